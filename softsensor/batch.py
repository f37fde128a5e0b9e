"""Many runs at once: the same model solved for a list of cases, several runs side by side in one kernel.

For questions to the model alone, such as a window of press times (``deploy/examples/press_window``) or the spread
of coefficients. Fits need sensitivities with every run and solve run by run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from daq.records import Array
from softsensor import kernels_batch
from softsensor.case import Case
from softsensor.kernels_batch import LANES, SPAN
from softsensor.model import Build, Solution, ThermalModel, observe, read_places

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
        Threads to spread groups of runs over; the kernels release the interpreter's lock.

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
    runs, steps = len(cases), max(len(c.h) for c in cases)
    n, contacts = max(len(c.mesh.dx) for c in cases), max(len(c.layout.interface) for c in cases)
    places = [read_places(case, build) for case, build in zip(cases, builds, strict=True)]
    m = max(len(x) for x in places)
    h, outer = np.empty((steps, runs)), np.empty((steps, 4, runs))
    group, reach = np.empty((steps, runs), dtype=np.int64), np.ones(LANES, dtype=np.int64)
    joints = np.empty((runs, contacts), dtype=np.int64)
    joint, ends = np.empty((runs, steps, contacts, 3)), np.empty((runs, steps, 4))
    cap, g, diag, t = np.ones((n, LANES)), np.zeros((n, LANES)), np.zeros((n, LANES)), np.zeros((n, LANES))
    first, weights = np.zeros((runs, m), dtype=np.int64), np.zeros((runs, m, SPAN))
    for lane, build in enumerate(builds):
        kernels_batch.lay_out(
            build.stack, build.tangents, build.drive, build.start, places[lane], lane,
            h, group, outer, joints, joint, ends, cap, g, diag, t, reach, first, weights,
        )  # fmt: skip
    ambient = np.array([case.ambient for case in cases])
    out = np.empty((runs, steps + 1, m))
    kernels_batch.march_lanes(
        h, group, outer, joints, joint, ends, cap, g, diag, t, reach, first, weights, ambient, out
    )
    return [out[i, : len(c.h) + 1, : len(places[i])] for i, c in enumerate(cases)]


def _observe(case: Case, build: Build, values: Values, out: Array) -> Solution:
    """Apply the measuring chain to one run's places."""
    none = np.empty((0, *out.shape))
    shares, _ = case.row_clock.shares(values)
    return observe(
        case, build, values, out, none, len(case.places), np.empty((0, len(case.mesh.dx))), shares[:, 2]
    )
