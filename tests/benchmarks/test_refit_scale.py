"""How long refitting a store's runs takes, by number of runs. Prints a table, asserts no time."""

import resource
import time
from dataclasses import replace

import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.store import open_store
from softsensor.jobs.night_fits import FitTask, fit_all

PRESS = parse_press(press_toml())
PLAN = Plan(rate_hz=2.0)
DISTINCT = 25
pytestmark = [pytest.mark.benchmark, pytest.mark.timeout(3600)]


def cpu_s():
    return sum(
        use.ru_utime + use.ru_stime
        for use in (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


@pytest.mark.parametrize("count", [10, 100, 1000])
def test_refitting_many_runs_on_two_processes(tmp_path, capsys, count):
    pressings = [run for run, _ in make_campaign(7300, DISTINCT, None, PLAN)]
    with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
        copies = []
        for i in range(count):
            run = pressings[i % DISTINCT]
            copies.append(replace(run, name=f"run-{i:04d}", header={**run.header, "run": f"run-{i:04d}"}))
        names = store.import_runs(copies, "lab", "press file")
        tasks = [FitTask(store.database.url.render_as_string(), PRESS, name, None) for name in names]
        begun, before = time.perf_counter(), cpu_s()
        failed = 0
        for one in fit_all(tasks, 2):
            failed += one.fit is None
            if one.fit is not None:
                store.put_fit(one.run, one.fit, "press file")
        wall, cpu = time.perf_counter() - begun, cpu_s() - before
    with capsys.disabled():
        print(f"\n{count:5d} runs: {wall:6.1f} s, {1e3 * wall / count:4.0f} ms each; {cpu:6.1f} s of CPU")
    assert failed == 0
