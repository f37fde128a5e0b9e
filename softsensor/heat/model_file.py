"""The model file: coefficients, effects and their uncertainty, as JSON.

``{"version", "press", "coefficients": {NAME: {"value", "sd"}}, "effects": [{"name", "parameters":
{NAME: {"value", "sd"}}}], "covariance": {"names", "matrix"}}``. Coefficients are those of a typical
run; ``sd`` is what a run may differ by, uncertainty of the mean included. The covariance is of the
logarithms of the coefficients and of the effect parameters themselves, in the order of its names.

Optional ``"adequacy": {"runs", "nothing", "unexplained_K", "causes": {NAME: {"chance", "size", "parameters",
"absorbed"}}}`` says what the runs behind the model know about causes it leaves out, see
`softsensor.diagnosis.missing_causes`.

Optional ``"scatter": {KEY: {"sd", "runs", "panel"}}``: by key of the header how far a constant was from what was
given, as a share of it, how many runs showed it (`softsensor.signals.doubt`), and the part of it by which panels
differ among themselves; a file without ``panel`` calls all of it that.

Optional ``"panels": [{"thickness_mm", "runs"}]``: how thick the panels of earlier runs were, and how many runs had
each; a file without it does not know (`softsensor.live.panels`).

Optional ``"sisters": {"presses": [NAME, ...], "scatter": {NAME: {"between", "within"}}}``: the presses of the same
kind that a press without runs of its own learned its model from, and how coefficients' logarithms scatter between
them and from run to run (`softsensor.jobs.sisters`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from daq.press.press_file import Press
from daq.printed import in_notebook, in_short, on_screen
from daq.records import KEYS_SHOWN, Array, InputError
from daq.words import Message, say
from softsensor.effects import find_effect
from softsensor.heat.model import ThermalModel


@dataclass(frozen=True)
class FittedValue:
    """A value and its standard deviation."""

    value: float
    """In the unit of its coefficient or parameter; of a coefficient [W/m²K]."""
    sd: float
    """Standard deviation in the same unit: what a run may differ by, uncertainty of the mean included."""


@dataclass(frozen=True)
class MissingCause:
    """A cause the model leaves out, as the runs behind it see it."""

    chance: float
    """That it is at work and nothing else is."""
    size: float
    """In units of its typical size."""
    parameters: Mapping[str, FittedValue]
    """What a further run would hold of it if it is; `sd` is what such a run may differ by."""
    absorbed: Mapping[str, float]
    """By how much coefficients' logarithms differ for its typical size from what the model without it says."""


@dataclass(frozen=True)
class MissingCauses:
    """How well the runs behind a model know that nothing is missing from it."""

    runs: int
    """Held against the model and described by it."""
    nothing: float
    """Chance that nothing of the catalogue is missing."""
    unexplained_K: float  # noqa: N815
    """Residual that neither the model nor any single cause explains. [K]"""
    causes: Mapping[str, MissingCause]

    __repr__ = on_screen


@dataclass(frozen=True)
class Scatter:
    """How far a constant is from the header's, as runs have shown it."""

    sd: float
    """As a share of the header's value: what all panels share and what they differ by."""
    runs: int
    panel: float
    """What panels differ by among themselves, as a share of the same."""


@dataclass(frozen=True)
class PressedPanel:
    """A product that earlier runs pressed."""

    thickness_mm: float
    runs: int


@dataclass(frozen=True)
class SisterScatter:
    """How a coefficient's logarithm scatters among presses of one kind."""

    between: float
    """Of a further press about what is expected of it."""
    within: float
    """From run to run."""


@dataclass(frozen=True)
class Sisters:
    """What a press without runs of its own learned its model from."""

    presses: tuple[str, ...]
    scatter: Mapping[str, SisterScatter]
    """By coefficient."""


def check_fitted(found: object, source: str | Message, place: str) -> None:
    """Refuse what is no value with a standard deviation. Raises `InputError`."""
    if not isinstance(found, FittedValue):
        raise InputError(say("model-file-no-numbers", file=source, place=place, value=in_short(found)))


@dataclass(frozen=True, repr=False, eq=False)
class ModelFile:
    """Coefficients and effects of one press, as a campaign found them.

    Two of the same content are equal, as what is written and read again. Raises `InputError` where a coefficient
    or parameter is no `FittedValue`.
    """

    version: str
    """Which model of the press it is."""
    press: str
    """Name of the press it is of."""
    coefficients: Mapping[str, FittedValue]
    """Heat transfer coefficients of a typical run, by name. [W/m²K]"""
    effects: tuple[tuple[str, Mapping[str, FittedValue]], ...] = ()
    """Name of each effect, and its parameters by name, in the parameters' own units."""
    names: tuple[str, ...] = ()
    """What rows and columns of the covariance are of, in their order (n)."""
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Of the coefficients' logarithms and of the effects' parameters themselves (n, n)."""
    missing: MissingCauses | None = None
    """None: nobody looked."""
    scatter: Mapping[str, Scatter] = field(default_factory=dict)
    """By key of the header."""
    panels: tuple[PressedPanel, ...] = ()
    """Which thicknesses earlier runs had, thinnest first; empty: not known."""
    sisters: Sisters | None = None
    """None: it rests on the press's own runs."""

    def __post_init__(self) -> None:
        """Refuse a value without its standard deviation."""
        tables = [("coefficients", self.coefficients)]
        tables += [(f"effects.{n}.parameters", table) for n, (_, table) in enumerate(self.effects)]
        for where, table in tables:
            for name, one in table.items():
                check_fitted(one, say("place-model", version=self.version), f"{where}.{name}")

    def __eq__(self, other: object) -> bool:
        """Return whether another model holds the same."""
        return self is other or (isinstance(other, ModelFile) and self.as_json() == other.as_json())

    def __hash__(self) -> int:
        """Hash by what names it; the content may be anything."""
        return hash((self.version, self.press))

    @property
    def _held(self) -> dict[str, FittedValue]:
        """Coefficients, and the effects' parameters by their full names."""
        own = {f"{name}.{key}": one for name, table in self.effects for key, one in table.items()}
        return {**self.coefficients, **own}

    def __repr__(self) -> str:
        """Return on one screen what it holds: its coefficients and effects, and what else runs have taught."""
        lines = [f"{name} = {one.value:.4g}, sd {one.sd:.2g}" for name, one in self._held.items()]
        shown = [*lines[:KEYS_SHOWN], *(["..."] if len(lines) > KEYS_SHOWN else [])]
        if self.missing is not None:
            percent = 100.0 * self.missing.nothing
            shown.append(str(say("printed-nothing-missing", percent=percent, runs=self.missing.runs)))
        thick = ", ".join(f"{panel.thickness_mm:g} mm" for panel in self.panels[:KEYS_SHOWN])
        panels = [str(say("printed-panels", panels=thick))] if thick else []
        return "\n".join([str(say("printed-model", version=self.version, press=self.press)), *shown, *panels])

    _repr_html_ = in_notebook

    @property
    def learned(self) -> dict[str, float]:
        """How far constants are off the header's by key, for `softsensor.signals.doubt.constant_doubts`."""
        return {key: s.sd for key, s in self.scatter.items()}

    @property
    def values(self) -> dict[str, float]:
        """Every parameter's value by its full name."""
        return {name: one.value for name, one in self._held.items()}

    def model(self, press: Press) -> ThermalModel:
        """Return the thermal model of a press with this file's effects."""
        return ThermalModel(press, tuple(find_effect(name) for name, _ in self.effects))

    def to_json(self) -> str:
        """Return the file's content as JSON."""
        return json.dumps(self.as_json())

    def as_json(self) -> dict[str, Any]:
        """Return the file's content."""

        def table(estimates: Mapping[str, FittedValue]) -> dict[str, Any]:
            return {name: {"value": e.value, "sd": e.sd} for name, e in estimates.items()}

        content = {
            "version": self.version,
            "press": self.press,
            "coefficients": table(self.coefficients),
            "effects": [{"name": name, "parameters": table(p)} for name, p in self.effects],
            "covariance": {"names": list(self.names), "matrix": np.asarray(self.covariance).tolist()},
        }
        if self.missing is not None:
            content["adequacy"] = {
                "runs": self.missing.runs,
                "nothing": self.missing.nothing,
                "unexplained_K": self.missing.unexplained_K,
                "causes": {
                    name: {
                        "chance": d.chance,
                        "size": d.size,
                        "parameters": table(d.parameters),
                        "absorbed": dict(d.absorbed),
                    }
                    for name, d in self.missing.causes.items()
                },
            }
        if self.scatter:
            content["scatter"] = {
                k: {"sd": s.sd, "runs": s.runs, "panel": s.panel} for k, s in self.scatter.items()
            }
        if self.panels:
            content["panels"] = [{"thickness_mm": p.thickness_mm, "runs": p.runs} for p in self.panels]
        if self.sisters is not None:
            scatter = {n: {"between": s.between, "within": s.within} for n, s in self.sisters.scatter.items()}
            content["sisters"] = {"presses": list(self.sisters.presses), "scatter": scatter}
        return content


def model_text(model: ModelFile) -> str:
    """Return the text of a model file."""
    return json.dumps(model.as_json(), indent=2) + "\n"
