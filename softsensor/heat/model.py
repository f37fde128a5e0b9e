"""The thermal model: a press, effects, and one run in; temperatures and their sensitivities out.

    rho c dT/dt = d/dx (k dT/dx) + q          T in °C, x in m from the bottom, q in W/m³

Notes on the paper this follows:

* It prints the equation with the sign of the conduction term turned and without rho c; the form above is
  meant, since heat flows down the gradient and the printed one has other units on either side.
* Its figure of the layers and its table of transitions give the labels h_p and h_pp the other way round
  for the open press. Here the figure counts: h_p couples platen and plate, h_pp couples plate and panel.
* Its pressures are read as N/cm² (350 N/cm² = 3.5 MPa, usual for laminating); the same figures in bar or
  N/mm² would be ten or a hundred times that.
* Its values table, read literally, weakens both contacts on closing, and no panel face could get warm
  enough to laminate; only closed values in kW/m²K do. ``deploy/examples/paper_table`` computes the face
  temperature under each reading. The file's guesses are ours.

Accuracy of the default mesh and steps (fineness 1, steps up to 0.5 s) on the laboratory press, panels of 8 to
19 mm, contacts of 100 to 2000 W/m²K, against a mesh six times as fine, from 0.25 s after a ramp: faces within
0.06 K, core within 0.055 K (rms of all 0.03 K). With 2 to 6 % of evaporating water, whose front is thinner than
the cells behind the face: faces within 0.45 K in the first 1.2 s after closing and 0.15 K later, core within
0.1 K. Nearly all of it is the mesh's: `fineness` 2 quarters it.

With steam (vapour convection of 1e4 to 2e4 W/m³K) that lifts the core of an 8 mm panel over 100 °C: core within
0.01 K.
Inside a ramp, where faces move by up to 400 K/s, rows are good to about 2 ms of time. Radiation of an end is
taken with its slope at each step's face temperature: no step is too long for a foil to settle.

Units: K, s, W, m; temperatures in °C. Parameters are named: coefficients as in the press file
(``h_pp_c``), effect parameters ``edge_loss.W_m3K``, and these nuisances of a run:

========================  ==========================================================
``closed_s, opened_s``    middle of the closing and opening ramp, shift from the case [s]
``inserted_s``            insertion, shift from the case; without effect where the run starts at it [s]
``ramp_s``                length of the closing ramp, shift from the case [s]
``opening_ramp_s``        length of the opening ramp, shift from the usual one [s]
``initial_K``             shift of the panel's initial temperature [K]
``boundary_bottom_K``     shift of the measured bottom boundary [K]
``boundary_top_K``        shift of the measured top boundary [K]
``panel_conductivity``    by how much the panel conducts better than given, as a share
``panel_capacity``        by how much it stores more heat than given, as a share
========================  ==========================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import accumulate
from math import isfinite
from typing import Any, Literal

import numpy as np

from daq.press.press_file import InitialKind, Press
from daq.records import InputError, Moments, Nonphysical, PressState, Run
from daq.words import say
from softsensor.effects import Conversion, Effect, Scene, Source, Terms, find_effect, on_panel
from softsensor.effects.effect import FACTORS, SUMMANDS
from softsensor.effects.own import terms_of
from softsensor.heat import implicit_steps
from softsensor.heat.build import Build
from softsensor.heat.case import FINE_STEP_S, GROWTH, Case, Fineness, prepare_case
from softsensor.heat.chain import Solution, observe, read_places
from softsensor.heat.exact import exact_grid, run_exact
from softsensor.heat.run_checks import check_first_readings, check_values, value_limits
from softsensor.heat.solve_request import SolveRequest

NUISANCES = (
    "closed_s",
    "opened_s",
    "ramp_s",
    "opening_ramp_s",
    "inserted_s",
    "initial_K",
    "boundary_bottom_K",
    "boundary_top_K",
    "panel_conductivity",
    "panel_capacity",
)
"""Per-run parameters every model has; 0 where nothing is known better."""
PANEL_SHARES = ("panel_conductivity", "panel_capacity")
"""Those of them that change a constant of the panel."""
_TINY = 1e-30
"""Imaginary step of complex-step derivatives: its square vanishes beside 1."""
_STATES = (PressState.IDLE, PressState.OPEN, PressState.CLOSED)


@dataclass(frozen=True)
class ThermalModel:
    r"""A press and the effects its model takes into account.

    Between the boundaries, through every layer, with contacts between neighbours and q from the effects:

    $$\rho c \frac{\partial T}{\partial t} =
    \frac{\partial}{\partial x}\left(k \frac{\partial T}{\partial x}\right) + q$$

    Examples
    --------
    >>> from daq import shared_files
    >>> from softsensor import find_effect, read_press
    >>> press = read_press(shared_files() / "presses" / "lab.toml")
    >>> ThermalModel(press, (find_effect("edge_loss"),)).parameter_names[-2:]
    ('h_ap', 'edge_loss.W_m3K')
    """

    press: Press
    """The chain of layers and contacts."""
    effects: tuple[Effect, ...] = ()
    """What it adds to plain conduction, in this order."""

    @staticmethod
    def of(press: Press, names: Iterable[str] = ()) -> ThermalModel:
        """Make a model from effect names of the catalogue. Raises InputError for an unknown name."""
        return ThermalModel(press, tuple(find_effect(name) for name in names))

    def extended(self, *effects: Effect) -> ThermalModel:
        """Return the model with more effects."""
        return replace(self, effects=(*self.effects, *effects))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Coefficients of the press, then the effects' parameters."""
        own = tuple(e.key(p.name) for e in self.effects for p in e.parameters)
        return self.press.coefficient_names + own

    @property
    def guesses(self) -> dict[str, float]:
        """The press file's guesses, and the effects' typical sizes."""
        values = {name: self.press.coefficient(name).guess for name in self.press.coefficient_names}
        return values | {e.key(p.name): p.typical for e in self.effects for p in e.parameters}

    def prepare(
        self,
        run: Run,
        moments: Moments,
        *,
        fineness: float = 1.0,
        max_step_s: float = 0.5,
        switch_step_s: float = FINE_STEP_S,
        growth: float = GROWTH,
    ) -> Case:
        """Lay out a run for solving.

        Parameters
        ----------
        fineness
            2 halves cells and steps, and quarters the error.
        max_step_s, switch_step_s
            Longest step, and step around a switch; where nothing outside is measured, steps grow beyond the
            longest with the time since the last switch (`heat.case.LATER`). [s]
        growth
            Factor of a step over the one before, after a switch.

        Raises
        ------
        InputError
            For a run the press file cannot be solved with, see `prepare_case`.
        """
        paper = any(e.layers for e in self.effects)
        how = Fineness(fineness, max_step_s, switch_step_s, growth)
        return prepare_case(self.press, run, moments, paper=paper, fineness=how)

    def build(self, case: Case, values: Mapping[str, float], tangents: tuple[str, ...] = ()) -> Build:
        """Assemble the arrays the compiled steps work on. Raises InputError for a missing coefficient.

        A coefficient that only the run's header names is its guess there unless given.
        """
        coefficients = case.press.coefficient_names
        if case.press is not self.press:
            own = set(coefficients).difference(self.press.coefficient_names)
            values = {name: case.press.coefficient(name).guess for name in own} | dict(values)
        missing = [n for n in coefficients if n not in values]
        if missing:
            raise InputError(say("coefficient-missing", name=missing[0], all=coefficients))
        for name in coefficients:
            if not 0.0 <= values[name] < np.inf:
                raise Nonphysical(say("coefficient-negative", name=name, value=f"{values[name]:g}"))
        for name in values:
            if not isfinite(values[name]):
                raise Nonphysical(say("value-not-finite", name=name, value=f"{values[name]:g}"))
        parts = self._parts(case, values)
        terms = _merged(parts)
        late = any(e.nonlinear or terms.closed_contact for e in self.effects)
        request = SolveRequest(values, tangents, terms, self._derived(case, values, parts, tangents, late=late))
        return Build.of(case, request, nonlinear=any(e.nonlinear for e in self.effects))

    def solve(
        self,
        case: Case,
        values: Mapping[str, float],
        tangents: Iterable[str] = (),
        *,
        method: Literal["implicit", "exact"] = "implicit",
        fields: bool = False,
    ) -> Solution:
        """Run the model over a case.

        Parameters
        ----------
        values
            Every coefficient of the press; effect parameters left out are neutral, nuisances 0.
        tangents
            Parameters to differentiate by.
        method
            ``implicit`` (TR-BDF2) for any model; ``exact`` in time for a linear one, see `exact`.
        fields
            Keep all cell temperatures at every step edge of the case (of the exact solver's own grid).

        Raises
        ------
        Nonphysical
            For a value that is no number, or outside what its parameter can be, and for contacts or sources
            from which no temperature follows.
        NoSteadyState
            For plates without a steady start.
        InputError
            For a missing coefficient, a value or a tangent the model does not have, an unknown method, a start
            from readings that are not there, or a model the exact solver cannot take.
        """
        names = tuple(tangents)
        if method not in ("implicit", "exact"):
            raise InputError(say("solve-unknown-method", method=repr(method)))
        self.check(case, values, names)
        if method == "implicit":
            try:
                build = self.build(case, values, names)
                record = implicit_steps.empty_record(
                    read_places(case, build), len(case.h), build.width, whole=fields
                )
                implicit_steps.march(
                    build.stack, build.tangents, build.drive, build.start, record, build.nonlinear
                )
            except ZeroDivisionError:
                raise Nonphysical(say("solve-no-temperatures", run=case.run.source or case.run.name)) from None
            return observe(case, build, record)
        terms = _merged(self._parts(case, values))
        late = terms.lag != 0.0 or terms.clock != 0.0  # what a channel reads depends on more than its row's moment
        grid = exact_grid(case, values, fine=bool(late or names))
        build = self.build(grid.sparse, values, names)
        if build.nonlinear:
            bent = [e.name for e in self.effects if e.nonlinear]
            what = bent[0] if bent else say("solve-table-or-radiation")
            raise InputError(say("solve-exact-not-linear", what=what))
        return observe(grid.case, build, run_exact(grid, build, read_places(case, build), fields=fields))

    def check(self, case: Case, values: Mapping[str, float], tangents: Iterable[str] = ()) -> None:
        """Refuse what `solve` does, but for models the exact solver cannot take."""
        limits = self._limits
        if case.press is not self.press:
            limits = value_limits((), case.press.coefficient_names, ()) | limits
        check_values(limits, values)
        if unknown := [name for name in tangents if name not in limits]:
            raise InputError(say("parameter-unknown", name=unknown[0], known=tuple(limits)))
        if case.press.initial.kind is InitialKind.SENSORS:
            check_first_readings(case.run, case.press.panel_layers, case.fitted_places, case.labels)

    @cached_property
    def _limits(self) -> dict[str, tuple[float, float]]:
        return value_limits(self.effects, self.press.coefficient_names, NUISANCES)

    def _parts(self, case: Case, values: Mapping[str, float], shift: complex = 0.0) -> list[Terms]:
        """Return each effect's terms, with the moment of closing shifted. [s]"""
        scene = _scene(case, values, shift)
        return [
            *(terms_of(effect, scene, _own(effect, values)) for effect in self.effects),
            _panel_terms(scene, values),
        ]

    def _derived(
        self, case: Case, values: Mapping[str, float], parts: list[Terms], by: Iterable[str], *, late: bool
    ) -> dict[str, Terms]:
        """Return the derivatives of the merged terms by those parameters that they depend on.

        `parts` are the effects' terms; a parameter changes those of its own effect only, and the moment of
        closing, if `late`, those of all.
        """
        owners = {e.key(p.name): (i, p.name) for i, e in enumerate(self.effects) for p in e.parameters}
        scene = _scene(case, values)
        before = list(accumulate(parts, _merge, initial=Terms()))
        after = list(accumulate(reversed(parts), lambda a, b: _merge(b, a), initial=Terms()))[::-1]
        derived = {}
        for name in by:
            if name in owners:
                i, own = owners[name]
                here = _own(self.effects[i], values)
                moved = terms_of(self.effects[i], scene, here | {own: here[own] + 1j * _TINY})
                derived[name] = _merged([before[i], moved, after[i + 1]], imaginary=True)
            elif name == "closed_s" and late:
                derived[name] = _merged(self._parts(case, values, 1j * _TINY), imaginary=True)
            elif name in PANEL_SHARES:
                moved = _panel_terms(scene, {**values, name: values.get(name, 0.0) + 1j * _TINY})
                derived[name] = _merged([before[-2], moved], imaginary=True)
        return derived


def _scene(case: Case, values: Mapping[str, float], shift: complex = 0.0) -> Scene:
    return replace(case.scene, closed_s=case.moments.closed_s + values.get("closed_s", 0.0) + shift)


def _panel_terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    """Return what a panel does that is not as given."""
    k, c = (values.get(name, 0.0) for name in PANEL_SHARES)
    if k == 0.0 and c == 0.0:
        return Terms()
    return Terms(conductivity=on_panel(scene, 1.0 + k, 1.0), capacity=on_panel(scene, 1.0 + c, 1.0))


def _own(effect: Effect, values: Mapping[str, float]) -> dict[str, Any]:
    """Return an effect's parameters by their short names."""
    return {p.name: values.get(effect.key(p.name), p.neutral) for p in effect.parameters}


def _merge(a: Terms, b: Terms) -> Terms:
    contact = dict(a.closed_contact)
    for m, factor in b.closed_contact.items():
        contact[m] = contact[m] * factor if m in contact else factor
    return Terms(
        **{name: getattr(a, name) * getattr(b, name) for name in FACTORS},
        **{name: getattr(a, name) + getattr(b, name) for name in SUMMANDS},
        closed_contact=contact,
        conversions=a.conversions + b.conversions,
        sources=a.sources + b.sources,
        paper=b.paper if b.paper is not None else a.paper,
        boundary_offset=(a.boundary_offset[0] + b.boundary_offset[0], a.boundary_offset[1] + b.boundary_offset[1]),
    )


def _merged(parts: Iterable[Terms], *, imaginary: bool = False) -> Terms:
    """Return the real part of several effects' terms together, or their derivative from the imaginary one."""
    terms = reduce(_merge, parts, Terms())

    def take(x: Any) -> Any:
        return x.imag / _TINY if imaginary else x.real

    return Terms(
        **{name: take(getattr(terms, name)) for name in FACTORS + SUMMANDS},
        closed_contact={m: take(f) for m, f in terms.closed_contact.items()},
        conversions=tuple(
            Conversion(take(c.heat), c.kind, take(c.a), take(c.b), take(c.c), take(c.own))
            for c in terms.conversions
        ),
        sources=tuple(Source(take(s.heat), take(s.course)) for s in terms.sources),
        paper=None if terms.paper is None else (take(terms.paper[0]), take(terms.paper[1])),
        boundary_offset=(take(terms.boundary_offset[0]), take(terms.boundary_offset[1])),
    )


def states(case: Case) -> list[PressState]:
    """Return the press state at each row: a moment's own row already has the new state."""
    if not case.press.has_states:
        return [PressState.CLOSED] * len(case.run.time_s)
    moments, t = case.moments, case.run.time_s + 1e-9
    gone = t >= moments.removed_s
    closed = (t >= moments.closed_s) & ~(t >= moments.opened_s) & ~gone
    idle = gone | ((t < moments.inserted_s) & ~closed)
    return [_STATES[0 if away else 2 if shut else 1] for away, shut in zip(idle, closed, strict=True)]
