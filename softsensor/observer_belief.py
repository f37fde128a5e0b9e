"""What the live sensor believes: filters side by side, blended into one mixture for the core."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from daq.records import Array
from softsensor import observer_kernels as loops
from softsensor.observer_priors import TIMING, Suspect
from softsensor.observer_setup import CHAIN_UNITS, Bench, Filter

CHANNEL_K, OFFSET_K = 0.07, 0.3
"""White noise and constant offset of a panel channel. [K]"""
FACE_K, FACE_S = 0.15, 25.0
"""Slow error common to a face, and how fast it is forgotten. [K, s]"""
ROUGH_S, ROUGH_MEMORY_S = 0.15, 3.0
"""How far the model may be off in time where readings jump, and for how long. [s]"""
MARGIN_K, MARGIN_SHARE = 0.2, 0.006
"""What the model itself adds to the core: absolute (no start temperature is known better), and of its rise."""
GATE = 4.0
"""Innovations beyond this many standard deviations lose weight."""
MISFIT_MEMORY_S, WORST_MEMORY_S = 10.0, 120.0
MISFIT_USUAL, MISFIT_WEIGHT = 1.4, 5.0
"""A misfit beyond the first (sound runs stay below 0.8) speaks for a change, with this many nats a unit."""
SURE = 0.9
"""A hypothesis this likely moves the point of linearisation."""
LOG_STEP, TIME_STEP_S, UNIT_STEP = 0.15, 0.06, 0.5
"""Linearise anew where a logarithm, a moment or any other parameter (in prior units) has moved this far."""
JUMP_K, JUMPS_PER_S = 0.15, 5e-5
"""Innovations where something changes at once (a contact lapses, a door opens), and how often that is. [K, 1/s]"""
QUIET_S = 2.5
"""So long after a switch innovations say nothing about changes. [s]"""
DOUBT, DOUBT_SHARE = 0.3, 0.1
"""After a change: chance that the panel itself changed, and how far the core may then be off, of its lag
behind the faces."""
_ERRORS = np.array([CHANNEL_K, ROUGH_S, ROUGH_MEMORY_S, JUMP_K])
_SLOW = np.array([FACE_K, FACE_S])
_UNITS = np.array(CHAIN_UNITS)


@dataclass(frozen=True)
class Mixture:
    """Core temperature by hypothesis: the first is "nothing is missing"."""

    names: tuple[str, ...]
    weights: Array
    means: Array
    sds: Array
    low: float
    high: float
    """Bounds of 95 %. [°C]"""

    @property
    def mean(self) -> float:
        """[°C]"""
        return float(self.weights @ self.means)

    @property
    def sd(self) -> float:
        """[K]"""
        return float(np.sqrt(self.weights @ (self.sds**2 + (self.means - self.mean) ** 2)))

    @property
    def leading(self) -> int:
        """The most likely hypothesis."""
        return int(np.argmax(self.weights))


@dataclass
class Member:
    """One filter, its belief, and how well it has done. Arrays change in place."""

    filter: Filter
    suspects: tuple[Suspect, ...]
    chances: Array
    """Of "nothing" (or of this filter's own cause), then of each suspect."""
    label: str
    """What the first hypothesis is called."""
    timing: loops.Timing
    x: Array
    cov: Array
    where: loops.Integers
    """Columns of the suspects."""
    spikes: Array
    one_sided: Array
    fit: float = 0.0
    misfit: float = 0.3
    """Mean squared normalised innovation, the newest weighing most."""
    worst: float = 0.0
    """Largest misfit away from switches, forgotten slowly."""
    changed: float = -50.0
    """Logarithm of the odds that something changed at once since the start."""

    @staticmethod
    def fresh(
        bench: Bench,
        made: Filter,
        timing: loops.Timing,
        suspects: tuple[Suspect, ...],
        chance: float,
        label: str,
    ) -> Member:
        """Start a belief at the prior."""
        m, p = len(bench.labels), len(made.names)
        size = p + 2 + 2 * m
        cov = np.eye(size)
        for a in range(m):
            channels = max(1, int((bench.place == a).sum()))
            cov[p + 2 + a, p + 2 + a] = OFFSET_K**2 / channels
            cov[p + 2 + m + a, p + 2 + m + a] = FACE_K**2
        return Member(
            filter=made,
            suspects=suspects,
            chances=np.array([chance, *(s.chance for s in suspects)]),
            label=label,
            timing=timing,
            x=np.zeros(size),
            cov=cov,
            where=np.array([made.names.index(s.parameter) for s in suspects], dtype=np.int64),
            spikes=np.array([s.spike for s in suspects]),
            one_sided=np.array([s.one_sided for s in suspects], dtype=bool),
        )

    def take(
        self, span: Array, outside: Array, level: Array, moment: Array, votes: Array, *, quiet: bool = False
    ) -> None:
        """March over a block of scans and correct by what the faces read; `quiet` just after a switch."""
        f = self.filter
        fit, squares, count, jump = loops.take(
            f.stack, f.tangents, f.d_boundary, f.state, f.nonlinear, f.factors, f.chain, f.places,
            self.timing, f.moving, span, outside, self.x, self.cov, f.at,
            level, moment, votes, _ERRORS, _UNITS, GATE, _SLOW,
        )  # fmt: skip
        if not quiet:  # just after a switch the filters differ by their linearisation, not by what they know
            self.fit += fit
        if count and not quiet:
            self.changed = float(np.logaddexp(self.changed, math.log(JUMPS_PER_S * (span[1] - span[0])) + jump))
        elapsed = max(span[1] - span[0], 0.05)
        if count and not quiet:
            keep = math.exp(-elapsed / MISFIT_MEMORY_S)
            self.misfit = keep * self.misfit + (1.0 - keep) * squares / count
        worst = self.worst * math.exp(-elapsed / WORST_MEMORY_S)
        self.worst = worst if quiet else max(worst, self.misfit)

    def blend(self, level: float, readout: Array) -> tuple[Array, Array, Array, Array]:
        """Return by hypothesis log-weight, mean and variance of level + readout (x - at); and suspects' sizes."""
        p, e = len(self.filter.names), len(self.suspects)
        full = np.zeros(len(self.x))
        full[:p] = readout
        shift, variance, evidence, sizes = np.empty(e + 1), np.empty(e + 1), np.empty(e + 1), np.empty(e)
        loops.blend(
            self.x, self.cov, full, self.where, self.spikes, self.one_sided, shift, variance, evidence, sizes
        )
        centre = level + float(readout @ (self.x[:p] - self.filter.at))
        return np.log(self.chances) + evidence + self.fit, centre + shift, variance, sizes

    def under(self, hypothesis: int) -> Array:
        """Return the mean of all states under one hypothesis."""
        if not self.suspects:
            return self.x
        own = self.cov[np.ix_(self.where, self.where)] + 1e-12 * np.eye(len(self.where))
        precision = np.linalg.inv(own)
        pull = precision @ self.x[self.where]
        tight = 1.0 / self.spikes**2 - 1.0
        if hypothesis:
            tight[hypothesis - 1] = 0.0
        sizes = np.linalg.solve(precision + np.diag(tight), pull)
        return np.asarray(self.x + self.cov[:, self.where] @ precision @ (sizes - self.x[self.where]))

    def better_point(self, hypothesis: int, sure: bool) -> Array | None:
        """Return where to linearise anew, or None where the old point will do."""
        f = self.filter
        p = len(f.names)
        mean = self.under(hypothesis)[:p]
        target, far = f.at.copy(), False
        for i, (name, prior) in enumerate(zip(f.names, f.priors, strict=True)):
            move = mean[i] - f.at[i]
            if i in self.where:
                mine = hypothesis > 0 and self.where[hypothesis - 1] == i
                move = mean[i] - f.at[i] if mine and sure else (-f.at[i] if sure else 0.0)
                step = UNIT_STEP
            elif prior.logarithmic:
                step = LOG_STEP / prior.sd
            elif name in TIMING:
                step = TIME_STEP_S / prior.sd
            elif "." in name and name not in _MILD:
                step = UNIT_STEP
            else:
                continue
            target[i] = min(max(f.at[i] + move, -3.5), 3.5)
            far = far or abs(target[i] - f.at[i]) > step
        return target if far else None


CHANGED = "sudden change"
UNSEEN_S = 3.0
"""Without a face this long, the faces no longer drive the panel. [s]"""
_MILD = ("open_radiation.emissivity", "initial_press_state.offset_K", "resin_cure.heat_kJ_m2", "skin.J_m2K")


@dataclass
class Driven:
    """The panel alone, between the faces as they are measured: right whatever the contacts do."""

    filter: Filter
    timing: loops.Timing
    faces: tuple[int, int]
    """Places of the lower and the upper face."""
    start_C: float  # noqa: N815
    last: Array
    """What the faces read last. [°C]"""
    unseen_s: float = 0.0

    @staticmethod
    def fresh(made: Filter, timing: loops.Timing, faces: tuple[int, int], start: float) -> Driven:
        """Start with both faces at the panel's initial temperature."""
        return Driven(made, timing, faces, start, np.full(2, start))

    def take(self, span: Array, level: Array) -> None:
        """March over a block; a face that is silent keeps its last temperature."""
        now = self.last.copy()
        if timing_inside(self.timing, span[1]):
            for side, place in enumerate(self.faces):
                if level[place] == level[place]:
                    now[side] = level[place]
        seen = all(level[place] == level[place] for place in self.faces)
        self.unseen_s = 0.0 if seen else self.unseen_s + span[1] - span[0]
        if span[1] > span[0]:
            f = self.filter
            loops.march(
                f.stack, f.tangents, f.d_boundary, f.state, f.nonlinear, f.factors, f.chain, f.places,
                self.timing, span, np.stack([self.last, now]), f.moving,
            )  # fmt: skip
        self.last = now

    @property
    def core(self) -> tuple[float, float]:
        """Mean and variance. [°C, K²]"""
        chain = self.filter.chain
        return float(chain.level[0]), float(chain.d_level @ chain.d_level)


def timing_inside(timing: loops.Timing, now: float) -> bool:
    """Return whether a panel is in the press."""
    return timing.inserted <= now <= timing.removed


def mix(members: list[Member], rise: float, driven: Driven | None = None) -> Mixture:
    """Blend what all hypotheses of all filters say about the core.

    `rise` is how far the core has come from its start, in which the model's own error is counted. [K]
    """
    names: list[str] = []
    parts: list[tuple[Array, Array, Array]] = []
    margin = MARGIN_K**2 + (MARGIN_SHARE * rise) ** 2
    for member in members:
        chain = member.filter.chain
        log, means, variances, _ = member.blend(float(chain.level[0]), chain.d_level)
        parts.append((log, means, (variances + margin) * max(1.0, member.misfit)))
        names += [member.label, *(s.effect for s in member.suspects)]
    log, means, variances = (np.concatenate(column) for column in zip(*parts, strict=True))
    weights = np.exp(log - log.max())
    weights /= weights.sum()
    worst = min(member.worst for member in members)
    odds = float(np.logaddexp(members[0].changed, MISFIT_WEIGHT * (worst - MISFIT_USUAL)))
    if odds > -6.0:
        share = 1.0 / (1.0 + math.exp(-odds))
        centre, variance = float(weights @ means), float(weights @ (variances + (means - weights @ means) ** 2))
        gap = 10.0
        if driven is not None and driven.unseen_s < UNSEEN_S:
            gap = abs(float(driven.last.mean()) - driven.core[0])
            centre, variance = driven.core[0], driven.core[1] + margin
        weights = np.concatenate([weights * (1.0 - share), share * np.array([1.0 - DOUBT, DOUBT])])
        means = np.append(means, [centre, centre])
        variances = np.append(variances, [variance, variance + (DOUBT_SHARE * gap) ** 2])
        names += [CHANGED, CHANGED]
    sds = np.sqrt(variances)
    low = loops.quantile(weights, means, sds, 0.025)
    high = loops.quantile(weights, means, sds, 0.975)
    return Mixture(tuple(names), weights, means, sds, low, high)
