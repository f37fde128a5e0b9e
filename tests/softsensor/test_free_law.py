"""What is missing as a free function, read from virtual campaigns that compute it by their own equations."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
import pytest

import softsensor
from daq.press.press_file import parse_press
from daq.records import InputError, Moments, Nonphysical
from daq.simulated.campaign import Effects, Plan, make_campaign, press_toml
from daq.simulated.physics_mesh import INNER_WIDTH
from daq.words.message import words
from softsensor.diagnosis.extended_model import model_of
from softsensor.diagnosis.extension import SharedFit
from softsensor.diagnosis.finding import Diagnosis
from softsensor.diagnosis.gains import Gain
from softsensor.diagnosis.laws import choice, fitting
from softsensor.diagnosis.laws import kinds as laws
from softsensor.diagnosis.laws.choice import Law, free_law
from softsensor.diagnosis.laws.curve import resembles
from softsensor.diagnosis.laws.fitting import STRENGTHS, FittedLaw, learned_strength
from softsensor.diagnosis.settling import SettledModel, settle_base
from softsensor.diagnosis.summary import law_messages
from softsensor.diagnosis.verdict import _screened
from softsensor.effects import find_effect
from softsensor.effects.effect import LawOf
from softsensor.effects.free_law import LENGTH, LEVEL, STRENGTH, VALUE, Smooth, depth_knots
from softsensor.fitting.simulated_run import simulate_run
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_file import FittedValue, model_text
from softsensor.heat.model_reading import parse_model
from softsensor.live.replay import replay

PRESS_S = 30.0
THIN = Plan(
    rate_hz=1.0,
    thickness_mm=8.0,
    press_time_s=(PRESS_S, PRESS_S),
    open_before_s=(5.0, 8.0),
    open_after_s=(15.0, 20.0),
)
LAPSE: Effects = {"contact_lapse": {"drop": 0.5, "from_share": 0.25, "lasts_share": 0.35}}
"""Outside the catalogue: the upper contact halves from 7.5 to 18 s after closing."""
LAPSE_FOR_GOOD: Effects = {"contact_lapse": {"drop": 0.5, "from_share": 0.4, "lasts_share": 2.0}}
STEAM: Effects = {"moisture_evaporation": {"moisture_percent": 5.0, "temperature_C": 102.0}}
STEP: Effects = {"conductivity_step": {"lost": 0.4, "temperature_C": 80.0}}
"""Outside the catalogue, about a temperature."""
LEVELLING: Effects = {"contact_levelling": {"share": 0.5}}
"""Outside the catalogue: a contact that grows with the pressure p as 1 - exp(-2 p / p_ref)."""
SEED = {"break": 24_201, "break that moments make up for": 24_207}
"""Campaigns from 24,200 on: one in which this law was always claimed, and one in which it is since 2026-11-29."""
EASED = replace(THIN, eased=(0.2, 0.5), closed_column=True)
"""Its limit switch tells the opening: by the faces alone, a contact that eases off looks like one that opens."""
GROWTH: Effects = {"contact_buildup": {"deficit": 0.7, "time_constant_s": 8.0}}


@cache
def settled(hidden: str) -> SettledModel:
    plan = EASED if hidden in ("levelling", "eased") else THIN
    press = parse_press(press_toml(loaded=plan is EASED))
    effects = {
        "levelling": LEVELLING,
        "eased": None,
        "step": STEP,
        "break": "contact_break",
        "break that moments make up for": "contact_break",
        "lapse": LAPSE,
        "lapse for good": LAPSE_FOR_GOOD,
        "steam": STEAM,
        "growth": GROWTH,
        "nothing": None,
    }[hidden]
    _, digests = _screened(press, [run for run, _ in make_campaign(SEED.get(hidden, 41), 8, effects, plan)])
    return settle_base(ThermalModel(press), digests)


@cache
def law(hidden: str) -> Law | None:
    return free_law(settled(hidden))


def test_no_law_is_claimed_where_nothing_is_hidden():
    assert law("nothing") is None


def test_a_run_that_tipped_the_choice_of_a_kind_has_the_law_that_the_others_would_choose(monkeypatch):
    """Errors fall by these logarithms; without its first run the other kind is the better one."""
    stage, tipped, even = settled("nothing"), np.array([0.9, *[0.5] * 7]), np.full(8, 0.52)
    fell = {"contact_upper": tipped, "contact_lower": even}
    kinds = [SimpleNamespace(name=name, variable="time_since_closing_s", unit="-") for name in fell]
    monkeypatch.setattr(choice, "kinds", lambda _: kinds)
    monkeypatch.setattr(choice, "held_out", lambda *_: None)
    monkeypatch.setattr(choice, "run_errors", lambda *_: np.ones(8))
    monkeypatch.setattr(choice, "curve_of", lambda _: np.zeros((0, 4)))
    monkeypatch.setattr(choice, "resembles", lambda *_: None)
    monkeypatch.setattr(choice, "_kept", lambda _: {})
    monkeypatch.setattr(
        choice, "tried", lambda _, kind: FittedLaw(kind, stage.fit, np.exp(-fell[kind.name]), readings=100)
    )
    found = free_law(stage)
    assert found.kind == "contact_upper"
    assert found.gain.value_K == pytest.approx(1.0 - np.exp(-(0.52 + 7 * 0.5) / 8), rel=1e-5)


def test_too_few_runs_tell_no_law():
    assert free_law(settled("lapse").among(np.arange(5))) is None


@pytest.mark.campaign
def test_a_contact_that_lapses_is_found_by_the_time_since_closing_and_on_its_side():
    """The virtual press breaks it off sharply, which a smooth law rounds: a second about each edge is left out."""
    found = law("lapse")
    assert found is not None
    assert (found.kind, found.variable, found.set) == ("contact_upper", "time_since_closing_s", ("contact_upper",))
    assert found.resembles is None
    assert found.gain.ci95 is not None
    assert found.gain.ci95[0] > 1.0
    x, value, _, _ = found.curve.T
    assert value[(x > 8.5) & (x < 17.0)] == pytest.approx(0.5, abs=0.06)
    assert value[x > 19.0] == pytest.approx(1.0, abs=0.16)
    true = np.where((x > 7.5) & (x < 18.0), 0.5, 1.0)
    away = (np.abs(x - 7.5) > 1.0) & (np.abs(x - 18.0) > 1.0)
    assert np.mean(inside(found, true)[away]) >= 0.7


def inside(found, true):
    """Return at which points a true curve lies in the band."""
    return (true >= found.curve[:, 2]) & (true <= found.curve[:, 3])


@pytest.mark.campaign
def test_a_contact_that_lapses_for_good_ends_below_the_other():
    """Both contacts have one coefficient in the press file: the upper one's law has a level of its own."""
    found = law("lapse for good")
    assert found is not None
    assert found.set == ("contact_upper",)
    x, value, _, _ = found.curve.T
    assert value[(x > 0.5) & (x < 10.0)] == pytest.approx(1.0, abs=0.1)  # the closing ramp lasts until then
    assert value[x > 15.0] == pytest.approx(0.5, abs=0.1)


@pytest.mark.campaign
def test_a_smooth_law_of_the_contact_lies_in_its_band_and_is_recognised():
    found = law("growth")
    assert found is not None
    assert found.kind == "contact"
    x = found.curve[:, 0]
    true = 1.0 - 0.7 * np.exp(-x / 8.0)
    true /= true[-1]
    assert np.mean(inside(found, true)) >= 0.9
    assert found.resembles == "contact_buildup"


@pytest.mark.campaign
def test_a_contact_that_follows_the_pressure_is_found_by_it():
    """The press eases off within each pressing: contacts scatter between pressings by more than pressures do."""
    found = law("levelling")
    assert found is not None
    assert found.set == ("contact_by_load",)
    x, value, _, _ = found.curve.T
    true = (1.0 - np.exp(-2.0 * x)) / (1.0 - np.exp(-2.0))
    assert np.mean(inside(found, true)) >= 0.9
    assert np.sqrt(np.mean((value - true) ** 2)) < 0.1 * np.ptp(true)
    assert law("eased") is None


@pytest.mark.campaign
def test_a_conductivity_that_steps_is_found_by_temperature():
    found = law("step")
    assert found is not None
    assert found.kind == "conductivity"
    assert len(found.set) <= 2
    x, value, _, _ = found.curve.T
    assert value[x > 100.0].mean() / value[x < 60.0].mean() == pytest.approx(0.6, abs=0.1)


@pytest.mark.campaign
@pytest.mark.parametrize("hidden", ["break", "break that moments make up for"])
def test_a_contact_that_breaks_at_a_temperature_is_found_by_it(hidden):
    found = law(hidden)
    assert found is not None
    assert found.set == ("contact_by_temperature",)
    x, value, _, _ = found.curve.T
    assert value[x < 140.0].mean() > 1.3 * value[x > 170.0].mean()


@pytest.mark.parametrize("kind", [laws.conductivity_by_temperature, laws.contact_by_temperature])
def test_a_law_of_temperature_has_the_derivatives_of_its_own_differences(kind):
    made = kind(40.0, 160.0)
    press = parse_press(press_toml())
    run, truth = make_campaign(43, 1, None, THIN)[0]
    model, name = ThermalModel(press, (made.effect,)), made.effect.key("w4")
    case = model.prepare(run, truth.moments)
    numbers = {made.effect.key(p.name): 0.3 for p in made.effect.parameters}
    up, down = (model.solve(case, model.guesses | numbers | {name: 0.3 + d}).sensors for d in (1e-4, -1e-4))
    solved = model.solve(case, model.guesses | numbers, (name,))
    assert solved.d_sensors[name] == pytest.approx((up - down) / 2e-4, abs=2e-3)
    assert np.max(np.abs(solved.d_sensors[name])) > 0.1


@pytest.mark.campaign
def test_heat_that_goes_at_the_boiling_point_is_found_by_temperature_and_recognised():
    found = law("steam")
    assert found is not None
    assert (found.kind, found.variable) == ("heat", "temperature_C")
    x, value = found.curve[:, 0], found.curve[:, 1]
    assert 90.0 < x[np.argmax(value[x < 140.0])] < 118.0
    assert found.resembles == "moisture_evaporation"


@pytest.mark.parametrize(
    "kind", ["contact_upper", "contact_by_load", "contact_by_temperature", "conductivity", "heat", "heat_exchange"]
)
def test_a_law_in_a_model_file_heats_the_panel_as_the_fitted_one_did(kind):
    made = {
        "contact_upper": laws.contact_by_time(30.0, "upper"),
        "contact_by_load": laws.contact_by_load(0.3, 1.2),
        "contact_by_temperature": laws.contact_by_temperature(40.0, 160.0),
        "conductivity": laws.conductivity_by_temperature(40.0, 160.0),
        "heat": laws.heat_by_temperature(40.0, 160.0),
        "heat_exchange": laws.exchange_by_depth(),
    }[kind]
    press = parse_press(press_toml(loaded=True))
    run, truth = make_campaign(43, 1, None, EASED)[0]
    numbers = 0.6 * np.random.default_rng(4).normal(size=len(made.effect.parameters))
    fitted = {made.effect.key(p.name): v for p, v in zip(made.effect.parameters, numbers, strict=True)}
    stored = find_effect(f"law_{kind}")
    kept = {stored.key(name): value for name, value in made.kept(numbers).items()}
    found = []
    for effect, values in ((made.effect, fitted), (stored, kept | {stored.key(STRENGTH): 1.0})):
        model = ThermalModel(press, (effect,))
        case = model.prepare(run, truth.moments)
        found.append(model.solve(case, model.guesses | values).core)
    plain = ThermalModel(press)
    without = plain.solve(plain.prepare(run, truth.moments), plain.guesses).core
    absent = model.solve(case, model.guesses | kept | {stored.key(STRENGTH): 0.0}).core
    assert found[1] == pytest.approx(found[0], abs=1e-6)
    assert np.max(np.abs(found[1] - without)) > 0.2
    assert absent == pytest.approx(without, abs=0.02)


def test_values_at_knots_are_as_alike_as_the_kernel_says_and_the_curve_goes_through_them():
    smooth = Smooth.over(2.0, 12.0, 6)
    alike = smooth.weights(smooth.knots) @ smooth.weights(smooth.knots).T
    apart = (smooth.knots[:, None] - smooth.knots[None, :]) / 2.0  # in distances of knots
    assert alike == pytest.approx(np.exp(-0.5 * (apart / LENGTH) ** 2), abs=1e-4)
    values = np.random.default_rng(1).normal(size=6)
    assert smooth.through(values)(smooth.knots) == pytest.approx(values, abs=1e-2)
    assert smooth.through(smooth.factor @ values)(np.array([3.3])) == pytest.approx(
        smooth.weights(np.array([3.3])) @ values
    )


def test_heat_that_goes_leaves_the_core_colder_by_what_was_taken():
    """A law of 400 kJ/m³K takes a third of the heat of MDF (1.1 MJ/m³K), so of the core's rise about a quarter."""
    law = find_effect("law_heat")
    press, flat = parse_press(press_toml()), {f"value_{knot}": 400.0 for knot in range(9)}
    run, truth = make_campaign(43, 1, None, THIN)[0]
    numbers = {**flat, STRENGTH: 1.0, "coldest_C": 30.0, "hottest_C": 200.0}
    model = ThermalModel(press, (law,))
    case = model.prepare(run, truth.moments)
    end = [
        model.solve(case, model.guesses | {law.key(n): v for n, v in (numbers | {STRENGTH: size}).items()}).core[
            -1
        ]
        for size in (0.0, 1.0)
    ]
    rise = end[0] - case.panel.initial_temperature
    assert 0.1 < (end[0] - end[1]) / rise < 0.4


def test_a_law_that_the_runs_drive_beyond_all_matter_is_none_and_ends_nothing(monkeypatch):
    kind = laws.contact_by_time(30.0)
    press = parse_press(press_toml())
    run, truth = make_campaign(43, 1, None, THIN)[0]
    model = ThermalModel(press, (kind.effect,))
    torn = {kind.effect.key(p.name): 400.0 * (-1) ** i for i, p in enumerate(kind.effect.parameters)}
    with pytest.raises(Nonphysical, match="lead to no finite temperatures"):
        model.solve(model.prepare(run, truth.moments), model.guesses | torn)
    monkeypatch.setattr(fitting, "from_the_others", lambda fit, data: [fit.theta + _along(fit, torn)] * len(data))
    assert fitting.tried(settled("nothing"), kind) is None


def _along(fit, torn):
    return np.array([torn.get(name, 0.0) for name in fit.layout.names])


@pytest.mark.campaign
def test_a_law_found_goes_with_the_model_to_runs_nobody_has_seen(tmp_path):
    """Faces and core of six further runs, simulated and predicted, beside the model without the law.

    Faces by the contacts that the runs really had: these scatter by more than the law is about.
    """
    found, base = law("lapse"), settled("lapse")
    assert found is not None
    press = parse_press(press_toml())
    with_law = model_of(found.stage, "", {"law_contact_upper": found.kept})
    (tmp_path / "model.json").write_text(model_text(with_law), encoding="utf-8")
    read = parse_model(json.loads((tmp_path / "model.json").read_text(encoding="utf-8")), "here")
    assert read.effects[0][0] == "law_contact_upper"
    assert read.effects[0][1] == with_law.effects[0][1]
    assert read.effects[0][1][STRENGTH].value == 1.0
    assert 0.01 < read.effects[0][1][STRENGTH].sd < 0.5
    unseen = make_campaign(41, 14, LAPSE, THIN)[8:]
    errors = {}
    for name, model in (("plain", model_of(base)), ("law", read)):
        faces, live = [], []
        for run, truth in unseen:
            out = simulate_run(run, press, model.model(press), {**model.values, **truth.coefficients})
            inside = (out.time_s >= truth.moments.closed_s) & (out.time_s < truth.moments.opened_s)
            faces.append(np.mean((out.places["panel.top"] - truth.top_C)[inside] ** 2))
            estimates = replay(press, run, model).estimates
            live += [
                (e.core_C - c, e.core_low_C <= c <= e.core_high_C)
                for e, c in zip(estimates, truth.core_C, strict=True)
                if e.valid
            ]
        errors[name] = (np.sqrt(np.mean(faces)), *np.array(live).T)
    assert errors["law"][0] < 0.6 * errors["plain"][0]
    assert len(errors["law"][1]) > 100
    assert np.mean(errors["law"][2]) >= 0.95


def test_the_strength_of_a_law_is_that_of_the_likeliest_prior():
    """Closed form: of weights measured with variance v the likeliest prior has the variance mean(a^2) - v."""
    rng = np.random.default_rng(3)
    weights, precise = 2.0 * rng.normal(size=400), 25.0
    names = tuple(f"w{i}" for i in range(400))
    fit = SimpleNamespace(
        layout=SimpleNamespace(names=names, priors=(np.zeros(400), np.ones(400))),
        theta=weights,
        hessians=(precise * np.eye(400),),
        gradients=(np.zeros(400),),
    )
    expected = np.sqrt(np.mean(weights**2) - 1.0 / precise)
    found = learned_strength(cast(SharedFit, fit), names)
    step = STRENGTHS[1] / STRENGTHS[0]
    assert expected / step < found < expected * step


def test_a_flat_curve_of_exchange_is_a_rim_loss_and_a_bent_one_is_not():
    x = np.linspace(0.0, 1.0, 33)
    flat, bent = np.full(33, 900.0), 900.0 * np.sin(2.0 * np.pi * x)
    tables = [np.stack([x, v, v - 100.0, v + 100.0], axis=1) for v in (flat, bent)]
    assert [resembles(LawOf.EXCHANGE, table) for table in tables] == ["edge_loss", None]


def test_a_law_of_contact_that_grows_is_a_buildup():
    x = np.linspace(0.0, 30.0, 33)
    v = 1.0 - 0.6 * np.exp(-x / 7.0)
    curve = np.stack([x, v, v - 0.05, v + 0.05], axis=1)
    assert resembles(LawOf.CONTACT, curve) == "contact_buildup"


@pytest.mark.parametrize(("language", "part"), [("en", "time since closing"), ("de", "Zeit seit dem Schließen")])
def test_a_law_is_told_in_words_and_as_the_contract_has_it(language, part):
    x = np.linspace(0.0, 30.0, 33)
    middle = 1.0 - 0.5 * x / 30.0
    curve = np.stack([x, middle, middle - 0.2, middle + 0.1], axis=1)
    fields = (LawOf.CONTACT, "time_since_closing_s", "-", curve, Gain(0.8, (0.5, 1.0)), ("contact", "heat"), None)
    one = Law(*fields, stage=settled("nothing"), kept={})
    found = SimpleNamespace(law=one, final=settled("nothing"), extended=SimpleNamespace(heldout_rmse_K=1.2))
    lines = [words(m, language) for m in law_messages(cast(Diagnosis, found))]
    assert part in lines[0]
    assert {"en": "0.5 (at 30; 95 %: 0.3 to 0.6)", "de": "0,5 (bei 30; 95 %: 0,3 bis 0,6)"}[language] in lines[0]
    assert {"en": "1 (at 0; 95 %: 0.8 to 1.1)", "de": "1 (bei 0; 95 %: 0,8 bis 1,1)"}[language] in lines[0]
    assert len(lines) == 4
    assert {"en": "falls by 50 % between 0 and 30", "de": "zwischen 0 und 30 um 50 %"}[language] in lines[1]
    digests = [white.digest for white in one.stage.data]
    never = [replace(d, moments=replace(d.moments, opened_s=np.nan)) for d in digests]
    data = [replace(white, digest=d) for white, d in zip(one.stage.data, never, strict=True)]
    unopened = SimpleNamespace(**vars(found) | {"law": replace(one, stage=replace(one.stage, data=data))})
    ends = [words(m, language) for m in law_messages(cast(Diagnosis, unopened))]
    assert lines[2].startswith({"en": "When the press opens", "de": "Beim Öffnen der Presse"}[language])
    assert ends[2].startswith({"en": "At the end of a run", "de": "Am Ende einer Pressung"}[language])
    content = one.as_json()
    assert {"kind", "variable", "curve", "unit", "heldout_gain_K", "resembles"} <= content.keys()
    assert all(len(row) == 4 for row in content["curve"])
    assert law_messages(cast(Diagnosis, SimpleNamespace(law=None, law_seconds=None))) == ()


@pytest.mark.parametrize(
    ("sign", "language", "part"),
    [
        (1.0, "en", "Between 60 and 100 °C heat disappears, {} kJ/kg of panel (95 %: {} to {}): evaporation"),
        (-1.0, "de", "Zwischen 60 und 100 °C entsteht Wärme, {} kJ je kg Platte (95 %: {} bis {}): eine Reaktion"),
    ],
)
def test_what_a_law_of_heat_takes_is_said_by_mass_where_it_is_sure(sign, language, part):
    """A rectangle of 100 kJ/m³K over 40 K takes 4 MJ/m³, whatever lies beside it that may be nothing."""
    stage = settled("nothing")
    x = np.linspace(40.0, 160.0, 25)
    sure = (x >= 60.0) & (x <= 100.0)
    middle = sign * np.where(sure, 100.0, 10.0)
    curve = np.stack([x, middle, middle - np.where(sure, 20.0, 30.0), middle + np.where(sure, 20.0, 30.0)], axis=1)
    density = np.mean([white.digest.run.header["panel.density_kg_m3"] for white in stage.data])
    fields = (LawOf.HEAT, "temperature_C", "kJ/m3K", curve, Gain(0.8, (0.5, 1.0)), ("heat",), None)
    law_found = Law(*fields, stage=stage, kept={})
    found = SimpleNamespace(law=law_found, final=stage, extended=SimpleNamespace(heldout_rmse_K=1.2))
    lines = [words(m, language) for m in law_messages(cast(Diagnosis, found))]
    amounts = [
        f"{40.0 * value / density:.2g}".replace(".", "," if language == "de" else ".")
        for value in (100.0, 80.0, 120.0)
    ]
    assert any(line.startswith(part.format(*amounts)) for line in lines)
    unsure = replace(law_found, curve=np.stack([x, middle, middle - 200.0, middle + 200.0], axis=1))
    found = SimpleNamespace(law=unsure, final=stage, extended=SimpleNamespace(heldout_rmse_K=1.2))
    assert len(law_messages(cast(Diagnosis, found))) == len(lines) - 1


@pytest.mark.parametrize("side", [LawOf.CONTACT_LOWER, LawOf.CONTACT_UPPER])
def test_a_flat_law_of_one_contact_is_an_asymmetry_and_a_brief_one_is_not(side):
    x = np.linspace(0.0, 30.0, 33)
    flat, brief = np.full(33, 0.708), np.where((x > 10.0) & (x < 13.0), 0.5, 1.0)
    assert resembles(side, np.stack([x, flat, flat - 0.01, flat + 0.01], axis=1)) == "contact_asymmetry"
    assert resembles(side, np.stack([x, brief, brief - 0.05, brief + 0.05], axis=1)) is None


def test_a_model_file_of_a_version_without_levels_means_what_it_meant():
    """Its law of one contact was 1 at the longest time seen."""
    made, press = laws.contact_by_time(30.0, "upper"), parse_press(press_toml())
    run, truth = make_campaign(43, 1, None, THIN)[0]
    kept = made.kept(0.6 * np.random.default_rng(4).normal(size=len(made.effect.parameters)))
    older = {name: value for name, value in kept.items() if name != LEVEL}
    shifted = older | {f"{VALUE}_{k}": kept[f"{VALUE}_{k}"] + 0.4 for k in range(len(made.effect.parameters))}
    stored = find_effect("law_contact_upper")
    model = ThermalModel(press, (stored,))
    case = model.prepare(run, truth.moments)
    cores = [
        model.solve(case, model.guesses | {stored.key(n): v for n, v in numbers.items()}).core
        for numbers in (older, older | {LEVEL: 0.0}, shifted, kept)
    ]
    assert cores[1] == pytest.approx(cores[0], abs=1e-9)
    assert np.max(np.abs(cores[2] - cores[0])) < 0.05
    assert np.max(np.abs(cores[3] - cores[0])) > 0.05


def law_file(kind: str, **changed: float | None) -> dict[str, object]:
    """Return a model file's content with a law of some kind, numbers changed in it or, where None, left out."""
    made = {
        "contact": laws.contact_by_time(30.0),
        "contact_by_load": laws.contact_by_load(0.3, 1.2),
        "conductivity": laws.conductivity_by_temperature(40.0, 160.0),
        "heat": laws.heat_by_temperature(40.0, 160.0),
        "source_by_depth": laws.source_by_depth(),
    }[kind]
    numbers = {STRENGTH: 1.0, **made.kept(np.zeros(len(made.effect.parameters))), **changed}
    table = {name: {"value": value, "sd": 0.0} for name, value in numbers.items() if value is not None}
    guesses = ThermalModel(parse_press(press_toml(loaded=True))).guesses
    coefficients = {name: {"value": value, "sd": 0.0} for name, value in guesses.items()}
    return {"coefficients": coefficients, "effects": [{"name": f"law_{kind}", "parameters": table}]}


@pytest.mark.parametrize(
    ("kind", "changed", "expected"),
    [
        ("contact", {"last_s": 0.0}, "last_s = 0"),
        ("contact", {"last_s": None}, "last_s is missing"),
        ("contact", {STRENGTH: None}, "strength is missing"),
        ("contact", {"value_7": None}, "value_7 is missing"),
        ("contact", {"value_7": 800.0}, "value_7 = 800"),
        ("contact_by_load", {"least_load": -1.0}, "least_load = -1"),
        ("contact_by_load", {"least_load": 1.2}, "least_load = 1.2 must lie below most_load = 1.2"),
        ("conductivity", {"value_0": 1000.0}, "value_0 = 1000"),
        ("conductivity", {"hottest_C": 40.0}, "coldest_C = 40 must lie below hottest_C = 40"),
        ("heat", {"coldest_C": 200.0}, "coldest_C = 200 must lie below hottest_C = 160"),
        ("heat", {"value_3": 1e9}, "value_3"),
    ],
)
def test_a_law_of_a_damaged_file_is_refused_by_its_key(kind, changed, expected):
    """Ends the wrong way round turned the sign of the heat, equal ones made all temperatures no numbers."""
    with pytest.raises(InputError, match=expected):
        parse_model(law_file(kind, **changed), "model.json")
    assert parse_model(law_file(kind), "model.json").effects[0][0] == f"law_{kind}"


@pytest.mark.parametrize(("kind", "value"), [("conductivity", 11.5), ("heat", -2e5), ("source_by_depth", 1e9)])
def test_a_law_that_leads_to_impossible_temperatures_is_refused_where_a_run_is_simulated(kind, value):
    run = make_campaign(43, 1, None, THIN)[0][0]
    knots = {name: value for name in find_effect(f"law_{kind}").neutral if name.startswith(VALUE)}
    model = parse_model(law_file(kind, **{STRENGTH: 10.0, **knots}), "model.json")
    with pytest.raises(Nonphysical, match=r"not between -273\.15 and 2,?000 °C"):
        softsensor.simulate(run, parse_press(press_toml()), model)


INSULATED = """
[press]
name = "box"
area_m2 = 0.01
[[layer]]
name = "panel"
from_run = true
[boundary.bottom]
kind = "insulated"
[boundary.top]
kind = "insulated"
[[sensor]]
columns = ["top_1"]
at = "panel.top"
[initial]
kind = "uniform"
temperature_C = 20.0
"""


def test_a_source_heats_an_insulated_panel_by_what_it_releases():
    """Closed form: T = T0 + P t / (rho c), everywhere, however fast heat spreads."""
    law, t = find_effect("law_source_by_depth"), np.arange(0.0, 61.0)
    header = {
        "panel.material": "MDF", "panel.thickness_mm": 10.0, "panel.density_kg_m3": 700.0,
        "panel.conductivity_W_mK": 0.12, "panel.heat_capacity_J_kgK": 1600.0, "panel.initial_temperature_C": 20.0,
    }  # fmt: skip
    frame = pd.DataFrame({"time_s": t, "top_1": 20.0})
    frame.attrs = header
    model = ThermalModel(parse_press(INSULATED), (law,))
    case = model.prepare(softsensor.read_run(frame), Moments())
    flat = {law.key(f"{VALUE}_{knot}"): 50.0 for knot in range(5)}
    solved = model.solve(case, model.guesses | flat | {law.key(STRENGTH): 1.0})
    assert solved.core == pytest.approx(20.0 + 50e3 * t / (700.0 * 1600.0), abs=0.02)


@pytest.mark.parametrize("kind", [laws.source_by_depth(), laws.source_by_time(30.0)], ids=lambda kind: kind.name)
def test_a_source_s_tangents_are_its_derivatives_also_by_the_moment_of_closing(kind):
    press = parse_press(press_toml())
    run, truth = make_campaign(43, 1, None, THIN)[0]
    model = ThermalModel(press, (kind.effect,))
    case = model.prepare(run, truth.moments)
    names = [kind.effect.key(p.name) for p in kind.effect.parameters]
    at = model.guesses | {name: 0.5 * (-1) ** i for i, name in enumerate(names)}
    asked = (*names[:3], "closed_s")
    exact = model.solve(case, at, asked)
    for name in asked:
        step = 0.02
        up, down = (model.solve(case, at | {name: at.get(name, 0.0) + s}) for s in (step, -step))
        assert exact.d_core[name] == pytest.approx((up.core - down.core) / (2.0 * step), rel=0.02, abs=0.02), name


def test_sources_of_several_effects_add_up_each_by_its_own_course():
    press = parse_press(press_toml())
    run, truth = make_campaign(43, 1, None, THIN)[0]
    kinds = [laws.source_by_depth(), laws.source_by_time(30.0)]
    sized = [
        {k.effect.key(p.name): size for p in k.effect.parameters}
        for k, size in zip(kinds, (2.0, -1.0), strict=True)
    ]
    cores = {}
    for chosen in ((), (0,), (1,), (0, 1)):
        model = ThermalModel(press, tuple(kinds[k].effect for k in chosen))
        values = {name: v for k in chosen for name, v in sized[k].items()}
        cores[chosen] = model.solve(model.prepare(run, truth.moments), model.guesses | values).core
    assert np.max(np.abs(cores[0,] - cores[1,])) > 1.0
    assert cores[0, 1] == pytest.approx(cores[0,] + cores[1,] - cores[()], abs=0.05)


def test_the_live_core_follows_a_source_that_the_model_file_holds():
    """The virtual press releases heat about the middle, 10 K of it at the core before the press opens."""
    press, (run, truth) = parse_press(press_toml()), make_campaign(24_200, 1, "inner_source", THIN)[0]
    depth = 0.5 * (depth_knots().knots + 1.0)
    power = truth.effects["inner_source"]["kW_m3"] * np.exp(-0.5 * ((depth - 0.5) / INNER_WIDTH) ** 2)
    kept = {STRENGTH: FittedValue(1.0, 0.1)} | {
        f"{VALUE}_{k}": FittedValue(float(p), 0.0) for k, p in enumerate(power)
    }
    plain = model_of(settled("nothing"))
    errors = {}
    for name, effects in (("plain", ()), ("law", (("law_source_by_depth", kept),))):
        model = parse_model(json.loads(model_text(replace(plain, effects=effects))), "here")
        told = [(e, c) for e, c in zip(replay(press, run, model).estimates, truth.core_C, strict=True) if e.valid]
        errors[name] = np.sqrt(np.mean([(e.core_C - c) ** 2 for e, c in told]))
        assert name == "plain" or all(e.core_low_C <= c <= e.core_high_C for e, c in told)
    assert errors["law"] < 1.0
    assert errors["plain"] > 5.0


@pytest.mark.campaign
def test_what_is_far_below_the_readings_slow_noise_is_no_law():
    """On this empty campaign a contact of one's own saves 0.005 of 0.050 K on runs left out, by chance surely."""
    press = parse_press(press_toml())
    _, digests = _screened(press, [run for run, _ in make_campaign(24_205, 8, None, THIN)])
    assert free_law(settle_base(ThermalModel(press), digests)) is None
