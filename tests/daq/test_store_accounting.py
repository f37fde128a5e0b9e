"""Nothing put into the write path is lost in silence: every scan, begin, end and event is a row or an alarm."""

import random
from collections import Counter
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from daq.recording.press_line import in_order
from daq.recording.run_keeper import RunKeeper, RunNames, RunRules
from daq.records import Channel, PressEvent, PressEventKind, Quality, Run, Scan
from daq.store import RunStatus, open_store
from daq.store.outbox import Outbox
from tests.daq.test_store_outbox import wait_until

CHANNELS = (Channel("platen_top"), Channel("top_1"))
MIDNIGHT = datetime(2026, 3, 5, tzinfo=UTC)
CYCLE = {10: "inserted", 20: "closed", 60: "opened", 75: "removed"}
"""What happens at which scan of a cycle of 100 scans, one a second."""


def scan(number, set_by_s):
    utc = MIDNIGHT + timedelta(seconds=number - 150 + set_by_s)
    return Scan(number, utc, 1000.0 + number, (200.0, 21.0), (Quality.GOOD,) * 2)


def events_at(number):
    kind = CYCLE.get(number % 100)
    return [PressEvent(PressEventKind(kind), 1000.0 + number, 1000.0 + number)] if kind else []


def record_pressings(store, cycles, clock, restart=lambda cycle: False):
    """Put pressings as a press line does; returns what was put, counted."""
    put, number = Counter(), 0
    for cycle in range(cycles):
        if cycle == 0 or restart(cycle):
            store.interrupt_open_runs("lab")
            key = store.register_press("lab", CHANNELS)
            names = RunNames("lab", store.unused_run_name("lab", scan(number, clock(cycle)).utc))
            keeper, outbox = RunKeeper(RunRules("lab"), names, [1]), Outbox(store)
            outbox.start()
        for _ in range(100):
            one, events = scan(number, clock(cycle)), events_at(number)
            for batch in in_order(key, one, events, keeper.take(one, events)):
                put.update(scans=len(batch.scans), events=len(batch.events))
                put.update(begins=batch.begin is not None, ends=batch.end is not None)
                outbox.put(batch)
            number += 1
        wait_until(lambda: outbox.waiting == 0)  # noqa: B023
        if restart(cycle + 1) or cycle + 1 == cycles:
            outbox.close()
    return put


def assert_all_is_there(store, put):
    runs = store.runs(limit=1000).items
    assert len(store.scans_after("lab", -1, 100_000).scans) == put["scans"]
    assert len(store.press_events("lab", limit=100_000)) == put["events"]
    recorded = [run for run in runs if run.kind == "recorded"]
    assert len(recorded) == put["begins"]
    assert sum(run.status is RunStatus.CLOSED for run in recorded) == put["ends"]
    assert [run.first_scan % 100 for run in recorded] == [5] * len(recorded)
    assert all(run.moments.closed_s == pytest.approx(15.0) for run in recorded)


def test_a_run_imported_under_the_name_the_next_pressing_would_get_costs_no_pressing(store_url):
    taken = "lab-2026-03-04-02"
    with open_store(store_url) as store:
        imported = Run(taken, {"run": taken}, np.arange(3.0), {"top_1": np.full(3, 20.0)}, "file")

        def clock(cycle):
            if cycle == 1:  # another PC's run comes while this one records
                store.import_run(imported, "lab")
            return -1000.0

        calls = []
        put = record_pressings(store, 3, lambda c: -1000.0 if c in calls or calls.append(c) else clock(c))
        assert_all_is_there(store, put)
        names = [run.run for run in store.runs(limit=10).items if run.kind == "recorded"]
        assert sorted(names) == ["lab-2026-03-04-01", "lab-2026-03-04-03", "lab-2026-03-04-04"]
        said = [e.message for e in store.journal(level="warning").items if e.message.code == "run-renamed"]
        assert [dict(m.arguments) for m in said[::-1]] == [
            {"run": taken, "name": "lab-2026-03-04-03"},
            {"run": "lab-2026-03-04-03", "name": "lab-2026-03-04-04"},
        ]


@pytest.mark.parametrize("seed", range(3))
def test_pressings_around_midnight_with_a_clock_set_back_and_forth_and_restarts_are_all_runs(store_url, seed):
    chance = random.Random(seed)
    steps = [chance.choice((0.0, -3600.0, -86400.0, 86400.0, 30.0)) for _ in range(8)]
    restarts = {c for c in range(1, 8) if chance.random() < 0.4}
    with open_store(store_url) as store:
        put = record_pressings(store, 8, lambda cycle: steps[cycle], lambda cycle: cycle in restarts)
        assert put["begins"] == 8
        assert_all_is_there(store, put)
        names = [run.run for run in store.runs(limit=100).items]
        assert len(set(names)) == len(names) == 8


def test_an_end_whose_run_the_store_does_not_hold_is_an_alarm(store_url):
    from daq.store import RunEnd

    with open_store(store_url) as store:
        key = store.register_press("lab", CHANNELS)
        store.append_scans(key, [scan(0, 0.0)], end=RunEnd("lab-9", 0, MIDNIGHT, first_scan=0))
        (said,) = store.journal(level="alarm").items
    assert str(said.message) == "the end of run lab-9 at scan 0 finds no such run in the store; its scans are kept"
