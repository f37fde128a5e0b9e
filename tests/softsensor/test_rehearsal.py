"""Error rates of a campaign, by campaigns simulated from it."""

from __future__ import annotations

import json
import os
import re
import signal
import time
from functools import cache

import numpy as np
import pytest
from scipy.stats import binom

from api.cli import main
from daq.files.run_file import write_run
from daq.press.press_file import parse_press
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign, press_toml
from softsensor.diagnosis import rehearsal, verdict
from softsensor.diagnosis.rehearsal import Campaign, Hidden, Outcome, Rate, campaign_of, hidden_of, rehearsal_of
from softsensor.diagnosis.verdict import diagnose
from softsensor.jobs import rehearsals
from softsensor.report.rehearsal_rows import lost_messages
from softsensor.signals.doubt import constant_doubts

TINY = Plan(
    rate_hz=1.0,
    thickness_mm=8.0,
    press_time_s=(18.0, 25.0),
    open_before_s=(5.0, 8.0),
    open_after_s=(15.0, 20.0),
    core_column=0.4,
)


@cache
def runs():
    return [run for run, _ in make_campaign(41, 7, None, TINY)]


@cache
def campaign() -> Campaign:
    return campaign_of(diagnose(parse_press(press_toml()), runs(), effects=["edge_loss"]))


@pytest.mark.parametrize("of", [1, 10, 97])
def test_the_interval_of_none_or_all_is_the_closed_form(of):
    edge = 1.0 - 0.025 ** (1.0 / of)
    assert Rate(0, of).ci95 == pytest.approx((0.0, edge))
    assert Rate(of, of).ci95 == pytest.approx((1.0 - edge, 1.0))


@pytest.mark.parametrize("chance", [0.02, 0.3, 0.5, 0.97])
def test_the_interval_holds_the_chance_in_at_least_95_percent_of_all_draws(chance):
    counts = np.arange(21)
    holds = [low <= chance <= high for low, high in (Rate(int(k), 20).ci95 for k in counts)]
    assert binom.pmf(counts, 20, chance)[holds].sum() >= 0.95


def test_found_alone_and_wrong_names_are_counted_apart():
    heat, rim = Hidden("resin_cure", (("heat_kJ_m2", 30.0),)), Hidden("edge_loss", (("W_m3K", 1200.0),))
    rows = [
        Outcome(heat, 0, "named", (("resin_cure",),)),
        Outcome(heat, 1, "ambiguous", (("edge_loss", "resin_cure"),)),
        Outcome(heat, 2, "named", (("edge_loss",),)),
        Outcome(rim, 0, "no_effect", ()),
        Outcome(Hidden(""), 0, "no_effect", ()),
        Outcome(Hidden(""), 1, "named", (("edge_loss",),)),
    ]
    found = rehearsal_of(campaign(), rows)
    assert [(r.hidden.name, r.found.count, r.alone.count, r.wrong.count, r.found.of) for r in found.rows] == [
        ("resin_cure", 2, 1, 1, 3),
        ("edge_loss", 0, 0, 0, 1),
    ]
    assert (found.nothing.count, found.nothing.of) == (1, 2)


def test_a_simulated_run_keeps_programs_gaps_and_the_rows_without_a_panel():
    one = campaign().runs[0]
    readings = {c: v.copy() for c, v in one.run.columns.items()}
    readings["top_1"][20:24] = np.nan
    gappy = rehearsal.replace(one, run=rehearsal.replace(one.run, columns=readings))
    few = rehearsal.replace(campaign(), runs=(gappy, *campaign().runs[1:]))
    made = rehearsal.simulated_runs(few, Hidden(""), 3)[0]
    assert np.array_equal(made.time_s, one.run.time_s)
    assert np.array_equal(made.columns["platen_top"], one.run.columns["platen_top"])
    assert np.isnan(made.columns["top_1"][20:24]).all()
    away = one.run.time_s < one.moments.inserted_s
    assert np.array_equal(made.columns["top_2"][away], one.run.columns["top_2"][away])
    assert not np.array_equal(made.columns["top_2"], one.run.columns["top_2"])


def test_the_same_number_gives_the_same_campaign_and_another_one_another():
    first, again, other = (rehearsal.simulated_runs(campaign(), Hidden(""), n)[2] for n in (5, 5, 6))
    assert np.array_equal(first.columns["bottom_3"], again.columns["bottom_3"], equal_nan=True)
    assert not np.array_equal(first.columns["bottom_3"], other.columns["bottom_3"], equal_nan=True)


def test_resampled_noise_is_as_large_and_as_shared_as_the_residuals():
    """Whole blocks of all channels: neither variance nor what two channels of a face share is lost."""
    rng = np.random.default_rng(1)
    drawn = [rehearsal._readings(campaign(), one, rng) for _ in range(60) for one in campaign().runs]
    own = campaign().runs
    variance = np.mean([np.var(d["top_1"]) for d in drawn])
    assert variance == pytest.approx(np.mean([np.var(r.noise["top_1"]) for r in own]), rel=0.15)
    shared = np.mean([np.mean(np.diff(d["top_1"]) * np.diff(d["top_2"])) for d in drawn])
    known = np.mean([np.mean(np.diff(r.noise["top_1"]) * np.diff(r.noise["top_2"])) for r in own])
    assert abs(shared - known) < 0.3 * np.mean([np.var(np.diff(r.noise["top_1"])) for r in own])


def test_channels_that_are_read_in_turn_rehearse_as_much_noise_as_those_read_at_once():
    def in_turn(run):
        shown = {
            c: np.where(np.arange(len(v)) % 2 == number % 2, v, np.nan) if c.startswith(("top_", "bottom_")) else v
            for number, (c, v) in enumerate(sorted(run.columns.items()))
        }
        return rehearsal.replace(run, columns=shown)

    halved = diagnose(parse_press(press_toml()), [in_turn(run) for run in runs()], effects=["edge_loss"])
    made, rng = campaign_of(halved), np.random.default_rng(1)
    drawn = [rehearsal._readings(made, one, rng) for _ in range(60) for one in made.runs]
    for channel in ("top_1", "bottom_2"):
        at_once = np.mean([np.var(one.noise[channel]) for one in campaign().runs])
        assert np.mean([np.var(d[channel]) for d in drawn]) == pytest.approx(at_once, rel=0.15)


@pytest.mark.parametrize(
    ("known", "expected"), [([2], [2] * 5), ([0, 3], [0, 0, 3, 3, 3]), ([0, 1, 2, 3, 4], [0, 1, 2, 3, 4])]
)
def test_an_empty_cell_has_the_noise_of_the_nearest_row_that_has_one(known, expected):
    assert rehearsal._nearest(np.array(known), 5).tolist() == expected


def test_what_a_rehearsed_channel_reads_beside_the_truth_some_run_left_in_one_direction():
    rng = np.random.default_rng(2)
    for _ in range(20):
        drawn = rehearsal._readings(campaign(), campaign().runs[0], rng)
        assert any(
            all(np.isin(sign * drawn[c], one.level[c] + one.noise[c]).all() for c in drawn)
            for sign in (1.0, -1.0)
            for one in campaign().runs
        )


def test_constants_of_rehearsed_panels_lie_about_the_given_ones_as_far_as_these_are_in_doubt():
    run, press = campaign().runs[0].run, campaign().press
    doubt = constant_doubts(run.header, press, rehearsal.ONE_PRODUCT)["panel.thickness_mm"]
    drawn = np.array(
        [
            rehearsal._drawn(run, press, np.random.default_rng(n), of_run=True)["panel.thickness_mm"]
            for n in range(2000)
        ]
    )
    off = (drawn - run.header["panel.thickness_mm"]) / doubt.sd
    assert abs(off.mean()) < 0.1
    assert off.std() == pytest.approx(0.959, abs=0.05)  # of a standard normal number within two of them
    assert np.abs(off).max() == pytest.approx(2.0)


def test_a_hidden_sink_cools_the_simulated_faces():
    sink = hidden_of(campaign(), ["edge_loss=20000"])[0]
    cold, warm = (
        np.mean([r.columns["top_1"][-5:].mean() for r in rehearsal.simulated_runs(campaign(), h, 0)])
        for h in (sink, Hidden(""))
    )
    assert cold < warm - 2.0


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ("edge_loss=much", "edge_loss"),
        ("edge_loss=0", "of this size it is absent"),
        ("sensor_fault=1", "sensor_fault"),
        ("clock_offset", "clock_offset"),
    ],
)
def test_a_cause_that_cannot_be_hidden_is_refused(asked, expected):
    with pytest.raises(InputError, match=expected):
        hidden_of(campaign(), [asked])


def test_options_of_a_rehearsal_want_a_rehearsal(tmp_path, capsys):
    (tmp_path / "press.toml").write_text(press_toml())
    write_run(runs()[0], tmp_path / "run.csv")
    call = ["diagnose", str(tmp_path / "run.csv"), "--press", str(tmp_path / "press.toml")]
    assert main([*call, "--rehearse-campaigns", "2"]) == 2
    assert "--rehearse" in capsys.readouterr().err


def fill_finished(file, names: list[str]) -> None:
    """Fill a file with finished campaigns of everything that is named."""
    for name in names:
        hidden = hidden_of(campaign(), [name])[0] if name else Hidden("")
        sets = ((hidden.name,),) if name else ()
        rehearsals._keep(file, rehearsals._mark(campaign()), Outcome(hidden, 0, "named", sets))


@pytest.mark.campaign
def test_a_rehearsal_killed_while_it_wrote_goes_on_and_gives_the_same_table(tmp_path):
    """A real rehearsal of one campaign stands for a run that was not killed."""
    file, causes = tmp_path / "finished.jsonl", hidden_of(campaign(), ["sensor_fault", "thermocouple_lag=4"])
    fill_finished(file, ["", "thermocouple_lag=4"])
    whole = rehearsals.rehearse(rehearsals.plan_rehearsal(campaign(), causes, 1, file))
    assert [(r.hidden.name, r.found.count) for r in whole.rows] == [("thermocouple_lag", 1), ("sensor_fault", 1)]
    assert (whole.nothing.count, whole.nothing.of) == (0, 1)
    kept = file.read_text()
    assert rehearsals.plan_rehearsal(campaign(), causes, 1, file).tasks == ()
    file.write_text(kept[:-20])
    again = rehearsals.plan_rehearsal(campaign(), causes, 1, file)
    assert [t.hidden.name for t in again.tasks] == ["sensor_fault"]
    assert rehearsals.rehearse(again).as_json() == whole.as_json()
    assert rehearsals.plan_rehearsal(campaign(), causes, 1, file).tasks == ()


def test_finished_campaigns_of_other_runs_do_not_count(tmp_path):
    file = tmp_path / "finished.jsonl"
    fill_finished(file, [""])
    first, *others = campaign().runs
    later = rehearsal.replace(first, run=rehearsal.replace(first.run, time_s=first.run.time_s + 0.01))
    assert len(rehearsals.plan_rehearsal(campaign(), [], 2, file).done) == 1
    for changed in (
        rehearsal.replace(campaign(), runs=tuple(others)),
        rehearsal.replace(campaign(), runs=(later, *others)),
        rehearsal.replace(campaign(), testable=(*campaign().testable, "draught_above")),
    ):
        assert len(rehearsals.plan_rehearsal(changed, [], 2, file).done) == 0


@pytest.mark.parametrize("content", [b"\x89PNG\r\n", b"time_s,top_1\n0,21\n", b'{"verdict": "named"}\n'])
def test_a_file_of_something_else_is_not_written_to(tmp_path, content):
    file = tmp_path / "other"
    file.write_bytes(content)
    with pytest.raises(InputError, match="something else"):
        rehearsals.check_file(file)
    assert file.read_bytes() == content


def test_a_file_torn_in_its_first_line_goes_on(tmp_path):
    file = tmp_path / "finished.jsonl"
    rehearsals.check_file(file)
    fill_finished(file, [""])
    kept = file.read_bytes()
    for count in (0, 5, len(kept)):
        file.write_bytes(kept[:count])
        rehearsals.check_file(file)


def test_a_campaign_whose_workers_are_killed_is_missing_and_said_to_be(monkeypatch):
    """Real processes; each that is given the second campaign kills itself."""
    monkeypatch.setattr(rehearsals, "_rehearse", killed_over_the_second)
    plan = rehearsals.plan_rehearsal(campaign(), [], 3)
    counts: list[int] = []
    found = rehearsals.rehearse(plan, counts.append)
    assert (found.nothing.of, found.lost, counts) == (2, 1, [1, 2, 3])
    assert found.as_json()["lost"] == 1
    assert [str(line) for line in lost_messages(found)] == [
        "1 of the campaigns is missing and counts nowhere: the processes that simulated them were killed."
    ]


def killed_over_the_second(_campaign: Campaign, task: rehearsals.RehearsalTask) -> Outcome:
    if task.number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return Outcome(task.hidden, task.number, "no_effect", ())


def test_a_rehearsal_that_cannot_begin_takes_no_diagnosis_with_it(tmp_path, capsys):
    (tmp_path / "press.toml").write_text(press_toml())
    write_run(runs()[0], tmp_path / "run.csv")
    out = tmp_path / "found.json"
    call = ["diagnose", str(tmp_path / "run.csv"), "--press", str(tmp_path / "press.toml"), "--json", str(out)]
    assert main([*call, "--rehearse", "--rehearse-effect", "law_contact"]) == 2
    shown = capsys.readouterr()
    assert "these runs cannot show it" in shown.err
    assert "too_few_runs" in shown.out
    assert "rehearsal" not in json.loads(out.read_text())


def test_what_a_rehearsal_takes_is_reckoned_without_the_search_for_a_law(monkeypatch):
    """No rehearsed diagnosis looks for one."""
    slow = 0.3
    monkeypatch.setattr(verdict, "free_law", lambda _stage: time.sleep(slow))
    found = diagnose(parse_press(press_toml()), runs()[:1], effects=["edge_loss"], law=True)
    assert found.law_seconds == pytest.approx(slow, abs=0.2)
    assert found.seconds > found.law_seconds


def test_the_command_tells_how_long_it_takes_and_where_the_campaigns_come_from(tmp_path, capsys, monkeypatch):
    """The real command; its two campaigns are rehearsed by a stand-in that names what is hidden."""

    def instantly(plan, _dask, _workers):
        yield from (
            Outcome(t.hidden, t.number, "named", ((t.hidden.name,),) if t.hidden.name else ()) for t in plan.tasks
        )

    monkeypatch.setattr(rehearsals, "_outcomes", instantly)
    (tmp_path / "press.toml").write_text(press_toml())
    for run in runs():
        write_run(run, tmp_path / f"{run.name}.csv")
    files = [str(tmp_path / f"{run.name}.csv") for run in runs()]
    json_out, html = tmp_path / "found.json", tmp_path / "found.html"
    call = ["diagnose", *files, "--press", str(tmp_path / "press.toml"), "--rehearse", "--rehearse-campaigns", "1"]
    call += ["--rehearse-effect", "thermocouple_lag=4", "--json", str(json_out), "--html", str(html)]
    assert main(call) == 0
    output = capsys.readouterr().out
    assert "2 simulated campaigns to diagnose, 0 done before" in output
    assert re.search(r"about \d+ min on \d process", output)
    assert "the sensor's own model" in output
    assert re.search(r"1 of 1 \([23] to 100 %\)", output)  # 2.5 %
    assert "How often such a diagnosis is right" in html.read_text()
    table = json.loads(json_out.read_text())["rehearsal"]
    assert table["effects"][0]["parameters"] == {"time_constant_s": 4.0}
    assert table["none"]["false_names"] == {"count": 0, "share": 0.0, "ci95": [0.0, 0.975]}
