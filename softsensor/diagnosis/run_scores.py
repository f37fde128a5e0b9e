"""What single runs say for causes that a model leaves out, along directions fixed beforehand.

A diagnosis looks for the direction that suits its runs best; what is put together night after night must not have
looked at the run it counts. So each cause has the direction of its typical size, whatever the runs say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.press.press_file import Press
from daq.records import Array, Run
from softsensor.diagnosis.decision import SMALLEST_EXPONENT
from softsensor.diagnosis.directions import direction
from softsensor.diagnosis.extension_unknowns import is_shape
from softsensor.diagnosis.search import PROBE, candidates_for, switch_scores
from softsensor.diagnosis.settling import SettledModel, settle_base
from softsensor.diagnosis.sign_flips import SCORE_LIMIT
from softsensor.effects import Effect, Need, catalogue
from softsensor.effects.parameters import SMALL_SHARE
from softsensor.heat.model import ThermalModel
from softsensor.signals.digest import screened_digest


@dataclass(frozen=True)
class CauseWay:
    """One way in which a cause can show: one of its parameters, or all of them, moved to one side."""

    effect: Effect
    values: dict[str, float]
    """Parameters as the model names them, `PROBE` typical sizes away."""
    least: float
    """Size below which a cause is none, in typical ones."""
    sign: float = 1.0
    """Of the side it is moved to."""


def ways() -> dict[str, CauseWay]:
    """Return the catalogue's ways by name; what can have either sign has two for each of its parameters."""
    found = {}
    for effect in catalogue().values():
        sizes = [p for p in effect.parameters if not is_shape(p)]
        neutral = {effect.key(p.name): p.typical if is_shape(p) else p.neutral for p in effect.parameters}
        least = SMALLEST_EXPONENT if effect.needs == Need.LOAD else SMALL_SHARE
        for several in [sizes] if effect.one_sided else [[p] for p in sizes]:
            for sign in (1.0,) if effect.one_sided else (1.0, -1.0):
                moved = {effect.key(p.name): p.neutral + sign * PROBE * (p.typical - p.neutral) for p in several}
                name = f"{effect.name}.{'+'.join(p.name for p in several)}{'-' * (sign < 0)}"
                found[name] = CauseWay(effect, neutral | moved, least, sign)
    return found


@dataclass(frozen=True)
class Shown:
    """What runs show of a cause in one of its ways, in standard deviations of a run's own size (runs)."""

    score: Array
    least: Array
    """What the cause's least size would be."""

    @property
    def beyond(self) -> Array:
        """By how much runs show more than that, `SCORE_LIMIT` at most either way.

        Of a cause that has no more, it is as likely below zero as above it, or likelier.
        """
        return np.asarray(np.clip(self.score - self.least, -SCORE_LIMIT, SCORE_LIMIT))


def run_scores(model: ThermalModel, press: Press, runs: Sequence[Run]) -> dict[str, Shown]:
    """Return what runs show of the causes they can say something about, by way.

    They are fitted together, which shows how they scatter.

    Raises
    ------
    InputError
        For a run that does not fit the press.
    """
    stage = settle_base(model, [screened_digest(press, run).digest for run in runs])
    able = {effect.name for effect in candidates_for(stage)} - set(stage.effects)
    return {name: _shown(stage, way) for name, way in ways().items() if way.effect.name in able}


def _shown(stage: SettledModel, way: CauseWay) -> Shown:
    if way.effect.needs == Need.SWITCH:  # scores have a least size of their own
        scores = way.sign * switch_scores(stage)
        return Shown(scores, np.zeros_like(scores))
    along = direction(stage.fit, stage.data, stage.fit.layout.model.extended(way.effect), way.values)
    root = np.sqrt(np.maximum(along.power, 1e-12))
    return Shown(along.score / root, way.least / PROBE * root)
