"""Hide an effect in a campaign and require finding it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from daq.press.press_file import Press, parse_press
from daq.records import Array, InputError, Moments, Run
from daq.simulated.campaign import Plan, Truth, make_campaign, press_toml
from daq.words import Message
from daq.words.message import catalogue_of, sentences, words
from softsensor.diagnosis import numbers, verdict
from softsensor.diagnosis.advice import CORE_OFF_K, AdviceBasis, next_measurement, rim_notes, thickness_notes
from softsensor.diagnosis.causes import _alternatives
from softsensor.diagnosis.curves import curves_of
from softsensor.diagnosis.decision import (
    ALPHA,
    ALPHA_PATTERN,
    EXCESS,
    FEW_RUNS,
    NEGLIGIBLE_K,
    Verdict,
    refuted_by_cores,
)
from softsensor.diagnosis.directions import Direction
from softsensor.diagnosis.extended_model import model_of
from softsensor.diagnosis.extension import (
    STUCK,
    RunState,
    bounded_offsets,
    evaluate,
    fit_campaign_model,
    from_the_others,
    held_out,
    predicted,
    start_eta,
    unstuck,
)
from softsensor.diagnosis.extension_unknowns import Unknowns, lay_out
from softsensor.diagnosis.finding import Diagnosis, Finding
from softsensor.diagnosis.gains import Gain
from softsensor.diagnosis.held import SWITCHED, between_runs, loads
from softsensor.diagnosis.numbers import (
    BLOCK_S,
    Interval,
    intervals,
    intervals_of_models,
    measure_errors,
    noise_floor,
    residual_K,
    sure_core_error_K,
)
from softsensor.diagnosis.run_scores import run_scores
from softsensor.diagnosis.search import CLOCK_ERROR_S, HOPELESS, Candidate, search, switch_scores
from softsensor.diagnosis.selection import Round, left_beside, p_values
from softsensor.diagnosis.settling import (
    START_NOISE,
    LeftOut,
    finer,
    gain_of,
    panels_as_usual,
    panels_given,
    run_errors,
    settle,
    settle_base,
)
from softsensor.diagnosis.sign_flips import (
    MANY,
    PatternTest,
    Pocket,
    likelihood_p,
    max_t,
    pattern_test,
    sign_patterns,
)
from softsensor.diagnosis.summary import core_messages, sureness, verdict_messages, worth
from softsensor.diagnosis.unseen import never_seen, stage_errors
from softsensor.diagnosis.verdict import _lacking_loads, _proof, _screened, _size_is_sure, diagnose
from softsensor.diagnosis.where import stretches, where_row
from softsensor.effects import BUILT_IN, find_effect
from softsensor.fitting.one_run import fit_run
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_reading import parse_model
from softsensor.heat.timing import OPENING_RAMP, OPENING_RAMP_S
from softsensor.jobs.night_sure import held_back
from softsensor.jobs.stored_diagnosis import stored_diagnosis
from softsensor.planning.plan import plan
from softsensor.report.diagnosis_figures import residual_figure
from softsensor.report.diagnosis_report import diagnosis_report
from softsensor.signals.digest import Digest, MeanNoise, Whitened, digest_run
from softsensor.signals.faces import rim_falls
from softsensor.signals.moments import moments_seen
from softsensor.signals.screen import screened
from softsensor.signals.unknown import Unknown
from tests.editions import edition

WIDE = Plan(rate_hz=2.0, thickness_mm=16.0, coefficient_spread=0.12, pressure_N_cm2=(150.0, 250.0, 350.0, 450.0))
SMALL = Plan(rate_hz=2.0, thickness_mm=(8.0, 16.0, 19.0))


@cache
def press() -> Press:
    """The virtual press as a press file describes it."""
    return parse_press(press_toml())


@cache
def campaign(effect: str | None, seed: int, runs: int, core: float = 0.0) -> tuple[tuple[Run, Truth], ...]:
    plan = Plan(rate_hz=2.0, thickness_mm=(8.0, 16.0, 19.0), core_column=core)
    if core:  # what the cause does to the core is asked, not what panels do that differ
        plan = replace(plan, panel_spread=0.0)
    return tuple(make_campaign(seed, runs, effect, plan))


@cache
def diagnosed(effect: str | None, seed: int, runs: int = 7, core: float = 0.0) -> Diagnosis:
    return diagnose(press(), [run for run, _ in campaign(effect, seed, runs, core)])


def test_a_campaign_without_a_hidden_effect_gets_no_name() -> None:
    found = diagnosed(None, 41)
    assert found.verdict == "no_effect"
    assert found.findings == ()
    assert found.extended == found.base


def test_contacts_that_follow_the_pressure_of_their_runs_are_named_though_each_run_can_make_up_for_it() -> None:
    """A run's own contact does what its pressure does, so nothing is left in any: it shows between the runs."""
    runs = make_campaign(93101, 12, {"contact_load": {"exponent": 0.8}}, WIDE)
    found = diagnose(press(), [run for run, _ in runs], law=False)
    (cause,) = found.findings
    assert (found.verdict, cause.set) == (Verdict.NAMED, ("contact_load",))
    low, high = cause.parameters["exponent"].ci95
    assert low < 0.8 < high
    assert cause.gain.sure


def test_contacts_that_the_press_file_fixes_cannot_make_up_for_the_pressure_of_their_runs() -> None:
    before, rest = press_toml().split("[coefficients.h_pp_c]")
    fixed = parse_press(before + "[coefficients.h_pp_c]" + rest.replace("upper", "fixed = true\nupper", 1))
    plan = Plan(rate_hz=1.0, thickness_mm=16.0, coefficient_spread=0.05, pressure_N_cm2=(150.0, 450.0))
    runs = [run for run, _ in make_campaign(7, 6, {"contact_load": {"exponent": 0.8}}, plan)]
    found = diagnose(fixed, runs, effects=["contact_load"], law=False)
    assert [f.name for f in (*found.findings, *found.suspected)] == ["contact_load"]


def test_how_contacts_scatter_that_no_pressure_moves_is_no_evidence_for_one() -> None:
    runs = [run for run, _ in make_campaign(701, 12, None, WIDE)]
    base = settle_base(ThermalModel(press()), _screened(press(), runs)[1])
    (found,) = search(base, [find_effect("contact_load")])
    assert found.gain < HOPELESS


def test_a_pressure_that_a_column_shows_only_while_closed_is_one_that_stays_as_it_is() -> None:
    by_column = parse_press(
        press_toml().replace('"h_pp_c"', '"h_pp_c"\nload = { column = "load", reference = 350.0 }')
    )
    runs = []
    for run, truth in make_campaign(701, 3, None, WIDE):
        shut = (run.time_s > truth.moments.closed_s - 1.0) & (run.time_s < truth.moments.opened_s + 1.0)
        load = np.where(shut, run.setting("pressure_N_cm2"), 0.0)
        runs.append(replace(run, columns=run.columns | {"load": load}))
    digests = [_screened(by_column, [run])[1][0] for run in runs]
    data = [Whitened.of(d, START_NOISE) for d in digests]
    assert between_runs(find_effect("contact_load"), data)
    for run, d in zip(runs, digests, strict=True):
        assert loads(d)["h_pp_c"] == pytest.approx(np.log(run.setting("pressure_N_cm2") / 350.0), abs=1e-6)


def test_a_rim_loss_is_named_and_its_size_found() -> None:
    found = diagnosed("edge_loss", 501, 7, 0.5)
    truth = campaign("edge_loss", 501, 7, 0.5)[0][1].effects["edge_loss"]["W_m3K"]
    assert [f.name for f in found.findings] == ["edge_loss"]
    assert found.findings[0].parameters["W_m3K"].value == pytest.approx(truth, rel=0.35)


def test_a_name_that_the_nights_are_not_sure_of_is_only_suspected() -> None:
    held = held_back(diagnosed("edge_loss", 501, 7, 0.5))
    content = json.loads(json.dumps(stored_diagnosis(press(), held), allow_nan=False))
    assert (content["verdict"], content["effects"]) == ("unknown_effect", [])
    assert [f["name"] for f in content["suspected"]] == ["edge_loss"]
    assert content["extended"] == content["base"]
    assert content["next_measurement"].startswith("Insulate the rim")
    assert model_of(held.final).effects == ()
    assert any("heat lost at the rim" in str(message) for message in verdict_messages(held))


def test_runs_show_a_hidden_cause_each_by_itself_and_none_where_nothing_is_hidden() -> None:
    for effect, seed in (("edge_loss", 501), (None, 41)):
        runs = [run for run, _ in campaign(effect, seed, 7, 0.5 if effect else 0.0)]
        shown = run_scores(ThermalModel(press()), press(), runs)
        assert {"edge_loss.W_m3K", "platen_offset.top_K", "platen_offset.top_K-"} < set(shown)
        assert ((shown["edge_loss.W_m3K"].beyond > 0.0) == bool(effect)).all()


def test_the_extended_model_at_least_halves_core_and_held_out_errors() -> None:
    found = diagnosed("edge_loss", 501, 7, 0.5)
    assert found.base.core_rmse_K is not None
    assert found.extended.core_rmse_K is not None
    assert found.extended.core_rmse_K < 0.5 * found.base.core_rmse_K
    assert found.extended.heldout_rmse_K < 0.5 * found.base.heldout_rmse_K


def test_the_answer_holds_every_key_of_the_contract_and_is_plain_json() -> None:
    content = json.loads(json.dumps(diagnosed("edge_loss", 501, 7, 0.5).as_json(), allow_nan=False))
    assert {
        "verdict",
        "effects",
        "base",
        "extended",
        "suspected",
        "law",
        "noise_floor_K",
        "where",
        "candidates",
        "next_measurement",
        "seconds",
    } <= content.keys()
    effect = content["effects"][0]
    kept = {"name", "set", "parameters", "p_value", "heldout_gain_K", "heldout_gain_ci95", "explained_share"}
    assert kept <= effect.keys()
    assert effect["heldout_gain_ci95"][0] < effect["heldout_gain_K"] < effect["heldout_gain_ci95"][1]
    assert (content["suspected"], content["law"]) == ([], None)
    assert effect["set"][0] == effect["name"]
    errors = {"rmse_K", "heldout_rmse_K", "predicted_rmse_K", "core_rmse_K", "predicted_core_rmse_K"}
    assert errors <= content["base"].keys() & content["extended"].keys()
    assert {"signal", "state", "from_s", "to_s", "residual_K"} <= content["where"][0].keys()
    assert {"name", "score", "p_value", "heldout_gain_K"} <= content["candidates"][0].keys()
    assert content["next_measurement"] == str(Message.from_json(content["next_measurement_said"]))
    assert content["warnings"] == [str(Message.from_json(one)) for one in content["warnings_said"]]
    assert content["where"][0]["phase"] == str(Message.from_json(content["where"][0]["phase_said"]))


def test_a_cause_saves_the_same_in_its_own_table_among_the_candidates_and_in_its_sentence() -> None:
    found = diagnosed("edge_loss", 501, 7, 0.5)
    content = stored_diagnosis(press(), found)
    (effect,) = content["effects"]
    (row,) = [c for c in content["candidates"] if c["name"] == effect["name"]]
    assert row["heldout_gain_K"] == effect["heldout_gain_K"] == effect["worth_said"]["arguments"]["gain"]
    assert f"by {effect['heldout_gain_K']:.2f} K on a typical run left out" in effect["worth"]


def test_a_stored_diagnosis_carries_what_a_cause_is_worth_as_a_sentence_and_as_a_code() -> None:
    (effect,) = stored_diagnosis(press(), diagnosed("edge_loss", 501, 7, 0.5))["effects"]
    assert effect["worth"].startswith("lowers the residual by ")
    assert effect["worth_said"]["code"] == "worth-saves"
    assert words(Message.from_json(effect["worth_said"]), "de").startswith("senkt das Residuum einer typischen ")


def test_a_stored_diagnosis_carries_the_next_pressings_as_a_plan_and_in_words() -> None:
    held = held_back(diagnosed("edge_loss", 501, 7, 0.5))
    content = json.loads(json.dumps(stored_diagnosis(press(), held), allow_nan=False))
    ahead = plan(press(), held)
    assert [point["name"] for point in content["plan"]["open"]] == [a.point.name for a in ahead.points]
    cause = content["plan"]["open"][0]
    assert (cause["kind"], cause["causes"]) == ("cause", ["edge_loss", *cause["causes"][1:]])
    assert cause["sentence"].startswith("Suspected, not proven: heat lost at the rim")
    assert cause["pressings"][0]["sentence"].startswith("Best: ")
    assert words(Message.from_json(cause["pressings"][0]["sentence_said"]), "de").startswith("Am besten: ")
    assert (content["plan"]["sentences"], content["law_sentences"]) == ([], [])


def test_the_model_file_carries_the_cause_for_other_commands() -> None:
    found = diagnosed("edge_loss", 501, 7, 0.5)
    read = parse_model(found.model_file().as_json(), "here")
    assert [name for name, _ in read.effects] == ["edge_loss"]
    assert set(read.coefficients) == set(press().coefficient_names)
    assert read.covariance.shape == (len(read.names), len(read.names))
    assert np.linalg.eigvalsh(read.covariance).min() > -1e-9


def test_a_model_file_is_as_unsure_as_panels_differ_in_a_cause_and_pressings_in_contacts() -> None:
    stage, key = diagnosed("edge_loss", 501, 7, 0.5).final, "edge_loss.W_m3K"
    alike, differ = (
        replace(stage, fit=replace(stage.fit, layout=replace(stage.fit.layout, spreads=spreads)))
        for spreads in ({}, {key: 0.3})
    )
    one, other = (dict(model_of(s).effects)["edge_loss"]["W_m3K"] for s in (alike, differ))
    assert other.value == one.value
    assert other.sd**2 == pytest.approx(one.sd**2 + (0.3 * one.value) ** 2)
    curvature = dict(zip(stage.fit.layout.names, np.diag(stage.fit.covariance), strict=True))
    for name, scatter in stage.population.items():
        known = model_of(stage).coefficients[name]
        assert (known.sd / known.value) ** 2 == pytest.approx(curvature[f"log {name}"] + scatter**2)


def test_the_report_says_cause_cost_gain_and_next_measurement() -> None:
    page = diagnosis_report(diagnosed("edge_loss", 501, 7, 0.5)).replace("\N{NO-BREAK SPACE}", " ")
    for part in ("Heat leaves through the rim", "What it costs", "When the press opens", "Measure next"):
        assert part in page
    assert page.count("<svg") == 3
    assert f"likelihood of runs left out: {sureness(diagnosed('edge_loss', 501, 7, 0.5).findings[0], 7)}." in page
    assert re.search(
        r'title="W_m3K">heat lost at the rim, [^<]*</td><td class="text"><b>\d+</b>&nbsp;W/m³K</td>', page
    )


def test_what_hardly_saves_kelvins_says_why_it_is_named_and_what_it_moves() -> None:
    found = diagnosed("edge_loss", 501, 7, 0.5)
    edge = found.findings[0]
    assert str(worth(found, edge)).endswith("on a typical run left out (geometric mean over the runs)")
    text = str(worth(found, replace(edge, gain=Gain(-0.0, (-0.1, 0.1)))))
    before, after = core_of(found.stages[0]), core_of(found.stages[1])
    assert "(0.00 of " in text
    assert "named because 7 of 7 runs, each left out in turn, fit better with it" in text
    shift = after - before
    assert f"the core is {abs(shift):.1f} K {'hotter' if shift > 0 else 'cooler'} when the press opens" in text
    assert re.search(r"it (raises|lowers) h_\w+ \(p[^)]+, (open|closed)\) by \d+ %", text)


def test_what_a_fitted_moment_of_insertion_shifts_is_no_error() -> None:
    stage = diagnosed("edge_loss", 501, 7, 0.5).stages[0]
    late = [np.linspace(0.0, 9.0, r.shift.size).reshape(r.shift.shape) for r in stage.fit.runs]
    runs = tuple(replace(r, shift=r.shift + s) for r, s in zip(stage.fit.runs, late, strict=True))
    moved = replace(stage, fit=replace(stage.fit, runs=runs))
    before, after = (measure_errors(s, LeftOut.of(r), r) for s, r in ((stage, stage.fit.runs), (moved, runs)))
    assert after.as_json() == before.as_json()


def core_of(stage) -> float:
    """Mean core temperature at opening. [°C]"""
    at = [
        np.interp(white.digest.moments.opened_s, white.digest.time, run.core)
        for white, run in zip(stage.data, stage.fit.runs, strict=True)
    ]
    return float(np.mean(at))


def test_a_run_that_tipped_the_choice_is_predicted_without_the_cause() -> None:
    found = diagnosed("edge_loss", 501, 7, 0.5)
    plain, final = found.stages
    tipped = Round([], {}, None, ("edge_loss",), (None,) * 7, "edge_loss")
    before, after = (held_out(s.fit, s.data) for s in (plain, final))

    def other(_: Candidate) -> list[RunState]:
        return after[::-1]

    assert [r.cost for r in never_seen([before, after], [tipped], other)] == [r.cost for r in before]
    rival = SimpleNamespace(effect=SimpleNamespace(name="another"))
    swayed = Round([], {}, None, ("edge_loss",), cast(tuple[Candidate, ...], (rival,) * 7), "edge_loss")
    assert [r.cost for r in never_seen([before, after], [swayed], other)] == [r.cost for r in after[::-1]]
    (kept,) = {c.name for c in found.findings}
    chosen = SimpleNamespace(effect=SimpleNamespace(name=kept))
    stays = Round([], {}, None, (kept,), cast(tuple[Candidate, ...], (chosen,) * 7), kept)
    assert [r.cost for r in never_seen([before, after], [stays], other)] == [r.cost for r in after]


def test_core_thermocouples_refute_only_where_every_one_of_at_least_two_is_met_far_worse() -> None:
    good = np.array([0.5, np.nan, 0.6])
    assert refuted_by_cores(np.array([3.0, np.nan, 2.0]), good)
    assert not refuted_by_cores(np.array([3.0, np.nan, 0.8]), good)
    assert not refuted_by_cores(np.array([3.0, np.nan, np.nan]), np.array([0.5, np.nan, np.nan]))


def test_a_cause_named_beside_a_better_one_is_no_alternative_to_it() -> None:
    named = ("moisture_evaporation", "thermocouple_lag", "resin_cure")
    nothing = np.zeros(12)
    found = [says(name, nothing, nothing, gain) for name, gain in zip(named, (90.0, 60.0, 50.0), strict=True)]
    round_ = Round(found, {}, found[0], named)
    assert _alternatives(round_, found[0], named[:2]) == ("moisture_evaporation", "resin_cure")
    assert _alternatives(round_, found[0], named[:1]) == named
    found[1] = says(named[1], nothing, nothing, 95.0)
    assert _alternatives(round_, found[0], named[:2]) == named


def test_a_scan_that_reads_one_face_after_the_other_is_no_cause() -> None:
    """Faces read 0.04 s apart: the delay is found, and less than half of what it does is left."""
    stage = diagnosed(None, 41).stages[0]
    run, white = stage.fit.runs[0], stage.data[0]
    slope = np.gradient(run.model, white.digest.time, axis=0)
    skewed = white.digest.y + np.array([0.02, -0.02]) * slope
    data = replace(white, digest=replace(white.digest, y=skewed))
    again = evaluate(stage.fit.layout, 0, data, stage.fit.theta, run.eta)
    moved = np.nanstd((again.misfit - run.misfit) * white.digest.trust)
    assert moved < 0.5 * np.nanstd((skewed - white.digest.y) * white.digest.trust)
    late = slice(3, 5)  # after two offsets and the insertion
    assert again.offsets[late] - run.offsets[late] == pytest.approx([-0.02, 0.02], abs=0.012)


def test_fast_scans_show_how_long_a_press_takes_to_open() -> None:
    runs = make_campaign(942000, 4, None, Plan(rate_hz=10.0))
    stage = settle_base(ThermalModel(press()), _screened(press(), [run for run, _ in runs])[1])
    fitted = [
        OPENING_RAMP_S + eta
        for unknowns, run in zip(stage.fit.layout.unknowns, stage.fit.runs, strict=True)
        for unknown, eta in zip(unknowns, run.eta, strict=True)
        if unknown.name == OPENING_RAMP
    ]
    true = [truth.pressing.opening_ramp for _, truth in runs]
    assert np.std(true) > 0.08
    assert fitted == pytest.approx(true, abs=0.04)


def test_a_log_that_begins_with_the_panel_shows_no_late_thermocouple() -> None:
    runs = [run for run, _ in make_campaign(932003, 12, None, Plan(core_column=0.25))]
    stage = settle_base(ThermalModel(press()), _screened(press(), runs)[1])
    assert all(d.digest.moments.inserted_s <= d.digest.run.time_s[0] for d in stage.data)
    (late,) = search(stage, [find_effect("thermocouple_lag")])
    assert late.gain < HOPELESS
    assert p_values([late], np.arange(12))["thermocouple_lag"] > ALPHA


def test_a_run_is_predicted_from_nothing_it_has_read_itself() -> None:
    """Readings of one run are moved by 5 K: its prediction stays, and the error is those 5 K more."""
    stage = diagnosed("edge_loss", 501, 7, 0.5).stages[0]
    thetas = from_the_others(stage.fit, stage.data)
    ahead = predicted(stage.fit, stage.data, thetas)
    digest = replace(stage.data[2].digest, y=stage.data[2].digest.y + 5.0)
    data = tuple(replace(d, digest=digest) if r == 2 else d for r, d in enumerate(stage.data))
    again = predicted(stage.fit, data, thetas)
    assert np.nanmax(np.abs(again[2].model - ahead[2].model)) < 1e-9
    assert np.nanmax(np.abs(again[2].misfit - ahead[2].misfit - 5.0)) < 1e-9
    assert np.nanmax(np.abs(ahead[2].misfit - (stage.data[2].digest.y - ahead[2].model))) < 1e-9


def test_the_interval_of_a_size_is_students_of_its_curvature_and_its_laws_own_error() -> None:
    stage = diagnosed("edge_loss", 501, 7, 0.5).stages[1]
    size = stage.fit.values["edge_loss.W_m3K"]
    curvature = np.diag(
        [1.0 / (7 * (0.04 * size) ** 2) if n == "edge_loss.W_m3K" else 0.0 for n in stage.fit.layout.names]
    )
    still = np.zeros_like(stage.fit.theta)
    known = replace(stage.fit, hessians=(curvature,) * 7, gradients=(still,) * 7, prior_hessian=0.0 * curvature)
    interval = intervals(known, find_effect("edge_loss"))["W_m3K"].ci95
    assert interval == pytest.approx((size * (1 - 2.447 * 0.05), size * (1 + 2.447 * 0.05)), rel=1e-3)


def test_runs_left_out_have_the_numbers_of_the_others_and_not_their_own() -> None:
    (stage, *_) = diagnosed("edge_loss", 501, 7, 0.5).stages
    thetas = from_the_others(stage.fit, stage.data, rounds=1)
    own = [stage.fit.theta] * len(stage.data)
    left_out, with_their_own = (
        measure_errors(
            stage, LeftOut.of(held_out(stage.fit, stage.data, 3, t)), predicted(stage.fit, stage.data, t)
        )
        for t in (thetas, own)
    )
    (found,) = stage_errors([stage], [])
    assert found.heldout.tolist() == left_out.heldout.tolist()
    assert found.predicted.tolist() == left_out.predicted.tolist()
    assert (np.abs(found.predicted - with_their_own.predicted) > 0.01).all()


@pytest.mark.parametrize(
    ("effect", "ends", "sure"),
    [
        ("platen_offset", {"top_K": (-1.0, 1.0), "bottom_K": (2.0, 3.0)}, True),
        ("platen_offset", {"top_K": (-1.0, 1.0), "bottom_K": (-0.1, 3.0)}, False),
        ("moisture_evaporation", {"moisture_percent": (0.0, 5.0), "temperature_C": (90.0, 110.0)}, False),
        ("moisture_evaporation", {"moisture_percent": (0.1, 5.0), "temperature_C": (90.0, 110.0)}, True),
    ],
)
def test_a_size_is_sure_where_one_amplitude_cannot_be_nothing(
    effect: str, ends: dict[str, tuple[float, float]], sure: bool
) -> None:
    values = {name: Interval(0.5 * sum(ci), ci) for name, ci in ends.items()}
    assert _size_is_sure(find_effect(effect), values) is sure


@pytest.mark.parametrize(("left", "confirm"), [(False, "Insulate the rim"), (True, "Press three sacrificial")])
def test_what_is_suspected_is_never_no_effect_and_to_be_confirmed_unless_more_is_left(
    left: bool, confirm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    suspected = diagnosed("edge_loss", 501, 7, 0.5).findings
    monkeypatch.setattr(verdict, "nearly_named", lambda *_: suspected)
    monkeypatch.setattr(verdict, "something_left", lambda *_: left)
    found = diagnose(press(), [run for run, _ in campaign(None, 41, 7)], effects=["edge_loss"], law=False)
    assert (found.verdict, found.findings) == (Verdict.UNKNOWN_EFFECT, ())
    assert [f.name for f in found.suspected] == ["edge_loss"]
    assert str(found.next_measurement).startswith(confirm)


def test_a_cause_that_halves_every_run_left_out_leaves_half_however_large_the_runs_errors_are() -> None:
    found = diagnosed("edge_loss", 501, 7, 0.5)
    before = replace(found.base, heldout=2.0 * found.extended.heldout)
    proof = _proof(found.findings[0], before, found.extended, found.noise_floor_K)
    assert proof.heldout_ratio == pytest.approx(0.5)


def test_a_cause_named_beside_a_suspected_one_has_the_interval_of_both_models(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    runs = [run for run, _ in campaign("edge_loss", 501, 7, 0.5)]
    alone = diagnose(press(), runs, effects=["edge_loss"])
    fit = alone.final.fit
    theta = fit.theta.copy()
    theta[fit.layout.names.index("edge_loss.W_m3K")] *= 1.2
    beside = replace(alone.final, fit=replace(fit, theta=theta))
    monkeypatch.setattr(verdict, "with_the_suspected", lambda *_: (beside,))
    (found,) = diagnose(press(), runs, effects=["edge_loss"]).findings
    own, other = (intervals(s.fit, find_effect("edge_loss"))["W_m3K"].ci95 for s in (alone.final, beside))
    assert own is not None
    assert other is not None
    assert found.parameters["W_m3K"].ci95 == (own[0], other[1])


def test_an_interval_holds_whichever_of_two_models_is_right_and_one_model_keeps_its_own() -> None:
    """The same fit twice, the second with a loss a fifth larger."""
    fit, effect = diagnosed("edge_loss", 501, 7, 0.5).stages[1].fit, find_effect("edge_loss")
    theta = fit.theta.copy()
    theta[fit.layout.names.index("edge_loss.W_m3K")] *= 1.2
    beside = replace(fit, theta=theta)
    one, other = (intervals(f, effect)["W_m3K"] for f in (fit, beside))
    union = intervals_of_models([fit, beside], effect)["W_m3K"]
    assert one.ci95 is not None
    assert other.ci95 is not None
    assert union.value == one.value
    assert union.ci95 == (one.ci95[0], other.ci95[1])
    assert intervals_of_models([fit], effect)["W_m3K"] == one


def test_a_size_at_its_limit_or_far_beyond_what_is_usual_is_unphysical() -> None:
    """Of a loss at the rim: five times the typical one."""
    fit, effect = diagnosed("edge_loss", 501, 7, 0.5).stages[1].fit, find_effect("edge_loss")
    (p,) = effect.parameters
    at = fit.layout.names.index(effect.key(p.name))

    def too_large(size: float) -> bool:
        theta = fit.theta.copy()
        theta[at] = size
        none = cast(Direction, None)
        return Candidate(effect, none, replace(fit, theta=theta), 0.0, np.zeros(7), True).too_large

    assert not too_large(4.9 * p.typical)
    assert too_large(5.1 * p.typical)
    assert too_large(p.upper)


def test_two_moments_a_standard_deviation_beyond_the_usual_score_the_root_of_two() -> None:
    stage = diagnosed("edge_loss", 501, 7, 0.5).stages[0]

    def late(run: RunState, unknowns: Sequence[Unknown]) -> RunState:
        late_s = [u.centre + CLOCK_ERROR_S + u.sd for u in unknowns]
        eta = [t if u.name in SWITCHED else e for t, u, e in zip(late_s, unknowns, run.eta, strict=True)]
        return replace(run, eta=np.array(eta))

    runs = tuple(late(*pair) for pair in zip(stage.fit.runs, stage.fit.layout.unknowns, strict=True))
    seen = ((20.0, 0.5), (80.0, 0.5))
    wired = tuple(replace(d, digest=replace(d.digest, switch=seen)) for d in stage.data)
    found = switch_scores(replace(stage, fit=replace(stage.fit, runs=runs), data=wired))
    assert found == pytest.approx([2.0**0.5] * 7)


def test_a_clock_is_off_only_beyond_what_scans_and_a_switch_are_always_off() -> None:
    """Every moment 0.03 s behind the switch is nothing, 0.1 s is 0.06 s beyond the usual 0.04 s."""
    stage = diagnosed("edge_loss", 501, 7, 0.5).stages[0]

    def behind(late_s: float) -> np.ndarray:
        def moved(run: RunState, unknowns: Sequence[Unknown]) -> RunState:
            eta = [u.centre + late_s if u.name in SWITCHED else e for u, e in zip(unknowns, run.eta, strict=True)]
            return replace(run, eta=np.array(eta))

        runs = tuple(moved(*pair) for pair in zip(stage.fit.runs, stage.fit.layout.unknowns, strict=True))
        wired = tuple(replace(d, digest=replace(d.digest, switch=((20.0, 0.5), (80.0, 0.5)))) for d in stage.data)
        return switch_scores(replace(stage, fit=replace(stage.fit, runs=runs), data=wired))

    assert behind(0.03) == pytest.approx([0.0] * 7, abs=1e-9)
    assert behind(-0.03) == pytest.approx([0.0] * 7, abs=1e-9)
    sds = [u.sd for u in stage.fit.layout.unknowns[0] if u.name in SWITCHED]
    assert behind(0.1)[0] == pytest.approx(sum(0.06 / sd for sd in sds) / 2.0**0.5)


def test_what_all_runs_lose_by_or_would_have_to_be_negative_has_no_p_value() -> None:
    runs, ones = np.arange(12), np.ones(12)
    assert p_values([says("lost", 0.0 * ones, -ones)], runs)["lost"] == 1.0
    assert p_values([says("turned", -ones, 0.0 * ones)], runs)["turned"] == 2.0**-11
    assert p_values([says("less than none", -ones, 0.0 * ones, one_sided=True)], runs)["less than none"] == 1.0
    assert p_values([says("there", ones, 0.0 * ones, one_sided=True)], runs)["there"] == 2.0**-11


def test_of_seven_runs_that_agree_every_one_halves_the_chance() -> None:
    assert max_t(np.ones((7, 1))) == pytest.approx([2.0**-6])
    assert max_t(np.array([[-1.0], *[[1.0]] * 6])) > 2.0**-6


def test_the_others_numbers_do_not_know_the_run_left_out() -> None:
    """Fitted on, the others' cost hardly falls from where one Newton step and one round have led."""
    stage = diagnosed("edge_loss", 501, 7, 0.5).stages[1]
    near, far = (from_the_others(stage.fit, stage.data, rounds)[3] for rounds in (1, 5))
    sd = np.sqrt(np.diag(stage.fit.covariance))
    assert np.abs(near - far).max() < 0.5 * sd.max()
    ends = [
        evaluate(stage.fit.layout, 3, stage.data[3], t, start_eta(stage.fit.layout, 3, t)) for t in (near, far)
    ]
    assert ends[0].cost == pytest.approx(ends[1].cost, rel=0.05)


def test_the_prediction_of_a_core_is_told_beside_that_of_the_fit() -> None:
    found = diagnosed("edge_loss", 501, 7, 0.5)
    base, extended = found.base.as_json(), found.extended.as_json()
    assert base["predicted_rmse_K"] > 2.0 * base["heldout_rmse_K"]
    assert extended["predicted_core_rmse_K"] < 0.5 * base["predicted_core_rmse_K"]
    assert extended["predicted_rmse_K"] < base["predicted_rmse_K"]


def test_the_noise_floor_is_the_readings_and_neither_the_misfit_nor_a_cap() -> None:
    found = diagnosed("edge_loss", 501, 7, 0.5)
    plain, final = found.stages
    alone = noise_floor([plain])
    assert alone == pytest.approx(noise_floor([final]), rel=0.15)
    assert found.base.rmse_K > 3.0 * alone
    rng = np.random.default_rng(4)
    noisy = []
    for run, d in zip(plain.fit.runs, plain.data, strict=True):
        blocks = rng.standard_normal((int(d.digest.time[-1] / BLOCK_S) + 2, run.misfit.shape[1]))
        noisy.append(replace(run, misfit=run.misfit + 3.0 * blocks[(d.digest.time / BLOCK_S).astype(int)]))
    loud = replace(plain, fit=replace(plain.fit, runs=tuple(noisy)))
    assert noise_floor([loud]) > 2.0


def test_a_model_that_leaves_corners_makes_no_noise() -> None:
    """Readings that jump from block to block where the loss at the rim is missing, as with a bad model."""
    stages = diagnosed("edge_loss", 501, 7, 0.5).stages
    jumps = tuple(
        replace(run, misfit=run.misfit + 2.0 * (np.floor(data.digest.time / BLOCK_S) % 2)[:, None])
        for run, data in zip(stages[0].fit.runs, stages[0].data, strict=True)
    )
    worse = replace(stages[0], fit=replace(stages[0].fit, runs=jumps))
    right = noise_floor([stages[1]])
    assert noise_floor([worse]) > 2.0 * right
    assert noise_floor([worse, stages[1]]) == noise_floor([stages[1], worse]) == right


def test_what_late_scans_make_of_steep_moments_is_no_more_than_noise() -> None:
    plain = diagnosed(None, 41).stages[0]
    runs = tuple(
        replace(run, misfit=run.misfit + 0.1 * d.digest.slope)
        for run, d in zip(plain.fit.runs, plain.data, strict=True)
    )
    noise = noise_floor([plain])
    for off, residual in ((1.2, plain.fit.runs), (EXCESS, runs)):
        stage = replace(plain, fit=replace(plain.fit, runs=residual))
        errors = measure_errors(stage, LeftOut.of(residual), residual)
        assert (errors.rmse_K > EXCESS * noise) is (residual is runs)
        assert errors.weighed_rmse_K < off * noise


def test_a_named_cause_says_what_it_means_for_the_core() -> None:
    text = sentences(core_messages(diagnosed("edge_loss", 501, 7, 0.5)))
    assert "K cooler than by the plain model" in text
    assert "Core thermocouples, which took no part in any fit" in text
    assert "core estimate stays as it is" in sentences(core_messages(diagnosed(None, 41)))


def test_two_runs_without_an_effect_are_too_few() -> None:
    assert diagnosed(None, 43, 2).verdict == "too_few_runs"


def test_two_runs_get_one_cause_at_most() -> None:
    """A draught is in no catalogue; two runs took it for paper and a footprint, and no veto asks so few."""
    runs = [run for run, _ in make_campaign(161200, 8, "draught", Plan(core_column=0.25))[:2]]
    found = diagnose(press(), runs, effects=["paper_layer", "thermocouple_footprint", "density_profile"])
    assert len(found.final.effects) <= 1


def test_the_order_of_the_runs_does_not_matter() -> None:
    runs = [run for run, _ in campaign(None, 41, 7)]
    again = diagnose(press(), runs[::-1], effects=["edge_loss"]).as_json()
    first = diagnose(press(), runs, effects=["edge_loss"]).as_json()
    assert {**again, "seconds": 0} == {**first, "seconds": 0}


def test_no_runs_are_refused_with_what_to_do() -> None:
    with pytest.raises(InputError, match="give at least one run file"):
        diagnose(press(), [])


def test_a_candidate_the_catalogue_does_not_hold_is_refused_and_not_called_no_effect() -> None:
    with pytest.raises(InputError, match="moisture_evaporatoin"):
        diagnose(press(), [run for run, _ in campaign(None, 41, 1)], effects=["moisture_evaporatoin"])


def test_runs_with_platens_only_are_refused_by_file_and_columns() -> None:
    run, _ = campaign(None, 41, 1)[0]
    bare = replace(
        run, columns={n: v for n, v in run.columns.items() if n.startswith("platen")} | closed_rows(run)
    )
    with pytest.raises(InputError, match=r"no usable panel channel; the press file's sensors name top_\*"):
        diagnose(press(), [bare])


def test_a_press_file_whose_sensors_are_all_for_validation_is_refused_as_such() -> None:
    run, truth = campaign(None, 41, 1)[0]
    apart = press().model_copy(update={"sensor": tuple(s for s in press().sensor if s.role == "validation")})
    for asked in (lambda: diagnose(apart, [run]), lambda: fit_run(ThermalModel(apart), run, truth.moments)):
        with pytest.raises(InputError, match="the press file has no sensor to fit with"):
            asked()


def closed_rows(run: Run) -> dict[str, np.ndarray]:
    return {"closed": ((run.time_s > 30.0) & (run.time_s < 60.0)).astype(float)}


def test_what_a_rim_loss_leaves_in_common_is_negligible() -> None:
    plain, final = diagnosed("edge_loss", 501, 7, 0.5).stages
    assert pattern_test(plain.pockets()).energy > NEGLIGIBLE_K**2 > pattern_test(final.pockets()).energy


@pytest.mark.campaign
@pytest.mark.parametrize("law", ["kinetic", "sorbed"])
def test_moisture_that_dries_by_another_law_gets_no_second_name(law: str) -> None:
    plan = Plan(core_column=0.25, drying_law=law)
    found = diagnose(press(), [run for run, _ in make_campaign(701, 8, "moisture_evaporation", plan)])
    assert [f.set for f in found.findings] == [("moisture_evaporation",)]


@pytest.mark.campaign
def test_panels_that_conduct_otherwise_are_a_second_cause_though_each_could_be_fitted_its_own() -> None:
    hidden = ["contact_asymmetry", "conductivity_offset"]
    found = diagnose(press(), [run for run, _ in make_campaign(8150050, 12, hidden, Plan(core_column=0.25))])
    assert [f.name for f in found.findings] == hidden
    both = gain_of(found.stages[-1].data, found.base.left_out, found.extended.left_out)
    assert 0.0 < found.findings[0].gain.value_K < both.value_K


def test_constants_that_are_off_explain_only_what_panels_as_given_leave() -> None:
    base = diagnosed(None, 41).stages[0]
    model = ThermalModel(press()).extended(find_effect("conductivity_offset"))
    further = settle(model, [d.digest for d in base.data], START_NOISE)
    noise = noise_floor([base, further])
    found = left_beside([base], further)
    assert found == tuple(residual_K(panels_given(stage)) / noise for stage in (base, further))
    assert found[0] > 1.05 * residual_K(base) / noise


@pytest.mark.campaign
def test_moisture_in_many_runs_gets_no_second_and_third_name() -> None:
    found = diagnose(press(), [run for run, _ in make_campaign(915007, edition(12, 24), "moisture_evaporation")])
    assert [f.set for f in found.findings] == [("moisture_evaporation",)]


def test_panels_that_differ_as_panels_do_are_no_unknown_effect() -> None:
    runs = [run for run, _ in make_campaign(932004, 12, None, Plan(core_column=0.25))]
    found = diagnose(press(), runs, effects=["edge_loss"])
    as_given = settle(ThermalModel(press()), [d.digest.as_given for d in found.stages[0].data], START_NOISE)
    assert residual_K(as_given) > EXCESS * found.noise_floor_K
    assert found.base.rmse_K < EXCESS * found.noise_floor_K
    assert found.verdict == "no_effect"
    assert [m.code for m in verdict_messages(found)] == ["verdict-plain-model-explains"]


def with_bad_cells(run: Run, bad: Mapping[str, Array]) -> Run:
    """Read 80 K too much in some rows."""
    return replace(run, columns={**run.columns, **{c: run.columns[c] + 80.0 * rows for c, rows in bad.items()}})


def test_single_bad_cells_of_platens_and_faces_are_no_effect_and_those_of_platens_stand_in_a_note() -> None:
    rng, spoilt = np.random.default_rng(9777200), []
    runs = [run for run, _ in make_campaign(9777200, 6)]
    for run in runs:
        rows = np.arange(len(run.time_s))
        faces = {c: rng.random(len(rows)) < 0.01 for c in run.columns if c.startswith(("top_", "bottom_"))}
        platen = {"platen_top": (rows == 0) | (rows == len(rows) // 2)}
        spoilt.append(with_bad_cells(run, faces | platen))
    found = diagnose(press(), spoilt)
    assert found.verdict is Verdict.NO_EFFECT
    assert found.base.rmse_K < 1.05 * diagnose(press(), runs).base.rmse_K
    note = "6 of 6 runs: 12 single cells of platen_top jump by more than 10 K and were left out"
    assert [str(w) for w in found.warnings if "platen_top" in str(w)] == [note]


def test_a_base_meets_a_run_that_its_own_fit_meets_however_far_off_the_guesses_are() -> None:
    """A press file without guesses of its own; begun from the usual ones the run stays 9 K off."""
    plain = parse_press(re.sub(r"\[coefficients[^[]*", "", press_toml()))
    run = make_campaign(303, 1, None, Plan(rate_hz=4.0))[0][0]
    assert fit_run(ThermalModel(plain), run, moments_seen(run, plain), company=None).met
    base = settle_base(ThermalModel(plain), _screened(plain, [run])[1])
    assert run_errors(base.data, base.fit.runs)[0] < 0.1
    assert base.misfit < 1.2


def test_a_campaign_whose_runs_have_all_gone_astray_finds_its_way_back() -> None:
    """Moments 1.2 s off in each run, so that none is worse off than the others."""
    good = settle_base(ThermalModel(press()), _screened(press(), [run for run, _ in campaign(None, 41, 7)])[1])
    layout = good.fit.layout.begun(good.fit.theta)
    late = [
        np.array([eta + 1.2 * (u.name in SWITCHED) for u, eta in zip(own, run.eta, strict=True)])
        for own, run in zip(layout.unknowns, good.fit.runs, strict=True)
    ]
    astray = fit_campaign_model(layout, good.data, late, rounds=0)
    misfits = [run.cost for run in astray.runs]
    assert max(misfits) < STUCK * np.median(misfits)
    assert astray.cost > 20.0 * good.fit.cost
    assert unstuck(astray, good.data).cost < 1.05 * good.fit.cost


def test_panels_may_differ_the_less_the_further_a_model_is_off_and_noise_does_not_grow() -> None:
    noise = START_NOISE
    assert finer(noise, 1.0) == (noise, 1.0)
    assert finer(noise, 16.0) == (noise, 0.25)
    assert finer(noise, 0.25) == (MeanNoise(noise.slow / 2, noise.fast / 2, noise.white / 2), 1.0)
    assert finer(noise, 0.0)[1] == 1.0


@pytest.mark.parametrize("earlier_s", [0.2, 3.0], ids=["a moment moved", "a ramp as short as it goes"])
def test_a_step_knows_what_late_signals_and_moved_moments_do_to_each_other(earlier_s: float) -> None:
    data, layout, theta, eta, names = panels_late(ramp_earlier_s=earlier_s)
    there = evaluate(layout, 0, data, theta, eta)
    assert np.ptp(there.offsets[len(data.digest.signals) + 1 :]) > 0.02  # signals are late
    linear, _ = np.linalg.qr(there.jacobian[:, len(eta) :])

    def free_of_offsets(series: Array) -> Array:
        return series - linear @ (linear.T @ series)

    for i, name in enumerate(names):
        step = np.zeros(len(eta))
        step[i] = 1e-4
        after, before = (evaluate(layout, 0, data, theta, eta + way * step, tangents=False) for way in (1, -1))
        moved = free_of_offsets(before.residual - after.residual) / 2e-4
        assert np.linalg.norm(free_of_offsets(there.jacobian[:, i]) - moved) < 0.01 * np.linalg.norm(moved), name


def panels_late(ramp_earlier_s: float) -> tuple[Whitened, Unknowns, Array, Array, list[str]]:
    """Return a run whose lower face is read late, and where a search might stand, its moments moved."""
    ((run, _), *_) = campaign(None, 41, 7)
    late = {
        c: np.interp(run.time_s - 0.2, run.time_s, v) for c, v in run.columns.items() if c.startswith("bottom")
    }
    model, run = ThermalModel(press()), replace(run, columns={**run.columns, **late})
    (data,) = settle(model, _screened(press(), [run])[1], START_NOISE).data
    layout = lay_out(model, [data.digest], {}, {})
    theta = np.array([s.begin for s in layout.shared])
    eta, names = start_eta(layout, 0, theta), [u.name for u in layout.unknowns[0]]
    eta[names.index("closed_s")] -= 0.15
    eta[names.index("ramp_s")] -= ramp_earlier_s
    return data, layout, theta, eta, names


def test_what_enters_linearly_stays_within_its_limits() -> None:
    """Held at its limit it is no longer free, and the others make up for it."""
    rows, plain = np.eye(3)[:, :2], np.array([10.0, 1.0, 0.0])
    found, free = bounded_offsets(rows, plain, np.ones(2), np.array([2.0, np.inf]))
    assert found == pytest.approx([2.0, 0.5])
    assert free.tolist() == [False, True]


def test_panels_that_all_store_more_heat_than_given_are_not_taken_for_usual_ones() -> None:
    runs = [run for run, _ in campaign("heat_capacity_offset", 930300, 7)]
    plain = settle_base(ThermalModel(press()), _screened(press(), runs)[1])
    middle, scatter = panels_as_usual(plain)
    assert middle < ALPHA_PATTERN / 2 < scatter
    usual = [run for run, _ in campaign(None, 41, 7)]
    plain = settle_base(ThermalModel(press()), _screened(press(), usual)[1])
    assert min(panels_as_usual(plain)) > ALPHA_PATTERN / 2


@pytest.mark.parametrize(
    ("ratios", "alike"),
    [
        ({"heat_capacity_offset": 1.44}, "12.0"),
        ({"conductivity_offset": 1.0 / 1.44}, "12.0"),
        ({"conductivity_offset": 1.0 / 1.2, "heat_capacity_offset": 1.2}, "12.0"),
        ({"conductivity_offset": 1.21}, "9.1"),
        ({"edge_loss": 1.44}, None),
    ],
)
def test_constants_that_are_off_are_told_with_the_thickness_that_would_look_the_same(
    ratios: dict[str, float], alike: str | None
) -> None:
    """A panel s times as thick is one of 1/s the conductivity and s the capacity, in the thickness given."""
    rest = (0.01, Gain(1.0, None), Gain(1.0, None), 1.0)
    found = [Finding(name, (name,), {"ratio": Interval(ratio, None)}, *rest) for name, ratio in ratios.items()]
    header = dict(campaign(None, 41, 7)[0][0].header) | {"panel.thickness_mm": 10.0}
    runs = [Run(f"v-{i}", header, np.zeros(1), {}) for i in range(3)]
    notes = [str(note) for note in thickness_notes(found, runs)]
    expected = f"panels of {alike} mm instead of the 10.0 mm in the headers would show the same: measure one"
    assert notes == ([expected] if alike else [])
    thicker = replace(runs[0], header=header | {"panel.thickness_mm": 16.0})
    assert thickness_notes(found, [*runs, thicker]) == ()


def test_pressings_asked_for_are_as_many_as_a_cause_needs() -> None:
    for runs in range(2, FEW_RUNS):
        asked = next_measurement(Verdict.TOO_FEW_RUNS, (), AdviceBasis(runs, panel=True))
        assert asked.arguments["more"] + runs == asked.arguments["least"]


@pytest.mark.parametrize("name", [e.name for e in BUILT_IN])
def test_the_next_measurement_is_one_sentence(name: str) -> None:
    finding = Finding(name, (name,), {}, 0.01, Gain(1.0, (0.5, 1.5)), Gain(1.0, (0.5, 1.5)), 1.0)
    text = str(next_measurement(Verdict.NAMED, (finding,), AdviceBasis(12, panel=True)))
    assert text.endswith(".")
    assert ". " not in text


@pytest.mark.parametrize("verdict", [v for v in Verdict if v not in (Verdict.NAMED, Verdict.AMBIGUOUS)])
def test_a_rig_of_layers_is_told_nothing_of_panels_and_cores(verdict: Verdict) -> None:
    advice = {str(next_measurement(verdict, (), AdviceBasis(3, panel=panel))) for panel in (False, True)}
    assert len(advice) == 2
    assert "panel" not in str(next_measurement(verdict, (), AdviceBasis(3, panel=False)))
    assert "core" not in str(next_measurement(verdict, (), AdviceBasis(3, panel=False)))


def test_one_run_with_a_loose_sensor_says_that_it_is_too_few_and_draws_its_residual() -> None:
    found = diagnosed("sensor_fault", 21, 1)
    assert sentences(verdict_messages(found)).endswith(
        "1 run is too few to distinguish any other cause from chance."
    )
    drawn = [line.get_label() for ax in residual_figure(curves_of(found)).get_axes() for line in ax.get_lines()]
    assert "plain model" in drawn
    assert "by comparison with the channels beside it" in diagnosis_report(found)
    assert "flipping" not in diagnosis_report(found)


def test_the_sentence_says_what_a_verdict_rests_on() -> None:
    found = diagnosed(None, 41)
    assert sentences(verdict_messages(found)).startswith("The plain model explains these 7 runs")
    beyond_chance = replace(found, verdict=Verdict.UNKNOWN_EFFECT)
    assert "with a cause added it fits them better than by chance" in sentences(verdict_messages(beyond_chance))
    unlike, elsewhere = ({"panels_alike": False}, {"panels_as_given": False})
    for panels, expected in ((unlike, "differ from one another"), (elsewhere, "otherwise than the headers give")):
        assert expected in sentences(
            verdict_messages(replace(beyond_chance, remains=(replace(found.left, **panels),)))
        )
    for left in ({"times_noise": 2.0}, {"off": (1,)}):
        differs = replace(beyond_chance, remains=(replace(found.left, **left),))
        assert "differs from run to run" in sentences(verdict_messages(differs))
    off = replace(found, verdict=Verdict.NOT_DESCRIBED)
    assert sentences(verdict_messages(off)).startswith("No verdict is possible: the model is ")
    doubted = replace(found, suspected=diagnosed("edge_loss", 501, 7, 0.5).findings)
    assert sentences(verdict_messages(doubted)).endswith("Suspected, not proven: heat lost at the rim.")
    for times, code in ((1.01 * EXCESS, "verdict-few-runs-off"), (0.99 * EXCESS, "verdict-few-runs")):
        few = replace(found, verdict=Verdict.TOO_FEW_RUNS, remains=(replace(found.left, times_noise=times),))
        assert [message.code for message in verdict_messages(few)] == [code]


def test_an_effect_in_half_of_the_runs_is_said_to_be_in_those() -> None:
    plain, grown = (make_campaign(872013, 4, effect, SMALL) for effect in (None, "contact_buildup"))
    runs = [(grown if i % 2 else plain)[i][0] for i in range(4)]
    found = diagnose(press(), runs, effects=["edge_loss"])
    note = found.as_json()["warnings"][0]
    assert note.startswith("more than noise is left in 2 of 4 runs, ")
    assert note.endswith(": v872013-02, v872013-04")
    assert note in diagnosis_report(found).replace("\N{NO-BREAK SPACE}", " ")
    rest, shared = (found.extended.weighed[some] for some in ([0, 2], [1, 3]))
    assert f"{np.sqrt(np.mean(shared**2)):.2f} K there and {np.sqrt(np.mean(rest**2)):.2f} K in the others" in note
    unknown = replace(
        found, verdict=Verdict.UNKNOWN_EFFECT, remains=(replace(found.left, pattern=PatternTest(0.0, 1.0, None)),)
    )
    many = replace(unknown, stages=(replace(found.stages[0], data=found.stages[0].data * 2),))
    assert sentences(verdict_messages(many)).startswith("Some of the runs share a residual")
    everywhere = replace(many, remains=(replace(unknown.left, off=()),))
    assert sentences(verdict_messages(everywhere)).startswith("All runs share a residual")
    assert everywhere.warnings == found.remarks
    advice = [
        str(next_measurement(Verdict.UNKNOWN_EFFECT, (), AdviceBasis(8, True, apart=runs)))
        for runs in (0, 1, 6, 7)
    ]
    assert [one.split()[0] for one in advice] == ["Press", "Find", "Find", "Find"]
    assert "themselves, with 5 more like them: below 6 runs" in advice[1]  # fewer give no verdict
    assert all(one.endswith("by themselves.") for one in advice[2:])


def test_what_is_left_is_told_where_it_is_most_kelvins_off_and_not_where_it_is_surest() -> None:
    rng = np.random.default_rng(8)
    surest = Pocket("panel.top", "closed", 0.0, 1.0, False, np.full(12, -0.03))
    largest = Pocket("panel.top", "opened", 8.0, 16.0, False, -0.4 + 0.15 * rng.standard_normal(12))
    chance = Pocket("panel.bottom", "opened", 8.0, 16.0, False, 3.0 * np.resize([1.0, -1.0, 0.9], 12))
    assert pattern_test([surest, largest, chance]).worst is largest


def heated(residual: Callable[[np.ndarray], np.ndarray]) -> tuple[Digest, np.ndarray]:
    """A run that never closes, half an hour long and 0.1 K warmer each second, and what a model leaves of it."""
    time = np.arange(2.0, 1800.0, 4.0)
    run = SimpleNamespace(
        time=time, y=20.0 + 0.1 * time[:, None], signals=("panel.back",), moments=Moments(inserted_s=0.0)
    )
    run.trust = np.ones((len(time), 1))
    return cast(Digest, run), residual(time)[:, None]


def test_a_run_that_is_wrong_for_a_while_is_told_for_when_and_at_which_temperatures() -> None:
    digest, left = heated(lambda t: np.where((t > 500.0) & (t < 596.0), -8.0, 0.0))
    (row,) = [where_row(p, [digest]) for p in stretches([digest], [left])]
    assert (row["from_s"], row["to_s"]) == (477.0, 596.0)
    assert row["residual_K"] == pytest.approx(-8.0 * 24 / 30, abs=0.4)
    assert (row["low_C"], row["high_C"]) == pytest.approx((67.8, 79.4), abs=0.5)


def test_neighbours_alike_are_told_as_one_stretch_and_others_apart() -> None:
    digest, left = heated(lambda t: np.select([t < 66.0, t < 198.0, t < 2000.0], [1.0, 4.0, 5.0]))
    found = [where_row(p, [digest]) for p in stretches([digest], [left])]
    assert [(w["from_s"], w["to_s"]) for w in found] == [(64.0, None), (0.0, 64.0)]
    assert found[0]["residual_K"] == pytest.approx(4.9, abs=0.1)


def test_a_stretch_that_half_of_several_runs_do_not_show_is_not_told() -> None:
    runs = [heated(lambda t, sign=sign: np.where(t > 931.0, 6.0 * sign, 2.0)) for sign in (1.0, -1.0, 1.0, -1.0)]
    found = stretches(*map(list, zip(*runs, strict=True)))
    assert [(p.from_s, p.to_s) for p in found] == [(0.0, 931.0)]


def test_rim_sensors_that_fall_are_told_with_their_kelvins() -> None:
    assert "1.2 K" in str(rim_notes(np.array([-1.3, -1.1, -1.2, np.nan]))[0])
    assert rim_notes(np.array([-0.1, 0.1, 0.0])) == ()
    assert rim_notes(np.full(3, np.nan)) == ()
    assert rim_notes(np.array([-3.0, 2.0, 0.2])) == ()  # as far above as below


@pytest.mark.parametrize("seed", [21, 22, 23])
def test_loose_drifting_and_swapped_channels_are_found_and_no_other(seed: int) -> None:
    for run, truth in make_campaign(seed, 4, "sensor_fault", SMALL):
        expected = {f.column for f in truth.faults} | {f.partner for f in truth.faults if f.partner}
        assert {f.column for f in screened(press(), run, moments_seen(run, press())).faults} == expected


def test_rim_sensors_that_read_lower_on_every_face_are_not_called_faulty() -> None:
    plan = Plan(rate_hz=2.0, rim_contrast=1.0)
    for run, truth in make_campaign(31, 4, "edge_loss", plan):
        expected = {f.column for f in truth.faults}
        assert {f.column for f in screened(press(), run, moments_seen(run, press())).faults} <= expected


def test_rim_sensors_fall_against_central_ones_when_the_rim_loses_heat() -> None:
    placed = parse_press(press_toml(positions=True))
    falls = {}
    for effect in ("edge_loss", None):
        runs = make_campaign(33, 4, effect, Plan(rate_hz=2.0, rim_contrast=1.0, press_time_s=(60.0, 120.0)))
        falls[effect] = [
            rim_falls(placed, r, moments_seen(r, placed), frozenset(f.column for f in t.faults)) for r, t in runs
        ]
    assert max(falls["edge_loss"]) < -0.15
    assert abs(np.mean(falls[None])) < 0.15


def test_sign_flips_keep_the_level_under_any_scale_of_the_runs() -> None:
    rng = np.random.default_rng(5)
    scale = np.exp(rng.normal(0.0, 1.0, 10))
    p = np.array([max_t(rng.standard_t(3, (10, 4)) * scale[:, None]).min() for _ in range(400)])
    assert 0.02 < np.mean(p <= 0.05) < 0.08


def says(
    name: str, score: np.ndarray, gains: np.ndarray, gain: float = 0.0, *, one_sided: bool = False
) -> Candidate:
    """What runs say for a cause, without the fit behind it."""
    effect = SimpleNamespace(name=name, needs="panel", one_sided=one_sided)
    return cast(Candidate, SimpleNamespace(effect=effect, score=score, gains=gains, gain=gain))


def test_a_cause_that_every_run_gains_by_is_sure_though_few_show_its_direction() -> None:
    """Numbers of a campaign with a conductivity 16 % off, in four runs plain enough to bend the plain fit."""
    score = np.array([3.0, 0.3, 1.6, -1.0, 0.4, 0.9, -0.2, 3.0, 3.0, 3.0, 1.1, -1.0])
    gains = np.array([193.9, 8.3, 9.8, 4.0, 3.3, 5.6, 3.4, 932.6, 288.3, 328.3, 6.8, 5.5])
    four = np.where(gains > 100, gains, -gains)
    everyone = np.arange(12)
    assert p_values([says("all", score, gains)], everyone)["all"] < 0.01
    assert p_values([says("four", score, four)], everyone)["four"] > 0.05


def test_large_scores_of_mixed_signs_do_not_tie_with_a_cause_that_six_runs_show() -> None:
    """What a misfit of many standard deviations does to every direction: cut off at three, flips cannot tell."""
    ones, none = np.ones(6), np.zeros(6)
    found = [says("there", 12.0 * ones, none), says("beside", 8.0 * np.array([1, 1, -1, 1, 1, -1.0]), none)]
    assert p_values(found, np.arange(6))["there"] == 2.0**-5
    assert p_values(found, np.arange(6))["beside"] > ALPHA


@pytest.mark.parametrize("lost", [1e3, 1e6, np.inf, np.nan])
def test_a_rival_that_fails_in_one_run_takes_nothing_from_a_cause_that_six_runs_show(lost: float) -> None:
    there = says("there", 3.0 * np.ones(6), 9.0 * np.ones(6))
    failed = says(
        "failed", np.array([0.5, -1.0, 1.0, -0.5, 0.3, 1.0]), np.array([-lost, 1.0, -0.5, 1.0, 0.2, -1.0])
    )
    assert p_values([there, failed], np.arange(6))["there"] == 2.0**-5
    assert p_values([there, failed], np.arange(6))["failed"] > ALPHA


def test_scores_and_gains_left_out_keep_their_common_level_where_nothing_is() -> None:
    """Six causes of twelve runs, one number each, by its formulas: a name by chance in 5 % of campaigns."""
    rng = np.random.default_rng(7)
    named = 0
    for _ in range(400):
        found = []
        residual = rng.standard_normal((12, 40)) * rng.uniform(0.5, 2.0, (12, 1))
        for i in range(6):
            direction = rng.standard_normal((12, 40)) * rng.lognormal(0.0, 0.7, (12, 1))
            u, w = (direction * residual).sum(axis=1), (direction**2).sum(axis=1)
            size = (u.sum() - u) / (w.sum() - w)
            found.append(says(str(i), u / np.sqrt(w), 2 * size * u - size**2 * w))
        p = p_values(found, np.arange(12))
        named += any(p[c.effect.name] <= 0.05 and c.gains.sum() > 0 for c in found)
    assert named <= 400 * 0.05 + 2 * np.sqrt(400 * 0.05 * 0.95)


def test_five_of_six_runs_that_are_plainly_likelier_are_no_luck_though_the_sixth_is_not() -> None:
    """What vapour at half its size saves (seed 9129001), where flips of six runs with one against come to 1/16."""
    assert likelihood_p(np.array([80.0, 250.0, 20.0, 130.0, 29.0, -3.0]), 20) == 1.0 / MANY
    assert likelihood_p(np.array([8.0, 8.0, 3.0, 1.0, -1.0, 5.0]), 20) > ALPHA


def test_a_third_of_the_runs_names_nothing_by_likelihood() -> None:
    assert likelihood_p(np.array([1e4, 1e4, 0.5, -0.5, 0.2, -1.0]), 20) == 1.0


def test_likelihood_of_runs_left_out_keeps_its_level_where_nothing_is() -> None:
    """Twenty causes of six runs, one number each, by its formulas; the bound is wider than it needs to be."""
    rng = np.random.default_rng(8)
    named = 0
    for _ in range(1000):
        residual = rng.standard_normal((6, 40))
        least = 1.0
        for _ in range(20):
            direction = rng.standard_normal((6, 40)) * rng.lognormal(0.0, 0.7, (6, 1))
            u, w = (direction * residual).sum(axis=1), (direction**2).sum(axis=1)
            size = (u.sum() - u) / (w.sum() - w)
            least = min(least, likelihood_p(2 * size * u - size**2 * w, 20))
        named += least <= ALPHA
    assert named <= 50


@pytest.mark.campaign
def test_steam_at_half_its_size_is_named_from_six_runs_of_which_one_shows_next_to_nothing() -> None:
    runs = [run for run, _ in make_campaign(9129001, 6, "vapour_convection", Plan(core_column=0.25, scale=0.5))]
    found = diagnose(press(), runs)
    assert [f.set for f in found.findings] == [("vapour_convection",)]
    assert found.findings[0].p_value <= ALPHA
    assert found.findings[0].gain.ci95[0] > 0.0


def test_each_sign_pattern_and_its_opposite_count_once() -> None:
    patterns = sign_patterns(5)
    assert patterns.shape == (16, 5)
    assert (patterns[0] == 1.0).all()
    assert len(np.unique(np.concatenate([patterns, -patterns]), axis=0)) == 32


def test_load_columns_a_run_lacks_are_among_the_remarks():
    text = press_toml().replace('closed = "h_p_c"', 'closed = "h_p_c"\nload = { column = "kN" }', 1)
    run, _ = make_campaign(5, 1)[0]
    (remark,) = _lacking_loads(parse_press(text), [run])
    assert "load column 'kN' is missing" in str(remark)


def test_a_report_in_german_says_nothing_of_its_own_in_english() -> None:
    page = diagnosis_report(diagnosed("edge_loss", 501, 7, 0.5), "de").replace("\N{NO-BREAK SPACE}", " ")
    assert '<html lang="de">' in page
    for part in ("Was falsch ist", "Beim Öffnen der Presse", "Residuum aller Fühler", "geschlossen"):
        assert part in page
    english = {c: t.strip() for c, t in catalogue_of("en").entries().items() if c.startswith("report-")}
    shown = re.sub(r"<svg.*?</svg>|<style.*?</style>", "", page, flags=re.DOTALL)
    assert not [c for c, text in english.items() if "{" not in text and f">{text}<" in shown]
    assert not re.search(r"\bnamed\b", shown)  # the verdict's code, which is for machines
    assert re.search(r"erweitert \d,\d\d K", page)


@pytest.mark.parametrize(
    ("means_K", "sure_K"),
    [
        (
            [-15.0, -17.0, -13.0, -15.0],
            15.0 - 4.1765 * np.sqrt(8.0 / 3.0) / 2.0,
        ),  # t of 3 degrees at 97.5 % two-sided
        ([3.6, -1.2, -1.8, 2.7, -0.6], 0.0),
        ([9.0], 0.0),
        ([], 0.0),
    ],
)
def test_cores_are_surely_off_where_all_runs_share_it_and_not_where_panels_scatter(means_K, sure_K, monkeypatch):
    monkeypatch.setattr(numbers, "_depth_errors", lambda *_: [np.zeros(1)])
    silent = SimpleNamespace(digest=SimpleNamespace(cores={}))
    read = [SimpleNamespace(digest=SimpleNamespace(cores={"core_1": np.array([50.0, np.nan, 60.0])}))]
    runs = [SimpleNamespace(validation={"core_1": np.array([50.0, 0.0, 60.0]) - mean}) for mean in means_K]
    stage = SimpleNamespace(
        data=[*read * len(means_K), silent],
        fit=SimpleNamespace(runs=[*runs, SimpleNamespace(validation={})]),
    )
    assert sure_core_error_K(stage) == pytest.approx(sure_K, abs=1e-3)


HEATED_SLAB = """
[[layer]]
name = "slab"
thickness_mm = 20.0
density_kg_m3 = 650.0
conductivity_W_mK = 0.15
heat_capacity_J_kgK = 1500.0
[initial]
kind = "uniform"
temperature_C = 20.0
[boundary.top]
kind = "flux"
incident_W_m2 = 8000.0
coefficient = "h"
[coefficients.h]
guess = 15.0
lower = 1.0
upper = 100.0
[[sensor]]
columns = ["top"]
at = "slab.top"
[[sensor]]
columns = ["deep"]
role = "validation"
at = { layer = "slab", depth_mm = 15.0 }
"""


def test_a_core_that_may_lie_off_its_depth_in_steep_heat_is_not_surely_off() -> None:
    """It lies 0.25 mm nearer to the heat in all runs, and heat rises by more than 10 K/mm."""
    moved = parse_press(HEATED_SLAB.replace("15.0 }", "15.25 }"))
    time_s, rng, runs = np.arange(0.0, 300.0), np.random.default_rng(4), []
    for flux in (7000.0, 8000.0, 9000.0, 10000.0):
        header = {"ambient.temperature_C": 20.0, "boundary.top.incident_W_m2": flux}
        empty = Run(f"{flux:.0f}", header, time_s, {c: np.full(len(time_s), np.nan) for c in ("top", "deep")})
        model = ThermalModel(moved)
        found = model.solve(model.prepare(empty, Moments()), {"h": 15.0})
        noisy = {c: found.column(c) + 0.1 * rng.normal(size=len(time_s)) for c in empty.columns}
        runs.append(replace(empty, columns=noisy))
    sure = []
    for sd in ("", ', "depth_mm.sd" = 0.01'):
        thermal = ThermalModel(parse_press(HEATED_SLAB.replace("15.0 }", f"15.0{sd} }}")))
        stage = settle_base(thermal, [digest_run(thermal.press, run, Moments()) for run in runs])
        sure.append(sure_core_error_K(stage))
    assert sure[0] == 0.0
    assert sure[1] > CORE_OFF_K
