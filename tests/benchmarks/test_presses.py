"""How many presses at 10 Hz one machine records before a scan is late. Prints a table, asserts no time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from daq.files.run_file import toml_value
from daq.records import Quality
from daq.store import open_store

ROOT = Path(__file__).parents[2]
COLUMNS = (
    "platen_top",
    "platen_bottom",
    *(f"top_{i}" for i in range(1, 8)),
    *(f"bottom_{i}" for i in range(1, 8)),
)
MEASURED_S = 12.0
LOGGERS = """
import json, math, sys
from contextlib import ExitStack
from daq.simulated.devices import simulated, wiring
columns = tuple(json.loads(sys.argv[2]))
def room(now_s):
    return [25.0 + 0.5 * math.sin(now_s + k) for k in range(16)]
with ExitStack() as stack:
    tables = []
    for _ in range(int(sys.argv[1])):
        server = stack.enter_context(simulated("labjack-t7", room, refresh_s=0.0))
        tables.append(wiring("labjack-t7", server, "all", columns))
    print(json.dumps(tables), flush=True)
    sys.stdin.read()
"""


def configuration(folder: Path, tables: list[dict[str, object]]) -> Path:
    press = (ROOT / "deploy" / "presses" / "lab.toml").as_posix()
    text = '[store]\nurl = "s.sqlite"\n'
    for number, table in enumerate(tables):
        text += f'[[press]]\nname = "p{number}"\nfile = "{press}"\nrate_hz = 10.0\n[[press.logger]]\n'
        text += "".join(f"{key} = {toml_value(value)}\n" for key, value in table.items())
    path = folder / "kerntemp.toml"
    path.write_text(text)
    return path


def measured(folder: Path, count: int) -> tuple[float, float, float, float]:
    """Return scans a second and press, share left out, share of values late, and the recorder's CPU share."""
    folder.mkdir()
    words = [sys.executable, "-c", LOGGERS, str(count), json.dumps(COLUMNS)]
    loggers = subprocess.Popen(words, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    config = configuration(folder, json.loads(loggers.stdout.readline()))
    services = [
        subprocess.Popen(
            [sys.executable, "-m", "api", name, "--config", str(config)], cwd=ROOT, stderr=subprocess.DEVNULL
        )
        for name in ("record", "sense")
    ]
    try:
        with open_store(str(folder / "s.sqlite")) as store:
            while not {"record", "sense"} <= set(store.statuses()) or store.newest_scan_number("p0") < 20:
                time.sleep(0.2)
            first = [store.newest_scan_number(f"p{i}") for i in range(count)]
            missed, busy, began = _missed(store), _cpu_s(services[0].pid), time.monotonic()
            time.sleep(MEASURED_S)
            elapsed, busy = time.monotonic() - began, _cpu_s(services[0].pid) - busy
            last = [store.newest_scan_number(f"p{i}") for i in range(count)]
            time.sleep(1.5)
            left_out = (_missed(store) - missed) / (10.0 * elapsed * count)
            batch = [s for i in range(count) for s in store.scans_after(f"p{i}", first[i], 500).scans]
            late = sum(q is Quality.LATE for s in batch for q in s.qualities) / max(
                sum(len(s.qualities) for s in batch), 1
            )
            rate = sum(b - a for a, b in zip(first, last, strict=True)) / elapsed / count
            return rate, left_out, late, busy / elapsed
    finally:
        for child in services:
            child.terminate()
        for child in services:
            child.wait(30)
        loggers.stdin.close()
        loggers.wait(30)
        loggers.stdout.close()


def _missed(store) -> int:
    return sum(p["missed_ticks"] for p in store.statuses()["record"].status["presses"])


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.benchmark
@pytest.mark.timeout(1800)
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads Linux's /proc")
def test_presses_at_10_hz_until_a_scan_is_late(tmp_path):
    print("\npresses   scans/s and press   left out   values late   recorder's CPU")
    for count in (1, 8, 16, 24, 32, 48, 64, 96, 128):
        rate, left_out, late, cpu = measured(tmp_path / str(count), count)
        print(f"{count:7}   {rate:19.2f}   {left_out:8.2%}   {late:11.2%}   {cpu:14.0%}", flush=True)
        if left_out > 0.05 or late > 0.05:
            break
