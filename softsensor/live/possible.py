"""Between which temperatures a core can be at all: physics has the last word.

Heat flows from warm to cold, so nothing inside is hotter than the hottest that has touched the stack so far, nor
colder than the coldest (maximum principle of the heat equation); a flux adds what its face would reach if only its
radiation cooled it, a resin what it releases in an insulated panel. Evaporating water takes heat only from what is
hotter than itself. Numbers that go beyond are no answer.
"""

from __future__ import annotations

import math

from daq.press.header import panel_of
from daq.press.press_file import Boundary, BoundaryKind, InitialKind, Press
from daq.records import STEFAN_BOLTZMANN, Run
from softsensor.effects import catalogue
from softsensor.heat.step_terms import ZERO_C
from softsensor.live.setup import RunSetup
from softsensor.live.validity import Invalid, InvalidReason
from softsensor.signals.instrument import PLATEN_TOTAL_K

SLACK_K = 3.0 * PLATEN_TOTAL_K
"""A platen's reading may be off by so much. [K]"""


class Possible:
    """The coldest and the hottest that a run's core can have become.

    Parameters
    ----------
    setup
        The press with the run's overrides, and the run as its first scan has it.
    """

    def __init__(self, setup: RunSetup) -> None:
        press, run = setup.press, setup.run
        ends, ambient = (press.boundary.bottom, press.boundary.top), run.ambient_temperature
        known = [ambient, *(end.ambient_C for end in ends if end.ambient_C is not None), setup.start_C]
        known += [] if press.initial.temperature_C is None else [press.initial.temperature_C]
        if press.initial.kind is InitialKind.SENSORS:
            known += [float(run.columns[name][0]) for name in setup.columns]
        known = [t for t in known if math.isfinite(t)]
        self.lowest_C = min(known) - SLACK_K
        self._above = SLACK_K + _released(press, run)
        self.highest_C = max([*known, *(_by_radiation(end, ambient) for end in ends)]) + self._above

    def note(self, outside: tuple[float, ...]) -> None:
        """Take the measured boundary temperatures of a scan. [°C]"""
        for t in outside:
            self.lowest_C = min(self.lowest_C, t - SLACK_K)
            self.highest_C = max(self.highest_C, t + self._above)

    def within(self, temperature_C: float) -> float:
        """Return the possible temperature nearest to one. [°C]"""
        return min(max(temperature_C, self.lowest_C), self.highest_C)

    def contradicted(self, core_C: float) -> Invalid | None:
        """Return why a core cannot be so, None where it can. [°C]"""
        if self.lowest_C <= core_C <= self.highest_C:
            return None
        limits = {"lowest_C": self.lowest_C, "highest_C": self.highest_C}
        return Invalid(InvalidReason.IMPOSSIBLE_CORE, {"core_C": core_C} | limits)


def _by_radiation(end: Boundary, ambient: float) -> float:
    """Return what a face under a flux reaches if nothing but its own radiation cools it. [°C]"""
    if end.kind is not BoundaryKind.FLUX:
        return ambient
    if end.emissivity <= 0.0:
        return math.inf
    around = (ambient if end.ambient_C is None else end.ambient_C) + ZERO_C
    absorbed = end.absorptivity * end.incident_W_m2 / (end.emissivity * STEFAN_BOLTZMANN)
    return math.sqrt(math.sqrt(absorbed + around**4)) - ZERO_C


def _released(press: Press, run: Run) -> float:
    """Return by how much all heat that effects of the catalogue can release would warm an insulated panel. [K]"""
    if not press.panel_layers:
        return 0.0
    panel = panel_of(run)
    most = sum(effect.most_heat_J_m2 for effect in catalogue().values())
    return most / (panel.thickness * panel.density * panel.heat_capacity)
