"""`kerntemp calibrate` on simulated loggers that lie in a room."""

from __future__ import annotations

import contextlib
import itertools
from pathlib import Path

import pytest

from api.cli import main
from daq.drivers.calibration import read_calibrations
from daq.simulated.devices import simulated

PRESS_FILE = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"
ROOM_C = 21.0
READS_AT_REST = 1 + 10
"""Of one logger: the check at set-up, and the readings before the hand."""


@contextlib.contextmanager
def workshop(folder, temperatures):
    """A configuration with two loggers; yields its path."""
    with (
        simulated("exemys-rme1-tc", lambda now_s: temperatures(now_s)[:8], refresh_s=0) as first,
        simulated("exemys-rme1-tc", lambda now_s: temperatures(now_s)[8:], refresh_s=0) as second,
    ):
        tables = []
        for name, server, channels in (
            ("upper", first, ["platen_top", *(f"top_{k}" for k in range(1, 8))]),
            ("lower", second, ["platen_bottom", *(f"bottom_{k}" for k in range(1, 8))]),
        ):
            tables.append(
                f'[[press.logger]]\nname = "{name}"\nprofile = "exemys-rme1-tc"\nhost = "127.0.0.1"\n'
                f'tcp_port = {server.place["tcp_port"]}\nchannels = {channels}\ncalibration = "{name}.toml"\n'
            )
        path = folder / "kerntemp.toml"
        head = f'[store]\nurl = "store.sqlite"\n[[press]]\nname = "lab"\nfile = "{PRESS_FILE.as_posix()}"\n'
        path.write_text(head + "".join(tables).replace("'", '"'))
        yield path


def test_offsets_at_room_temperature_are_written_once_and_correct_the_next_check(tmp_path, capsys):
    with workshop(tmp_path, lambda now_s: [ROOM_C + 0.1 * k for k in range(16)]) as config:
        call = ["calibrate", "--config", str(config), "--room", str(ROOM_C), "--period", "0"]
        assert main([*call, "--write"]) == 0
        assert "bottom_7       22.50 °C, +1.50 K off" in capsys.readouterr().out
        assert {c.channel: c.offset_K for c in read_calibrations(tmp_path / "lower.toml")}["bottom_7"] == -1.5
        assert main(call) == 0
        assert "bottom_7       21.00 °C, +0.00 K off" in capsys.readouterr().out


def test_a_limit_switch_and_a_pressure_are_not_held_against_the_thermometer(tmp_path, capsys):
    with workshop(tmp_path, lambda now_s: [ROOM_C] * 14 + [0.0, 350.0]) as config:
        text = config.read_text().replace('"bottom_6", "bottom_7"', '"S7", "bar"')
        press = tmp_path / "lab.toml"
        wires = 'limit_switch = "S7"\npressure = { column = "bar", closed_above = 50.0 }\n'
        press.write_text(PRESS_FILE.read_text().replace("[press]\n", f"[press]\n{wires}"))
        config.write_text(text.replace(PRESS_FILE.as_posix(), press.as_posix()))
        call = ["calibrate", "--config", str(config), "--room", str(ROOM_C), "--period", "0", "--write"]
        assert main(call) == 0
    out = capsys.readouterr().out
    assert "S7" not in out
    assert "bar" not in out
    kept = {c.channel for c in read_calibrations(tmp_path / "lower.toml")}
    assert kept == {"platen_bottom", *(f"bottom_{k}" for k in range(1, 6))}


def test_offsets_are_kept_for_the_loggers_that_name_a_file_and_the_others_are_told(tmp_path, capsys):
    with workshop(tmp_path, lambda now_s: [ROOM_C + 0.5] * 16) as config:
        config.write_text(config.read_text().replace('calibration = "lower.toml"\n', ""))
        call = ["calibrate", "--config", str(config), "--room", str(ROOM_C), "--period", "0", "--write"]
        assert main(call) == 0
        out = capsys.readouterr().out
        assert 'lower: offsets not kept; give it the name of a file, calibration = "lower.toml"' in out
        assert len(read_calibrations(tmp_path / "upper.toml")) == 8
        config.write_text(config.read_text().replace('calibration = "upper.toml"\n', ""))
        assert main(call) == 2
        assert "no logger of" in capsys.readouterr().err


def test_a_calibration_file_may_be_named_before_it_is_made(tmp_path, capsys):
    with workshop(tmp_path, lambda now_s: [ROOM_C + 1.0] * 16) as config:
        config.write_text(config.read_text().replace('"upper.toml"', '"calibrations/upper.toml"'))
        assert main(["check", "--config", str(config)]) == 0
        out = capsys.readouterr().out
        assert "platen_top 22.0" in out
        assert "logger upper: values are not corrected, " in out
        assert main(["calibrate", "--config", str(config), "--room", str(ROOM_C), "--period", "0", "--write"]) == 0
        capsys.readouterr()
        assert main(["check", "--config", str(config)]) == 0
    out = capsys.readouterr().out
    assert "platen_top 21.0" in out
    assert "not corrected" not in out


def test_a_channel_too_far_off_is_named_and_not_calibrated_away(tmp_path, capsys):
    with workshop(tmp_path, lambda now_s: [ROOM_C] * 15 + [ROOM_C + 8.0]) as config:
        call = ["calibrate", "--config", str(config), "--room", str(ROOM_C), "--period", "0", "--write"]
        assert main(call) == 1
    assert "1 of 16 channels fail the check: bottom_7 off" in capsys.readouterr().err
    assert "bottom_7" not in (tmp_path / "lower.toml").read_text()


def test_the_thermocouple_warmed_by_hand_is_named_with_its_logger(tmp_path, capsys):
    asked = itertools.count()

    def temperatures(now_s):
        reads_of_both_loggers = next(asked)
        return (
            [ROOM_C] * 11 + [ROOM_C + (6.0 if reads_of_both_loggers > 2 * READS_AT_REST else 0.0)] + [ROOM_C] * 4
        )

    with workshop(tmp_path, temperatures) as config:
        call = ["calibrate", "--config", str(config), "--warm", "--period", "0", "--wait", "0"]
        assert main(call) == 0
    assert "bottom_3 (lower) rose by 6.0 K" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "either --room"),
        (["--warm", "--write"], "--write needs --room"),
        (["--room", "21", "--warm"], "either"),
    ],
)
def test_calls_that_say_nothing_clear_are_refused(tmp_path, capsys, arguments, message):
    assert main(["calibrate", *arguments]) == 2
    assert message in capsys.readouterr().err
