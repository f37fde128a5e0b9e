"""One Kalman filter of the live sensor and how well it has done; the panel alone between its faces as measured."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from daq.press.faces import BLIND_S
from daq.records import Array
from softsensor.live import mixture_steps as mixtures
from softsensor.live.block_steps import Blocks, FacesRead, march_between_faces, single
from softsensor.live.curing import Curing
from softsensor.live.kalman_steps import StateEstimate, filter_blocks
from softsensor.live.march_steps import PressTiming
from softsensor.live.mixture_steps import Hypotheses
from softsensor.live.priors import TIMING, FilterPlan, is_straight
from softsensor.live.setup import Linearised, RunSetup
from softsensor.signals.instrument import CHANNEL_K, FACE_SLOW_K

MISFIT_MEMORY_S, WORST_MEMORY_S = 10.0, 120.0
"""How long a misfit, and the worst one so far, are remembered; by hand: core 0.004, band 4 %. [s]"""

# Numbers without another source were set by hand, 2026-11. Where one has "core x, band y %", the live core of
# sample run 7 moves by x of its standard deviations at most, and its band widens or narrows by y % when
# it is half as large again or a third smaller (`tests.calibration.set_by_hand live`, seed 2026, 2026-11-29).

LOG_STEP, TIME_STEP_S, TIME_STEP, UNIT_STEP = 0.15, 0.06, 0.2, 0.5
"""Linearise anew where a logarithm, a moment (both in seconds and in prior units) or any other parameter (in prior
units) has moved this far. The first: core 0.09, band 21 %; the last: core 0.004, band 1 %; a moment's steps move
nothing."""
JUMPS_PER_S = 5e-5
"""How often something changes at once (a contact lapses, a door opens): once in 5 h of pressing. Core 0.005, band
2 %. [1/s]"""
DECIDE_S = 1.5
"""What is odd about a reading waits so long for the press to have closed or opened; a core does not hurry. Core
0.004, band 4 %. [s]"""
UNREAD_K = 10.0
"""A face that has moved by more while it was silent has driven the panel in a way nobody knows. [K]"""


@dataclass
class KalmanFilter:
    """A state estimate, what it is linearised about, and how well it has done. Arrays change in place."""

    linearised: Linearised
    names: tuple[str, ...]
    """What "no cause" (or this filter's own) is called, then each suspected cause."""
    hypotheses: Hypotheses
    timing: PressTiming
    estimate: StateEstimate
    reach: tuple[Array, Array]
    """Where the point of linearisation may lie (P), (P)."""
    fit: float = 0.0
    misfit: float = 0.3
    """Mean squared normalised innovation, the newest weighing most."""
    worst: float = 0.0
    """Largest misfit away from switches, forgotten slowly."""
    across: float = 0.0
    """Largest mean squared normalised innovation right after a hole in the scans. A logger that reads once
    a minute has none; its innovations are the misfit's."""
    block_s: float = math.inf
    """How long the block before was. [s]"""
    changed: float = -50.0
    """Logarithm of the odds that something changed at once since the start."""
    odd: deque[tuple[float, float, float, float]] = field(default_factory=deque)
    """Blocks not yet counted in the three: end, length, mean square innovation, nats for a change. [s, s, -, -]"""
    curing: Curing | None = None
    """Cure of both faces, where a resin is given."""
    panel: int = 0
    """Number of the panel it takes to lie in the press (`live.panels`); 0: the header's."""
    prior: tuple[Array, Array] = (np.zeros(0), np.zeros((0, 0)))
    """Mean, and how coefficients lean on causes in it (`FilterPlan.coupling`) (P), (P, P)."""

    @staticmethod
    def at_prior(
        setup: RunSetup, made: Linearised, timing: PressTiming, plan: FilterPlan, chance: float = 1.0
    ) -> KalmanFilter:
        """Start at the prior; `chance` is that of the panel that is set up."""
        m, p = len(setup.labels), len(made.names)
        x, cov = np.zeros(p + 2 + 2 * m), np.eye(p + 2 + 2 * m)
        lean = plan.coupling
        x[:p] = -lean @ plan.neutral
        cov[:p, :p] += lean + lean.T + lean @ lean.T
        for a in range(m):
            channels = max(1, int((setup.place == a).sum()))
            cov[p + 2 + a, p + 2 + a] = CHANNEL_K**2 / channels
            cov[p + 2 + m + a, p + 2 + m + a] = FACE_SLOW_K**2
        held = np.flatnonzero([prior.considered for prior in made.priors])
        cov[held, held] = 0.0
        error = np.zeros((len(x), len(held)))
        error[held, np.arange(len(held))] = 1.0
        causes = plan.causes
        return KalmanFilter(
            linearised=made,
            names=(plan.label, *(c.effect for c in causes)),
            hypotheses=Hypotheses(
                column=np.array([made.names.index(c.parameter) for c in causes], dtype=np.int64),
                absent=np.array([c.absent for c in causes]),
                width=np.array([c.width for c in causes]),
                one_sided=np.array([c.one_sided for c in causes], dtype=bool),
                log_prior=np.log(chance * np.array([plan.chance, *(c.chance for c in causes)])),
            ),
            timing=timing,
            estimate=StateEstimate(x, cov, error, made.at),
            reach=plan.reach,
            curing=_uncured(setup, made),
            prior=(x[:p].copy(), lean),
        )

    def take(self, blocks: Blocks) -> None:
        """March over blocks of scans and correct by what the faces read."""
        scores = np.empty((len(blocks.quiet), 4))
        if self.curing is None:
            filter_blocks(self.linearised.model, self.timing, self.estimate, blocks, scores)
        else:
            self._take_and_cure(blocks, scores)
        for (begin, end), quiet, score in zip(
            blocks.span.tolist(), blocks.quiet.tolist(), scores.tolist(), strict=True
        ):
            self._count(begin, end, score, quiet=quiet)

    def _take_and_cure(self, blocks: Blocks, scores: Array) -> None:
        """March block by block, so that the cure sees the faces at each block's end."""
        model = self.linearised.model
        for k in range(len(blocks.quiet)):
            one = single(blocks, k)
            filter_blocks(model, self.timing, self.estimate, one, scores[k : k + 1])
            self.cure(float(blocks.span[k, 1] - blocks.span[k, 0]))

    def cure(self, seconds: float) -> None:
        """Carry the cure on to where the model has been marched, so many seconds on."""
        if self.curing is not None:
            self.curing = self.curing.after(self.linearised.model.state, seconds)

    def _count(self, begin: float, end: float, score: list[float], *, quiet: bool) -> None:
        """Keep how well a block was expected: log-likelihood, squares, their number, nats for a change."""
        fit, squares, count, jump = score
        if not quiet:  # just after a switch the filters differ by their linearisation, not by what they know
            self.fit += fit
        elapsed = end - begin
        if count and not quiet and elapsed > max(BLIND_S, 2.0 * self.block_s):
            self.across = max(self.across, squares / count)
        self.block_s = elapsed if elapsed > 0.0 else math.inf
        self.worst *= math.exp(-elapsed / WORST_MEMORY_S)
        if count and not quiet:
            self.odd.append((end, max(elapsed, 0.05), squares / count, jump))
        while self.odd and end - self.odd[0][0] >= DECIDE_S:
            _, elapsed, square, jump = self.odd.popleft()
            self.changed = log_sum(self.changed, math.log(JUMPS_PER_S * elapsed) + jump)
            keep = math.exp(-elapsed / MISFIT_MEMORY_S)
            self.misfit = keep * self.misfit + (1.0 - keep) * square
            self.worst = max(self.worst, self.misfit)

    @property
    def excess(self) -> float:
        """By how much more than it says a variance of it is, 1 at least: by the newest readings or by all so far.

        States far from their prior follow the readings at the price of what was known before them; each
        innovation is then a usual one, and no misfit shows it.
        """
        square, settled = self._strayed()
        return max(1.0, self.misfit, square / settled)

    @property
    def by_chance(self) -> float:
        """Chance that readings of a right model draw the states as far from their prior as they are, or further.

        At most: squares that count by shares scatter less than chi squared of as many degrees.
        """
        from scipy.special import chdtrc  # loads slowly, and only a core that readings have moved far asks

        square, settled = self._strayed()
        return float(chdtrc(settled, square))

    @property
    def core_before_C(self) -> float:  # noqa: N802
        """Core by what was known before the run, had readings moved no state. [°C]"""
        mean, at = self.prior[0], self.linearised.at
        return self.core_C + float(self.linearised.model.chain.d_level @ (mean - at))

    def _strayed(self) -> tuple[float, float]:
        """Return the squared distance of the states from their prior, and its mean where the model is right.

        Their ratio is Birge's (1932, Phys. Rev. 40, 207). A posterior's mean scatters by the prior's covariance
        without its own, P, to which what considered parameters E are off adds: M = I + E E' is the measure and
        tr M^-1 (M - P) the mean, how many states the readings have settled, here one at least. A state that no
        reading has moved lies on its prior, and is no evidence that the others are right.
        """
        (mean, lean), free = self.prior, self.linearised.free
        p = len(free)
        back = (np.eye(p) - lean)[free]
        away = back @ (self.estimate.mean[:p] - mean)
        known = back @ self.estimate.covariance[:p, :p] @ back.T
        settled = max(len(away) - float(np.trace(known)), 1.0)
        if away @ away <= settled:  # what the constants add brings neither of them nearer to the other
            return float(away @ away), settled
        error = self.estimate.error[:p][free]
        found = np.linalg.solve(np.eye(len(away)) + error @ error.T, np.column_stack([away, known]))
        return float(away @ found[:, 0]), max(len(away) - float(np.trace(found[:, 1:])), 1.0)

    @property
    def held_K(self) -> Array:  # noqa: N802
        """How far off the core is for one standard deviation of each considered parameter (C). [K]"""
        return np.asarray(mixtures.held(self.estimate, self.linearised.model.chain, self.hypotheses))

    @property
    def core_C(self) -> float:  # noqa: N802
        """Core where the model is linearised. [°C]"""
        return float(self.linearised.model.chain.level[0])

    def cells(self, shares: Array) -> Array:
        """Return the cells' temperatures as the hypotheses expect them, each by its share (E + 1). [°C]"""
        state = self.linearised.model.state
        return np.asarray(mixtures.cells(self.estimate, self.hypotheses, shares, state))

    def better_point(self) -> Array | None:
        """Return where to linearise anew, or None where the old point will do. Suspected causes stay absent."""
        own = self.linearised
        mean = mixtures.without_causes(self.estimate, self.hypotheses)
        target, far = own.at.copy(), False
        for i, (name, prior) in enumerate(zip(own.names, own.priors, strict=True)):
            if i in self.hypotheses.column or prior.considered:
                continue
            if prior.log:
                step = LOG_STEP / prior.sd
            elif name in TIMING:
                step = max(TIME_STEP_S / prior.sd, TIME_STEP)
            elif "." in name and not is_straight(name):
                step = UNIT_STEP
            else:
                continue
            target[i] = min(max(mean[i], self.reach[0][i]), self.reach[1][i])
            far = far or abs(target[i] - own.at[i]) > step
        return target if far else None


def _uncured(setup: RunSetup, made: Linearised) -> Curing | None:
    """Return the cure at a filter's start; None without a resin or a panel."""
    if setup.resin is None or not len(made.profile):
        return None
    faces = made.profile[[0, -1]]
    return Curing.begin(setup.resin.kinetics, faces, made.start_C, len(made.names), made.model.state)


@dataclass
class BetweenFaces:
    """The panel alone, between its faces as they are measured: right whatever the contacts do."""

    linearised: Linearised
    timing: PressTiming
    faces: tuple[int, int]
    """Places of the lower and the upper face."""
    read: FacesRead
    before_C: float  # noqa: N815
    """Core when last nothing had changed. [°C]"""
    late_K: float = 0.0  # noqa: N815
    """By how much the core may be ahead of faces that are read late: what it warms by in the time in which they
    stood still in the closed press, at the rate of the model in force. [K]"""

    @staticmethod
    def at_start(made: Linearised, timing: PressTiming, faces: tuple[int, int], start_C: float) -> BetweenFaces:
        """Start with both faces at the panel's initial temperature."""
        read = FacesRead(np.full(2, start_C), np.zeros(1), np.zeros(2))
        return BetweenFaces(made, timing, faces, read, start_C)

    def take(self, blocks: Blocks) -> None:
        """March over blocks of scans; a face that is silent keeps its last temperature."""
        march_between_faces(self.linearised.model, self.timing, blocks, self.faces, self.read)

    @property
    def knows(self) -> bool:
        """Whether both faces have been read whenever they moved."""
        return bool(self.read.silent_s[0] < BLIND_S and self.read.jumped_K[0] < UNREAD_K)

    @property
    def core(self) -> tuple[float, float]:
        """Mean and variance. [°C, K²]"""
        chain = self.linearised.model.chain
        return float(chain.level[0]), float(chain.d_level @ chain.d_level) + self.late_K**2


def log_sum(a: float, b: float) -> float:
    """Return the logarithm of the sum of two numbers given by theirs."""
    high = max(a, b)
    return high + math.log1p(math.exp(min(a, b) - high))
