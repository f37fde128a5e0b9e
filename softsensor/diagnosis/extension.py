"""Models of a whole campaign: a base or extended model fitted to all runs at once, each with its own nuisances.

Least squares over runs r with effect parameters theta and campaign levels psi shared and eta_r of the run's
own (log coefficients, moments, start temperature, platen errors, sensor offsets, what the panel conducts and
stores otherwise than given, and for causes that lie in the panel how much of them this panel has):

    sum_r |W (y_r - f(theta, eta_r))|^2 + |(eta_r - psi) / s|^2 + |prior(theta)|^2

Gauss-Newton with exact derivatives; eta_r is eliminated run by run (variable projection), so the cost is
linear in runs and a step solves for theta and psi only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from daq.printed import on_screen
from daq.records import Array
from softsensor.diagnosis.extension_unknowns import Unknowns, panel_shares, run_values, shared_cost, start_eta
from softsensor.signals.digest import Digest, Whitened
from softsensor.signals.instrument import RAMP_S, scan_sd
from softsensor.signals.unknown import Unknown

STUCK = 3.0
"""A run whose misfit is so many times the usual or the noise's may sit in a side valley. By hand, 2026-11."""

LARGEST_OWN_STEP = 1.2
"""Of each of a run's own numbers in one step of a search: a contact by a factor of 3.3, a moment by as many
seconds. By hand, 2026-11."""
ROUNDS = 12
"""Of Gauss and Newton, by which a fit that begins far off has converged. By hand, 2026-11."""
MOST_OWN = 5.0
"""Standard deviations that a panel's own constant lies off at most; one in two million panels lies further off.
Where a model is far off they would go anywhere (26 in moist pine). Derived."""

# Numbers without another source were set by hand, 2026-11.


@dataclass(frozen=True)
class RunState:
    """One run at one point of the fit."""

    eta: Array
    residual: Array
    """Whitened data and prior rows."""
    jacobian: Array
    """Of the residual by eta, offsets last."""
    shared_jacobian: Array
    offsets: Array
    """Of each signal [K], of the insertion [s], how much later than the others each signal is read [s], and the
    panel's own constants (standard deviations)."""
    misfit: Array
    """Data minus model minus offsets (bins, signals). [K]"""
    model: Array
    """(bins, signals). [°C]"""
    core: Array
    """Of the panel as its header gives it: its own constants enter, to first order, what the faces read alone
    (bins). [°C]"""
    validation: Mapping[str, Array]
    """Model at validation channels, of the panel as its header gives it, too (bins). [°C]"""
    shift: Array
    """What offsets and insertion moment took out (bins, signals). [K]"""

    __repr__ = on_screen

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)


@dataclass(frozen=True)
class SharedFit:
    """A layout fitted to all runs."""

    layout: Unknowns
    theta: Array
    runs: tuple[RunState, ...]
    hessians: tuple[Array, ...]
    """By run: of half the cost by the shared numbers, the run's own eliminated."""
    gradients: tuple[Array, ...]
    prior_hessian: Array
    converged: bool

    __repr__ = on_screen

    @property
    def cost(self) -> float:
        """Sum of squares over runs and of the shared priors."""
        return sum(r.cost for r in self.runs) + shared_cost(self.layout, self.theta)

    @property
    def covariance(self) -> Array:
        """Of the shared numbers, as the curvature says."""
        return np.asarray(np.linalg.pinv(sum(self.hessians) + self.prior_hessian, hermitian=True))

    @property
    def values(self) -> dict[str, float]:
        """The shared numbers by name."""
        return self.layout.named(self.theta)

    def own(self, names: Sequence[str]) -> list[list[tuple[Unknown, float]]]:
        """Return each run's own unknowns of these names, with their estimates (runs)."""
        pairs = (zip(u, r.eta.tolist(), strict=True) for u, r in zip(self.layout.unknowns, self.runs, strict=True))
        return [[(u, estimate) for u, estimate in of_run if u.name in names] for of_run in pairs]


def evaluate(
    layout: Unknowns, run: int, data: Whitened, theta: Array, eta: Array, *, tangents: bool = True
) -> RunState:
    """Solve one run and set up its least-squares rows; offsets are solved for on the way."""
    digest, unknowns = data.digest, layout.unknowns[run]
    own = [u.name for u in unknowns if not u.share_of]
    names = tuple(dict.fromkeys([*own, *layout.effect_names])) if tangents else ()
    solution = digest.solve(layout.model, run_values(layout, run, theta, eta), names)
    model = digest.observed(solution)
    linear = _Linear.of(data, model)
    away = (start_eta(layout, run, theta) - eta) / np.array([u.sd for u in unknowns])
    residual = np.concatenate([linear.left, away, -linear.offsets * linear.prior])
    misfit = digest.y - model - linear.shift
    core = digest.bins(solution.core[:, None])[:, 0]
    validation = {c: digest.bins(solution.column(c)[:, None])[:, 0] for c in digest.cores}
    jacobian, outer = np.zeros((len(residual), 0)), np.zeros((len(residual), 0))
    if tangents:
        moved = digest.observed_tangents(solution, names)
        moved = data(moved + _shifted(digest, moved, linear.offsets))
        jacobian, outer = _jacobians(layout, run, theta, eta, linear, dict(zip(names, moved.T, strict=True)))
    return RunState(eta, residual, jacobian, outer, linear.offsets, misfit, model, core, validation, linear.shift)


class _Linear(NamedTuple):
    """What enters linearly, at its least squares: offsets, insertion, late signals, the panel's own constants."""

    offsets: Array
    prior: Array
    """One over their standard deviations about zero (n)."""
    free: Array
    """Whitened rows of those that are not held at a limit (entries, n)."""
    left: Array
    """Whitened readings minus model minus offsets (entries)."""
    shift: Array
    """What they take out (bins, signals). [K]"""

    @staticmethod
    def of(data: Whitened, model: Array) -> _Linear:
        """Solve for them about a model (bins, signals). [°C]"""
        digest = data.digest
        rows = _linear_rows(digest, model)
        white = data(rows)
        late = np.full(len(digest.signals), scan_sd(digest.period_s))
        own_panel = np.full(digest.panel_rows.shape[-1], data.panel_sd)
        prior = 1.0 / np.concatenate([digest.offset_sd, [digest.insertion_sd], late, own_panel])
        most = np.concatenate([np.full(rows.shape[-1] - len(own_panel), np.inf), MOST_OWN * own_panel])
        plain = data(np.where(digest.valid, digest.y - model, 0.0))
        offsets, free = bounded_offsets(white, plain, prior, most)
        return _Linear(offsets, prior, white * free, plain - white @ offsets, rows @ offsets)


def _jacobians(
    layout: Unknowns, run: int, theta: Array, eta: Array, linear: _Linear, rows: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Return the derivatives of a run's residual by its own numbers, offsets last, and by the shared ones.

    `rows`: whitened derivatives of the model by name (entries).
    """
    unknowns, shared = layout.unknowns[run], {name: i for i, name in enumerate(layout.names)}
    n, k, count = len(linear.left), len(unknowns), len(linear.offsets)
    jacobian, outer = np.zeros((n + k + count, k + count)), np.zeros((n + k + count, len(shared)))
    for key in layout.effect_names:
        outer[:n, shared[key]] = rows[key]
    for j, u in enumerate(unknowns):
        if key := u.share_of:
            jacobian[:n, j] = rows[key] * (theta[shared[key]] - layout.shared[shared[key]].centre)
            outer[:n, shared[key]] = rows[key] * max(1.0 + eta[j], 0.0)
        else:
            jacobian[:n, j] = rows[u.name] * u.slope(float(eta[j]))
        jacobian[n + j, j] = 1.0 / u.sd
        if u.shared in shared:
            outer[n + j, shared[u.shared]] = -1.0 / u.sd
    jacobian[:n, k:] = linear.free
    jacobian[n + k :, k:] = np.diag(linear.prior)
    return jacobian, outer


def bounded_offsets(rows: Array, plain: Array, prior: Array, most: Array) -> tuple[Array, np.ndarray]:
    """Return what enters linearly, by least squares, and which of it is free: what would go beyond `most` is held.

    Parameters
    ----------
    rows, plain
        Whitened (entries, n) and (entries).
    prior
        One over the standard deviations about zero (n).
    most
        Limits either way (n).
    """
    found, free = np.zeros(len(prior)), np.ones(len(prior), dtype=bool)
    while True:
        some = rows[:, free]
        normal = some.T @ some + np.diag(prior[free] ** 2)
        found[free] = np.linalg.solve(normal, some.T @ (plain - rows[:, ~free] @ found[~free]))
        beyond = free & (np.abs(found) > most)
        if not beyond.any():
            return found, free
        found[beyond] = np.sign(found[beyond]) * most[beyond]
        free &= ~beyond


def own_constants(digest: Digest, state: RunState) -> list[tuple[Unknown, float]]:
    """Return what a run's panel conducts and stores otherwise than given, as fitted, within what a panel can."""
    own = list(panel_shares(digest))[: digest.panel_rows.shape[-1]]
    fitted = state.offsets[len(state.offsets) - len(own) :]
    return [(u, float(np.clip(u.sd * share, u.lower, u.upper))) for u, share in zip(own, fitted, strict=True)]


def _linear_rows(digest: Digest, model: Array) -> Array:
    """Return what enters linearly (bins, signals, n).

    An offset for each signal, the insertion a moment later, each signal read later than the others, and what the
    panel conducts and stores otherwise than given. Channels are scanned one after the other, by the same in all
    runs, which must not pass for a cause. What is late in all of them is left to the moments: freed beside them,
    one run of twelve at 1 Hz ended in a side valley.
    """
    bins, count = model.shape
    rows = np.zeros((bins, count, 2 * count + 1))
    slope, inserted = _slopes(digest, model)
    rows[:, :, :count] = np.eye(count)
    rows[:, :, count] = -inserted
    rows[:, :, count + 1 :] = -slope[:, :, None] * (np.eye(count) - 1.0 / count)
    return np.concatenate([rows, digest.panel_rows], axis=-1)


def _slopes(digest: Digest, series: Array) -> tuple[Array, Array]:
    """Return how fast series rise, everywhere and before the press closes, 0 elsewhere (bins, ...). [1/s]"""
    slope, early = np.zeros_like(series), np.zeros_like(series)
    before = digest.time < digest.moments.closed_s - RAMP_S / 2.0
    if len(series) > 2:
        slope = np.gradient(series, digest.time, axis=0)
    if before.sum() > 2:
        early[before] = np.gradient(series[before], digest.time[before], axis=0)
    return slope, early


def _shifted(digest: Digest, tangents: Array, offsets: Array) -> Array:
    """Return by how much what enters linearly moves with the model, through its slopes (bins, signals, n).

    Late signals and a late insertion shift by the model's slope; where that steepens, so do they.
    """
    count = len(digest.signals)
    late = offsets[count + 1 : 2 * count + 1]
    slope, inserted = _slopes(digest, tangents)
    return np.asarray(-slope * (late - late.mean())[:, None] - inserted * offsets[count])


def fit_campaign_model(
    layout: Unknowns,
    data: Sequence[Whitened],
    etas: Sequence[Array] | None = None,
    *,
    rounds: int = ROUNDS,
    tolerance: float = 0.3,
) -> SharedFit:
    """Minimise the cost over everything. `etas` are starts; steps that do not help are halved."""
    theta = np.array([s.begin for s in layout.shared])
    lower, upper = layout.limits
    theta = np.clip(theta, lower, upper)
    own = [start_eta(layout, r, theta) for r in range(len(data))] if etas is None else list(etas)
    runs = each_run(lambda r: evaluate(layout, r, data[r], theta, own[r]), len(data))
    cost = sum(r.cost for r in runs) + shared_cost(layout, theta)
    converged, damping = False, 0.0
    for _ in range(rounds):
        accepted = False
        for _ in range(6):
            step, own_steps = _step(layout, theta, runs, damping)
            new_theta = np.clip(theta + step, lower, upper)
            new = _evaluate_all(layout, data, new_theta, [r.eta + s for r, s in zip(runs, own_steps, strict=True)])
            new_cost = sum(r.cost for r in new) + shared_cost(layout, new_theta)
            if new_cost < cost:
                accepted = True
                break
            damping = max(10.0 * damping, 0.3)
        if not accepted:
            converged = True
            break
        damping = damping / 10.0 if damping > 0.05 else 0.0
        gain, cost, theta, runs = cost - new_cost, new_cost, new_theta, new
        if gain < tolerance + 1e-4 * cost * (damping == 0.0):
            converged = True
            break
    hessians, gradients = zip(*(_reduced(r) for r in runs), strict=True)
    prior = np.diag(1.0 / layout.priors[1] ** 2)
    return SharedFit(layout, theta, tuple(runs), hessians, gradients, prior, converged)


def unstuck(fit: SharedFit, data: Sequence[Whitened], begin: Callable[[int], Array] | None = None) -> SharedFit:
    """Fit again where runs are worse off only because of where they began.

    Those far worse off than the others, or than noise: most of a campaign may have gone astray together, with
    moments and contacts. What a cause then seemed to save was a fresh start. `begin`: where a run begins again;
    by default at the middle of its priors.
    """
    begin = begin or (lambda r: start_eta(fit.layout, r, fit.theta))
    misfits = np.array([r.cost / len(r.residual) for r in fit.runs])
    etas, freed = [r.eta for r in fit.runs], False
    for r in np.flatnonzero(misfits > STUCK * min(float(np.median(misfits)), 1.0)).tolist():
        again = fit_run_to(fit.layout, r, data[r], fit.theta, begin(r), rounds=8)
        if again.cost < 0.8 * fit.runs[r].cost:
            etas[r], freed = again.eta, True
    if not freed:
        return fit
    return fit_campaign_model(fit.layout.begun(fit.theta), data, etas, rounds=6)


def _evaluate_all(
    layout: Unknowns, data: Sequence[Whitened], theta: Array, etas: Sequence[Array]
) -> list[RunState]:
    return each_run(lambda r: evaluate(layout, r, data[r], theta, _within(layout.unknowns[r], etas[r])), len(data))


_POOL = ThreadPoolExecutor(2, thread_name_prefix="runs")


def each_run(work: Callable[[int], RunState], count: int) -> list[RunState]:
    """Do something for each run on two threads; the solver lets go of the interpreter meanwhile."""
    return list(_POOL.map(work, range(count)))


def _within(unknowns: Sequence[Unknown], eta: Array) -> Array:
    return np.clip(eta, [u.lower for u in unknowns], [u.upper for u in unknowns])


def _reduced(run: RunState) -> tuple[Array, Array]:
    """Hessian and gradient of half the cost by the shared numbers, the run's own numbers following."""
    q, _ = np.linalg.qr(run.jacobian)
    outer = run.shared_jacobian - q @ (q.T @ run.shared_jacobian)
    rest = run.residual - q @ (q.T @ run.residual)
    return outer.T @ outer, -outer.T @ rest


def _step(
    layout: Unknowns, theta: Array, runs: Sequence[RunState], damping: float = 0.0
) -> tuple[Array, list[Array]]:
    """Gauss-Newton step of everything; shared numbers at a limit stay there if the step leads outwards."""
    (centre, sd), (lower, upper) = layout.priors, layout.limits
    normal = np.diag(1.0 / sd**2)
    right = -(theta - centre) / sd**2
    factors = []
    for unknowns, run in zip(layout.unknowns, runs, strict=True):
        rows = np.zeros((len(unknowns), run.jacobian.shape[1]))
        rows[:, : len(unknowns)] = np.diag([np.sqrt(damping) / u.sd for u in unknowns])
        q, triangle = np.linalg.qr(np.concatenate([run.jacobian, rows]))
        q = q[: len(run.residual)]
        outer = run.shared_jacobian - q @ (q.T @ run.shared_jacobian)
        normal += run.shared_jacobian.T @ outer
        right += outer.T @ run.residual
        factors.append((q, triangle))
    normal += 0.01 * damping * np.diag(np.diag(normal))
    step = bounded_step(normal, right, theta, lower, upper, np.array([s.step for s in layout.shared]))
    own = []
    for run, (q, triangle) in zip(runs, factors, strict=True):
        target = q.T @ (run.residual - run.shared_jacobian @ step)
        own.append(solve_triangular(triangle, target)[: len(run.eta)])
    return step, [np.clip(s, -LARGEST_OWN_STEP, LARGEST_OWN_STEP) for s in own]


def bounded_step(normal: Array, right: Array, theta: Array, lower: Array, upper: Array, limit: Array) -> Array:
    """Solve for a step that stays within limits: numbers that would cross one move up to it and are held."""
    free = np.ones(len(theta), dtype=bool)
    step = np.zeros(len(theta))
    for _ in range(len(theta)):
        inner = np.flatnonzero(free)
        rest = right[inner] - normal[np.ix_(inner, np.flatnonzero(~free))] @ step[~free]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal)[inner], 1e-300))
        scaled = normal[np.ix_(inner, inner)] * scale[:, None] * scale[None, :]
        step[inner] = scale * np.linalg.lstsq(scaled, scale * rest, rcond=1e-13)[0]
        crossing = inner[(theta + step)[inner] < lower[inner] - 1e-12 * np.abs(lower[inner])]
        crossing = np.append(crossing, inner[(theta + step)[inner] > upper[inner] + 1e-12 * np.abs(upper[inner])])
        if not len(crossing):
            break
        free[crossing] = False
        step[crossing] = np.clip((theta + step)[crossing], lower[crossing], upper[crossing]) - theta[crossing]
    return step * float(np.min(limit / np.maximum(np.abs(step), 1e-300), initial=1.0))


def from_the_others(fit: SharedFit, data: Sequence[Whitened], rounds: int = 0) -> list[Array]:
    """Return for each run the shared numbers that the other runs alone give (runs).

    One Newton step of the others' cost, then so many rounds of a fit to them.
    """
    total = sum(fit.hessians) + fit.prior_hessian
    lower, upper = fit.layout.limits
    found = []
    for r, own in enumerate(fit.hessians):
        theta = np.clip(fit.theta + np.linalg.lstsq(total - own, fit.gradients[r], rcond=1e-12)[0], lower, upper)
        others = [i for i in range(len(data)) if i != r]
        if rounds and others:
            layout = replace(fit.layout.begun(theta), unknowns=tuple(fit.layout.unknowns[i] for i in others))
            etas = [fit.runs[i].eta for i in others]
            theta = fit_campaign_model(layout, [data[i] for i in others], etas, rounds=rounds).theta
        found.append(theta)
    return found


def held_out(
    fit: SharedFit, data: Sequence[Whitened], rounds: int = 2, thetas: Sequence[Array] | None = None
) -> list[RunState]:
    """Return each run with shared numbers from the other runs, its own numbers fitted to it.

    `thetas` as `from_the_others` returns them; worked out where they are not given.
    """
    known = from_the_others(fit, data) if thetas is None else thetas
    return each_run(lambda r: fit_run_to(fit.layout, r, data[r], known[r], fit.runs[r].eta, rounds), len(data))


def predicted(fit: SharedFit, data: Sequence[Whitened], thetas: Sequence[Array]) -> list[RunState]:
    """Return each run as its header, its moments, its platens and the other runs alone predict it.

    No panel channel of the run enters but through the moments: its contacts are the others' middle, its share of
    a cause is the usual one, its sensors have no offset. `thetas` as `from_the_others` returns them.
    """

    def ahead(r: int) -> RunState:
        state = evaluate(fit.layout, r, data[r], thetas[r], start_eta(fit.layout, r, thetas[r]), tangents=False)
        return replace(state, misfit=state.misfit + state.shift, shift=np.zeros_like(state.shift))

    return each_run(ahead, len(data))


def fit_run_to(layout: Unknowns, run: int, data: Whitened, theta: Array, eta: Array, rounds: int = 3) -> RunState:
    """Fit one run's own numbers at given shared ones."""
    state = evaluate(layout, run, data, theta, eta)
    for _ in range(rounds):
        q, upper = np.linalg.qr(state.jacobian)
        step = solve_triangular(upper, q.T @ state.residual)[: len(state.eta)]
        step = np.clip(step, -LARGEST_OWN_STEP, LARGEST_OWN_STEP)
        new = evaluate(layout, run, data, theta, _within(layout.unknowns[run], state.eta + step))
        if new.cost >= state.cost - 0.02:
            return new if new.cost < state.cost else state
        state = new
    return state
