"""Runs boiled down to what a diagnosis weighs: place means in bins, their noise, and what a run may vary.

The channels of one place (a face) say the same thing but for an offset each, so their mean is kept, and
it is averaged over bins that are narrow after each event (insertion, closing, opening) and grow from
there: some 80 numbers a place and run. The noise of such a mean is not white: two Ornstein-Uhlenbeck
processes (seconds and half a minute) and a white part, sized by maximum likelihood over the campaign,
plus what a timing error of some hundredths of a second makes of a steep slope. Whitening with their
covariance takes the place of an AR(1) filter, which would need even sampling.

What differs from run to run without being a cause is fitted in every run with a prior: coefficients
about the campaign's own level, closing and opening moment, ramp, start temperature, platen errors,
one offset a place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from daq.press.press_file import Press
from daq.printed import on_screen
from daq.records import Array, Moments, Run
from softsensor.effects import clock_offset
from softsensor.heat.case import Case
from softsensor.heat.chain import Solution
from softsensor.heat.model import ThermalModel
from softsensor.signals.instrument import (
    FACE_SLOW_S,
    INSERTED_S,
    MEAN_FAST_S,
    RAMP_S,
    RAMPS_S,
    SCAN_LATE_S,
    SCAN_SKEW_S,
)
from softsensor.signals.moments import Switch, moments_seen, switch_of
from softsensor.signals.places import Place
from softsensor.signals.screen import ChannelFault, faces_of, no_panel_channel, screened
from softsensor.signals.spikes import Spikes, without_spikes

# Numbers without another source were set by hand, 2026-11.

GROWTH = 1.15
"""Each bin after an event is this much wider than the one before."""
FIRST_BIN_S, WIDEST_BIN_S = 0.2, 4.0
"""Narrowest bin, after an event, and widest in a run of up to 8 min. Set by hand, 2026-11. [s]"""
SAMPLES = 4
"""The model is read at up to so many times within a bin."""
MEAN_OFFSET_K = 0.1
"""Error of a place's mean that its channels' scatter does not show: they share a face and a logger. [K]"""
SWITCHING_S = RAMPS_S[1] / 2.0
"""Around closing and opening, bins of their own: half of the longest ramp. [s]"""
BEFORE_REMOVAL_S = RAMP_S / 2.0
"""Left out before the panel's removal, whose moment is known no better. [s]"""
MOST_BINS, LAST_BIN = 120.0, 1.6
"""A long run's widest bins would be so many; what is left before a switch is one bin up to so many widths."""
PLAIN_K = 0.1
"""Where a slope times the timing error exceeds this, residuals count less. [K]"""
STEP_S = 1.5
"""The solver's longest step; against a third of it faces are 4 mK off at most, the core 7 (three sample runs, seed
2026, 2026-11-29: `tests.calibration.steps`). [s]"""
TIMING_S = SCAN_LATE_S
"""Errors of the time axis that no nuisance covers: scan skew, jitter, shape of a ramp. [s]"""
UNBOUNDED_K = 1e5
"""Beyond every temperature there is: what a prediction that grows without end counts as. [K]"""
UNSURE_S = 1.5
"""After an insertion so much is left out: its moment enters linearly only, and a face's first rise has no slope.

Where the log begins with the insertion too: left in, scans some hundredths of a second apart passed for
thermocouples that answer late (p 0.002 and 0.015 with nothing hidden, seeds 932003 and 932002, 2026-11-23). [s]"""


@dataclass(frozen=True)
class MeanNoise:
    """Standard deviations of a place's mean. [K]"""

    slow: float
    """Over `FACE_SLOW_S`."""
    fast: float
    """Over `MEAN_FAST_S`."""
    white: float
    """Of each row."""

    def times(self, factor: float) -> MeanNoise:
        """Return all of it so many times as large."""
        return MeanNoise(self.slow * factor, self.fast * factor, self.white * factor)


@dataclass(frozen=True)
class Digest:
    """One run boiled down."""

    run: Run
    moments: Moments
    switch: Switch | None
    period_s: float
    signals: tuple[str, ...]
    """Places with sensors of role ``fit``, as named in ``at``."""
    channels: Mapping[str, tuple[str, ...]]
    """Channels that went into each signal."""
    offset_sd: Array
    """Prior of each signal's offset (signals). [K]"""
    insertion_sd: float
    """How well the moment of insertion is known. [s]"""
    time: Array
    """Bin middles (bins). [s of the run]"""
    width: Array
    samples: Array
    """Times at which the model is read (samples). [s of the run]"""
    first_sample: np.ndarray
    """Index of each bin's first sample (bins)."""
    y: Array
    """Means (bins, signals), NaN where nothing was read. [°C]"""
    slope: Array
    """Of `y`. [K/s]"""
    cores: Mapping[str, Array]
    """Validation channels by bin. [°C]"""
    cases: Mapping[bool, Case]
    """Ready to solve, without and with paper layers."""
    panel_rows: Array
    """What each of the panel's own constants moves the signals by (bins, signals, constants), by one standard
    deviation of what panels differ by; none before a model was fitted. [K]"""

    __repr__ = on_screen

    @property
    def valid(self) -> np.ndarray:
        """Which bins of which signals hold a value (bins, signals)."""
        return np.isfinite(self.y)

    @property
    def trust(self) -> Array:
        """Weights of residuals in kelvin: small where a timing error turns a steep slope into one."""
        return np.asarray(PLAIN_K / np.hypot(PLAIN_K, 2.0 * TIMING_S * self.slope))

    @property
    def as_given(self) -> Digest:
        """The same with the panel's constants held at those given."""
        return replace(self, panel_rows=self.panel_rows[..., :0])

    def bins(self, rows: Array) -> Array:
        """Average rows at the sample times (samples, ...) over the bins (bins, ...)."""
        count = np.diff(np.append(self.first_sample, len(self.samples)))
        total = np.add.reduceat(rows, self.first_sample, axis=0)
        return np.asarray(total / count.reshape(-1, *([1] * (rows.ndim - 1))))

    def solve(self, model: ThermalModel, values: Mapping[str, float], tangents: Sequence[str] = ()) -> Solution:
        """Run a model over the case, the panel laid in earlier by as much as channels, which show it, are late."""
        paper = any(e.layers for e in model.effects)
        if late := values.get(clock_offset.SECONDS, 0.0):
            values = {**values, "inserted_s": values.get("inserted_s", 0.0) - late}
        if clock_offset.SECONDS in tangents:
            tangents = tuple(dict.fromkeys((*tangents, "inserted_s")))
        return model.solve(self.cases[paper], values, tangents)

    def observed(self, solution: Solution) -> Array:
        """Return the model's signals by bin, in numbers that can be compared with readings (bins, signals). [°C]

        A search may try what no panel has, steam in one as light as wool, say, and temperatures grow without end.
        Such a point has to lose against every other, not to end the diagnosis.
        """
        predicted = self.bins(solution.sensors[:, : len(self.signals)])
        return np.clip(np.nan_to_num(predicted, nan=UNBOUNDED_K), -UNBOUNDED_K, UNBOUNDED_K)

    def observed_tangents(self, solution: Solution, names: Sequence[str]) -> Array:
        """Return the derivatives of the signals by parameters, 0 where they have no end (bins, signals, names)."""
        moved = [
            solution.d_sensors[name] - (solution.d_sensors["inserted_s"] if name == clock_offset.SECONDS else 0.0)
            for name in names
        ]
        slopes = self.bins(np.stack([m[:, : len(self.signals)] for m in moved], axis=-1))
        known = np.abs(self.observed(solution)) < UNBOUNDED_K
        return np.where(known[..., None] & np.isfinite(slopes), slopes, 0.0)


def digest_run(press: Press, run: Run, moments: Moments, excluded: frozenset[str] = frozenset()) -> Digest:
    """Boil a run down. `excluded` channels are left out.

    Raises InputError as `ThermalModel.prepare` does, and where no panel channel is left.
    """
    plain = ThermalModel(press)
    case = plain.prepare(run, moments, max_step_s=STEP_S)
    channels = _channels_of(case.press, run, excluded)
    signals = tuple(channels)
    series, offset_sd = _signal_series(run, signals, channels)
    period = float(np.median(np.diff(run.time_s))) if len(run.time_s) > 1 else 1.0
    rows, group = _group_rows(run.time_s, moments, period)
    first_row = np.flatnonzero(np.diff(np.append(-1, group)))
    y = _nan_means(series[rows], first_row)
    time = _nan_means(run.time_s[rows][:, None], first_row)[:, 0]
    last = np.append(first_row[1:], len(rows)) - 1
    start, end = run.time_s[rows[first_row]], run.time_s[rows[last]]
    samples, first_sample = _sample_times(start, end, last - first_row + 1)
    buried = case.press.sensors_of(run, "validation")
    validation = {c: s.label for c, s in buried.items() if np.isfinite(run.columns[c]).any()}
    cores = {c: _nan_means(run.columns[c][rows][:, None], first_row)[:, 0] for c in validation}
    slope = np.stack([slope_of(time, y[:, i]) for i in range(len(signals))], axis=1)
    lean = _lean(run, samples, series, signals, validation)
    places = {s: s for s in signals} | validation
    cases = {False: _sampled(case, lean, places)}
    if press.panel_layers:
        cases[True] = _sampled(_papered(press, run, moments), lean, places)
    return Digest(
        run=run,
        moments=moments,
        switch=switch_of(run, case.press) if case.press.has_states else None,
        period_s=period,
        signals=signals,
        channels=channels,
        offset_sd=offset_sd,
        insertion_sd=INSERTED_S if moments.inserted_s > run.time_s[0] else SCAN_SKEW_S,
        time=time,
        width=np.maximum(end - start + period, period),
        samples=samples,
        first_sample=first_sample,
        y=y,
        slope=slope,
        cores=cores,
        cases=cases,
        panel_rows=np.zeros((*y.shape, 0)),
    )


class ScreenedDigest(NamedTuple):
    """A run boiled down, and what was left out before."""

    digest: Digest
    faults: tuple[ChannelFault, ...]
    spikes: tuple[Spikes, ...]


def screened_digest(press: Press, run: Run) -> ScreenedDigest:
    """Boil a run down without its faulty channels and the single bad cells of platens and faces.

    Raises InputError as `digest_run`.
    """
    run, spikes = without_spikes(press, run)
    moments = moments_seen(run, press)
    sound = screened(press, run, moments)
    excluded = frozenset(fault.column for fault in sound.faults)
    return ScreenedDigest(digest_run(press, sound.run, moments, excluded), sound.faults, spikes)


def _channels_of(press: Press, run: Run, excluded: frozenset[str]) -> dict[str, tuple[str, ...]]:
    """Return the channels of each signal. Raises InputError where none is left."""
    usable = {
        place: tuple(c for c in columns if c not in excluded) for place, columns in faces_of(press, run)[0].items()
    }
    if not any(usable.values()):
        raise no_panel_channel(press, run)
    return {place: columns for place, columns in usable.items() if columns}


def _sampled(case: Case, lean: Run, places: Mapping[str, str]) -> Case:
    """Return a case that is read at the sample times of `lean`, whose columns lie at `places`."""
    place_of = {column: case.labels.index(place) for column, place in places.items()}
    return replace(case, run=lean, columns=tuple(places), place_of=place_of)


def _papered(press: Press, run: Run, moments: Moments) -> Case:
    from softsensor.effects import find_effect

    return ThermalModel(press, (find_effect("paper_layer"),)).prepare(run, moments, max_step_s=STEP_S)


def _lean(run: Run, samples: Array, series: Array, signals: tuple[str, ...], validation: Mapping[str, str]) -> Run:
    columns = {s: np.interp(samples, run.time_s, _filled(series[:, i])) for i, s in enumerate(signals)}
    for c in validation:
        columns[c] = np.interp(samples, run.time_s, _filled(run.columns[c]))
    return Run(run.name, run.header, samples, columns, run.source)


def _filled(values: Array) -> Array:
    good = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), good, values[good])


def _signal_series(
    run: Run, signals: tuple[str, ...], channels: Mapping[str, tuple[str, ...]]
) -> tuple[Array, Array]:
    """Mean over each place's channels, their constant offsets taken out first, and the mean's offset prior."""
    series = np.full((len(run.time_s), len(signals)), np.nan)
    offset_sd = np.full(len(signals), 1.0)
    for i, signal in enumerate(signals):
        place = Place.of(signal, channels[signal], np.stack([run.columns[c] for c in channels[signal]], axis=1))
        series[:, i] = place.mean
        if len(place.offsets) >= 3:
            offset_sd[i] = np.sqrt(np.var(place.offsets, ddof=1) / len(place.offsets) + MEAN_OFFSET_K**2)
    return series, offset_sd


def _nan_means(values: Array, first: np.ndarray) -> Array:
    good = np.isfinite(values)
    count = np.add.reduceat(good, first, axis=0)
    total = np.add.reduceat(np.where(good, values, 0.0), first, axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _group_rows(time_s: Array, moments: Moments, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows with the panel in the press, and the bin each belongs to."""
    start = float(time_s[0])
    if np.isfinite(moments.inserted_s):
        start = min(max(moments.inserted_s, start) + UNSURE_S, float(time_s[-1]))
    end = moments.removed_s - BEFORE_REMOVAL_S if np.isfinite(moments.removed_s) else time_s[-1]
    edges = [start]
    inner = [m for m in (moments.closed_s, moments.opened_s) if np.isfinite(m) and start < m < end]
    stops = [m - SWITCHING_S for m in inner] + [float(end) + period]
    widest = max(WIDEST_BIN_S, (float(end) - start) / MOST_BINS)
    for stop in stops:
        width = max(FIRST_BIN_S, period)
        while edges[-1] < stop - 1e-9:
            step = width if edges[-1] + LAST_BIN * width < stop else stop - edges[-1]
            edges.append(edges[-1] + step)
            width = min(width * GROWTH, widest)
        if stop != stops[-1]:
            fine = max(FIRST_BIN_S, period)
            for _ in range(max(1, round(SWITCHING_S / fine))):
                edges.append(edges[-1] + fine)
    rows = np.flatnonzero((time_s >= start) & (time_s <= end))
    group = np.searchsorted(np.array(edges), time_s[rows], side="right")
    return rows, group


def _sample_times(start: Array, end: Array, count: np.ndarray) -> tuple[Array, np.ndarray]:
    """Spread up to `SAMPLES` reading times evenly over each bin's rows."""
    times: list[float] = []
    first: list[int] = []
    for a, b, n in zip(start, end, count, strict=True):
        first.append(len(times))
        m = min(int(n), SAMPLES)
        if m == int(n) or n == 1:
            times += np.linspace(a, b, m).tolist()
        else:
            step = (b - a) / (n - 1) * n / m
            times += (a - (b - a) / (n - 1) / 2 + step * (np.arange(m) + 0.5)).tolist()
    return np.array(times), np.array(first)


def slope_of(time: Array, y: Array) -> Array:
    """Return how fast a signal's means rise, 0 where there is none (bins). [K/s]"""
    good = np.isfinite(y)
    slope = np.zeros(len(y))
    if good.sum() > 2:
        slope[good] = np.gradient(y[good], time[good])
    return slope


def whitener(digest: Digest, noise: MeanNoise, signal: int) -> Array:
    """Return the Cholesky factor of a signal's covariance over its valid bins (valid, valid). [K]"""
    good = digest.valid[:, signal]
    t, w = digest.time[good], digest.width[good]
    gap = np.abs(t[:, None] - t[None, :])
    cov = noise.slow**2 * np.exp(-gap / FACE_SLOW_S) + noise.fast**2 * np.exp(-gap / MEAN_FAST_S)
    rows = np.maximum(w / digest.period_s, 1.0)
    cov[np.diag_indices_from(cov)] += noise.white**2 / rows + (TIMING_S * digest.slope[good, signal]) ** 2 + 1e-6
    return np.linalg.cholesky(cov)


@dataclass(frozen=True)
class Whitened:
    """A digest with its noise: turns differences (bins, signals, ...) into independent unit noise."""

    digest: Digest
    noise: MeanNoise
    inverses: tuple[Array, ...]
    """Of the covariances' Cholesky factors, by signal."""
    panel_sd: float
    """How far the panel's own constants may lie off, in what panels differ by: less where a model is further off
    than this noise, since they would take up what it leaves."""

    __repr__ = on_screen

    @property
    def as_given(self) -> Whitened:
        """The same with the panel's constants held at those given."""
        return replace(self, digest=self.digest.as_given)

    @staticmethod
    def of(digest: Digest, noise: MeanNoise, panel_sd: float = 1.0) -> Whitened:
        """Factor the covariances."""
        factors = (whitener(digest, noise, i) for i in range(len(digest.signals)))
        inverses = (solve_triangular(f, np.eye(len(f)), lower=True, check_finite=False) for f in factors)
        return Whitened(digest, noise, tuple(inverses), panel_sd)

    def __call__(self, values: Array) -> Array:
        """Return the whitened valid entries, signal after signal (entries, ...)."""
        valid = self.digest.valid
        parts = [np.tensordot(inverse, values[valid[:, i], i], 1) for i, inverse in enumerate(self.inverses)]
        return np.concatenate(parts)
