"""From a pressing to the true temperature at every sensor: places over the face that differ are solved apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from daq.records import Array
from daq.simulated.campaign_platens import KNOT_S
from daq.simulated.campaign_sensors import FACES, POSITIONS_MM, RIM_SHAPE
from daq.simulated.physics import SolvedPressing, solve
from daq.simulated.physics_mesh import Accuracy
from daq.simulated.physics_pressing import Platen, Pressing

Curve = Callable[[Array], Array]
HEATER_LOSS_K = 40.0
"""What a face falls by in the long run without one of its heater zones."""


@dataclass(frozen=True)
class Places:
    """A solved pressing as the sensors would see it with nothing wrong in their chain."""

    core: Curve
    """Mean over the face, at mid-depth."""
    channels: Mapping[str, Curve]
    """The 14 thermocouples on the panel."""
    mean: SolvedPressing


def solve_places(
    pressing: Pressing,
    outside: Mapping[str, Mapping[str, float]],
    rim_contrast: float = 0.0,
    accuracy: Accuracy = "fast",
    plates: tuple[Array, Array] | None = None,
) -> Places:
    """Solve the press once, or once for each kind of place over the face.

    Parameters
    ----------
    pressing
        The conditions, with faults outside the catalogue already put in.
    outside
        Those faults again, for the one that needs a second place: a heater zone.
    rim_contrast
        1 gives rim sensors the full difference of a rim loss, 0 none.
    accuracy, plates
        As in `solve`.
    """
    mean = solve(pressing, accuracy, plates)
    places = [mean] * len(POSITIONS_MM)
    core = _curve(mean, "core")
    if rim_contrast > 0 and "edge_loss" in pressing.effects:
        shares = {shape: 1.0 + rim_contrast * (shape - 1.0) for shape in set(RIM_SHAPE)}
        solved = {shape: solve(_with_edge(pressing, x), accuracy, plates) for shape, x in shares.items()}
        places = [solved[shape] for shape in RIM_SHAPE]
    if zone := outside.get("heater_zone_out"):
        cold = solve(replace(pressing, platen_top=_without_heater(pressing, zone)), accuracy, plates)
        places = [cold if x > 250.0 else mean for x, _ in POSITIONS_MM]
        core = _mean_curve(mean, cold, "core")
    channels = {
        column: _curve(places[i], f"sensor_{face}")
        for face, names in FACES.items()
        for i, column in enumerate(names)
    }
    return Places(core, channels, mean)


def _with_edge(pressing: Pressing, factor: float) -> Pressing:
    edge = {"W_m3K": factor * pressing.effects["edge_loss"]["W_m3K"]}
    return replace(pressing, effects={**pressing.effects, "edge_loss": edge})


def _without_heater(pressing: Pressing, zone: Mapping[str, float]) -> Platen:
    """Return the upper platen where a heater zone has cut out: it falls, and its sensor sits elsewhere."""
    platen = pressing.platen_top
    t = platen.start + KNOT_S * np.arange(len(platen.values))
    cut = pressing.closed + zone["from_share"] * (pressing.opened - pressing.closed)
    fallen = 1.0 - np.exp(-np.clip(t - cut, 0.0, None) * zone["K_s"] / HEATER_LOSS_K)
    return replace(platen, values=platen.values - HEATER_LOSS_K * fallen)


def _curve(solution: SolvedPressing, signal: str) -> Curve:
    return lambda t: solution.at(signal, t)


def _mean_curve(a: SolvedPressing, b: SolvedPressing, signal: str) -> Curve:
    return lambda t: 0.5 * (a.at(signal, t) + b.at(signal, t))
