"""When exactly the press closed or opened: kinks in face temperatures, placed between the scans.

A face that a hot plate touches follows the solution for a half space heated through a contact that grows
while the press closes; a face the plate leaves cools like a half space whose flux changes over a short
ramp. Both are compared with the readings on a grid of onset, ramp and contact; the answer is the
posterior mean of the ramp's middle, so that few scans lean on the prior and many do not.

References
----------
Carslaw & Jaeger, Conduction of Heat in Solids, 2nd ed., Secs. 2.7 (contact) and 2.9 (given flux).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.materials import MATERIALS
from daq.records import ROOM_C, Array, PressEventKind

STEP_S = 0.02
"""Of the grids of onset and time: small beside a scan at 20 Hz. Set by hand, 2026-11. [s]"""
_CONTACTS = np.geomspace(0.3, 8.0, 15)
"""Contact coefficient over the panel's effusivity; see `_TYPICAL_CONTACT`. [1/√s]"""
CLOSING_RAMPS_S = np.linspace(0.1, 1.2, 12)
"""A press closes in 0.2 to 1 s (contract, section 2), all lengths alike; with some room beyond. [s]"""
_OPENING_RAMPS_S = (0.05, 0.15, 0.25, 0.35, 0.45, 0.55)
"""It opens more quickly than it closes. Set by hand, 2026-11. [s]"""
_TYPICAL_CONTACT, _CONTACT_SPREAD = 700.0 / MATERIALS["MDF"].effusivity, 0.5
"""The paper's 700 W/m²K on MDF; its logarithm's spread covers 420 to 1150 W/m²K. [1/√s, 1]"""
LAGS_S = np.array([0.0, 0.15, 0.3, 0.5, 0.75, 1.0])
"""Lags of a sensor that are tried. Set by hand, 2026-11. [s]"""

# Numbers without another source were set by hand, 2026-11.

_LAG_SCALE_S = 0.25
"""A thermocouple taped between two bodies may lag up to a second, but mostly does not. [s]"""
_SQRT_KELVIN = 2.0 / (np.sqrt(np.pi) * MATERIALS["MDF"].effusivity)
"""Rise of a face of MDF per flux and root of time: a half-space. [K m²/W/√s]"""
_CLOSED_W_M2K, _AIR_W_M2K, _LYING_W_M2K = 365.0, 12.0, 40.0
"""Roughly what a face gains from its platen, closed; what it loses to air and hall, open; and what it gains where
it only lies on its plate. How strong a kink is depends on them, and is known no better than `_SIZE_SHARE`.
[W/m²K]"""
_LEAST_GAPS_K = (2.0, 5.0, 30.0)
"""Of these three the temperature difference is taken to be at least so large: a size of nothing fits any noise.
[K]"""
_ERROR_K = 0.3
"""Of reading and model where a kink is placed; an insertion, which hands blur, has twice that. [K]"""
_SIZE_SHARE = 0.6
"""How well the size of a kink is known beforehand."""
_NOTICED_AFTER_S, _OPENED_BEFORE_S, _INSERTED_BEFORE_S = 2.6, 1.8, 11.0
"""A closing, an opening and an insertion begin at most so long before they are plain to see. [s]"""
_BEFORE_CLOSING_S, _BEFORE_OPENING_S = 1.3, 0.9
"""Rows so long before a closing, an opening is plain show the face undisturbed. [s]"""
_SLOPES_K_S = (-3.0, 6.0)
"""No face that waits for its plate moves faster, down or up. [K/s]"""
_LYING_DOWN_S = (STEP_S,)
"""A panel comes to lie on its plate at once: one step of the grid. [s]"""
BEFORE_S = 0.2
"""A scan so long before a moment shows what was before it: moments are placed to 0.1 s. [s]"""
INSERTION_S, _REACH_LONG_S, REACH_SHORT_S, _LONG_S = 14.0, 6.0, 2.5, 20.0
"""Rows so long before an event was noticed place it: an insertion, which is a slow rise; another where the press
had not moved for the last, and where it had. The detector remembers no more. [s]"""
_NEAR_PLATE_K, _BEYOND_FACE_K = 3.0, 30.0
"""The hot plate a face comes to ends below its platen by the first; with no platen read, it is hotter than the
face ever was by the second. [K]"""
BREAK_K = 1.0
"""A rise that was interrupted by so much began after it, and a fall ended before it. [K]"""
_NEVER = 1e9
"""The misfit of what was not computed."""
_UNLIKELY = 20.0
"""A lag whose misfit is larger by this is not tried: its odds are e⁻¹⁰."""
_LAG_COST = 5.0
"""Misfit of any lag against none: odds of e⁻²·⁵, one in twelve, before its length counts against it."""
REACH_S = 4.0
"""How long after the ramp a face is compared: √(a t) is 0.6 mm in MDF then, so any panel is a half space. [s]"""


@cache
def _contact_table() -> Array:
    """Return the rise of a face towards the plate, 0 to 1: contact x ramp x time since the ramp began."""
    time = STEP_S * np.arange(int(REACH_S / STEP_S) + 1)
    edges = 2.0 / np.sqrt(np.pi) * np.sqrt(STEP_S * np.arange(len(time) + 1))
    weights = np.diff(edges)
    strength = _CONTACTS[:, None, None] * np.clip(time / CLOSING_RAMPS_S[None, :, None], 0.0, 1.0)
    rise = np.zeros(strength.shape)
    flux = np.zeros(strength.shape)
    for n in range(1, len(time)):
        history = flux[..., 1:n] @ weights[n - 1 : 0 : -1] if n > 1 else 0.0
        rise[..., n] = (history + weights[0] * strength[..., n]) / (1.0 + weights[0] * strength[..., n])
        flux[..., n] = strength[..., n] * (1.0 - rise[..., n])
    return np.stack([_lagged(rise, lag) for lag in LAGS_S])


def _lagged(curves: Array, lag: float) -> Array:
    """Return curves that start at 0 as a sensor with a first-order lag shows them."""
    if lag == 0.0:
        return curves
    keep = float(np.exp(-STEP_S / lag))
    between = 1.0 - lag / STEP_S * (1.0 - keep)
    weights = [between, 1.0 - keep - between]  # exact for straight lines between the steps
    shown = weights[0] * curves
    shown[..., 1:] += weights[1] * curves[..., :-1]
    for n in range(1, shown.shape[-1]):
        shown[..., n] += keep * shown[..., n - 1]
    return shown


@dataclass(frozen=True)
class Placed:
    """A moment between the scans, the ramp around it, and what the readings say about the sensors' lag."""

    middle: float
    """[s]"""
    ramp: float
    """[s]"""
    lag_misfit: Array
    """For each lag of `LAGS_S`, minus twice the logarithm of its likelihood."""


def no_lag() -> Array:
    """Return the belief that the sensors do not lag, as a misfit for each of `LAGS_S`."""
    return np.where(LAGS_S == 0.0, 0.0, _NEVER)


def usual_lag() -> Array:
    """Return what is believed of the lag before a run is seen: most likely none, at times up to a second."""
    return np.where(LAGS_S == 0.0, 0.0, _LAG_COST + 2.0 * LAGS_S / _LAG_SCALE_S)


def closing_moment(
    times: Array, face: Array, plate: float, noticed: float, lag: Array | None = None, sigma: float = 0.02
) -> Placed:
    """Return middle and length of the closing ramp from the face the hot plate comes to.

    Parameters
    ----------
    times, face
        Some seconds before and about one after the jump. [s, °C]
    plate
        Temperature of the plate that comes. [°C]
    noticed
        A time at which the jump was plain to see. [s]
    lag
        What is known of the sensors' lag, a misfit for each of `LAGS_S`; None: they have none. Ramp, contact
        and lag look alike in this one jump, so the lag is better learned from insertion and opening.
    sigma
        Error of reading and model, as a share of the distance to the plate.
    """
    good = np.isfinite(face)
    times, face = times[good], face[good]
    level, slope = _trend(times, face, noticed)
    onsets = np.arange(_earliest(times, noticed, _NOTICED_AFTER_S), noticed + 1e-9, STEP_S)
    onsets = onsets[onsets >= min(times[0], noticed) - STEP_S]
    near = times >= onsets[0]
    times, face = times[near], face[near]
    base = level + slope * (times - noticed)
    distance = np.maximum(plate - base, 1.0)
    share = (face - base) / distance
    counts, sums = _by_place(times, onsets, share)
    error = sigma + 0.5 / float(np.median(distance)) if len(distance) else math.inf  # the prior alone counts
    lag = no_lag() if lag is None else lag
    prior = ((np.log(_CONTACTS / _TYPICAL_CONTACT) / _CONTACT_SPREAD) ** 2)[:, None, None]
    # a ramp of any length is as likely as another
    misfit = np.full((len(LAGS_S), len(_CONTACTS), len(CLOSING_RAMPS_S), len(onsets)), _NEVER)
    for i in np.flatnonzero(lag < lag.min() + _UNLIKELY):
        model = _contact_table()[i]  # contact, ramp, time since the onset
        squares = (model * model) @ counts - 2.0 * (model @ sums) + share @ share
        misfit[i] = squares / error**2 + prior + lag[i]
    return _posterior(misfit, onsets, CLOSING_RAMPS_S, lag)


def _earliest(times: Array, noticed: float, back_s: float) -> float:
    """Return from when on an event plain at `noticed` may have begun: `back_s` or a scan before. [s]"""
    before = times[times < noticed]
    return min(noticed - back_s, float(before[-1])) if len(before) else noticed - back_s


def _by_place(times: Array, onsets: Array, values: Array) -> tuple[Array, Array]:
    """Return how many rows lie so many steps after each onset, and the sum of their values (steps, onsets)."""
    place = np.rint((times[:, None] - onsets) / STEP_S).astype(int)
    shape = (int(REACH_S / STEP_S) + 1, len(onsets))
    cell = np.ravel_multi_index((np.clip(place, 0, shape[0] - 1), np.arange(shape[1])), shape).ravel()
    counts = np.bincount(cell, minlength=shape[0] * shape[1]).astype(float)
    sums = np.bincount(cell, np.repeat(values, shape[1]), minlength=len(counts))
    return counts.reshape(shape), np.asarray(sums, dtype=float).reshape(shape)


def _posterior(misfit: Array, onsets: Array, ramps: Array, lag: Array) -> Placed:
    """Return the means over a grid whose first axis is the lag and whose last two are ramp and onset."""
    weight = np.exp(-0.5 * (misfit - misfit.min()))
    weight /= weight.sum()
    by_lag = weight.reshape(len(LAGS_S), -1).sum(axis=1)
    weight = weight.reshape(-1, len(ramps), len(onsets)).sum(axis=0)
    ramp = float(weight.sum(axis=1) @ ramps)
    return Placed(
        middle=float(weight.sum(axis=0) @ onsets) + 0.5 * ramp,
        ramp=ramp,
        lag_misfit=-2.0 * np.log(np.maximum(by_lag, 1e-30)) - lag,
    )


def _trend(times: Array, face: Array, noticed: float) -> tuple[float, float]:
    """Return level at `noticed` and slope of the readings safely before the jump."""
    early = times < noticed - _BEFORE_CLOSING_S
    if early.sum() < 2:
        early = np.arange(len(times)) < max(1, int((times < noticed).sum()) - 1)
    t, y = times[early][-40:], face[early][-40:]
    if len(t) < 4:
        return float(y[-1]), 0.0
    slope, _ = np.polyfit(t - noticed, y, 1)
    slope = float(np.clip(slope, *_SLOPES_K_S))
    return float(np.mean(y) - slope * np.mean(t - noticed)), slope


def opening_moment(
    times: Array,
    faces: Sequence[Array],
    noticed: float,
    plate: float = np.nan,
    lag: Array | None = None,
    sigma: float = _ERROR_K,
) -> Placed:
    """Return when the plates left the faces: their flux changes over a short ramp.

    `sigma` is the error of reading and model. [K] The platen, where known, shows roughly how much flux
    there was to lose (`_CLOSED_W_M2K`); that helps where a single scan follows the opening.
    """
    sizes = []
    to_plate, to_air, _ = _LEAST_GAPS_K
    for face in faces:
        before = face[(times < noticed - _BEFORE_OPENING_S) & np.isfinite(face)]
        level = float(np.median(before[-5:])) if len(before) else np.nan
        flux = _CLOSED_W_M2K * max(plate - level, to_plate) + _AIR_W_M2K * max(level - ROOM_C, to_air)
        sizes.append(-_SQRT_KELVIN * flux)
    return _kink(times, faces, noticed, sigma, _Expected(_OPENING_RAMPS_S, _OPENED_BEFORE_S, tuple(sizes)), lag)


def insertion_moment(
    times: Array,
    faces: Sequence[Array],
    noticed: float,
    plate: float = np.nan,
    lag: Array | None = None,
    sigma: float = 2.0 * _ERROR_K,
) -> Placed:
    """Return when the cool panel came to lie on the hot plate."""
    *_, least = _LEAST_GAPS_K
    sizes = tuple(_SQRT_KELVIN * _LYING_W_M2K * max(plate - float(np.nanmin(face)), least) for face in faces)
    return _kink(times, faces, noticed, sigma, _Expected(_LYING_DOWN_S, _INSERTED_BEFORE_S, sizes), lag)


@cache
def _kink_table(ramps: tuple[float, ...]) -> Array:
    """Return how a face departs from its trend when its flux changes: lag x ramp x time since."""
    time = STEP_S * np.arange(int(4 * REACH_S / STEP_S) + 1)
    ramp = np.array(ramps)[:, None]
    late = np.clip(time - ramp, 0.0, None)
    shape = 2.0 * (time * np.sqrt(time) - late * np.sqrt(late)) / (3 * ramp)  # mean of √t over the ramp
    return np.stack([_lagged(shape, lag) for lag in LAGS_S])


class _Expected(NamedTuple):
    """What is expected of a kink."""

    ramps_s: tuple[float, ...]
    """How long the press may take to move. [s]"""
    back_s: float
    """How long before it is plain to see it may lie. [s]"""
    sizes: tuple[float, ...]
    """How strong it will be, by face. [K/√s]"""


def _kink(
    times: Array, faces: Sequence[Array], noticed: float, sigma: float, expected: _Expected, lag: Array | None
) -> Placed:
    """Place a kink of both faces."""
    ramps = expected.ramps_s
    begin = max(_earliest(times, noticed, expected.back_s), times[0] - 1.0)
    onsets = np.arange(begin, noticed + 1e-9, STEP_S)
    place = np.rint((times[None, :] - onsets[:, None]) / STEP_S).astype(int)
    table = _kink_table(ramps)
    place = np.clip(place, 0, table.shape[-1] - 1)
    lag = usual_lag() if lag is None else lag
    misfit = np.full((len(LAGS_S), len(ramps), len(onsets)), _NEVER)
    for i in np.flatnonzero(lag < lag.min() + _UNLIKELY):
        shape = table[i][..., place]  # ramp, onset, row
        misfit[i] = lag[i]
        for face, size in zip(faces, expected.sizes, strict=True):
            good = np.isfinite(face)
            if good.sum() >= 3:
                misfit[i] += _misfit(times[good] - noticed, face[good], shape[..., good], size, sigma)
    return _posterior(misfit, onsets, np.array(ramps), lag)


def _misfit(times: Array, face: Array, shape: NDArray[np.float64], size: float, sigma: float) -> Array:
    """Return the squared misfit of level + slope + kink for every shape, its size known within `_SIZE_SHARE`."""
    lines = np.stack([np.ones_like(times), times])
    if len(times) < 6:
        lines = lines[:1]
    q, _ = np.linalg.qr(lines.T)
    rest = face - q @ (q.T @ face)
    bent = shape - (shape @ q) @ q.T
    trust = (sigma / (_SIZE_SHARE * size)) ** 2 if np.isfinite(size) else 0.0
    aim = size if np.isfinite(size) else 0.0
    square, along = np.einsum("...n,...n->...", bent, bent), bent @ rest
    found = (along + trust * aim) / np.maximum(square + trust, 1e-9)
    if np.isfinite(size):
        found = np.where(np.sign(found) == np.sign(size), found, 0.0)
    off = rest @ rest - 2.0 * found * along + found**2 * square + trust * (found - aim) ** 2
    return np.asarray(off / sigma**2)


@dataclass(frozen=True)
class FaceHistory:
    """Both faces over some seconds, and the plate's temperature there."""

    times: Array
    top: Array
    bottom: Array
    plate: float


def place_moment(
    kind: PressEventKind, faces: FaceHistory, noticed: float, after: float, lag: Array | None
) -> Placed | None:
    """Place an event by the faces around the scan it was noticed at; None where they cannot show it.

    Rows before `after` belong to an earlier event. [s]
    """
    reach = _REACH_LONG_S if after < noticed - _LONG_S else REACH_SHORT_S
    reach = INSERTION_S if kind is PressEventKind.INSERTED else reach
    # an event is seen against two scans before it, however far apart they are
    earlier = faces.times[faces.times < noticed][-2:]
    first = min(noticed - reach, float(earlier[0]) - STEP_S) if len(earlier) else noticed - reach
    near = (faces.times > first) & (faces.times >= after)
    times, top, bottom = faces.times[near], faces.top[near], faces.bottom[near]
    readable = [face for face in (top, bottom) if np.isfinite(face).sum() >= 2]
    plate = faces.plate
    if not readable or len(times) < 2:
        return None
    if kind is PressEventKind.CLOSED:
        hot = plate - _NEAR_PLATE_K if plate == plate else float(np.nanmax(readable[0])) + _BEYOND_FACE_K
        return closing_moment(times, readable[0], hot, noticed, lag)
    if kind is PressEventKind.OPENED:
        return opening_moment(times, readable, noticed, plate, lag)
    lower = bottom if np.isfinite(bottom).sum() >= 2 else top
    if kind is PressEventKind.INSERTED:
        rise = _last_rise(times, lower, noticed)
        return insertion_moment(times[rise:], [lower[rise:]], noticed, plate, lag)
    return opening_moment(times, [lower], noticed, math.nan, lag)


def _last_rise(times: Array, face: Array, noticed: float) -> int:
    """Return the row from which a face only rose: a warm hand before the insertion is no part of it."""
    lowest = math.inf
    for i in range(int(np.searchsorted(times, noticed, side="right")) - 1, -1, -1):
        if face[i] > lowest + BREAK_K:
            return i + 1
        lowest = min(lowest, face[i]) if face[i] == face[i] else lowest
    return 0
