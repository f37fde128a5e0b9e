"""The catalogue: every entry passes the same contract; users add their own; examples run."""

import os
import re
import subprocess
import sys
from dataclasses import fields, replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import lognorm, norm

import softsensor
from daq.records import InputError, Moments
from daq.shared import shared_files
from daq.simulated.effects import SIZES
from daq.words import message as words
from softsensor.diagnosis.extension_unknowns import is_shape
from softsensor.diagnosis.run_scores import ways
from softsensor.effects import (
    BUILT_IN,
    Conversion,
    Effect,
    Live,
    Need,
    Role,
    Source,
    Terms,
    add_effect,
    catalogue,
    find_effect,
    known_effect,
    learn_words,
    on_panel,
)
from softsensor.effects.own import check_effect
from softsensor.effects.parameters import Parameter
from softsensor.effects.vocabulary import coefficient_words
from softsensor.heat.model import ThermalModel
from softsensor.live.priors import _parameter, is_straight
from softsensor.opening.steam import equilibrium_moisture

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "deploy" / "examples"
CONTRACT = {
    "moisture_evaporation": {"moisture_percent", "temperature_C"},
    "vapour_convection": {"W_m3K"},
    "resin_cure": {"heat_kJ_m2"},
    "conductivity_temperature": {"per_100_K"},
    "heat_capacity_temperature": {"per_100_K"},
    "conductivity_offset": {"ratio"},
    "heat_capacity_offset": {"ratio"},
    "density_profile": {"amplitude"},
    "contact_buildup": {"deficit", "time_constant_s"},
    "contact_load": {"exponent"},
    "contact_asymmetry": {"ratio"},
    "paper_layer": {"resistance_m2K_W", "capacity_J_m2K"},
    "open_radiation": {"emissivity"},
    "edge_loss": {"W_m3K"},
    "initial_press_state": {"offset_K"},
    "thermocouple_lag": {"time_constant_s"},
    "thermocouple_footprint": {"weight"},
    "clock_offset": {"seconds"},
    "platen_offset": {"top_K", "bottom_K"},
    "sensor_fault": set(),
}
by_name = pytest.mark.parametrize("effect", BUILT_IN, ids=lambda e: e.name)


OF_ITS_LAW = {"resin_cure": {"temperature_C", "autocatalysis"}}
"""Parameters beyond the contract's, which say how an effect goes."""


def test_the_catalogue_holds_the_contract_names_and_parameters():
    assert [e.name for e in BUILT_IN] == list(CONTRACT)
    for effect in BUILT_IN:
        own = OF_ITS_LAW.get(effect.name, set())
        assert {p.name for p in effect.parameters} == CONTRACT[effect.name] | own
        assert all(is_shape(p) for p in effect.parameters if p.name in own)


@pytest.mark.parametrize("language", words.languages())
@by_name
def test_every_effect_says_what_it_means_and_how_to_confirm_it_in_all_languages(effect, language):
    known = words.catalogue_of(language)
    for message in (effect.meaning, effect.symptom, effect.confirm, effect.core, effect.called):
        assert known.has(message.code)
        assert len(known.words(message)) > 5
    for parameter in effect.parameters:
        called = effect.parameter_called(parameter.name)
        assert known.has(called.code)
        assert len(known.words(called)) > 5
        assert known.has(parameter.shown_unit.code)
        assert not re.search(r"_|^-$|unit-", known.words(parameter.shown_unit))


@by_name
def test_every_effect_has_a_source_and_limits_about_its_typical_size(effect):
    assert len(effect.source) > 5
    for parameter in effect.parameters:
        assert parameter.unit
        assert parameter.source
        assert parameter.lower <= parameter.neutral <= parameter.upper
        assert parameter.lower <= parameter.typical <= parameter.upper


def test_a_size_known_within_a_factor_lies_as_a_log_normal_does_between_its_quartiles():
    size = find_effect("vapour_convection").parameters[0]
    log_normal = lognorm(np.log(size.within), scale=size.typical)
    assert norm(*size.present).ppf([0.25, 0.75]) == pytest.approx(log_normal.ppf([0.25, 0.75]), rel=1e-3)


@pytest.mark.parametrize("name", ["density_profile", "moisture_evaporation", "contact_buildup", "open_radiation"])
def test_no_search_looks_where_a_cause_would_be_the_opposite_of_its_name(name):
    assert find_effect(name).one_sided


@by_name
def test_neutral_values_leave_the_stack_alone(effect, lab_press, make_run, coefficients, moments):
    model = ThermalModel(lab_press, (effect,))
    case = model.prepare(make_run(end=30.0), moments)
    terms = model.build(case, coefficients).terms
    for field in fields(Terms):
        value, default = getattr(terms, field.name), getattr(Terms(), field.name)
        if field.name == "closed_contact":
            assert all(np.allclose(factor, 1.0) for factor in value.values())
        elif field.name == "conversions":
            assert all(np.allclose(c.heat, 0.0) for c in value)
        elif field.name != "paper":
            assert np.allclose(value, default), field.name


@by_name
def test_a_typical_size_changes_readings_or_core(effect, lab_press, make_run, coefficients, moments):
    if not effect.parameters:
        return
    model = ThermalModel(lab_press, (effect,))
    case = model.prepare(make_run(every=0.5), moments, fineness=0.5)
    plain, moved = (model.solve(case, coefficients | v) for v in ({}, model.guesses | coefficients))
    change = max(np.abs(moved.sensors - plain.sensors).max(), np.abs(moved.core - plain.core).max())
    assert change > 0.2


@by_name
def test_the_exact_solver_takes_linear_effects_and_refuses_the_others_by_name(
    effect, lab_press, make_run, coefficients, moments
):
    model = ThermalModel(lab_press, (effect,))
    case = model.prepare(make_run(every=0.5, end=60.0), moments, fineness=0.5)
    values = model.guesses | coefficients
    if effect.nonlinear:
        with pytest.raises(InputError, match=f"'exact': {effect.name} is not linear"):
            model.solve(case, values, method="exact")
    elif effect.name == "contact_buildup":
        with pytest.raises(InputError, match="a contact changes while the press is closed"):
            model.solve(case, values, method="exact")
    else:
        names = model.parameter_names
        exact, implicit = (model.solve(case, values, names, method=m) for m in ("exact", "implicit"))
        assert np.abs(exact.core - implicit.core).max() < 0.005
        t = case.run.time_s
        settled = (np.abs(t - moments.inserted_s) > 0.4) & (np.abs(t - moments.closed_s) > 0.7)
        assert np.abs(exact.sensors - implicit.sensors)[settled].max() < 0.15
        for name in names:
            scale = np.abs(exact.d_core[name]).max() + 1e-9
            assert np.abs(exact.d_core[name] - implicit.d_core[name]).max() < 0.01 * scale, name


def test_the_exact_solver_refuses_a_load_that_changes_only_where_contacts_follow_it(make_rig):
    toml = """
[[layer]]
name = "panel"
from_run = true
[boundary.bottom]
kind = "measured"
column = "hot"
[[contact]]
between = ["boundary.bottom", "panel"]
closed = "h"
load = { column = "load" }
"""
    header = {"panel.material": "MDF", "panel.thickness_mm": 16.0, "panel.initial_temperature_C": 20.0}
    time_s = np.arange(0.0, 20.05, 0.5)
    plain, run = make_rig(toml, time_s, {"hot": 150.0, "load": 1.0 + time_s}, {"a": '"panel.bottom"'}, **header)
    model = ThermalModel.of(plain.press, ["contact_load"])
    case = model.prepare(run, Moments())
    assert np.ptp(model.solve(case, {"h": 300.0}, method="exact").core) > 0.0
    with pytest.raises(InputError, match="a contact changes"):
        model.solve(case, {"h": 300.0, "contact_load.exponent": 0.7}, method="exact")


def test_a_load_at_twice_its_reference_raises_the_contact_by_the_power_law(make_rig):
    toml = """
[[layer]]
name = "panel"
from_run = true
[boundary.bottom]
kind = "measured"
column = "hot"
[[contact]]
between = ["boundary.bottom", "panel"]
closed = "h"
load = { column = "load", reference = 200.0 }
"""
    header = {"panel.material": "MDF", "panel.thickness_mm": 16.0, "panel.initial_temperature_C": 20.0}
    time_s = np.arange(0.0, 20.05, 0.5)

    def core(load, h):
        plain, run = make_rig(
            toml, time_s, {"hot": 150.0, "load": load + 0.0 * time_s}, {"a": '"panel.bottom"'}, **header
        )
        model = ThermalModel.of(plain.press, ["contact_load"])
        return model.solve(model.prepare(run, Moments()), {"h": h, "contact_load.exponent": 0.8}).sensors

    assert core(400.0, 300.0) == pytest.approx(core(200.0, 300.0 * 2.0**0.8), abs=1e-9)


def test_an_unknown_effect_is_refused_with_the_known_ones():
    with pytest.raises(InputError, match=r"'draft' is not in the catalogue; known are moisture_evaporation, "):
        find_effect("draft")


def test_paper_contributes_its_resistance_and_capacity(lab_press, make_run, moments):
    model = ThermalModel.of(lab_press, ["paper_layer"])
    case = model.prepare(make_run(end=30.0), moments)
    values = {name: 100.0 for name in lab_press.coefficient_names}
    values |= {"paper_layer.resistance_m2K_W": 4e-4, "paper_layer.capacity_J_m2K": 600.0}
    stack = model.build(case, values).stack
    paper = case.layout.paper
    assert paper.sum() == 2
    assert (stack.dx / stack.k)[paper] == pytest.approx([4e-4, 4e-4])
    assert (stack.dx * stack.c)[paper] == pytest.approx([600.0, 600.0])


def test_resin_heat_adds_up_to_what_is_given_on_each_face(lab_press, make_run, moments):
    model = ThermalModel.of(lab_press, ["resin_cure"])
    case = model.prepare(make_run(end=30.0), moments)
    values = {name: 100.0 for name in lab_press.coefficient_names} | {"resin_cure.heat_kJ_m2": 12.0}
    stack = model.build(case, values).stack
    assert stack.heat[0] @ stack.dx == pytest.approx(2 * 12e3)


def run_python(*arguments: str, path: tuple[Path, ...] = ()) -> str:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(str(p) for p in (*path, ROOT))}
    done = subprocess.run(
        [sys.executable, *arguments], env=environment, capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


ASK = """
from pathlib import Path
from types import SimpleNamespace as Space
from daq.press.press_file import read_press
from daq.words.message import words
from softsensor.diagnosis.missing_causes import candidates
from softsensor.effects import catalogue, words_of_own_effects
from softsensor.effects.vocabulary import called, parameters_shown
from softsensor.heat.model import ThermalModel
from softsensor.opening.steam import equilibrium_moisture
from softsensor.live.priors import plans_for

press = read_press(Path("deploy/presses/lab.toml"))
effect = catalogue()["hood_draught"]
told = parameters_shown("hood_draught", {"W_m3K": {"value": 1500.0, "ci95": [1000.0, 2000.0]}})[0]
plan = plans_for(press, None, (0.0, 0.1, 0.1))[0]
suspect = next(s for s in plan.causes if s.effect == "hood_draught")
problem = Space(model=ThermalModel(press), case=Space(press=press))
print(effect in candidates(problem), ThermalModel(press, (effect,)).parameter_names[-1])
print(words(called("hood_draught"), "de"), "|", called("hood_draught"))
print(told.line, "|", words(effect.confirm, "de"))
print(suspect.parameter, suspect.sd, suspect.chance, suspect.one_sided)
print(words_of_own_effects("de")["effect-hood_draught-called"])
"""


def test_an_installed_package_adds_its_effect_in_one_file_and_diagnosis_live_sensor_and_words_know_it(tmp_path):
    source = tmp_path / "own_effect"
    source.mkdir()
    for file in ("pyproject.toml", "hood_draught.py"):
        (source / file).write_text((EXAMPLES / "own_effect" / file).read_text(encoding="utf-8"), encoding="utf-8")
    target = tmp_path / "site"
    run_python(
        "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--target", str(target), str(source)
    )
    assert run_python("-c", ASK, path=(target,)).splitlines() == [
        "True hood_draught.W_m3K",
        "Zug der Haube | a draught of the hood",
        "heat lost at the top of the rim, per volume and kelvin above ambient (W_m3K): 1500 W/m³K "
        "(95 %: 1000 to 2000) | Die Haube für eine Pressung abschalten.",
        "hood_draught.W_m3K 1500.0 0.02 True",
        "Zug der Haube",
    ]
    assert "hood_draught" not in catalogue()


@pytest.fixture(scope="module")
def isotherm():
    """Return the example's module: a second law of drying."""
    path = EXAMPLES / "drying_by_isotherm" / "drying_by_isotherm.py"
    spec = spec_from_file_location(path.stem, path)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("moisture", [0.0, 3.0, 8.0, 25.0])
def test_drying_by_the_isotherm_keeps_the_water_and_leaves_what_the_wood_holds_in_steam(isotherm, moisture):
    at, water = map(np.array, zip(*isotherm.leaving(moisture), strict=True))
    assert water.sum() == pytest.approx(moisture, abs=1e-12)
    assert (water >= 0.0).all()
    assert np.iscomplexobj(np.array([w for _, w in isotherm.leaving(moisture + 1e-20j)]))
    for hot_C in (105.0, 117.0, 140.0):  # 1013 hPa over that of saturated water, by steam tables
        humidity = 101.33 / {105.0: 120.9, 117.0: 180.5, 140.0: 361.5}[hot_C]
        holds = min(moisture, float(equilibrium_moisture(humidity, hot_C)))
        assert water[at > hot_C].sum() == pytest.approx(holds, abs=0.1)


def test_the_heat_that_drying_by_the_isotherm_takes_is_that_of_the_water_wood_no_longer_holds(isotherm, make_rig):
    end = 'kind = "air"\ncoefficient = "h"\nambient_C = 115.0\n'
    toml = f'[[layer]]\nname = "panel"\nfrom_run = true\n[boundary.bottom]\n{end}[boundary.top]\n{end}'
    toml += '[initial]\nkind = "uniform"\ntemperature_C = 95.0\n'
    panel = {"thickness_mm": 1.0, "density_kg_m3": 740.0, "conductivity_W_mK": 0.12, "heat_capacity_J_kgK": 1550.0}
    header = {f"panel.{key}": value for key, value in panel.items()} | {"panel.initial_temperature_C": 95.0}
    plain, run = make_rig(toml, np.arange(0.0, 200.5, 0.5), {}, {"face": '"panel.bottom"'}, **header)
    model = ThermalModel(plain.press, (isotherm.EFFECT,))
    for moisture, dries in ((8.0, 1.6), (0.0, 0.0)):  # % left at 112 °C in steam of one atmosphere: 6.4
        wet = {"drying_by_isotherm.moisture_percent": moisture, "drying_by_isotherm.temperature_C": 100.0}
        solved = model.solve(model.prepare(run, Moments()), {"h": 20.0} | wet)
        flowed_in = np.trapezoid(2.0 * 20.0 * (115.0 - solved.column("face")), run.time_s)
        kept = 740.0 * 1550.0 * 1e-3 * (solved.core[-1] - 95.0)
        assert (flowed_in - kept) / (isotherm.LATENT_HEAT * 740.0 * 1e-5) == pytest.approx(dries, abs=0.15)


def test_an_effect_without_english_words_is_refused_with_what_is_missing():
    effect = replace(find_effect("edge_loss"), name="draught", words={"en": {"called": "a draught"}})
    with pytest.raises(InputError, match="no English words for confirmed-by, core, meaning, parameter-W_m3K, sym"):
        learn_words(effect)


SPOKEN = ("called", "meaning", "symptom", "confirmed-by", "core", "parameter-W_m3K")


def hood_terms(scene, values):
    return Terms(exchange=on_panel(scene, values["W_m3K"], 0.0))


def own_effect(terms=hood_terms, **changed):
    """Return an effect as somebody writes one in a notebook, some of it changed; `size` is of its parameter."""
    loss = Parameter("W_m3K", "W/m³K", neutral=0.0, typical=4000.0, lower=0.0, upper=4e4, source="assumed")
    loss = replace(loss, **changed.pop("size", {}))
    words = {"en": {what: f"hood: {what}" for what in (*SPOKEN, f"parameter-{loss.name}")}}
    given = {"chance": 0.02, "live": Live(Role.HYPOTHESIS), "needs": Need.PANEL, "words": words, **changed}
    return Effect("hood", (loss,), terms, source="assumed", **given)


@pytest.fixture
def own():
    """Add an effect of one's own for as long as a test takes."""
    yield add_effect
    catalogue().pop("hood", None)


@by_name
def test_what_is_asked_of_ones_own_effect_holds_of_every_shipped_one(effect):
    if effect.parameters:  # faults of channels are found by comparison
        check_effect(effect)


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (
            {"size": {"lower": 4e4, "upper": 0.0}},
            "effect hood: parameter W_m3K: lower = 40000 and upper = 0",
        ),
        ({"size": {"upper": float("inf")}}, "lower = 0 and upper = inf are no limits"),
        ({"size": {"neutral": -1.0}}, "parameter W_m3K: neutral = -1 lies outside its limits 0 to 40000"),
        ({"size": {"typical": 5e4}}, "parameter W_m3K: typical = 50000 lies outside its limits 0 to 40000"),
        ({"size": {"typical": float("nan")}}, "typical = nan lies outside"),
        ({"size": {"typical": "much"}}, "typical = 'much' lies outside"),
        ({"size": {"typical": 0.0}}, "typical equals neutral"),
        ({"size": {"name": "loss W"}}, "effect hood: 'loss W' is no name"),
        ({"chance": 2.0}, "effect hood: chance = 2: it is a probability"),
        ({"chance": float("nan")}, "chance = nan"),
    ],
)
def test_an_effect_that_cannot_be_is_refused_when_it_is_added(own, wrong, expected):
    with pytest.raises(InputError, match=re.escape(expected)):
        own(own_effect(**wrong))
    assert "hood" not in catalogue()


@pytest.mark.parametrize("name", ["My Effect", "", "hood.draught", "1st", "häubchen", 5])
def test_an_effect_whose_name_no_file_takes_is_refused_when_it_is_added(own, name):
    with pytest.raises(InputError, match="is no name"):
        own(replace(own_effect(), name=name))
    assert name not in catalogue()


def test_an_effect_without_parameters_of_its_own_each_is_refused_when_it_is_added(own):
    hood = own_effect()
    for parameters, expected in (((), "one Parameter or more"), (hood.parameters * 2, "two parameters W_m3K")):
        with pytest.raises(InputError, match=expected):
            own(replace(hood, parameters=parameters))
    with pytest.raises(InputError, match="an effect is given as an Effect"):
        own(replace(hood, terms=5))


@pytest.mark.parametrize("name", ["edge_loss", "law_conductivity"])
def test_an_effect_that_is_shipped_stays(own, name):
    with pytest.raises(InputError, match=f"effect {name}: Kerntemp brings one of that name"):
        own(replace(own_effect(), name=name))
    assert known_effect(name).source != "assumed"


def test_runs_are_asked_for_an_effect_that_is_added_later_and_as_it_is_now(own):
    before = ways()
    own(own_effect())
    own(second := own_effect(chance=0.03))
    assert {name: way.effect for name, way in ways().items() if name not in before} == {"hood.W_m3K": second}


def test_the_live_sensor_too_takes_an_effect_as_it_is_now(own):
    for typical, straight in ((4000.0, True), (400.0, False)):
        changed = own_effect(size={"typical": typical}, live=Live(Role.HYPOTHESIS, straight=straight))
        own(changed)
        assert (_parameter("hood.W_m3K").typical, is_straight("hood.W_m3K")) == (typical, straight)


def test_an_effect_that_is_added_once_more_counts_as_it_is_now_and_so_do_its_words(own, lab_press):
    german = {what: "Haube" for what in SPOKEN}
    first = own_effect()
    own(replace(first, words={**first.words, "de": german}))
    assert (str(first.called), words.words(first.called, "de")) == ("hood: called", "Haube")
    second = own_effect(terms=lambda scene, values: Terms(exchange=on_panel(scene, 0.5 * values["W_m3K"], 0.0)))
    own(replace(second, words={"en": {**second.words["en"], "called": "a hood"}}))
    assert find_effect("hood").terms is second.terms
    assert (str(first.called), words.words(first.called, "de")) == ("a hood", "a hood")
    assert list(catalogue()).count("hood") == 1


WRONG_TERMS = {
    "a misspelt key": (lambda scene, values: Terms(lag=values["W_m3"]), "its terms fail (KeyError: 'W_m3')"),
    "nothing": (lambda scene, values: None, "its terms are None; let it return Terms"),
    "a number": (lambda scene, values: 5, "its terms are 5; let it return Terms"),
    "a wrong shape": (
        lambda scene, values: Terms(exchange=np.zeros(3)),
        "exchange has the shape (3,)",
    ),
    "no number": (lambda scene, values: Terms(exchange=float("nan")), "of its terms exchange is not finite"),
    "a text": (lambda scene, values: Terms(convection="much"), "of its terms convection is 'much', not a number"),
    "an array of one number": (lambda scene, values: Terms(lag=np.zeros(2)), "lag has the shape (2,)"),
    "no such contact": (
        lambda scene, values: Terms(closed_contact={9: 1.0}),
        "closed_contact is {9: 1}; it",
    ),
    "no pair": (lambda scene, values: Terms(boundary_offset=3.0), "boundary_offset is 3; it takes a tuple of two"),
    "no sources": (lambda scene, values: Terms(sources=(np.zeros(3),)), "sources are"),
    "ragged": (lambda scene, values: Terms(exchange=[[1.0], [1.0, 2.0]]), "exchange is"),
}


@pytest.mark.parametrize("terms", WRONG_TERMS)
def test_terms_that_fail_or_are_none_are_refused_by_the_name_of_their_effect_wherever_they_are_asked_for(
    own, terms
):
    wrong, expected = WRONG_TERMS[terms]
    own(own_effect(terms=wrong))
    shared = shared_files()
    press, run = shared / "presses" / "lab.toml", softsensor.read_run(shared / "samples" / "2026-03-04-07.csv")
    model = softsensor.ModelFile("m", "lab", {}, effects=(("hood", {"W_m3K": softsensor.FittedValue(10.0, 1.0)}),))
    scan = {name: column[0] for name, column in run.columns.items()}
    for ask in (
        lambda: softsensor.simulate(run, press, model),
        lambda: softsensor.predict(run, press, model),
        lambda: softsensor.predict(run, press),  # the live sensor suspects it
        lambda: softsensor.LiveSensor(press, run.header).update(0.0, scan),
        lambda: softsensor.diagnose([run], press, effects="hood"),
    ):
        with pytest.raises(InputError, match=re.escape("effect hood: ")) as refused:
            ask()
        assert expected in str(refused.value)


def test_terms_of_every_shape_that_is_documented_are_taken(lab_press, make_run, moments, coefficients):
    def everything(scene, values):
        n, steps, w = len(scene.z), len(scene.step_start), values["W_m3K"]
        cells, own = np.ones(n) + 1e-9 * w, Conversion(np.zeros(n), 0, 1e-3, 1e4, 400.0)
        contacts = dict.fromkeys(range(scene.contacts), np.ones(steps))
        terms = Terms(cells, 0 * cells, np.zeros(61), cells, 0 * cells, 0 * cells, contacts, np.zeros(61))
        sources = (Source(np.zeros(n), np.ones(steps)), Source(np.zeros(n)))
        return replace(terms, conversions=(own,), sources=sources, boundary_offset=(0.0, 1e-9 * w))

    plain = ThermalModel(lab_press)
    more = plain.extended(own_effect(terms=everything, nonlinear=True))
    case = plain.prepare(make_run(), moments)
    values = {**coefficients, "hood.W_m3K": 1.0}
    found = more.solve(more.prepare(make_run(), moments), values, tangents=("hood.W_m3K",))
    np.testing.assert_allclose(found.core, plain.solve(case, coefficients).core, atol=1e-3)


def test_the_paper_table_example_finds_only_the_kilowatt_reading_able_to_laminate(tmp_path):
    figure = tmp_path / "faces.svg"
    output = run_python(str(EXAMPLES / "paper_table" / "face_temperature.py"), str(figure))
    able = [line for line in output.splitlines() if line.endswith("laminates")]
    assert len(able) == 1
    assert able[0].startswith("closed values in kW/m²K")
    assert figure.read_text(encoding="utf-8").startswith("<?xml")


def test_each_coefficient_of_the_laboratory_press_is_said_between_its_own_bodies_in_its_own_state(lab_press):
    assert {name: str(coefficient_words(lab_press, name)) for name in lab_press.coefficient_names} == {
        "h_p_o": "platen – plate, open",
        "h_p_c": "platen – plate, closed",
        "h_pp_o": "plate – panel, open",
        "h_pp_c": "plate – panel, closed",
        "h_wa": "panel – air, open",
        "h_ap": "plate – air, open",
    }


@pytest.mark.parametrize("name", [name for name, limits in SIZES.items() if limits])
def test_what_counts_as_a_typical_size_lies_near_what_is_drawn(name):
    effect, (first, (low, high)) = find_effect(name), next(iter(SIZES[name].items()))
    own = next(p for p in effect.parameters if p.name == first)
    usual = 0.5 * (abs(low - own.neutral) + abs(high - own.neutral))
    assert 0.5 <= own.size / usual <= 2.0
