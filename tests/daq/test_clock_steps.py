"""A recorder whose machine's clock is set while it records: all that was put into the store's way is there.

The recorder is a process of its own on simulated devices; what happened is known from the press that is simulated.
"""

import itertools
import os
import random
import signal
import subprocess
import sys
from collections import Counter
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from daq.store import RunStatus, open_store
from tests.daq.accounted import noted
from tests.daq.test_recorder import QUICK, plant
from tests.editions import edition
from tests.patience import wait_until

DAY_S = 86400.0
STEPS_S = (60.0, -60.0, 300.0, -300.0, 3600.0, -3600.0, DAY_S, -DAY_S, 400 * DAY_S, -400 * DAY_S)


class Recorder:
    """A recorder in a process of its own, whose clock can be set."""

    def __init__(self, made, notes):
        self._made, self._notes = made, notes
        self.set_by_s = 0.0
        """How far its clock is from the right time. [s]"""
        self.set_at_s = []
        """By how much it was set while it ran. [s]"""
        self._process = None

    def start(self):
        command = [sys.executable, "-m", "tests.daq.accounted", str(self._made.config), str(self._notes)]
        root = Path(__file__).parents[2]
        self._process = subprocess.Popen(command, cwd=root, stdin=subprocess.PIPE, text=True)
        self._say(self.set_by_s)
        self.wait_for("scan")

    def _say(self, seconds):
        self._process.stdin.write(f"{seconds}\n")
        self._process.stdin.flush()

    def set_clock(self, seconds):
        self._say(seconds)
        self.set_by_s += seconds
        self.set_at_s.append(seconds)

    def count(self, what):
        return sum(kind == "kept" and one == what for kind, one, _ in noted(self._notes))

    def wait_for(self, what, more=1):
        """Wait until so many more of these are in the store."""
        before = self.count(what)
        wait_until(lambda: self.count(what) >= before + more or self._process.poll() is not None)
        assert self._process.poll() is None

    def end(self, by):
        self._process.send_signal(by)
        assert self._process.wait(240) == (0 if by == signal.SIGTERM else -by)
        self._process.stdin.close()


@contextmanager
def recorder(made, notes):
    one = Recorder(made, notes)
    one.start()
    try:
        yield one
    finally:
        if one._process.poll() is None:
            one._process.kill()
            one._process.wait(240)
        one._process.stdin.close()


def to_midnight():
    """Return by how much a clock is to be set to show a minute before midnight. [s]"""
    now = datetime.now(UTC)
    return (now.replace(hour=23, minute=59, second=0, microsecond=0) - now) / timedelta(seconds=1)


def rows_of(store):
    """Return all that is in the store, as the recorder notes it."""
    there, last = Counter(), -1
    while more := store.scans_after("lab", last, 5000).scans:
        there.update(("scan", one.monotonic_s) for one in more)
        last = more[-1].number
    there.update((str(event.kind), event.monotonic_s) for event in store.press_events("lab", limit=100_000))
    runs = store.runs(limit=10_000).items
    there.update(("begin", run.zero_monotonic_s) for run in runs)
    there.update(("end", run.ended_utc.timestamp()) for run in runs if run.status is RunStatus.CLOSED)
    return there


@pytest.mark.campaign
@pytest.mark.skipif(os.name == "nt", reason="SIGTERM and SIGKILL are POSIX")
@pytest.mark.parametrize("seed", range(edition(1, 8)))
@pytest.mark.parametrize("killed", [False, True], ids=["not killed", "killed"])
def test_whatever_a_clock_is_set_to_every_pressing_is_a_run_and_every_step_is_told(
    store_url, tmp_path, seed, killed
):
    """Midnight comes twice, with a pressing before, between and after: two of them would have one name."""
    chance = random.Random(seed)
    notes = tmp_path / "notes"
    with plant(tmp_path, speed=20.0, rate_hz=2.0, store=store_url) as made, open_store(store_url) as store:
        with recorder(made, notes) as one:
            one.set_clock(to_midnight())
            for step_s in (120.0, -120.0):
                one.wait_for("begin")
                one.set_clock(step_s)
            one.wait_for("begin")
            for step_s in (chance.choice(STEPS_S) for _ in range(edition(4, 40))):
                one.wait_for(chance.choice(("begin", "closed", "opened", "scan")))
                one.wait_for("scan", chance.randrange(1, 20))
                if killed:
                    one.end(signal.SIGKILL)
                    one.set_by_s += step_s
                    one.start()
                else:
                    one.set_clock(step_s)
            one.wait_for("end")
            one.end(signal.SIGTERM)
        put, kept = (
            Counter((what, at) for kind, what, at in noted(notes) if kind == which) for which in ("put", "kept")
        )
        there = rows_of(store)
        assert max(there.values()) == 1
        assert kept.keys() <= there.keys() <= put.keys()
        assert killed or put == kept
        entries = store.journal(level="warning", limit=10_000).items[::-1]
        steps = [e.detail["step_s"] for e in entries if e.message.code == "clock-set"]
        assert steps == pytest.approx(one.set_at_s, abs=0.5)
        assert any(e.message.code == "run-renamed" for e in entries)
        assert not store.journal(level="alarm").items
        runs = store.runs(limit=10_000).items
        begun, recorded = [run.zero_monotonic_s for run in runs], [at for what, at in there if what == "scan"]
        truly = [cycle.moments for cycle in made.press.cycles]
        seen = [m.inserted_s + made.began * made.speed for m in truly]
        seen = [at for at in seen if whole(recorded, at - 10.0, at + QUICK.open_after_s[1])]
        print(f"{len(steps)} steps, {len(seen)} pressings seen whole, {len(begun)} runs, {there.total()} rows")
        assert begun
        if not killed:  # before the closing, a kill leaves no run of a panel that came in a gap between two scans
            # on a busy machine readings come late: a tenth of its second is two of the press's
            assert all(any(at - 45.0 < zero < at + 10.0 for zero in begun) for at in seen)


def whole(recorded, first, last):
    """Whether there are scans all the time, as a recorder that is not killed meanwhile leaves them."""
    within = sorted(at for at in recorded if first < at < last)
    ends = (first, *within, last)
    return max(after - before for before, after in itertools.pairwise(ends)) < 10.0
