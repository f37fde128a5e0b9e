"""From true temperatures to what a logger would have written: the measuring chain and its faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from daq.records import Array
from daq.simulated.campaign_platens import coloured, first_order

FACES = {
    "top": tuple(f"top_{i}" for i in range(1, 8)),
    "bottom": tuple(f"bottom_{i}" for i in range(1, 8)),
}
PLATENS = ("platen_top", "platen_bottom")
CHANNELS = (*PLATENS, *FACES["top"], *FACES["bottom"])
"""The 16 channels of the laboratory press, in scan order."""

POSITIONS_MM = (
    (250.0, 250.0),
    (125.0, 125.0),
    (375.0, 125.0),
    (125.0, 375.0),
    (375.0, 375.0),
    (25.0, 250.0),
    (475.0, 250.0),
)
"""Places of sensors 1 to 7 on the 500 mm by 500 mm face; 6 and 7 lie at the rim."""

RIM_SHAPE = (0.65, 0.8, 0.8, 0.8, 0.8, 1.575, 1.575)
"""How much of the mean rim loss reaches each place; the mean of the seven is 1."""


@dataclass(frozen=True)
class Nuisances:
    """Imperfections every real measuring chain has. Standard deviations unless stated otherwise."""

    offset_K: float = 0.3
    """Of each panel channel, new in every run."""
    gain: float = 0.0
    """Of each panel channel, relative to its distance from 23 °C."""
    platen_offset_K: float = 0.1
    platen_gain: float = 0.0
    channel_noise_K: tuple[float, float] = (0.1, 0.2)
    """Range; correlated over 10 s."""
    face_noise_K: tuple[float, float] = (0.1, 0.2)
    """Range; common to a face, correlated over 30 s."""
    white_K: float = 0.05
    quantum_K: float = 0.1
    skew_s: float = 0.05
    """Time a scan takes from its first to its last channel, at most half a period."""
    jitter: float = 0.01
    """Of the row times, as a share of the period."""
    missing: float = 0.001
    """Share of single cells."""
    burst_chance: float = 0.15
    """That a run has one channel silent for some seconds."""
    gap_chance: float = 0.0
    """That a run lacks all rows for 1 to 10 s."""
    loose_chance: float = 0.15
    """That a run has a loose sensor, beyond any hidden effect."""
    start_error_K: float = 0.1
    """Header's start temperature against the true one."""
    ambient_error_K: float = 0.1

    @classmethod
    def real_chain(cls) -> Nuisances:
        """Return what issue 4 asks a fit to allow for: gains and a start temperature off by 0.3 K too."""
        return cls(gain=0.0015, platen_gain=0.0005, start_error_K=0.3)

    @classmethod
    def none(cls) -> Nuisances:
        """Return a perfect chain."""
        return cls(0.0, 0.0, 0.0, 0.0, (0.0, 0.0), (0.0, 0.0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Fault:
    """One channel that reads something false."""

    kind: str
    """``loose``, ``drifting`` or ``swapped``."""
    column: str
    partner: str = ""
    """The other channel of a swap."""
    start_s: float = 0.0
    size: float = 0.0
    """Loose: share of contact left; drifting: K/s."""


@dataclass(frozen=True)
class Chain:
    """One run's measuring chain: everything drawn once, then applied to all channels."""

    nuisances: Nuisances
    clock_s: float = 0.0
    """Panel channels show what was true this much earlier."""
    platen_error_K: Mapping[str, float] = field(default_factory=dict)
    """True minus reading."""
    faults: tuple[Fault, ...] = ()

    @staticmethod
    def of(nuisances: Nuisances, effects: Mapping[str, Mapping[str, float]], faults: tuple[Fault, ...]) -> Chain:
        """Return the chain of a run, from what is hidden in it by effect and parameter."""
        offset = effects.get("platen_offset", {})
        return Chain(
            nuisances,
            effects.get("clock_offset", {}).get("seconds", 0.0),
            {f"platen_{side}": offset.get(f"{side}_K", 0.0) for side in ("top", "bottom")},
            faults,
        )


def measure(
    truth: Mapping[str, Callable[[Array], Array]],
    times: Array,
    chain: Chain,
    ambient: float,
    rng: np.random.Generator,
) -> dict[str, Array]:
    """Return the columns a logger writes (rows). [°C]

    Parameters
    ----------
    truth
        For every channel the true temperature as a function of time. [°C]
    times
        Row times. [s]
    chain, ambient, rng
        Imperfections, the temperature a loose sensor tends to, and the source of chance.
    """
    n = len(times)
    step = float(np.median(np.diff(times))) if n > 1 else 1.0
    nuisances = chain.nuisances
    skew = min(nuisances.skew_s, 0.5 * step) / max(len(truth), 1)
    face_sd, channel_sd = rng.uniform(*nuisances.face_noise_K), rng.uniform(*nuisances.channel_noise_K)
    common = {face: coloured(rng, n, step, 30.0, face_sd) for face in FACES}
    columns: dict[str, Array] = {}
    for j, (name, curve) in enumerate(truth.items()):
        at = times + j * skew
        if name in PLATENS:
            true = curve(at)
            offset, gain = rng.normal(0.0, [nuisances.platen_offset_K, nuisances.platen_gain])
            noise = coloured(rng, n, step, 10.0, 0.3 * channel_sd) + rng.normal(0.0, 0.6 * nuisances.white_K, n)
            offset -= chain.platen_error_K.get(name, 0.0)
        else:
            true = curve(at - chain.clock_s)
            offset, gain = rng.normal(0.0, [nuisances.offset_K, nuisances.gain])
            face = common.get(name.partition("_")[0], 0.0)
            noise = coloured(rng, n, step, 10.0, channel_sd) + rng.normal(0.0, nuisances.white_K, n) + face
        own = [fault for fault in chain.faults if fault.column == name and fault.kind != "swapped"]
        true = _faulty(true, times, own, ambient, step, rng)
        columns[name] = true + offset + gain * (true - 23.0) + noise
    for fault in chain.faults:
        if fault.kind == "swapped":
            columns[fault.column], columns[fault.partner] = columns[fault.partner], columns[fault.column]
    return _written(columns, times, nuisances, rng)


def _faulty(
    true: Array,
    times: Array,
    faults: Sequence[Fault],
    ambient: float,
    step: float,
    rng: np.random.Generator,
) -> Array:
    for fault in faults:
        since = np.clip(times - fault.start_s, 0.0, None)
        if fault.kind == "drifting":
            true = true + fault.size * since
            continue
        rattle = 1.0 + coloured(rng, len(times), step, 4.0, 0.15)
        share = np.clip((1.0 - fault.size) * (1.0 - np.exp(-since / 5.0)) * rattle, 0.0, 0.95)
        a = float(np.exp(-step / 3.0))
        driven = (1.0 - a) * true
        driven[0] += a * true[0]  # it begins where it would stay
        slow = first_order(driven, a)
        true = np.where(since > 0, (1.0 - share) * slow + share * ambient, true)
    return true


def _written(
    columns: dict[str, Array], times: Array, nuisances: Nuisances, rng: np.random.Generator
) -> dict[str, Array]:
    """Quantise, and lose some cells."""
    names = list(columns)
    for name, values in columns.items():
        if nuisances.quantum_K > 0:
            values = np.round(np.round(values / nuisances.quantum_K) * nuisances.quantum_K, 6)
        if nuisances.missing > 0:
            lost = rng.random(len(values)) < nuisances.missing
            lost[0] = False
            values = np.where(lost, np.nan, values)
        columns[name] = values
    if rng.random() < nuisances.burst_chance:
        name = names[int(rng.integers(2, len(names)))]
        begin = rng.uniform(times[0] + 3.0, times[-1])
        lost = (times >= begin) & (times < begin + rng.uniform(2.0, 10.0))
        columns[name] = np.where(lost, np.nan, columns[name])
    return columns


def draw_fault(rng: np.random.Generator, end: float, kind: str | None = None) -> Fault:
    """Return a faulty panel channel: loose, drifting, or swapped with one of the other face."""
    kind = kind or ("loose", "drifting", "swapped")[int(rng.integers(3))]
    i, j = rng.integers(1, 8, 2)
    if kind == "swapped":
        return Fault(kind, f"top_{i}", f"bottom_{j}")
    column = f"{'top' if rng.random() < 0.5 else 'bottom'}_{i}"
    if kind == "drifting":
        size = float(rng.uniform(0.05, 0.2)) * (1.0 if rng.random() < 0.5 else -1.0)
        return Fault(kind, column, start_s=float(rng.uniform(0.0, 0.3 * end)), size=size)
    return Fault(kind, column, start_s=float(rng.uniform(0.0, 0.4 * end)), size=float(rng.uniform(0.5, 0.85)))
