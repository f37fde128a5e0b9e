"""The filter's algebra against slow second ways."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import multivariate_normal, norm

from softsensor.heat.implicit_steps import Drive
from softsensor.live import kalman_steps, march_steps, mixture_steps
from softsensor.live.blocks import fresh_channels
from softsensor.live.channel_steps import robust_mean
from softsensor.live.kalman_steps import StateEstimate
from softsensor.live.march_steps import PressTiming
from softsensor.live.mixture_steps import Change, Components, Hypotheses, cells, pool, quantile
from tests.reached import reached

kalman_update = reached(kalman_steps.kalman_update)
step_length = reached(march_steps.step_length)
set_shares = reached(march_steps.set_shares)
condition = reached(mixture_steps.condition)


def problem(seed, states=6, readings=9):
    """Return a linear-Gaussian problem: H, readings y, noise variance, prior N(0, I)."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((readings, states)), rng.standard_normal(readings), 0.3


def filtered(h, y, noise):
    x, fit = np.zeros(h.shape[1]), 0.0
    estimate = StateEstimate(x, np.eye(h.shape[1]), np.zeros((h.shape[1], 0)), np.zeros(0))
    for row, value in zip(h, y, strict=True):
        gained, _ = kalman_update(estimate, row, value - row @ x, noise, 1e3)
        fit += gained
    return x, estimate.covariance, fit


def conditioned(x, cov, readout, where, absent, width, one_sided):
    """Return shift, variance and log-evidence of "no cause" and of each cause."""
    out = Components(*(np.empty(len(where) + 1) for _ in range(3)))
    causes = Hypotheses(where, absent, width, np.asarray(one_sided), np.zeros(len(where) + 1))
    condition(StateEstimate(x, cov, np.zeros((len(x), 0)), np.zeros(0)), readout, causes, out)
    return out.mean, out.variance, out.weight


@pytest.mark.parametrize("seed", range(5))
def test_updates_one_by_one_equal_conditioning_the_joint_gaussian(seed):
    h, y, noise = problem(seed)
    x, cov, fit = filtered(h, y, noise)
    joint = h @ h.T + noise * np.eye(len(y))
    assert x == pytest.approx(h.T @ np.linalg.solve(joint, y))
    assert cov == pytest.approx(np.eye(h.shape[1]) - h.T @ np.linalg.solve(joint, h))
    constant = -0.5 * len(y) * np.log(2 * np.pi)
    assert fit + constant == pytest.approx(multivariate_normal(np.zeros(len(y)), joint).logpdf(y))


@pytest.mark.parametrize("seed", range(5))
def test_what_considered_states_add_is_the_covariance_of_a_filter_that_takes_them_for_exact(seed):
    """Joseph's form with those gains, from a covariance in which the held states are uncertain."""
    h, y, noise = problem(seed)
    n, held = h.shape[1], [1, 4]
    cov, error = np.eye(n), np.zeros((n, 2))
    cov[held, held] = 0.0
    error[held, [0, 1]] = 1.0
    estimate, full = StateEstimate(np.zeros(n), cov, error, np.zeros(0)), np.eye(n)
    for row, value in zip(h, y, strict=True):
        gain = estimate.covariance @ row / (row @ estimate.covariance @ row + noise)
        kept = np.eye(n) - np.outer(gain, row)
        full = kept @ full @ kept.T + noise * np.outer(gain, gain)
        kalman_update(estimate, row, value - row @ estimate.mean, noise, 1e3)
    assert estimate.covariance + estimate.error @ estimate.error.T == pytest.approx(full)
    assert not estimate.mean[held].any()


@pytest.mark.parametrize("seed", range(5))
def test_hypotheses_read_off_one_filter_equal_filters_run_for_each(seed):
    h, y, noise = problem(seed)
    where, spike, absent = np.array([1, 3, 4]), np.array([0.05, 0.1, 0.2]), np.array([0.0, -2.5, 1.2])
    readout = np.random.default_rng(seed + 100).standard_normal(h.shape[1])
    x, cov, fit = filtered(h, y, noise)
    causes = (where, absent, spike, np.zeros(3, dtype=bool))
    means, variances, evidence = conditioned(x, cov, readout, *causes)
    for hypothesis in range(4):
        scale, centre = np.ones(h.shape[1]), np.zeros(h.shape[1])
        scale[where], centre[where] = spike, absent
        if hypothesis:
            scale[where[hypothesis - 1]], centre[where[hypothesis - 1]] = 1.0, 0.0
        own_x, own_cov, own_fit = filtered(h * scale, y - h @ centre, noise)
        own_x = centre + scale * own_x
        assert readout @ x + means[hypothesis] == pytest.approx(readout @ own_x, abs=1e-6)
        assert variances[hypothesis] == pytest.approx((readout * scale) @ own_cov @ (readout * scale), rel=1e-5)
        assert fit + evidence[hypothesis] == pytest.approx(own_fit, abs=1e-5)
        if hypothesis:
            own = where[hypothesis - 1]
            size = x[own] + conditioned(x, cov, np.eye(h.shape[1])[own], *causes)[0][hypothesis]
            assert size == pytest.approx(own_x[own], abs=1e-6)


class Field(NamedTuple):
    """What `cells` reads of a marched state."""

    t: np.ndarray
    s: np.ndarray


@pytest.mark.parametrize("one_sided", [False, True])
def test_cells_are_what_the_hypotheses_expect_by_their_shares(one_sided):
    h, y, noise = problem(7)
    where, absent, width = np.array([1, 3, 4]), np.array([0.0, -2.5, 1.2]), np.array([0.05, 0.1, 0.2])
    rng = np.random.default_rng(8)
    x, cov, _ = filtered(h, y, noise)
    shares, at, field = (
        np.array([0.2, 0.5, 0.1, 0.2]),
        rng.standard_normal(5),
        Field(*rng.standard_normal((2, 5, 4))),
    )
    field = Field(field.t[0], field.s)
    causes = Hypotheses(where, absent, width, np.full(3, one_sided), np.zeros(4))
    found = cells(StateEstimate(x, cov, np.zeros((6, 0)), at), causes, shares, field)
    for i in range(4):
        readout = np.append(field.s[:, i], 0.0)  # the last state is a bias of the readings
        shifts, _, _ = conditioned(x, cov, readout, where, absent, width, causes.one_sided)
        centre = field.t[i] + field.s[:, i] @ (x[:5] - at)
        assert found[i] == pytest.approx(centre + shares @ shifts)


@pytest.mark.parametrize("absent", [0.0, -1.5])
def test_a_cause_that_can_only_be_larger_counts_what_its_prior_leaves_above(absent):
    x, cov = np.array([0.8 + absent, 0.3]), np.array([[0.25, 0.1], [0.1, 0.5]])
    readout, where, spike = np.array([0.4, 1.0]), np.array([0]), np.array([1e-3])
    gone = np.array([absent])
    out = conditioned(x, cov, readout, where, gone, spike, [True])
    free = conditioned(x, cov, readout, where, gone, spike, [False])
    draws = np.random.default_rng(3).multivariate_normal(x, cov, 400_000)
    above = draws[draws[:, 0] > absent] @ readout - readout @ x
    assert out[0][1] == pytest.approx(above.mean(), abs=0.01)
    assert out[1][1] == pytest.approx(above.var(), abs=0.01)
    assert out[2][1] - free[2][1] == pytest.approx(np.log(norm.cdf(0.8 / 0.5) / norm.cdf(-absent)))


def test_quantiles_of_a_mixture_leave_their_share_below():
    weights, means, sds = np.array([0.7, 0.2, 0.1]), np.array([0.0, 5.0, -3.0]), np.array([0.3, 1.0, 4.0])
    for share in (0.025, 0.5, 0.975):
        exact = brentq(lambda v, p=share: weights @ norm.cdf((v - means) / sds) - p, -50, 50)
        assert quantile(weights, means, sds, share) == pytest.approx(exact, abs=2e-3)


@pytest.mark.parametrize("core", [(4.0, 0.3), (np.nan, np.nan)])
def test_what_may_have_changed_at_once_takes_its_share_of_the_mixture(core):
    log, means, variances = np.log([7.0, 2.0, 1.0]), np.array([0.0, 5.0, -3.0]), np.array([0.3, 1.0, 4.0])
    out = [np.append(column, [np.nan, np.nan]) for column in (log, means, variances)]
    mean, sd, low, high = pool(Components(*out), Change(0.25, *core, 0.4, 2.0))
    rng = np.random.default_rng(5)
    usual = rng.choice(3, 1_000_000, p=[0.7, 0.2, 0.1])
    draws = rng.normal(means[usual], np.sqrt(variances[usual]))
    centre, variance = core if np.isfinite(core[0]) else (draws.mean(), draws.var())
    doubted = rng.random(len(draws)) < 0.4
    faces = rng.normal(centre, np.sqrt(variance + np.where(doubted, 4.0, 0.0)))
    draws = np.where(rng.random(len(draws)) < 0.25, faces, draws)
    assert out[0] == pytest.approx([0.525, 0.15, 0.075, 0.15, 0.1])
    assert mean == pytest.approx(draws.mean(), abs=0.01)
    assert sd == pytest.approx(np.sqrt(np.mean((draws - mean) ** 2)), rel=0.01)
    assert (low, high) == pytest.approx(np.quantile(draws, [0.025, 0.975]), abs=0.05)


def one_face(channels):
    return fresh_channels(np.zeros(channels, dtype=np.int64), 1)


def test_a_channel_that_drops_out_and_returns_leaves_no_step():
    shifts = np.array([0.3, -0.2, 0.5, -0.4, 0.1])
    known, level, votes = one_face(5), np.empty(1), np.empty(1)
    seen = []
    for k in range(120):
        values = 50.0 + 0.1 * k + shifts
        if 40 <= k < 80:
            values[2] = np.nan
        robust_mean(known, values, level, votes)
        seen.append(level[0] - 0.1 * k)
    assert np.ptp(seen[5:]) < 0.02


def test_a_loose_channel_loses_its_vote():
    known, level, votes = one_face(7), np.empty(1), np.empty(1)
    for k in range(60):
        values = np.full(7, 100.0)
        values[4] -= 0.8 * max(k - 10, 0)
        robust_mean(known, values, level, votes)
    assert level[0] == pytest.approx(100.0, abs=0.1)


def test_steps_end_where_they_should_and_are_fine_at_a_switch():
    timing = PressTiming(0.0, 2.0, 10.0, np.inf, np.inf, 0.5, True, 1.0, 1.0, 1.0, 0.5)
    t, steps = 0.0, []
    while t < 30.0 - 1e-9:
        h = step_length(t, 30.0, timing)
        steps.append((t, h))
        t += h
    assert t == pytest.approx(30.0)
    assert max(h for at, h in steps if 9.8 < at < 10.2) <= 0.11
    assert max(h for _, h in steps) <= 0.66


@pytest.mark.parametrize("moment", ["inserted", "closed", "opened"])
@pytest.mark.parametrize("begin", [1.95, 9.9, 19.9])
def test_shares_of_a_step_answer_to_the_moments_as_their_derivatives_say(moment, begin):
    timing = PressTiming(0.0, 2.0, 10.0, 20.0, np.inf, 0.5, True, 3.0, 0.2, 0.4, 0.5)
    unit = {"inserted": 3.0, "closed": 0.2, "opened": 0.4}[moment]
    moving = np.arange(3)

    def shares(shift):
        weight, d_weight = np.zeros((1, 3)), np.zeros((1, 3, 3))
        moved = timing._replace(**{moment: getattr(timing, moment) + shift})
        none = np.empty((1, 0))
        drive = Drive(
            np.array([0.08]), weight, d_weight, none, none[..., None], np.empty((1, 2, 2)), np.empty((2, 3))
        )
        set_shares(drive, 0, begin, begin + 0.08, moved, moving)
        return weight[0], d_weight[0, :, ["inserted", "closed", "opened"].index(moment)]

    expected = (shares(1e-5)[0] - shares(-1e-5)[0]) / 2e-5 * unit
    assert np.allclose(shares(0.0)[1], expected, atol=1e-6)
    assert shares(0.0)[0].sum() == pytest.approx(1.0)
