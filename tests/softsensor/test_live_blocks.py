"""Scans and the blocks they are taken in by."""

import numpy as np

from softsensor.live.block_steps import Counted
from softsensor.live.blocks import ScanArrays, blocks_of, cut

ALWAYS = (-np.inf, np.inf)
MOMENTS = np.array([0.0, np.nan, 10.0, np.nan, np.nan])


def scans(times, readings):
    """Two faces with one sensor each."""
    kept = ScanArrays(np.array([0, 1]), 2)
    for t, values in zip(times, readings, strict=True):
        kept.append(t, (200.0, 201.0), np.array(values))
    return kept


def test_scans_are_kept_when_the_room_runs_out():
    times = 0.1 * np.arange(3000)
    kept = scans(times, np.column_stack([20.0 + times, 20.0 - times]))
    assert np.array_equal(kept.time, times)
    assert np.allclose(kept.level[:, 0], 20.0 + times)
    assert kept.outside.tolist() == [[200.0, 201.0]] * 3000


def test_scans_are_taken_one_by_one_after_a_switch_and_half_a_second_together_else():
    times = 0.1 * np.arange(300)
    ends, whole = cut(scans(times, np.ones((300, 2))), 0, MOMENTS, 1000)
    assert whole
    steps = np.diff(times[ends])
    late = times[ends][1:]
    eager = (late < 3.95) | ((late > 9.05) & (late < 13.95))
    assert np.allclose(steps[eager & (np.roll(eager, 1))], 0.1)
    calm = (late > 4.6) & (late < 8.9)
    assert np.allclose(steps[calm], 0.5)


def test_cutting_in_parts_cuts_at_the_same_scans():
    kept = scans(0.1 * np.arange(300), np.ones((300, 2)))
    whole, _ = cut(kept, 0, MOMENTS, 1000)
    parts, done, complete = [], 0, False
    while not complete:
        ends, complete = cut(kept, done, MOMENTS, 7)
        parts += ends.tolist()
        done = parts[-1] + 1
    assert parts == whole.tolist()


def test_a_block_holds_the_mean_of_what_was_heard_and_when():
    nan = np.nan
    kept = scans([5.0, 5.1, 5.2, 5.4], [[30.0, nan], [31.0, nan], [nan, nan], [34.0, nan]])
    made = blocks_of(kept.rows, 1, np.array([3]), Counted(*ALWAYS, MOMENTS, False))
    assert np.allclose(made.span, [[5.0, 5.4]])
    assert np.allclose(made.level, [[32.5, nan]], equal_nan=True)
    assert np.isclose(made.moment[0, 0], (5.25 - 5.0) / 0.4)
    assert np.isnan(blocks_of(kept.rows, 1, np.array([3]), Counted(*ALWAYS, MOMENTS, True)).level).all()
    late = blocks_of(kept.rows, 1, np.array([3]), Counted(5.15, np.inf, MOMENTS, False))
    assert np.allclose(late.level, [[34.0, nan]], equal_nan=True)


def test_faces_are_as_late_as_the_last_of_them_begins_to_move_in_the_closed_press():
    times = np.arange(10.0)
    lower, upper = np.where(times < 4.0, 20.0, 120.0), np.where(times < 7.0, 20.0, 120.0)
    assert scans(times, np.column_stack([lower, upper])).late_s(2.5) == 4.5
    assert scans(times, np.column_stack([lower, np.full(10, np.nan)])).late_s(2.5) == 1.5
    assert scans(times, np.full((10, 2), 20.0)).late_s(2.5) == 6.5
    assert scans(times, np.full((10, 2), 20.0)).late_s(np.nan) == 0.0
