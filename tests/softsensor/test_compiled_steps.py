"""The compiled loops, one by one."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from softsensor.heat import implicit_steps as kernels
from softsensor.heat import modal_steps as kernels_modal
from softsensor.heat import step_terms as kernels_terms
from softsensor.heat.model_file import FittedValue, ModelFile
from softsensor.heat.readout import Reader
from softsensor.heat.timing import ramp
from softsensor.jobs.warm_up import warm_up
from softsensor.live import block_steps, channel_steps, kalman_steps, march_steps, mixture_steps
from softsensor.live.sensor import ScanSensor
from tests.reached import reached

MODULES = (
    kernels,
    kernels_modal,
    kernels_terms,
    block_steps,
    channel_steps,
    kalman_steps,
    march_steps,
    mixture_steps,
)


def test_no_scan_of_a_live_run_waits_for_a_compiler_once_warmed_up(lab_press, make_run, coefficients, moments):
    warm_up(lab_press)
    before = compiled()
    assert before["kalman_steps"] > 0
    run = make_run(end=60.0, every=0.5)
    values = {name: FittedValue(x, 0.2 * x) for name, x in coefficients.items()}
    wet = (
        (
            "moisture_evaporation",
            {"moisture_percent": FittedValue(3.0, 1.0), "temperature_C": FittedValue(103.0, 2.0)},
        ),
    )
    for model in (None, ModelFile("known", "lab", values, wet)):
        sensor = ScanSensor(lab_press, run.header, model)
        for i, time_s in enumerate(run.time_s.tolist()):
            values = {name: float(x[i]) for name, x in run.columns.items()}
            sensor.update(time_s, values | {"top_1": 80.0, "bottom_1": 79.0, "closed": float(20 <= time_s < 45)})
            _ = sensor.inside
    assert compiled() == before


def compiled():
    return {
        module.__name__.rpartition(".")[2]: sum(
            len(f.signatures) for f in vars(module).values() if hasattr(f, "signatures")
        )
        for module in MODULES
    }


def test_modes_follow_a_stiff_integrator_with_inputs_straight_between_steps():
    rng = np.random.default_rng(5)
    rates = np.array([0.0, 1e-6, 0.3, 4.0, 90.0, 900.0])
    gains = rng.normal(size=(3, 6))
    edges = np.concatenate([[0.0], np.cumsum(rng.choice([0.01, 0.1, 0.3], 40))])
    u = np.cumsum(rng.normal(size=(41, 2)), axis=0)
    forces = u @ gains[:2] + gains[2]
    read, chosen = rng.normal(size=(4, 6)), np.array([0, 7, 40])
    q = rng.normal(size=6)
    start = q.copy()
    out, history = np.zeros((41, 4)), np.zeros((3, 6))
    forced = kernels_modal.Forced(rates, np.diff(edges), gains, u)
    kernels_modal.drive(forced, q, kernels_modal.Noted(read, out, chosen, history))
    carried = np.zeros((1, 41, 6))
    carried[0, 0] = start
    kernels_modal.carry(rates, np.diff(edges), forces[None], carried)
    expected = [start]
    for k in range(40):

        def rate(t, y, k=k):
            share = (t - edges[k]) / (edges[k + 1] - edges[k])
            return -rates * y + forces[k] + share * (forces[k + 1] - forces[k])

        expected.append(solve_ivp(rate, edges[k : k + 2], expected[-1], "Radau", rtol=1e-10, atol=1e-12).y[:, -1])
    assert np.allclose(out, np.array(expected) @ read.T, atol=1e-6)
    assert np.allclose(carried[0], expected, atol=1e-6)
    assert np.allclose(history, np.array(expected)[chosen], atol=1e-6)
    assert np.allclose(q, expected[-1], atol=1e-6)


@pytest.mark.parametrize("n", [1, 2, 3, 8, 9])
def test_elimination_from_both_ends_solves_the_tridiagonal_system(n):
    rng = np.random.default_rng(n)
    cap, g, dh = rng.uniform(1, 2, n), rng.uniform(0, 5, n + 1), 0.7
    diag = g[:-1] + g[1:]
    full = np.diag(cap + dh * diag) - dh * (np.diag(g[1:n], 1) + np.diag(g[1:n], -1))
    inverse, back = np.zeros(n), np.zeros(n)
    reached(kernels._factor)(cap, diag, g, dh, inverse, back)
    one, many = rng.normal(size=n), rng.normal(size=(8, n))
    x, y = one.copy(), many.copy()
    reached(kernels._solve)(inverse, back, x)
    reached(kernels._solve_many)(inverse, back, y)
    assert np.allclose(full @ x, one, rtol=0, atol=1e-12)
    assert np.allclose(full @ y.T, many.T, rtol=0, atol=1e-12)


def test_delay_is_the_exact_answer_to_straight_pieces():
    h = np.array([0.1, 0.5, 0.02, 1.0])
    y = np.array([[20.0], [25.0], [60.0], [61.0], [40.0]])
    expected = [20.0]
    edges = np.concatenate([[0.0], np.cumsum(h)])
    for k in range(4):

        def rate(t, x, k=k):
            return (np.interp(t, edges, y[:, 0]) - x) / 0.3

        expected.append(solve_ivp(rate, edges[k : k + 2], expected[-1:], rtol=1e-10, atol=1e-10).y[0, -1])
    out, d_out = y.copy(), np.zeros((1, 5, 1))
    kernels.delay(h, out, d_out, 0.3, np.ones(1))
    assert np.allclose(out[:, 0], expected, atol=1e-7)
    later, earlier = y.copy(), y.copy()
    kernels.delay(h, later, np.zeros((1, 5, 1)), 0.3 + 1e-6, np.ones(1))
    kernels.delay(h, earlier, np.zeros((1, 5, 1)), 0.3 - 1e-6, np.ones(1))
    assert np.allclose(d_out[0], (later - earlier) / 2e-6, atol=1e-5)


def test_reader_reads_a_cubic_and_its_slope_exactly():
    edges = np.cumsum(np.concatenate([[0.0], np.random.default_rng(2).uniform(0.2, 0.9, 30)]))
    times = np.linspace(edges[1], edges[-2] - 0.01, 77)
    y = (edges**3 - 2 * edges)[:, None]
    assert np.allclose(Reader.at(edges, times)(y)[:, 0], times**3 - 2 * times)
    assert np.allclose(Reader.at(edges, times, slope=True)(y)[:, 0], 3 * times**2 - 2)


@pytest.mark.parametrize("mean", [False, True])
def test_ramp_derivatives_equal_differences(mean):
    edges = np.arange(0.0, 4.0, 0.07)

    def at(middle, length):
        return ramp(edges, middle, length, mean=mean)[0]

    _, by_middle, by_length = ramp(edges, 2.013, 0.5, mean=mean)
    step = 1e-7
    assert np.allclose(by_middle, (at(2.013 + step, 0.5) - at(2.013 - step, 0.5)) / (2 * step), atol=1e-5)
    assert np.allclose(by_length, (at(2.013, 0.5 + step) - at(2.013, 0.5 - step)) / (2 * step), atol=1e-5)
