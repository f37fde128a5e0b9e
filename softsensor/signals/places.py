"""A run's channels made ready for a fit: grouped by place, screened, and whitened.

Channels at the same place see the same temperature, so what a run says about the heat lies in the mean
of each place; what distinguishes the channels (offset, gain, noise) lies in their deviations from it.
The noise of a place's mean is modelled as two first-order processes, one common to the face and one
from the channels, plus white noise; a Kalman filter turns it into independent residuals of variance 1,
with uneven and missing rows treated exactly. Testing samples as if they were independent would make
intervals three to ten times too narrow here (noise correlated over 10 to 30 s at up to 10 rows a second).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.compiled import compiled
from daq.press.press_file import Press
from daq.printed import on_screen
from daq.records import Array, Moments, Run
from softsensor.signals.instrument import CHANNEL_FAST_LIMITS_S, CHANNEL_FAST_S, CHANNEL_WHITE_K
from softsensor.signals.robust import Flags, nan_median, robust_sd
from softsensor.signals.screen import ChannelFault, faces_of, quiet_rows, screened

# Numbers without another source were set by hand, 2026-11.

NEAR_S, FAR_S = 2.0, 6.0
"""Lags at which the channels' noise is looked at: one beyond a scan, one beyond what fades at once. [s]"""
LEAST_WHITE_K, LEAST_WHITE_SHARE = 1e-3, 0.1
"""White noise of a channel at least, alone, and as a share of all its noise where it has a slower part. [K, -]"""


@dataclass(frozen=True)
class Place:
    """Channels at one place of the stack, and their mean."""

    label: str
    columns: tuple[str, ...]
    mean: Array
    """Mean of the good channels, differences between their offsets removed (rows). [°C]"""
    count: Array
    """Channels behind each row's mean, 0 where there is none (rows)."""
    offsets: Array
    """By how much each channel reads above their common level (channels). [K]"""

    __repr__ = on_screen

    @staticmethod
    def of(label: str, columns: Sequence[str], values: Array) -> Place:
        """Take the mean over channels (rows, channels); one that drops out makes no step in it."""
        good, offsets = np.isfinite(values), np.zeros(len(columns))
        if len(columns) > 1:
            offsets = np.nan_to_num(nan_median((values - nan_median(values)[:, None]).T))
            offsets -= offsets.mean()
        count = good.sum(axis=1).astype(float)
        total = np.where(good, values - offsets, 0.0).sum(axis=1)
        mean = np.where(count > 0, total / np.maximum(count, 1.0), np.nan)
        return Place(label, tuple(columns), mean, count, offsets)


@dataclass(frozen=True)
class Signals:
    """A run's good channels, by place."""

    time_s: Array
    places: tuple[Place, ...]
    cells: Mapping[str, Array]
    """Values of each good channel, NaN where missing or dropped (rows). [°C]"""
    findings: tuple[ChannelFault, ...]
    dropped: int
    """Single cells left out."""

    __repr__ = on_screen

    @property
    def period_s(self) -> float:
        """Median time from row to row. [s]"""
        return float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else 1.0


@dataclass(frozen=True)
class Noise:
    """Standard deviations and correlation times of the residuals."""

    slow_K: float  # noqa: N815
    """Common to a place. [K]"""
    slow_s: float
    fast_K: float  # noqa: N815
    """Of each channel. [K]"""
    fast_s: float
    white_K: float  # noqa: N815
    """Of each reading. [K]"""


def collect_signals(press: Press, run: Run, moments: Moments) -> Signals:
    """Group a run's fit channels by place and leave out what cannot be believed; the run's overrides applied."""
    usable, empty = faces_of(press, run)
    sound = screened(press, run, moments)
    bad = {f.column for f in sound.faults}
    cells = {c: sound.run.columns[c] for columns in usable.values() for c in columns if c not in bad}
    good = {label: [c for c in columns if c in cells] for label, columns in usable.items()}
    places = [
        Place.of(label, columns, np.stack([cells[c] for c in columns], axis=1))
        for label, columns in good.items()
        if columns
    ]
    return Signals(run.time_s, tuple(places), cells, empty + sound.faults, sound.dropped)


def channel_noise(signals: Signals, moments: Moments, before: Noise) -> Noise:
    """Return the noise with its channel part estimated from deviations within each place.

    Autocovariances near lags of 0, `NEAR_S` and `FAR_S` give white level, channel level and correlation time.
    A place with a single channel has no deviations; its white level follows from second differences.
    """
    quiet = quiet_rows(signals.time_s, moments)
    period = signals.period_s
    near, far = max(1, round(NEAR_S / period)), max(2, round(FAR_S / period))
    sums, weights = np.zeros(3), np.zeros(3)
    single = []
    for place in signals.places:
        values = np.stack([signals.cells[c] for c in place.columns], axis=1)[quiet]
        n = values.shape[1]
        if n < 3:
            single.append(_white_level(values))
            continue
        deviation = values - place.mean[quiet][:, None]
        deviation = deviation - nan_median(deviation.T)
        deviation = _without_gain(deviation, place.mean[quiet]) * np.sqrt(n / (n - 1.0))
        for i, lag in enumerate((0, near, far)):
            product = deviation[lag:] * deviation[: max(len(deviation) - lag, 0)]
            ok = np.isfinite(product)
            sums[i] += product[ok].sum()
            weights[i] += ok.sum()
    if weights[0] < 20:
        white = float(np.median(single)) if single else before.white_K
        return replace(before, white_K=max(white, LEAST_WHITE_K), fast_K=0.0)
    c0, c1, c2 = sums / np.maximum(weights, 1.0)
    if weights[2] < 20:
        return replace(before, white_K=max(float(np.sqrt(c0)), LEAST_WHITE_K), fast_K=0.0)
    apart = (far - near) * period
    tau = (
        CHANNEL_FAST_S if c2 <= 0 or c1 <= c2 else float(np.clip(apart / np.log(c1 / c2), *CHANNEL_FAST_LIMITS_S))
    )
    fast = float(np.clip(c1 * np.exp(near * period / tau), 0.0, c0))
    white = max(c0 - fast, (LEAST_WHITE_SHARE * np.sqrt(c0)) ** 2, LEAST_WHITE_K**2)
    return replace(before, fast_K=float(np.sqrt(fast)), fast_s=tau, white_K=float(np.sqrt(white)))


def _without_gain(deviation: Array, mean: Array) -> Array:
    spread = mean - np.nanmean(mean)
    out = deviation.copy()
    for i in range(deviation.shape[1]):
        ok = np.isfinite(deviation[:, i]) & np.isfinite(spread)
        variance = float(spread[ok] @ spread[ok])
        if variance > 0:
            out[:, i] -= float(spread[ok] @ deviation[ok, i]) / variance * spread
    return out


def _white_level(values: Array) -> float:
    second = np.diff(values, n=2, axis=0)
    second = second[np.isfinite(second)]
    return float(robust_sd(second)) / np.sqrt(1.0 + 2.0**2 + 1.0) if len(second) else CHANNEL_WHITE_K


def _whiten(
    time_s: Array,
    series: Array,
    variance: Array,
    ok: Flags,
    coloured: tuple[float, float, float, float],
) -> tuple[Array, float]:
    """Filter the columns of `series` with the gains of one noise model; see `whiten`.

    `coloured`: variance and correlation time of the slow and of the fast process. [K², s, K², s]
    """
    (rows, m), (slow, slow_s, fast, fast_s) = series.shape, coloured
    out = np.zeros((rows, m))
    a, b = np.zeros(m), np.zeros(m)
    p11, p12, p22 = slow, 0.0, fast
    log_det = 0.0
    last = time_s[0]
    before, fa, fb = -1.0, 1.0, 1.0
    for k in range(rows):
        dt = time_s[k] - last
        last = time_s[k]
        if abs(dt - before) > 1e-9:
            fa, fb = np.exp(-dt / slow_s), np.exp(-dt / fast_s)
            before = dt
        p11 = fa * fa * p11 + slow * (1.0 - fa * fa)
        p22 = fb * fb * p22 + fast * (1.0 - fb * fb)
        p12 = fa * fb * p12
        for j in range(m):
            a[j] *= fa
            b[j] *= fb
        if not ok[k]:
            continue
        s = p11 + 2.0 * p12 + p22 + variance[k]
        k1, k2 = (p11 + p12) / s, (p12 + p22) / s
        root = 1.0 / np.sqrt(s)
        for j in range(m):
            v = series[k, j] - a[j] - b[j]
            out[k, j] = v * root
            a[j] += k1 * v
            b[j] += k2 * v
        q11, q22 = p11 + p12, p12 + p22
        p11 -= k1 * q11
        p12 -= k1 * q22
        p22 -= k2 * q22
        log_det += np.log(s)
    return out, log_det


_filter: Callable[..., Any] = compiled(nogil=True)(_whiten)


def whiten(time_s: Array, series: Array, variance: Array, noise: Noise, count: float) -> tuple[Array, float]:
    """Turn series with a place's coloured noise into independent ones of variance 1.

    Parameters
    ----------
    series
        Residuals and derivatives of a place's mean (rows, columns); rows where the first column is not
        finite give zeros.
    variance
        White part by row (rows). [K²]
    count
        Channels of the place.

    Returns
    -------
    The whitened series (rows, columns) and the logarithm of the covariance's determinant.

    Examples
    --------
    >>> t = np.arange(200.0)
    >>> white, _ = whiten(t, np.ones((200, 1)), np.full(200, 1e-4), Noise(0.2, 30.0, 0.0, 10.0, 0.1), 7)
    >>> float(round(white[0, 0], 2)), bool(abs(white[50:]).max() < 1.0)
    (4.99, True)
    """
    ok = np.isfinite(series[:, 0])
    fast = noise.fast_K**2 / max(count, 1.0)
    out, log_det = _filter(
        np.ascontiguousarray(time_s),
        np.ascontiguousarray(series),
        np.ascontiguousarray(variance),
        ok,
        (noise.slow_K**2, noise.slow_s, fast, noise.fast_s),
    )
    return out, float(log_det)
