"""Backup, restore, thinning and export sums: nothing of a run is ever lost by looking after it."""

import math
import secrets
import shutil
import sqlite3
import threading
from contextlib import closing
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from sqlalchemy import event, make_url, text

from daq.files.manifest import NAME, check_listed, update_manifest
from daq.records import Channel, InputError, PressState, Quality, Run, Scan
from daq.store import NewRun, RunEnd, RunStatus, StoredEstimate, open_store, upkeep
from daq.store.database import migrations, statements
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


def test_restoring_leaves_no_table_out(store_url, tmp_path):
    words = {"note": ("door open", "")}
    with open_store(store_url) as store:
        fill(store)
        store.import_run(Run("told", {}, np.arange(2.0), {"top_1": np.ones(2)}, texts=words), "lab")
        store.annotate_run("one", {"remark": "seen"}, "eva")
        store.put_diagnosis("lab", {"verdict": "no_effect"})
        store.beat("record", {})
        store.back_up(tmp_path / "b.sqlite")
    restore(tmp_path / "b.sqlite", str(tmp_path / "again.sqlite"))
    with open_store(str(tmp_path / "again.sqlite")) as again:
        assert again.run_for_file("told").texts == words
    with closing(sqlite3.connect(tmp_path / "b.sqlite")) as made:
        tables = [r[0] for r in made.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        before = {t: made.execute(f"SELECT count(*) FROM {t}").fetchone()[0] for t in tables}
    with closing(sqlite3.connect(tmp_path / "again.sqlite")) as made:
        assert {t: made.execute(f"SELECT count(*) FROM {t}").fetchone()[0] for t in tables} == before


@pytest.mark.parametrize("schema", [1, 2])
def test_a_backup_of_an_older_version_is_restored_and_brought_up_to_date(schema, store_url, tmp_path):
    old = {number: step for number, step in migrations().items() if number <= schema}
    with closing(sqlite3.connect(tmp_path / "old.sqlite")) as made:
        for number in sorted(old):
            for statement in statements(old[number], "sqlite"):
                made.execute(statement)
        made.execute("CREATE TABLE schema_version (version INTEGER NOT NULL)")
        made.execute(f"INSERT INTO schema_version VALUES ({schema})")
        made.execute("INSERT INTO press VALUES (1, 'lab', 'imported', '', 0)")
        made.execute('INSERT INTO channel_layout VALUES (1, 1, \'[["top_1", "C"]]\', 0)')
        made.execute("INSERT INTO scan VALUES (1, 0, NULL, 0, 1, '[20.5]', NULL)")
        made.execute(
            "INSERT INTO run (run, press_id, status, started_unix_s, zero_monotonic_s, first_scan, last_scan, "
            "header_toml, software_version) VALUES ('r', 1, 'closed', 0, 0, 0, 0, '', '1')"
        )
        made.execute("INSERT INTO fit VALUES (1, 'r', 0, 'v1', 1, 0.5, '{}')")
        made.execute("INSERT INTO coefficient VALUES (1, 'h_pp_c', 700, 10, 680, 720, 1)")
        made.commit()
    assert restore(tmp_path / "old.sqlite", store_url).schema == max(migrations())
    with open_store(store_url) as store:
        assert store.load_run("r").columns["top_1"].tolist() == [20.5]
        assert store.coefficient_history().items[0].value == 700.0


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


def test_a_backup_with_one_wrong_digit_is_refused(tmp_path):
    with open_store(str(tmp_path / "s.sqlite")) as store:
        fill(store)
        store.back_up(tmp_path / "b.sqlite")
    verify(tmp_path / "b.sqlite")
    sound = (tmp_path / "b.sqlite").read_bytes()
    place = sound.index(b"[200.0,") + 3
    (tmp_path / "b.sqlite").write_bytes(sound[:place] + b"9" + sound[place + 1 :])
    for use in (verify, lambda path: restore(path, str(tmp_path / "again.sqlite"))):
        with pytest.raises(InputError, match="changed or damaged since it was written"):
            use(tmp_path / "b.sqlite")
    assert not (tmp_path / "again.sqlite").exists()


def test_a_backup_of_a_newer_version_is_refused_by_its_own_name(tmp_path):
    with open_store(str(tmp_path / "b.sqlite")) as store, store.database.writing() as connection:
        connection.exec_driver_sql("UPDATE schema_version SET version = 99")
    with pytest.raises(InputError, match=r"backup .*b.sqlite: made by a newer version \(schema 99"):
        restore(tmp_path / "b.sqlite", str(tmp_path / "again.sqlite"))
    assert not (tmp_path / "again.sqlite").exists()


def test_a_backup_with_a_run_that_lost_scans_is_refused(tmp_path):
    with open_store(str(tmp_path / "s.sqlite")) as store:
        fill(store)
        store.back_up(tmp_path / "b.sqlite")
    with sqlite3.connect(tmp_path / "b.sqlite") as connection:
        connection.execute("DELETE FROM scan WHERE number = 650")
    connection.close()
    with pytest.raises(InputError, match="run one lacks its first or last scan"):
        verify(tmp_path / "b.sqlite")


@pytest.mark.parametrize("lost", ["number < 310", "number > 640", "number BETWEEN 300 AND 650"])
def test_a_store_with_a_closed_run_that_lost_scans_is_backed_up_and_the_rest_of_it_is_read(
    store_url, tmp_path, lost
):
    with open_store(store_url) as store:
        fill(store)
        with store.database.writing() as connection:
            connection.execute(text(f"DELETE FROM scan WHERE {lost}"))
        with pytest.raises(InputError, match="scans of it are missing"):
            store.load_run("one")
        assert store.back_up(tmp_path / "b.sqlite").runs == 1
        (alarm,) = store.journal(level="alarm").items
        assert (alarm.press, alarm.process) == ("lab", "backup")
        assert "run one lacks its first or last scans" in str(alarm.message)
        left = {"number < 310": (310, 650), "number > 640": (300, 640)}.get(lost, (300, 650))
        for one in (store, open_store(str(tmp_path / "b.sqlite"))):
            run = one.run_record("one")
            assert (run.status, run.first_scan, run.last_scan) == (RunStatus.INTERRUPTED, *left)
            assert len(one.load_run("one").time_s) == (0 if "BETWEEN" in lost else left[1] - left[0] + 1)
        one.close()
        store.back_up(tmp_path / "c.sqlite")
        assert len(store.journal(level="alarm").items) == 1
        assert restore(tmp_path / "c.sqlite", str(tmp_path / "again.sqlite")).runs == 1


def test_a_copy_that_lost_scans_which_the_store_has_is_no_backup(tmp_path, monkeypatch):
    copied = upkeep._copy_file

    def torn(source, target):
        copied(source, target)
        with closing(sqlite3.connect(target)) as connection, connection:
            connection.execute("DELETE FROM scan WHERE number = 650")

    monkeypatch.setattr(upkeep, "_copy_file", torn)
    with open_store(str(tmp_path / "s.sqlite")) as store:
        fill(store)
        with pytest.raises(InputError, match="run one lacks its first or last scan"):
            store.back_up(tmp_path / "b.sqlite")
        assert store.run_record("one").status is RunStatus.CLOSED
    assert sorted(p.name for p in tmp_path.glob("*b.sqlite*")) == []


def test_thinning_takes_old_idle_scans_and_never_those_of_a_run(store_url):
    with open_store(store_url) as store:
        key = fill(store)
        before = store.load_run("one")
        assert sum(store.thin_idle(BEGAN - timedelta(days=1))) == 0
        gone = sum(store.thin_idle(BEGAN + timedelta(seconds=68), keep_every=100))
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
        assert sum(store.thin_idle(BEGAN + timedelta(days=1))) == 19
        assert len(store.load_run("r").time_s) == 30


def test_numbers_go_on_after_a_press_that_stood_still_for_long_was_thinned(store_url):
    with open_store(store_url) as store:
        key = fill(store)
        assert sum(store.thin_idle(BEGAN + timedelta(days=1))) > 0
        assert store.register_press("lab", CHANNELS).next_number == key.next_number + 700


def test_a_long_stretch_is_thinned_in_pieces_and_a_thinning_that_ends_between_two_is_taken_up_again(store_url):
    with open_store(store_url) as store:
        key = store.register_press("lab", CHANNELS)
        store.append_scans(key, scans(0, 3000))
        first = next(iter(store.thin_idle(BEGAN + timedelta(days=1))))
        assert 0 < first < 2000
        assert len(store.scans_after("lab", -1, 5000).scans) == 3000 - first
    with open_store(store_url) as store:
        assert first + sum(store.thin_idle(BEGAN + timedelta(days=1))) == 3000 - 31
        kept = [s.number for s in store.scans_after("lab", -1, 5000).scans]
        assert kept == [*range(0, 3000, 100), 2999]


def with_runs(store, count):
    """Store runs of three scans with two idle ones before each."""
    key = store.register_press("lab", CHANNELS)
    for i in range(count):
        end = RunEnd(f"r{i}", 5 * i + 4, BEGAN + timedelta(seconds=i))
        store.append_scans(key, scans(5 * i, 5), begin=NewRun(f"r{i}", 5 * i + 2, BEGAN, 0.5 * i), end=end)
    store.append_scans(key, scans(5 * count, 2))


def test_what_is_thinned_is_not_gone_through_again_after_a_restart_however_much_is_stored(store_url):
    asked, old = [], BEGAN + timedelta(days=1)
    for count in (4, 60):
        with open_store(store_url) as store:
            with_runs(store, count)
            assert sum(store.thin_idle(old)) > 0
        with open_store(store_url) as store:
            statements_of(store, asked)
            before = len(asked)
            assert sum(store.thin_idle(old)) == 0
            assert len(asked) - before < 20, "questions that grow with the runs stored"
            for table in ("scan", "run"):
                with store.database.writing() as connection:
                    connection.execute(text(f"DELETE FROM {table}"))


def statements_of(store, asked):
    """Let every statement of a store be noted."""
    store.presses()
    event.listen(store.database.engine, "before_cursor_execute", lambda *arguments: asked.append(arguments[2]))


def test_sizes_tell_what_a_scan_costs(store_url):
    with open_store(store_url) as store:
        fill(store)
        sizes = store.sizes()
        assert sizes.bytes > 50_000
        assert sizes.bytes_per_scan == pytest.approx(sizes.bytes / 700)


def test_a_server_on_this_machine_tells_how_much_room_it_has_and_one_that_may_not_does_not(postgresql_url):
    with open_store(postgresql_url) as store:
        with store.database.reading() as connection:
            folder = connection.execute(text("SHOW data_directory")).scalar_one()
        assert store.sizes().free_bytes == pytest.approx(shutil.disk_usage(folder).free, rel=0.2)
        name = f"kt_reader_{secrets.token_hex(4)}"
        with store.database.writing() as connection:
            connection.exec_driver_sql(f"CREATE ROLE {name} LOGIN")
            connection.exec_driver_sql(f"GRANT SELECT ON ALL TABLES IN SCHEMA public TO {name}")
        try:
            url = make_url(postgresql_url).set(username=name).render_as_string(hide_password=False)
            with open_store(url) as reader:
                assert reader.sizes().free_bytes is None
                assert reader.sizes().bytes > 0
        finally:
            with store.database.writing() as connection:
                connection.exec_driver_sql(f"DROP OWNED BY {name}")
                connection.exec_driver_sql(f"DROP ROLE {name}")


def test_a_text_that_a_server_cannot_keep_is_told_in_words(postgresql_url):
    with open_store(postgresql_url) as store:
        run = Run("r", {"panel.material": "a\0b"}, np.arange(3.0), {"top_1": np.arange(3.0)})
        with pytest.raises(InputError, match="holds a NUL character"):
            store.import_run(run, "lab")
        with pytest.raises(InputError, match="holds a NUL character"):
            store.run_record("a\0b")


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
    with pytest.raises(InputError, match=r"a\.csv: changed or damaged since it was written"):
        check_listed(tmp_path / "a.csv")


def test_several_runs_are_imported_all_or_none(store_url):
    runs = [Run(name, {}, np.arange(3.0), {"top_1": np.arange(3.0)}) for name in ("a", "b", "a")]
    with open_store(store_url) as store:
        with pytest.raises(InputError, match="run 'a' is in the store already"):
            store.import_runs(runs, "lab")
        assert store.runs().items == ()
        assert store.import_runs(runs[:2], "lab") == ["a", "b"]
