"""Numbers of a verdict: errors before and after, parameters with their intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.press.press_file import At
from daq.records import Array
from softsensor.diagnosis.decision import ALPHA_PATTERN
from softsensor.diagnosis.extension import RunState, SharedFit
from softsensor.diagnosis.extension_unknowns import is_shape, run_values
from softsensor.diagnosis.search import CLOCK_ERROR_S
from softsensor.diagnosis.settling import START_NOISE, LeftOut, SettledModel
from softsensor.effects import Effect, Need
from softsensor.effects.parameters import QUARTILE
from softsensor.fitting.result import MISFIT_K, MISFIT_NOISE, MISFIT_SHARE, NOISIEST_K
from softsensor.heat.case import Case
from softsensor.signals.digest import WIDEST_BIN_S, Digest, MeanNoise
from softsensor.signals.doubt import depth_doubt
from softsensor.signals.faces import place_scatter
from softsensor.signals.instrument import FACE_SLOW_S, MEAN_FAST_S
from softsensor.signals.student import student

MODEL_ERROR = 0.03
"""Laws are simpler than nature: no standard deviation below this share of the size, or of a shape's range.
Set by hand, 2026-11: with it 21 of 22 true parameters lay in their 95 % interval (confusion benchmark)."""
BLOCK_S = WIDEST_BIN_S
"""Blocks whose second differences show the noise: the widest bin of a short run. [s]"""
CALM = 0.7
"""Least `Digest.trust` of a bin that shows noise: where its slope is gentle. By hand, 2026-11."""

MEDIAN_CHI2 = QUARTILE**2
"""Median of chi-squared with one degree of freedom: of the square of a normal."""


@dataclass(frozen=True)
class Interval:
    """A parameter and where it lies with 95 %."""

    value: Any
    ci95: tuple[float, float] | None

    def as_json(self) -> dict[str, Any]:
        """Return value and ci95."""
        value = list(self.value) if isinstance(self.value, tuple) else self.value
        return {"value": value, "ci95": None if self.ci95 is None else list(self.ci95)}


@dataclass(frozen=True)
class Errors:
    """How far a model is from the readings. [K]"""

    rmse_K: float  # noqa: N815
    rmse_raw_K: float  # noqa: N815
    weighed_rmse_K: float  # noqa: N815
    """`rmse_K`, steep moments counting less (`Digest.trust`): timing says more there than a model."""
    heldout_rmse_K: float  # noqa: N815
    """Runs left out, each with its own contacts and offsets fitted to it, and its panel's own constants unless a
    cause that these can make up for is in the model."""
    core_rmse_K: float | None  # noqa: N815
    predicted_rmse_K: float  # noqa: N815
    """Runs predicted from header, platens and the other runs alone, sensors' offsets within."""
    predicted_core_rmse_K: float | None  # noqa: N815
    weighed: Array
    """`weighed_rmse_K` by run, single channels scattering as in the mean run: where a scan falls within a ramp its
    channels are tens of kelvins apart, which makes a run louder and no worse described."""
    heldout: Array
    """`heldout_rmse_K` by run."""
    predicted: Array
    """`predicted_rmse_K` by run."""
    left_out: LeftOut
    """What `heldout` is of."""

    def as_json(self) -> dict[str, Any]:
        """Return the contract's table."""
        table = {
            "rmse_K": self.rmse_K,
            "heldout_rmse_K": self.heldout_rmse_K,
            "predicted_rmse_K": self.predicted_rmse_K,
            "core_rmse_K": self.core_rmse_K,
            "predicted_core_rmse_K": self.predicted_core_rmse_K,
            "rmse_raw_K": self.rmse_raw_K,
        }
        return {name: None if value is None else short(value) for name, value in table.items()}


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def short(value: float) -> float:
    """Return a number with as many digits as any answer needs."""
    return float(f"{value:.6g}")


def intervals(fit: SharedFit, effect: Effect) -> dict[str, Interval]:
    """Return the effect's parameters; the wider of curvature and run-to-run scatter gives the interval."""
    covariance = fit.covariance
    runs = len(fit.runs)
    centred = [g - np.mean(fit.gradients, axis=0) for g in fit.gradients]
    meat = sum((np.outer(g, g) for g in centred), np.zeros_like(covariance)) * runs / max(runs - 1, 1)
    robust = covariance @ meat @ covariance
    quantile = student(max(runs - 1, 1))
    found = {}
    for p in effect.parameters:
        i = fit.layout.names.index(effect.key(p.name))
        value = float(fit.theta[i])
        law = MODEL_ERROR * (p.upper - p.lower if is_shape(p) else value - p.neutral)
        law = max(law, CLOCK_ERROR_S) if effect.needs == Need.SWITCH else law
        sd = np.sqrt(max(covariance[i, i], robust[i, i]) + law**2)
        half = quantile * float(sd)
        low, high = max(value - half, p.lower), min(value + half, p.upper)
        found[p.name] = Interval(short(value), (short(low), short(high)))
    return found


def intervals_of_models(fits: Sequence[SharedFit], effect: Effect) -> dict[str, Interval]:
    """Return the effect's parameters by the first of several fits, with intervals that hold if any fit is right.

    The union of their intervals: it covers as often as the interval of the right one does, with no odds between
    them, which the noise alone would give far too surely. Where a cause is no more than suspected, the model with
    it and the one without both stand.
    """
    first, *others = (intervals(fit, effect) for fit in fits)
    return {name: _widened(interval, [other[name] for other in others]) for name, interval in first.items()}


def _widened(interval: Interval, others: Sequence[Interval]) -> Interval:
    ends = [one.ci95 for one in (interval, *others) if one.ci95 is not None]
    return (
        replace(interval, ci95=(min(low for low, _ in ends), max(high for _, high in ends))) if ends else interval
    )


def measure_errors(stage: SettledModel, others: LeftOut, ahead: Sequence[RunState]) -> Errors:
    """Return errors of a stage: of the fit, of each run by numbers from the others, and of its prediction.

    A channel's error is made of what its place's mean is off and its own scatter about that mean; both
    are weighted by time. Offsets are constant, so they come out of the first two and stay in `rmse_raw_K` and in
    the prediction. The moment of the insertion is fitted as those of closing and opening are, so what it shifts
    is no error but in a prediction.
    """
    table = []
    cores: list[Array] = []
    cores_ahead: list[Array] = []
    for run, other, pure, white in zip(stage.fit.runs, others.runs, ahead, stage.data, strict=True):
        d = white.digest
        own = _squares(d, run.misfit + run.offsets[: len(d.signals)])
        weighed = _squares(d, d.trust * run.misfit)[0]
        table.append(
            (*own, weighed, _squares(d, other.misfit)[0], _squares(d, pure.misfit)[1], place_noise(d) ** 2)
        )
        cores += _core_errors(d, run)
        cores_ahead += _core_errors(d, pure)
    fit, raw, weighed, held, pure_, scatter = np.array(table).T
    return Errors(
        rmse_K=rms(np.sqrt(fit + scatter)),
        rmse_raw_K=rms(np.sqrt(raw + scatter)),
        weighed_rmse_K=rms(np.sqrt(weighed + scatter)),
        heldout_rmse_K=rms(np.sqrt(held + scatter)),
        core_rmse_K=rms(np.concatenate(cores)) if cores else None,
        predicted_rmse_K=rms(np.sqrt(pure_ + scatter)),
        predicted_core_rmse_K=rms(np.concatenate(cores_ahead)) if cores_ahead else None,
        weighed=np.sqrt(weighed + np.mean(scatter)),
        heldout=np.sqrt(held + scatter),
        predicted=np.sqrt(pure_ + scatter),
        left_out=others,
    )


def residual_K(stage: SettledModel) -> float:  # noqa: N802 - kelvin
    """Return how far a model is from the readings it was fitted to, a channel's own scatter within. [K]"""
    pairs = zip(stage.data, stage.fit.runs, strict=True)
    return float(
        np.sqrt(np.mean([_squares(d.digest, r.misfit)[0] + place_noise(d.digest) ** 2 for d, r in pairs]))
    )


def _squares(digest: Digest, misfit: Array) -> tuple[float, float]:
    """Time-weighted mean squares of the places' misfit, without its mean and with it."""
    without, with_mean, total = 0.0, 0.0, 0.0
    for i, signal in enumerate(digest.signals):
        good = digest.valid[:, i]
        weight, values = digest.width[good], misfit[good, i]
        mean = float(np.average(values, weights=weight))
        count = len(digest.channels[signal])
        without += count * float(np.average((values - mean) ** 2, weights=weight))
        with_mean += count * float(np.average(values**2, weights=weight))
        total += count
    return without / total, with_mean / total


def is_described(rmse_K: float, noise_K: float, digests: Sequence[Digest]) -> bool:
    """Return whether a model is near enough to the readings to say anything: the rule of a single run's fit."""
    span = max(float(np.nanmax(d.y) - np.nanmin(d.y)) for d in digests)
    return rmse_K <= max(MISFIT_K, MISFIT_SHARE * span, MISFIT_NOISE * min(noise_K, NOISIEST_K))


def noise_floor(stages: Sequence[SettledModel]) -> float:
    """Return what noise alone leaves of a channel, estimated from the readings. [K]

    Single channels scatter about their place's mean by `place_noise`. What a place's channels share shows in
    second differences over blocks of `BLOCK_S`, which a model's error, being smooth, hardly enters: by how much
    they exceed what the usual noise of a mean makes of them (median over all blocks), its slow and fast part do.
    Smallest over the models: none adds noise, but a bad one may leave corners.
    """
    digests = [d.digest for d in stages[0].data]
    shared2 = START_NOISE.slow**2 + START_NOISE.fast**2
    factor2 = min(_excess(digests, [r.misfit for r in s.fit.runs], START_NOISE) for s in stages)
    return float(np.sqrt(np.mean([place_noise(d) ** 2 for d in digests]) + factor2 * shared2))


def _excess(digests: Sequence[Digest], misfits: Sequence[Array], usual: MeanNoise) -> float:
    """Return by what factor second differences of blocks exceed a noise's, as variances; 1 without blocks."""
    found = [
        square
        for d, misfit in zip(digests, misfits, strict=True)
        for i in range(len(d.signals))
        for stretch in _calm(d, i)
        for square in _bends(d.time[stretch], misfit[stretch, i], d.width[stretch] / d.period_s, usual)
    ]
    return float(np.median(found)) / MEDIAN_CHI2 if found else 1.0


def _calm(d: Digest, signal: int) -> Iterator[np.ndarray]:
    """Yield the rows of each stretch without an event in which a signal was read and its slope is gentle."""
    good = np.isfinite(d.y[:, signal]) & (d.trust[:, signal] > CALM)
    edges = [m for m in (d.moments.closed_s, d.moments.opened_s) if np.isfinite(m)]
    phase = np.searchsorted(edges, d.time)
    for k in range(len(edges) + 1):
        yield np.flatnonzero(good & (phase == k))


def _bends(time: Array, misfit: Array, rows: Array, usual: MeanNoise) -> Iterator[float]:
    """Yield squared second differences of block means, in the variance a noise gives them."""
    if len(time) < 3:
        return
    block = np.floor((time - time[0]) / BLOCK_S).astype(int)
    gap = np.abs(time[:, None] - time[None, :])
    cov = usual.slow**2 * np.exp(-gap / FACE_SLOW_S) + usual.fast**2 * np.exp(-gap / MEAN_FAST_S)
    cov[np.diag_indices_from(cov)] += usual.white**2 / np.maximum(rows, 1.0)
    for k in range(1, int(block[-1])):
        parts = [block == k + step for step in (-1, 0, 1)]
        if all(part.any() for part in parts):
            weight = sum(
                (factor * part / part.sum() for factor, part in zip((1.0, -2.0, 1.0), parts, strict=True)),
                np.zeros(len(time)),
            )
            yield float((weight @ misfit) ** 2 / (weight @ cov @ weight))


def place_noise(digest: Digest) -> float:
    """Return how far the channels of a place scatter about their mean, root mean square over places. [K]"""
    rows = (digest.run.time_s >= digest.time[0]) & (digest.run.time_s <= digest.time[-1])
    values = [place_scatter(digest.run, c, rows) ** 2 for c in digest.channels.values() if len(c) > 1]
    return float(np.sqrt(np.mean(values))) if values else 0.0


def sure_core_error_K(stage: SettledModel) -> float:  # noqa: N802 - kelvin
    """Return by how much core thermocouples surely lie off a model alike in all runs, 0 where chance may. [K]

    Of each run the mean over its time; what is beyond Student's interval over runs, as sure as a pattern of the
    faces must be, is no panel's own doing. A buried one may lie off its depth alike in all runs.
    """
    means, places = [], []
    for number, (white, run) in enumerate(zip(stage.data, stage.fit.runs, strict=True)):
        if errors := _core_errors(white.digest, run):
            means.append(np.mean(np.concatenate(errors)))
            places.append(np.mean(np.concatenate(_depth_errors(stage.fit, number, white.digest))))
    if len(means) < 2:
        return 0.0
    quantile = student(len(means) - 1, 1.0 - ALPHA_PATTERN / 2.0)
    half = quantile * float(np.hypot(np.std(means, ddof=1) / np.sqrt(len(means)), np.mean(places)))
    return max(abs(float(np.mean(means))) - half, 0.0)


def _depth_errors(fit: SharedFit, number: int, digest: Digest) -> list[Array]:
    """Return what a deviation of its depth does to each core thermocouple of a run, where it reads (bins). [K]

    Only one at a stated depth may lie beside it.
    """
    sensors = digest.cases[False].press.sensors_of(digest.run, "validation").values()
    if not any(isinstance(sensor.at, At) for sensor in sensors):
        return [np.zeros(1)]
    cases = {paper: _read_beside(case, digest) for paper, case in digest.cases.items()}
    values = run_values(fit.layout, number, fit.theta, fit.runs[number].eta)
    beside = replace(digest, cases=cases).solve(fit.layout.model, values)
    read = ((np.isfinite(digest.cores[c]), digest.bins(beside.column(c)[:, None])[:, 0]) for c in digest.cores)
    return [np.abs(kelvin[good]) for good, kelvin in read]


def _read_beside(case: Case, digest: Digest) -> Case:
    """Return a case whose core thermocouples read what a deviation of their depth changes. [K]"""
    places = case.places.copy()
    for column, sensor in case.press.sensors_of(digest.run, "validation").items():
        row = case.place_of[column]
        places[row] = 0.0
        if isinstance(sensor.at, At):
            sd = depth_doubt(digest.run.header, case.press.sensor.index(sensor), sensor.at).sd / 1000.0
            places[row] = sd * case.mesh.slope(sensor.at.layer, sensor.at.depth_mm / 1000.0)
    return replace(case, places=places)


def _core_errors(digest: Digest, run: RunState) -> list[Array]:
    found = []
    for column, values in digest.cores.items():
        good = np.isfinite(values)
        if good.any():
            found.append(values[good] - run.validation[column][good])
    return found
