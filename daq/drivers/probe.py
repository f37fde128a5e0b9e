"""What is at the end of this wire? Registers under every plausible reading, and a profile for it.

Only reads, except where a profile's own set-up writes (LabJack, SCPI). At room temperature a right
reading gives every connected channel 5 to 45 °C, and a wrong one hardly ever does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from pydantic import ValidationError

from daq.drivers import modbus
from daq.drivers.bus import Bus, LineTiming
from daq.drivers.decode import raw_values
from daq.drivers.link import NEVER_OPENED, Place, SerialPlace, SocketPlace, socket_of
from daq.drivers.opening import open_logger
from daq.drivers.profile import (
    REGISTERS,
    TCP_PORT,
    Field16,
    Profile,
    Scaling,
    check_profile,
    profile_names,
    profile_table,
)
from daq.drivers.protocol import Cause, NoReply, ReadFailure
from daq.drivers.settings import LoggerSettings
from daq.records import ROOM_C, InputError, Quality
from daq.tables import explained
from daq.words import Message, say, spoken

# Numbers without another source were set by hand, 2026-11.

TIMEOUT_S = 0.3
"""Longest wait for a reply while it is looked what is on a wire: what slow profiles take. [s]"""
BAUD = 9600
"""Of a serial line of which nothing is stated: as most loggers leave the factory (the profiles)."""
ROOMS_C = (5.0, 45.0)
"""Where loggers are set up: from an unheated hall in winter to one beside a hot press in summer. [°C]"""
_DRAIN_S, _TURN_S = 0.3, 0.005
"""What comes late is awaited so long at most; between two requests a device gets the second. [s]"""
_ENOUGH = 0.5
"""Share of inputs that must read room temperature: some may have no thermocouple yet."""
_SCALINGS: Mapping[Message, tuple[str, Scaling]] = {
    say("registers-tenths"): ("s16", Scaling(scale=0.1)),
    say("registers-hundredths"): ("s16", Scaling(scale=0.01)),
    say("registers-whole-degrees"): ("s16", Scaling(scale=1.0)),
    say("registers-full-scale", full="7FFF", celsius=1370): ("s16", Scaling(full_code=32767, full_value=1370.0)),
    say("registers-full-scale", full="7FFF", celsius=1372): ("s16", Scaling(full_code=32767, full_value=1372.0)),
    say("registers-full-scale", full="FFFF", celsius=1370): ("u16", Scaling(full_code=65535, full_value=1370.0)),
    say("registers-float"): ("f32", Scaling(scale=1.0)),
}


@dataclass(frozen=True)
class Interpretation:
    """Registers read one way."""

    meaning: Message
    format: str
    word_order: str
    scale: float
    values: tuple[float, ...]
    """[°C]"""
    plausible: float
    """Share of values at room temperature."""


@dataclass(frozen=True)
class RegisterBlock:
    """What a station answered, and every way to read it, the most plausible first."""

    station: int
    function: int
    address: int
    words: tuple[int, ...]
    interpretations: tuple[Interpretation, ...]


@dataclass(frozen=True)
class Attempt:
    """One profile tried on the wire."""

    profile: str
    scaling: str | None
    station: int | None
    outcome: Message
    """That it fits, that it reads no room temperature, or why it failed."""
    fits: bool = False
    values: tuple[float, ...] = ()
    qualities: tuple[Quality, ...] = ()
    plausible: float = 0.0
    settings: Mapping[str, Any] = field(default_factory=dict)
    """The settings table that was tried, without channels and waits."""
    identified: int = 0
    """How many registers or replies confirmed what the device is: its name, or thermocouple types."""


@dataclass(frozen=True)
class Proposal:
    """A settings table for kerntemp.toml, its channels still to be named."""

    settings: Mapping[str, Any]
    ambiguous_with: tuple[Message | str, ...] = ()
    """Other profiles that read just as well: only the label on the device decides."""


@dataclass(frozen=True)
class ProbeReport:
    """All that was found."""

    place: str
    stations: tuple[int, ...]
    """That answered Modbus."""
    registers: tuple[RegisterBlock, ...]
    attempts: tuple[Attempt, ...]
    """Best first."""
    proposals: tuple[Proposal, ...] = ()
    """One for each device found."""


def probe(
    wire: Mapping[str, Any],
    *,
    stations: Iterable[int] = (1,),
    profiles: Iterable[str] | None = None,
    timeout_s: float = TIMEOUT_S,
    progress: Callable[[Message], None] = lambda line: None,
) -> ProbeReport:
    """Find out what is on a wire.

    Parameters
    ----------
    wire
        Settings keys that say where: ``port`` and ``baud``, or ``host`` and ``tcp_port``; also
        ``transport``, ``parity``, ``stop_bits``, ``local_echo`` where they differ from the usual.
    stations
        Addresses to try.
    profiles
        Which to try; None: all that come with the package.
    timeout_s
        Wait for each reply. [s]
    progress
        Called before each step with what is tried.

    Raises
    ------
    NoReply
        Where the serial port does not open: in use, not there, not permitted.
    """
    place = _place(wire)
    stations = tuple(stations)
    blocks, answering = _registers(wire, place, stations, timeout_s, progress)
    attempts: list[Attempt] = []
    for name in profiles or [n for n in profile_names() if n != "generic"]:
        progress(say("probe-tries-profile", profile=name))
        attempts += _tried(name, wire, answering, stations, timeout_s)
    attempts.sort(key=_rank, reverse=True)
    places: tuple[int | None, ...] = answering or (*stations, None)
    found = [_proposed(wire, station, attempts, blocks) for station in places]
    return ProbeReport(
        str(place), answering, tuple(blocks), tuple(attempts), tuple(p for p in found if p is not None)
    )


def interpretations(words: Sequence[int], room: tuple[float, float] = ROOMS_C) -> tuple[Interpretation, ...]:
    """Return every plausible way to read registers, the most plausible first.

    >>> best = interpretations((213, 208, 0x7FFF, 210))[0]
    >>> str(best.meaning), best.plausible
    ('tenths', 0.75)
    """
    found = []
    for meaning, (form, scaling) in _SCALINGS.items():
        for order in ("big", "little") if form == "f32" else ("big",):
            layout = Field16.model_validate({"format": form, "word_order": order})
            inputs = len(words) // REGISTERS[form]
            if not inputs:
                continue
            values = tuple(r * scaling.factor for r in raw_values(words, layout, inputs))
            share = sum(room[0] <= v <= room[1] for v in values) / inputs
            title = say("registers-low-word-first", meaning=meaning) if order == "little" else meaning
            found.append(Interpretation(title, form, order, scaling.factor, values, share))
    return tuple(sorted(found, key=lambda i: i.plausible, reverse=True))


def _place(wire: Mapping[str, Any]) -> Place:
    if wire.get("host"):
        return SocketPlace(str(wire["host"]), int(wire.get("tcp_port") or TCP_PORT))
    if not wire.get("port"):
        raise InputError(say("probe-needs-place"))
    if socket := socket_of(str(wire["port"])):
        return socket
    return SerialPlace(
        str(wire["port"]),
        int(wire.get("baud") or BAUD),
        str(wire.get("parity") or "N"),
        int(wire.get("stop_bits") or 1),
    )


def _is_tcp(wire: Mapping[str, Any]) -> bool:
    return bool(wire.get("host")) and wire.get("transport") in (None, "tcp")


def _registers(
    wire: Mapping[str, Any],
    place: Place,
    stations: tuple[int, ...],
    timeout_s: float,
    progress: Callable[[Message], None],
) -> tuple[list[RegisterBlock], tuple[int, ...]]:
    """Return the first registers of each station, and the stations that answered, be it with a refusal."""
    bus = Bus(place, numbered=_is_tcp(wire))
    timing = LineTiming(timeout_s, min(timeout_s, _DRAIN_S), _TURN_S)
    blocks, answering = [], set()
    try:
        for station in stations:
            for function in (3, 4):
                progress(say("probe-reads-registers", station=station, function=function))
                words = _words(bus, timing, station, function, local_echo=bool(wire.get("local_echo")))
                if words is not None:
                    answering.add(station)
                if words:
                    blocks.append(RegisterBlock(station, function, 0, words, interpretations(words)))
    finally:
        bus.close()
    return blocks, tuple(sorted(answering))


def _words(
    bus: Bus, timing: LineTiming, station: int, function: int, *, local_echo: bool
) -> tuple[int, ...] | None:
    """Return the first 16 registers, or 8, none where the station refuses; None where it does not answer."""
    for count in (16, 8):
        request = modbus.Request(function, 0, count)
        try:
            if bus.numbered:
                number = bus.next_transaction()
                frame, take = (
                    modbus.tcp_frame(number, station, request),
                    modbus.tcp_reply(number, station, request),
                )
            else:
                frame = modbus.rtu_frame(station, request)
                take = modbus.rtu_reply(station, request, local_echo=local_echo)
            return modbus.registers(bus.exchange(frame, take, timing).payload)
        except NoReply as failure:
            if failure.cause in NEVER_OPENED:
                raise  # no device is asked as long as the port does not open
            if failure.cause is Cause.REFUSED:
                continue
            return None
        except ReadFailure:
            return None
    return ()


def _tried(
    name: str,
    wire: Mapping[str, Any],
    answering: tuple[int, ...],
    stations: tuple[int, ...],
    timeout_s: float,
) -> list[Attempt]:
    profile = check_profile(profile_table(name), name)
    if profile.protocol == "modbus":
        return [
            _attempt(profile, wire, station, scaling, timeout_s)
            for station in answering
            for scaling in profile.scalings
        ]
    if answering or (_is_tcp(wire) and profile.protocol != "scpi"):
        return []
    if profile.protocol == "dcon":
        return [
            _attempt(profile, {**wire, "checksum": guarded}, station, None, timeout_s)
            for station in stations
            for guarded in (False, True)
        ]
    return [_attempt(profile, wire, None, None, max(timeout_s, 0.5))]


def _attempt(
    profile: Profile, wire: Mapping[str, Any], station: int | None, scaling: str | None, timeout_s: float
) -> Attempt:
    settings = _table(profile.name, wire, station, scaling)
    trial = {"channels": [f"input_{k}" for k in range(profile.inputs)], "timeout_s": timeout_s}
    try:
        logger = open_logger(
            LoggerSettings.model_validate(settings | trial | {"drain_s": min(timeout_s, _DRAIN_S)})
        )
    except ValidationError as error:
        raise InputError(say("at-place", place="probe", what=explained(error, LoggerSettings))) from None
    try:
        reading = logger.read()
    except ReadFailure as failure:
        why = say("at-place", place=failure.cause.message, what=spoken(failure))
        return Attempt(profile.name, scaling, station, why, settings=settings)
    finally:
        logger.close()
    low, high = ROOMS_C
    hits = sum(low <= v <= high for v, q in zip(reading.values, reading.qualities, strict=True) if q.usable)
    share = hits / profile.inputs
    fits = share >= _ENOUGH
    identified = sum(c.count for c in profile.checks) + (profile.protocol in ("scpi", "sr630"))
    return Attempt(
        profile.name,
        scaling,
        station,
        say("probe-fits") if fits else say("probe-not-at-room-temperature"),
        fits,
        reading.values,
        reading.qualities,
        share,
        settings=settings,
        identified=identified,
    )


def _table(name: str, wire: Mapping[str, Any], station: int | None, scaling: str | None) -> dict[str, Any]:
    title = name if station is None else f"{name} at {station}"
    table: dict[str, Any] = {"name": title, "profile": name} | dict(wire)
    if station is not None:
        table["address"] = station
    if scaling is not None:
        table["scaling"] = scaling
    if "port" in wire:
        table.setdefault("baud", BAUD)
    return table


def _rank(attempt: Attempt) -> tuple[bool, float, int]:
    return (attempt.fits, attempt.plausible, attempt.identified)


def _from_usual_room(attempt: Attempt) -> int:
    """Return how far the middle reading lies from the usual room: only orders readings that fit as well. [K]"""
    return round(abs(_middle(attempt) - ROOM_C))


def _middle(attempt: Attempt) -> float:
    return median(v for v, q in zip(attempt.values, attempt.qualities, strict=True) if q.usable)


def _differs(rival: Attempt, best: Attempt) -> bool:
    """Whether a rival is another profile, or reads other temperatures by another scaling."""
    return rival.profile != best.profile or abs(_middle(rival) - _middle(best)) > 1.0


def _proposed(
    wire: Mapping[str, Any],
    station: int | None,
    attempts: Sequence[Attempt],
    blocks: Sequence[RegisterBlock],
) -> Proposal | None:
    """Return what reads one station best, or a generic map of its registers."""
    fitting = [a for a in attempts if a.fits and a.station == station]
    if fitting:
        equal = [a for a in fitting if _rank(a) == _rank(fitting[0])]
        best = min(equal, key=_from_usual_room)
        rivals = [_called(a, best) for a in equal if _differs(a, best)]
        return Proposal(best.settings, tuple(dict.fromkeys(rivals)))
    for block in blocks:
        top = block.interpretations[0]
        if block.station == station and top.plausible >= _ENOUGH:
            return Proposal(_generic(wire, block, top))
    return None


def _called(rival: Attempt, best: Attempt) -> Message | str:
    """Return a rival by its profile, or by its scaling where that is all that differs."""
    if rival.profile != best.profile:
        return rival.profile
    return say("profile-with-scaling", profile=rival.profile, scaling=rival.scaling or "")


def _generic(wire: Mapping[str, Any], block: RegisterBlock, reading: Interpretation) -> dict[str, Any]:
    override = {
        "inputs": len(reading.values),
        "block": {"function": block.function, "address": block.address, "count": len(block.words)},
        "values": {"format": reading.format, "word_order": reading.word_order},
        "scalings": {"probed": {"scale": reading.scale}},
    }
    return _table("generic", wire, block.station, "probed") | {"override": override}
