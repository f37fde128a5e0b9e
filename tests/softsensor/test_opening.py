"""Cure, steam and limits at opening against closed forms, conservation and Monte Carlo."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.stats import multivariate_normal

from daq.press.resin_file import IsoconversionalLaw, KamalLaw, LimitsTable, OrderLaw, parse_resin, read_resin
from daq.records import InputError
from softsensor.effects.resin_cure import ACTIVATION, RATE
from softsensor.live.curing import resin_remarks
from softsensor.opening.kinetics import Course, CureProgress, advance, equivalent_course, kinetics_of
from softsensor.opening.limits import Broken, Normal, PanelState, broken, either_below, opening
from softsensor.opening.steam import equilibrium_moisture, saturation_kPa, steam_pressure, steam_with_slopes

R = 8.314462618
RESINS = Path(__file__).resolve().parents[2] / "deploy" / "resins"


def cure_course(law, time_s, face_C):
    return law.cure(equivalent_course(law, time_s, face_C))


def arrhenius(rate, energy, reference_C, t_C):
    return rate * np.exp(-energy / R * (1 / (t_C + 273.15) - 1 / (reference_C + 273.15)))


@pytest.mark.parametrize("order", [0.5, 1.0, 1.7, 3.0])
def test_isothermal_cure_of_any_order_is_its_closed_form(order):
    law = kinetics_of(OrderLaw(rate_per_s=0.05, activation_energy_kJ_mol=80.0, order=order))
    t = np.linspace(0.0, 30.0, 7)
    k = arrhenius(0.05, 80e3, 140.0, 155.0)
    n = 1.0 - order
    closed = 1 - np.exp(-k * t) if order == 1.0 else 1 - np.maximum(1 - n * k * t, 0.0) ** (1 / n)
    assert cure_course(law, t, np.full(7, 155.0)) == pytest.approx(closed, abs=2e-5)


def test_isothermal_autocatalytic_cure_is_its_closed_form():
    """With both orders 1, dα/dt = (k1 + k2 α)(1 - α): α = k1 (e^u - 1) / (k1 e^u + k2), u = (k1 + k2) t."""
    numbers = dict(activation_energy_1_kJ_mol=70.0, activation_energy_2_kJ_mol=70.0)
    law = kinetics_of(KamalLaw(rate_1_per_s=0.004, rate_2_per_s=0.12, **numbers))
    t = np.linspace(0.0, 80.0, 9)
    k1, k2 = (arrhenius(k, 70e3, 140.0, 150.0) for k in (0.004, 0.12))
    e = np.exp((k1 + k2) * t)
    assert cure_course(law, t, np.full(9, 150.0)) == pytest.approx(k1 * (e - 1) / (k1 * e + k2), abs=2e-5)


def test_two_activation_energies_follow_the_differential_equation():
    numbers = dict(order_m=0.8, order_n=1.4, activation_energy_1_kJ_mol=95.0, activation_energy_2_kJ_mol=60.0)
    law = kinetics_of(KamalLaw(rate_1_per_s=0.01, rate_2_per_s=0.08, **numbers))
    t = np.linspace(0.0, 60.0, 121)
    face = 30.0 + 140.0 * (1 - np.exp(-t / 8.0))

    def rate(time, a):
        k1, k2 = (arrhenius(k, e, 140.0, np.interp(time, t, face)) for k, e in ((0.01, 95e3), (0.08, 60e3)))
        return (k1 + k2 * max(a[0], 0.0) ** 0.8) * (1 - a[0]) ** 1.4

    truth = solve_ivp(rate, (0, 60), [0.0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.2).y[0]
    assert np.abs(cure_course(law, t, face) - truth).max() < 2e-3


def test_a_table_of_a_constant_activation_energy_is_the_law_it_was_made_from():
    kelvin = 140.0 + 273.15
    at = np.linspace(0.02, 0.98, 97)
    rows = [(a, 80.0, float(np.log(0.05 * (1 - a)) + 80e3 / (R * kelvin))) for a in at]
    t = np.linspace(0.0, 60.0, 61)
    face = 100.0 + t
    one = cure_course(kinetics_of(IsoconversionalLaw(table=rows)), t, face)
    other = cure_course(kinetics_of(OrderLaw(rate_per_s=0.05, activation_energy_kJ_mol=80.0)), t, face)
    assert one == pytest.approx(other, abs=1e-3)


def test_a_prefactor_is_the_rate_it_gives_at_the_reference():
    prefactor = 0.05 * np.exp(80e3 / (R * 413.15))
    a, b = (
        kinetics_of(OrderLaw(activation_energy_kJ_mol=80.0, **rate))
        for rate in ({"prefactor_per_s": float(prefactor)}, {"rate_per_s": 0.05})
    )
    assert a.log_time == pytest.approx(b.log_time)


def test_halving_the_steps_divides_the_error_of_a_rising_course():
    law = kinetics_of(OrderLaw(rate_per_s=0.05, activation_energy_kJ_mol=80.0))
    truth = quad(lambda s: arrhenius(1.0, 80e3, 140.0, 40.0 + 6.0 * s), 0.0, 20.0)[0]
    t = np.array([0.0, 20.0])
    assert equivalent_course(law, t, 40.0 + 6.0 * t)[-1] == pytest.approx(truth, rel=1e-4)


KAMAL = KamalLaw(
    rate_1_per_s=0.01, rate_2_per_s=0.08, activation_energy_1_kJ_mol=95.0, activation_energy_2_kJ_mol=60.0,
    relative_sd=0.1, activation_energy_relative_sd=0.03,
)  # fmt: skip
ORDER = parse_resin(
    '[resin]\nname = "x"\nsource = "test"\n[order]\nrate_per_s = 0.05\nrate_per_s.sd = 0.005\n'
    "activation_energy_kJ_mol = 80\nactivation_energy_kJ_mol.sd = 2.4\n"
)


@pytest.mark.parametrize("law", [KAMAL, ORDER], ids=["kamal", "order"])
def test_the_band_of_the_linearised_cure_is_that_of_a_monte_carlo(law):
    """Course uncertain by contact (sd 12 %) and level (sd 1 K), kinetics by rate and activation energy."""
    kinetics, rng = kinetics_of(law), np.random.default_rng(7)
    t = np.linspace(0.0, 25.0, 51)

    def course(log_contact, level):
        approach = 1 - np.exp(-np.multiply.outer(np.exp(0.12 * log_contact), t) / 4.0)
        return 25.0 + (130.0 + np.multiply.outer(level, np.ones_like(t))) * approach

    z = rng.standard_normal((4, 4000))
    monte = np.log(equivalent_course(kinetics, t, course(z[0], z[1]), z[2:])[:, -1])
    base = course(np.zeros(1), np.zeros(1))
    slopes = np.stack(
        [(course(np.full(1, d), np.zeros(1)) - course(np.full(1, -d), np.zeros(1))) / (2 * d) for d in (1e-3,)]
        + [(course(np.zeros(1), np.full(1, d)) - course(np.zeros(1), np.full(1, -d))) / (2 * d) for d in (1e-3,)],
        axis=-1,
    )
    progress = CureProgress.begin(1, 2)
    for k in range(1, len(t)):
        step = Course(base[:, k - 1], base[:, k], slopes[:, k - 1], slopes[:, k], float(t[k] - t[k - 1]))
        progress = advance(kinetics, progress, step)
    x = progress.equivalent_s[0]
    sd = np.hypot(np.linalg.norm(progress.by_parameter[0]), np.linalg.norm(progress.by_error[0])) / x
    assert x == pytest.approx(equivalent_course(kinetics, t, base)[0, -1], rel=1e-6)
    assert sd == pytest.approx(monte.std(), rel=0.05)
    inside = np.abs(monte - np.log(x)) < 1.96 * sd
    assert 0.93 < inside.mean() < 0.97


def test_wood_and_water_at_the_handbooks_own_points():
    """Wood Handbook, table 4-2: 12.0 % at 21.1 °C and 65 %; its equation in °F gives 8.4 % at 140 °F and 55 %."""
    assert float(equilibrium_moisture(0.65, 21.1)) == pytest.approx(12.0, abs=0.15)
    assert float(equilibrium_moisture(0.55, 60.0)) == pytest.approx(8.4, abs=0.05)
    assert float(saturation_kPa(100.0)) == pytest.approx(101.42, abs=0.01)


def test_water_in_a_sealed_panel_is_kept_at_the_pressure_found():
    temperatures = np.array([160.0, 120.0, 80.0, 60.0, 80.0, 120.0, 160.0])
    share = np.full(7, 1 / 7)
    pressure = steam_pressure(temperatures, share, 8.0)
    held = share @ equilibrium_moisture(pressure / saturation_kPa(temperatures), temperatures)
    assert held == pytest.approx(8.0, abs=1e-9)
    assert saturation_kPa(60.0) * 0.3 < pressure < saturation_kPa(160.0)


def test_a_wetter_or_hotter_panel_holds_more_steam():
    layers = np.full(5, 0.2)
    moisture = [float(steam_pressure(np.full(5, 100.0), layers, m)) for m in (2.0, 5.0, 8.0, 12.0)]
    heat = [float(steam_pressure(np.full(5, t), layers, 8.0)) for t in (20.0, 60.0, 100.0, 119.0)]
    assert moisture == sorted(moisture)
    assert heat == sorted(heat)


def test_slopes_of_steam_are_its_differences():
    temperatures, share = np.array([118.0, 70.0, 90.0]), np.array([0.25, 0.5, 0.25])
    got = steam_with_slopes(temperatures, share, 8.0, 0.9)

    def log_p(t=temperatures, m=8.0, f=0.9):
        return float(np.log(steam_pressure(t, share, m, f)))

    for i in range(3):
        d = np.eye(3)[i] * 0.01
        assert got.by_temperature[i] == pytest.approx(
            (log_p(temperatures + d) - log_p(temperatures - d)) / 0.02, rel=1e-3
        )
    assert got.by_moisture == pytest.approx((log_p(m=8.01) - log_p(m=7.99)) / 0.02, rel=1e-3)
    ratio = (log_p(f=0.9 * np.exp(1e-3)) - log_p(f=0.9 * np.exp(-1e-3))) / 2e-3
    assert got.by_factor == pytest.approx(ratio, rel=1e-3)


def test_steam_of_a_panel_of_unknown_moisture_is_not_known():
    assert np.isnan(steam_pressure(np.full(3, 90.0), np.full(3, 1 / 3), float("nan")))


LAW = kinetics_of(ORDER)
KNOWN = Normal(np.array(100.0), np.array(1.0))
SAFE = PanelState(
    Normal(np.array(9.0), np.array(0.1)), Normal(np.array(9.0), np.array(0.1)), KNOWN, Normal(np.log(10.0), 0.1)
)


def test_what_is_not_known_counts_as_broken():
    nothing = Normal(np.array(np.nan), np.array(np.nan))
    every = LimitsTable(cure_least=0.9, core_least_C=60.0, core_most_C=120.0, steam_most_kPa=100.0)
    assert float(broken(every, LAW, SAFE).risk) < 1e-6
    for name, gone in (
        ("cure_top", PanelState(SAFE.cure_bottom, nothing, KNOWN, SAFE.steam)),
        ("core_most", PanelState(SAFE.cure_bottom, SAFE.cure_top, nothing, SAFE.steam)),
        ("steam_most", PanelState(SAFE.cure_bottom, SAFE.cure_top, KNOWN, nothing)),
    ):
        found = broken(every, LAW, gone)
        assert found.chances[name] == 1.0
        assert float(found.risk) == 1.0


def test_a_limit_of_cure_without_kinetics_counts_as_broken():
    found = broken(LimitsTable(cure_least=0.9, core_least_C=60.0), None, SAFE)
    assert (found.chances["cure_bottom"], found.chances["cure_top"], float(found.risk)) == (1.0, 1.0, 1.0)
    assert found.chances["core_least"] < 1e-6


def test_no_limit_at_all_is_no_leave_to_open():
    assert broken(LimitsTable(), LAW, SAFE) == Broken({})
    assert float(Broken({}).risk) == 1.0


@pytest.mark.parametrize("together", [-0.6, 0.0, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("limit", [-2.3, -1.0, 0.0, 0.7])
def test_one_face_or_the_other_is_undercured_as_often_as_scipys_bivariate_normal_says(together, limit):
    one, other = Normal(np.array(0.0), np.array(1.0)), Normal(np.array(0.3), np.array(0.8))
    cross = 0.8 * together
    neither = multivariate_normal([0.0, -0.3], [[1.0, cross], [cross, 0.64]]).cdf([-limit, -limit])
    assert float(either_below(limit, one, other, together)) == pytest.approx(1.0 - neither, abs=2e-5)


def test_two_faces_of_one_paper_break_the_limit_together_and_not_in_turn():
    face, limits = Normal(np.array(1.959964), np.array(1.0)), LimitsTable(cure_least=0.9)
    panels = (shifted(PanelState(face, face, KNOWN, KNOWN, together)) for together in (0.0, 1.0))
    apart, whole = (float(broken(limits, LAW, panel).risk) for panel in panels)
    assert apart == pytest.approx(1.0 - (1.0 - 0.025) ** 2, abs=1e-5)
    assert whole == pytest.approx(0.025, abs=1e-5)


def shifted(panel):
    """Return the panel with its faces' cure counted from what 90 % take."""
    least = np.log(LAW.equivalent_s(0.9))
    faces = (Normal(face.mean + least, face.sd) for face in (panel.cure_bottom, panel.cure_top))
    return PanelState(*faces, panel.core, panel.steam, panel.together)


def test_a_limit_that_waiting_breaks_ends_the_window():
    ahead = np.arange(0.0, 20.0, 4.0)
    cure = np.array([1, 0.3, 0.01, 0, 0])
    chances = {"cure_top": cure, "core_most": np.array([0, 0, 0.001, 0.01, 0.5])}
    found = opening(ahead, Broken(chances, cure), 0.975)
    assert (found.until_s, found.blocking, found.risk) == (12.0, "", pytest.approx(0.025))
    assert 4.0 < found.in_s < 8.0
    assert 0.0 < found.likely_in_s < 4.0


def test_a_window_that_never_opens_names_what_blocks_it():
    ahead = np.array([0.0, 10.0])
    cure = np.array([0.9, 0.1])
    found = opening(ahead, Broken({"cure_top": cure, "steam_most": np.array([0.2, 0.6])}, cure), 0.975)
    assert np.isnan(found.in_s)
    assert (found.blocking, found.risk) == ("steam_most", pytest.approx(0.7))


@pytest.mark.parametrize("order", [1, -1])
def test_limits_broken_for_certain_are_told_apart_by_how_far(order):
    sure = np.ones(2)
    names = ["core_least", "core_most"][::order]
    beyond = {"core_least": np.array([40.0, 30.0]), "core_most": np.array([20.0, 50.0])}
    found = opening(np.array([0.0, 4.0]), Broken(dict.fromkeys(names, sure), 0.0, beyond), 0.975)
    assert (found.blocking, found.risk, found.beyond) == ("core_least", 1.0, 40.0)


def test_the_example_cures_as_the_paper_whose_heat_a_diagnosis_looks_for():
    order = read_resin(RESINS / "melamine_formaldehyde.toml").order
    assert (order.rate_per_s, 1e3 * order.activation_energy_kJ_mol) == (RATE, ACTIVATION)


@pytest.mark.parametrize("file", sorted(RESINS.glob("*.toml")), ids=lambda f: f.stem)
def test_examples_say_that_they_are_examples_and_where_from(file):
    resin = read_resin(file)
    assert resin.resin.example
    assert not resin.resin.verified
    assert len(resin.resin.source) > 60
    law = kinetics_of(resin)
    assert law.log_rate_sd > 0
    assert law.energy_sd > 0


def test_of_a_resin_whose_numbers_nobody_compared_with_their_source_a_prediction_says_so():
    example = read_resin(RESINS / "melamine_formaldehyde.toml")
    said = {}
    for verified in (None, False, True):
        resin = example.resin.model_copy(update={"example": False, "verified": verified})
        remarks = resin_remarks(example.model_copy(update={"resin": resin}), {})
        said[verified] = [one.code for one in remarks if one.code != "resin-no-moisture"]
    assert said == {None: [], False: ["resin-not-verified"], True: []}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("rate_per_s = 0.05\n", ""), "exactly one of rate_per_s"),
        (
            ("activation_energy_kJ_mol = 80\n", "activation_energy_kJ_mol = 2\n"),
            "order.activation_energy_kJ_mol = 2",
        ),
        (("order]", "ordr]"), "did you mean order"),
        (("rate_per_s = 0.05\n", "rate_per_s = 0.05\norder = 1.5\norder.sd = 0.1\n"), "order.sd"),
        (("rate_per_s = 0.05\n", "prefactor_per_s = 1e40\n"), "order: prefactor_per_s: with its activation"),
        (("rate_per_s = 0.05\n", "prefactor_per_s = 1e-9\n"), "must lie between 1e-12 and 1e6 1/s"),
        (("[order]", "[kamal]\nrate_1_per_s = 1.0\n[order]"), "kamal"),
    ],
)
def test_a_resin_file_is_refused_with_key_and_limit(change, expected):
    text = '[resin]\nname = "x"\nsource = "y"\n[order]\nrate_per_s = 0.05\nactivation_energy_kJ_mol = 80\n'
    assert change[0] in text
    with pytest.raises(InputError) as error:
        parse_resin(text.replace(*change), "own.toml")
    assert str(error.value).startswith("own.toml: ")
    assert expected in str(error.value)


@pytest.mark.parametrize(("log_prefactor", "power"), [(900.0, "10^380.8"), (-900.0, "10^-401")])
def test_a_table_of_ones_own_dsc_with_a_rate_that_cannot_be_is_refused(log_prefactor, power):
    rows = f"[[0.1, 80.0, 20.0], [0.9, 80.0, {log_prefactor}]]"
    text = f'[resin]\nname = "x"\nsource = "y"\n[isoconversional]\ntable = {rows}\n'
    with pytest.raises(InputError) as error:
        parse_resin(text, "own.toml")
    assert str(error.value).startswith(
        "own.toml: isoconversional: table.1: with its activation energy the rate at"
    )
    assert power in str(error.value)


def test_cure_beyond_what_a_law_lays_out_is_never_reached():
    """At 140 °C 0.05 1/s cures all but e^-t/20 s: 1 - 1e-9 takes 414 s, and no answer may come sooner."""
    law = kinetics_of(OrderLaw(rate_per_s=0.05, activation_energy_kJ_mol=80.0))
    assert law.equivalent_s(1.0 - 1e-6) == pytest.approx(-np.log(1e-6) / 0.05, rel=1e-3)
    assert not law.equivalent_s(1.0 - 1e-9) < -np.log(1e-9) / 0.05


def test_limits_of_the_core_that_exclude_each_other_are_refused():
    text = (RESINS / "melamine_formaldehyde.toml").read_text(encoding="utf-8")
    wrong = text.replace("[limits]", "[limits]\ncore_least_C = 70.0\ncore_most_C = 60.0")
    with pytest.raises(InputError, match=r"core_least_C = 70 and core_most_C = 60 exclude each other"):
        parse_resin(wrong)
