"""The compiled loops, one by one."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from softsensor import kernels, kernels_modal
from softsensor.model import ThermalModel, warm_up
from softsensor.readout import Reader
from softsensor.timing import ramp


def test_nothing_compiles_after_warming_up(lab_press, make_run, coefficients, moments):
    warm_up()
    before = {name: len(f.signatures) for name, f in _dispatchers().items()}
    for effects in ((), ("moisture_evaporation", "thermocouple_lag", "thermocouple_footprint"), ("paper_layer",)):
        model = ThermalModel.of(lab_press, effects)
        case = model.prepare(make_run(end=30.0), moments)
        model.solve(case, model.guesses | coefficients, model.parameter_names)
        model.solve(case, model.guesses | coefficients)
        if not effects:
            model.solve(case, coefficients, model.parameter_names, method="exact")
    assert {name: len(f.signatures) for name, f in _dispatchers().items()} == before


def _dispatchers():
    found = {}
    for module in (kernels, kernels_modal):
        found |= {name: f for name, f in vars(module).items() if hasattr(f, "signatures")}
    return found


def test_modes_follow_a_stiff_integrator_with_inputs_straight_between_steps():
    rng = np.random.default_rng(5)
    rates = np.array([0.0, 1e-6, 0.3, 4.0, 90.0, 900.0])
    gains = rng.normal(size=(2, 6))
    edges = np.concatenate([[0.0], np.cumsum(rng.choice([0.01, 0.1, 0.3], 40))])
    u = np.cumsum(rng.normal(size=(41, 2)), axis=0)
    read = rng.normal(size=(3, 6))
    q = rng.normal(size=(1, 6))
    start = q[0].copy()
    out, none = np.zeros((1, 41, 3)), np.zeros((0, 0, 6))
    kernels_modal.modes(rates, gains[None], read, np.diff(edges), u[None], none, q, out, none)
    y = start
    for k in range(40):

        def rate(t, y, k=k):
            share = (t - edges[k]) / (edges[k + 1] - edges[k])
            return -rates * y + (u[k] + share * (u[k + 1] - u[k])) @ gains

        y = solve_ivp(rate, edges[k : k + 2], y, "Radau", rtol=1e-10, atol=1e-12).y[:, -1]
        assert np.allclose(out[0, k + 1], read @ y, atol=1e-6)
    assert np.allclose(q[0], y, atol=1e-6)


def test_modes_take_given_forces_and_keep_a_history():
    rng = np.random.default_rng(6)
    rates, gains = np.array([0.1, 3.0, 500.0]), rng.normal(size=(1, 2, 3))
    u, h = rng.normal(size=(1, 21, 2)), np.full(20, 0.2)
    read, none = np.eye(3), np.zeros((0, 0, 3))
    results = []
    for forced, history in ((none, none), (u @ gains, np.zeros((1, 21, 3)))):
        q, out = np.ones((1, 3)), np.zeros((1, 21, 3))
        kernels_modal.modes(rates, gains, read, h, u, forced, q, out, history)
        results.append((q, out[:, 1:]))
        if len(history):
            assert np.allclose(history[:, 1:], out[:, 1:])
    assert np.allclose(results[0][0], results[1][0])
    assert np.allclose(results[0][1], results[1][1])


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
