"""Many runs at once: the same model solved for a list of cases, several runs side by side in one kernel.

For questions to the model alone, such as a window of press times (``deploy/examples/press_window``) or the spread
of coefficients. Fits need sensitivities with every run and solve run by run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from daq.records import Array
from softsensor.heat import batch_steps
from softsensor.heat.batch_steps import LANES, Lanes, Ready
from softsensor.heat.case import Case
from softsensor.heat.model import Build, Solution, ThermalModel, observe, read_places

Values = Mapping[str, float]


def solve_many(
    model: ThermalModel, cases: Sequence[Case], values: Values | Sequence[Values], *, threads: int = 2
) -> list[Solution]:
    """Solve many cases without tangents; in the order given, as `ThermalModel.solve` would within 1e-9 K.

    Linear stacks are taken by lanes in the compiled kernel; a case whose model is nonlinear, or in which
    property tables or radiation rule, is solved alone. Cells, steps, moments and coefficients may differ from
    run to run; runs of similar length and mesh go together best. `Solution.final` holds the state at the
    start, its fields are empty.

    Parameters
    ----------
    values
        Parameter values of all cases, or of each, as `ThermalModel.solve` takes them.
    threads
        Threads to spread groups of runs over; the compiled steps release the interpreter's lock.

    Raises
    ------
    InputError
        For a missing or nonphysical coefficient.
    """
    each = [values] * len(cases) if isinstance(values, Mapping) else list(values)
    if len(each) != len(cases):
        raise ValueError(f"{len(each)} sets of values for {len(cases)} cases; give one for each, or one for all")
    order = sorted(range(len(cases)), key=lambda i: (len(cases[i].mesh.dx), len(cases[i].h)))
    groups = [order[i : i + LANES] for i in range(0, len(order), LANES)]

    for case, own_values in zip(cases, each, strict=True):
        model.check(case, own_values)

    def solve(group: list[int]) -> list[tuple[int, Solution]]:
        own = [(i, model.build(cases[i], each[i])) for i in group]
        linear = [(i, build) for i, build in own if not build.nonlinear]
        outs = _march([cases[i] for i, _ in linear], [build for _, build in linear]) if linear else []
        found = [(i, model.solve(cases[i], each[i])) for i, build in own if build.nonlinear]
        for (i, build), out in zip(linear, outs, strict=True):
            found.append((i, _observe(cases[i], build, each[i], out)))
        return found

    with ThreadPoolExecutor(max(1, threads)) as pool:
        solved = dict(pair for part in pool.map(solve, groups) for pair in part)
    return [solved[i] for i in range(len(cases))]


def _march(cases: list[Case], builds: list[Build]) -> list[Array]:
    """Carry linear runs side by side; return each one's places at its step edges."""
    places = [read_places(case, build) for case, build in zip(cases, builds, strict=True)]
    steps, m = max(len(c.h) for c in cases), max(len(x) for x in places)
    cells, contacts = max(len(c.mesh.dx) for c in cases), max(len(c.layout.interface) for c in cases)
    lanes = Lanes.empty(len(cases), steps, cells, contacts, m)
    for lane, b in enumerate(builds):
        batch_steps.lay_out(Ready(b.stack, b.tangents, b.drive, b.start, places[lane]), lane, lanes)
    out = np.empty((len(cases), steps + 1, m))
    batch_steps.march_lanes(lanes, out)
    return [out[i, : len(c.h) + 1, : len(places[i])] for i, c in enumerate(cases)]


def _observe(case: Case, build: Build, values: Values, out: Array) -> Solution:
    """Apply the measuring chain to one run's places."""
    none = np.empty((0, *out.shape))
    shares, _ = case.row_clock.shares(values)
    return observe(
        case, build, values, out, none, len(case.places), np.empty((0, len(case.mesh.dx))), shares[:, 2]
    )
