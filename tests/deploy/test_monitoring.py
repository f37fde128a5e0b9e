"""Alarms and dashboard hold only numbers that `/metrics` really has."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from api.answers.health import health_of
from api.http.metrics import metrics_text
from daq.records import Channel, PressEvent, PressEventKind, PressState, Quality, Scan
from daq.store import NewRun, Store, StoredEstimate, open_store

FOLDER = Path(__file__).parents[2] / "deploy" / "monitoring"
RUNBOOK = FOLDER.parent / "RUNBOOK.md"
LAB = (FOLDER.parent / "presses" / "lab.toml").read_text()
NAME = re.compile(r"\bkerntemp_[a-z_]+\b")
NOW = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)


@pytest.fixture
def store(tmp_path):
    """A store as recorder, live sensor and nightly job leave it."""
    with open_store(str(tmp_path / "plant.sqlite")) as opened:
        key = opened.register_press("lab", [Channel("platen_top"), Channel("top_1")], LAB)
        scan = Scan(0, NOW, 5.0, (200.0, float("nan")), (Quality.GOOD, Quality.OPEN))
        closing = [PressEvent(kind, 5.0, 5.0) for kind in (PressEventKind.INSERTED, PressEventKind.CLOSED)]
        opened.append_scans(key, [scan], closing, NewRun("one", 0, NOW, 5.0))
        estimate = StoredEstimate(0, 5.0, PressState.CLOSED, 80.0, 0.5, 79.0, 81.0, True)
        opened.append_estimates("lab", [estimate])
        logger = {"press": "lab", "name": "top", "state": "lost", "counters": {"good": 7, "no reply": 2}}
        press = {"press": "lab", "missed_ticks": 3}
        opened.use_archive(tmp_path / "archive")
        opened.beat("record", {"state": "running", "waiting": 4, "presses": [press], "loggers": [logger]})
        opened.beat("sense", {"state": "running", "presses": [{"press": "lab", "behind_scans": 5}]})
        opened.beat("refit", {"state": "done", "message": "lab: 1 of 1 runs fitted"})
        opened.put_model("lab", "lab-1", {"effects": []})
        opened.promote_model("lab-1", "test")
        yield opened


def samples(store: Store) -> dict[str, float]:
    text = metrics_text(store, NOW)
    return {
        sample.name + str(sorted(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def names(store: Store) -> set[str]:
    return {key.partition("[")[0] for key in samples(store)}


def test_metrics_tell_loggers_late_scans_and_the_model_in_base_units(store):
    found = samples(store)
    assert found["kerntemp_logger_up[('logger', 'top'), ('press', 'lab')]"] == 0
    assert (
        found["kerntemp_logger_replies_total[('logger', 'top'), ('outcome', 'no reply'), ('press', 'lab')]"] == 2
    )
    assert found["kerntemp_missed_scans_total[('press', 'lab')]"] == 3
    assert found["kerntemp_record_waiting[]"] == 4
    assert found["kerntemp_sense_behind_scans[('press', 'lab')]"] == 5
    assert found["kerntemp_core_celsius[('press', 'lab')]"] == 80.0
    assert found["kerntemp_channel_good[('channel', 'top_1'), ('press', 'lab')]"] == 0
    assert found["kerntemp_model_info[('press', 'lab'), ('version', 'lab-1')]"] == 1
    assert found["kerntemp_store_up[]"] == 1
    assert "kerntemp_process_age_seconds[('process', 'refit')]" in found
    assert "kerntemp_process_up[('process', 'refit')]" not in found, "a job that is over is not down"


def test_before_the_nightly_job_ever_came_to_its_end_its_age_counts_from_the_journals_first_line(tmp_path):
    with open_store(str(tmp_path / "plant.sqlite")) as store:
        store.log("info", "record", "recording lab")
        later = store.journal().items[0].utc + timedelta(hours=51)
        assert 'kerntemp_process_age_seconds{process="refit"} 183600.0' in metrics_text(store, later)
        assert "refit: the nightly job has not finished for 51 h; see its log" in health_of(store, later).alarms


def test_a_press_that_is_no_longer_recorded_keeps_no_alarm_standing(store):
    week = timedelta(days=7)
    for after, expected in ((week, True), (week + timedelta(seconds=1), False)):
        text = metrics_text(store, NOW + after)
        assert ("kerntemp_scan_age_seconds{" in text) == expected
        assert ("kerntemp_channel_good{" in text) == expected
    assert 'kerntemp_scans_total{press="lab"} 1.0' in text


def test_of_several_machines_in_one_database_each_has_its_own_sign_of_life(postgresql_url, monkeypatch):
    with open_store(postgresql_url) as store:
        for host, state in (("north", "answers"), ("south", "lost")):
            monkeypatch.setattr("daq.store.store.gethostname", lambda host=host: host)
            logger = {"press": host, "name": "top", "state": state}
            press = {"press": host, "missed_ticks": 3}
            status = {"state": "running", "waiting": 4, "presses": [press], "loggers": [logger]}
            store.beat(store.beats_as("record"), status)
            store.beat(store.beats_as("sense"), {"state": "running", "presses": []})
        now = datetime.now(UTC)
        assert health_of(store, now).alarms == []
        text = metrics_text(store, now)
        assert 'kerntemp_logger_up{logger="top",press="north"} 1.0' in text
        assert 'kerntemp_logger_up{logger="top",press="south"} 0.0' in text
        assert "kerntemp_record_waiting 8.0" in text
        later = now + timedelta(seconds=20)
        store.beat("record@north", {"state": "running"})
        with store.database.writing() as connection:
            connection.exec_driver_sql("UPDATE status SET unix_s = unix_s + 20 WHERE process <> 'record@south'")
        (alarm,) = health_of(store, later).alarms
        assert alarm.startswith("record@south: silent for")
        assert [p.name for p in health_of(store, now + timedelta(days=8)).processes] == [
            "record@north",
            "sense@south",
        ]


def test_health_says_in_words_what_stands_behind_the_alarms(tmp_path, monkeypatch):
    monkeypatch.setattr("api.answers.health.LEAST_FREE_BYTES", 10**18)  # no disk has so much
    with open_store(str(tmp_path / "plant.sqlite")) as store:
        store.beat("record", {"state": "running"})
        store.beat("sense", {"state": "running", "presses": [{"press": "lab", "behind_scans": 700}]})
        assert health_of(store, datetime.now(UTC)).alarms == [
            "lab: 700 scans behind, this machine is too busy",
            "less than 1000000000 GB left on the store's disk",
        ]


def test_without_a_store_the_metrics_say_so_instead_of_failing(store):
    store.database.engine.dispose()
    with store.database.writing() as connection:
        connection.exec_driver_sql("ALTER TABLE press RENAME TO gone")
    assert "kerntemp_store_up 0.0" in metrics_text(store, NOW)


def test_every_query_of_dashboard_and_alarms_names_a_metric_that_exists(store):
    known = names(store)
    board = json.loads((FOLDER / "kerntemp-dashboard.json").read_text(encoding="utf-8"))
    queries = [target["expr"] for panel in board["panels"] for target in panel["targets"]]
    queries += [entry["query"] for entry in board["templating"]["list"] if entry["type"] == "query"]
    rules = (FOLDER / "kerntemp-alerts.yml").read_text(encoding="utf-8")
    queries += re.findall(r"expr: (.*)", rules)
    for query in queries:
        asked = set(NAME.findall(query)) or {"up"}
        assert asked <= known | {"up"}, query
    assert {name for query in queries for name in NAME.findall(query)} >= known - {
        "kerntemp_info",
        "kerntemp_process_age_seconds",
        "kerntemp_scans_created",
    } - {name for name in known if name.endswith("_created")}


def test_every_panel_has_a_title_a_unit_and_a_place_of_its_own():
    board = json.loads((FOLDER / "kerntemp-dashboard.json").read_text(encoding="utf-8"))
    taken: set[tuple[int, int]] = set()
    for panel in board["panels"]:
        assert panel["title"]
        assert panel["fieldConfig"]["defaults"]["unit"]
        place = panel["gridPos"]
        cells = {(place["x"] + i, place["y"] + j) for i in range(place["w"]) for j in range(place["h"])}
        assert not cells & taken, panel["title"]
        taken |= cells


def test_every_alarm_is_explained_in_the_runbook():
    rules = (FOLDER / "kerntemp-alerts.yml").read_text(encoding="utf-8")
    runbook = RUNBOOK.read_text(encoding="utf-8")
    alarms = re.findall(r"alert: (\w+)", rules)
    assert len(alarms) > 8
    assert [alarm for alarm in alarms if alarm not in runbook] == []


@pytest.mark.parametrize(
    "call", [("check", "rules", "kerntemp-alerts.yml"), ("test", "rules", "kerntemp-alerts-test.yml")]
)
def test_prometheus_own_tool_accepts_the_alarms_and_they_fire_when_they_should(call):
    tool = shutil.which("promtool")
    if tool is None:
        pytest.skip("no promtool is installed: it comes with Debian's package prometheus")
    done = subprocess.run([tool, *call], cwd=FOLDER, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
