"""The lowest point of a function whose slopes nobody knows: the downhill simplex, for a few variables.

Reference: Nelder & Mead, Computer Journal 7:308 (1965), with their reflection 1, expansion 2, contraction and
shrinking 1/2.

Choice (2026-11-24): our own, since a fit needs no more of scipy.optimize, whose import takes 0.19 s of processor
time on a busy machine when all else is loaded; one run is to be fitted in two seconds. It takes the same steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from daq.records import Array

FIRST_EDGE = 0.05
"""Of the first simplex, as a share of the coordinate at the start. (as in MATLAB and scipy)"""
_Corner = tuple[float, Array]
"""The loss at a point, and the point (variables)."""


class _Spent(Exception):
    """As many calls as are allowed were made."""


def lowest_point(loss: Callable[[Array], float], start: Sequence[float], tolerance: float, most: int) -> Array:
    """Return where a function is lowest near `start` (variables, none of them 0).

    It ends where all corners lie within `tolerance` of the best one, in place and in loss, or before the step for
    which `most` calls do not suffice.

    Examples
    --------
    >>> lowest_point(lambda x: (x[0] - 2.0) ** 2 + (x[1] + 1.0) ** 2, (1.0, 1.0), 1e-6, 500).round(3).tolist()
    [2.0, -1.0]
    """
    left = iter(range(most))

    def at(x: Array) -> _Corner:
        if next(left, None) is None:
            raise _Spent
        return loss(x), x

    first = np.array(start)
    corners = [at(first), *(at(first * (1.0 + FIRST_EDGE * row)) for row in np.eye(len(first)))]
    while True:
        corners.sort(key=lambda corner: corner[0])
        low, best = corners[0]
        apart = max(float(np.max(np.abs(x - best))) for _, x in corners)
        if apart <= tolerance and corners[-1][0] - low <= tolerance:
            return best
        try:
            corners = _step(corners, at)
        except _Spent:
            return best


def _step(corners: list[_Corner], at: Callable[[Array], _Corner]) -> list[_Corner]:
    """Return the corners, best first before, with the worst one moved, or all others drawn to the best one."""
    (low, best), (high, worst) = corners[0], corners[-1]
    middle = np.mean([x for _, x in corners[:-1]], axis=0)
    away = middle - worst
    moved = at(middle + away)
    if moved[0] < low:
        moved = min(at(middle + 2.0 * away), moved, key=lambda corner: corner[0])
    elif moved[0] >= corners[-2][0]:
        most = min(moved[0], high)
        moved = at(middle + 0.5 * away) if moved[0] < high else at(middle - 0.5 * away)
        if moved[0] > most:
            return [corners[0], *(at(best + 0.5 * (x - best)) for _, x in corners[1:])]
    return [*corners[:-1], moved]
