"""How one logger is wired: the table ``[[press.logger]]`` of the service configuration."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from daq.words import say

Seconds = Annotated[float, Field(gt=0, le=600, allow_inf_nan=False)]


class LoggerSettings(BaseModel):
    """One module or instrument. Two modules on one wire are two tables that name the same port."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(min_length=1)
    """What messages and /health call it."""
    profile: str = Field(min_length=1)
    """A profile of ``daq/drivers/profiles`` (``adam-4118``) or the path of a user's own TOML file, relative to the
    configuration."""
    channels: tuple[str, ...] = Field(min_length=1)
    """Column names in the order of the inputs, from input 0; ``""`` leaves an input unused."""

    port: str | None = None
    """Serial port, ``/dev/serial/by-id/...``, ``COM5`` or a pyserial URL (``socket://host:port``)."""
    host: str | None = None
    tcp_port: int | None = Field(default=None, ge=1, le=65535)
    """None takes the profile's."""
    transport: Literal["rtu", "tcp", "rtu_over_tcp"] | None = None
    """Modbus framing. None: ``rtu`` on a port, ``tcp`` on a host."""
    address: int | None = Field(default=None, ge=0, le=255)
    """Station on the bus. None takes the profile's factory address, where one is established."""

    baud: int | None = Field(default=None, ge=300, le=3_000_000)
    parity: Literal["N", "E", "O"] | None = None
    stop_bits: Literal[1, 2] | None = None
    data_bits: Literal[7, 8] | None = None
    local_echo: bool = False
    """The converter repeats what we send (two-wire RS-485 without echo suppression)."""

    timeout_s: Seconds | None = None
    """Longest wait for a reply. None takes the profile's worst response time."""
    drain_s: Seconds | None = None
    """Silence kept after a fault, before the next request. None: as long as the timeout."""
    stale_after_s: Seconds | None = None
    """A module whose channels all stand still this long is called stale. None takes the profile's."""

    scaling: str | None = None
    """Name of one of the profile's scalings; needed where the profile establishes no default."""
    checksum: bool | None = None
    """ASCII modules: two hexadecimal digits guard every frame. Strongly recommended."""
    cold_junction_C: float | None = Field(default=None, ge=-40, le=100)  # noqa: N815
    """Cold junction of a device that reports bare voltages and no temperature of its own."""
    calibration: Path | None = None
    """File with dated offsets and gains, relative to the configuration (``daq.drivers.calibration``)."""
    simulated: bool = False
    """Mark every good value ``simulated``."""
    override: dict[str, Any] = Field(default_factory=dict)
    """Profile tables to change or complete, in the profile's own vocabulary."""

    @property
    def used(self) -> tuple[int, ...]:
        """The inputs that have a name."""
        return tuple(k for k, name in enumerate(self.channels) if name)

    @model_validator(mode="after")
    def _wired(self) -> LoggerSettings:
        if (self.port is None) == (self.host is None):
            raise ValueError(say("logger-port-or-host"))
        if self.tcp_port is not None and self.host is None:
            raise ValueError(say("logger-tcp-port-alone"))
        if self.port is not None and self.transport == "tcp":
            raise ValueError(say("logger-tcp-on-port"))
        if self.host is not None and self.transport == "rtu":
            raise ValueError(say("logger-rtu-on-host"))
        names = Counter(name for name in self.channels if name)
        if not names:
            raise ValueError(say("logger-no-channels"))
        if twice := [name for name, count in names.items() if count > 1]:
            raise ValueError(say("logger-channels-twice", names=tuple(twice)))
        return self

    def relative_to(self, folder: Path) -> LoggerSettings:
        """Return the same with its file names, relative to a folder, made absolute."""
        changes: dict[str, Any] = {}
        if self.profile.endswith(".toml"):
            changes["profile"] = str(folder / self.profile)
        if self.calibration is not None:
            changes["calibration"] = folder / self.calibration
        return self.model_copy(update=changes)

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns this logger fills, in the order of its inputs."""
        return tuple(name for name in self.channels if name)
