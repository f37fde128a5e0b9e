"""First start on a machine that has compiled nothing yet, and later ones: how long, and where the time goes."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import pytest

from softsensor.jobs.first_start import WorkKind
from tests.api.test_alarms import free_port

ROOT = Path(__file__).parents[2]
CHILD = """
import json, sys, time
began = time.perf_counter(), time.process_time()
steps = []
def lap(what):
    steps.append((what, time.perf_counter() - began[0], time.process_time() - began[1]))
import daq, softsensor
samples = daq.shared_files() / "samples"
press = softsensor.read_press(daq.shared_files() / "presses/lab.toml")
run = softsensor.read_run(samples / "2026-03-04-07.csv")
lap("imported, run and press read")
from numba.core import event
with event.install_recorder("numba:compile") as compiled:
    if sys.argv[1] == "fit":
        softsensor.fit(run, press)
        lap("one run fitted")
    else:
        sensor = softsensor.LiveSensor(press, run.header)
        for i, time_s in enumerate(run.time_s[:60].tolist()):
            said = sensor.update(time_s, {name: float(values[i]) for name, values in run.columns.items()})
            if i in (0, 59):
                lap(f"scan {i + 1}, core {said.core_C:.1f} C")
began_of, spent = {}, {}
for at, what in compiled.buffer:
    name = str(what.data["dispatcher"].py_func.__qualname__)
    if what.is_start:
        began_of.setdefault(name, []).append(at)
    else:
        spent[name] = spent.get(name, 0.0) + at - began_of[name].pop()
print(json.dumps({"steps": steps, "compiled": spent}))
"""

LISTED = """
import sys, time
from numba import types
from daq.compiled_ahead import function_at, read_list
from softsensor.jobs.first_start import WorkKind, list_of
def scalars(of):
    if isinstance(of, types.BaseTuple):
        return sum(map(scalars, of))
    return 5 + 2 * of.ndim if isinstance(of, types.Array) else 1
functions, spent = read_list(list_of(WorkKind(sys.argv[1]))), []
for of in functions:
    made = function_at(of.module, of.name)
    began = time.process_time()
    made.compile(of.signature)
    spent.append((time.process_time() - began, f"{of.name} of {sum(map(scalars, of.signature))} scalars"))
print(f"{len(spent)} functions, {sum(took for took, _ in spent):.1f} s of processor time")
for took, name in sorted(spent, reverse=True)[:15]:
    print(f"  {took:5.2f} s  {name}")
"""


@pytest.mark.benchmark
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("work", WorkKind)
def test_processor_time_that_a_list_takes_to_compile(work, tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", LISTED, work], capture_output=True, text=True, check=True, env=environment, cwd=ROOT
    )
    print(f"\n{work} (load {os.getloadavg()[0]:.1f}): {done.stdout}")


@pytest.mark.benchmark
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("what", ["fit", "live"])
def test_time_of_a_first_start(what, tmp_path):
    for start in ("first start", "later start"):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            [sys.executable, "-c", CHILD, what],
            capture_output=True,
            text=True,
            check=True,
            env=environment,
            cwd=tmp_path,
        ).stdout
        found = json.loads(done.splitlines()[-1])
        print(f"\n{what}, {start} ({os.cpu_count()} cores, load {os.getloadavg()[0]:.1f})")
        for step, wall, cpu in found["steps"]:
            print(f"  {step:32s} after {wall:6.1f} s, {cpu:6.1f} s of processor time")
        longest = sorted(found["compiled"].items(), key=lambda entry: -entry[1])[:8]
        print(
            "  compiling, each with what it calls: " + ", ".join(f"{name} {took:.1f} s" for name, took in longest)
        )


@pytest.mark.benchmark
@pytest.mark.timeout(1800)
def test_time_until_the_demonstration_shows_something(tmp_path):
    port = free_port()
    for start in ("first start", "later start"):
        folder = tmp_path / start.replace(" ", "-")
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "compiled")}
        command = [
            sys.executable,
            "-m",
            "api",
            "demo",
            "--pressings",
            "1",
            "--port",
            str(port),
            "--data",
            str(folder),
        ]
        print(f"\ndemonstration, {start} ({os.cpu_count()} cores, load {os.getloadavg()[0]:.1f})")
        began, seen = time.monotonic(), set()
        with subprocess.Popen([*command, "--speed", "20"], env=environment, stdout=subprocess.DEVNULL) as demo:
            while demo.poll() is None:
                for what in _there(port) - seen:
                    seen.add(what)
                    print(f"  {what:32s} after {time.monotonic() - began:6.1f} s")
                time.sleep(0.2)
        assert demo.returncode == 0
        assert len(seen) == 3


def _there(port):
    """What the page's server shows by now."""
    try:
        with urlopen(f"http://127.0.0.1:{port}/api/v1/press", timeout=5) as answer:
            presses = json.load(answer)["items"]
    except (URLError, TimeoutError, ConnectionError):
        return set()
    read = any(channel["value"] is not None for now in presses for channel in now["channels"])
    core = any(now["estimate"] is not None and now["estimate"]["valid"] for now in presses)
    found = {"the page": True, "a scan recorded": read, "a live core": core}
    return {what for what, there in found.items() if there}
