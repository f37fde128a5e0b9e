"""What questions cost as the store grows: 100, 1,000, 10,000 runs of 3,000 scans in SQLite and PostgreSQL."""

import os
import time
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from sqlalchemy import func, insert, literal, select

from api.answers.health import health_of
from api.http.server import settle_memory
from daq.records import Channel, Quality, Scan
from daq.store import NewRun, RunEnd, open_store
from daq.store.outbox import Outbox
from daq.store.schema import COEFFICIENT, FIT, RUN, SCAN
from daq.store.write_batch import WriteBatch

BEGAN = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
CHANNELS = tuple(Channel(f"c{i}") for i in range(16))
PER_RUN, APART_S = 3000, 400.0
COEFFICIENTS = ("h_a", "h_b", "h_c", "h_d", "h_e", "h_f")
QUESTIONS = 300


def batch_of(run, table):
    number, start = PER_RUN * run, BEGAN + timedelta(seconds=APART_S * run)
    return [
        Scan(
            number + i,
            start + timedelta(seconds=i / 10),
            APART_S * run + i / 10,
            tuple(row),
            (Quality.GOOD,) * len(row),
        )
        for i, row in enumerate(table)
    ]


def press_runs(store, runs):
    """Record the first runs as a recorder's back-fill does; returns scans a second."""
    rng = np.random.default_rng(0)
    key = store.register_press("lab", CHANNELS)
    spent = 0.0
    coefficient = {"value": 700.0, "sd": 9.0, "ci95": [680.0, 720.0], "identifiable": True}
    fit = {"coefficients": dict.fromkeys(COEFFICIENTS, coefficient)}
    for r in range(runs):
        table = np.round(np.cumsum(rng.normal(0, 0.3, (PER_RUN, 16)), axis=0) + 100, 1).tolist()
        batch = batch_of(r, table)
        begin = NewRun(f"lab-{r:06d}", PER_RUN * r, batch[0].utc, APART_S * r, {"panel.material": "MDF"})
        began = time.perf_counter()
        store.append_scans(key, batch, begin=begin, end=RunEnd(begin.run, batch[-1].number, batch[-1].utc))
        spent += time.perf_counter() - began
        store.put_fit(begin.run, fit)
    return PER_RUN * runs / spent


def double(store, there, wanted):
    """Copy the first runs behind the last ones, inside the database: their scans, fits and coefficients."""
    more = min(there, wanted - there)
    numbers, seconds = PER_RUN * there, APART_S * there
    shifts = {SCAN.c.number: numbers, SCAN.c.unix_s: seconds, SCAN.c.monotonic_s: seconds}
    with store.database.writing() as connection:
        copy = select(*[c + literal(shifts[c]) if c in shifts else c for c in SCAN.c])
        copy = copy.where(SCAN.c.press_id == 1, SCAN.c.number < PER_RUN * more)
        connection.execute(insert(SCAN).from_select(list(SCAN.c), copy))
        rows = connection.execute(select(RUN).order_by(RUN.c.run_number).limit(more)).mappings().all()
        first_fit = connection.execute(select(func.max(FIT.c.fit_id))).scalar_one() + 1
        runs, fits, coefficients = [], [], []
        for k, row in enumerate(rows):
            run = dict(row) | {"run": f"lab-{there + k:06d}", "started_unix_s": row["started_unix_s"] + seconds}
            run["first_scan"], run["last_scan"] = row["first_scan"] + numbers, row["last_scan"] + numbers
            run["zero_monotonic_s"] += seconds
            del run["run_number"]
            runs.append(run)
            fit = {"fit_id": first_fit + k, "run": run["run"], "created_unix_s": 0.0, "model_version": ""}
            fits.append(fit | {"converged": 1, "rmse_kelvin": 0.3, "fit_json": "{}"})
            value = {"fit_id": first_fit + k, "value_w_m2k": 700.0, "sd_w_m2k": 9.0, "low_w_m2k": 680.0}
            value["high_w_m2k"] = 720.0
            coefficients += [value | {"name": name, "identifiable": 1} for name in COEFFICIENTS]
        for table, content in ((RUN, runs), (FIT, fits), (COEFFICIENT, coefficients)):
            connection.execute(insert(table), content)
    return there + more


def back_fill_rate(store, there):
    """Return scans a second through the outbox, each scan a batch of its own as the recorder puts them."""
    key = store.register_press("second", CHANNELS)
    table = np.round(np.random.default_rng(there).normal(100, 5, (6000, 16)), 1).tolist()
    outbox = Outbox(store)
    for scan in batch_of(key.next_number // PER_RUN, table):
        outbox.put(WriteBatch(key, (scan,)))
    began = time.perf_counter()
    outbox.start()
    while outbox.waiting:
        time.sleep(0.005)
    spent = time.perf_counter() - began
    outbox.close()
    return len(table) / spent


def timed(question, times=QUESTIONS):
    spent = []
    for i in range(times):
        began = time.perf_counter()
        question(i)
        spent.append(1000 * (time.perf_counter() - began))
    return np.quantile(spent, [0.5, 0.99])


def start_up(url):
    """What a recorder asks of the store before its first scan."""
    with open_store(url) as store:
        store.interrupt_open_runs("lab")
        store.register_press("lab", CHANNELS)
        store.unused_run_name("lab", BEGAN)


HEAD = "\n  runs      scans  GB   start   page   samples  history  health  [ms, p50/p99]  back-fill 1/s"


def cost_of_questions(store, url, there):
    """Return one line of the table."""
    rng = np.random.default_rng(there)
    names = [f"lab-{r:06d}" for r in rng.integers(0, there, QUESTIONS)]
    cursors = rng.integers(1, there + 1, QUESTIONS).tolist()
    costs = [
        timed(lambda i: start_up(url), 100),
        timed(lambda i: store.runs(cursor=str(cursors[i]), limit=50)),
        timed(lambda i: store.load_run(names[i])),
        timed(lambda i: store.coefficient_history(limit=200, cursor=str(cursors[i]))),
        timed(lambda i: health_of(store, datetime.now(UTC)), 100),
    ]
    shown = "  ".join(f"{a:.1f}/{b:.1f}" for a, b in costs)
    size = store.sizes().bytes / 1e9
    return f"{there:6d} {PER_RUN * there:10d} {size:5.2f}  {shown}  {back_fill_rate(store, there):.0f}"


@pytest.mark.benchmark
@pytest.mark.timeout(7200)
def test_cost_of_questions_as_the_store_grows(store_url):
    """Scale by KERNTEMP_BENCH_RUNS, default 200 runs of 3,000 scans; the full size is 10,000 runs."""
    most = int(os.environ.get("KERNTEMP_BENCH_RUNS", "200"))
    settle_memory()  # as `kerntemp serve` does
    print(HEAD)
    with open_store(store_url) as store:
        there = max(most // 100, 2)
        rate = press_runs(store, there)
        for runs in (most // 100, most // 10, most):
            while there < runs:
                there = double(store, there, runs)
            print(cost_of_questions(store, store_url, there))
        assert len(store.load_run(f"lab-{there - 1:06d}").time_s) == PER_RUN
        assert store.contents().runs == there
    print(f"runs written whole: {rate:.0f} scans/s")
