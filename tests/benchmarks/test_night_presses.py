"""A night of eight presses, one after another and shared out, side by side. Prints a table, asserts no time.

Beside the time on the clock stands the processor time of all processes: on a machine that does other work the
clock says little, and two workers on two idle cores need no less than half of theirs. One worker is held to one
core, since a diagnosis uses a second one where it is free. `KERNTEMP_BENCH_PRESSES`, `KERNTEMP_BENCH_RUNS` and
`KERNTEMP_BENCH_HIDE` ask for other numbers of presses and of runs a press, and for a cause hidden in each.
"""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest

from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.store import open_store
from tests.softsensor.test_night import found_by

PRESSES = [f"press-{i}" for i in range(int(os.environ.get("KERNTEMP_BENCH_PRESSES", "8")))]
RUNS = int(os.environ.get("KERNTEMP_BENCH_RUNS", "6"))
HIDE = os.environ.get("KERNTEMP_BENCH_HIDE")
pytestmark = [pytest.mark.benchmark, pytest.mark.timeout(3600)]

NIGHT = """
import json, os, resource, sys, time
from daq.press.press_file import parse_press
from daq.simulated.campaign_pressfile import press_toml
from daq.store import open_store
from softsensor.jobs.nights import refit_presses

def main():
    presses = dict.fromkeys(sys.argv[3:], parse_press(press_toml()))
    with open_store(sys.argv[1]) as store:
        begun = time.perf_counter()
        work(store, presses, sys.argv[2])
        wall = time.perf_counter() - begun
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    print(json.dumps([wall, sum(u.ru_utime + u.ru_stime for u in used)]))

def work(store, presses, way):
    if way == "one after another, their fits on two processes":
        for name, press in presses.items():
            list(refit_presses(store, {name: press}, workers=2))
    elif way == "two workers of Dask":
        from dask.distributed import LocalCluster
        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
            list(refit_presses(store, presses, dask=cluster.scheduler_address))
    elif way == "two workers":
        list(refit_presses(store, presses, workers=2))
    else:
        os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])
        list(refit_presses(store, presses, workers=1))

if __name__ == "__main__":
    main()
"""
WAYS = (
    "one worker on one core",
    "one after another, their fits on two processes",
    "two workers",
    "two workers of Dask",
)


def test_a_night_of_several_presses_on_two_workers(tmp_path, capsys):
    stored, script = tmp_path / "stored.sqlite", tmp_path / "night.py"
    script.write_text(NIGHT, encoding="utf-8")
    with open_store(str(stored)) as store:
        for i, press in enumerate(PRESSES):
            runs = [run for run, _ in make_campaign(7300 + i, RUNS, HIDE, Plan(rate_hz=2.0))]
            named = [replace(run, name=f"{press}-{j:02}") for j, run in enumerate(runs)]
            store.import_runs(named, press, press_toml())
    times, found, memory = {}, [], 0
    for way in WAYS:
        copy = str(shutil.copy(stored, tmp_path / f"{len(found)}.sqlite"))
        done = subprocess.run(
            [sys.executable, str(script), copy, way, *PRESSES], capture_output=True, text=True, check=True
        )
        times[way] = json.loads(done.stdout.splitlines()[-1])
        with open_store(copy) as store:
            found.append(found_by(store, PRESSES))
            nights = [record.night for record in store.newest_nights().values()]
            memory = max([memory, *(night["memory_bytes"] or 0 for night in nights)])
    with capsys.disabled():
        print(
            f"\n{len(PRESSES)} presses of {RUNS} runs, {HIDE or 'nothing'} hidden, {memory / 1e6:.0f} MB at most, "
            f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
        )
        for way, (wall, used) in times.items():
            print(
                f"{way:>48}: {wall:6.1f} s, {times[WAYS[0]][0] / wall:4.2f} times as fast as one worker, "
                f"{times[WAYS[1]][0] / wall:4.2f} as before; {used:6.1f} s of processor time"
            )
    assert all(one == found[0] for one in found)
