"""Many runs at once: the same model solved for a list of cases, several runs side by side in one kernel.

For questions to the model alone, such as a window of press times (``deploy/examples/press_window``) or the spread
of coefficients. Fits need sensitivities with every run and solve run by run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from softsensor.heat import batch_steps
from softsensor.heat.batch_steps import LANES, Lanes, Ready
from softsensor.heat.build import Build
from softsensor.heat.case import Case
from softsensor.heat.chain import Solution, observe, read_places
from softsensor.heat.implicit_steps import Record, empty_record
from softsensor.heat.model import ThermalModel

Values = Mapping[str, float]
Each = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
"""Does some work for each of several things and returns the results in order, as `map` does."""


def solve_many(
    model: ThermalModel, cases: Sequence[Case], values: Values | Sequence[Values], each: Each = map
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
    each
        Does the work for each group of runs, as `map` does; a thread pool's does it on several cores, for the
        compiled steps release the interpreter's lock.

    Raises
    ------
    InputError
        For a missing or nonphysical coefficient.
    """
    own_values = [values] * len(cases) if isinstance(values, Mapping) else list(values)
    if len(own_values) != len(cases):
        raise ValueError(
            f"{len(own_values)} sets of values for {len(cases)} cases; give one for each, or one for all"
        )
    order = sorted(range(len(cases)), key=lambda i: (len(cases[i].mesh.dx), len(cases[i].h)))
    groups = [order[i : i + LANES] for i in range(0, len(order), LANES)]

    for case, given in zip(cases, own_values, strict=True):
        model.check(case, given)

    def solve(group: list[int]) -> list[tuple[int, Solution]]:
        own = [(i, model.build(cases[i], own_values[i])) for i in group]
        linear = [(i, build) for i, build in own if not build.nonlinear]
        records = _march([cases[i] for i, _ in linear], [build for _, build in linear]) if linear else []
        found = [(i, model.solve(cases[i], own_values[i])) for i, build in own if build.nonlinear]
        return found + [
            (i, observe(cases[i], build, record)) for (i, build), record in zip(linear, records, strict=True)
        ]

    solved = dict(pair for part in each(solve, groups) for pair in part)
    return [solved[i] for i in range(len(cases))]


def _march(cases: list[Case], builds: list[Build]) -> list[Record]:
    """Carry linear runs side by side; return what is read of each at its step edges."""
    places = [read_places(case, build) for case, build in zip(cases, builds, strict=True)]
    steps, m = max(len(c.h) for c in cases), max(len(x) for x in places)
    cells, contacts = max(len(c.mesh.dx) for c in cases), max(len(c.layout.interface) for c in cases)
    lanes = Lanes.empty(len(cases), steps, cells, contacts, m)
    for lane, b in enumerate(builds):
        batch_steps.fill_lane(Ready(b.stack, b.tangents, b.drive, b.start, places[lane]), lane, lanes)
    out = np.empty((len(cases), steps + 1, m))
    batch_steps.march_lanes(lanes, out)
    return [
        empty_record(x, len(c.h), 0, whole=False)._replace(out=out[i, : len(c.h) + 1, : len(x)])
        for i, (c, x) in enumerate(zip(cases, places, strict=True))
    ]
