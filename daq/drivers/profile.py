"""What is known of a device, as data: the profile files and their vocabulary.

A profile says where the values stand, how they are written, what the device answers instead of a
value, and how long it takes. ``marks`` gives the confidence of each part: A vendor page or several
independent drivers, B one source, C not established. What is C has no default: the profile leaves
it out and the logger's settings must give it (``scaling``, ``baud``, ``override``).
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from daq.drivers.settings import LoggerSettings
from daq.records import InputError, Quality
from daq.tables import at, explained, load_toml, nearest
from daq.words import Message, say

Format = Literal["s16", "u16", "s32", "u32", "f32"]
Order = Literal["big", "little"]
REGISTERS: Mapping[str, int] = {"s16": 1, "u16": 1, "s32": 2, "u32": 2, "f32": 2}
"""Registers a value takes in each format."""


class _ProfileTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


TCP_PORT = 502
"""Of a Modbus device on a network, registered with IANA (MODBUS Messaging on TCP/IP, section 4.2)."""


class SerialLine(_ProfileTable):
    """Factory setting of the port."""

    baud: int
    parity: Literal["N", "E", "O"] = "N"
    stop_bits: Literal[1, 2] = 1
    data_bits: Literal[7, 8] = 8
    xonxoff: bool = False


class Timing(_ProfileTable):
    """How fast the device is."""

    response_s: float = Field(gt=0)
    """Worst time from request to complete reply, wire included."""
    drain_s: float | None = Field(default=None, gt=0)
    """Silence after a fault where less than the worst response time is enough, because the reply
    itself names the request it answers; None: the worst response time."""
    refresh_s: float = Field(gt=0)
    """Time in which every input is converted once."""
    age_s: float = Field(default=0.0, ge=0)
    """How old values are on average when the device is asked: half of `refresh_s` where it converts by itself,
    one input after the other; 0 where it converts at the request, or where nobody has established it."""
    turnaround_s: float = Field(default=0.005, ge=0)
    """Silence the bus keeps between a reply and the next request."""
    setup_s: float = Field(default=0.0, ge=0)
    """Pause after each set-up write or command."""
    stale_after_s: float = Field(default=30.0, gt=0)
    """All inputs unchanged for so long: the converter has stopped."""


class Block(_ProfileTable):
    """The one Modbus read that fetches all values."""

    function: Literal[1, 2, 3, 4]
    """3, 4: registers; 1, 2: bits, such as a limit switch on a digital input, each a value of 0 or 1."""
    address: int = Field(ge=0, le=65535)
    """Zero-based, as on the wire."""
    count: int = Field(ge=1, le=125)
    alternate: Literal[3, 4] | None = None
    """The other function that reads the same registers: used in turn, it shows a reply that comes
    later than any drain from the reply to the next request."""


class Field16(_ProfileTable):
    """Values in the block: the first stands at register ``at``, the next ``stride`` further."""

    at: int = Field(default=0, ge=0)
    format: Format
    word_order: Order = "big"
    byte_order: Order = "big"
    stride: int | None = Field(default=None, ge=1)
    unit: Literal["C", "K", "F", "uV", "mV"] = "C"

    @property
    def step(self) -> int:
        """Registers from one value to the next."""
        return self.stride or REGISTERS[self.format]


class Scaling(_ProfileTable):
    """Physical value = raw x scale + offset; or a full-scale code and what it stands for."""

    scale: float | None = None
    offset: float = 0.0
    full_code: float | None = None
    full_value: float | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Scaling:
        by_code = self.full_code is not None and self.full_value is not None
        if (self.scale is None) == (not by_code):
            raise ValueError(say("profile-scale-or-code"))
        return self

    @property
    def factor(self) -> float:
        """Physical units of one count."""
        if self.scale is not None:
            return self.scale
        return (self.full_value or 0.0) / (self.full_code or 1.0)


class ErrorValue(_ProfileTable):
    """A raw value that is no measurement."""

    raw: float
    quality: Quality
    with_status: bool = False
    """Believe it only when the status says so too, because the code is also a possible value."""


class StatusBits(_ProfileTable):
    """A second read, of one bit an input."""

    function: Literal[1, 2]
    address: int = Field(ge=0, le=65535)
    quality: Quality | Literal["range"] = Quality.OPEN
    """``range``: out of range, over or under as the value stands; open where it stands inside."""


class StatusCodes(_ProfileTable):
    """A register an input, inside the block."""

    at: int = Field(ge=0)
    codes: dict[str, Quality]
    """Register value, as text, to what it means; 0 is good unless listed."""


class ColdJunction(_ProfileTable):
    """Where the terminal temperature of a device that reports voltages comes from."""

    kind: Literal["setting", "implied"]
    """``implied``: the median of what the device's own temperatures and voltages imply."""
    temperatures: Field16 | None = None
    scale: float = 1.0


class Check(_ProfileTable):
    """A read at set-up whose answer must be as expected, else the device is not what we think."""

    what: str
    function: Literal[1, 2, 3, 4]
    address: int
    count: int = 1
    expect: tuple[int, ...]
    """One value for all, or one each."""


class Write(_ProfileTable):
    """A write at set-up; ``stride`` repeats it for every input in use."""

    what: str
    address: int
    format: Format
    value: float
    stride: int | None = None


class Ascii(_ProfileTable):
    """ADAM and DCON modules: ``#AA`` and what answers it."""

    width: int = 7
    """Characters of one value."""
    status: Literal["B"] | None = "B"
    """``$AAB`` reports open or out-of-range inputs as bits."""
    name: str | None = None
    """What ``$AAM`` must contain."""


class Scpi(_ProfileTable):
    """Instruments of the 34970A family."""

    first_channel: int = 101
    """Slot and channel of input 0; the others follow."""
    thermocouple: Literal["B", "E", "J", "K", "N", "R", "S", "T"] = "K"
    line_cycles: float = Field(default=1.0, gt=0)
    model: str
    """What ``*IDN?`` must contain."""


class Limits(_ProfileTable):
    """What the device can measure. [°C]"""

    lower_C: float = -270.0  # noqa: N815
    upper_C: float = 1372.0  # noqa: N815
    clips: bool = False
    """Outside, the device goes on showing the end itself: a value there is none."""


class Profile(_ProfileTable):
    """A device."""

    name: str
    title: str
    protocol: Literal["modbus", "dcon", "scpi", "sr630"]
    inputs: int = Field(ge=1, le=125)
    marks: dict[str, Literal["A", "A-", "B", "C"]] = Field(default_factory=dict)
    sources: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    address: Annotated[int | None, Field(ge=0, le=255)] = None
    """Factory address; None: the settings must say."""
    tcp_port: int = TCP_PORT
    serial: SerialLine | None = None
    timing: Timing
    block: Block | None = None
    values: Field16 | None = None
    scaling: str | None = None
    """Which of ``scalings`` holds unless the settings name one; None: they must."""
    scalings: dict[str, Scaling] = Field(default_factory=dict)
    errors: tuple[ErrorValue, ...] = ()
    status_bits: StatusBits | None = None
    status_codes: StatusCodes | None = None
    cold_junction: ColdJunction | None = None
    checks: tuple[Check, ...] = ()
    writes: tuple[Write, ...] = ()
    limits: Limits = Limits()
    ascii: Ascii | None = None
    scpi: Scpi | None = None

    @model_validator(mode="after")
    def _complete(self) -> Profile:
        needed = {"modbus": ("block", "values"), "dcon": ("ascii",), "scpi": ("scpi",), "sr630": ()}
        if missing := [key for key in needed[self.protocol] if getattr(self, key) is None]:
            raise ValueError(say("profile-needs-tables", protocol=self.protocol, tables=tuple(missing)))
        if self.block and self.values:
            end = self.values.at + (self.inputs - 1) * self.values.step + REGISTERS[self.values.format]
            if end > self.block.count:
                raise ValueError(say("profile-block-short", count=self.block.count, inputs=self.inputs, end=end))
        if self.block and self.values and self.block.function in (1, 2) and REGISTERS[self.values.format] > 1:
            raise ValueError(say("profile-bits-wide", format=self.values.format))
        other = [(say("profile-check", what=repr(x.what)), x.function, x.count) for x in self.checks]
        other += (
            [(say("plain-text", text="status_bits"), self.status_bits.function, self.inputs)]
            if self.status_bits
            else []
        )
        for what, function, count in other:
            if self.block and _shape(function, count) == _shape(self.block.function, self.block.count):
                raise ValueError(say("profile-same-shape", what=what))
        return self


def _shape(function: int, count: int) -> tuple[int, int]:
    """Return how a reply begins: its function and how many bytes follow."""
    return function, (count + 7) // 8 if function in (1, 2) else 2 * count


def profile_names() -> tuple[str, ...]:
    """Return the profiles that come with the package."""
    folder = resources.files("daq.drivers") / "profiles"
    return tuple(
        sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))
    )


def profile_table(name: str) -> dict[str, Any]:
    """Return a profile file as it stands: one of the package's by name, or a user's by path."""
    own = name.endswith(".toml")
    path = Path(name) if own else Path(str(resources.files("daq.drivers") / "profiles" / f"{name}.toml"))
    if not path.exists():
        meant, known = nearest(name, profile_names()) or "", profile_names()
        problem = say("profile-unknown-meant", meant=meant) if meant else say("profile-unknown", known=known)
        raise InputError(at(name, problem))
    return load_toml(path, say("file-of-profile"))


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return `table` with `changes` laid over it, table by table.

    >>> merged({"a": {"b": 1, "c": 2}}, {"a": {"c": 3}})
    {'a': {'b': 1, 'c': 3}}
    """
    result = dict(table)
    for key, value in changes.items():
        old = result.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        result[key] = merged(old, value) if both else value  # type: ignore[arg-type]
    return result


def check_profile(table: Mapping[str, Any], where: Message | str) -> Profile:
    """Validate a profile table, or raise InputError with one line."""
    try:
        return Profile.model_validate(dict(table))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        missing = first["type"] == "missing"
        problem = say("profile-not-established", key=key) if missing else explained(error, Profile)
        raise InputError(at(where, problem)) from None


def profile_for(settings: LoggerSettings) -> Profile:
    """Return the profile of one logger: the file, with the settings' overrides laid over it."""
    where = say("logger-of-profile", logger=settings.name, profile=settings.profile)
    profile = check_profile(merged(profile_table(settings.profile), settings.override), where)
    if len(settings.channels) > profile.inputs:
        problem = say("logger-too-many-channels", channels=len(settings.channels), inputs=profile.inputs)
        raise InputError(at(where, problem))
    chosen = settings.scaling or profile.scaling
    if profile.protocol == "modbus" and chosen not in profile.scalings:
        given = "yes" if chosen else "no"
        raise InputError(
            at(where, say("logger-scaling", given=given, scaling=chosen or "", known=tuple(profile.scalings)))
        )
    wired = settings.port is not None and not settings.port.startswith("socket://")
    if wired and not (settings.baud or profile.serial):
        raise InputError(say("logger-needs-baud", logger=settings.name))
    needs_address = profile.protocol in ("modbus", "dcon")
    if needs_address and settings.address is None and profile.address is None:
        raise InputError(at(where, say("logger-needs-address")))
    cold = profile.cold_junction
    if cold and cold.kind == "setting" and settings.cold_junction_C is None:
        raise InputError(at(where, say("logger-needs-cold-junction")))
    return profile
