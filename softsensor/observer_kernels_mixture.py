"""The live sensor's compiled loops that read off beliefs: one mixture of all filters, and the panel inside."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from softsensor import observer_kernels as loops
from softsensor.kernels_terms import properties

_NODES, _SHARES = np.polynomial.legendre.leggauss(4)


@njit(cache=True)
def weigh(
    x, cov, at, core, d_core, where, absent, spikes, one_sided, chances, fit, shape, told, log, means, variances
):
    """Write what one filter's hypotheses say about the core, as `observer_kernels.blend` splits its belief.

    Parameters
    ----------
    at, core, d_core
        Where the filter is linearised (P), the core there [°C], and how it answers (P).
    chances
        Logarithm of what each hypothesis is given beforehand (E + 1).
    fit
        The filter's log-likelihood, and the share of such a logarithm that counts.
    shape
        Share of a departure from what is told that is not known, and its most. [-, K]
    told
        What is told; NaN: what the first hypothesis says. [°C]
    log, means, variances
        Get unnormalised log-weight, mean [°C] and variance [K²] of each hypothesis (E + 1).

    Returns
    -------
    What is told. [°C]
    """
    p, e = at.shape[0], where.shape[0]
    readout = np.zeros(x.shape[0])
    readout[:p] = d_core
    loops.blend(x, cov, readout, where, absent, spikes, one_sided, means, variances, log, np.empty(e))
    centre = core + d_core @ (x[:p] - at)
    for j in range(e + 1):
        log[j] = chances[j] + fit[1] * (log[j] + fit[0])
        means[j] += centre
        if j == 0 and told != told:
            told = means[0]
        variances[j] += min(shape[0] * abs(means[j] - told), shape[1]) ** 2
    return told


@njit(cache=True)
def pool(log, means, variances, told, most, share, core, doubt):
    """Make one mixture of all hypotheses; `log` becomes their weights, `variances` their standard deviations.

    Parameters
    ----------
    most
        How far what is told may lie from what is expected. [K]
    share
        Chance that something has changed at once. If it is not 0, the last two hypotheses are that: the panel
        is what it was, or it is not.
    core
        What the faces alone say then: mean and variance; NaN where all hypotheses together say it. [°C, K²]
    doubt
        Chance of the last hypothesis, and what it adds to the standard deviation. [-, K]

    Returns
    -------
    What is told, the root mean square distance from it, and the bounds of 95 %. [°C, K, °C, °C]
    """
    n = log.shape[0] - (2 if share > 0.0 else 0)
    highest, total = log[:n].max(), 0.0
    for j in range(n):
        log[j] = math.exp(log[j] - highest)
        total += log[j]
    expected = 0.0
    for j in range(n):
        log[j] /= total
        expected += log[j] * means[j]
    told = min(max(told, expected - most), expected + most)
    if share > 0.0:
        centre, variance = core
        if centre != centre:
            centre, variance = expected, 0.0
            for j in range(n):
                variance += log[j] * (variances[j] + (means[j] - expected) ** 2)
        told += share * (centre - told)
        for j in range(n):
            log[j] *= 1.0 - share
        log[n], log[n + 1] = share * (1.0 - doubt[0]), share * doubt[0]
        means[n:] = centre
        variances[n], variances[n + 1] = variance, variance + doubt[1] ** 2
    square = 0.0
    for j in range(log.shape[0]):
        square += log[j] * (variances[j] + (means[j] - told) ** 2)
        variances[j] = math.sqrt(variances[j])
    low, high = loops.quantile(log, means, variances, 0.025), loops.quantile(log, means, variances, 0.975)
    return told, math.sqrt(square), min(low, told), max(high, told)


@njit(cache=True)
def unburdened(x, cov, where, absent, spikes):
    """Return the mean of all states (N) if no suspect is at work; arguments as in `observer_kernels.blend`."""
    e = where.shape[0]
    if e == 0:
        return x.copy()
    own, lever, mean = np.empty((e, e)), np.empty((x.shape[0], e)), np.empty(e)
    for a in range(e):
        mean[a] = x[where[a]]
        lever[:, a] = cov[:, where[a]]
        for b in range(e):
            own[a, b] = cov[where[a], where[b]]
        own[a, a] += 1e-12
    precision = np.linalg.solve(own, np.eye(e))
    pull, narrow = precision @ mean, precision.copy()
    for a in range(e):
        pull[a] += absent[a] / spikes[a] ** 2
        narrow[a, a] += 1.0 / spikes[a] ** 2 - 1.0
    return x + lever @ (precision @ (np.linalg.solve(narrow, pull) - mean))


@njit(cache=True)
def cells(x, cov, where, absent, spikes, at, t, s):
    """Return the cells' temperatures (n) if no suspect is at work; `t` (n) and `s` (P, n) are the model's. [°C]"""
    p = at.shape[0]
    return t + (unburdened(x, cov, where, absent, spikes)[:p] - at) @ s[:p]


@njit(cache=True)
def heat(dx, c, c_slope, c_table, table_x, table_y, wet, start, field):
    """Return the heat that takes the wet cells from `start` to `field` (n), rho c(T) integrated. [J/m²]"""
    n = field.shape[0]
    none, value, star = np.empty((0, n)), np.empty(n), np.empty(n)
    total = 0.0
    for k in range(_NODES.shape[0]):
        for i in range(n):
            star[i] = start + 0.5 * (1.0 + _NODES[k]) * (field[i] - start)
        properties(dx, c, c_slope, c_table, table_x, table_y, none, none, star, none, value, none)
        for i in range(n):
            if wet[i]:
                total += 0.5 * _SHARES[k] * value[i] * (field[i] - start)
    return total
