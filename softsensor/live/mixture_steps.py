"""The live sensor's Gaussian mixture in compiled loops: hypotheses read off state estimates, and pooled.

A filter's joint Gaussian takes every suspected cause as N(0, 1): at work. A hypothesis narrows all causes but its
own to N(absent, width²). For Gaussians that is exact, and the ratio of the densities at `absent` is the evidence
(Savage-Dickey; Dickey 1971, Ann. Math. Stat. 42, 204).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.compiled import compiled
from softsensor.signals.unknown import CENTRAL

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
TRUST = 0.1
"""Share of a log-likelihood that counts between causes (a power posterior). Their laws, and the linear answers to
them, are off for seconds on end, so that blocks of 0.45 s are not independent: taken in full, one pressing
would be sure of one cause now and of another a minute later, with a narrow band about each. Set on virtual
campaigns of the seeds 41000 to 41153; 0.03 to 0.3 do about as well."""
SHAPE_SHARE, SHAPE_K = 0.45, 4.5
"""What a suspected cause does to the core is known to this share only, for its law may be another; and to so much
at worst. Set by hand, 2026-11. [-, K]"""


class Hypotheses(NamedTuple):
    """Suspected causes that are states of a filter (E), and what the hypotheses are given beforehand."""

    column: Integers
    """The state of each (E)."""
    absent: Array
    """Where it lies if the cause is absent (E)."""
    width: Array
    """And how closely (E)."""
    one_sided: NDArray[np.bool_]
    """Whether it can only lie above `absent` (E)."""
    log_prior: Array
    """"No cause", then each cause (E + 1)."""


class Components(NamedTuple):
    """A mixture of normals; changed in place."""

    weight: Array
    """Unnormalised logarithm; after `pool` the share."""
    mean: Array
    variance: Array


class Change(NamedTuple):
    """That something has changed at once; the last two components are for it: the panel is what it was, or not."""

    chance: float
    core: float
    """What the faces alone say then, NaN where all hypotheses together say it. [°C]"""
    variance: float
    """[K²]"""
    other_panel: float
    """Chance that the panel itself has changed."""
    other_K: float  # noqa: N815
    """And what that adds to the standard deviation. [K]"""


class Causes(NamedTuple):
    """What one filter knows of its suspected causes (E)."""

    mean: Array
    """Jointly with all else (E)."""
    precision: Array
    """(E, E)"""
    still: Array
    """Mean if none is at work (E)."""
    inner: Array
    """Covariance if none is at work (E, E)."""
    evidence: float
    """Log-evidence of that against the joint estimate."""


# Loops below, not Numba's `inv`, `@` and lists of indices: these take several times as long to compile.


@compiled(inner=True)
def _times(matrix, vector):
    """Return a matrix (E, E) times a vector (E)."""
    out = np.empty(vector.shape[0])
    for i in range(out.shape[0]):
        total = 0.0
        for j in range(out.shape[0]):
            total += matrix[i, j] * vector[j]
        out[i] = total
    return out


@compiled(inner=True)
def _invert(matrix):
    """Overwrite a positive definite matrix (E, E) by its inverse; return the logarithm of its determinant."""
    n, log = matrix.shape[0], 0.0
    for k in range(n):
        pivot = matrix[k, k]
        log += math.log(pivot)
        matrix[k, k] = 1.0
        for j in range(n):
            matrix[k, j] /= pivot
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(n):
                    matrix[i, j] -= factor * matrix[k, j]
    return log


@compiled(inner=True)
def _causes(estimate, hypotheses):
    """Return what is known of the causes, jointly and if none is at work."""
    column, width, absent = hypotheses.column, hypotheses.width, hypotheses.absent
    e = column.shape[0]
    mean, precision, inner = np.empty(e), np.empty((e, e)), np.empty((e, e))
    for i in range(e):
        mean[i] = estimate.mean[column[i]]
        for j in range(e):
            precision[i, j] = estimate.covariance[column[i], column[j]]
        precision[i, i] += 1e-12
    evidence = -0.5 * _invert(precision)
    pull = _times(precision, mean)
    for i in range(e):
        evidence -= 0.5 * mean[i] * pull[i] + math.log(width[i]) + 0.5 * (absent[i] / width[i]) ** 2
        pull[i] += absent[i] / (width[i] * width[i])
        for j in range(e):
            inner[i, j] = precision[i, j]
        inner[i, i] += 1.0 / (width[i] * width[i]) - 1.0
    evidence -= 0.5 * _invert(inner)
    still = _times(inner, pull)
    for i in range(e):
        evidence += 0.5 * pull[i] * still[i]
    return Causes(mean, precision, still, inner, evidence)


@compiled(inner=True)
def _lever(estimate, column, causes, readout):
    """Return how one linear function of the states goes with the causes (E), and its variance."""
    cross, variance = np.zeros(column.shape[0]), 0.0
    for a in range(readout.shape[0]):
        for b in range(readout.shape[0]):
            variance += readout[a] * estimate.covariance[a, b] * readout[b]
        for j in range(column.shape[0]):
            cross[j] += estimate.covariance[column[j], a] * readout[a]
    slope = _times(causes.precision, cross)
    for j in range(column.shape[0]):
        variance -= cross[j] * slope[j]
    return slope, variance


@compiled(inner=True)
def condition(estimate, readout, hypotheses, out):
    """Write what each hypothesis says of one linear function of the states.

    Parameters
    ----------
    readout
        Derivative of what is asked for by the first states; by the others it is 0.
    out
        Gets its shift from the joint mean, its variance, and the log-evidence against the joint estimate (E + 1).

    Returns
    -------
    How far off it is for each considered parameter (C) if no suspected cause is at work.
    """
    column, causes = hypotheses.column, _causes(estimate, hypotheses)
    slope, variance = _lever(estimate, column, causes, readout)
    carried, plain = _times(causes.inner, slope), 0.0
    for j in range(column.shape[0]):
        plain += slope[j] * (causes.still[j] - causes.mean[j])
        variance += slope[j] * carried[j]
    out.mean[0], out.variance[0], out.weight[0] = plain, max(variance, 1e-12), causes.evidence
    for j in range(column.shape[0]):
        shift, added, evidence = _released(hypotheses, j, causes.inner[j, j], causes.still[j], carried[j])
        out.mean[1 + j] = plain + shift
        out.variance[1 + j] = max(variance + added, 1e-12)
        out.weight[1 + j] = causes.evidence + evidence
    return _held(estimate.error, column, causes, readout, slope)


@compiled(inner=True)
def _held(error, column, causes, readout, slope):
    """Return how far off a linear function is for each considered parameter (C) if no cause is at work."""
    held, own = np.zeros(error.shape[1]), np.empty(column.shape[0])
    for c in range(held.shape[0]):
        for a in range(readout.shape[0]):
            held[c] += readout[a] * error[a, c]
        for j in range(own.shape[0]):
            own[j] = error[column[j], c]
        still = _times(causes.inner, _times(causes.precision, own))
        for j in range(own.shape[0]):
            held[c] += slope[j] * (still[j] - own[j])
    return held


@compiled(inner=True)
def _released(hypotheses, j, own, still, carried):
    """Return what changes where cause `j` is at work: shift, variance and log-evidence beside "no cause".

    `own` and `still` are its variance and mean while it is narrowed, `carried` how what is asked for goes with it.
    """
    absent, width = hypotheses.absent[j], hypotheses.width[j]
    s = 1.0 / (width * width) - 1.0
    t = absent / (width * width)
    d = 1.0 - s * own
    f = s / d
    lift = f * (still - t * own) - t
    size = still + own * lift
    spread = own * (1.0 + f * own)
    evidence = math.log(width) + 0.5 * (absent / width) ** 2
    evidence += 0.5 * (lift * still - t * size) - 0.5 * math.log(d)
    shift = carried * lift
    added = f * carried * carried
    if hypotheses.one_sided[j]:
        root = math.sqrt(spread)
        mass, push, shrink = _half_normal((size - absent) / root)
        evidence += mass - _half_normal(-absent)[0]
        lever = carried * (1.0 + f * own) / spread
        shift += lever * root * push
        added += lever * lever * spread * (shrink - 1.0)
    return shift, added, evidence


@compiled(inner=True)
def _half_normal(z):
    """Log mass, mean shift and variance factor of N(z, 1) cut at 0, in units of its deviation."""
    if z < -6.0:
        mass = -0.5 * z * z - math.log(-z) - 0.5 * math.log(2.0 * math.pi)
        ratio = -z + 1.0 / (-z)
    else:
        share = 0.5 * math.erfc(-z / math.sqrt(2.0))
        mass = math.log(share)
        ratio = math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi) / share
    return mass, ratio, max(1.0 - z * ratio - ratio * ratio, 1e-3)


@compiled()
def quantile(weights, means, sds, share):
    """Return the `share` quantile of a mixture of normals."""
    low, high = math.inf, -math.inf
    for j in range(weights.shape[0]):
        if weights[j] > 1e-9:
            reach = 8.0 * sds[j]
            low = min(low, means[j] - reach)
            high = max(high, means[j] + reach)
    for _ in range(40):
        middle = 0.5 * (low + high)
        total = 0.0
        for j in range(weights.shape[0]):
            if weights[j] > 1e-9:
                total += weights[j] * 0.5 * math.erfc((means[j] - middle) / (sds[j] * math.sqrt(2.0)))
        if total < share:
            low = middle
        else:
            high = middle
        if high - low < 1e-3:
            break
    return 0.5 * (low + high)


@compiled()
def held(estimate, chain, hypotheses):
    """Return how far off the core is for each considered parameter (C) if no suspected cause is at work. [K]"""
    causes = _causes(estimate, hypotheses)
    slope, _ = _lever(estimate, hypotheses.column, causes, chain.d_level)
    return _held(estimate.error, hypotheses.column, causes, chain.d_level, slope)


@compiled()
def weigh(estimate, chain, hypotheses, fit, plain, out):
    """Write what one filter's hypotheses say about the core: log-weight, mean [°C] and variance [K²] (E + 1).

    Parameters
    ----------
    fit
        The filter's log-likelihood.
    plain
        What the first filter's first hypothesis says, from where a cause's law is in doubt; NaN: this is that one.

    Returns
    -------
    The same, a number now [°C], and how far off the core is for each considered parameter (C), as in `held` [K].
    """
    away = condition(estimate, chain.d_level, hypotheses, out)
    centre = chain.level[0]
    for i in range(chain.d_level.shape[0]):
        centre += chain.d_level[i] * (estimate.mean[i] - estimate.at[i])
    for j in range(out.mean.shape[0]):
        out.weight[j] = hypotheses.log_prior[j] + TRUST * (out.weight[j] + fit)
        out.mean[j] += centre
        if j == 0 and math.isnan(plain):
            plain = out.mean[0]
        out.variance[j] += min(SHAPE_SHARE * abs(out.mean[j] - plain), SHAPE_K) ** 2
    return plain, away


@compiled()
def pool(components, change):
    """Make one mixture of all hypotheses: log-weights become shares.

    Returns
    -------
    What they expect together, the root mean square distance from it, and the bounds of 95 %. [°C, K, °C, °C]
    """
    log, means, variances = components
    n = log.shape[0] - (2 if change.chance > 0.0 else 0)
    highest, total = log[0], 0.0
    for j in range(1, n):
        highest = max(highest, log[j])
    for j in range(n):
        log[j] = math.exp(log[j] - highest)
        total += log[j]
    expected = 0.0
    for j in range(n):
        log[j] /= total
        expected += log[j] * means[j]
    if change.chance > 0.0:
        centre, variance = change.core, change.variance
        if math.isnan(centre):
            centre, variance = expected, 0.0
            for j in range(n):
                variance += log[j] * (variances[j] + (means[j] - expected) ** 2)
        expected += change.chance * (centre - expected)
        for j in range(n):
            log[j] *= 1.0 - change.chance
        log[n], log[n + 1] = change.chance * (1.0 - change.other_panel), change.chance * change.other_panel
        means[n] = means[n + 1] = centre
        variances[n], variances[n + 1] = variance, variance + change.other_K**2
    square, sds = 0.0, np.empty(log.shape[0])
    for j in range(log.shape[0]):
        square += log[j] * (variances[j] + (means[j] - expected) ** 2)
        sds[j] = math.sqrt(variances[j])
    low, high = quantile(log, means, sds, CENTRAL[0]), quantile(log, means, sds, CENTRAL[1])
    return expected, math.sqrt(square), min(low, expected), max(high, expected)


@compiled()
def without_causes(estimate, hypotheses):
    """Return the mean of all states (N) if no suspected cause is at work."""
    causes = _causes(estimate, hypotheses)
    return _moved(estimate, hypotheses.column, causes, np.zeros(causes.mean.shape[0]))


@compiled(inner=True)
def _moved(estimate, column, causes, pushed):
    """Return the mean of all states (N) where the causes are moved from none at work by inner @ `pushed` (E)."""
    states, move = estimate.mean.copy(), _times(causes.inner, pushed)
    for j in range(column.shape[0]):
        move[j] += causes.still[j] - causes.mean[j]
    move = _times(causes.precision, move)
    for a in range(states.shape[0]):
        for j in range(column.shape[0]):
            states[a] += estimate.covariance[a, column[j]] * move[j]
    return states


@compiled()
def cells(estimate, hypotheses, shares, state):
    """Return the cells' temperatures (n) as one filter's hypotheses expect them, `shares` of them (E + 1). [°C]"""
    causes, pushed = _causes(estimate, hypotheses), np.empty(hypotheses.column.shape[0])
    for j in range(pushed.shape[0]):
        shift, _, _ = _released(hypotheses, j, causes.inner[j, j], causes.still[j], 1.0)
        pushed[j] = shares[1 + j] * shift
    states, t = _moved(estimate, hypotheses.column, causes, pushed), state.t.copy()
    for q in range(estimate.at.shape[0]):
        for i in range(t.shape[0]):
            t[i] += (states[q] - estimate.at[q]) * state.s[q, i]
    return t
