"""The nightly job: only what changed, nothing lost, the old model in place until a better one is proved."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import event, update

from api.cli import main
from daq.press.press_file import parse_press
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.store import Store, StoreUnavailable, archive, open_store, process_lock
from daq.store.proved_file import sound_content
from daq.store.schema import NIGHT, RUN, SCAN
from daq.supervision import unexpected
from daq.words import Message, say
from daq.words.message import words
from softsensor.heat.model_file import FittedValue, ModelFile
from softsensor.heat.model_reading import parse_model
from softsensor.jobs import cluster as cluster_of_workers
from softsensor.jobs import night as nightly
from softsensor.jobs import night_comparison
from softsensor.jobs import night_fits as nightly_fits
from softsensor.jobs import night_judgement as nightly_judge
from softsensor.jobs import night_progress as progress
from softsensor.jobs import nights as fleet
from softsensor.jobs.cluster import WorkersLost, on_dask
from softsensor.jobs.model_in_force import combined_model, fingerprint
from softsensor.jobs.night import refit_press, roll_back
from softsensor.jobs.night_basis import FAILED, NightBasis
from softsensor.jobs.night_comparison import surely_less
from softsensor.jobs.night_fits import Done, FitTask, fit_all, fit_stored
from softsensor.jobs.night_record import night_record, stored_night_record
from softsensor.jobs.nights import refit_presses
from softsensor.jobs.retention import OldScans, Rules, keep_house
from softsensor.report.night_report import night_report, write_report
from tests.editions import edition
from tests.panels import panel_stated

PRESS = parse_press(press_toml())
PLAN = Plan(
    rate_hz=1.0, thickness_mm=16.0, start_before_s=6.0, closed_column=True,
    press_time_s=(25.0, 40.0), open_before_s=(6.0, 8.0), open_after_s=(20.0, 25.0),
)  # fmt: skip


@pytest.fixture
def store(tmp_path):
    with open_store(str(tmp_path / "kerntemp.sqlite")) as opened:
        yield opened


def fill(store, runs):
    for run in runs:
        store.import_run(run, "lab", press_toml())


@pytest.fixture(scope="module")
def runs():
    campaign = make_campaign(51, 4, None, replace(PLAN, panel_spread=0.0))
    return [panel_stated(run, 0.01) for run, _ in campaign]


def test_runs_are_fitted_once_and_a_first_model_is_promoted(store, runs):
    fill(store, runs[:3])
    first = refit_press(store, "lab", PRESS, workers=1)
    assert (first.runs, first.fitted, first.failed) == (3, 3, 0)
    assert first.promoted
    model = store.active_model("lab")
    assert model is not None
    assert set(model.model["coefficients"]) == set(PRESS.coefficient_names)
    assert model.model["effects"] == []
    again = refit_press(store, "lab", PRESS, workers=1)
    assert (again.runs, again.fitted, again.promoted) == (3, 0, False)
    fill(store, runs[3:])
    store.annotate_run(runs[0].name, {"panel.density_kg_m3": 700.0}, "tester")
    third = refit_press(store, "lab", PRESS, workers=1)
    assert (third.runs, third.fitted) == (4, 2)
    assert store.active_model("lab").version == model.version


def test_a_run_that_comes_while_the_night_works_is_the_next_night_s(store, runs, monkeypatch):
    fill(store, runs[:3])
    whole = nightly_fits.fit_stored

    def meanwhile(task):
        if task.run == runs[0].name:
            fill(store, runs[3:])
        return whole(task)

    with monkeypatch.context() as patched:
        patched.setattr(nightly_fits, "fit_stored", meanwhile)
        first = refit_press(store, "lab", PRESS, workers=1)
    assert str(first.fits_line) == "3 of 3 runs fitted, 0 could not be fitted"
    second = refit_press(store, "lab", PRESS, workers=1)
    assert (second.runs, second.new, second.fitted) == (4, 1, 1)


def test_a_job_killed_among_the_fits_goes_on_where_it_was(store, runs, monkeypatch):
    fill(store, runs[:3])
    whole = nightly_fits.fit_stored
    left = [2]

    def dying(task):
        if left[0] == 0:
            raise KeyboardInterrupt
        left[0] -= 1
        return whole(task)

    with monkeypatch.context() as patched:
        patched.setattr(nightly_fits, "fit_stored", dying)
        with pytest.raises(KeyboardInterrupt):
            refit_press(store, "lab", PRESS, workers=1)
    assert store.active_model("lab") is None
    assert refit_press(store, "lab", PRESS, workers=1).fitted == 1


def test_each_run_is_bet_on_once_wherever_a_night_is_killed(store, runs, monkeypatch):
    def bets():
        return progress.Progress.of(store, "lab").bets

    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(nightly, "judge_night", lambda night, outcome: outcome)
    fill(store, runs[:3])
    for where in ("judge_night", "alarms_of"):
        with monkeypatch.context() as patched:
            patched.setattr(nightly, where, killed)
            with pytest.raises(KeyboardInterrupt):
                refit_press(store, "lab", PRESS, workers=1)
        assert bets().runs == 0
    refit_press(store, "lab", PRESS, workers=1)
    first = bets()
    assert (first.models, first.runs, first.counted) == (1, 3, store.run_record(runs[2].name).number)
    assert first.average != 1.0
    refit_press(store, "lab", PRESS, workers=1)
    assert bets() == first
    fill(store, runs[3:])
    refit_press(store, "lab", PRESS, workers=1)
    assert bets().runs == 4
    promote_with(store, "lab-1", "edge_loss")
    fill(store, [replace(runs[0], name="later")])
    refit_press(store, "lab", PRESS, workers=1)
    assert (bets().models, bets().runs, bets().counted) == (2, 0, store.run_record("later").number)


def test_a_pressing_that_is_stored_twice_is_judged_once(store, runs):
    fill(store, [*runs[:3], replace(runs[0], name="copy")])
    outcome = refit_press(store, "lab", PRESS, workers=1)
    assert [run for run, _ in outcome.left_out] == ["copy"]
    assert f"holds the readings of run '{runs[0].name}'" in str(outcome.unread[0])


@pytest.mark.parametrize("started", [None, datetime(2026, 3, 4, 7, 0, 0, 123456, UTC)], ids=["undated", "dated"])
@pytest.mark.parametrize("newest", [3, 200])
def test_a_pressing_that_comes_again_under_another_name_is_no_further_evidence(
    store, runs, started, newest, monkeypatch
):
    monkeypatch.setattr(nightly, "judge_night", lambda night, outcome: outcome)
    monkeypatch.setattr(nightly, "DIAGNOSED_RUNS", newest)
    monkeypatch.setattr(nightly, "JUDGES", 0)
    when = {"recorded.started_utc": started} if started else {}
    first = [replace(run, header={**run.header, **when}) for run in runs]
    fill(store, first)
    refit_press(store, "lab", PRESS, workers=1)
    before = store.nights(press="lab").items[0].progress["bets"]
    if started:
        store.use_archive(store.database.path.parent / "archive")
        for run in runs:
            store.archive_run(run.name)
    fill(store, [replace(run, name=f"copy of {run.name}") for run in first])
    refit_press(store, "lab", PRESS, workers=1)
    told = [entry.message.code for entry in store.journal(press="lab", level="alarm").items]
    assert told == ["run-not-judged"] * len(runs)
    assert store.nights(press="lab").items[0].progress["bets"] == before
    assert before["runs"] == min(len(runs), newest)


def damage_of(store, kind, run, tmp_path):
    if kind == "a row":
        first = store.run_record(run).first_scan
        with store.database.writing() as connection:
            connection.execute(update(SCAN).where(SCAN.c.number == first + 5).values(readings="[20.1,"))
    elif kind == "its header":
        with store.database.writing() as connection:
            connection.execute(update(RUN).where(RUN.c.run == run).values(header_toml="x = = 1"))
    else:
        store.use_archive(tmp_path / "archive")
        store.archive_run(run)
        [file] = (tmp_path / "archive").rglob(f"*-{run}.parquet")
        file.write_bytes(file.read_bytes()[:-200])


DAMAGED = {"a row": "scan", "its header": "header", "a file of the archive": "archive file"}


@pytest.mark.parametrize("kind", DAMAGED)
@pytest.mark.parametrize("fitted", [True, False], ids=["fitted before", "not fitted yet"])
def test_a_run_that_cannot_be_read_is_left_out_with_an_alarm_and_the_night_goes_on(
    store, runs, tmp_path, kind, fitted
):
    fill(store, runs[:3])
    if fitted:
        assert refit_press(store, "lab", PRESS, workers=1).fitted == 3
        store.annotate_run(runs[0].name, {"panel.density_kg_m3": 700.0}, "tester")
    damage_of(store, kind, runs[1].name, tmp_path)
    fill(store, runs[3:])
    outcome = refit_press(store, "lab", PRESS, workers=1)
    assert outcome.fitted == (2 if fitted else 3)
    [(run, why)] = outcome.left_out
    assert run == runs[1].name
    assert DAMAGED[kind] in str(why)
    judged = fitted and kind != "its header"  # whose fit does not stand, for nobody knows of which panel it is
    if judged:
        assert outcome.unread == (why,)
    assert outcome.verdict != FAILED
    alarms = [e.message.code for e in store.journal(press="lab", level="alarm").items]
    assert alarms == ["run-not-judged" if judged else "run-not-fitted"]
    (night,) = store.nights(press="lab", limit=1).items
    assert [entry["run"] for entry in night.night["left_out"]] == [runs[1].name]
    again = refit_press(store, "lab", PRESS, workers=1)
    assert (again.fitted, again.unread) == (0, ())


def without_panel_sensors(run):
    return replace(
        run,
        name="blind",
        header=dict(run.header) | {"run": "blind"},
        columns={n: v for n, v in run.columns.items() if not n.startswith(("top", "bottom"))},
    )


def without_platens(run):
    return replace(run, columns={n: v for n, v in run.columns.items() if not n.startswith("platen")})


def test_a_run_that_cannot_be_fitted_does_not_stop_the_others(store, runs):
    fill(store, [without_platens(runs[0]), *runs[1:3]])
    outcome = refit_press(store, "lab", PRESS, workers=1)
    assert (outcome.fitted, outcome.failed) == (2, 1)
    assert outcome.verdict == "too_few_runs"
    assert any(runs[0].name in str(entry.message) for entry in store.journal(level="warning").items)


def test_a_pressing_without_panel_sensors_as_in_production_is_no_failure(store, runs):
    fill(store, [without_panel_sensors(runs[0]), runs[1]])
    for fitted, kept in ((1, ""), (0, "1 keeps its fit, ")):
        outcome = refit_press(store, "lab", PRESS, workers=1)
        nightly.sign_off(store, [outcome])
        assert (outcome.fitted, outcome.failed, outcome.newly_unfit) == (fitted, 0, 0)
        assert f"{fitted} of 2 runs fitted, {kept}0 could not be fitted, 1 has no panel sensors" in str(
            outcome.line
        )
    assert not store.journal(level="warning").items


def test_a_run_that_cannot_be_fitted_is_named_once_and_tried_again_when_it_has_changed(store, runs):
    def nightly_job():
        outcome = refit_press(store, "lab", PRESS, workers=1)
        nightly.sign_off(store, [outcome])
        return outcome

    fill(store, [without_platens(runs[0])])
    first, second = nightly_job(), nightly_job()
    assert (first.failed, first.newly_unfit) == (1, 1)
    assert (second.failed, second.newly_unfit) == (1, 0)
    unfit = [
        entry for entry in store.journal(level="warning").items if "could not be fitted" in str(entry.message)
    ]
    assert len(unfit) == 1
    assert store.statuses()["refit"].status["state"] == "done"
    store.annotate_run(runs[0].name, {"panel.density_kg_m3": 700.0}, "tester")
    assert nightly_job().newly_unfit == 1


def kill_here():
    os.kill(os.getpid(), signal.SIGKILL)


class Poison:
    """A model that really kills each worker it comes to."""

    def __reduce__(self):
        return kill_here, ()


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_a_run_that_kills_the_workers_is_told_and_the_others_are_fitted(store, runs):
    fill(store, runs[:3])
    url = store.database.url.render_as_string()
    done = fit_all(
        [FitTask(url, PRESS, run.name, Poison() if i == 1 else None) for i, run in enumerate(runs[:3])], 2
    )
    found = {one.run: (one.fit is not None, one.killed) for one in done}
    assert found == {runs[0].name: (True, False), runs[1].name: (False, True), runs[2].name: (True, False)}


def test_a_killed_fit_is_an_alarm_of_the_night_and_tried_again_the_next(store, runs, monkeypatch):
    fill(store, runs[:3])
    whole = nightly_fits.fit_stored

    def shot(task):
        return Done(task.run, killed=True) if task.run == runs[1].name else whole(task)

    with monkeypatch.context() as patched:
        patched.setattr(nightly_fits, "fit_stored", shot)
        outcome = refit_press(store, "lab", PRESS, workers=1)
    assert (outcome.fitted, outcome.failed) == (2, 1)
    (alarm,) = store.journal(level="alarm").items
    assert (alarm.message.code, alarm.message.arguments["run"]) == ("run-fit-killed", runs[1].name)
    assert refit_press(store, "lab", PRESS, workers=1).fitted == 1


@pytest.mark.campaign
def test_workers_find_what_one_process_finds(store, runs):
    fill(store, runs)
    tasks = [FitTask(store.database.url.render_as_string(), PRESS, run.name, None) for run in runs]

    def values(results):
        return {one.run: {n: c["value"] for n, c in one.fit["coefficients"].items()} for one in results}

    alone = values(fit_all(tasks, 1))
    shared = values(fit_all(tasks, 2))
    assert shared == {run: pytest.approx(table, rel=1e-9) for run, table in alone.items()}


def test_the_model_before_comes_back_by_one_call(store, runs):
    fill(store, runs[:1])
    table = {n: FittedValue(PRESS.coefficient(n).guess, 10.0) for n in PRESS.coefficient_names}
    for version in ("lab-1", "lab-2"):
        store.put_model("lab", version, ModelFile(version, "lab", table).as_json())
        store.promote_model(version, "test")
    assert roll_back(store, "lab") == "lab-1"
    assert store.active_model("lab").version == "lab-1"
    with pytest.raises(InputError, match="no earlier model"):
        roll_back(store, "lab")  # not forward again
    store.promote_model("lab-2", "test")
    store.promote_model("lab-1", "test")  # an old one by hand
    assert [roll_back(store, "lab"), roll_back(store, "lab")] == ["lab-2", "lab-1"]


def killed(*_):
    raise KeyboardInterrupt


def test_fits_that_no_finished_job_has_judged_are_judged_whoever_made_them(store, runs, monkeypatch):
    judged = []

    def judge(night, outcome):
        judged.append(sorted(night.fits))
        return nightly_judge._keep_or_begin(night, combined_model(PRESS, None, list(night.fits.values())), outcome)

    monkeypatch.setattr(nightly, "judge_night", judge)
    fill(store, runs[:3])
    with monkeypatch.context() as patched:
        patched.setattr(type(store), "put_night", killed)  # before its end: no sign-off
        with pytest.raises(KeyboardInterrupt):
            refit_press(store, "lab", PRESS, workers=1)
    refit_press(store, "lab", PRESS, workers=1)
    refit_press(store, "lab", PRESS, workers=1)
    assert [len(runs) for runs in judged] == [3, 3]
    fill(store, runs[3:])
    base = parse_model(store.active_model("lab").model, "model")
    fit = nightly_judge.fit_one(PRESS, runs[3], base)  # as the live sensor leaves it after a pressing
    store.put_fit(
        runs[3].name, {**fit, "fingerprint": fingerprint(store.run_record(runs[3].name), PRESS, base)}, "x"
    )
    last = refit_press(store, "lab", PRESS, workers=1)
    assert last.fitted == 0
    assert [len(runs) for runs in judged] == [3, 3, 4]


@pytest.fixture
def judging_nothing(monkeypatch):
    """Nights that fit in no time and judge nothing: what is looked at is what they are asked for."""
    monkeypatch.setattr(nightly, "judge_night", lambda night, outcome: outcome)
    monkeypatch.setattr(nightly, "settled", lambda bets, *_: bets)
    monkeypatch.setattr(nightly_fits, "fit_stored", lambda task: Done(task.run, {"run": task.run, "rmse_K": 0.3}))


def promote_with(store, version, *effects):
    table = {n: FittedValue(PRESS.coefficient(n).guess, 10.0) for n in PRESS.coefficient_names}
    parameters = {"W_m3K": FittedValue(1000.0, 100.0)}
    model = ModelFile(version, "lab", table, tuple((name, parameters) for name in effects))
    store.put_model("lab", version, model.as_json())
    store.promote_model(version, "test")


def test_a_promoted_effect_refits_the_newest_runs_at_once_and_the_others_night_by_night(
    store, runs, monkeypatch, judging_nothing
):
    monkeypatch.setattr(progress, "WINDOW", 4)
    monkeypatch.setattr(progress, "SHARE", 3)
    fill(store, [replace(runs[0], name=f"run-{i:02}") for i in range(12)])
    first = refit_press(store, "lab", PRESS, workers=1)
    assert (first.new, first.fitted, first.later) == (12, 12, 0)
    promote_with(store, "lab-1", "edge_loss")
    nights = [refit_press(store, "lab", PRESS, workers=1) for _ in range(4)]
    assert [(n.new, n.fitted, n.later) for n in nights] == [(0, 7, 5), (0, 3, 2), (0, 2, 0), (0, 0, 0)]
    assert "7 of 12 runs fitted, 0 could not be fitted, 5 older ones follow in the next 2 nights" in str(
        nights[0].line
    )
    assert "2 older ones follow in the next night;" in str(nights[1].line)
    assert [night.night["later"] for night in store.nights(press="lab").items] == [0, 0, 2, 5, 0]


def test_edited_and_late_runs_far_behind_the_newest_are_found(store, runs, monkeypatch, judging_nothing):
    monkeypatch.setattr(progress, "WINDOW", 2)
    fill(store, [replace(runs[0], name=f"run-{i:02}") for i in range(8)])
    refit_press(store, "lab", PRESS, workers=1)
    store.annotate_run("run-01", {"panel.density_kg_m3": 700.0}, "tester")
    fill(store, [replace(runs[0], name=f"late-{i:02}") for i in range(5)])
    outcome = refit_press(store, "lab", PRESS, workers=1)
    assert (outcome.new, outcome.fitted) == (5, 6)
    assert store.fit("run-01")["fingerprint"] == fingerprint(store.run_record("run-01"), PRESS, None)


def differing(run, name, kelvin):
    """A pressing of its own: copies of one are looked up."""
    return replace(run, name=name, columns={**run.columns, "top_1": run.columns["top_1"] + kelvin})


def test_a_night_asks_as_often_whatever_is_stored(store, runs, monkeypatch, judging_nothing):
    monkeypatch.setattr(progress, "WINDOW", 4)
    asked = []
    event.listen(store.database.engine, "before_cursor_execute", lambda *a: asked.append(a[2]))
    counts = []
    for stored in (10, 40):
        fill(store, [differing(runs[0], f"run-{stored}-{i:02}", 1e-3 * (i + stored)) for i in range(stored)])
        refit_press(store, "lab", PRESS, workers=1)
        asked.clear()
        refit_press(store, "lab", PRESS, workers=1)
        counts.append(len(asked))
    reads = 4 * progress.WINDOW  # each run that a judgement rests on is read once, by four questions
    assert counts[0] == counts[1] < 60 + reads


def test_the_row_of_a_night_says_what_was_new_left_out_named_and_kept(store, runs):
    fill(store, [without_platens(runs[0]), *runs[1:4]])
    refit_press(store, "lab", PRESS, workers=1)
    (night,) = store.nights(press="lab").items
    content = night.night
    assert (content["runs"], content["new"], content["fitted"], content["not_fitted"]) == (4, 4, 3, 1)
    assert [entry["run"] for entry in content["left_out"]] == [runs[0].name]
    assert content["promoted"] == content["version"] == store.active_model("lab").version
    assert 0.0 < content["seconds"] <= (night.ended_utc - night.started_utc).total_seconds() + 1.0
    assert content["memory_bytes"] is None or content["memory_bytes"] > 50e6
    assert set(store.newest_nights()) == {"lab"}


def test_there_is_nothing_before_the_first_model(store):
    with pytest.raises(InputError, match="no earlier model"):
        roll_back(store, "lab")


def test_a_model_somebody_has_gone_back_from_is_not_promoted_again_at_night(store, runs, monkeypatch):
    fill(store, runs)
    table = {n: FittedValue(PRESS.coefficient(n).guess, 10.0) for n in PRESS.coefficient_names}
    plain = ModelFile("lab-1", "lab", table)
    rim = replace(plain, version="lab-2", effects=(("edge_loss", {"W_m3K": FittedValue(1000.0, 100.0)}),))
    for model in (plain, rim):
        store.put_model("lab", model.version, model.as_json())
        store.promote_model(model.version, "test")
    report = {"verdict": "named", "base": {}, "extended": {}}
    monkeypatch.setattr(nightly_judge, "_diagnose", lambda night, asked: (report, rim, []))
    monkeypatch.setattr(
        nightly_judge,
        "compare",
        lambda *_, **__: night_comparison.Comparison(say("plain-text", text="better"), True, {}),
    )
    monkeypatch.setattr(nightly_judge, "_fits_with", lambda *_: {})
    roll_back(store, "lab")
    outcome = refit_press(store, "lab", PRESS, workers=1)
    assert not outcome.promoted
    assert "like lab-2, which was rolled back" in str(outcome.reason)
    assert store.active_model("lab").version == "lab-1"
    assert store.models(press="lab").items[0].status == "candidate"


def test_an_effect_the_diagnosis_no_longer_finds_goes_unless_it_still_helps(store, runs, monkeypatch):
    fill(store, runs)
    table = {n: FittedValue(PRESS.coefficient(n).guess, 10.0) for n in PRESS.coefficient_names}
    plain = ModelFile("", "lab", table)
    rim = replace(plain, version="lab-1", effects=(("edge_loss", {"W_m3K": FittedValue(1000.0, 100.0)}),))
    store.put_model("lab", "lab-1", rim.as_json())
    store.promote_model("lab-1", "test")
    report = {"verdict": "no_effect", "base": {}, "extended": {}}
    monkeypatch.setattr(nightly_judge, "_diagnose", lambda night, asked: (report, plain, []))
    outcome = refit_press(store, "lab", PRESS, workers=1)
    assert outcome.promoted
    assert str(outcome.reason).startswith(
        "no longer: heat lost at the rim: residual of single sensors at rest, own "
    )
    model = store.active_model("lab").model
    assert (model["effects"], model["basis"]["judged_runs"]) == ([], [run.name for run in runs])
    assert model["basis"]["rmse_still_K"]["after"] < 1.02 * model["basis"]["rmse_still_K"]["before"]

    fits = {run.name: {"rmse_K": 0.3} for run in runs}
    night = NightBasis(store, "lab", PRESS, rim, [], fits)
    worse = {name: {"rmse_K": 0.3 + 0.1 * i} for i, name in enumerate(fits, 1)}
    kept = night_comparison.compare(night, report, plain, worse, apart=True, fewer=("edge_loss",))
    assert not kept.better
    assert str(kept.reason).endswith("; an effect it would drop still improves the fit")


@pytest.mark.parametrize(
    ("core", "says"),
    [
        (night_comparison._Core(0.5, float("nan"), True), "the core is valid in fewer scans"),
        (night_comparison._Core(0.5, float("nan"), False), "the core gets worse"),
        (night_comparison._Core(0.5, 0.6, False), "the core gets worse"),
        (night_comparison._Core(0.5, 0.3, False), "core from 0.50 to 0.30 K live"),
    ],
)
def test_a_core_that_gets_worse_or_silent_is_no_gain(core, says, monkeypatch):
    rim = ModelFile("lab-2", "lab", {}, (("edge_loss", {"W_m3K": FittedValue(1000.0, 100.0)}),))
    monkeypatch.setattr(night_comparison, "_core_rmse", lambda *_: core)
    monkeypatch.setattr(night_comparison, "_predictions", lambda *_, **__: None)
    before, after = ({f"run-{i}": {"rmse_K": rmse} for i in range(6)} for rmse in (0.4, 0.3))
    night = NightBasis(None, "lab", PRESS, None, [], before)
    found = night_comparison.compare(night, {}, rim, after, apart=True)
    assert str(found.reason).endswith(says)
    assert found.better is (core.after_K < core.before_K)


def test_what_moves_with_the_press_does_not_promote_a_model(monkeypatch):
    """A row amid the closing weighs more than the rest of a run; older fits know of no other number."""
    rim = ModelFile("lab-2", "lab", {}, (("edge_loss", {"W_m3K": FittedValue(1000.0, 100.0)}),))
    monkeypatch.setattr(night_comparison, "_core_rmse", lambda *_: None)
    monkeypatch.setattr(night_comparison, "_predictions", lambda *_, **__: None)

    def found(before, after):
        night = NightBasis(None, "lab", PRESS, None, [], {f"run-{i}": before for i in range(6)})
        return night_comparison.compare(night, {}, rim, dict.fromkeys(night.fits, after), apart=True)

    moved = found({"rmse_K": 2.0, "rmse_still_K": 0.3}, {"rmse_K": 0.5, "rmse_still_K": 0.3})
    assert not moved.better
    assert "single sensors at rest, own contacts fitted, from 0.300 to 0.300 K" in str(moved.reason)
    older = found({"rmse_K": 2.0}, {"rmse_K": 0.5, "rmse_still_K": 0.3})
    assert older.better
    assert "single sensors, own contacts fitted, from 2.000 to 0.500 K" in str(older.reason)
    unknown = found({"rmse_K": None}, {"rmse_K": 0.5, "rmse_still_K": 0.3})
    assert not unknown.better


@pytest.mark.parametrize(
    ("ahead", "residual_after", "against"),
    [
        ((2.0, 2.1, False), 0.3, "predicts-worse"),
        ((2.0, 1.9, False), 0.3, None),
        ((2.0, 1.9, False), 0.4, "not-significant"),
        ((2.0, 1.5, True), 0.4, None),
    ],
)
def test_predictions_decide_what_is_promoted(ahead, residual_after, against):
    """A veto where runs are predicted worse, enough where they are surely predicted better."""
    before, after = (np.array([k + 0.01 * i for i in range(6)]) for k in (0.4, residual_after))
    seen = night_comparison._Predictions(*ahead)
    assert night_comparison._against(before, after, seen, None, fewer=False) == against


def test_a_gain_that_only_some_runs_have_is_not_promoted():
    """A tenth less on the mean: of four that gain and two that lose it may be chance, of six alike not."""
    before = np.full(6, 0.4)
    scattered, alike = np.array([0.2, 0.6, 0.3, 0.55, 0.2, 0.31]), np.full(6, 0.36)
    assert scattered.mean() == pytest.approx(alike.mean())
    assert night_comparison._against(before, scattered, None, None, fewer=False) == "not-significant"
    assert night_comparison._against(before, alike, None, None, fewer=False) is None


def test_a_run_is_predicted_from_platens_and_header_alone(store, runs):
    """Panel sensors moved by 3 K move nothing of the prediction, so its error grows by what they are off."""
    table = {n: FittedValue(PRESS.coefficient(n).guess, 10.0) for n in PRESS.coefficient_names}
    night = NightBasis(store, "lab", PRESS, None, [], {})
    run, model = runs[0], ModelFile("lab-1", "lab", table)
    out = night_comparison.simulate_run(run, PRESS, model.model(PRESS), model.values)
    inside = out.time_s >= night_comparison.moments_of(run, PRESS).inserted_s
    rest = np.concatenate([(out.measured[p] - v)[inside] for p, v in out.places.items()])
    rest = rest[np.isfinite(rest)]
    assert night_comparison._prediction_errors(night, run, [model])[0] == pytest.approx(np.sqrt(np.mean(rest**2)))
    panel = [c for c in run.columns if c.startswith(("top_", "bottom_"))]
    moved = replace(run, columns={c: v + 3.0 * (c in panel) for c, v in run.columns.items()})
    expected = np.sqrt(np.mean((rest + 3.0) ** 2))
    assert night_comparison._prediction_errors(night, moved, [model])[0] == pytest.approx(expected, rel=0.02)


def test_judging_runs_that_took_part_are_judged_by_what_the_others_predicted(store):
    report = {
        "base": {"predicted_rmse_K": 3.0},
        "extended": {"predicted_rmse_K": 2.5},
        "predicted_gain_ci95": [0.1, 0.9],
    }
    night = NightBasis(store, "lab", PRESS, None, [], {})
    found = night_comparison._predictions(night, report, ModelFile("", "lab", {}), ["run-1"], apart=False)
    assert found == night_comparison._Predictions(3.0, 2.5, True)
    unsure = {**report, "predicted_gain_ci95": [-0.1, 0.9]}
    found = night_comparison._predictions(night, unsure, ModelFile("", "lab", {}), ["run-1"], apart=False)
    assert found == night_comparison._Predictions(3.0, 2.5, False)


def test_a_promotion_alone_asks_no_second_diagnosis(store, runs, monkeypatch):
    fill(store, runs)
    asked = []

    def diagnose(night, names):
        asked.append(names)
        table = {n: FittedValue(PRESS.coefficient(n).guess, 10.0) for n in PRESS.coefficient_names}
        rim = (("edge_loss", {"W_m3K": FittedValue(1000.0, 100.0)}),)
        return {"verdict": "named", "base": {}, "extended": {}}, ModelFile("", "lab", table, rim), []

    monkeypatch.setattr(nightly_judge, "_diagnose", diagnose)
    monkeypatch.setattr(
        nightly_judge,
        "compare",
        lambda *_, **__: night_comparison.Comparison(say("plain-text", text="better"), True, {}),
    )
    monkeypatch.setattr(nightly_judge, "_fits_with", lambda *_: {})
    nights = []
    for _ in range(2):
        nights.append(refit_press(store, "lab", PRESS, workers=1))
        nightly.sign_off(store, nights[-1:])
    assert [night.promoted for night in nights] == [True, False]
    assert len(asked) == 1


@pytest.mark.campaign
def test_a_hidden_cause_is_named_and_the_better_model_promoted(store):
    fill(store, [run for run, _ in make_campaign(52, 12, "edge_loss", replace(PLAN, press_time_s=(40.0, 90.0)))])
    outcome = refit_press(store, "lab", PRESS)
    assert outcome.promoted
    text = r"heat lost at the rim: .* on 12 runs of the diagnosis, predictions .* K off"
    assert re.match(text, str(outcome.reason))
    german = words(outcome.reason, "de")
    assert re.match(r"Wärmeverlust am Rand: .* 12 Pressungen der Diagnose, Vorhersagen von \d+,\d\d ", german)
    assert "edge_loss" not in german
    assert store.active_model("lab").model["effects"][0]["name"] == "edge_loss"


TAG = re.compile(r"<svg.*?</svg>|<style.*?</style>|<[^>]+>", re.DOTALL)
AXIS_LABEL = re.compile(r"<!-- (.*?) -->")
RIM = {
    "verdict": "named",
    "effects": [
        {
            "name": "edge_loss",
            "set": ["edge_loss"],
            "parameters": {"W_m3K": {"value": 11000.0, "ci95": [9900.0, 12100.0]}},
            "worth": "lowers the residual by 0.48 K on a typical run left out",
        }
    ],
    "next_measurement": "Insulate the rim.",
}


def test_the_page_of_the_night_says_what_was_done(store, runs, tmp_path):
    fill(store, runs[:3])
    outcome = refit_press(store, "lab", PRESS, workers=1)
    drawn = night_report(night_record(store, outcome), link="http://press:8765/")
    assert drawn.count("<svg") == 2  # as of any diagnosis without a cause: one run, what all have left
    assert all(f'<a href="http://press:8765/#/runs/{run.name}">' in drawn for run in runs[:3])
    (night,) = store.nights(press="lab").items
    kept = night_report(stored_night_record(store, night), link="http://press:8765/")
    when = r"\d{4}-\d\d-\d\d \d\d:\d\d UTC"
    assert re.sub(when, "", kept) == re.sub(when, "", drawn)
    store.put_diagnosis("lab", RIM)
    store.log("warning", "sense", "what came in the morning", "lab")
    assert night_report(stored_night_record(store, night), link="http://press:8765/") == kept
    page = write_report(night_record(store, outcome), tmp_path / "reports").read_text(encoding="utf-8")
    page = page.replace("\N{NO-BREAK SPACE}", " ")
    assert f"Model {outcome.version} was promoted" in page
    assert "3 of 3 runs fitted, 0 could not be fitted." in page
    assert all(run.name in page for run in runs[:3])
    assert 'title="h_pp_c">plate – panel, closed' in page
    assert page.count("W/m²K") == len(PRESS.coefficient_names)
    assert "<b>heat lost at the rim</b>: lowers the residual by 0.48 K on a typical run left out." in page
    assert re.search(r'title="W_m3K">heat lost at the rim, [^<]*: <b>11000</b>&nbsp;W/m³K', page)
    assert not re.search(r"\d\.?\de[+-]\d\d", page)  # 110, not 1.1e+02
    german = night_report(night_record(store, outcome), "de").replace("\N{NO-BREAK SPACE}", " ")
    assert f"Modell {outcome.version} wurde in Kraft gesetzt" in german
    assert "<b>Ursache benannt</b>" in german
    assert re.search(r">\d+,\d+</td>", german)  # a small coefficient's spread, say
    own = TAG.sub(" ", german.replace(RIM["effects"][0]["worth"], ""))  # that is text of an earlier version
    assert not re.search(r"\d\.\d", own)
    assert not any(re.search(r"\d\.\d", label) for label in AXIS_LABEL.findall(german))
    assert [p.suffix for p in (tmp_path / "reports").iterdir()] == [".html"]


def test_the_page_of_the_night_has_notes_a_law_without_a_name_and_the_pressings_that_would_decide(store, runs):
    def kept(message: Message) -> dict[str, object]:
        return {"sentence": words(message), "sentence_said": message.to_json()}

    fill(store, runs[:1])
    outcome = refit_press(store, "lab", PRESS, workers=1)
    assert words(say("plan-heading")) not in night_report(night_record(store, outcome))
    prospect = say("plan-settles", percent=64.0, runs=say("plan-runs", runs=2))
    pressing = say("plan-best", settings=(say("plan-set-press_time_s", value=165.0),), prospect=prospect)
    point = say("plan-open-suspected", causes=(Message("effect-resin_cure-called"),))
    law = say("law-resembles", cause=Message("effect-moisture_evaporation-called"))
    plan = {"open": [kept(point) | {"pressings": [kept(pressing)]}], "sentences": []}
    note = say("note-thickness-alike", thickness=12.1, given=10.0)
    found = {"law_sentences": [kept(law)], "plan": plan, "warnings_said": [note.to_json()]}
    store.put_diagnosis("lab", RIM | found)
    for language in ("en", "de"):
        page = night_report(night_record(store, outcome), language)
        for message in (note, law, say("plan-heading"), point, pressing):
            assert words(message, language) in page.replace("\N{NO-BREAK SPACE}", " ")


def test_a_run_the_model_does_not_describe_is_marked_in_the_page_of_the_night(store, runs):
    fill(store, runs[:2])
    outcome = refit_press(store, "lab", PRESS, workers=1)
    warned = say("fit-not-described-check", misfit=say("plain-text", text="off by 9 K")).to_json()
    fit = store.fit(runs[0].name)
    store.put_fit(runs[0].name, {**fit, "rmse_K": 9.0, "warnings_said": [warned]}, "press file")
    german = night_report(night_record(store, outcome), "de")
    assert german.count("vom Modell nicht beschrieben") == 1
    assert "9,00\u00a0K, vom Modell nicht beschrieben" in german.replace("9,00 K", "9,00\u00a0K")
    assert "press file" not in german


def test_a_folder_that_cannot_be_written_is_named(store, runs, tmp_path):
    fill(store, runs[:1])
    (tmp_path / "reports").write_text("in the way", encoding="utf-8")
    outcome = refit_press(store, "lab", PRESS, workers=1)
    with pytest.raises(InputError, match=r"reports.*cannot write the report"):
        write_report(night_record(store, outcome), tmp_path / "reports")


CONFIG = """
[store]
url = "kerntemp.sqlite"
[refit]
workers = 1
dask = "{dask}"
[[press]]
name = "lab"
file = "press.toml"
[[press.logger]]
name = "x"
profile = "m-7018"
host = "127.0.0.1"
channels = ["platen_top", "platen_bottom", "top_1", "bottom_1"]
"""


def configured(folder, dask=""):
    (folder / "press.toml").write_text(press_toml(), encoding="utf-8")
    (folder / "kerntemp.toml").write_text(CONFIG.format(dask=dask), encoding="utf-8")
    return [sys.executable, "-m", "api", "refit", "--config", str(folder / "kerntemp.toml")]


def values(fit):
    return {name: c["value"] for name, c in fit["coefficients"].items()}


def test_a_report_that_cannot_be_written_keeps_no_press_from_its_night(tmp_path, capsys):
    configured(tmp_path)
    config = tmp_path / "kerntemp.toml"
    text = config.read_text(encoding="utf-8")
    table = text[text.index("[[press]]") :]
    config.write_text(text + table.replace('"lab"', '"north"'), encoding="utf-8")
    (tmp_path / "reports").write_text("in the way", encoding="utf-8")
    assert main(["refit", "--config", str(config)]) == 1
    output = capsys.readouterr().err
    with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
        assert nightly.PROCESS in store.statuses(), "the job came to its end"
        warnings = store.journal(level="warning").items
    for press in ("lab", "north"):
        assert any(entry.press == press and "cannot write the report" in str(entry.message) for entry in warnings)
        assert f"{press}-" in output


@pytest.mark.campaign
def test_killed_at_any_moment_it_leaves_the_old_model_and_goes_on_next_time(tmp_path):
    plan = replace(PLAN, press_time_s=(40.0, 90.0))
    pressings = [run for run, _ in make_campaign(53, 12, "edge_loss", plan)]
    known = {n: FittedValue(PRESS.coefficient(n).guess, 50.0) for n in PRESS.coefficient_names}
    command = configured(tmp_path)
    with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
        fill(store, pressings)
        store.put_model("lab", "lab-old", ModelFile("lab-old", "lab", known).as_json())
        store.promote_model("lab-old", "test")
        fitted = []
        for after in edition((0.3, 6.0), (0.3, 3.0, 4.5, 6.0, 8.0, 11.0)):
            job = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            time.sleep(after)
            job.send_signal(signal.SIGKILL)
            job.wait()
            active = store.active_model("lab")
            parse_model(active.model, "model in force")
            assert active.version == "lab-old" or store.diagnoses(press="lab").items
            fitted.append(sum(store.fit(run.name) is not None for run in pressings))
        assert fitted == sorted(fitted)  # what was fitted stays fitted
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "edge_loss" in [name for name, _ in parse_model(store.active_model("lab").model, "model").effects]
        assert list((tmp_path / "reports").glob("lab-*.html"))


def found_by(store, presses):
    """Return all that a night has found of some presses, but how long it took."""

    def timeless(entry):
        return {k: v for k, v in entry.items() if k != "seconds"} if entry is not None else None

    nights = {}
    for name in presses:
        (night,) = store.nights(press=name).items
        fits = {r.run: timeless(store.fit(r.run)) for r in store.runs(press=name).items}
        (asked,) = store.diagnoses(press=name).items
        models = [(m.version, m.model, m.status) for m in store.models(press=name).items]
        nights[name] = (fits, timeless(asked.diagnosis), models, night.progress)
    return nights


@pytest.mark.campaign
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_presses_on_dask_are_found_to_the_bit_as_here_and_a_killed_worker_costs_a_repetition_alone(tmp_path, runs):
    from dask import config
    from dask.distributed import Client, LocalCluster

    presses, found, killed, over = {"left": PRESS, "right": PRESS}, [], [], threading.Event()

    def kill_at_work(cluster):
        with Client(cluster.scheduler_address) as watcher:
            while not killed and not over.wait(0.02):
                fitted = [r for r in store.runs(press="left").items if store.fit(r.run) is not None]
                nannies = {n.worker_address: n for n in cluster.workers.values()}
                busy = [a for a, tasks in watcher.processing().items() if tasks]
                if fitted and busy:
                    killed.append(nannies[busy[0]].pid)
                    os.kill(killed[0], signal.SIGKILL)

    for way in ("here", "dask"):
        with open_store(str(tmp_path / f"{way}.sqlite")) as store:
            for press in presses:
                renamed = [replace(run, name=f"{press}-{i}") for i, run in enumerate(runs[:3])]
                store.import_runs(renamed, press, press_toml())
            if way == "here":
                assert [o.press for o in refit_presses(store, presses, workers=1)] == ["left", "right"]
            else:
                as_here = config.set({"distributed.nanny.pre-spawn-environ": {}})  # rounding goes by BLAS threads
                with as_here, LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
                    hand = threading.Thread(target=kill_at_work, args=[cluster])
                    hand.start()
                    done = list(refit_presses(store, presses, dask=cluster.scheduler_address))
                    over.set()
                    hand.join(240)
                assert {o.press for o in done if o.promoted} == set(presses)
            found.append(found_by(store, presses))
    assert len(killed) == 1
    assert found[0] == found[1]


def killed_over(task):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.campaign
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_presses_whose_workers_are_killed_again_and_again_are_worked_on_here(store, judging_nothing, monkeypatch):
    monkeypatch.setattr(fleet, "refit_stored", killed_over)
    outcomes = list(refit_presses(store, {"left": PRESS, "right": PRESS}, workers=2))
    assert {o.press for o in outcomes} == {"left", "right"} == set(store.newest_nights())
    messages = [entry.message.code for entry in store.journal(level="warning").items]
    assert messages == ["night-workers-killed"] * 2


@pytest.mark.skipif(os.name == "nt", reason="fork is POSIX")
@pytest.mark.parametrize("work", ["the night", "the archive"])
def test_while_a_job_works_on_a_press_another_leaves_it_alone(
    work, store_url, runs, tmp_path, judging_nothing, monkeypatch
):
    monkeypatch.setattr(process_lock, "WAIT_S", 0.1)
    rules = Rules(tmp_path / "archive", timedelta(0), None, 60.0, datetime.now(UTC))
    ready, go_on = os.pipe(), os.pipe()

    def stands_still(*_):
        os.write(ready[1], b"1")
        os.read(go_on[0], 1)

    with open_store(store_url) as store:
        fill(store, runs[:2])
    child = os.fork()
    if not child:
        module, name = (nightly, "agenda_of") if work == "the night" else (Store, "recheck_unsound")
        real = getattr(module, name)
        setattr(module, name, lambda *given: (stands_still(), real(*given))[1])
        with open_store(store_url) as own:
            list(refit_presses(own, {"lab": PRESS}, workers=1, rules=rules))
        os._exit(0)
    os.read(ready[0], 1)
    with open_store(store_url) as store:
        (outcome,) = refit_presses(store, {"lab": PRESS}, workers=1, rules=rules)
        assert "another nightly job works on press lab" in str(outcome.reason)
        os.write(go_on[1], b"11")
        assert os.waitpid(child, 0)[1] == 0
        assert store.newest_nights()["lab"].night["verdict"] != "failed"
        (again,) = refit_presses(store, {"lab": PRESS}, workers=1, rules=rules)
        assert (again.new, again.fitted) == (0, 0)


def test_each_of_several_presses_has_a_night_of_its_own(store, runs, judging_nothing):
    for press in ("left", "right"):
        store.import_runs([replace(run, name=f"{press}-{run.name}") for run in runs[:2]], press, press_toml())
    outcomes = list(refit_presses(store, {"left": PRESS, "right": PRESS}, workers=1))
    assert [(o.press, o.fitted) for o in outcomes] == [("left", 2), ("right", 2)]
    assert set(store.newest_nights()) == {"left", "right"}


@pytest.mark.campaign
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_a_dask_worker_that_is_killed_in_mid_fit_costs_a_repetition_and_never_a_result(store, runs):
    """Killed so often that the scheduler gives up on everything that waited at the worker."""
    from dask.distributed import Client, LocalCluster

    fill(store, runs[:3])
    url = store.database.url.render_as_string()
    tasks = [FitTask(url, PRESS, run.name, None) for run in runs[:3]]
    killed, over = [], threading.Event()
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster,
        Client(cluster.scheduler_address) as watcher,
    ):

        def kill_at_work():
            while len(killed) < 4 and not over.wait(0.02):
                (nanny,) = cluster.workers.values()
                at_work = watcher.processing().get(nanny.worker_address)  # a nanny replaces one that has begun
                if at_work and nanny.pid is not None and nanny.pid not in killed:
                    killed.append(nanny.pid)
                    os.kill(nanny.pid, signal.SIGKILL)

        hand = threading.Thread(target=kill_at_work)
        hand.start()
        done = list(fit_all(tasks, dask=cluster.scheduler_address))
        over.set()
        hand.join(240)
    assert len(killed) == 4
    assert sorted(one.run for one in done) == sorted(run.name for run in runs[:3])
    assert all(one.fit is not None for one in done)


def after(seconds):
    time.sleep(seconds)
    return seconds


@pytest.fixture
def scheduler_and_worker(tmp_path):
    """A scheduler and a worker as somebody starts them, each a process of its own, and the scheduler's address."""
    running, file = [], tmp_path / "scheduler.json"

    def started(module, *arguments):
        line = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
        where = {"cwd": Path(__file__).parents[2], "stderr": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
        running.append(subprocess.Popen(line, **where))

    started("dask_scheduler", "--port", "0", "--dashboard-address", ":0", "--scheduler-file", str(file))
    started("dask_worker", "--scheduler-file", str(file), "--no-nanny", "--nthreads", "1", "--no-dashboard")
    while not file.exists() or not file.read_text(encoding="utf-8"):
        time.sleep(0.05)
    yield (*running, json.loads(file.read_text(encoding="utf-8"))["address"])
    for process in running:
        process.kill()
        process.wait(240)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("gone", "expected"),
    [
        ("worker", "no worker for"),
        ("scheduler", "went away over the work"),
        pytest.param(
            "scheduler that stands still",
            "no worker for",
            marks=pytest.mark.skipif(os.name == "nt", reason="SIGSTOP is POSIX"),
        ),
    ],
)
def test_a_scheduler_or_last_worker_that_goes_away_in_mid_work_is_told_instead_of_waited_for(
    gone, expected, scheduler_and_worker, monkeypatch
):
    scheduler, worker, address = scheduler_and_worker
    came = on_dask(after, [0.1, 3600.0], address)
    assert next(came) == (0.1, 0.1)
    monkeypatch.setattr(cluster_of_workers, "WORKERS_WAIT_S", 0.5)
    monkeypatch.setattr(cluster_of_workers, "LOOK_S", 0.2)
    monkeypatch.setattr(cluster_of_workers, "SCHEDULER_WAIT_S", 1.0)
    if gone == "scheduler that stands still":
        scheduler.send_signal(signal.SIGSTOP)
    else:
        (worker if gone == "worker" else scheduler).kill()
    with pytest.raises(WorkersLost, match=expected):
        next(came)


def test_a_fault_nobody_foresaw_costs_one_run_its_fit_and_a_store_that_is_away_is_no_fault_of_a_run(
    store, runs, monkeypatch
):
    fill(store, runs[:1])
    task = FitTask(store.database.url.render_as_string(), PRESS, runs[0].name, None)

    def faulty(error):
        def fit(*_):
            raise error

        return fit

    monkeypatch.setattr(nightly_fits, "fit_one", faulty(KeyError("top_1")))
    assert fit_stored(task).why == unexpected(KeyError("top_1"))
    monkeypatch.setattr(nightly_fits, "fit_one", faulty(StoreUnavailable("locked")))
    with pytest.raises(StoreUnavailable):
        fit_stored(task)


@pytest.mark.campaign
def test_a_dask_scheduler_without_workers_is_named_instead_of_waited_for(store, monkeypatch):
    from dask.distributed import LocalCluster

    monkeypatch.setattr(cluster_of_workers, "WORKERS_WAIT_S", 0.5)
    with LocalCluster(n_workers=0, dashboard_address=":0", processes=False) as cluster:
        task = FitTask("", PRESS, "run", None)
        with pytest.raises(InputError, match=r"no worker in 0\.5 s; start dask worker"):
            list(fit_all([task], dask=cluster.scheduler_address))


@pytest.mark.campaign
def test_a_dask_scheduler_that_is_not_there_is_named(tmp_path, runs):
    command = configured(tmp_path, "tcp://127.0.0.1:9")
    with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
        fill(store, runs[:3])
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "tcp://127.0.0.1:9" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("after", "sure"),
    [
        ([0.4, 0.42, 0.38, 0.41, 0.4, 0.8], True),  # the last run gains more than the others together
        ([0.4, 0.5, 0.4, 0.6, 0.5, 3.0], False),
        ([0.5, 0.5, 0.5, 0.5, 0.5, 2.0], False),
    ],
)
def test_a_gain_counts_where_most_runs_share_it_however_much_one_of_them_leaves_over(after, sure):
    assert surely_less(np.array([0.5, 0.5, 0.5, 0.5, 0.5, 2.0]), np.array(after)) is sure


def test_three_runs_need_a_clearer_gain_than_twelve():
    ratios = np.array([0.95, 0.8, 0.65])
    assert not surely_less(np.ones(3), ratios)
    assert surely_less(np.ones(12), np.tile(ratios, 4))


def refit_kept(store, rules):
    (outcome,) = refit_presses(store, {"lab": PRESS}, workers=1, rules=rules)
    return outcome


def test_a_night_archives_old_runs_by_the_rules_and_fits_them_from_there(store, runs, tmp_path):
    dated = [
        replace(run, header={**run.header, "recorded.started_utc": datetime(2020, 1, 1, tzinfo=UTC)})
        for run in runs[:2]
    ]
    fill(store, dated)
    before = {run.name: fit_stored(FitTask(store.database.address, PRESS, run.name, None)).fit for run in dated}
    rules = Rules(tmp_path / "archive", timedelta(days=90), None, 600.0, datetime.now(UTC))
    first = refit_kept(store, rules)
    assert (first.fitted, first.failed) == (2, 0)
    night = store.nights(press="lab").items[0].night
    assert (night["archived"], night["archive_later"], night["pressings_only"]) == (2, 0, 0)
    assert min(night["freed_bytes"], night["archived_bytes"]) > 0
    for run, fit in before.items():
        assert store.fit(run)["coefficients"] == json.loads(json.dumps(fit))["coefficients"]
    last = replace(rules, pressings_only_after=timedelta(days=365))
    refit_kept(store, last)
    assert store.nights(press="lab").items[0].night["pressings_only"] == 0  # nights have not come for a month
    with store.database.writing() as connection:
        earlier = datetime.now(UTC) - timedelta(days=31)
        connection.execute(update(NIGHT).values(ended_unix_s=earlier.timestamp()))
    refit_kept(store, rules)
    assert refit_kept(store, last).archive is not None
    assert store.nights(press="lab").items[0].night["pressings_only"] == 2
    store.annotate_run(runs[0].name, {"panel.density_kg_m3": 700.0}, "tester")
    assert refit_kept(store, last).failed == 0
    assert set(store.fits(list(before))) == set(before)


def test_a_clock_that_runs_ahead_gives_up_no_scans(store, runs, tmp_path, judging_nothing):
    fill(
        store,
        [replace(runs[0], header={**runs[0].header, "recorded.started_utc": datetime(2026, 1, 1, tzinfo=UTC)})],
    )
    rules = Rules(tmp_path / "archive", timedelta(days=90), timedelta(days=3650), 600.0, datetime.now(UTC))
    refit_kept(store, rules)
    now = datetime.now(UTC)
    ahead = keep_house(store, "lab", rules, now + timedelta(days=30 * 365))
    assert ahead.pressings_only == 0
    [entry] = store.journal(press="lab", level="alarm").items
    assert "the clock is 10950 days past the night before" in str(entry.message)
    assert len(store.load_run(runs[0].name).time_s) == len(runs[0].time_s)


def test_a_file_that_is_not_sound_is_read_once_a_night_whatever_presses_share_the_archive(
    store, runs, tmp_path, monkeypatch
):
    old = {**runs[0].header, "recorded.started_utc": datetime(2020, 1, 1, tzinfo=UTC)}
    fill(store, [replace(runs[0], header=old)])
    rules = Rules(tmp_path / "archive", timedelta(days=90), None, 600.0, datetime.now(UTC))
    assert keep_house(store, "lab", rules, datetime.now(UTC)).archived == 1
    [file] = rules.folder.rglob("*.parquet")
    file.write_bytes(file.read_bytes()[:-1])
    assert len(store.check_archive(datetime.now(UTC) + timedelta(days=1)).unsound) == 1
    read = []
    monkeypatch.setattr(archive, "sound_content", lambda *of: [read.append(of[0]), sound_content(*of)])
    for night in (1, 2):
        tonight = replace(rules, began=datetime.now(UTC))
        for press in ("lab", "left", "right"):
            keep_house(store, press, tonight, datetime.now(UTC))
        assert read == [file] * night


def test_a_night_without_time_leaves_the_archive_to_the_next_and_a_wrong_folder_stops_nothing_else(
    store, runs, tmp_path
):
    fill(
        store,
        [replace(runs[0], header={**runs[0].header, "recorded.started_utc": datetime(2020, 1, 1, tzinfo=UTC)})],
    )
    (tmp_path / "file").write_text("")
    rules = Rules(tmp_path / "archive", timedelta(days=90), None, 0.0, datetime.now(UTC))
    assert keep_house(store, "lab", rules, datetime.now(UTC)).archive_later == 1
    lost = keep_house(store, "lab", replace(rules, folder=tmp_path / "file"), datetime.now(UTC))
    assert lost == OldScans(problem=lost.problem)
    assert "correct store.archive" in str(lost.problem)
    [entry] = store.journal(level="alarm").items
    assert "correct store.archive" in str(entry.message)
