"""`calibrate`: hold every channel against the room, and find the channel that a warm hand holds."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.inputs import ConfigFile, config_path
from api.outputs import WorkFailed, in_words, write_line
from daq.records import InputError
from daq.words import Message, say, spoken

if TYPE_CHECKING:
    from daq.drivers import DataLogger, LoggerSettings
    from daq.drivers.commissioning import RoomCheck, Warmed
    from daq.process.config import PressSettings
    from daq.records import Channel, Reading

READINGS = 10
"""Whose mean is taken: noise counts for a third of that of one."""


def calibrate(
    config: ConfigFile = None,
    room: Annotated[float | None, typer.Option(min=0.0, max=60.0, metavar="CELSIUS", help="help-room")] = None,
    warm: Annotated[bool, typer.Option("--warm", help="help-warm")] = False,
    write: Annotated[bool, typer.Option("--write", help="help-calibrate-write")] = False,
    wait_s: Annotated[float | None, typer.Option("--wait", min=0.0, metavar="SECONDS", help="help-wait")] = None,
    period_s: Annotated[float, typer.Option("--period", min=0.0, metavar="SECONDS", help="help-period")] = 1.0,
) -> None:
    """Check calibration at room temperature (--room) or channels for swaps (--warm); stop `record` first."""
    if (room is None) == (not warm):
        raise InputError(say("terminal-calibrate-needs-mode"))
    if write and room is None:
        raise InputError(say("terminal-calibrate-write-needs-room"))
    from daq.process.config import load_config

    loaded = load_config(config_path(config))
    loggers = [one for press in loaded.press for one in _loggers_of(press)]
    if write and not any(one.settings.calibration for one in loggers):
        first = loggers[0].settings.name
        raise InputError(say("terminal-calibrate-no-file", config=str(loaded.path), logger=first))
    if room is not None:
        _room(loggers, room, period_s, write=write)
    else:
        _warm(loggers, wait_s, period_s)


@dataclass(frozen=True)
class _Calibrated:
    """A logger with sensors to hold against a thermometer."""

    settings: LoggerSettings
    wires: frozenset[str]
    """Columns that are no temperatures: limit switch, pressure."""

    def read(self, logger: DataLogger, period_s: float) -> tuple[list[Channel], list[Reading]]:
        """Return its temperature channels and some readings of them."""
        from daq.drivers import ReadFailure
        from daq.drivers.commissioning import collect

        try:
            readings = collect(logger, READINGS, period_s=period_s)
        except ReadFailure as failure:
            raise WorkFailed(spoken(failure)) from failure
        kept = [k for k, channel in enumerate(logger.channels) if channel.name not in self.wires]
        parts = [
            replace(r, values=tuple(r.values[k] for k in kept), qualities=tuple(r.qualities[k] for k in kept))
            for r in readings
        ]
        return [logger.channels[k] for k in kept], parts


def _loggers_of(press: PressSettings) -> list[_Calibrated]:
    from daq.press.wires import Wires
    from daq.process.config import press_of

    wires = frozenset(Wires(press_of(press).press).columns)
    return [_Calibrated(logger, wires) for logger in press.logger if not wires.issuperset(logger.columns)]


def _room(loggers: list[_Calibrated], reference: float, period_s: float, *, write: bool) -> None:
    from daq.drivers.commissioning import RoomVerdict, check_at_room_temperature

    checks = []
    with _opened(loggers) as opened:
        for one, logger in opened:
            found = check_at_room_temperature(*one.read(logger, period_s), reference)
            checks.append(found)
            for check in found:
                write_line(_line(check))
    if write:
        for one, found in zip(loggers, checks, strict=True):
            _write(one.settings, found, reference)
    bad = [
        say("terminal-channel-verdict", channel=c.channel, verdict=c.verdict.message)
        for found in checks
        for c in found
        if c.verdict is not RoomVerdict.OK
    ]
    if bad:
        raise WorkFailed(say("terminal-channels-fail", bad=len(bad), all=sum(map(len, checks)), names=tuple(bad)))


def _line(check: RoomCheck) -> Message:
    from daq.drivers.commissioning import RoomVerdict

    name, verdict = f"{check.channel:14}", check.verdict.message
    if check.verdict is RoomVerdict.NO_VALUE:
        return say(
            "terminal-room-no-value",
            channel=name,
            verdict=verdict,
            quality=Message(f"page-quality-{check.quality}"),
        )
    off = check.deviation_kelvin
    return say(
        "terminal-room-check",
        channel=name,
        mean=check.mean_celsius,
        deviation=say("kelvin-signed", sign="−" if off < 0 else "+", kelvin=abs(off)),
        noise=check.noise_kelvin,
        verdict=verdict,
    )


def _write(settings: LoggerSettings, checks: tuple[RoomCheck, ...], reference: float) -> None:
    """Add what still remains to the correction in force, so that the file says the whole of it."""
    from daq.drivers.calibration import append_calibrations, in_force, read_calibrations
    from daq.drivers.commissioning import offsets_from_room

    path = settings.calibration
    if path is None:
        write_line(say("terminal-calibrate-not-kept", logger=settings.name))
        return
    today = datetime.now(UTC).date()
    history = read_calibrations(path) if path.exists() else ()
    entries = []
    for entry in offsets_from_room(checks, today, f"room at {reference:g} °C"):
        old = in_force(history, entry.channel, today)
        gain, offset = (old.gain, old.offset_K) if old else (1.0, 0.0)
        entries.append(entry.model_copy(update={"gain": gain, "offset_K": round(offset + entry.offset_K, 3)}))
    append_calibrations(path, entries)
    write_line(say("terminal-calibrate-added", path=str(path), entries=len(entries), day=str(today)))


def _warm(loggers: list[_Calibrated], wait_s: float | None, period_s: float) -> None:
    from daq.drivers.commissioning import warmed_channel

    with _opened(loggers) as opened:
        before = [one.read(logger, period_s)[1] for one, logger in opened]
        write_line(say("terminal-hold-one-now"))
        if wait_s is None:
            typer.prompt(in_words(say("terminal-press-enter")), default="", show_default=False)
        else:
            time.sleep(wait_s)
        found = []
        for (one, logger), earlier in zip(opened, before, strict=True):
            channels, later = one.read(logger, period_s)
            found.append((one.settings, warmed_channel(channels, earlier, later)))
    clear = [(settings, warmed) for settings, warmed in found if warmed.channel is not None]
    if len(clear) != 1:
        raise WorkFailed(say("terminal-no-channel-rose", rises=tuple(_rise(s, w) for s, w in found)))
    settings, warmed = clear[0]
    write_line(say("terminal-rose", channel=str(warmed.channel), logger=settings.name, rise=warmed.rise_kelvin))


def _rise(settings: LoggerSettings, warmed: Warmed) -> Message:
    rises = {"rise": warmed.rise_kelvin, "next": warmed.next_rise_kelvin}
    return say("terminal-rise", logger=settings.name, **rises)


@contextmanager
def _opened(loggers: list[_Calibrated]) -> Iterator[list[tuple[_Calibrated, DataLogger]]]:
    from daq.drivers import open_logger

    opened: list[tuple[_Calibrated, DataLogger]] = []
    try:
        for one in loggers:
            opened.append((one, open_logger(one.settings)))
        yield opened
    finally:
        for _, logger in opened:
            logger.close()
