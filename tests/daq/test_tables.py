"""Tables that people write: limits on what is read, and the key that was meant."""

from __future__ import annotations

import socket
import sqlite3
from contextlib import closing

import pytest

from daq.drivers.calibration import read_calibrations
from daq.files.run_file import read_run
from daq.press.press_file import parse_press, read_press
from daq.press.resin_file import read_resin
from daq.process.config import Config, load_config
from daq.records import InputError
from daq.tables import LARGEST_BYTES, fields_at, nearest, read_toml, reason_of
from daq.words import Message, spoken
from daq.words.message import words
from softsensor.jobs.model_files import read_model

PANEL = '[[layer]]\nname = "panel"\nfrom_run = true\n'


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a = 1\nb = " + 4301 * "9", r"line 2: a whole number with more than 300 digits"),
        ("x = 1\n\nb = " + 301 * "9", r"line 3: a whole number with more than 300 digits"),
        ("a = " + 3000 * "[" + 3000 * "]", "more than 16 deep within one another"),
        ("a = " + 3000 * "{a=" + "1" + 3000 * "}", "more than 16 deep within one another"),
        (".".join(3000 * "a") + " = 1", "more than 16 deep within one another"),
        ("a = " + 20 * "[" + 20 * "]", "more than 16 deep within one another"),
        ("a =", "not valid TOML"),
    ],
)
def test_numbers_and_nesting_that_would_kill_the_reader_are_refused_in_press_file_and_configuration(
    tmp_path, text, expected
):
    with pytest.raises(InputError, match=expected):
        read_toml(text)
    with pytest.raises(InputError, match=f"^press file: .*{expected}"):
        parse_press(text)
    path = tmp_path / "kerntemp.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=f"kerntemp.toml: .*{expected}"):
        load_config(path)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (b"a = 1\nb = ", "kein gültiges TOML: unverständlich ab Zeile 2, Spalte 5"),
        (b"a = 1\n= 2\n", "kein gültiges TOML: unverständlich ab Zeile 2, Spalte 1"),
        (b"[a]\n\n[a]\n", "bemerkt in Zeile 3"),
        (b"a = 1\na = 2", "bemerkt in Zeile 2"),
        (b"a = 1\nb = '\xfc'", "Zeile 2: kein UTF-8-Text"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_in_one_language_with_its_line(tmp_path, text, expected):
    path = tmp_path / "kerntemp.toml"
    path.write_bytes(text)
    for read in (load_config, read_press):
        with pytest.raises(InputError) as refused:
            read(path)
        assert expected in words(spoken(refused.value), "de")


def test_a_large_whole_number_and_a_longer_text_are_read():
    assert read_toml(f'a = {2**99}\nb = "{4301 * "9"}"')["a"] == 2**99


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("thicknes_mm", "thickness_mm"),
        ("Thickness_mm", "thickness_mm"),
        ("thikcness_mm", "thickness_mm"),
        ("thickness", "thickness_mm"),
        ("thickness_m", "thickness_mm"),
        ("supplier", None),
        ("platen_temperature_top_C", None),
        ("step_2", None),
    ],
)
def test_a_slip_of_typing_finds_the_key_that_was_meant_and_another_key_finds_none(key, meant):
    assert nearest(key, ("thickness_mm", "density_kg_m3", "platen_temperature_C", "step_1")) == meant


def test_a_refused_key_of_press_file_and_configuration_names_the_one_that_was_meant(tmp_path):
    with pytest.raises(
        InputError, match=r"layer\.0\.thicknes_mm = 3\.0: unknown key; did you mean thickness_mm\?"
    ):
        parse_press(PANEL + "thicknes_mm = 3.0")
    with pytest.raises(InputError, match=r"boundry: unknown key; did you mean boundary\?"):
        parse_press(PANEL + '[boundry.top]\nkind = "insulated"')
    with pytest.raises(InputError, match=r"press\.colour = 'red': unknown key; remove it"):
        parse_press(PANEL + '[press]\ncolour = "red"')


def test_the_keys_of_a_table_are_found_by_its_place_through_lists_and_names():
    assert "channels" in fields_at(Config, ["press", "0", "logger", "1"])
    assert "rate_hz" in fields_at(Config, ["press", "0"])
    assert "keep_idle_days" in fields_at(Config, ["store"])


@pytest.mark.parametrize("read", [load_config, read_press, read_resin, read_model, read_calibrations])
def test_of_a_file_without_end_only_a_bounded_piece_is_read(tmp_path, read):
    path = tmp_path / "wrong.toml"
    path.write_text(PANEL + "# " + LARGEST_BYTES * "x")
    with pytest.raises(InputError, match=r"wrong.toml: .*File too large"):
        read(path)


def test_what_libraries_and_system_say_stands_in_the_readers_language(tmp_path):
    def read(name, content):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError) as refused:
            read_run(tmp_path / name)
        return words(spoken(refused.value), "de")

    head = b"time_s,platen_top,remark\n"
    assert "Ein Anführungszeichen ist nicht geschlossen" in read("open.csv", head + b'0,20.0,"x\n')
    assert "folgt Text" in read("after.csv", head + b'0,20.0,"x"y\n')
    assert "ihr Ende ist nicht das einer Parquet-Datei" in read("cut.parquet", b"PAR1" + b"x" * 100)
    assert "ihr Ende ist nicht das einer Parquet-Datei" in read("short.parquet", b"PAR1")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    for error in (ConnectionResetError(104, "Connection reset by peer"), TimeoutError("timed out")):
        assert isinstance(reason_of(error), Message)
    with pytest.raises(ConnectionRefusedError) as refused:
        socket.create_connection(("127.0.0.1", port), 5)
    assert reason_of(refused.value) == Message("system-connection-refused", {})
    (tmp_path / "none.sqlite").write_bytes(b"no database at all" * 300)
    opened = closing(sqlite3.connect(tmp_path / "none.sqlite"))
    with opened as connection, pytest.raises(sqlite3.DatabaseError) as damaged:
        connection.execute("SELECT * FROM sqlite_master").fetchall()
    assert reason_of(damaged.value) == Message("database-none", {})
