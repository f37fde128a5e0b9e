"""From a logger's reply to the estimate at a listener, through all three processes; prints, asserts no time.

The loggers' protocol over a socket, `kerntemp record`, `sense` and `serve` as processes of their own, a listener
of Server-Sent Events: real. The press behind the logger is simulated, in real time.
"""

import bisect
import json
import sqlite3
import subprocess
import sys
import time
from contextlib import ExitStack, closing
from datetime import datetime
from pathlib import Path

import httpx
import numpy as np
import pytest

from daq.files.run_file import toml_value
from daq.simulated.campaign import press_toml
from daq.simulated.campaign_sensors import CHANNELS
from daq.simulated.devices import simulated, wiring
from daq.simulated.press import VirtualPress, VirtualPressSettings

ROOT = Path(__file__).parents[2]
RATE_HZ, MEASURED_S = 10.0, 75.0
pytestmark = pytest.mark.benchmark


def commit_times(folder):
    """Return how long the disk takes to keep one small transaction. [s]"""
    spent = []
    with closing(sqlite3.connect(folder / "commit.sqlite", isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")
        connection.execute("CREATE TABLE t (x)")
        for i in range(200):
            begun = time.perf_counter()
            connection.execute("INSERT INTO t VALUES (?)", (i,))
            spent.append(time.perf_counter() - begun)
    return np.array(spent)


def configure(folder, table):
    (folder / "lab.toml").write_text(press_toml(), encoding="utf-8")
    text = f'[store]\nurl = "plant.sqlite"\n[[press]]\nname = "lab"\nfile = "lab.toml"\nrate_hz = {RATE_HZ}\n'
    text += 'header = { "panel.material" = "MDF", "panel.thickness_mm" = 16.0, "setting.core_target_C" = 60.0 }\n'
    text += "[[press.logger]]\n" + "".join(f"{k} = {toml_value(v)}\n" for k, v in table.items())
    (folder / "kerntemp.toml").write_text(text, encoding="utf-8")


def start(folder, name, *options):
    line = [sys.executable, "-m", "api", name, "--config", str(folder / "kerntemp.toml"), *options]
    with (folder / f"{name}.log").open("w", encoding="utf-8") as log:
        return subprocess.Popen(line, cwd=ROOT, stdout=subprocess.PIPE, stderr=log, text=True)


def listen(address, seconds):
    """Return when each estimate came and the instant of its scan, from the first on; and opening to refit. [s]

    Scans before the insertion was found are left out: their estimates are made when the pressing begins.
    """
    heard, refits, kind, opened = [], [], "", None
    with httpx.stream("GET", f"{address}/api/v1/live", timeout=30.0) as answer:
        answer.raise_for_status()
        for line in answer.iter_lines():
            name, _, rest = line.partition(":")
            if name == "event":
                kind = rest.strip()
            elif name == "data" and kind in ("estimate", "press", "fit"):
                data, now = json.loads(rest), time.time()
                utc = datetime.fromisoformat(data["utc"]).timestamp() if data.get("utc") else None
                if kind == "estimate" and data["state"] in ("open", "closed") and utc is not None:
                    heard.append((now, utc))
                elif kind == "press" and data["event"] == "opened":
                    opened = utc
                elif kind == "fit" and opened is not None:
                    refits.append(now - opened)
                    opened = None
            if heard and heard[-1][0] > heard[0][0] + seconds:
                break
    return heard, refits


def test_from_a_loggers_reply_to_a_listener(tmp_path, capsys):
    quick = VirtualPressSettings(between_s=(8.0, 9.0), press_time_s=(30.0, 31.0), open_after_s=(15.0, 16.0))
    press = VirtualPress(quick, 11)
    press.cycle(0.0)  # solved before the clock runs
    replies = []
    begun = time.monotonic()

    def inputs(_now_s):
        shown = press.temperatures(time.monotonic() - begun)
        replies.append(time.time())
        return [shown[name] for name in CHANNELS]

    with ExitStack() as stack:
        server = stack.enter_context(simulated("labjack-t7", inputs, refresh_s=0.0))
        configure(tmp_path, wiring("labjack-t7", server, "all", CHANNELS))
        for name in ("record", "sense", "serve"):
            child = start(tmp_path, name, *(("--port", "0") if name == "serve" else ()))
            stack.callback(child.communicate)
            stack.callback(child.terminate)
        address = child.stdout.readline().split()[-1].rstrip("/")
        heard, refits = listen(address, MEASURED_S)
    assert len(heard) > 0.3 * RATE_HZ * MEASURED_S
    spent = []
    for came, scanned in heard:
        i = bisect.bisect_right(replies, scanned + 0.005)
        spent.append(came - replies[i - 1])
    ms = 1000.0 * np.array(spent)
    commits = 1000.0 * commit_times(tmp_path)
    shares = ", ".join(f"{name} {value:.0f}" for name, value in zip(
        ("median", "95 %", "99 %", "worst"), [*np.quantile(ms, [0.5, 0.95, 0.99]), ms.max()], strict=True
    ))  # fmt: skip
    disk = f"median {np.median(commits):.1f}, 99 % {np.quantile(commits, 0.99):.1f}"
    with capsys.disabled():
        print(f"\nreply to listener at {RATE_HZ:g} Hz [ms]: {shares}; {len(ms)} estimates")
        print(f"one commit of this disk [ms]: {disk}")
        print(f"opening to the listener's word of the refit [s]: {', '.join(f'{r:.2f}' for r in refits)}")
    assert refits
