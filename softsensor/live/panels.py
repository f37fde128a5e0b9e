"""Which panel lies in the press: the one that the header says, or another that this press has had before.

A wrong thickness does not show: contacts, edges and undiagnosed causes explain the faces as well (of a quarter
too thin or too thick a filter with the true one is ahead by 0.0 to 0.2 nats after 30 s in the closed press, 0.0
to 0.7 after 60 s; ``python -m tests.calibration.wrong_headers``, 2026-11-24), and the core is then 10 to 60 K
beyond a band that rests on it. So it is a matter of chances. After N runs of K products the next panel is of a
product never had before with a chance of K / (N + K) (Witten & Bell 1991, IEEE Trans. Inf. Theory 37, 1085,
method C; of one product Laplace's 1 / (N + 1)), else of product i with n_i / (N + K). A header that says what a
product was is believed. One that says something else is right about a new product, or wrong about a known one:

    new product : product i  =  (1 - ENTRY_ERROR) K  :  ENTRY_ERROR n_i

for a wrong number may be any, as a new product's may. A new product's constants are known no better than before
any run; a known one's as earlier runs have shown them. Each has filters of its own, and the faces weigh them.

So it is with a constant that is odd for its material (`daq.materials.ODD`): the board is special, or the number is
mistaken and a board of the table lies there. Until 2026-11-25 one filter about the header's number doubted it by
as much as it is off; the core answers to that in no straight line, and was 1.4 K beyond its band where the header
stated half as much again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from daq.press.header import listed_constants
from daq.press.press_file import SD, Press, press_for_run
from daq.records import Run
from daq.words import Message, say
from softsensor.heat.model_file import ModelFile, PressedPanel
from softsensor.live.directions import MOST_SHARE, odd_constants
from softsensor.live.setup import RunSetup, set_up
from softsensor.signals.doubt import nearest_of, one_product, thickness_sd

THICKNESS = "panel.thickness_mm"
ENTRY_ERROR = 0.023
"""Chance that a number which people enter is wrong: the least that double entry found in clinical databases, 2.3
to 26.9 % (Goldberg, Niemierko & Turchin 2008, AMIA Annu. Symp. Proc. 242)."""
LEAST_CHANCE = 0.25
"""The header is never held less likely than this: a band of 95 % still holds nine tenths of what would be if it is
right (0.025 / 0.25 lie beyond). Rates of entry errors are no surer: one trade has 0.3 to 6.6 % of them by the way
of entry (Garza et al. 2023, doi 10.21203/rs.3.rs-2386986), and a thickness is mostly new because somebody wants it
so. By hand, 2026-11."""
MOST_OTHERS = 3
"""So many other panels have filters of their own, each at the cost of the header's. By hand."""


@dataclass(frozen=True)
class PanelChance:
    """A thickness and how likely it is before the faces are read."""

    chance: float
    thickness_mm: float
    sd_mm: float
    """What panels so called differ by."""


def panel_chances(header_mm: float, pressed: Sequence[PressedPanel]) -> tuple[PanelChance, ...]:
    """Return how thick the panel may be, the header's thickness first; they add up to 1.

    Parameters
    ----------
    header_mm
        What the header says.
    pressed
        What earlier runs were of; none: not known.
    """
    own = PanelChance(1.0, header_mm, thickness_sd(header_mm))
    if not pressed or any(one_product(header_mm, p.thickness_mm) for p in pressed):
        return (own,)
    runs = sum(p.runs for p in pressed)
    new, wrong = (1.0 - ENTRY_ERROR) * len(pressed), ENTRY_ERROR * runs
    header = max(new / (new + wrong), LEAST_CHANCE)
    others = [
        PanelChance((1.0 - header) * p.runs / runs, p.thickness_mm, thickness_sd(p.thickness_mm)) for p in pressed
    ]
    while len(others) > MOST_OTHERS:
        i = min(range(len(others) - 1), key=lambda i: others[i + 1].thickness_mm / others[i].thickness_mm)
        others[i : i + 2] = [_joined(others[i], others[i + 1])]
    return replace(own, chance=header), *others


def _joined(one: PanelChance, other: PanelChance) -> PanelChance:
    """Return two as one with their mean and variance."""
    chance = one.chance + other.chance
    share = one.chance / chance
    apart = other.thickness_mm - one.thickness_mm
    variance = share * one.sd_mm**2 + (1.0 - share) * other.sd_mm**2 + share * (1.0 - share) * apart**2
    return PanelChance(chance, one.thickness_mm + (1.0 - share) * apart, math.sqrt(variance))


def mistaken_constants(header: Mapping[str, Any]) -> tuple[float, dict[str, float]]:
    """Return the chance that a header's odd constants are mistaken, and what its keys hold if they are.

    Of sound boards a number lies as far from the table's as by the normal law, and of mistaken ones at most every
    one does: right : mistaken is (1 - ENTRY_ERROR) P(so far off) : ENTRY_ERROR. Nothing and 0 where none is odd,
    where one is off by too much to be followed, or where several are, any of which may be the mistaken one: each
    is then doubted by as much as it is off (`directions`).
    """
    odd, listed = odd_constants(header), listed_constants(header)
    if len(odd) != 1 or max(odd.values()) > MOST_SHARE:
        return 0.0, {}
    deviations = max(math.expm1(off) / listed[key].relative_sd for key, off in odd.items())
    right = (1.0 - ENTRY_ERROR) * math.erfc(deviations / math.sqrt(2.0))
    listed_values = {key: listed[key].value for key in odd}
    listed_values |= {f"{key}{SD}": listed[key].relative_sd * value for key, value in listed_values.items()}
    return 1.0 - max(right / (right + ENTRY_ERROR), LEAST_CHANCE), listed_values


@dataclass(frozen=True)
class LikelyPanel:
    """A panel that may lie in the press, as a run's set-up."""

    chance: float
    """Before its faces are read."""
    setup: RunSetup

    @property
    def thickness_mm(self) -> float:
        """As it is set up; NaN without a panel. [mm]"""
        return float(self.setup.run.header.get(THICKNESS, math.nan))


def panel_remark(header: Mapping[str, Any], model: ModelFile | None) -> Message | None:
    """Return what must be known about a live core whose header says a thickness that no earlier run had."""
    header_mm, pressed = header.get(THICKNESS), model.panels if model is not None else ()
    if not isinstance(header_mm, int | float) or len(chances := panel_chances(float(header_mm), pressed)) == 1:
        return None
    return say("panel-not-pressed-before", key=THICKNESS, **nearest_of([c.thickness_mm for c in chances]))


def likely_panels(press: Press, run: Run, model: ModelFile | None) -> tuple[LikelyPanel, ...]:
    """Return the panels that may lie in a run's press, the header's first; they add up to 1.

    The last is the material table's where a constant of the header is odd.

    Parameters
    ----------
    press
        Without the run's overrides.
    run
        As its first scan has it.

    Raises
    ------
    InputError
        Where the header does not fit the press.
    """
    own = press_for_run(press, run)
    header_mm, pressed = run.header.get(THICKNESS), model.panels if model is not None else ()
    if not own.panel_layers or not isinstance(header_mm, int | float):
        return (LikelyPanel(1.0, set_up(own, run, model)),)
    mistaken, listed = mistaken_constants(run.header)
    header, *others = panel_chances(float(header_mm), pressed)
    likely = [(header.chance, {}), *((o.chance, _so_thick(o)) for o in others)]
    likely = [((1.0 - mistaken) * chance, changes) for chance, changes in likely]
    likely += [(mistaken, listed)] if mistaken else []
    if (first := likely[0][0]) < LEAST_CHANCE:  # of two doubts together
        rest = (1.0 - LEAST_CHANCE) / (1.0 - first)
        likely = [(LEAST_CHANCE, {}), *((rest * chance, changes) for chance, changes in likely[1:])]
    found = []
    for chance, changes in likely:
        changed = replace(run, header={**run.header, **changes})
        new = bool(others) and THICKNESS not in changes
        found.append(LikelyPanel(chance, set_up(own, changed, model, new_product=new)))
    return tuple(found)


def _so_thick(one: PanelChance) -> dict[str, float]:
    return {THICKNESS: one.thickness_mm, f"{THICKNESS}{SD}": one.sd_mm}
