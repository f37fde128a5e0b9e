"""What is asked of one press, or of the journal's alarms, costs as much however much a store of ten years holds.

Counted are SQLite's own steps, which no other work on the machine changes.
"""

from dataclasses import replace
from datetime import UTC, datetime
from functools import partial

import numpy as np
import pytest
from sqlalchemy import insert

from api.answers.health import health_of
from daq.records import Run
from daq.store import StoredNight, open_store
from daq.store.convert import to_json
from daq.store.schema import ALARM, COEFFICIENT, DIAGNOSIS, EVENT, FIT, MODEL, NIGHT, PRESS_EVENT, RUN
from daq.words import say

NOW = datetime(2036, 3, 4, tzinfo=UTC)
VALUE = {"value": 700.0, "sd": 9.0, "ci95": [680.0, 720.0], "identifiable": True}
SAID = to_json(say("plain-text", text="over").to_json())
RARE = ("few", "blind")
"""A press with one fitted run, and one whose run has no fit; both older than all that the busy one has."""
QUESTIONS = {
    "the newest fit of any press": lambda store: store.newest_fit_number(),
    "the journal's alarms": lambda store: store.journal(level="alarm", limit=10),
    "a rare process's lines": lambda store: store.journal(process="token"),
    "alarms nobody has acknowledged": lambda store: store.alarms(pending=True),
    "health": lambda store: health_of(store, NOW),
}
OF_A_PRESS = {
    "its newest fit": lambda store, press: store.newest_fit_number(press),
    "its coefficients": lambda store, press: store.coefficient_history(press=press),
    "its model in force": lambda store, press: store.active_model(press),
    "its models": lambda store, press: store.models(press=press),
    "its diagnoses": lambda store, press: store.diagnoses(press=press),
    "its nights": lambda store, press: store.nights(press=press),
    "its lines": lambda store, press: store.journal(press=press),
    "its alarms": lambda store, press: store.alarms(press=press),
    "its alarms nobody has acknowledged": lambda store, press: store.alarms(press=press, pending=True),
    "its events, newest first": lambda store, press: store.press_journal(press),
    "its events, oldest first": lambda store, press: store.press_events(press),
    "its runs": lambda store, press: store.runs(press=press),
    "its pressings": lambda store, press: store.pressings(press),
    "how many pressings it has": lambda store, press: store.count_pressings(press),
    "which run is open": lambda store, press: store.open_run(press),
    "what was edited": lambda store, press: store.edited_after(press, 0),
    "what to archive": lambda store, press: store.runs_to_archive(press, NOW),
}
FEW_OF_MANY = {
    "its newest fit": OF_A_PRESS["its newest fit"],
    "its model in force": OF_A_PRESS["its model in force"],
    "its newest coefficients": lambda store, press: store.coefficient_history(press=press, limit=20),
    "older coefficients": lambda store, press: store.coefficient_history(press=press, limit=20, cursor="100"),
    "its newest models": lambda store, press: store.models(press=press, limit=20),
    "its newest diagnosis": lambda store, press: store.diagnoses(press=press, limit=1),
    "its newest night": lambda store, press: store.nights(press=press, limit=1),
    "its newest lines": lambda store, press: store.journal(press=press, limit=20),
    "its newest alarms": lambda store, press: store.alarms(press=press, limit=20),
    "its newest events": lambda store, press: store.press_journal(press, limit=20),
    "its newest runs": lambda store, press: store.runs(press=press, limit=20),
    "its newest pressings": lambda store, press: store.pressings(press, limit=20),
    "pressings that are new": lambda store, press: store.pressings(press, after=250, limit=20),
    "older pressings": lambda store, press: store.pressings(press, below=250, limit=20),
    "which run is open": OF_A_PRESS["which run is open"],
}
QUESTIONS |= {f"{what}, of the busy press": partial(ask, press="busy") for what, ask in FEW_OF_MANY.items()}
QUESTIONS |= {
    f"{what}, of press {press}": partial(ask, press=press) for what, ask in OF_A_PRESS.items() for press in RARE
}


def begin(store):
    """Leave what two presses had years ago."""
    run = Run("few-1", {}, np.arange(2.0), {"top_1": np.ones(2)})
    store.import_run(run, "few", "")
    store.import_run(replace(run, name="blind-1"), "blind", "")
    store.put_fit("few-1", {"coefficients": {"h": VALUE}}, "few-1")
    store.put_model("few", "few-1", {"effects": []})
    store.promote_model("few-1", "test")
    store.put_diagnosis("few", {"verdict": "no_effect"})
    store.put_night(StoredNight("few", NOW, NOW, {}, {}))
    store.log("alarm", "token", "long ago", "few")
    store.import_run(replace(run, name="busy-1"), "busy", "")


def live_on(store, first, last):
    """Let a third press have runs, fits, models, diagnoses, nights, lines, alarms and events, numbered so."""
    numbers = range(first, last)
    with store.database.writing() as connection:
        row = dict(connection.execute(RUN.select().where(RUN.c.run == "busy-1")).mappings().one())
        del row["run_number"]
        runs = [
            {**row, "run": f"busy-{i}", "first_scan": -i, "last_scan": -i - 1, "started_unix_s": 1.7e9 + i}
            for i in numbers
        ]
        fit = {"created_unix_s": 1.7e9, "model_version": "", "converged": 1, "rmse_kelvin": 0.3, "fit_json": "{}"}
        value = {"name": "h", "value_w_m2k": 1.0, "sd_w_m2k": 1.0, "low_w_m2k": 0.0, "high_w_m2k": 2.0}
        model = {"press": "busy", "created_unix_s": 1.7e9, "status": "rejected", "reason": "", "model_json": "{}"}
        diagnosis = {"press": "busy", "created_unix_s": 1.7e9, "verdict": "no_effect", "diagnosis_json": "{}"}
        night = {"press": "busy", "started_unix_s": 1.7e9, "ended_unix_s": 1.7e9}
        line = {"unix_s": 1.7e9, "level": "info", "process": "refit", "press": "busy", "message": "worked"}
        alarm = {"press": "busy", "message_json": SAID, "raised_unix_s": 1.7e9, "seen_unix_s": 1.7e9}
        over = {"ended_unix_s": 1.7e9, "acknowledged_unix_s": 1.7e9, "acknowledged_by": "test"}
        moment = {"press_id": row["press_id"], "unix_s": 1.7e9, "monotonic_s": 0.0, "noticed_monotonic_s": 0.0}
        tables = {
            RUN: runs,
            FIT: [{**fit, "fit_id": i, "run": f"busy-{i}"} for i in numbers],
            COEFFICIENT: [{**value, "fit_id": i, "identifiable": 1} for i in numbers],
            MODEL: [{**model, "version": f"busy-{i}"} for i in numbers],
            DIAGNOSIS: [diagnosis] * len(numbers),
            NIGHT: [{**night, "night_json": "{}", "progress_json": "{}"}] * len(numbers),
            EVENT: [line] * len(numbers),
            ALARM: [{**alarm, **over, "key": f"busy-{i}"} for i in numbers],
            PRESS_EVENT: [{**moment, "scan_number": i, "kind": "closed", "source": "test"} for i in numbers],
        }
        for table, rows in tables.items():
            connection.execute(insert(table), rows)
    store.put_fit("busy-1", {"coefficients": {"h": VALUE}}, "")


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    """How many steps each question takes of a store that is young, and of one that is old."""
    steps, taken = [], {name: [] for name in QUESTIONS}
    with open_store(str(tmp_path_factory.mktemp("age") / "s.sqlite")) as store:
        connection = store.database.engine.connect()
        connection.connection.dbapi_connection.set_progress_handler(lambda: steps.append(1), 10)
        connection.close()  # the pool hands it out again
        begin(store)
        for first, last in ((10, 300), (400, 6000)):
            live_on(store, first, last)
            for name, ask in QUESTIONS.items():
                steps.clear()
                ask(store)
                taken[name].append(len(steps))
    return taken


@pytest.mark.parametrize("name", QUESTIONS)
def test_a_question_about_little_costs_as_much_in_an_old_store_as_in_a_young_one(steps, name):
    young, old = steps[name]
    assert old <= 2 * young + 20
