"""What the archive of format 1 was made from; its files beside this were written by that version, 2026-11."""

import math

import numpy as np

from daq.store.archive_file import StoredScans
from daq.store.estimate_file import EstimateRow

CHANNELS = {3: ["top_1", "top_2", "own step", "any"], 5: ["top_1"]}


def scans():
    """Return scans of two layouts: tenths, sums, a device's own steps, any doubles, gaps, faults, remarks."""
    n = 60
    rng = np.random.default_rng(11)
    tenths = np.rint(10 * (20 + 60 * (1 - np.exp(-np.arange(n) / 20))) + rng.normal(0, 0.5, n))
    first = np.column_stack(
        [tenths / 10, tenths * 0.1 - 0.423, np.rint(tenths * 3.2) * (1370 / 32767), tenths + rng.normal(0, 1, n)]
    )[:50]
    first[7, 1] = math.nan
    monotonic_s = np.round(500.0 + np.arange(n) / 10 + rng.normal(0, 1e-3, n), 6)
    unix_s = np.round((1.7e9 + monotonic_s) * 1e6) / 1e6
    faults = tuple('{"top_2":"open"}' if i == 7 else None for i in range(n))
    remarks = tuple('{"note":"door"}' if i == 9 else None for i in range(n))
    layout = np.array([3] * 50 + [5] * 10)
    values = {3: first, 5: tenths[50:, None] / 10}
    return StoredScans(np.arange(7, 7 + n), unix_s, monotonic_s, layout, values, faults, remarks)


def estimates():
    """Return what a live sensor said, with and without a core."""
    core = [None if i % 3 == 0 else 20.0 + math.sqrt(i) for i in range(12)]
    return [
        EstimateRow(7 + i, 500.0 + i / 10, "closed", *_about(c), "", "v1", c and '{"energy_kJ_m2":1.5}')
        for i, c in enumerate(core)
    ]


def _about(core):
    return (None, None, None, None, 0) if core is None else (core, 0.5, core - 1, core + 1, 1)
