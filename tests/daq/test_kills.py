"""Recorder and live sensor killed at random moments, again and again: nothing acknowledged is lost or doubled."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import pytest
from sqlalchemy import text

from daq.store import RunStatus, open_store
from tests.daq.test_recorder import all_scans, plant
from tests.editions import edition
from tests.patience import wait_until

pytestmark = pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
ROLES = ("record", "sense")


class Herd:
    """Recorder and sensor, forked from a parent that is ready, and what they had acknowledged."""

    def __init__(self, made, parent, notes):
        self.made, self.notes = made, notes
        self._parent = parent
        self.alive, self.kills = {}, Counter()

    def start(self, role):
        self._parent.stdin.write(role + "\n")
        self._parent.stdin.flush()
        self.alive[role] = int(self._parent.stdout.readline())

    def kill(self, role):
        os.kill(self.alive[role], signal.SIGKILL)
        wait_until(lambda: not Path(f"/proc/{self.alive[role]}").exists() or is_zombie(self.alive[role]))
        self.kills[role] += 1

    def end(self, role):
        """Kill a process for good; it does not count."""
        self.kill(role)
        self.kills[role] -= 1

    def acknowledged(self, role):
        file = self.notes / role
        lines = file.read_text().split("\n")[:-1] if file.exists() else []
        return [tuple(json.loads(line)) for line in lines]

    def size(self, role):
        file = self.notes / role
        return file.stat().st_size if file.exists() else 0


def is_zombie(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


@contextmanager
def herd(folder, store=None):
    with plant(folder, speed=20.0, rate_hz=2.0, store=store) as made:
        notes = folder / "notes"
        notes.mkdir()
        command = [sys.executable, "-m", "tests.daq.forking", str(made.config), str(notes)]
        parent = subprocess.Popen(
            command, cwd=Path(__file__).parents[2], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        one = Herd(made, parent, notes)
        try:
            yield one
        finally:
            for pid in one.alive.values():
                if not is_zombie(pid):
                    os.kill(pid, signal.SIGKILL)
            parent.stdin.close()
            parent.wait(240)
            parent.stdout.close()


def kill_at_random(one, times, seed, look=lambda: None):
    """Kill recorder, sensor or both after a random while, each once it has had something acknowledged."""
    chance = random.Random(seed)
    for role in ROLES:
        one.start(role)
    while sum(one.kills.values()) < times:
        roles = chance.choice((("record",), ("sense",), ROLES))
        before = {role: one.size(role) for role in roles}
        if chance.random() < 0.8:  # the others are killed while they start
            wait_until(lambda: all(one.size(role) > before[role] for role in roles))  # noqa: B023
        time.sleep(chance.uniform(0.0, 0.6))
        for role in roles:
            one.kill(role)
        for role in roles:
            one.start(role)
        look()


def balance(one, store):
    """Hold what was acknowledged against what the store holds; returns a sentence of figures.

    The recorder ends first, once all that an earlier kill left on its disk is in: a busy sensor would never catch
    up with one that goes on.
    """
    begun = one.size("record")
    wait_until(lambda: one.size("record") > begun)
    one.end("record")
    wait_until(lambda: caught_up(store))
    one.end("sense")
    scans = all_scans(store)
    assert [s.number for s in scans] == list(range(len(scans))), "a number is missing"
    kept = {s.monotonic_s: s.values[0] for s in scans}
    assert len(kept) == len(scans), "a scan is there twice"
    promised = one.acknowledged("record")
    lost = [at for at, value in promised if at not in kept or (value is not None and kept[at] != value)]
    estimates = {e.number: e.monotonic_s for e in estimates_of(store)}
    acknowledged = one.acknowledged("sense")
    forgotten = [number for number, at in acknowledged if estimates.get(number) != at]
    bare = [
        (run.run, number)
        for run in store.runs(limit=10_000).items
        if run.last_scan is not None
        for number in range(run.first_scan, run.last_scan + 1)
        if number not in estimates and number > min(estimates)
    ]
    life = Counter(run.status.value for run in store.runs(limit=10_000).items)
    with store.database.reading() as connection:
        if store.database.dialect == "sqlite":
            assert connection.execute(text("PRAGMA integrity_check")).scalar() == "ok"
        assert connection.execute(text("SELECT count(*) FROM run WHERE status = 'open'")).scalar() <= 1
    assert not lost
    assert not forgotten
    assert not bare, "scans of a run without an estimate"
    return (
        f"{one.kills['record']} kills of the recorder, {one.kills['sense']} of the sensor: "
        f"{len(promised)} scans acknowledged, {len(scans)} in the store, {len(lost)} lost, "
        f"{len(scans) - len(kept)} doubled; {len(acknowledged)} estimates acknowledged, {len(forgotten)} lost, "
        f"{len(bare)} scans of runs without one; runs {dict(life)}"
    )


def caught_up(store):
    """Whether the sensor has said something about the newest scans, and about all of every run that is over."""
    followed = store.last_scan_followed("lab")
    return followed >= store.newest_scan_number("lab") - 120 and not store.ended_runs_after("lab", followed)


def estimates_of(store):
    estimates, last = [], -1
    while more := store.estimates_after("lab", last, 5000):
        estimates += more
        last = more[-1].number
    return estimates


@pytest.mark.campaign
def test_killed_at_random_recorder_and_sensor_lose_nothing_acknowledged(store_url, tmp_path):
    with herd(tmp_path, store_url) as one, open_store(store_url) as store:
        kill_at_random(one, 8, 1)
        assert "0 lost" in balance(one, store)


@pytest.mark.campaign
@pytest.mark.timeout(7200)
def test_a_thousand_kills_lose_nothing(tmp_path):
    with herd(tmp_path) as one, open_store(one.made.url) as store:

        def look():
            done = sum(one.kills.values())
            if done % 50 < 2:
                with store.database.reading() as connection:
                    assert connection.execute(text("PRAGMA quick_check")).scalar() == "ok"
                print(f"{done} kills, {store.newest_scan_number('lab') + 1} scans", flush=True)

        kill_at_random(one, edition(30, 1000), 2, look)
        print(balance(one, store))
        assert store.runs(status=RunStatus.INTERRUPTED).items
