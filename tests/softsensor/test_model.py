"""The press cycle: against an independent right-hand side, and every sensitivity against differences."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daq.records import InputError, Moments
from softsensor.effects import BUILT_IN
from softsensor.heat.model import NUISANCES, PANEL_SHARES, ThermalModel, states
from softsensor.heat.timing import HANDLING_RAMP_S, OPENING_RAMP_S

SIGMA = 5.670374419e-8
SHORT = Moments(inserted_s=2.0, closed_s=8.2, opened_s=30.4, removed_s=45.0, ramp_s=0.5)
LINEAR = {"top": lambda t: 195.0 + 0.05 * t, "bottom": lambda t: 201.0 - 0.03 * t}


def with_typical(model, coefficients):
    return coefficients | {name: v for name, v in model.guesses.items() if "." in name}


class Independent:
    """The lab press with every effect at full nonlinearity, written down once more for the test."""

    def __init__(self, mesh, run, moments, h, effects):
        self.m, self.h, self.effects = moments, h, effects
        self.dx = mesh.dx
        panel = np.zeros(len(mesh.dx), dtype=bool)
        panel[mesh.cells("panel")] = True
        self.panel = panel
        self.k0 = np.where(panel, 0.12, 45.0)
        self.c0 = np.where(panel, 740.0 * 1550.0, 7850.0 * 490.0)
        self.first, self.last = np.flatnonzero(panel)[[0, -1]]
        self.ambient = 23.0
        dry = 740.0 / 1.08
        self.water = 2.4e6 * dry * effects.get("moisture_evaporation", {}).get("moisture_percent", 0.0) / 100.0
        self.boils = effects.get("moisture_evaporation", {}).get("temperature_C", 103.0)

    def shares(self, t):
        def rise(middle, length):
            return float(np.clip((t - middle) / length + 0.5, 0.0, 1.0))

        m = self.m
        present = rise(m.inserted_s, HANDLING_RAMP_S) - rise(m.removed_s, HANDLING_RAMP_S)
        closed = rise(m.closed_s, m.ramp_s) - rise(m.opened_s, OPENING_RAMP_S)
        return 1.0 - present, present - closed, closed

    def rate(self, T):
        return 0.05 * 2.0 * np.logaddexp(0.0, (T - self.boils) / 2.0)

    def __call__(self, t, y):
        n = len(self.dx)
        T, Z = y[:n], y[n:]
        e, h = self.effects, self.h
        idle, opened, closed = self.shares(t)
        lift_k = (
            1.0 + e.get("conductivity_temperature", {}).get("per_100_K", 0.0) / 100.0 * (T - 20.0) * self.panel
        )
        lift_c = (
            1.0 + e.get("heat_capacity_temperature", {}).get("per_100_K", 0.0) / 100.0 * (T - 20.0) * self.panel
        )
        k, c = self.k0 * lift_k, self.c0 * lift_c
        flow = np.zeros(n + 1)  # W/m² upwards through each interface
        half = self.dx / (2.0 * k)
        flow[1:n] = (T[:-1] - T[1:]) / (half[:-1] + half[1:])
        power = np.zeros(n)
        bottom = (idle + opened) * h["h_p_o"] + closed * h["h_p_c"]
        flow[0] = (LINEAR["bottom"](t) - T[0]) / (half[0] + 1.0 / bottom)
        flow[n] = (T[-1] - LINEAR["top"](t)) / (half[-1] + 1.0 / bottom)
        emissivity = e.get("open_radiation", {}).get("emissivity", 0.0)
        for i, joined, plate_side, apart in (
            (self.first, opened * h["h_pp_o"] + closed * h["h_pp_c"], 0, (0.0, 0.0)),
            (self.last + 1, closed * h["h_pp_c"], 1, (opened * h["h_wa"], opened * h["h_ap"])),
        ):
            losses = list(apart)
            losses[plate_side] += idle * h["h_ap"]
            a, b = T[i - 1], T[i]
            if plate_side == 1:
                joined = joined + opened * emissivity * SIGMA * (
                    ((a + 273.15) ** 2 + (b + 273.15) ** 2) * (a + b + 546.3)
                )
            # faces x, y: (a - x)/half = joined (x - y) + losses[0] (x - Ta), and likewise above
            system = np.array(
                [
                    [1.0 / half[i - 1] + joined + losses[0], -joined],
                    [-joined, 1.0 / half[i] + joined + losses[1]],
                ]
            )
            right = np.array([a / half[i - 1] + losses[0] * self.ambient, b / half[i] + losses[1] * self.ambient])
            x, yy = np.linalg.solve(system, right)
            flow[i] = 0.0
            power[i - 1] -= (a - x) / half[i - 1]
            power[i] -= (b - yy) / half[i]
        power += flow[:-1] - flow[1:]
        if "vapour_convection" in e:
            over = np.where(self.panel, T - 100.0, 0.0)
            hot = np.sum(np.maximum(over, 0.0) * self.dx)
            cold = np.sum(np.maximum(-over, 0.0) * self.dx)
            if hot > 0:
                moved = np.where(over > 0, over * cold, over * hot) / (cold + 0.01)
                power -= closed * e["vapour_convection"]["W_m3K"] * moved * self.dx
        out = [np.zeros(n)]
        if self.water:
            dz = np.where(self.panel, (1.0 - Z) * self.rate(T), 0.0)
            power -= self.water * self.dx * dz
            out.append(dz)
        out[0] = power / (c * self.dx)
        return np.concatenate(out)


@pytest.mark.parametrize(
    ("effects", "tolerance"),
    [
        ({}, 0.002),
        ({"conductivity_temperature": {"per_100_K": 0.2}, "heat_capacity_temperature": {"per_100_K": 0.2}}, 0.005),
        ({"moisture_evaporation": {"moisture_percent": 3.0, "temperature_C": 103.0}}, 0.02),
        ({"vapour_convection": {"W_m3K": 1.2e4}, "open_radiation": {"emissivity": 0.5}}, 0.01),
    ],
    ids=["linear", "k(T), c(T)", "evaporation", "steam, radiation"],
)
def test_press_cycle_agrees_with_tight_bdf_on_an_independent_right_hand_side(
    lab_press, make_run, coefficients, effects, tolerance
):
    run = make_run(end=50.0, **LINEAR)
    model = ThermalModel.of(lab_press, effects)
    values = coefficients | {f"{e}.{p}": v for e, table in effects.items() for p, v in table.items()}
    case = model.prepare(run, SHORT, fineness=0.5, max_step_s=0.5)
    coarse = model.solve(case, values, fields=True)
    truth = Independent(case.mesh, run, SHORT, coefficients, effects)
    n = len(case.mesh.dx)
    y = np.concatenate([coarse.fields[0], np.zeros(n if truth.water else 0)])
    kinks = [0.0, 50.0]
    for middle, length in (
        (SHORT.inserted_s, HANDLING_RAMP_S),
        (SHORT.closed_s, SHORT.ramp_s),
        (SHORT.opened_s, OPENING_RAMP_S),
        (SHORT.removed_s, HANDLING_RAMP_S),
    ):
        kinks += [middle - length / 2, middle + length / 2]
    sparsity = None
    if "vapour_convection" not in effects:
        near = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) <= 1
        sparsity = np.block([[near, near], [near, near]])[: len(y), : len(y)]
    reference = np.empty((len(run.time_s), n))
    reference[0] = y[:n]
    for a, b in zip(sorted(kinks), sorted(kinks)[1:], strict=False):
        rows = np.flatnonzero((run.time_s > a + 1e-9) & (run.time_s < b - 1e-9))
        at = np.append(run.time_s[rows], b)
        with np.errstate(
            invalid="ignore", over="ignore"
        ):  # SciPy subtracts a row it never filled, and does not use it
            found = solve_ivp(truth, (a, b), y, "BDF", at, rtol=1e-8, atol=1e-7, jac_sparsity=sparsity)
        reference[rows], y = found.y[:n, :-1].T, found.y[:, -1]
        reference[np.abs(run.time_s - b) < 1e-9] = y[:n]
    fine = model.solve(_refined(model, run), values)
    settled = np.ones(len(run.time_s), dtype=bool)
    for moment in (SHORT.inserted_s, SHORT.closed_s, SHORT.opened_s, SHORT.removed_s):
        settled &= (run.time_s < moment - 0.3) | (run.time_s > moment + 0.45)
    expected = reference @ case.places.T
    assert np.abs(fine.places - expected)[settled].max() < tolerance
    # the default steps, from 0.2 s after a ramp
    assert np.abs(coarse.places - expected)[settled].max() < 0.1
    assert np.sqrt(np.mean((coarse.places - expected)[settled] ** 2)) < 0.01


def _refined(model, run):
    """A case on the same mesh with steps a tenth as long."""
    return model.prepare(run, SHORT, fineness=0.5, max_step_s=0.05, switch_step_s=0.004, growth=1.02)


def test_both_solvers_agree_on_the_press_cycle(lab_press, make_run, coefficients, moments):
    model = ThermalModel.of(lab_press)
    case = model.prepare(make_run(noise=0.1), moments)
    moved = ("closed_s", "opened_s", "ramp_s", "opening_ramp_s")
    names = (*model.parameter_names, "initial_K", "boundary_top_K", *moved)
    exact = model.solve(case, coefficients, names, method="exact")
    implicit = model.solve(case, coefficients, names)
    t = case.run.time_s
    settled = np.ones(len(t), dtype=bool)
    for moment in (moments.inserted_s, moments.closed_s, moments.opened_s, moments.removed_s):
        settled &= (t < moment - 0.3) | (t > moment + 0.4)
    assert np.abs(exact.sensors - implicit.sensors)[settled].max() < 0.05
    assert np.abs(exact.core - implicit.core).max() < 0.002
    for name in names:
        scale = np.abs(exact.d_sensors[name]).max()
        assert np.abs(exact.d_sensors[name] - implicit.d_sensors[name])[settled].max() < 0.02 * scale, name


@pytest.mark.parametrize("effect", [None, *[e.name for e in BUILT_IN if e.parameters]])
def test_every_sensitivity_equals_high_order_differences(lab_press, make_run, coefficients, moments, effect):
    model = ThermalModel.of(lab_press, [effect] if effect else [])
    run = make_run(every=0.5)
    case = model.prepare(run, moments, fineness=0.5)
    values = with_typical(model, coefficients)
    for e in model.effects:  # differences need room on both sides
        values |= {e.key(p.name): 0.5 * (p.lower + p.upper) for p in e.parameters if p.typical == p.least}
    own = tuple(n for n in model.parameter_names if effect is None or "." in n)
    # a shift of time moves kinks across steps, and is checked on fine steps below
    names = own + tuple(n for n in NUISANCES if n not in ("closed_s", "opened_s", "ramp_s", "opening_ramp_s"))
    if effect == "clock_offset":
        names = tuple(n for n in names if n != "clock_offset.seconds")
    solution = model.solve(case, values, names)
    for name in names:
        unit = 1e-4 if "resistance" in name else 0.1 if name in PANEL_SHARES else 1.0  # of what matters
        step = 1e-3 * max(abs(values.get(name, 0.0)), unit)

        def at(shift, name=name):
            moved = model.solve(case, values | {name: values.get(name, 0.0) + shift})
            return np.column_stack([moved.sensors, moved.core])

        difference = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)
        tangent = np.column_stack([solution.d_sensors[name], solution.d_core[name]])
        assert np.abs(tangent - difference).max() < 2e-5 * np.abs(difference).max() + 1e-12, name


def test_tangents_of_the_exact_solver_are_as_good_as_it_says(lab_press, make_run, coefficients, moments):
    model = ThermalModel.of(lab_press)
    case = model.prepare(make_run(noise=0.1), moments)
    names = model.parameter_names
    solution = model.solve(case, coefficients, names, method="exact")
    t = case.run.time_s
    settled = np.ones(len(t), dtype=bool)
    for moment in (moments.inserted_s, moments.closed_s, moments.opened_s, moments.removed_s):
        settled &= (t < moment - 0.25) | (t > moment + 0.45)
    for name in names:
        step = 1e-3 * coefficients[name]

        def at(shift, name=name):
            moved = model.solve(case, coefficients | {name: coefficients[name] + shift}, method="exact")
            return np.column_stack([moved.sensors, moved.core])

        difference = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)
        tangent = np.column_stack([solution.d_sensors[name], solution.d_core[name]])
        assert np.abs(tangent - difference)[settled].max() < 0.004 * np.abs(difference).max(), name


@pytest.mark.parametrize("method", ["implicit", "exact"])
@pytest.mark.parametrize("name", ["closed_s", "opened_s", "ramp_s", "opening_ramp_s", "inserted_s"])
def test_sensitivities_to_moments_equal_differences_on_fine_steps(
    lab_press, make_run, coefficients, moments, method, name
):
    model = ThermalModel.of(lab_press)
    case = model.prepare(make_run(every=0.5), moments, fineness=0.5, switch_step_s=0.004, growth=1.05)
    solution = model.solve(case, coefficients, (name,), method=method)

    def at(shift):
        moved = model.solve(case, coefficients | {name: shift})
        return np.column_stack([moved.sensors, moved.core])

    step = 0.01
    difference = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)
    tangent = np.column_stack([solution.d_sensors[name], solution.d_core[name]])
    t = case.run.time_s
    settled = np.ones(len(t), dtype=bool)
    for moment in (moments.inserted_s, moments.closed_s, moments.opened_s, moments.removed_s):
        settled &= (t < moment - 0.3) | (t > moment + 0.4)
    assert np.abs(difference[settled]).max() > 0.1
    assert np.abs(tangent - difference)[settled].max() < 0.005 * np.abs(difference[settled]).max()


def test_clock_offset_shifts_readings_by_their_slope(lab_press, make_run, coefficients, moments):
    model = ThermalModel.of(lab_press, ["clock_offset"])
    case = model.prepare(make_run(), moments)
    name = "clock_offset.seconds"
    solution = model.solve(case, coefficients | {name: 0.0}, (name,))
    later = model.solve(case, coefficients | {name: 0.001}).sensors
    earlier = model.solve(case, coefficients | {name: -0.001}).sensors
    t = case.run.time_s
    smooth = (t > 22.0) & (t < 79.0)
    difference = ((later - earlier) / 0.002)[smooth]
    # compared in the mean: a row on a step edge sees either side of it
    error = np.abs(solution.d_sensors[name][smooth] - difference)
    assert np.median(error) < 1e-3 * np.abs(difference).max()


@pytest.mark.parametrize("thickness", [8.0, 16.0, 19.0])
@pytest.mark.parametrize("contact", [100.0, 700.0, 2000.0])
def test_default_mesh_and_steps_are_within_their_stated_error(
    lab_press, make_run, coefficients, moments, thickness, contact
):
    model = ThermalModel.of(lab_press)
    run = make_run(**{"panel.thickness_mm": thickness})
    values = coefficients | {"h_pp_c": contact}
    error = np.abs(
        model.solve(model.prepare(run, moments), values).places
        - model.solve(model.prepare(run, moments, fineness=6.0), values).places
    )
    t = run.time_s
    settled = np.ones(len(t), dtype=bool)
    for moment in (moments.inserted_s, moments.closed_s, moments.opened_s, moments.removed_s):
        settled &= (t < moment - 0.25) | (t > moment + 0.4)
    assert error[settled, -1].max() < 0.055, "core"
    assert error[settled].max() < 0.06, "faces"
    assert np.sqrt(np.mean(error[settled] ** 2)) < 0.03


@pytest.mark.parametrize(("thickness", "contact", "percent"), [(19.0, 700.0, 6.0), (8.0, 2000.0, 2.0)])
def test_default_mesh_and_steps_are_within_their_stated_error_with_evaporation(
    lab_press, make_run, coefficients, moments, thickness, contact, percent
):
    model = ThermalModel.of(lab_press, ["moisture_evaporation"])
    run = make_run(**{"panel.thickness_mm": thickness})
    values = model.guesses | coefficients | {"h_pp_c": contact, "moisture_evaporation.moisture_percent": percent}
    error = np.abs(
        model.solve(model.prepare(run, moments), values).places
        - model.solve(model.prepare(run, moments, fineness=6.0), values).places
    )
    t = run.time_s
    settled = np.ones(len(t), dtype=bool)
    for moment in (moments.inserted_s, moments.closed_s, moments.opened_s, moments.removed_s):
        settled &= (t < moment - 0.25) | (t > moment + 0.4)
    first = (t > moments.closed_s) & (t < moments.closed_s + 1.2)
    assert error[settled, -1].max() < 0.1, "core"
    assert error[settled].max() < 0.45, "faces, in the first second"
    assert error[settled & ~first].max() < 0.15, "faces, later"


@pytest.mark.parametrize(
    ("effect", "rms_K"),
    [
        ("moisture_evaporation", 0.01),
        ("vapour_convection", 0.01),
        ("resin_cure", 0.015),  # within 0.08 mm of the faces
        ("conductivity_temperature", 0.01),
        ("open_radiation", 0.01),
    ],
)
def test_steps_of_half_a_second_are_enough_for_nonlinear_effects(lab_press, make_run, coefficients, effect, rms_K):
    model = ThermalModel.of(lab_press, [effect])
    run = make_run(end=50.0)
    values = with_typical(model, coefficients)
    coarse = model.solve(model.prepare(run, SHORT, fineness=0.5, max_step_s=0.5), values).places
    error = np.abs(coarse - model.solve(_refined(model, run), values).places)
    t = run.time_s
    settled = np.ones(len(t), dtype=bool)
    for moment in (SHORT.inserted_s, SHORT.closed_s, SHORT.opened_s, SHORT.removed_s):
        settled &= (t < moment - 0.3) | (t > moment + 0.7)
    # the steps' error alone: both solve the same cells; `fineness` 0.5 doubles the fine steps
    assert error[settled].max() < 0.06, (error[settled].max(), t[settled][error[settled].max(axis=1).argmax()])
    assert np.sqrt(np.mean(error[settled] ** 2)) < rms_K


def test_heat_taken_by_evaporation_is_latent_heat_times_water(make_rig):
    toml = """
[[layer]]
name = "panel"
from_run = true
[initial]
kind = "sensors"
"""
    header = {
        "panel.material": "MDF", "panel.thickness_mm": 16.0, "panel.moisture_percent": 8.0,
        "panel.initial_temperature_C": 20.0,
    }  # fmt: skip
    time_s = np.arange(0.0, 60.05, 0.5)
    model, run = make_rig(toml, time_s, {}, {"a": '"panel.bottom"', "b": '"panel.top"'}, **header)
    run.columns["a"][0], run.columns["b"][0] = 60.0, 190.0
    wet = ThermalModel.of(model.press, ["moisture_evaporation"])
    case = wet.prepare(run, Moments())
    solution = wet.solve(case, wet.guesses, fields=True)
    rho_c = 740.0 * 1550.0
    lost = (solution.fields[0] - solution.fields[-1]) @ case.mesh.dx * rho_c
    water = 0.03 * 740.0 / 1.08 * (solution.final.done[0] @ case.mesh.dx)
    assert 0.1 < solution.final.done.mean() < 0.9
    assert lost == pytest.approx(2.4e6 * water, rel=1e-10)


def test_cured_resin_gave_off_all_its_heat(make_rig):
    toml = '[[layer]]\nname = "panel"\nfrom_run = true\n[initial]\nkind = "uniform"\ntemperature_C = 150.0\n'
    header = {"panel.material": "MDF", "panel.thickness_mm": 16.0, "panel.initial_temperature_C": 20.0}
    model, run = make_rig(toml, np.arange(0.0, 600.5, 1.0), {}, {"a": '"panel.bottom"'}, **header)
    hot = ThermalModel.of(model.press, ["resin_cure"])
    case = hot.prepare(run, Moments())
    fields = hot.solve(case, {"resin_cure.heat_kJ_m2": 15.0}, fields=True).fields
    gained = (fields[-1] - fields[0]) @ case.mesh.dx * 740.0 * 1550.0
    assert gained == pytest.approx(2 * 15.0e3, rel=1e-4)


HEATED = """
[[layer]]
name = "panel"
from_run = true
[initial]
kind = "uniform"
temperature_C = 20.0
[boundary.top]
kind = "flux"
incident_W_m2 = 500.0
coefficient = "h"
[coefficients.h]
guess = 0.01
lower = 0.001
upper = 1.0
"""


def test_hours_of_steady_heat_take_few_steps_and_stay_on_the_closed_form(make_rig):
    """Carslaw & Jaeger, 2nd ed., Sec. 3.8: one face heated, the other insulated, no loss."""
    header = {"panel.material": "MDF", "panel.thickness_mm": 16.0, "panel.initial_temperature_C": 20.0}
    model, run = make_rig(HEATED, np.arange(0.0, 7200.5, 10.0), {}, {"a": '"panel.bottom"'}, **header)
    case = model.prepare(run, Moments())
    alpha, n = 0.12 / (740.0 * 1550.0), np.arange(1, 200)[:, None]
    fourier = alpha * run.time_s / 0.016**2
    series = np.sum((-1.0) ** n / n**2 * np.exp(-((n * np.pi) ** 2) * fourier), axis=0)
    rise = 500.0 * 0.016 / 0.12 * (fourier - 1.0 / 6.0 - 2.0 / np.pi**2 * series)
    assert model.solve(case, {"h": 0.0}).places[:, 0] - 20.0 == pytest.approx(rise, abs=0.03)
    assert len(case.h) < 2000


@pytest.mark.parametrize("own", [0.0, 0.5, 0.95])
def test_cure_at_one_temperature_is_its_closed_form_however_long_the_steps(make_rig, own):
    toml = '[[layer]]\nname = "panel"\nfrom_run = true\n[initial]\nkind = "uniform"\ntemperature_C = 130.0\n'
    header = {"panel.material": "MDF", "panel.thickness_mm": 16.0, "panel.initial_temperature_C": 20.0}
    model, run = make_rig(toml, np.arange(0.0, 60.5, 1.0), {}, {"a": '"panel.bottom"'}, **header)
    hot = ThermalModel.of(model.press, ["resin_cure"])
    # so little heat that the panel stays as warm as it is; half cured, it cures by 3 % a second
    given = {"resin_cure.heat_kJ_m2": 1e-9, "resin_cure.temperature_C": 130.0, "resin_cure.autocatalysis": own}
    for step_s in (0.5, 20.0):
        done = hot.solve(hot.prepare(run, Moments(), max_step_s=step_s), given).final.done[0]
        left = np.exp(-2.0 * 0.03 / (1.0 - 0.5 * own) * 60.0)
        assert done[[0, -1]] == pytest.approx((1.0 - own) * (1.0 - left) / (1.0 - own + own * left), rel=1e-9)


def test_neutral_effects_change_nothing(lab_press, make_run, coefficients, moments):
    run = make_run(every=0.5)
    plain = ThermalModel.of(lab_press)
    expected = plain.solve(plain.prepare(run, moments, fineness=0.5), coefficients).sensors
    for effect in BUILT_IN:
        if effect.layers:
            continue
        model = ThermalModel(lab_press, (effect,))
        case = model.prepare(run, moments, fineness=0.5, max_step_s=0.5)  # the plain model's steps
        solution = model.solve(case, coefficients)
        # nonlinear models renew their coefficients every step: the same to rounding
        assert np.abs(solution.sensors - expected).max() < 1e-6, effect.name


def test_states_follow_the_moments(lab_press, make_run, moments):
    model = ThermalModel.of(lab_press)
    case = model.prepare(make_run(), moments)
    found = states(case)
    at = dict(zip(np.round(case.run.time_s, 1).tolist(), found, strict=True))
    assert [at[t] for t in (4.0, 10.0, 40.0, 100.0, 160.0)] == ["idle", "open", "closed", "open", "idle"]


def test_a_missing_coefficient_is_named(lab_press, make_run, coefficients, moments):
    model = ThermalModel.of(lab_press)
    del coefficients["h_wa"]
    with pytest.raises(InputError, match="coefficient h_wa is missing"):
        model.solve(model.prepare(make_run(end=30.0), moments), coefficients)


@pytest.mark.parametrize(
    ("effect", "value"), [("thermocouple_lag.time_constant_s", 0.5), ("clock_offset.seconds", 0.3)]
)
@pytest.mark.parametrize("every", [0.5, 2.0])
def test_late_channels_read_the_same_with_and_without_tangents(
    lab_press, make_run, coefficients, moments, effect, value, every
):
    model = ThermalModel.of(lab_press, [effect.partition(".")[0]])
    case = model.prepare(make_run(end=120.0, every=every), moments)
    values = coefficients | {effect: value}
    plain, derived = (model.solve(case, values, n, method="exact").sensors for n in ((), ("h_pp_c",)))
    assert np.abs(plain - derived).max() < 0.01


@pytest.mark.parametrize(
    ("every", "short"),
    [(2.0, Moments(1.9, 6.4, 28.3, 41.4, ramp_s=0.8)), (0.5, Moments(0.0, 1.04, 14.36, ramp_s=0.5))],
)
@pytest.mark.parametrize("names", [(), ("h_p_c",)])
def test_the_exact_solver_takes_moments_that_lie_close_together(
    lab_press, make_run, coefficients, every, short, names
):
    model = ThermalModel.of(lab_press)
    case = model.prepare(make_run(end=60.0, every=every), short)
    exact = model.solve(case, coefficients, names, method="exact").core
    assert np.abs(exact - model.solve(case, coefficients).core).max() < 0.01


def test_steam_that_lifts_a_thin_panel_over_the_boiling_point_is_within_its_stated_error(
    lab_press, make_run, coefficients
):
    moments = Moments(inserted_s=5.0, closed_s=15.3, opened_s=65.2, ramp_s=0.4)
    run = make_run(end=70.0, every=0.25, **{"panel.thickness_mm": 8.0})
    model = ThermalModel.of(lab_press, ["vapour_convection"])
    values = coefficients | {"vapour_convection.W_m3K": 1.5e4}
    found = model.solve(model.prepare(run, moments), values).core
    fine = model.solve(model.prepare(run, moments, max_step_s=0.02), values).core
    assert found.max() > 105.0
    assert np.abs(found - fine).max() < 0.01


def test_once_steam_has_brought_the_core_to_the_boiling_point_its_strength_matters_little(
    lab_press, make_run, coefficients
):
    moments = Moments(inserted_s=5.0, closed_s=15.3, opened_s=135.2, ramp_s=0.4)
    run = make_run(end=140.0, every=0.25, **{"panel.thickness_mm": 12.0})
    model = ThermalModel.of(lab_press, ["vapour_convection"])
    name, strength = "vapour_convection.W_m3K", 1.5e4
    strides = model.prepare(run, moments, max_step_s=2.0)  # those of a look ahead
    found = model.solve(strides, coefficients | {name: strength}, (name,))
    steps = model.prepare(run, moments, max_step_s=0.05)
    more, less = (model.solve(steps, coefficients | {name: f * strength}).core for f in (1.02, 0.98))
    change_K, tangent_K = (more - less) / 0.04, strength * found.d_core[name]
    boils = np.minimum(more, less) > 100.0
    assert boils.sum() > 40
    assert change_K.max() > 15.0, "while steam brings it there, stronger steam is sooner there"
    assert np.abs(change_K[boils]).max() < 10.0
    assert np.abs(tangent_K - change_K)[boils].max() < 2.0
