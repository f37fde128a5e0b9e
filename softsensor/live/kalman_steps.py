"""The live sensor's Kalman filter in compiled loops: predict over a block, correct by what the faces read.

The states x are the model's parameters in units of their prior's standard deviation (P), lag and footprint of the
measuring chain (2), and each face's constant offset and slow bias (2 M) in K: x ~ N(0, I) but for the last.

    predict    x = F x,  P = F P F' + Q      only the slow biases change: F = keep, Q = FACE_SLOW_K² (1 - keep²)
    update     S = h P h' + R,  K = P h' / S,  x += K (y - h x),  P -= K S K'      one face at a time

Parameters that are *considered* (constants in doubt, model error) are held: readings that cannot separate
them from coefficients must not move them. Their rows of P are 0. What a wrong one does to every other state while
the filter takes it for right is followed beside it, as the matrix E of d(true - estimated state)/d(its own error),
which begins as 1 in its own row (consider covariance; Schmidt 1966; Bierman 1977, ch. VIII):

    predict    E = F E                       update     E -= K (h E)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.compiled import compiled
from softsensor.effects import thermocouple_footprint, thermocouple_lag
from softsensor.live.march_steps import march_span
from softsensor.signals.instrument import CHANNEL_WHITE_K, FACE_SLOW_K, FACE_SLOW_S, ROUNDING_K2

Array = NDArray[np.float64]

# Numbers without another source were set by hand, 2026-11.

ROUGH_S, ROUGH_MEMORY_S = 0.15, 3.0
"""How far the model may be off in time where readings jump, and for how long. [s]"""
JUMP_K = 0.15
"""Innovations where something changes at once (a contact lapses, a door opens). [K]"""
GATE = 4.0
"""Innovations beyond this many standard deviations lose weight."""
LAG_S, FOOTPRINT = thermocouple_lag.EFFECT.scatter_sd, thermocouple_footprint.EFFECT.scatter_sd
"""Prior standard deviation of the two parameters of the measuring chain. [s, -]"""


class StateEstimate(NamedTuple):
    """A Gaussian over the states, and where the model is linearised; mean and covariance change in place."""

    mean: Array
    """(N)"""
    covariance: Array
    """(N, N)"""
    error: Array
    """How far off the states are for one standard deviation of each considered parameter (N, C)."""
    at: Array
    """In prior units (P)."""


@compiled(inner=True)
def predict_biases(estimate, first, keep, variance):
    """Let the slow biases of the faces, states `first` and on, decay and be renewed: P = F P F' + Q."""
    x, P, E = estimate.mean, estimate.covariance, estimate.error
    n = x.shape[0]
    for a in range(first, n):
        x[a] *= keep
        for c in range(E.shape[1]):
            E[a, c] *= keep
        for b in range(n):
            P[a, b] *= keep
        for b in range(n):
            P[b, a] *= keep
        P[a, a] += variance * (1.0 - keep * keep)


@compiled(inner=True, fastmath=True)
def kalman_update(estimate, h, innovation, R, gate):
    """Correct by one reading; beyond `gate` standard deviations it loses weight, beyond twice all.

    How odd it is counts against all that is in doubt, the considered parameters too; what it corrects does not.

    Parameters
    ----------
    h
        Derivative of the reading by the states (N).
    innovation
        Reading minus what was expected. [K]
    R
        Variance of the reading's noise. [K²]

    Returns
    -------
    The log-likelihood and the squared normalised innovation, both bounded by the gate.
    """
    x, P, E = estimate.mean, estimate.covariance, estimate.error
    n, held = E.shape
    Ph, hE = np.empty(n), np.zeros(held)
    S = R
    for a in range(n):
        value = 0.0
        for b in range(n):
            value += P[a, b] * h[b]
        Ph[a] = value
        S += h[a] * value
        for c in range(held):
            hE[c] += h[a] * E[a, c]
    whole = S
    for c in range(held):
        whole += hE[c] * hE[c]
    square = innovation * innovation / whole
    fit = -0.5 * min(square, gate * gate) - 0.5 * math.log(whole)
    if square > gate * gate:
        S *= math.sqrt(square) / gate
    if square > 4.0 * gate * gate:
        S *= math.sqrt(square) / (2.0 * gate)
    move = innovation / S
    for a in range(n):
        x[a] += Ph[a] * move
        K = Ph[a] / S
        for b in range(n):
            P[a, b] -= K * Ph[b]
        for c in range(held):
            E[a, c] -= K * hE[c]
    return fit, square


@compiled(inner=True)
def expected_reading(chain, before, estimate, face, share, h):
    """Return what a face should read in the mean of a block, and fill its derivative `h` by the states (N). [°C]

    `before` is the measuring chain at the block's begin: readings (M) and derivatives (M, Q). `share` is the
    readings' mean time in the block.
    """
    read_before, d_before = before
    x, at = estimate.mean, estimate.at
    m, p, a, u = chain.read.shape[0], at.shape[0], face, share
    value = u * chain.read[a] + (1.0 - u) * read_before[a]
    for q in range(h.shape[0]):
        h[q] = 0.0
    for q in range(p):
        h[q] = u * chain.d_read[a, q] + (1.0 - u) * d_before[a, q]
        value += h[q] * (x[q] - at[q])
    for q in range(2):
        unit = LAG_S if q == 0 else FOOTPRINT
        h[p + q] = unit * (u * chain.d_read[a, p + q] + (1.0 - u) * d_before[a, p + q])
        value += h[p + q] * x[p + q]
    h[p + 2 + a] = 1.0
    h[p + 2 + m + a] = 1.0
    return value + (x[p + 2 + a] + x[p + 2 + m + a])


@compiled(inner=True)
def update_by_faces(chain, before, estimate, blocks, k, score):
    """Correct by what the faces read in block `k`; write into `score` (4) how well that was expected.

    The score: log-likelihood, sum of squared normalised innovations, number of readings, and the logarithm of how
    much likelier the readings are if something changed at once (heavy tails of `JUMP_K`).
    """
    level, elapsed = blocks.level[k], blocks.span[k, 1] - blocks.span[k, 0]
    m = level.shape[0]
    h = np.zeros(estimate.mean.shape[0])
    for part in range(score.shape[0]):
        score[part] = 0.0
    coldest = -1
    for a in range(m):
        if math.isfinite(level[a]) and (coldest < 0 or level[a] < level[coldest]):
            coldest = a
    for a in range(m):
        if not math.isfinite(level[a]):
            continue
        value = expected_reading(chain, before, estimate, a, blocks.moment[k, a], h)
        if elapsed <= 0.0 and (a != coldest or level[a] - value > 1.0):
            continue  # the first scan of a run may lie at the insertion, when a face is already warming
        slope = (chain.read[a] - before[0][a]) / elapsed if elapsed > 0.0 else 0.0
        rough = ROUGH_S * slope
        noise = CHANNEL_WHITE_K**2 / max(blocks.votes[k, a], 0.2) + ROUNDING_K2
        noise += rough * rough * max(1.0, ROUGH_MEMORY_S / max(elapsed, 0.02))
        fit, square = kalman_update(estimate, h, level[a] - value, noise, GATE)
        wide = (level[a] - value) / JUMP_K
        log_spread = -2.0 * (fit + 0.5 * min(square, GATE * GATE))
        score[0] += fit
        score[1] += min(square, 25.0)
        score[2] += 1.0
        score[3] += 0.5 * min(square, 200.0) + 0.5 * log_spread - math.log(1.25 * JUMP_K * (1.0 + wide * wide))


@compiled()
def filter_blocks(model, timing, estimate, blocks, scores):
    """March over blocks of scans and correct by what the faces read; `scores` (K, 4) as in `update_by_faces`."""
    chain = model.chain
    for k in range(blocks.span.shape[0]):
        elapsed = blocks.span[k, 1] - blocks.span[k, 0]
        before = chain.read.copy(), chain.d_read.copy()
        if elapsed > 0.0:
            march_span(model, timing, blocks.span[k], blocks.outside[k])
            first = estimate.mean.shape[0] - chain.read.shape[0]
            predict_biases(estimate, first, math.exp(-elapsed / FACE_SLOW_S), FACE_SLOW_K * FACE_SLOW_K)
        update_by_faces(chain, before, estimate, blocks, k, scores[k])
