"""Old runs move into files and answer as before; what is not proved is not deleted."""

import math
import os
import random
import signal
import time
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from sqlalchemy import text

from daq.files.run_file import read_run
from daq.records import Channel, InputError, PressState, Quality, Run, Scan
from daq.store import NewRun, RunEnd, StoredEstimate, archive, open_store, proved_file, run_scans
from daq.store.archive_file import StoredScans, read_archive, write_archive
from daq.store.estimate_file import beside, read_estimates
from daq.store.proved_file import SUM
from daq.store.records import ArchiveUnreadable, StoreUnavailable
from daq.store.upkeep import restore
from tests.daq.archive_1 import make as archive_1
from tests.editions import edition

BEGAN = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
LATER = BEGAN + timedelta(days=400)
CHANNELS = (Channel("platen_top", "C"), Channel("top_1", "C"), Channel("load", "kN"))
G = Quality.GOOD


def stored(values, faults=None):
    n = len(values)
    rng = np.random.default_rng(3)
    monotonic_s = np.round(1000.0 + np.arange(n) / 10 + rng.normal(0, 1e-3, n), 6)
    unix_s = np.round((1.7e9 + monotonic_s) * 1e6) / 1e6
    texts = (None,) * n if faults is None else faults
    return StoredScans(np.arange(7, 7 + n), unix_s, monotonic_s, np.full(n, 3), {3: values}, texts, (None,) * n)


def through_a_file(scans, folder):
    names = {key: [f"c{i}" for i in range(values.shape[1])] for key, values in scans.values.items()}
    written = write_archive(folder / "a.parquet", scans, names, {}, {})
    return read_archive(folder / "a.parquet", written.sha256), written.bytes / max(len(scans), 1)


def heating(scans, channels=16, step=0.1):
    """What a press's thermocouples count: whole steps of a curve that warms up, with noise of half a step."""
    rng = np.random.default_rng(0)
    t = np.arange(scans)[:, None] / 10
    curves = 20 + 150 * (1 - np.exp(-t / (20 + 5 * np.arange(channels))))
    return np.rint((curves + rng.normal(0, 0.5 * step, curves.shape)) / step)


READ = {
    "tenths as text says them": lambda counts: counts / 10,
    "tenths as a driver multiplies": lambda counts: counts * 0.1,
    "tenths with a calibration's offset": lambda counts: counts * 0.1 - 0.423,
    "tenths with gain and offset": lambda counts: 1.0003 * (counts * 0.1) + 0.31,
    "a full scale of 1370 °C in 32767 counts": lambda counts: np.rint(counts * 3.2) * (1370 / 32767),
    "doubles of any kind": lambda counts: counts / 10 + np.random.default_rng(1).normal(0, 0.01, counts.shape),
}
LARGEST = {"doubles of any kind": 110.0}
"""Bytes a scan of 16 channels may take; 12 at 0.1 K where nothing else is said (issue 23)."""


@pytest.mark.parametrize("how", READ)
def test_a_file_gives_every_bit_back_and_stays_small(how, tmp_path):
    values = READ[how](heating(3000))
    values[5, 3] = math.nan
    values[100:200, 0] = math.nan
    scans = stored(values)
    back, size = through_a_file(scans, tmp_path)
    assert back.same_as(scans)
    assert size <= LARGEST.get(how, 14.0 if "full scale" in how or "gain" in how else 12.0)


@pytest.mark.parametrize(("scans", "most"), [(1000, 12.0), (600, 14.0), (240, 20.0), (120, 32.0)])
def test_a_short_pressing_stays_small_too(scans, most, tmp_path):
    back, size = through_a_file(stored(heating(scans) / 10), tmp_path)
    assert len(back) == scans
    assert size <= most


@settings(max_examples=40)
@example(rows=[[0.0, 0.0], [0.0, 2.0], [0.0, 1.1125369292536007e-308]])
@given(rows=st.lists(st.lists(st.floats(width=64), min_size=2, max_size=2), min_size=1, max_size=5))
def test_any_value_comes_back_to_the_last_bit(rows, tmp_path_factory):
    values = np.where(np.isnan(rows), np.nan, rows)
    scans = stored(values, tuple('{"c0":"open"}' if i % 2 else None for i in range(len(rows))))
    assert through_a_file(scans, tmp_path_factory.mktemp("a"))[0].same_as(scans)


def test_scans_of_several_layouts_come_back_each_with_its_channels(tmp_path):
    scans = StoredScans(
        np.array([4, 5, 7]),
        np.full(3, np.nan),
        np.array([0.0, 0.1, 0.3]),
        np.array([2, 5, 2]),
        {2: np.array([[1.5, -0.0], [math.nan, 2.5]]), 5: np.array([[9.0]])},
        (None, '{"b":"open"}', None),
        (None, None, '{"note":"door"}'),
    )
    written = write_archive(tmp_path / "a.parquet", scans, {2: ["a", "b"], 5: ["b"]}, {}, {})
    assert read_archive(tmp_path / "a.parquet", written.sha256).same_as(scans)


def test_files_of_the_first_format_still_give_every_bit_back():
    files = Path(archive_1.__file__).with_name("run.parquet")
    sums = [file.with_name(file.name + SUM).read_text().split()[0] for file in (files, beside(files))]
    assert read_archive(files, sums[0]).same_as(archive_1.scans())
    assert read_estimates(beside(files), sums[1]) == archive_1.estimates()
    with pytest.raises(InputError, match="through its store only"):
        read_run(files)


@pytest.mark.parametrize("how", [*READ, "an unusable one", "another clock"])
def test_an_archived_run_is_a_run_file(how, store, tmp_path):
    counts = heating(200, 3)
    table = READ.get(how, READ["tenths as text says them"])(counts).tolist()
    table[5][1] = math.nan
    key = store.register_press("lab", CHANNELS)
    bad = {50: (G, Quality.STALE, G)} if how == "an unusable one" else {}
    jitter = 0.1 if how != "another clock" else 0.1000000007
    scans = [
        Scan(i, BEGAN + timedelta(seconds=i / 10), 30.0 + i * jitter, tuple(row), bad.get(i, (G, G, G)))
        for i, row in enumerate(table)
    ]
    begin = NewRun("one", 0, BEGAN, 30.0, {"panel.material": "MDF", "panel.thickness_mm": 16.0})
    store.append_scans(key, scans, begin=begin, end=RunEnd("one", 199, scans[-1].utc))
    known = store.run_for_file("one")
    store.use_archive(tmp_path)
    store.archive_run("one")
    [file] = tmp_path.rglob("*-one.parquet")
    read = read_run(file)
    assert read.header == known.header
    assert read.time_s == pytest.approx(known.time_s, abs=1e-6)
    assert {n: c.tobytes() for n, c in read.columns.items()} == {n: c.tobytes() for n, c in known.columns.items()}
    assert read.texts == known.texts
    if "says" in how or "multiplies" in how:  # as decimals, which any program reads
        plain = pq.read_table(file, columns=["time_s", "platen_top"]).to_pydict()
        for name, cells in (("time_s", known.time_s), ("platen_top", known.columns["platen_top"])):
            assert [float(cell) for cell in plain[name]] == pytest.approx(cells.tolist(), abs=1e-6)


def scan(number):
    values = (200.0 + number % 3 / 10, 20.0 + number / 7, 3.5 if number % 5 else math.nan)
    return Scan(
        number,
        BEGAN + timedelta(seconds=number / 10),
        number / 10,
        values,
        (G, G, G if number % 5 else Quality.OPEN),
    )


def record(store, run="one", first=0, press="lab"):
    """Record 100 scans, of which 60 are a run."""
    key = store.register_press(press, CHANNELS)
    first = key.next_number
    numbers = range(first, first + 100)
    start = scan(first + 20)
    begin = NewRun(run, first + 20, start.utc, start.monotonic_s, {"panel.material": "MDF"})
    end = RunEnd(run, first + 79, scan(first + 79).utc)
    store.append_scans(key, [scan(n) for n in numbers], begin=begin, end=end)
    estimates = [estimate(n) for n in numbers if n % 4]
    store.append_estimates(press, estimates)


def estimate(number):
    if number % 3 == 0:
        return StoredEstimate(number, number / 10, PressState.OPEN, *[math.nan] * 4, False, "platens_missing")
    core = 20.0 + math.sqrt(number)
    detail = {"profile_C": [core, 21.5], "energy_kJ_m2": number / 7}
    return StoredEstimate(
        number, number / 10, PressState.CLOSED, core, 0.5, core - 1.0, core + 1.0, True, "", "v1", detail
    )


def answers(store, run):
    loaded = store.run_for_file(run)
    part = store.load_run(run, ["top_1"], 1.0, 2.0)
    whole = [
        loaded.time_s.tobytes(),
        {n: v.tobytes() for n, v in loaded.columns.items()},
        loaded.header,
        loaded.texts,
    ]
    some = [part.time_s.tobytes(), part.columns["top_1"].tobytes(), part.texts]
    cores = {n: repr(c) for n, c in store.run_cores([run]).items()}
    return [*whole, *some, store.units_of(run), store.columns_of(run), repr(store.estimates(run)), cores]


@pytest.fixture
def store(store_url):
    with open_store(store_url) as opened:
        yield opened


def test_a_run_in_the_archive_gives_the_same_answers(store, tmp_path):
    record(store)
    words = {"note": ("", "door open", "")}
    nan = math.nan
    store.import_run(
        Run("told", {"run_started": "x"}, np.arange(3.0), {"top_1": np.array([20.1, nan, 20.3])}, texts=words),
        "lab",
    )
    before = {run: answers(store, run) for run in ("one", "told")}
    store.use_archive(tmp_path / "archive")
    for run in before:
        known = store.run_for_file(run)
        moved = store.archive_run(run)
        assert moved.file_bytes > 0
        [file] = (tmp_path / "archive").rglob(f"*-{run}.parquet")
        assert (read_run(file).header, read_run(file).texts) == (known.header, known.texts)
        assert answers(store, run) == before[run]
    kept = store.archive()
    assert (kept.runs, kept.scans, kept.removed, kept.unsound) == (2, 63, 0, 0)
    assert len(store.estimates("one")) == 45
    with store.database.reading() as connection:
        assert connection.execute(text("SELECT count(*) FROM scan")).scalar() == 40
        assert connection.execute(text("SELECT count(*) FROM scan_remark")).scalar() == 0
        assert connection.execute(text("SELECT count(*) FROM estimate")).scalar() == 30
    assert store.register_press("lab", CHANNELS).next_number == 100


def test_the_sum_beside_a_file_is_that_of_the_standard(store, tmp_path):
    import hashlib

    record(store)
    store.use_archive(tmp_path)
    store.archive_run("one")
    [file] = tmp_path.rglob("*-one.parquet")
    output = file.with_name(file.name + SUM).read_text()
    assert output == f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n"


def test_runs_are_archived_by_age_and_open_ones_never(store, tmp_path):
    record(store)
    record(store, "two")
    key = store.register_press("lab", CHANNELS)
    store.append_scans(key, [scan(key.next_number)], begin=NewRun("open", key.next_number, BEGAN, 0.0))
    store.import_run(Run("undated", {}, np.arange(3.0), {"top_1": np.ones(3)}), "lab")
    store.use_archive(tmp_path)
    assert store.runs_to_archive("lab", scan(100).utc) == ["one"]
    assert store.runs_to_archive("lab", LATER) == ["one", "two"]  # of "open", the newest, later
    assert store.runs_to_archive("other", LATER) == []
    store.archive_run("one")
    assert store.runs_to_archive("lab", LATER) == ["two"]


def test_idle_scans_before_an_archived_run_are_thinned_once_and_a_backup_of_it_all_is_sound(store, tmp_path):
    record(store)
    record(store, "two")
    store.use_archive(tmp_path / "archive")
    store.archive_run("one")
    assert sum(store.thin_idle(scan(60).utc, keep_every=19)) > 0
    assert list(store.thin_idle(scan(60).utc, keep_every=19)) == []
    contents = store.back_up(tmp_path / "b.sqlite")
    assert restore(tmp_path / "b.sqlite", str(tmp_path / "again.sqlite")) == contents
    with open_store(str(tmp_path / "again.sqlite")) as again:
        assert answers(again, "one") == answers(store, "one")


@pytest.mark.parametrize("harm", ["missing", "damaged"])
def test_a_file_that_is_not_sound_is_told_with_a_remedy_and_nothing_is_deleted(store, harm, tmp_path):
    record(store)
    store.put_fit("one", {"coefficients": {}}, "v1")
    before = answers(store, "one")
    store.use_archive(tmp_path)
    store.archive_run("one")
    [file] = tmp_path.rglob("*-one.parquet")
    sound = file.read_bytes()
    assert store.check_archive(datetime.now(UTC) + timedelta(days=1)).unsound == ()
    if harm == "missing":
        file.unlink()
    else:
        file.write_bytes(sound[:900] + bytes([sound[900] ^ 1]) + sound[901:])
    expected = "missing; copy it back" if harm == "missing" else "no longer what was written; copy it back"
    with pytest.raises(ArchiveUnreadable, match=expected):
        store.load_run("one")
    found = store.check_archive(datetime.now(UTC) + timedelta(days=1))
    assert [expected in str(one) for one in found.unsound] == [True]
    assert store.archive().unsound == 1
    assert store.remove_archived("lab", LATER) == (0, 0)
    assert store.columns_of("one") == ("platen_top", "top_1", "load")
    file.write_bytes(sound)
    store.recheck_unsound(datetime.now(UTC) + timedelta(days=1))
    assert store.check_archive(BEGAN).mended == ("one",)
    assert store.archive().unsound == 0
    assert answers(store, "one") == before


def test_pressings_alone_stay_where_the_rule_says_so(store, tmp_path):
    record(store)
    record(store, "unfitted")
    store.put_fit("one", {"coefficients": {"h": {"value": 1.0}}}, "v1")
    store.use_archive(tmp_path)
    for run in ("one", "unfitted"):
        store.archive_run(run)
    with store.database.writing() as connection:
        connection.execute(text("UPDATE run SET closed_s = 3.0"))
    assert store.remove_archived("lab", BEGAN) == (0, 0)
    runs, gone = store.remove_archived("lab", LATER)
    assert (runs, gone > 0) == (1, True)
    with pytest.raises(InputError, match="run one: its scans were deleted on 20"):
        store.load_run("one")
    assert store.fit("one")["coefficients"]["h"]["value"] == 1.0
    assert store.run_record("one").header["panel.material"] == "MDF"
    assert store.columns_of("one") == ("platen_top", "top_1", "load")
    left = ["00000002-unfitted.estimates.parquet", "00000002-unfitted.parquet"]
    assert sorted(p.name for p in tmp_path.rglob("*.parquet")) == left
    assert len(list(tmp_path.rglob("*" + SUM))) == 2
    assert store.without_scans(["one", "unfitted"]) == {"one"}
    assert [r.run for r in store.pressings("lab")] == ["unfitted"]
    assert store.count_pressings("lab") == 2
    assert store.archive().removed == 1


def dies_at(store, where, do):
    """Do something in a process of its own that is killed at a place, before that or right after it."""
    module, name, after = where
    child = os.fork()
    if child:
        assert os.WIFSIGNALED(os.waitpid(child, 0)[1]), "it came to its end without passing there"
        return
    real = getattr(module, name)

    def fatal(*given, **named):
        if after:
            real(*given, **named)
        os.kill(os.getpid(), signal.SIGKILL)

    setattr(module, name, fatal)
    with open_store(store.database.address) as own:
        do(own)
    os._exit(0)


MOMENTS = {
    "while the file is written": (proved_file, "_to_disk", False),
    "before what was written is compared": (proved_file, "columns_in", False),
    "before the sum is written": (proved_file, "_with_sum", False),
    "when the first file is done": (proved_file, "_with_sum", True),
    "before the estimates": (archive, "write_estimates", False),
    "after the estimates": (archive, "write_estimates", True),
    "before the row": (archive, "_exchange", False),
    "amid the transaction": (archive, "_count", True),
    "before the commit": (archive, "_exchange", True),
}


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_killed_anywhere_archiving_loses_nothing_and_goes_on(store, tmp_path):
    folder = tmp_path / "archive"
    store.use_archive(folder)
    for done, (moment, where) in enumerate(MOMENTS.items()):
        record(store, moment)
        before = answers(store, moment)
        dies_at(store, where, lambda own: own.archive_run(moment))  # noqa: B023
        assert answers(store, moment) == before
        assert store.archive().runs == done
        store.archive_run(moment)
        assert answers(store, moment) == before
    assert store.archive().runs == len(MOMENTS)
    left = [p.suffix for p in sorted(folder.rglob("*")) if p.is_file()]
    assert left == [".parquet", ".sha256"] * 2 * len(MOMENTS)


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_another_who_archives_the_same_run_and_is_killed_costs_nothing(store, tmp_path, monkeypatch):
    record(store)
    before = answers(store, "one")
    store.use_archive(tmp_path / "archive")
    real, begun = StoredScans.same_as, []

    def same_as(mine, its):
        if not begun:
            begun.append(True)
            dies_at(store, (proved_file, "write_columns", False), lambda own: own.archive_run("one"))
        return real(mine, its)

    monkeypatch.setattr(StoredScans, "same_as", same_as)
    with suppress(StoreUnavailable):
        store.archive_run("one")
    assert answers(store, "one") == before
    if not store.archive().runs:
        store.archive_run("one")
    assert answers(store, "one") == before
    left = sorted(p.suffix for p in (tmp_path / "archive").rglob("*") if p.is_file())
    assert left == [".parquet", ".parquet", ".sha256", ".sha256"]


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_killed_while_scans_are_given_up_the_next_night_ends_it(store, tmp_path):
    folder = tmp_path / "archive"
    store.use_archive(folder)
    for run, name in {"before the files go": "_with_sums", "after the files went": "_files_gone"}.items():
        record(store, run)
        store.archive_run(run)
        dies_at(store, (archive, name, False), lambda own: own.remove_archived("lab", LATER))
        assert store.without_scans([run]) == {run}
        assert store.remove_archived("lab", LATER) == (0, 0)
        assert [p for p in folder.rglob("*") if p.is_file()] == []
    assert (store.archive().runs, store.archive().bytes, store.archive().removed) == (0, 0, 2)


def test_a_file_of_another_store_is_not_written_over(store, tmp_path):
    record(store)
    store.use_archive(tmp_path)
    place = tmp_path / "2026" / "03" / "00000001-one.parquet"
    place.parent.mkdir(parents=True)
    place.write_bytes(b"another store's")
    with pytest.raises(InputError, match="give each store a folder of its own"):
        store.archive_run("one")
    assert place.read_bytes() == b"another store's"
    assert len(store.load_run("one").time_s) == 60


def test_scans_that_came_meanwhile_keep_all_of_a_run_in_the_store(store, tmp_path, monkeypatch):
    record(store)
    store.use_archive(tmp_path)
    real = write_archive

    def slow(path, *given):
        with store.database.writing() as connection:
            connection.execute(text("DELETE FROM scan WHERE number = 50"))
        return real(path, *given)

    monkeypatch.setattr("daq.store.archive.write_archive", slow)
    with pytest.raises(Exception, match="its scans changed while they were archived"):
        store.archive_run("one")
    assert store.archive().runs == 0
    assert len(store.load_run("one").time_s) == 59


def test_a_run_that_is_archived_while_it_is_read_is_read_whole(store, tmp_path, monkeypatch):
    record(store)
    before = answers(store, "one")
    store.use_archive(tmp_path)
    real = run_scans.archived_scans

    def meanwhile(connection, run):
        found = real(connection, run)
        monkeypatch.undo()
        with open_store(store.database.address) as other:
            other.archive_run(run)
        return found

    monkeypatch.setattr(run_scans, "archived_scans", meanwhile)
    assert len(store.load_run("one").time_s) == 60
    assert store.archive().runs == 1
    assert answers(store, "one") == before


def test_a_folder_without_what_was_archived_is_refused(store, tmp_path):
    record(store)
    store.use_archive(tmp_path / "a")
    store.archive_run("one")
    with pytest.raises(
        InputError, match=r"lacks 2026/03/00000001-one.parquet, which was archived in .*nothing was"
    ):
        store.use_archive(tmp_path / "b")
    assert not (tmp_path / "b").exists()
    assert store.archive().folder == str(tmp_path / "a")
    (tmp_path / "a").rename(tmp_path / "b")
    store.use_archive(tmp_path / "b")
    assert len(store.load_run("one").time_s) == 60


def test_a_lost_file_be_it_the_newest_does_not_end_the_archive(store, tmp_path):
    record(store)
    record(store, "two")
    store.use_archive(tmp_path / "a")
    store.archive_run("one")
    store.archive_run("two")
    [lost] = (tmp_path / "a").rglob("*-two.parquet")
    lost.unlink()
    store.use_archive(tmp_path / "a")
    found = store.check_archive(datetime.now(UTC) + timedelta(days=1))
    assert [str(lost) in str(one) for one in found.unsound] == [True]
    (tmp_path / "b" / "lost+found").mkdir(parents=True)
    for elsewhere in ("b", "c"):
        with pytest.raises(InputError, match=r"lacks 2026/03/00000002-two\.parquet"):
            store.use_archive(tmp_path / elsewhere)
    assert not (tmp_path / "c").exists()


@pytest.mark.campaign
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_killed_at_random_again_and_again_a_night_archives_and_gives_up_all_and_loses_nothing(store, tmp_path):
    folder, chance = tmp_path / "archive", random.Random(4)
    store.use_archive(folder)
    names = [f"run {i}" for i in range(edition(8, 300))]
    before, kills = {}, 0
    for name in names:
        record(store, name)
        store.put_fit(name, {"coefficients": {}}, "v1")
        before[name] = answers(store, name)

    def night(own):
        for name in own.runs_to_archive("lab", LATER):
            own.archive_run(name)
        while own.remove_archived("lab", scan(100 * len(names) // 2).utc, limit=3)[0]:
            pass

    while store.runs_to_archive("lab", LATER) or store.archive().removed < len(names) // 2:
        child = os.fork()
        if not child:
            with open_store(store.database.address) as own:
                night(own)
            os._exit(0)
        time.sleep(chance.uniform(0.0, 0.8))
        os.kill(child, signal.SIGKILL)
        kills += os.WIFSIGNALED(os.waitpid(child, 0)[1])
        gone = store.without_scans(names)
        for name in chance.sample(names, 4):
            assert name in gone or answers(store, name) == before[name]
    for name in set(names) - store.without_scans(names):
        assert answers(store, name) == before[name]
    night(store)
    kept = store.archive()
    assert (kept.runs, kept.removed) == (len(names) - 1 - len(names) // 2, len(names) // 2)
    assert len(list(folder.rglob("*.parquet"))) == 2 * kept.runs
    print(f"{kills} kills: {kept.runs} of {len(names)} runs archived, {kept.removed} given up, none lost")
