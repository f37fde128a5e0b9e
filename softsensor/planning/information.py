"""What runs that were not pressed would show: the algebra, closed in form.

A run of n like it says about shared numbers x, its own numbers solved for, with information H about them in each
run and P known before:

    covariance of x after n runs          C_n = inv(P + n H)

Between two causes, where the first holds: r is what it makes of a run's readings less what the second expects,
whitened, less what the run's own numbers can take up. The shared numbers of the second, known to P, then take up
what they can, the same in all n runs (g: the shared numbers' derivatives times r):

    E_n = n r'r - n² g' C_n g             by which the second fits worse, in twice the logarithm of odds

so that it is normal with mean E and variance 4 E. What lies in the shared numbers' reach saturates with n: more of
the same decides nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from daq.records import Array
from softsensor.fitting.experiment_advice import MANY
from softsensor.signals.unknown import ALPHA

# Numbers without another source were set by hand, 2026-11.

ODDS = 1.0 / ALPHA
"""That a suspected cause is there at all is settled at odds of so many to one: 5 % wrong, as in its tests."""
DRAWS, SEED = 400, 24
"""Of runs not pressed, the same for all pressings: a chance near 80 % is good to 2 %. Any seed does."""
WANTED_CHANCE = 0.8
"""Runs are counted until the matter is settled with this chance: the conventional power of a planned experiment
(Perugini, Gallucci & Costantini, Int. Rev. Soc. Psychol. 31 (2018) 20, doi 10.5334/irsp.181)."""


@dataclass(frozen=True)
class RunInformation:
    """What one run says about shared numbers x, its own numbers solved for."""

    information: Array
    """H (x, x)."""
    pull: Array
    """g: derivatives times what is left of the difference between two causes (x); zero where there is none."""
    left: float = 0.0
    """r'r: what is left of the difference, squared."""


def covariance_after(before: Array, run: RunInformation, runs: int) -> Array:
    """Return the covariance of the shared numbers after so many runs like one, on top of a precision `before`.

    Examples
    --------
    A number known to 0.2 and seen to 0.2 in a run is known to 0.1 after three:

    >>> one = RunInformation(np.array([[25.0]]), np.zeros(1))
    >>> float(covariance_after(np.array([[25.0]]), one, 3)[0, 0])
    0.01
    """
    return pseudo_inverse(before + runs * run.information)


def pseudo_inverse(precision: Array) -> Array:
    """Return the covariance (n, n) that a precision leaves, 0 along what it says nothing of."""
    return np.asarray(np.linalg.pinv(precision, hermitian=True), dtype=np.float64)


def evidence(before: Array, run: RunInformation, runs: int) -> float:
    """Return by how much the wrong cause would fit worse after so many runs (E_n of the module's head)."""
    taken_up = float(run.pull @ covariance_after(before, run, runs) @ run.pull)
    return max(runs * run.left - runs**2 * taken_up, 0.0)


@cache
def _noise(stream: int) -> Array:
    return np.random.default_rng([SEED, stream]).standard_normal((DRAWS, MANY))


def further_runs(so_far: Array, expected: float, runs: int, stream: int) -> Array:
    """Return by how much a wrong cause fits worse in each run, those so far and drawn ones (draws, runs).

    Parameters
    ----------
    so_far
        In each run so far (n).
    expected
        In all further ones together (E of the module's head).
    runs
        Of these.
    stream
        Draws of another number are independent.
    """
    each = expected / runs
    drawn = each + 2.0 * math.sqrt(each) * _noise(stream)[:, :runs]
    return np.hstack([np.broadcast_to(so_far, (DRAWS, len(so_far))), drawn])


def runs_needed(settled: Callable[[int], bool]) -> int | None:
    """Return the least number of runs for which something holds; None where more than `MANY`."""
    return next((n for n in range(1, MANY + 1) if settled(n)), None)
