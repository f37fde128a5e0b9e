"""What the live sensor believes: filters side by side, blended into one mixture for the core."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from daq.records import Array
from softsensor import observer_kernels as loops
from softsensor import observer_kernels_mixture as mixture
from softsensor.observer_blocks import Blocks
from softsensor.observer_kernels_blocks import HOLE_S, drive
from softsensor.observer_priors import TIMING, Plan, Suspect
from softsensor.observer_setup import CHAIN_UNITS, Bench, Filter

CHANNEL_K, OFFSET_K = 0.07, 0.3
"""White noise and constant offset of a panel channel. [K]"""
FACE_K, FACE_S = 0.15, 25.0
"""Slow error common to a face, and how fast it is forgotten. [K, s]"""
ROUGH_S, ROUGH_MEMORY_S = 0.15, 3.0
"""How far the model may be off in time where readings jump, and for how long. [s]"""
MARGIN_K, MARGIN_SHARE = 0.1, 0.003
"""What the model itself adds to the core: absolute (what header and logger round to), and of its rise (mesh,
steps). Start temperature and panel constants are not in it: they are parameters of the filter."""
TRUST = 0.1
"""Share of a log-likelihood that counts between causes (a power posterior). Their laws, and the linear answers to
them, are off for seconds on end, so that blocks of 0.45 s do not speak independently: taken in full, one pressing
would swear to one cause now and to another a minute later, with a narrow band about each. Set on virtual campaigns
of the seeds 41000 to 41153; 0.03 to 0.3 do about as well."""
SHAPE_SHARE, SHAPE_K = 0.45, 4.5
"""What a suspected cause does to the core is known to this share only, for its law may be another; and to so much
at worst. [-, K]"""
TOLD_K = 12.0
"""What the model in force says is told no further than this from what all hypotheses together expect. [K]"""
UNEXPLAINED, FULL_RISE_K = 1.5, 40.0
"""What the faces leave unexplained counts so many times in the core, once it has risen so far. [-, K]"""
GATE = 4.0
"""Innovations beyond this many standard deviations lose weight."""
MISFIT_MEMORY_S, WORST_MEMORY_S = 10.0, 120.0
MISFIT_USUAL, MISFIT_WEIGHT = 2.0, 5.0
"""A misfit beyond the first (78 sound runs at 1 to 10 Hz had less) speaks for a change, so many nats a unit."""
LOG_STEP, TIME_STEP_S, TIME_STEP, UNIT_STEP = 0.15, 0.06, 0.2, 0.5
"""Linearise anew where a logarithm, a moment (both in seconds and in prior units) or any other parameter (in prior
units) has moved this far."""
JUMP_K, JUMPS_PER_S = 0.15, 5e-5
"""Innovations where something changes at once (a contact lapses, a door opens), and how often that is. [K, 1/s]"""
DECIDE_S = 1.5
"""What is odd about a reading waits so long for the press to have closed or opened; a core does not hurry. [s]"""
DOUBT, DOUBT_SHARE, DOUBT_K = 0.3, 0.15, 1.0
"""After a change: chance that the panel itself changed, and how far the core may then be off, of its rise since
(a core cannot move at once), or where the faces are silent. [-, -, K]"""
SURE = 0.9
"""Chance beyond which a change counts as one."""
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
    told: float
    """What the model in force says, or the faces alone where something has changed at once. [°C]"""
    sd: float
    """Root mean square distance of the core from what is told. [K]"""
    low: float
    high: float
    """Bounds of 95 %. [°C]"""
    by_faces: bool = False
    """Whether something has changed at once and the faces as measured tell the core, whatever the contacts do."""

    @cached_property
    def leading(self) -> int:
        """The most likely hypothesis."""
        return int(np.argmax(self.weights))

    @property
    def changed(self) -> float:
        """Chance that something changed at once."""
        return float(sum(w for name, w in zip(self.names, self.weights, strict=True) if name == CHANGED))


@dataclass
class Member:
    """One filter, its belief, and how well it has done. Arrays change in place."""

    filter: Filter
    suspects: tuple[Suspect, ...]
    hypotheses: tuple[str, ...]
    """What "nothing" (or this filter's own cause) is called, then each suspect."""
    log_chances: Array
    """Logarithm of what each hypothesis is given beforehand."""
    timing: loops.Timing
    x: Array
    cov: Array
    where: loops.Integers
    """Columns of the suspects."""
    absent: Array
    """Where each suspect lies if it is absent."""
    spikes: Array
    one_sided: Array
    reach: tuple[Array, Array]
    """Where the point of linearisation may lie (P), (P)."""
    fit: float = 0.0
    misfit: float = 0.3
    """Mean squared normalised innovation, the newest weighing most."""
    worst: float = 0.0
    """Largest misfit away from switches, forgotten slowly."""
    changed: float = -50.0
    """Logarithm of the odds that something changed at once since the start."""
    odd: deque[tuple[float, float, float, float]] = field(default_factory=deque)
    """Blocks not yet counted in the three: end, length, mean square innovation, nats for a change. [s, s, -, -]"""

    @staticmethod
    def fresh(bench: Bench, made: Filter, timing: loops.Timing, plan: Plan) -> Member:
        """Start a belief at the prior."""
        m, p = len(bench.labels), len(made.names)
        x, cov = np.zeros(p + 2 + 2 * m), np.eye(p + 2 + 2 * m)
        lean = plan.coupling
        x[:p] = -lean @ plan.neutral
        cov[:p, :p] += lean + lean.T + lean @ lean.T
        for a in range(m):
            channels = max(1, int((bench.place == a).sum()))
            cov[p + 2 + a, p + 2 + a] = OFFSET_K**2 / channels
            cov[p + 2 + m + a, p + 2 + m + a] = FACE_K**2
        suspects = plan.suspects
        return Member(
            filter=made,
            suspects=suspects,
            hypotheses=(plan.label, *(s.effect for s in suspects)),
            log_chances=np.log([plan.chance, *(s.chance for s in suspects)]),
            timing=timing,
            x=x,
            cov=cov,
            where=np.array([made.names.index(s.parameter) for s in suspects], dtype=np.int64),
            absent=np.array([s.absent for s in suspects]),
            spikes=np.array([s.spike for s in suspects]),
            one_sided=np.array([s.one_sided for s in suspects], dtype=bool),
            reach=plan.reach,
        )

    def take(self, blocks: Blocks) -> None:
        """March over blocks of scans and correct by what the faces read."""
        f = self.filter
        said = np.empty((len(blocks.quiet), 4))
        loops.take(
            f.stack, f.tangents, f.d_boundary, f.state, f.nonlinear, f.factors, f.chain, f.places,
            self.timing, f.moving, blocks.span, blocks.outside, self.x, self.cov, f.at,
            blocks.level, blocks.moment, blocks.votes, _ERRORS, _UNITS, GATE, _SLOW, said,
        )  # fmt: skip
        for (begin, end), quiet, told in zip(
            blocks.span.tolist(), blocks.quiet.tolist(), said.tolist(), strict=True
        ):
            self._count(begin, end, told, quiet=quiet)

    def _count(self, begin: float, end: float, told: Sequence[float], *, quiet: bool) -> None:
        """Keep how well a block was foretold: log-likelihood, squares, their number, nats for a change."""
        fit, squares, count, jump = told
        if not quiet:  # just after a switch the filters differ by their linearisation, not by what they know
            self.fit += fit
        elapsed = end - begin
        self.worst *= math.exp(-elapsed / WORST_MEMORY_S)
        if count and not quiet:
            self.odd.append((end, max(elapsed, 0.05), squares / count, jump))
        while self.odd and end - self.odd[0][0] >= DECIDE_S:
            _, elapsed, square, jump = self.odd.popleft()
            self.changed = _either(self.changed, math.log(JUMPS_PER_S * elapsed) + jump)
            keep = math.exp(-elapsed / MISFIT_MEMORY_S)
            self.misfit = keep * self.misfit + (1.0 - keep) * square
            self.worst = max(self.worst, self.misfit)

    @property
    def unburdened(self) -> Array:
        """Mean of all states if no suspect is at work."""
        return np.asarray(mixture.unburdened(self.x, self.cov, self.where, self.absent, self.spikes))

    def better_point(self) -> Array | None:
        """Return where to linearise anew, or None where the old point will do. Suspects stay absent."""
        f = self.filter
        p = len(f.names)
        mean = self.unburdened[:p]
        target, far = f.at.copy(), False
        for i, (name, prior) in enumerate(zip(f.names, f.priors, strict=True)):
            if i in self.where:
                continue
            if prior.logarithmic:
                step = LOG_STEP / prior.sd
            elif name in TIMING:
                step = max(TIME_STEP_S / prior.sd, TIME_STEP)
            elif "." in name and name not in _MILD:
                step = UNIT_STEP
            else:
                continue
            target[i] = min(max(mean[i], self.reach[0][i]), self.reach[1][i])
            far = far or abs(target[i] - f.at[i]) > step
        return target if far else None


CHANGED = "sudden change"
UNHEARD_K = 10.0
"""A face that has moved by more while it was silent has driven the panel in a way nobody knows. [K]"""
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
    unheard: Array
    """For how long a face has been silent, largest jump of one face and of both after that. [s, K, K]"""
    before_C: float = math.nan  # noqa: N815
    """Core when last nothing had changed. [°C]"""

    @staticmethod
    def fresh(made: Filter, timing: loops.Timing, faces: tuple[int, int], start: float) -> Driven:
        """Start with both faces at the panel's initial temperature."""
        return Driven(made, timing, faces, start, np.full(2, start), np.zeros(3), before_C=start)

    def take(self, blocks: Blocks) -> None:
        """March over blocks of scans; a face that is silent keeps its last temperature."""
        f = self.filter
        drive(
            f.stack, f.tangents, f.d_boundary, f.state, f.nonlinear, f.factors, f.chain, f.places,
            self.timing, f.moving, blocks.span, blocks.newest, self.faces, self.last, self.unheard,
        )  # fmt: skip

    @property
    def knows(self) -> bool:
        """Whether both faces have been heard whenever they moved."""
        return bool(self.unheard[0] < HOLE_S and self.unheard[1] < UNHEARD_K)

    @property
    def core(self) -> tuple[float, float]:
        """Mean and variance. [°C, K²]"""
        chain = self.filter.chain
        return float(chain.level[0]), float(chain.d_level @ chain.d_level)


def _either(a: float, b: float) -> float:
    """Return the logarithm of the sum of two numbers given by theirs."""
    high = max(a, b)
    return high + math.log1p(math.exp(min(a, b) - high))


def mix(
    members: list[Member], rise: float, unexplained: float, driven: Driven | None = None, start: float = 0.0
) -> Mixture:
    """Blend what all hypotheses of all filters say about the core.

    Parameters
    ----------
    rise
        How far the core has come from its start, in which the model's own error is counted. [K]
    unexplained
        What the model leaves unexplained of the faces. [K]
    start
        How far the core's start may be from the faces', where only they tell it. [K]
    """
    names: list[str] = []
    margin = MARGIN_K**2 + start**2 + (MARGIN_SHARE * rise) ** 2
    margin += (UNEXPLAINED * unexplained * min(rise / FULL_RISE_K, 1.0)) ** 2
    log, means, variances = np.empty((3, 2 + sum(len(member.hypotheses) for member in members)))
    told = math.nan
    for member in members:
        chain, own = member.filter.chain, slice(len(names), len(names) + len(member.hypotheses))
        told = mixture.weigh(
            member.x, member.cov, member.filter.at, chain.level[0], chain.d_level,
            member.where, member.absent, member.spikes, member.one_sided, member.log_chances,
            (member.fit, TRUST), (SHAPE_SHARE, SHAPE_K), told, log[own], means[own], variances[own],
        )  # fmt: skip
        variances[own] = (variances[own] + margin) * max(1.0, member.misfit)
        names += member.hypotheses
    worst = min(member.worst for member in members)
    odds = _either(members[0].changed, MISFIT_WEIGHT * (worst - MISFIT_USUAL))
    share, by_faces = 0.0, False
    core, doubt = (math.nan, math.nan), DOUBT_K
    if odds > -6.0:
        share = 1.0 / (1.0 + math.exp(-odds))
        if driven is not None and driven.knows:
            core = driven.core[0], driven.core[1] + margin
            doubt = DOUBT_SHARE * abs(core[0] - driven.before_C)
            by_faces = share > SURE
        names += [CHANGED, CHANGED]
    weights, means, sds = log[: len(names)], means[: len(names)], variances[: len(names)]
    told, sd, low, high = mixture.pool(weights, means, sds, told, TOLD_K, share, core, (DOUBT, doubt))
    return Mixture(tuple(names), weights, means, sds, told, sd, low, high, by_faces)
