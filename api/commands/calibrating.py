"""`calibrate`: hold every channel against the room, and find the channel that a warm hand holds."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.inputs import ConfigFile, config_path
from api.outputs import WorkFailed
from daq.records import InputError

if TYPE_CHECKING:
    from daq.config import PressSettings
    from daq.drivers import DataLogger, LoggerSettings
    from daq.drivers.commissioning import RoomCheck, Warmed
    from daq.records import Channel, Reading

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

    loaded = load_config(config_path(config))
    benches = [bench for press in loaded.press for bench in _benches(press)]
    if write and not any(bench.settings.calibration for bench in benches):
        raise InputError(
            f"calibrate --write: no logger of {loaded.path} has a calibration file; "
            f'give one the name of a file to make, such as calibration = "{benches[0].settings.name}.toml"'
        )
    if room is not None:
        _room(benches, room, period_s, write=write)
    else:
        _warm(benches, wait_s, period_s)


@dataclass(frozen=True)
class _Bench:
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
            raise WorkFailed(str(failure)) from failure
        kept = [k for k, channel in enumerate(logger.channels) if channel.name not in self.wires]
        parts = [
            replace(r, values=tuple(r.values[k] for k in kept), qualities=tuple(r.qualities[k] for k in kept))
            for r in readings
        ]
        return [logger.channels[k] for k in kept], parts


def _benches(press: PressSettings) -> list[_Bench]:
    from daq.config import press_of
    from daq.press_wires import Wires

    wires = frozenset(Wires(press_of(press).press).columns)
    return [_Bench(logger, wires) for logger in press.logger if not wires.issuperset(logger.columns)]


def _room(benches: list[_Bench], reference: float, period_s: float, *, write: bool) -> None:
    from daq.drivers.commissioning import check_at_room_temperature

    checks = []
    with _opened(benches) as opened:
        for bench, logger in opened:
            found = check_at_room_temperature(*bench.read(logger, period_s), reference)
            checks.append(found)
            for check in found:
                sys.stdout.write(_line(check) + "\n")
    if write:
        for bench, found in zip(benches, checks, strict=True):
            _write(bench.settings, found, reference)
    bad = [f"{c.channel} {c.verdict}" for found in checks for c in found if c.verdict != "ok"]
    if bad:
        raise WorkFailed(f"{len(bad)} of {sum(map(len, checks))} channels fail: {', '.join(bad)}")


def _line(check: RoomCheck) -> str:
    if check.verdict == "no value":
        return f"{check.channel:14} no value ({check.quality})"
    return (
        f"{check.channel:14} {check.mean_celsius:7.2f} °C, {check.deviation_kelvin:+6.2f} K off, "
        f"noise {check.noise_kelvin:.2f} K: {check.verdict}"
    )


def _write(settings: LoggerSettings, checks: tuple[RoomCheck, ...], reference: float) -> None:
    """Add what still remains to the correction in force, so that the file says the whole of it."""
    from daq.drivers.calibration import append_calibrations, in_force, read_calibrations
    from daq.drivers.commissioning import offsets_from_room

    path = settings.calibration
    if path is None:
        name = settings.name
        sys.stdout.write(f'{name}: offsets not kept; give it the name of a file, calibration = "{name}.toml"\n')
        return
    today = datetime.now(UTC).date()
    history = read_calibrations(path) if path.exists() else ()
    entries = []
    for entry in offsets_from_room(checks, today, f"room at {reference:g} °C"):
        old = in_force(history, entry.channel, today)
        gain, offset = (old.gain, old.offset_K) if old else (1.0, 0.0)
        entries.append(entry.model_copy(update={"gain": gain, "offset_K": round(offset + entry.offset_K, 3)}))
    append_calibrations(path, entries)
    sys.stdout.write(f"{path}: {len(entries)} entries of {today} added\n")


def _warm(benches: list[_Bench], wait_s: float | None, period_s: float) -> None:
    from daq.drivers.commissioning import warmed_channel

    with _opened(benches) as opened:
        before = [bench.read(logger, period_s)[1] for bench, logger in opened]
        sys.stdout.write("Hold one thermocouple between two fingers now.\n")
        sys.stdout.flush()
        if wait_s is None:
            typer.prompt("Press Enter after some ten seconds", default="", show_default=False)
        else:
            time.sleep(wait_s)
        found = []
        for (bench, logger), earlier in zip(opened, before, strict=True):
            channels, later = bench.read(logger, period_s)
            found.append((bench.settings, warmed_channel(channels, earlier, later)))
    clear = [(settings, warmed) for settings, warmed in found if warmed.channel is not None]
    if len(clear) != 1:
        rises = ", ".join(f"{s.name}: {_rises(w)}" for s, w in found)
        raise WorkFailed(f"no single channel rose clearly ({rises}); hold one junction longer, alone")
    settings, warmed = clear[0]
    sys.stdout.write(f"{warmed.channel} ({settings.name}) rose by {warmed.rise_kelvin:.1f} K\n")


def _rises(warmed: Warmed) -> str:
    return f"largest {warmed.rise_kelvin:.1f} K, next {warmed.next_rise_kelvin:.1f} K"


@contextmanager
def _opened(benches: list[_Bench]) -> Iterator[list[tuple[_Bench, DataLogger]]]:
    from daq.drivers import open_logger

    opened: list[tuple[_Bench, DataLogger]] = []
    try:
        for bench in benches:
            opened.append((bench, open_logger(bench.settings)))
        yield opened
    finally:
        for _, logger in opened:
            logger.close()
