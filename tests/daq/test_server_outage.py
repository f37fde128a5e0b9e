"""A database server that is away: at the start, for minutes, while the recorder is killed. Nothing is lost."""

import os
import select
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import psycopg
import pytest
import time_machine
from sqlalchemy import event, text
from sqlalchemy.engine import make_url

from daq.records import Channel
from daq.store import NewRun, RunStatus, StoreUnavailable, connection_watchdog, open_store
from daq.store.outbox import Outbox
from daq.store.write_batch import Entry, WriteBatch
from daq.words import say
from tests.daq.test_kills import herd
from tests.daq.test_recorder import all_scans
from tests.daq.test_store_outbox import BEGAN, CHANNELS, G, Notes, batch
from tests.patience import wait_until


class Gate:
    """A door in front of a server: connections through it are cut and refused while it is shut."""

    def __init__(self, host, port):
        self._server = (host, port)
        self._listener, self._links = None, []
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]

    def open(self):
        self._listener = socket.create_server(("127.0.0.1", self.port))
        threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()

    def shut(self):
        listener, self._listener = self._listener, None
        if listener is None:
            return
        with suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        for link in self._links:
            with suppress(OSError):
                link.shutdown(socket.SHUT_RDWR)
        self._links.clear()

    def _accept(self, listener):
        with suppress(OSError):
            while True:
                client, _ = listener.accept()
                server = socket.create_connection(self._server)
                self._links += [client, server]
                threading.Thread(target=self._forward, args=(client, server), daemon=True).start()

    @staticmethod
    def _forward(client, server):
        with client, server, suppress(OSError):
            while True:
                ready, _, _ = select.select([client, server], [], [])
                for side in ready:
                    data = side.recv(65536)
                    if not data:
                        return
                    (server if side is client else client).sendall(data)


@contextmanager
def gated(url):
    """A gate before a PostgreSQL server, shut at first, and the URL that leads through it."""
    real = make_url(url)
    gate = Gate(real.host, real.port or 5432)
    try:
        yield gate, real.set(host="127.0.0.1", port=gate.port).render_as_string(hide_password=False)
    finally:
        gate.shut()


@pytest.mark.campaign
def test_a_recorder_started_and_killed_while_the_server_is_away_loses_nothing(postgresql_url, tmp_path):
    with gated(postgresql_url) as (gate, url), herd(tmp_path, url) as one:
        for count in (60, 120):
            one.start("record")
            wait_until(lambda: len(one.acknowledged("record")) > count)  # noqa: B023
            one.kill("record")
        gate.open()
        one.start("record")
        time.sleep(0.3)
        one.kill("record")  # perhaps in the middle of the back-fill
        one.start("record")
        count = len(one.acknowledged("record"))
        wait_until(lambda: len(one.acknowledged("record")) > count + 40)
        gate.shut()
        count = len(one.acknowledged("record"))
        wait_until(lambda: len(one.acknowledged("record")) > count + 40)
        gate.open()
        with open_store(postgresql_url) as store:
            wait_until(lambda: any("takes data again" in str(e.message) for e in store.journal().items))
            one.kill("record")
            one.start("record")
            balanced(one, store)
            assert len(store.runs(status=RunStatus.OPEN).items) <= 1
            messages = [str(e.message) for e in store.journal(limit=200).items]
            assert any(
                "kerntemp-buffer.sqlite, enough for" in m and "check that the database server" in m
                for m in messages
            )


def balanced(one, store):
    """Hold what was acknowledged against the store: all there, once, in order."""
    promised = one.acknowledged("record")
    wait_until(lambda: {at for at, _ in promised} <= {s.monotonic_s for s in all_scans(store)})
    scans = all_scans(store)
    assert [s.number for s in scans] == list(range(len(scans)))
    times = [s.monotonic_s for s in scans]
    assert times == sorted(set(times)), "a scan is doubled or out of order"
    kept = dict(zip(times, (s.values[0] for s in scans), strict=True))
    assert all(value is None or kept[at] == value for at, value in promised)


@contextmanager
def own_server():
    """A PostgreSQL server of our own that may be restarted; yields a function of pg_ctl's words, and the URL."""
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
    initdb = shutil.which("initdb") or (str(programs[-1] / "initdb") if programs else None)
    if initdb is None:
        pytest.skip("no PostgreSQL server programs (initdb) on this machine")
    root = os.geteuid() == 0  # the server refuses to run as root
    data = Path(tempfile.mkdtemp(prefix="kt_pg_"))
    if root:
        shutil.chown(data, "postgres")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]

    def call(*words):
        prefix = ["runuser", "-u", "postgres", "--"] if root else []
        subprocess.run([*prefix, *words], check=True, cwd="/", stdout=subprocess.DEVNULL, timeout=240)

    def control(*words):
        options = f"-p {port} -k {data} -c listen_addresses=127.0.0.1"
        call(
            str(Path(initdb).with_name("pg_ctl")),
            "-D",
            str(data / "d"),
            "-l",
            str(data / "log"),
            "-o",
            options,
            "-w",
            *words,
        )

    try:
        call(initdb, "-A", "trust", "-U", "postgres", "--no-sync", "-D", str(data / "d"))
        control("start")
        yield control, f"postgresql+psycopg://postgres@127.0.0.1:{port}/postgres"
        control("stop", "-m", "immediate")
    finally:
        shutil.rmtree(data, ignore_errors=True)


def stop_every_process(url):
    """Stop a server; return its process numbers, its parent's last.

    The parent is stopped first: it must not notice that a child has stopped, nor bury one that ends meanwhile,
    whose number would then be nobody's.
    """
    with psycopg.connect(url.replace("+psycopg", ""), autocommit=True) as connection:
        folder = connection.execute("SHOW data_directory").fetchone()[0]
    parent = int((Path(folder) / "postmaster.pid").read_text().split()[0])
    os.kill(parent, signal.SIGSTOP)
    wait_until(lambda: ") T " in Path(f"/proc/{parent}/stat").read_text())
    children = [*map(int, Path(f"/proc/{parent}/task/{parent}/children").read_text().split())]
    for child in children:
        os.kill(child, signal.SIGSTOP)
    return [*children, parent]


@contextmanager
def stopped(url):
    """The server says nothing; the machine it runs on still confirms what it is sent."""
    processes = stop_every_process(url)
    try:
        yield
    finally:
        for process in processes:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGCONT)


def test_a_server_that_falls_silent_costs_seconds_and_a_slow_one_is_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(connection_watchdog, "SILENT_S", 1.0)
    with own_server() as (_, url), open_store(url, busy_s=2.0) as store:
        with store.database.reading() as connection:
            assert connection.execute(text("SELECT 1 FROM pg_sleep(1.4)")).scalar() == 1
        key = store.register_press("lab", CHANNELS, "press file")
        faults, notes = [], Notes()
        outbox = Outbox(
            store,
            buffer=tmp_path / "b.sqlite",
            acknowledged=notes.note,
            journal=lambda *words: faults.append(words),
        )
        outbox.start()
        for n in range(10):
            outbox.put(batch(key, n))
        wait_until(lambda: outbox.written == 10)
        with stopped(url):
            for n in range(10, 3000):
                outbox.put(batch(key, n))
            wait_until(lambda: outbox.written == 3000)
            assert outbox.waiting == 2990
            with pytest.raises(StoreUnavailable, match="check that the database server runs"):
                store.newest_scan_number("lab")
        wait_until(lambda: outbox.waiting == 0)
        outbox.close()
        assert [s.number for s in all_scans(store)] == list(range(3000))
        assert [level for level, _ in faults] == ["alarm", "info"]
        assert "connection" in str(faults[0][1])
        assert "check that the database server runs" in str(faults[0][1])
        assert f"scans wait in {tmp_path / 'b.sqlite'}, enough for" in str(faults[0][1])


@pytest.mark.campaign
def test_a_server_that_stops_under_the_recorder_costs_no_scan_and_raises_the_alarm(tmp_path):
    with own_server() as (_, url), herd(tmp_path, url) as one:
        one.start("record")
        for count in (1, 2, 3):
            seen = len(one.acknowledged("record"))
            wait_until(lambda: len(one.acknowledged("record")) > seen + 40)  # noqa: B023
            with stopped(url):
                time.sleep(0.5)
                seen, began = len(one.acknowledged("record")), time.monotonic()
                wait_until(lambda: len(one.acknowledged("record")) > seen)  # noqa: B023
                print(f"scans go to the disk {time.monotonic() - began + 0.5:.1f} s after the server fell silent")
                wait_until(lambda: len(one.acknowledged("record")) > seen + 1000)  # noqa: B023
            with open_store(url) as store:
                balanced(one, store)
                back = "takes data again"
                wait_until(lambda: sum(back in str(e.message) for e in store.journal().items) == count)  # noqa: B023
                alarms = [str(e.message) for e in store.journal(level="alarm").items]
        assert len(alarms) == 3
        assert all(
            "check that the database server runs" in m and "sqlite, enough for" in m and "connection" in m
            for m in alarms
        )


@pytest.mark.campaign
def test_a_server_that_is_restarted_under_the_recorder_costs_no_scan(tmp_path):
    with own_server() as (control, url), herd(tmp_path, url) as one:
        one.start("record")
        for way in ("fast", "immediate"):
            count = len(one.acknowledged("record"))
            wait_until(lambda: len(one.acknowledged("record")) > count + 40)  # noqa: B023
            control("restart", "-m", way)
        count = len(one.acknowledged("record"))
        wait_until(lambda: len(one.acknowledged("record")) > count + 40)
        with open_store(url) as store:
            balanced(one, store)
            wait_until(lambda: any("takes data again" in str(e.message) for e in store.journal(limit=200).items))


def test_two_presses_that_begin_in_one_tick_of_the_clock_keep_their_scans_apart(tmp_path):
    """Windows' clock ticks 64 times a second."""
    with open_store(str(tmp_path / "s.sqlite")) as store, time_machine.travel(BEGAN, tick=False):
        outbox = Outbox(store, buffer=tmp_path / "b.sqlite")
        keys = [outbox.later_key(press, CHANNELS, "press file") for press in ("lab", "hall")]
        for key in keys:
            outbox.put(batch(key, 0))
        outbox.start()
        outbox.close()
        assert [len(store.scans_after(press, -1, 10).scans) for press in ("lab", "hall")] == [1, 1]


def test_a_session_gets_its_place_once_in_order_behind_what_a_killed_one_left(store_url, tmp_path):
    with open_store(store_url) as store:
        store.append_scans(store.register_press("lab", CHANNELS), batch(None, 0).scans)
        first = Outbox(store, buffer=tmp_path / "b.sqlite")
        key = first.later_key("lab", CHANNELS, "press file")
        begin = NewRun("lab-2026-03-04-t070000", 3, BEGAN, 0.0)
        for n in range(5):
            first.put(WriteBatch(key, batch(key, n).scans, (), begin if n == 4 else None))
        wider = (*CHANNELS, Channel("top_2"))
        second_key = first.later_key("lab", wider, "press file")
        for n in range(5):
            scan = batch(second_key, n).scans[0]
            first.put(WriteBatch(second_key, (replace(scan, values=(*scan.values, 21.0), qualities=(G, G, G)),)))
        notes = Notes()
        first._take()
        first._keep()
        assert first.behind
        second = Outbox(store, buffer=tmp_path / "b.sqlite", acknowledged=notes.note)
        second.start()
        wait_until(lambda: second.waiting == 0)
        second.close()
        assert [s.number for s in store.scans_after("lab", -1).scans] == list(range(6))
        assert [c.name for c in store.scans_after("lab", 5).channels] == ["platen_top", "top_1", "top_2"]
        assert store.newest_scan_number("lab") == 10
        run = store.run_record("lab-2026-03-04-t070000")
        assert (run.status, run.first_scan, run.last_scan) == (RunStatus.INTERRUPTED, 4, 5)


def test_what_a_session_said_is_timed_when_it_was_said(store_url, tmp_path):
    with open_store(store_url) as store:
        outbox = Outbox(store, buffer=tmp_path / "b.sqlite")
        outbox.put(Entry("warning", "record", say("plain-text", text="long ago"), unix_s=BEGAN.timestamp()))
        outbox._take()
        outbox._keep()
        outbox.start()
        wait_until(lambda: outbox.waiting == 0)
        outbox.close()
        assert store.journal().items[0].utc == BEGAN


def test_a_server_lost_in_the_midst_of_many_rows_is_reported_once_in_our_own_words(
    postgresql_url, tmp_path, caplog
):
    with gated(postgresql_url) as (gate, url):
        gate.open()
        with open_store(url) as store:
            key = store.register_press("lab", CHANNELS)
            event.listen(store.database.engine, "before_cursor_execute", lambda *given: given[-1] and gate.shut())
            with pytest.raises(StoreUnavailable):
                store.write_batches([batch(key, n) for n in range(500)])
    assert not [line for line in caplog.records if line.name.startswith("psycopg")]
