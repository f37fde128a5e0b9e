"""The line to systemd: a real datagram socket listens to what the recorder says."""

import os
import socket
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

import daq.recording.press_line
import daq.recording.recorder
from daq.process.config import load_config
from daq.process.notify import Notifier
from daq.records import Channel, Quality, Reading
from daq.simulated.campaign import press_toml

pytestmark = pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="systemd's socket is POSIX")


@pytest.fixture
def systemd(tmp_path, monkeypatch):
    """What systemd is to a service: a datagram socket named in the environment."""
    place = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(place)
        line.settimeout(240.0)
        monkeypatch.setenv("NOTIFY_SOCKET", place)
        monkeypatch.setenv("WATCHDOG_USEC", "30000000")
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        yield line


def test_messages_are_those_of_the_protocol(systemd):
    notifier = Notifier()
    notifier.ready("recording lab")
    notifier.alive("12 scans")
    notifier.status("waiting")
    notifier.stopping()
    datagrams = [systemd.recv(4096).decode() for _ in range(4)]
    assert datagrams == [
        "READY=1\nSTATUS=recording lab",
        "WATCHDOG=1\nSTATUS=12 scans",
        "STATUS=waiting",
        "STOPPING=1",
    ]
    assert notifier.watchdog_s == 30.0


def test_without_systemd_nothing_is_said_and_nobody_minds(tmp_path):
    Notifier({}).ready("x")
    Notifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")}).alive("x")
    assert Notifier({}).watchdog_s is None
    assert Notifier({"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}).watchdog_s is None
    assert Notifier({"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": str(os.getpid())}).watchdog_s == 1.0


class Instrument:
    """A logger of two platens whose driver can be made to hang."""

    def __init__(self):
        self.channels = (Channel("platen_top"), Channel("platen_bottom"))
        self.hangs = threading.Event()
        self.freed = threading.Event()

    def read(self):
        if self.hangs.is_set():
            self.freed.wait(240.0)
        now_s = time.monotonic()
        return Reading(now_s, now_s, (200.0, 200.0), (Quality.GOOD,) * 2)

    def close(self):
        pass


@contextmanager
def recorded(folder: Path, instrument, monkeypatch):
    (folder / "lab.toml").write_text(press_toml())
    (folder / "kerntemp.toml").write_text(
        '[[press]]\nname = "lab"\nfile = "lab.toml"\n[[press.logger]]\nname = "only"\nprofile = "labjack-t7"\n'
        'host = "127.0.0.1"\nchannels = ["platen_top", "platen_bottom"]\n'
    )
    monkeypatch.setattr(daq.recording.recorder, "open_logger", lambda settings: instrument)
    monkeypatch.setattr(daq.recording.press_line, "_STUCK_AFTER_S", 1.0)
    stop = threading.Event()
    work = threading.Thread(
        target=daq.recording.recorder.record, args=(load_config(folder / "kerntemp.toml"),), kwargs={"stop": stop}
    )
    work.start()
    try:
        yield
    finally:
        instrument.freed.set()
        stop.set()
        work.join(240.0)
        assert not work.is_alive()


def messages_until(line, sign):
    datagrams = []
    while not datagrams or sign not in datagrams[-1]:
        datagrams.append(line.recv(4096).decode())
    return datagrams


def test_the_recorder_feeds_the_watchdog_only_while_its_drivers_come_back(systemd, tmp_path, monkeypatch):
    instrument = Instrument()
    with recorded(tmp_path, instrument, monkeypatch):
        datagrams = messages_until(systemd, "WATCHDOG=1")
        assert datagrams[0] == "READY=1\nSTATUS=recording lab"
        instrument.hangs.set()
        hung = messages_until(systemd, "the driver of logger only has not returned from a read")
        assert "WATCHDOG" not in hung[-1]
        assert "WATCHDOG" not in systemd.recv(4096).decode()
        instrument.freed.set()
        messages_until(systemd, "WATCHDOG=1")
    assert messages_until(systemd, "STOPPING=1")
