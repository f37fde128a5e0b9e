"""A night with 100 new runs over what ten years have left. Prints a table, asserts no time.

Beside the time on the clock stands the processor time of all its processes, which other work on the machine
changes little. The new runs are all different: of runs with the same readings a night judges one alone.
What is stored has fits and coefficients and no scans. `KERNTEMP_BENCH_STORED=1000000` asks for more of it.
"""

import json
import os
import resource
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime

import pytest
from sqlalchemy import insert

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.store import StoredNight, open_store
from daq.store.schema import COEFFICIENT, FIT, RUN
from softsensor.jobs.model_in_force import fingerprint
from softsensor.jobs.night_progress import WINDOW, Progress, rests_on_of

PRESS = parse_press(press_toml())
STORED = int(os.environ.get("KERNTEMP_BENCH_STORED", "100000"))
NEW, BATCH = 100, 20_000
pytestmark = [pytest.mark.benchmark, pytest.mark.timeout(3600)]

NIGHT = """
import json, sys, time
from daq.press.press_file import parse_press
from daq.simulated.campaign_pressfile import press_toml
from daq.store import open_store
from softsensor.jobs.night import refit_press
from softsensor.jobs.night_progress import agenda_of
with open_store(sys.argv[1]) as store:
    press = parse_press(press_toml())
    begun = time.perf_counter()
    agenda = agenda_of(store, "lab", press, None)
    looked = time.perf_counter() - begun
    refit_press(store, "lab", press, workers=2)
    print(json.dumps([looked, len(agenda.due), store.nights(press="lab").items[0].night]))
"""


def remember(store, like, count):
    """Leave `count` runs like one, with their fits and coefficients, and a night that has seen them all."""
    names = PRESS.coefficient_names
    with store.database.writing() as connection:
        row = dict(connection.execute(RUN.select().where(RUN.c.run == like)).mappings().one())
    row.pop("run_number")
    fit = {"converged": 1, "created_unix_s": 1.7e9, "rmse_kelvin": 0.3, "model_version": "press file"}
    value = {"value_w_m2k": 100.0, "sd_w_m2k": 5.0, "low_w_m2k": 90.0, "high_w_m2k": 110.0, "identifiable": 1}
    for first in range(0, count, BATCH):
        numbers = range(first + 10, min(first + BATCH, count) + 10)
        runs = [
            {**row, "run": f"old-{i:07d}", "run_number": i, "first_scan": -i, "last_scan": -i} for i in numbers
        ]
        fits = [{**fit, "fit_id": i, "run": f"old-{i:07d}", "fit_json": '{"coefficients": {}}'} for i in numbers]
        table = [{**value, "fit_id": i, "name": name} for i in numbers for name in names]
        with store.database.writing() as connection:
            for into, rows in ((RUN, runs), (FIT, fits), (COEFFICIENT, table)):
                connection.execute(insert(into), rows)
    window = store.pressings("lab", limit=WINDOW)
    for record in window:
        known = {n: {"value": 100.0, "sd": 5.0, "ci95": [90.0, 110.0], "identifiable": True} for n in names}
        mark = fingerprint(record, PRESS, None)
        store.put_fit(record.run, {"coefficients": known, "rmse_K": 0.3, "fingerprint": mark}, "press file")
    progress = Progress(seen=window[0].number, rests_on=rests_on_of(PRESS, None))
    now = datetime.now(UTC)
    store.put_night(StoredNight("lab", now, now, {}, progress.as_json()))


def used_s():
    """Return the processor time of all processes that this one began and that have ended. [s]"""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_a_night_with_a_hundred_new_runs_over_all_that_is_stored(tmp_path, capsys):
    runs = [run for run, _ in make_campaign(7300, NEW, None, Plan(rate_hz=2.0))]
    path = str(tmp_path / "kerntemp.sqlite")
    with open_store(path) as store:
        store.import_runs([replace(runs[0], name="like")], "lab", press_toml())
        remember(store, "like", STORED)
        store.import_runs([replace(run, name=f"new-{i:04d}") for i, run in enumerate(runs)], "lab", press_toml())
    before = used_s()
    done = subprocess.run([sys.executable, "-c", NIGHT, path], stdout=subprocess.PIPE, text=True, check=True)
    looked, due, night = json.loads(done.stdout)
    shape = (
        "\n{stored:>9} stored, {new} new: looked through in {looked:.2f} s, {due} due, {fitted} fitted; "
        "the night {seconds:.1f} s, {used:.0f} s of processor time with its start, {mb:.0f} MB at most"
    )
    numbers = {"stored": STORED, "looked": looked, "due": due, "mb": (night["memory_bytes"] or 0) / 1e6}
    numbers["used"] = used_s() - before
    with capsys.disabled():
        print(shape.format(**{**night, **numbers}))
    assert (night["new"], due, night["fitted"]) == (NEW, NEW, NEW)
