"""Alarms and dashboard hold only numbers that `/metrics` really has."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from api.metrics import metrics_text
from daq.records import Channel, PressState, Quality, Scan
from daq.store import Store, StoredEstimate, open_store

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
        opened.append_scans(key, [scan])
        said = StoredEstimate(0, 5.0, PressState.CLOSED, 80.0, 0.5, 79.0, 81.0, True)
        opened.append_estimates("lab", [said])
        logger = {"press": "lab", "name": "top", "state": "lost", "counters": {"good": 7, "no reply": 2}}
        told = {"press": "lab", "missed_ticks": 3}
        opened.beat("record", {"state": "running", "waiting": 4, "presses": [told], "loggers": [logger]})
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
