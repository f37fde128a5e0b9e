"""`calibrate`: hold every channel against the room, and find the channel that a warm hand holds."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.inputs import ConfigFile, config_path
from api.outputs import WorkFailed
from daq.records import InputError

if TYPE_CHECKING:
    from daq.drivers import DataLogger, LoggerSettings
    from daq.drivers.commissioning import RoomCheck, Warmed
    from daq.records import Reading

READINGS = 10


def calibrate(
    config: ConfigFile = None,
    room: Annotated[
        float | None, typer.Option(min=0.0, max=60.0, help="What the thermometer beside the sensors says. [°C]")
    ] = None,
    warm: Annotated[bool, typer.Option("--warm", help="Find the thermocouple you warm by hand.")] = False,
    write: Annotated[
        bool, typer.Option("--write", help="Add the offsets found to each logger's calibration file.")
    ] = False,
    wait_s: Annotated[
        float | None, typer.Option("--wait", min=0.0, help="Time to warm it; without, Enter ends it. [s]")
    ] = None,
    period_s: Annotated[float, typer.Option("--period", min=0.0, help="Between two readings. [s]")] = 1.0,
) -> None:
    """Check calibration at room temperature (--room) or channels for swaps (--warm); stop `record` first."""
    if (room is None) == (not warm):
        raise InputError("calibrate: give either --room with the thermometer's reading or --warm")
    if write and room is None:
        raise InputError("calibrate: --write needs --room")
    from daq.config import load_config

    loggers = [one for press in load_config(config_path(config)).press for one in press.logger]
    if write and (without := [one.name for one in loggers if one.calibration is None]):
        raise InputError(
            f"calibrate --write: logger {without[0]} has no calibration file; give it one in the configuration"
        )
    if room is not None:
        _room(loggers, room, period_s, write=write)
    else:
        _warm(loggers, wait_s, period_s)


def _room(loggers: list[LoggerSettings], reference: float, period_s: float, *, write: bool) -> None:
    from daq.drivers.commissioning import check_at_room_temperature

    checks = {}
    with _opened(loggers) as opened:
        for settings, logger in opened:
            found = check_at_room_temperature(logger.channels, _readings(logger, period_s), reference)
            checks[settings.name] = found
            for check in found:
                sys.stdout.write(_line(check) + "\n")
    if write:
        _write(loggers, checks, reference)
    bad = [f"{c.channel} {c.verdict}" for found in checks.values() for c in found if c.verdict != "ok"]
    if bad:
        raise WorkFailed(f"{len(bad)} of {sum(map(len, checks.values()))} channels fail: {', '.join(bad)}")


def _line(check: RoomCheck) -> str:
    if check.verdict == "no value":
        return f"{check.channel:14} no value ({check.quality})"
    return (
        f"{check.channel:14} {check.mean_celsius:7.2f} °C, {check.deviation_kelvin:+6.2f} K off, "
        f"noise {check.noise_kelvin:.2f} K: {check.verdict}"
    )


def _write(loggers: list[LoggerSettings], checks: dict[str, tuple[RoomCheck, ...]], reference: float) -> None:
    """Add what still remains to the correction in force, so that the file says the whole of it."""
    from daq.drivers.calibration import append_calibrations, in_force, read_calibrations
    from daq.drivers.commissioning import offsets_from_room

    today = datetime.now(UTC).date()
    for settings in loggers:
        path = settings.calibration
        if path is None:
            continue
        history = read_calibrations(path) if path.exists() else ()
        entries = []
        for entry in offsets_from_room(checks[settings.name], today, f"room at {reference:g} °C"):
            old = in_force(history, entry.channel, today)
            gain, offset = (old.gain, old.offset_K) if old else (1.0, 0.0)
            entries.append(entry.model_copy(update={"gain": gain, "offset_K": round(offset + entry.offset_K, 3)}))
        append_calibrations(path, entries)
        sys.stdout.write(f"{path}: {len(entries)} entries of {today} added\n")


def _warm(loggers: list[LoggerSettings], wait_s: float | None, period_s: float) -> None:
    from daq.drivers.commissioning import warmed_channel

    with _opened(loggers) as opened:
        before = [_readings(logger, period_s) for _, logger in opened]
        sys.stdout.write("Hold one thermocouple between two fingers now.\n")
        sys.stdout.flush()
        if wait_s is None:
            typer.prompt("Press Enter after some ten seconds", default="", show_default=False)
        else:
            time.sleep(wait_s)
        found = [
            (settings, warmed_channel(logger.channels, earlier, _readings(logger, period_s)))
            for (settings, logger), earlier in zip(opened, before, strict=True)
        ]
    clear = [(settings, warmed) for settings, warmed in found if warmed.channel is not None]
    if len(clear) != 1:
        rises = ", ".join(f"{s.name}: {_rises(w)}" for s, w in found)
        raise WorkFailed(f"no single channel rose clearly ({rises}); hold one junction longer, alone")
    settings, warmed = clear[0]
    sys.stdout.write(f"{warmed.channel} ({settings.name}) rose by {warmed.rise_kelvin:.1f} K\n")


def _rises(warmed: Warmed) -> str:
    return f"largest {warmed.rise_kelvin:.1f} K, next {warmed.next_rise_kelvin:.1f} K"


def _readings(logger: DataLogger, period_s: float) -> tuple[Reading, ...]:
    from daq.drivers import ReadFailure
    from daq.drivers.commissioning import collect

    try:
        return collect(logger, READINGS, period_s=period_s)
    except ReadFailure as failure:
        raise WorkFailed(str(failure)) from failure


@contextmanager
def _opened(loggers: list[LoggerSettings]) -> Iterator[list[tuple[LoggerSettings, DataLogger]]]:
    from daq.drivers import open_logger

    opened: list[tuple[LoggerSettings, DataLogger]] = []
    try:
        for settings in loggers:
            present = settings.calibration is None or settings.calibration.exists()
            usable = settings if present else settings.model_copy(update={"calibration": None})
            opened.append((settings, open_logger(usable)))
        yield opened
    finally:
        for _, logger in opened:
            logger.close()
