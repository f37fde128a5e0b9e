"""Nothing put into the write path is lost in silence: every scan, begin, end and event is a row or an alarm."""

import os
import random
import signal
import time
from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from multiprocessing import get_context

import numpy as np
import pytest

from daq.recording.press_line import in_order
from daq.recording.run_keeper import RunKeeper, RunNames, RunRules
from daq.records import Channel, PressEvent, PressEventKind, Quality, Run, Scan
from daq.store import RunStatus, open_store
from daq.store.outbox import Outbox
from tests.daq.accounted import note, noted
from tests.patience import wait_until

CHANNELS = (Channel("platen_top"), Channel("top_1"))
RULES = RunRules("lab", pre_trigger_s=5.0, post_removal_s=5.0, longest_run_s=3600.0)
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
            keeper, outbox = RunKeeper(RULES, names, [1]), Outbox(store)
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
        messages = [e.message for e in store.journal(level="warning").items if e.message.code == "run-renamed"]
        assert [dict(m.arguments) for m in messages[::-1]] == [
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


def record_until_killed(url, folder, step_s):
    """Put pressings as a press line does, from where the one before was killed, until somebody kills us."""
    place = os.open(folder / "notes", os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
    put = [at for kind, what, at in noted(folder / "notes") if (kind, what) == ("put", "scan")]
    number = int(max(put, default=999.0)) - 999
    with open_store(url) as store:
        store.interrupt_open_runs("lab")
        key = store.register_press("lab", CHANNELS)
        begun = number
        keeper = RunKeeper(RULES, RunNames("lab", store.unused_run_name("lab", scan(number, step_s).utc)), [1])
        outbox = Outbox(store, acknowledged=lambda batch: note(place, "kept", batch))
        outbox.start()
        while True:
            one = replace(scan(number, step_s), number=key.next_number + number - begun)
            events = events_at(number)
            for batch in in_order(key, one, events, keeper.take(one, events)):
                note(place, "put", batch)
                outbox.put(batch)
            number += 1
            time.sleep(0.0005)


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
@pytest.mark.parametrize("seed", range(2))
def test_a_recorder_killed_at_any_moment_keeps_what_it_had_acknowledged_and_invents_nothing(
    store_url, tmp_path, seed
):
    """Of what was put, only the last before a kill may be missing: nobody was told that it is safe."""
    chance = random.Random(seed)
    open_store(store_url).close()
    for _ in range(5):
        step_s = chance.choice((0.0, -3600.0, -86400.0, 86400.0))
        before = len(noted(tmp_path / "notes"))
        recorder = get_context("fork").Process(target=record_until_killed, args=(store_url, tmp_path, step_s))
        recorder.start()
        more = chance.randrange(1, 600)
        wait_until(lambda: len(noted(tmp_path / "notes")) > before + more or recorder.exitcode is not None)  # noqa: B023
        recorder.kill()
        recorder.join()
        assert recorder.exitcode == -signal.SIGKILL
    with open_store(store_url) as store:
        store.interrupt_open_runs("lab")
        runs = store.runs(limit=1000).items
        there = Counter(("scan", one.monotonic_s) for one in store.scans_after("lab", -1, 100_000).scans)
        there.update((str(event.kind), event.monotonic_s) for event in store.press_events("lab", limit=100_000))
        there.update(("begin", run.zero_monotonic_s) for run in runs)
        there.update(("end", run.ended_utc.timestamp()) for run in runs if run.status is RunStatus.CLOSED)
        assert len({run.run for run in runs}) == len(runs)
        assert not store.journal(level="alarm").items
    put, kept = (
        Counter((what, at) for kind, what, at in noted(tmp_path / "notes") if kind == which)
        for which in ("put", "kept")
    )
    assert max(there.values()) == 1
    assert kept.keys() <= there.keys() <= put.keys()
    assert {what for what, _ in kept} >= {"scan", "begin", "end", "inserted", "closed", "opened", "removed"}


def test_an_end_whose_run_the_store_does_not_hold_is_an_alarm(store_url):
    from daq.store import RunEnd

    with open_store(store_url) as store:
        key = store.register_press("lab", CHANNELS)
        store.append_scans(key, [scan(0, 0.0)], end=RunEnd("lab-9", 0, MIDNIGHT, first_scan=0))
        (entry,) = store.journal(level="alarm").items
    assert str(entry.message) == "run lab-9 ends at scan 0, but the store has no such run; its scans are kept"
