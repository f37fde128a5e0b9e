"""The virtual press against closed forms and conservation laws."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import erfcx

from daq.records import Panel
from daq.simulated import physics_kernel as kernel
from daq.simulated.physics import solve
from daq.simulated.physics_mesh import LATENT_HEAT, build_knobs, build_mesh, first_state
from daq.simulated.physics_pressing import DryingLaw, OutsideFault, Platen, Plates, Pressing

TIMES = np.arange(5.0, 139.0, 0.1)
NOTHING = 1e-9
STEEL = Plates()


def constant_platen(temperature_C):
    return Platen(0.0, 1e4, np.full(2, temperature_C))


def nominal_panel(thickness: float = 0.016, initial_temperature: float = 20.8) -> Panel:
    """Return an MDF panel with the constants of the contract's example."""
    return Panel("MDF", thickness, 740.0, 0.12, 1550.0, initial_temperature, 8.0)


def pressing(**changes: object) -> Pressing:
    hot = constant_platen(200.0)
    return replace(Pressing(nominal_panel(), 23.0, hot, hot, 0.0, 140.0, 5.0, 20.0, 80.0), **changes)


def closed_for_long(seconds: float = 6000.0, **changes: object) -> Pressing:
    low, high = constant_platen(200.0), constant_platen(180.0)
    base = Pressing(nominal_panel(0.008), 23.0, low, high, 0.0, seconds, 0.0, 1.0, closing_ramp=0.2)
    return replace(base, **changes)


def test_two_thick_bodies_in_contact_follow_the_closed_form() -> None:
    h = 700.0
    only = dict(h_p_o=NOTHING, h_p_c=NOTHING, h_pp_o=NOTHING, h_pp_c=h, h_wa=NOTHING, h_ap=NOTHING)
    warm = constant_platen(200.0)
    p = Pressing(
        nominal_panel(), 23.0, warm, warm, 0.0, 0.4, 0.0, 0.05, closing_ramp=1e-4,
        coefficients=only, effects={},
    )  # fmt: skip
    plates = np.full(400, 200.0)
    mesh_size = len(solve(p, "accurate").plates[0])
    s = solve(p, "accurate", (plates[:mesh_size], plates[:mesh_size]))
    t = np.linspace(0.06, 0.4, 50)
    panel = p.panel
    e2 = np.sqrt(panel.conductivity * panel.density * panel.heat_capacity)
    e1 = np.sqrt(STEEL.conductivity * STEEL.stored)
    beta = h * (e1 + e2) / (e1 * e2)
    start = panel.initial_temperature
    rise = 1.0 - erfcx(beta * np.sqrt(t - 0.05))
    expected = start + (200.0 - start) * e1 / (e1 + e2) * rise
    assert np.abs(s.at("panel_top", t) - expected).max() < 0.05
    assert np.abs(s.at("panel_bottom", t) - expected).max() < 0.05
    plate = 200.0 - (200.0 - start) * e2 / (e1 + e2) * rise
    assert np.abs(s.at("plate_top", t) - plate).max() < 0.02


def test_a_long_pressing_ends_in_the_steady_profile_of_series_resistances() -> None:
    p = closed_for_long()
    s = solve(p)
    h = p.coefficients
    resistances = [1 / h["h_p_c"], STEEL.resistance, 1 / h["h_pp_c"], 0.008 / 0.12]
    resistances += resistances[2::-1]
    flux = 20.0 / sum(resistances)
    assert s.steps["panel_bottom"][-1] == pytest.approx(200.0 - flux * sum(resistances[:3]), abs=0.01)
    assert s.steps["core"][-1] == pytest.approx(190.0, abs=0.01)
    assert s.steps["plate_top"][-1] == pytest.approx(180.0 + flux * sum(resistances[5:]), abs=0.01)


def test_conductivity_rising_with_temperature_bends_the_profile_as_kirchhoff_says() -> None:
    sure = dict(h_p_o=1e6, h_p_c=1e6, h_pp_o=1e6, h_pp_c=1e6, h_wa=10.0, h_ap=10.0)
    p = closed_for_long(
        platen_bottom=constant_platen(200.0),
        platen_top=constant_platen(40.0),
        coefficients=sure,
        effects={"conductivity_temperature": {"per_100_K": 0.3}},
    )
    s = solve(p)
    low, high = s.steps["panel_bottom"][-1], s.steps["panel_top"][-1]

    def potential(T: float) -> float:
        return T + 0.5 * 0.003 * (T - 20.0) ** 2

    assert potential(s.steps["core"][-1]) == pytest.approx(0.5 * (potential(low) + potential(high)), abs=0.02)


def test_an_edge_loss_makes_the_steady_profile_a_hyperbolic_cosine() -> None:
    sure = dict(h_p_o=1e6, h_p_c=1e6, h_pp_o=1e6, h_pp_c=1e6, h_wa=10.0, h_ap=10.0)
    hot = constant_platen(200.0)
    p = closed_for_long(
        platen_bottom=hot, platen_top=hot, coefficients=sure, effects={"edge_loss": {"W_m3K": 1500.0}}
    )
    s = solve(p)
    face = s.steps["panel_top"][-1]
    expected = 23.0 + (face - 23.0) / np.cosh(np.sqrt(1500.0 / 0.12) * 0.004)
    assert s.steps["core"][-1] == pytest.approx(expected, abs=0.01)


def test_an_idle_press_stays_steady() -> None:
    p = pressing(inserted=200.0, closed=300.0, opened=400.0, removed=500.0)
    s = solve(p)
    for plate in ("plate_top", "plate_bottom"):
        assert np.ptp(s.steps[plate]) < 1e-6
    h = p.coefficients
    flux = (200.0 - 23.0) / (1 / h["h_p_o"] + STEEL.resistance + 1 / h["h_ap"])
    assert s.steps["plate_top"][0] == pytest.approx(23.0 + flux / h["h_ap"], abs=1e-6)


def test_the_integrator_agrees_with_scipy_on_the_same_equations() -> None:
    effects = {
        "moisture_evaporation": {"moisture_percent": 4.0, "temperature_C": 100.0},
        "vapour_convection": {"W_m3K": 1.5e4},
        "conductivity_temperature": {"per_100_K": 0.2},
        "heat_capacity_temperature": {"per_100_K": 0.2},
        "resin_cure": {"heat_kJ_m2": 15.0},
        "contact_buildup": {"deficit": 0.5, "time_constant_s": 6.0},
        "thermocouple_lag": {"time_constant_s": 0.4},
    }
    p = pressing(effects=effects, panel=nominal_panel(0.004), inserted=0.0, closed=0.5, closing_ramp=0.9, end=12.0)
    mesh = build_mesh(p, "fast")
    knobs, y = build_knobs(p, mesh), first_state(p, mesh, None)
    n, m = len(y.T), len(y.w)
    flow, d = kernel.Flow(np.empty(n + 1), np.empty(n)), kernel.NodeState(np.empty(n), np.empty(m), np.empty(5))

    def rates(t: float, v: np.ndarray, middle: float) -> np.ndarray:
        now = kernel.NodeState(v[:n].copy(), v[n : n + m].copy(), v[n + m :].copy())
        kernel.slope(kernel.Instant(t, middle), now, knobs, mesh.stack, flow, d)
        return np.concatenate((d.T, d.w, d.x))

    v = np.concatenate((y.T, y.w, y.x))
    for a, b in ((0.0, 0.05), (0.05, 0.5), (0.5, 0.95), (0.95, 12.0)):
        with np.errstate(invalid="ignore", over="ignore"):  # SciPy subtracts a row it never filled
            found = solve_ivp(rates, (a, b), v, "BDF", rtol=1e-6, atol=1e-5, args=(0.5 * (a + b),))
        v = found.y[:, -1]
    s = solve(p)
    expected = v[mesh.stack.first], v[mesh.stack.last], v[mesh.stack.first + m // 2], v[n + m + 3], v[n + m + 4]
    names = ("panel_bottom", "panel_top", "core", "sensor_bottom", "sensor_top")
    assert [s.steps[name][-1] for name in names] == pytest.approx(expected, abs=0.01)
    assert s.steps["water"][-1] == pytest.approx(mesh.stack.latent @ v[n : n + m], rel=2e-3)


def balance(s: object) -> float:
    """Enthalpy gained beyond the heat that came in, over the whole pressing. [J/m²]"""
    steps = s.steps  # type: ignore[attr-defined]
    gained = steps["enthalpy"][-1] - steps["enthalpy"][0]
    return float(gained - (steps["external_heat"][-1] - steps["external_heat"][0]))


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"conductivity_temperature": {"per_100_K": 0.25}, "heat_capacity_temperature": {"per_100_K": 0.25}},
        {"density_profile": {"amplitude": 0.3}, "conductivity_offset": {"ratio": 0.85}},
        {"vapour_convection": {"W_m3K": 2e4}},
        {"open_radiation": {"emissivity": 0.7}, "contact_buildup": {"deficit": 0.6, "time_constant_s": 6.0}},
        {"edge_loss": {"W_m3K": 2000.0}, "contact_asymmetry": {"ratio": 0.7}},
        {"paper_layer": {"resistance_m2K_W": 5e-4, "capacity_J_m2K": 500.0}, "contact_load": {"exponent": 0.8}},
        {"initial_press_state": {"offset_K": 8.0}, "thermocouple_lag": {"time_constant_s": 0.5}},
    ],
)
def test_heat_is_neither_made_nor_lost(effects: dict[str, dict[str, float]]) -> None:
    taken = 3e6  # what the panel takes up, J/m²
    assert abs(balance(solve(pressing(effects=effects, pressure=300.0)))) < 2e-5 * taken


def test_evaporated_water_times_its_latent_heat_is_the_missing_enthalpy() -> None:
    effect = {"moisture_evaporation": {"moisture_percent": 4.0, "temperature_C": 100.0}}
    for law in get_args(DryingLaw):
        s = solve(pressing(effects=effect, drying_law=law))
        water = s.steps["water"]
        assert water[0] == pytest.approx(LATENT_HEAT * 0.04 * 740.0 * 0.016, rel=1e-9)
        assert balance(s) == pytest.approx(water[-1] - water[0], rel=2e-3)
        assert np.diff(water).max() < 1e-6 * water[0]
        assert 0.1 < water[-1] / water[0] < 0.9


def test_water_does_not_come_back_when_the_panel_cools() -> None:
    effect = {"moisture_evaporation": {"moisture_percent": 4.0, "temperature_C": 100.0}}
    s = solve(pressing(effects=effect, panel=nominal_panel(0.008), end=600.0))
    assert s.steps["water"][-1] < 0.01 * s.steps["water"][0]
    assert s.steps["panel_top"][-1] < s.steps["panel_top"].max() - 30.0


def test_the_resin_gives_its_heat_once() -> None:
    effect = {"resin_cure": {"heat_kJ_m2": 15.0}}
    s = solve(pressing(effects=effect, end=400.0, opened=380.0))
    assert s.steps["cured"][-1] == pytest.approx(1.0, abs=1e-3)
    assert balance(s) == pytest.approx(2 * 15e3 * s.steps["cured"][-1], rel=1e-3)


def test_steam_only_moves_heat_from_the_faces_to_the_core() -> None:
    plain, steam = solve(pressing()), solve(pressing(effects={"vapour_convection": {"W_m3K": 1.5e4}}))
    assert steam.at("core", TIMES).max() - plain.at("core", TIMES).max() > 3.0
    assert abs(balance(steam)) < 50.0
    before = TIMES < 25.0
    assert np.abs(steam.at("core", TIMES) - plain.at("core", TIMES))[before].max() < 0.5


def test_condensing_steam_gives_back_as_much_as_it_took() -> None:
    fault = OutsideFault(wet_heat=30e3, wet_release=30.0, wet_return=60.0)
    s = solve(pressing(outside=fault))
    assert abs(balance(s)) < 100.0


def test_radiation_alone_heats_the_panel_by_stefan_and_boltzmann() -> None:
    only = dict(h_p_o=800.0, h_p_c=800.0, h_pp_o=NOTHING, h_pp_c=NOTHING, h_wa=NOTHING, h_ap=NOTHING)
    p = pressing(
        coefficients=only,
        effects={"open_radiation": {"emissivity": 0.6}},
        inserted=0.0,
        closed=500.0,
        opened=600.0,
    )
    s = solve(p)
    t = np.linspace(0.0, 139.0, 20001)
    kelvin = (s.at("plate_top", t) + 273.15) ** 4 - (s.at("panel_top", t) + 273.15) ** 4
    expected = 0.6 * 5.670374419e-8 * np.trapezoid(kelvin, t) / (740.0 * 1550.0 * 0.016)
    assert s.at("panel_mean", t)[-1] - 20.8 == pytest.approx(expected, rel=1e-4)


def test_a_lagging_thermocouple_is_the_first_order_answer_to_the_face() -> None:
    s = solve(pressing(effects={"thermocouple_lag": {"time_constant_s": 0.5}}))
    t = np.arange(15.0, 100.0, 0.001)
    face = s.at("panel_top", t)
    slow = np.empty_like(face)
    slow[0], a = face[0], np.exp(-0.001 / 0.5)
    slow[0] = s.at("sensor_top", t[:1])[0]
    for i in range(1, len(t)):
        slow[i] = a * slow[i - 1] + (1 - a) * 0.5 * (face[i] + face[i - 1])
    assert np.abs(slow - s.at("sensor_top", t)).max() < 0.02


def test_a_footprint_mixes_in_the_plate_only_while_closed() -> None:
    s = solve(pressing(effects={"thermocouple_footprint": {"weight": 0.1}}))
    closed, opened = np.array([50.0]), np.array([100.0])
    mixed = 0.9 * s.at("panel_top", closed) + 0.1 * s.at("plate_top", closed)
    assert s.at("sensor_top", closed) == pytest.approx(mixed, abs=0.01)
    assert s.at("sensor_top", opened) == pytest.approx(s.at("panel_top", opened), abs=1e-9)


def test_thicker_plates_keep_their_heat_longer() -> None:
    effect = {"initial_press_state": {"offset_K": 10.0}}
    left = []
    for plates in (Plates(), Plates(thickness=0.02)):
        p = pressing(plates=plates, inserted=200.0, closed=300.0, opened=400.0, removed=500.0, end=60.0)
        still = solve(p).at("plate_top", np.array([60.0]))
        warm = solve(replace(p, effects=effect)).at("plate_top", np.array([60.0]))
        left.append(float((warm - still)[0]) / 10.0)
    # a lump would keep exp(-60 s (h_p_o + h_ap) / C): 0.28 and 0.53
    assert left[0] == pytest.approx(0.28, abs=0.05)
    assert left[1] == pytest.approx(0.55, abs=0.07)


def test_load_and_asymmetry_scale_the_closed_contact() -> None:
    p = pressing(effects={"contact_load": {"exponent": 0.7}}, pressure=280.0)
    h = dict(p.coefficients) | {"h_pp_c": 700.0 * 0.8**0.7}
    same = solve(pressing(coefficients=h))
    assert solve(p).at("core", TIMES) == pytest.approx(same.at("core", TIMES), abs=1e-3)
    lopsided = solve(closed_for_long(effects={"contact_asymmetry": {"ratio": 0.5}}))
    coefficients = dict(p.coefficients)
    flux = coefficients["h_p_c"] * (200.0 - lopsided.steps["plate_bottom"][-1])
    flux /= 1 + coefficients["h_p_c"] * STEEL.resistance
    upper = lopsided.steps["panel_top"][-1] - lopsided.steps["plate_top"][-1]
    assert flux / upper == pytest.approx(350.0, rel=2e-3)


def test_a_density_profile_keeps_the_panels_mass() -> None:
    hot = constant_platen(200.0)
    for amplitude in (0.0, 0.3):
        p = closed_for_long(
            platen_bottom=hot, platen_top=hot, effects={"density_profile": {"amplitude": amplitude}}
        )
        s = solve(p, "accurate") if amplitude else solve(p)
        gained = s.steps["enthalpy"][-1] - s.steps["enthalpy"][0]
        if not amplitude:
            plain = gained
    assert gained == pytest.approx(plain, rel=2e-4)


@pytest.mark.parametrize(
    ("name", "parameters", "core_K"),
    [
        ("vapour_convection", {"W_m3K": 1.5e4}, 6.5),
        ("moisture_evaporation", {"moisture_percent": 4.0, "temperature_C": 100.0}, -5.3),
        ("edge_loss", {"W_m3K": 1400.0}, -4.1),
        ("conductivity_temperature", {"per_100_K": 0.2}, 3.6),
        ("density_profile", {"amplitude": 0.22}, 2.4),
        ("heat_capacity_temperature", {"per_100_K": 0.2}, -1.6),
        ("resin_cure", {"heat_kJ_m2": 15.0}, 0.25),
    ],
)
def test_effects_reach_the_core_with_sign_and_size_of_an_independent_check(
    name: str, parameters: dict[str, float], core_K: float
) -> None:
    # facts on the thermal model, section 6: another press program at 200 °C, 16 mm, 60 s
    change = solve(pressing(effects={name: parameters})).at("core", TIMES) - solve(pressing()).at("core", TIMES)
    most = change[np.abs(change).argmax()]
    assert np.sign(most) == np.sign(core_K)
    assert 0.3 < most / core_K < 2.7


def test_a_lapsing_contact_cools_the_upper_face_and_only_it_at_first() -> None:
    fault = OutsideFault(lapse_drop=0.5, lapse_from=40.0, lapse_to=55.0)
    plain, lapsed = solve(pressing()), solve(pressing(outside=fault))
    t = np.array([39.9, 54.0])
    top = lapsed.at("panel_top", t) - plain.at("panel_top", t)
    bottom = lapsed.at("panel_bottom", t) - plain.at("panel_bottom", t)
    assert abs(top[0]) < 0.02
    assert top[1] < -3.0
    assert abs(bottom[1]) < 0.1


def test_a_delamination_keeps_heat_from_the_core() -> None:
    fault = OutsideFault(split_resistance=0.015, split_depth=0.0145, split_from=40.0)
    plain, split = solve(pressing()), solve(pressing(outside=fault))
    change = split.at("core", TIMES) - plain.at("core", TIMES)
    assert change.min() < -0.5
    assert np.abs(change[TIMES < 40.0]).max() < 0.01


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"effects": {"moisture_evaporation": {"moisture_percent": 5.0, "temperature_C": 100.0}}},
        {"effects": {"vapour_convection": {"W_m3K": 2e4}}, "panel": nominal_panel(0.008)},
        {"effects": {"paper_layer": {"resistance_m2K_W": 5e-4, "capacity_J_m2K": 500.0}}},
        {"effects": {"resin_cure": {"heat_kJ_m2": 20.0}}, "panel": nominal_panel(0.019), "closing_ramp": 0.2},
        {"effects": {"contact_buildup": {"deficit": 0.7, "time_constant_s": 5.0}}},
        {"outside": OutsideFault(wet_heat=30e3, wet_release=30.0, wet_return=60.0)},
    ],
)
def test_fast_and_accurate_mode_agree_within_20_millikelvin(changes: dict[str, object]) -> None:
    fast, accurate = solve(pressing(**changes)), solve(pressing(**changes), "accurate")
    for signal in ("core", "panel_top", "panel_bottom"):
        assert np.abs(fast.at(signal, TIMES) - accurate.at(signal, TIMES)).max() < 0.02, signal
