"""The virtual press: the truth against which the model, the fit and the diagnosis are tested.

Stack from bottom to top: platen, steel plate, panel, steel plate, platen. Method of lines on nodes that
are finest at the panel's faces, every effect at full nonlinearity, closing and opening as ramps. It
shares no code with the soft sensor; `tests/daq/test_simulated_physics.py` checks it against closed forms.

Conventions where the contract leaves them open:
evaporable water counts on ``panel.density_kg_m3`` as the dry mass; `contact_load` refers to 350 N/cm²;
`contact_asymmetry` changes the upper contact and leaves the lower; `open_radiation` crosses the upper gap;
the paper lies between plate and panel, half its resistance on either side of its capacity, and the
thermocouples lie under it; steam condenses in proportion to 100 °C minus the temperature.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.records import Array
from daq.simulated import physics_kernel as kernel
from daq.simulated.physics_mesh import Accuracy, build_knobs, build_mesh, first_state
from daq.simulated.physics_pressing import EASING_S, Pressing

_STEPPING = {"fast": (1e-3, 0.5), "accurate": (1e-5, 0.1)}
"""Local error of a step [K] and longest step [s]: of `Stepping`."""


@dataclass(frozen=True)
class SolvedPressing:
    """A solved pressing: values after each step, and any time in between."""

    steps: Mapping[str, Array]
    """``time`` and every name of `SIGNALS`."""
    bounds: NDArray[np.int64]
    """First row of each stretch between two jumps, and one past the last row."""
    plates: tuple[Array, Array]
    """Node temperatures of the lower and upper plate at the end. [°C]"""

    def at(self, signal: str, times: Array) -> Array:
        """Return a signal at any times: cubic between the steps, never across a jump."""
        wanted = np.ascontiguousarray(times, dtype=np.float64)
        return np.asarray(kernel.interpolate(self.steps["time"], self.steps[signal], self.bounds, wanted))


def solve(
    pressing: Pressing, accuracy: Accuracy = "fast", plates: tuple[Array, Array] | None = None
) -> SolvedPressing:
    """Integrate a pressing from its start to its end.

    Parameters
    ----------
    pressing
        The conditions.
    accuracy
        ``fast`` agrees with ``accurate`` within 0.02 K at core and faces and takes a few milliseconds.
    plates
        Node temperatures to start from, as an earlier `SolvedPressing` ended; else the plates stand steady
        without a panel, as the contract's ``[initial] kind = "steady"`` says.
    """
    mesh = build_mesh(pressing, accuracy)
    knobs, y = build_knobs(pressing, mesh), first_state(pressing, mesh, plates)
    how = kernel.Stepping(*_STEPPING[accuracy])
    rows = 4000 + int(8 * (pressing.end - pressing.start) / how.longest)
    out = np.empty((rows, 1 + len(kernel.SIGNALS)))
    last, bounds = 0, [0]
    for a, b in itertools.pairwise(_breakpoints(pressing)):
        written = kernel.advance((a, b), y, knobs, mesh.stack, how, out[last:])
        if written < 0:
            raise RuntimeError(f"virtual press: more than {rows} steps up to {b:g} s")
        last += written
        bounds.append(last)
    steps = {name: out[:last, i].copy() for i, name in enumerate(("time", *kernel.SIGNALS))}
    return SolvedPressing(steps, np.array(bounds), (y.T[: mesh.stack.lower + 1], y.T[mesh.stack.upper :]))


def _breakpoints(pressing: Pressing) -> list[float]:
    """Return start, every jump in between, and end."""
    o = pressing.outside
    ramp, ramp_open = pressing.closing_ramp / 2, pressing.opening_ramp / 2
    jumps = [
        pressing.inserted, pressing.closed - ramp, pressing.closed, pressing.closed + ramp,
        pressing.opened - ramp_open, pressing.opened + ramp_open, pressing.removed,
        o.lapse_from, o.lapse_to, o.split_from, o.split_from + 2.0, o.draught_from, o.lift_from,
        o.flash_from, o.flash_to, pressing.eased_from, pressing.eased_from + EASING_S,
    ]  # fmt: skip
    inside = sorted({t for t in jumps if pressing.start + 1e-6 < t < pressing.end - 1e-6})
    return [pressing.start, *inside, pressing.end]
