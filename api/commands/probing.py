"""`probe`: what is at the end of this wire, and the settings table that reads it."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.commands.calling import taking
from api.outputs import WorkFailed, in_words, write_line
from daq.records import InputError
from daq.words import say, spoken

if TYPE_CHECKING:
    from daq.drivers.probe import ProbeReport
    from daq.words import Message

SHOWN_ATTEMPTS = 6
"""Of what was tried, and of what registers may mean, so much that all stands on one screen."""
SHOWN_READINGS = 8
"""See `SHOWN_ATTEMPTS`."""


@dataclass(frozen=True)
class ProbeOptions:
    """What `probe` is called with."""

    port: Annotated[str | None, typer.Option(metavar="PORT", help="help-serial-port")] = None
    host: Annotated[str | None, typer.Option(metavar="ADDRESS", help="help-device-host")] = None
    baud: Annotated[int | None, typer.Option(min=300, metavar="N", help="help-baud")] = None
    tcp_port: Annotated[
        int | None, typer.Option("--tcp-port", min=1, max=65535, metavar="N", help="help-tcp-port")
    ] = None
    transport: Annotated[str | None, typer.Option(metavar="rtu|tcp|rtu_over_tcp", help="help-transport")] = None
    stations: Annotated[str, typer.Option(metavar="LIST", help="help-stations")] = "1"
    timeout: Annotated[float | None, typer.Option(min=0.05, max=10.0, metavar="SECONDS", help="help-timeout")] = (
        None
    )


@taking(ProbeOptions)
def probe(options: ProbeOptions) -> None:
    """Find out what logger is on a wire, with the sensors at room temperature.

    No device at hand? "python -m daq.simulated.devices_serve adam-4118" puts a simulated one on a wire to try.
    """
    if (options.port is None) == (options.host is None):
        raise InputError(say("probe-needs-place"))
    given = {
        "port": options.port,
        "host": options.host,
        "tcp_port": options.tcp_port,
        "transport": options.transport,
    }
    wire = {key: value for key, value in given.items() if value is not None}
    from daq.drivers import probe as probing
    from daq.drivers.protocol import ReadFailure

    if options.port is not None:
        wire["baud"] = options.baud or probing.BAUD
    wait_s = options.timeout or probing.TIMEOUT_S
    try:
        report = probing.probe(wire, stations=_stations(options.stations), timeout_s=wait_s, progress=_show)
    except ReadFailure as error:
        raise WorkFailed(spoken(error)) from error
    for line in _lines(report):
        write_line(line)
    if not report.proposals:
        raise WorkFailed(say("terminal-probe-nothing-known", place=report.place))


def _show(line: Message) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(in_words(line) + "\n")


def _stations(text: str) -> list[int]:
    found: list[int] = []
    for part in filter(None, (p.strip() for p in text.split(","))):
        first, _, last = part.partition("-")
        if not all(re.fullmatch(r"[0-9]{1,3}", number) for number in (first, last or first)):
            raise InputError(say("terminal-stations-no-numbers", text=text))
        found += range(int(first), int(last or first) + 1)
    if not found or max(found) > 255:
        raise InputError(say("terminal-stations-out-of-range", text=text))
    return found


def _lines(report: ProbeReport) -> Iterable[str]:
    answers = say("terminal-probe-answers", place=report.place, stations=tuple(map(str, report.stations)))
    yield in_words(answers if report.stations else say("terminal-probe-answers-none", place=report.place))
    for block in report.registers:
        place = {"station": block.station, "function": block.function}
        yield f"  {in_words(say('terminal-probe-registers', **place))}"
        for reading in block.interpretations[:SHOWN_READINGS]:
            values = " ".join(f"{v:.5g}" for v in reading.values)
            percent = f"{100 * reading.plausible:.0f}"
            line = say("terminal-probe-reading", meaning=reading.meaning, percent=percent, values=values)
            yield f"    {in_words(line)}"
    for attempt in report.attempts[:SHOWN_ATTEMPTS]:
        values = " ".join(f"{v:.1f}" for v in attempt.values[:8])
        tried = [attempt.profile, attempt.scaling, None if attempt.station is None else f"#{attempt.station}"]
        shown = f" ({values} °C)" if values else ""
        yield f"  {', '.join(filter(None, tried))}: {in_words(attempt.outcome)}{shown}"
    for proposal in report.proposals:
        yield ""
        if proposal.ambiguous_with:
            yield f"# {in_words(say('terminal-probe-reads-as-well', profiles=tuple(proposal.ambiguous_with)))}"
        yield f"# {in_words(say('terminal-probe-for-configuration'))}"
        yield "[[press.logger]]"
        yield from _toml(proposal.settings)


def _toml(table: Mapping[str, Any]) -> Iterable[str]:
    from daq.files.run_file import toml_line

    for key, value in table.items():
        yield toml_line(key, value)
