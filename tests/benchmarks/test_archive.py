"""What a scan costs in the store and in the archive, and what moving and reading a run takes, side by side.

A run of 3,000 scans of 16 channels at 0.1 K, warming up as in a press, with noise of half a step. Asserts the
size of issue 23 and that every bit comes back; times are printed.
"""

import time
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from daq.recording.acquisition import nine_digits
from daq.records import Channel, PressState, Quality, Scan
from daq.store import NewRun, RunEnd, StoredEstimate, open_store
from daq.store.estimate_file import ENDING
from tests.daq.test_store_archive import heating

BEGAN = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
CHANNELS = tuple(Channel(f"top_{i}", "C") for i in range(16))
RUNS, SCANS = 20, 3000
LARGEST_BYTES = 12.0
"""A scan of 16 channels at 0.1 K in the archive. (Issue 23)"""


def bytes_of(store):
    """Return the store's size without SQLite's log of what was written last."""
    if store.database.path is not None:
        with store.database.engine.connect() as connection:
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
    return store.sizes().bytes


def press(store, kept):
    """Record the runs; returns scans a second."""
    key = store.register_press("lab", CHANNELS)
    table = [tuple(map(kept, row)) for row in (heating(SCANS) * 0.1).tolist()]
    jitter = np.random.default_rng(5).normal(0, 2e-4, SCANS).tolist()
    good = (Quality.GOOD,) * 16
    spent = 0.0
    for run in range(RUNS):
        first, start = SCANS * run, BEGAN + timedelta(seconds=400 * run)
        at = [i / 10 + jitter[i] for i in range(SCANS)]
        scans = [
            Scan(first + i, start + timedelta(seconds=at[i]), round(400.0 * run + at[i], 6), table[i], good)
            for i in range(SCANS)
        ]
        begin = NewRun(f"lab-{run:02d}", first, start, 400.0 * run, {"panel.material": "MDF"})
        began = time.perf_counter()
        store.append_scans(key, scans, begin=begin, end=RunEnd(begin.run, first + SCANS - 1, scans[-1].utc))
        spent += time.perf_counter() - began
    return RUNS * SCANS / spent


def say(store):
    """Write what a live sensor says of the runs: core and band as doubles, profile and forecast to a tenth."""
    rng = np.random.default_rng(9)
    for run in range(RUNS):
        core = 20 + 80 * (1 - np.exp(-np.arange(SCANS) / 900)) + rng.normal(0, 0.05, SCANS)
        lines = []
        for i, celsius in enumerate(core.tolist()):
            profile = [round(celsius + 100 * abs(z - 4) / 4, 1) for z in range(9)]
            detail = {
                "profile_C": profile,
                "energy_kJ_m2": round(celsius * 18, 1),
                "open_in_s": round(300 - i / 10, 1),
            }
            detail |= {"peak_C": round(celsius + 9, 1), "band_from": {"constants": 0.612, "start": 0.1}}
            band = (celsius, 0.61 + i * 1e-7, celsius - 1.2, celsius + 1.2)
            at = SCANS * run + i
            lines.append(
                StoredEstimate(at, 400.0 * run + i / 10, PressState.CLOSED, *band, True, "", "lab-7", detail)
            )
        store.append_estimates("lab", lines)


def read(store):
    """Return the runs' columns and the median time of reading one. [ms]"""
    spent, columns = [], []
    for run in range(RUNS):
        began = time.perf_counter()
        columns.append(store.load_run(f"lab-{run:02d}").columns)
        spent.append(1000 * (time.perf_counter() - began))
    return columns, float(np.median(spent))


@pytest.mark.benchmark
@pytest.mark.timeout(600)
@pytest.mark.parametrize("kept", [float, nine_digits], ids=["products of 0.1", "as recorded"])
def test_a_scan_in_the_store_and_in_the_archive(store_url, tmp_path, kept):
    with open_store(store_url) as store:
        empty = bytes_of(store)
        rate = press(store, kept)
        in_store = (bytes_of(store) - empty) / (RUNS * SCANS)
        before, read_store = read(store)
        scans_only = bytes_of(store)
        say(store)
        estimate_in_store = (bytes_of(store) - scans_only) / (RUNS * SCANS)
        store.use_archive(tmp_path / "archive")
        began = time.perf_counter()
        moved = [store.archive_run(f"lab-{run:02d}") for run in range(RUNS)]
        moving = 1000 * (time.perf_counter() - began) / RUNS
        after, read_archive = read(store)
    sizes = {p: p.stat().st_size for p in (tmp_path / "archive").rglob("*.parquet")}
    estimate_in_archive = sum(n for p, n in sizes.items() if p.name.endswith(ENDING)) / (RUNS * SCANS)
    in_archive = sum(one.file_bytes for one in moved) / (RUNS * SCANS) - estimate_in_archive
    print(f"\n{store.database.dialect}, {RUNS} runs of {SCANS} scans of 16 channels at 0.1 K, {kept.__name__}")
    for what, here, there in (
        ("bytes a scan", in_store, in_archive),
        ("bytes an estimate", estimate_in_store, estimate_in_archive),
        ("ms to read a run", read_store, read_archive),
    ):
        print(f"{what:17}  store {here:6.1f}  archive {there:5.2f}  ratio {here / there:.2f}")
    print(f"scans written a second {rate:.0f}; a run moved in {moving:.0f} ms, proved")
    assert in_archive <= LARGEST_BYTES
    for mine, its in zip(before, after, strict=True):
        assert {n: v.tobytes() for n, v in mine.items()} == {n: v.tobytes() for n, v in its.items()}
