"""First start on a machine that has compiled nothing yet, and later ones: how long, and where the time goes."""

import json
import os
import statistics
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import pytest

from softsensor.jobs.first_start import WorkKind
from tests.api.test_alarms import free_port

ROOT = Path(__file__).parents[2]
LATER_STARTS = int(os.environ.get("KERNTEMP_BENCH_STARTS", "3"))
PROCESSES = {
    "demonstration": "api demo ", "loggers": "api.demo.press", "page": "api serve", "recorder": "api record",
    "live sensor": "api sense", "fits' worker": "spawn_main", "worker's watch": "resource_tracker",
}  # fmt: skip
"""Words in the command of each."""
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
    later = []
    for start in ("first start", *(f"later start {k + 1}" for k in range(LATER_STARTS))):
        print(f"\ndemonstration, {start} ({os.cpu_count()} cores, load {os.getloadavg()[0]:.1f})")
        after_s = _demonstrated(tmp_path / start.replace(" ", "-"), tmp_path / "compiled")
        assert set(after_s) == {"the page", "a scan recorded", "a live core"}
        if start != "first start":
            later.append(after_s)
    for what in later[0] if later else ():
        middle = statistics.median(after_s[what] for after_s in later)
        print(f"later starts, the middle of {len(later)}: {what} after {middle:.1f} s")


def _demonstrated(folder, compiled):
    """Let the demonstration take one pressing; return what was seen after so many seconds, and print it."""
    port = free_port()
    options = ["--pressings", "1", "--speed", "20", "--port", str(port), "--data", str(folder)]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(compiled)}
    began, clock, seen = time.monotonic(), time.clock_gettime(time.CLOCK_BOOTTIME), {}
    command = [sys.executable, "-m", "api", "demo", *options]
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL) as demo:
        while demo.poll() is None:
            for what in _there(port) - seen.keys():
                seen[what] = time.monotonic() - began
                print(f"  {what:32s} after {seen[what]:6.1f} s")
                if what == "a live core":
                    _print_processes(demo.pid, clock)
            time.sleep(0.1)
    assert demo.returncode == 0
    return seen


def _print_processes(root, clock):
    """Print when the processes of a demonstration were started, and what processor time each took by now."""
    found, ticks = {}, os.sysconf("SC_CLK_TCK")
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            name = (folder / "cmdline").read_text(encoding="utf-8").replace("\0", " ")
            fields = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
            found[int(folder.name)] = (name, int(fields[1]), *(int(fields[k]) / ticks for k in (11, 12, 19)))
    total = 0.0
    for pid, (name, parent, user, system, started) in sorted(found.items(), key=lambda entry: entry[1][4]):
        while parent in found and parent != root and pid != root:
            parent = found[parent][1]
        if root in (pid, parent):
            total += user + system
            what = next((what for what, words in PROCESSES.items() if words in name), name[:40])
            print(
                f"    {what:18s} started after {started - clock:4.1f} s, {user + system:4.1f} s of processor time"
            )
    print(f"    all together {total:.1f} s of processor time")


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
