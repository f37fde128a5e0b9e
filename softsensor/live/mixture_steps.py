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


@compiled()
def condition(estimate, readout, hypotheses, out):
    """Write what each hypothesis says of one linear function of the states.

    Parameters
    ----------
    readout
        Derivative of what is asked for by all states (N).
    out
        Gets its shift from the joint mean, its variance, and the log-evidence against the joint estimate (E + 1).
    """
    column, width = hypotheses.column, hypotheses.width
    e, to_all = column.shape[0], estimate.covariance @ readout
    variance = readout @ to_all
    if e == 0:
        out.mean[0], out.variance[0], out.weight[0] = 0.0, variance, 0.0
        return
    mean, precision, narrow, pull = _causes(estimate, hypotheses)
    cross = to_all[column]
    slope = precision @ cross
    inner = np.linalg.inv(narrow)
    still = inner @ pull
    base = 0.5 * (log_determinant(precision) - mean @ (precision @ mean))
    base -= (np.log(width) + 0.5 * (hypotheses.absent / width) ** 2).sum()
    base += 0.5 * (pull @ still - log_determinant(narrow))
    carried = inner @ slope
    plain, spread = slope @ (still - mean), variance - cross @ slope + slope @ carried
    out.mean[0], out.variance[0], out.weight[0] = plain, max(spread, 1e-12), base
    for j in range(e):
        shift, added, evidence = _released(hypotheses, j, inner[j, j], still[j], carried[j])
        out.mean[1 + j] = plain + shift
        out.variance[1 + j] = max(spread + added, 1e-12)
        out.weight[1 + j] = base + evidence


@compiled(inner=True)
def log_determinant(matrix):
    """Return the logarithm of the determinant of a positive definite matrix (n, n), by Cholesky's factors.

    Written out: Numba's own function takes a tenth as long again to compile as all else that is here.
    """
    n = matrix.shape[0]
    factor, found = np.zeros((n, n)), 0.0
    for i in range(n):
        for j in range(i + 1):
            left = matrix[i, j]
            for k in range(j):
                left -= factor[i, k] * factor[j, k]
            factor[i, j] = math.sqrt(left) if i == j else left / factor[j, j]
        found += 2.0 * math.log(factor[i, i])
    return found


@compiled(inner=True)
def _causes(estimate, hypotheses):
    """Return the causes' mean and precision, and their precision and information vector if none is at work."""
    column, precise = hypotheses.column, hypotheses.width**-2.0
    mean = estimate.mean[column]
    precision = np.linalg.inv(estimate.covariance[column][:, column] + 1e-12 * np.eye(column.shape[0]))
    narrow = precision + np.diag(precise - 1.0)
    return mean, precision, narrow, precision @ mean + hypotheses.absent * precise


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
    low, high = 1e30, -1e30
    for j in range(weights.shape[0]):
        if weights[j] > 1e-9:
            low = min(low, means[j] - 8.0 * sds[j])
            high = max(high, means[j] + 8.0 * sds[j])
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
    p = estimate.at.shape[0]
    return chain.d_level @ _without_causes(estimate, hypotheses, estimate.error, 0.0)[:p]


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
    p, e = estimate.at.shape[0], hypotheses.column.shape[0]
    readout = np.zeros(estimate.mean.shape[0])
    for i in range(p):
        readout[i] = chain.d_level[i]
    condition(estimate, readout, hypotheses, out)
    centre = chain.level[0] + chain.d_level @ (estimate.mean[:p] - estimate.at)
    for j in range(e + 1):
        out.weight[j] = hypotheses.log_prior[j] + TRUST * (out.weight[j] + fit)
        out.mean[j] += centre
        if j == 0 and math.isnan(plain):
            plain = out.mean[0]
        out.variance[j] += min(SHAPE_SHARE * abs(out.mean[j] - plain), SHAPE_K) ** 2
    return plain, held(estimate, chain, hypotheses)


@compiled()
def pool(components, change):
    """Make one mixture of all hypotheses: log-weights become shares.

    Returns
    -------
    What they expect together, the root mean square distance from it, and the bounds of 95 %. [°C, K, °C, °C]
    """
    log, means, variances = components
    n = log.shape[0] - (2 if change.chance > 0.0 else 0)
    highest, total = log[:n].max(), 0.0
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
        means[n:] = centre
        variances[n], variances[n + 1] = variance, variance + change.other_K**2
    square = 0.0
    for j in range(log.shape[0]):
        square += log[j] * (variances[j] + (means[j] - expected) ** 2)
    sds = np.sqrt(variances)
    low, high = quantile(log, means, sds, CENTRAL[0]), quantile(log, means, sds, CENTRAL[1])
    return expected, math.sqrt(square), min(low, expected), max(high, expected)


@compiled()
def without_causes(estimate, hypotheses):
    """Return the mean of all states (N) if no suspected cause is at work."""
    return _without_causes(estimate, hypotheses, estimate.mean.reshape(-1, 1), 1.0)[:, 0]


@compiled(inner=True)
def _without_causes(estimate, hypotheses, states, known):
    """Return series of all states (N, S) if no suspected cause is at work: means (`known` 1) or errors (0)."""
    column = hypotheses.column
    if column.shape[0] == 0:
        return states.copy()
    _, precision, narrow, _ = _causes(estimate, hypotheses)
    pull = precision @ states[column]
    pull += (known * hypotheses.absent / hypotheses.width**2).reshape(-1, 1)
    return states + estimate.covariance[:, column] @ (precision @ (np.linalg.inv(narrow) @ pull - states[column]))


@compiled()
def cells(estimate, hypotheses, shares, state):
    """Return the cells' temperatures (n) as one filter's hypotheses expect them, `shares` of them (E + 1). [°C]"""
    p, column = estimate.at.shape[0], hypotheses.column
    states = estimate.mean.copy()
    if column.shape[0] > 0:
        mean, precision, narrow, pull = _causes(estimate, hypotheses)
        inner = np.linalg.inv(narrow)
        still, sizes = inner @ pull, np.empty(column.shape[0])
        for j in range(column.shape[0]):
            shift, _, _ = _released(hypotheses, j, inner[j, j], still[j], 1.0)
            sizes[j] = shares[1 + j] * shift
        states += estimate.covariance[:, column] @ (precision @ (still - mean + inner @ sizes))
    return state.t + (states[:p] - estimate.at) @ state.s[:p]
