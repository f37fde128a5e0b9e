"""Backup, restore, thinning and export sums: nothing of a run is ever lost by looking after it."""

import math
import os
import sqlite3
import threading
import time
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from daq.manifest import NAME, check_listed, update_manifest
from daq.records import Channel, InputError, PressState, Quality, Run, Scan
from daq.store import NewRun, RunEnd, StoredEstimate, open_store
from daq.store.upkeep import restore, verify

BEGAN = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
CHANNELS = (Channel("platen_top"), Channel("top_1"))
G = Quality.GOOD


def scans(first, count):
    return [
        Scan(n, BEGAN + timedelta(seconds=n / 10), n / 10, (200.0, 20.0 + n / 7), (G, G))
        for n in range(first, first + count)
    ]


def fill(store):
    key = store.register_press("lab", CHANNELS, "press file")
    store.append_scans(key, scans(0, 500), begin=NewRun("one", 300, BEGAN, 30.0))
    store.append_scans(key, scans(500, 200), end=RunEnd("one", 650, BEGAN + timedelta(seconds=65)))
    store.append_estimates(
        "lab",
        [StoredEstimate(n, n / 10, PressState.IDLE, *[math.nan] * 4, False, "idle") for n in range(0, 700, 50)],
    )
    store.put_fit("one", {"coefficients": {"h": {"value": 1.0}}}, "v1")
    store.put_model("lab", "v1", {"coefficients": {}}, status="promoted")
    store.log("info", "record", "hello")
    return key


def test_a_backup_made_while_recording_is_whole_and_restores_into_a_new_store(store_url, tmp_path):
    with open_store(store_url) as store:
        key = fill(store)
        going = threading.Event()

        def write():
            n = 700
            while not going.is_set():
                store.append_scans(key, scans(n, 5))
                n += 5

        writer = threading.Thread(target=write)
        writer.start()
        try:
            contents = store.back_up(tmp_path / "backup.sqlite")
        finally:
            going.set()
            writer.join()
        assert contents.runs == 1
        assert contents.scans >= 700
        assert store.contents().scans >= contents.scans
        assert verify(tmp_path / "backup.sqlite") == contents
        with pytest.raises(InputError, match="exists already; give a new name"):
            store.back_up(tmp_path / "backup.sqlite")
        assert [p.name for p in tmp_path.iterdir() if "backup" in p.name] == ["backup.sqlite"]
        original = store.load_run("one")
    assert restore(tmp_path / "backup.sqlite", str(tmp_path / "again.sqlite")) == contents
    with open_store(str(tmp_path / "again.sqlite")) as again:
        run = again.load_run("one")
        assert run.columns["top_1"].tobytes() == original.columns["top_1"].tobytes()
        assert again.fit("one")["model_version"] == "v1"
        assert again.active_model("lab").version == "v1"
        assert again.register_press("lab", CHANNELS).next_number == contents.scans


def test_a_backup_restores_into_a_server_where_recording_goes_on(tmp_path, postgresql_url):
    with open_store(str(tmp_path / "s.sqlite")) as store:
        fill(store)
        contents = store.back_up(tmp_path / "backup.sqlite")
    assert restore(tmp_path / "backup.sqlite", postgresql_url) == contents
    with open_store(postgresql_url) as store:
        store.append_scans(store.register_press("lab", CHANNELS), scans(700, 5))
        store.put_fit("one", {"coefficients": {}}, "v2")
        store.log("info", "record", "goes on")
        assert store.import_run(Run("two", {}, np.arange(3.0), {"top_1": np.arange(3.0)}), "lab") == "two"
    with pytest.raises(InputError, match="holds data; restore only into a new place"):
        restore(tmp_path / "backup.sqlite", postgresql_url)


def test_a_damaged_backup_is_refused(tmp_path):
    with open_store(str(tmp_path / "s.sqlite")) as store:
        fill(store)
        store.back_up(tmp_path / "b.sqlite")
    content = bytearray((tmp_path / "b.sqlite").read_bytes())
    content[len(content) // 2 : len(content) // 2 + 4096] = bytes(4096)
    (tmp_path / "b.sqlite").write_bytes(content)
    with pytest.raises(InputError, match="take another backup"):
        restore(tmp_path / "b.sqlite", str(tmp_path / "again.sqlite"))
    (tmp_path / "c.sqlite").write_text("no store at all" * 1000)
    with pytest.raises(InputError, match="not a sound store"):
        verify(tmp_path / "c.sqlite")
    with pytest.raises(InputError, match="does not exist"):
        verify(tmp_path / "d.sqlite")


def test_a_backup_with_a_run_that_lost_scans_is_refused(tmp_path):
    with open_store(str(tmp_path / "s.sqlite")) as store:
        fill(store)
        store.back_up(tmp_path / "b.sqlite")
    with sqlite3.connect(tmp_path / "b.sqlite") as connection:
        connection.execute("DELETE FROM scan WHERE number = 650")
    connection.close()
    with pytest.raises(InputError, match="run one lacks its first or last scan"):
        verify(tmp_path / "b.sqlite")


def test_thinning_takes_old_idle_scans_and_never_those_of_a_run(store_url):
    with open_store(store_url) as store:
        key = fill(store)
        before = store.load_run("one")
        assert store.thin_idle(BEGAN - timedelta(days=1)) == 0
        gone = store.thin_idle(BEGAN + timedelta(seconds=68), keep_every=100)
        kept = [s.number for s in store.scans_after("lab", -1, 5000).scans]
        assert kept == [0, 100, 200, *range(300, 651), *range(680, 700)]
        assert gone == 700 - len(kept)
        after = store.load_run("one")
        assert after.columns["top_1"].tobytes() == before.columns["top_1"].tobytes()
        assert [e.number for e in store.estimates_after("lab", -1)] == [0, 100, 200, *range(300, 651, 50)]
        assert store.register_press("lab", CHANNELS).next_number == key.next_number + 700


def test_an_open_run_is_not_thinned(store_url):
    with open_store(store_url) as store:
        key = store.register_press("lab", CHANNELS)
        store.append_scans(key, scans(0, 50), begin=NewRun("r", 20, BEGAN, 2.0))
        store.thin_idle(BEGAN + timedelta(days=1))
        assert len(store.load_run("r").time_s) == 30


def test_sizes_tell_what_a_scan_costs(store_url):
    with open_store(store_url) as store:
        fill(store)
        sizes = store.sizes()
        assert sizes.bytes > 50_000
        assert sizes.bytes_per_scan == pytest.approx(sizes.bytes / 700)


def test_export_sums_are_those_of_the_standard_and_find_a_changed_file(tmp_path):
    (tmp_path / "a.csv").write_text("abc")
    (tmp_path / "b.csv").write_text("b")
    update_manifest(tmp_path, [tmp_path / "b.csv"])
    update_manifest(tmp_path, [tmp_path / "a.csv"])
    lines = (tmp_path / NAME).read_text().split("\n")
    # FIPS 180-2, appendix B.1: the sum of "abc"
    assert lines[0] == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad  a.csv"
    assert lines[1].endswith("  b.csv")
    check_listed(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text("abd")
    (tmp_path / "c.csv").write_text("not listed")
    check_listed(tmp_path / "c.csv")
    with pytest.raises(InputError, match=r"a\.csv: changed or damaged since it was exported"):
        check_listed(tmp_path / "a.csv")


def test_several_runs_are_imported_all_or_none(store_url):
    runs = [Run(name, {}, np.arange(3.0), {"top_1": np.arange(3.0)}) for name in ("a", "b", "a")]
    with open_store(store_url) as store:
        with pytest.raises(InputError, match="run 'a' is in the store already"):
            store.import_runs(runs, "lab")
        assert store.runs().items == ()
        assert store.import_runs(runs[:2], "lab") == ["a", "b"]


def generate(store, there, runs):
    """Add runs of 3000 scans as a press leaves them, fits included."""
    rng = np.random.default_rng(there)
    key = store.register_press("lab", tuple(Channel(f"c{i}") for i in range(16)))
    table = np.round(np.cumsum(rng.normal(0, 0.3, (3000, 16)), axis=0) + 100, 1).tolist()
    coefficient = {"value": 700.0, "sd": 9.0, "ci95": [680.0, 720.0], "identifiable": True}
    fit = {"coefficients": dict.fromkeys(("h_a", "h_b", "h_c", "h_d", "h_e", "h_f"), coefficient)}
    for r in range(there, there + runs):
        number, start = 3000 * r, BEGAN + timedelta(seconds=400 * r)
        batch = [
            Scan(number + i, start + timedelta(seconds=i / 10), 400.0 * r + i / 10, tuple(row), (G,) * 16)
            for i, row in enumerate(table)
        ]
        begin = NewRun(f"lab-{r:06d}", number, start, 400.0 * r, {"panel.material": "MDF"})
        store.append_scans(key, batch, begin=begin, end=RunEnd(begin.run, number + 2999, start))
        store.put_fit(begin.run, fit)


def timed(question, times):
    spent = []
    for i in range(times):
        began = time.perf_counter()
        question(i)
        spent.append(1000 * (time.perf_counter() - began))
    return np.quantile(spent, [0.5, 0.99])


@pytest.mark.benchmark
@pytest.mark.timeout(3600)
def test_cost_of_questions_as_the_store_grows(tmp_path):
    """Scale by KERNTEMP_BENCH_RUNS, default 200 runs of 3000 scans; issue sizes are 10,000 runs."""
    most = int(os.environ.get("KERNTEMP_BENCH_RUNS", "200"))
    path = tmp_path / "s.sqlite"
    rng = np.random.default_rng(1)
    print("\n  runs      scans  ingest/s  open p99  page p99  samples p50/p99  coefficients p99  [ms]")
    for runs in (most // 10, most):
        with open_store(str(path)) as store:
            there, began = store.contents(), time.perf_counter()
            more = runs - there.runs
            generate(store, there.runs, more)
            rate = 3000 * more / (time.perf_counter() - began)
            names = [f"lab-{r:06d}" for r in rng.integers(0, runs, 60)]
            opening = timed(lambda i: open_store(str(path)).close(), 20)
            cursors = rng.integers(1, runs, 60).tolist()
            page = timed(lambda i: store.runs(cursor=str(cursors[i]), limit=50), 60)  # noqa: B023
            samples = timed(lambda i: store.load_run(names[i]), 60)  # noqa: B023
            history = timed(lambda i: store.coefficient_history(limit=200), 60)
            print(
                f"{runs:6d} {3000 * runs:10d} {rate:9.0f} {opening[1]:9.1f} {page[1]:9.1f}"
                f" {samples[0]:9.1f}/{samples[1]:<6.1f} {history[1]:13.1f}"
            )
