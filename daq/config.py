"""``kerntemp.toml``: what the services of one machine are told, checked at start, unknown keys refused.

::

    [store]
    url = "kerntemp.sqlite"                # a path, or postgresql://user@host/name

    [[press]]
    name = "lab"
    file = "presses/lab.toml"              # relative to this file
    rate_hz = 10.0
    header = { "panel.material" = "MDF", "panel.thickness_mm" = 16.0 }

    [[press.logger]]                       # see daq.drivers.settings
    name = "platens"
    profile = "adam-6018+"
    host = "192.168.0.21"
    channels = ["platen_top", "platen_bottom"]

    [server]
    host = "127.0.0.1"
    port = 8765
"""

from __future__ import annotations

import math
import tomllib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from daq.drivers.settings import LoggerSettings
from daq.press_wires import CLOSED, Wires
from daq.pressfile import Press, explain, read_press
from daq.records import InputError

HeaderValue = str | bool | int | float | list[Any]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class StoreSettings(_Table):
    """``[store]``."""

    url: str = Field(default="kerntemp.sqlite", min_length=1)
    """File path (relative to the configuration), ``sqlite:///path`` or ``postgresql://user@host/name``."""
    buffer: Path | None = None
    """Local file that takes the scans while a database server is away. None: beside the configuration."""
    keep_idle_days: Annotated[float, Field(ge=1)] = 30.0
    """Scans outside every run are thinned after this many days. Runs are never touched: a day is longer than
    what a run takes in from before its insertion, and than its row waits behind its scans in a back-fill."""


class PressSettings(_Table):
    """``[[press]]``: one recorded press."""

    name: str = Field(min_length=1, pattern=r"^[A-Za-z0-9_-]+$")
    file: Path
    """The press file."""
    rate_hz: Annotated[float, Field(ge=0.5, le=20)] = 10.0
    pre_trigger_s: Annotated[float, Field(ge=0, le=600)] = 5.0
    """A run begins this long before the panel's insertion; at least 35 s where no sensor showed it."""
    post_removal_s: Annotated[float, Field(ge=0, le=600)] = 5.0
    """A run ends this long after the panel's removal."""
    longest_run_s: Annotated[float, Field(gt=0)] = 3600.0
    """A run that long is ended: the removal was missed."""
    limit_switch: str | None = Field(default=None, min_length=1)
    """Column of a limit switch, 1 while the press is closed. None: what the press file says."""
    header: Mapping[str, HeaderValue] = Field(default_factory=dict)
    """Header keys every run of this press begins with: panel, ambient, settings."""
    logger: tuple[LoggerSettings, ...] = Field(min_length=1)

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of all loggers, in order."""
        return tuple(c for logger in self.logger for c in logger.columns)

    @model_validator(mode="after")
    def _distinct(self) -> PressSettings:
        if twice := [c for c, n in Counter(self.columns).items() if n > 1]:
            raise ValueError(f"two loggers fill column {twice[0]!r}; each column comes from one input")
        if twice := [c for c, n in Counter(x.name for x in self.logger).items() if n > 1]:
            raise ValueError(f"two loggers are called {twice[0]!r}; give each its own name")
        return self


class ServerSettings(_Table):
    """``[server]``: the REST interface and page."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8765
    tokens: Path | None = None
    """File with the tokens of readers and writers. None: reading on loopback only."""


class RefitSettings(_Table):
    """``[refit]``: the nightly job."""

    workers: Annotated[int, Field(ge=1)] | None = None
    """Local processes; None: one a core."""
    dask: str = ""
    """Address of a Dask scheduler whose workers take the fits instead; they must reach the store."""
    reports: Path = Path("reports")
    """Folder the job writes its report to, one page a press and night."""


class MqttSettings(_Table):
    """``[mqtt]``: the plant's broker, fed by `kerntemp publish`."""

    host: str = Field(min_length=1)
    port: Annotated[int, Field(ge=1, le=65535)] = 1883
    prefix: str = Field(default="kerntemp", pattern=r"^[^#+]+$")
    """Topics begin with it: ``prefix/press/scan``."""
    client: str = Field(default="kerntemp", min_length=1)
    """Client identifier; give each machine its own."""
    user: str = ""
    password_file: Path | None = None
    """File with the user's password in its first line."""
    tls: bool = False
    certificates: Path | None = None
    """Certificates of who may have signed the broker's, PEM. None: the machine's own."""


class OpcuaSettings(_Table):
    """``[opcua]``: an OPC UA server, run by `kerntemp publish`."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 4840
    certificate: Path | None = None
    """The server's certificate, DER or PEM; with `key` it switches signing and encryption on."""
    key: Path | None = None


class ClockSettings(_Table):
    """``[clock]``: only for an accelerated demonstration."""

    speed: Annotated[float, Field(gt=0, le=1000)] = 1.0
    """Run time = monotonic time times this."""


class Config(_Table):
    """The whole ``kerntemp.toml``. Paths in it are absolute after `load_config`."""

    store: StoreSettings = StoreSettings()
    press: tuple[PressSettings, ...] = Field(min_length=1)
    server: ServerSettings = ServerSettings()
    refit: RefitSettings = RefitSettings()
    mqtt: MqttSettings | None = None
    opcua: OpcuaSettings | None = None
    clock: ClockSettings = ClockSettings()
    text: str = Field(default="", exclude=True)
    """The file as it was read, kept with every run."""
    path: Path | None = Field(default=None, exclude=True)
    """Where it was read."""

    @model_validator(mode="after")
    def _distinct(self) -> Config:
        if twice := [c for c, n in Counter(p.name for p in self.press).items() if n > 1]:
            raise ValueError(f"two presses are called {twice[0]!r}; give each its own name")
        return self

    def press_named(self, name: str | None = None) -> PressSettings:
        """Return the press of that name, the first where none is asked for."""
        found = [p for p in self.press if name in (None, p.name)]
        if not found:
            known = ", ".join(p.name for p in self.press)
            raise InputError(f"press {name!r} is not in the configuration; it has {known}")
        return found[0]


def load_config(path: Path) -> Config:
    """Read and check a configuration with everything it names.

    Raises
    ------
    InputError
        Naming file, line or key, value and what is allowed.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        tree = tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot read the configuration: {reason}") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    if own := {"text", "path"} & set(tree):
        raise InputError(f"{path}: {min(own)}: unknown key; remove it or check its spelling")
    try:
        config = Config.model_validate({**tree, "text": text, "path": path})
    except ValidationError as error:
        raise InputError(f"{path}: {explain(error)}") from error
    config = _absolute(config, path.resolve().parent)
    presses = []
    for settings in config.press:
        press = press_of(settings)
        check_columns(settings, press, str(path))
        presses.append(_resting(settings, press))
    return config.model_copy(update={"press": tuple(presses)})


def _resting(settings: PressSettings, press: Press) -> PressSettings:
    """Let loggers that carry nothing but limit switch and pressure stand still for as long as they like."""
    wires = {*Wires(press.press).columns}
    loggers = tuple(
        x.model_copy(update={"stale_after_s": x.stale_after_s or math.inf}) if wires.issuperset(x.columns) else x
        for x in settings.logger
    )
    return settings.model_copy(update={"logger": loggers})


def press_of(settings: PressSettings) -> Press:
    """Read a press's file, with what the configuration says of its wires. Raises `InputError`."""
    press = read_press(settings.file)
    if settings.limit_switch is None:
        return press
    table = press.press.model_copy(update={"limit_switch": settings.limit_switch})
    press = press.model_copy(update={"press": table})
    if said := press.misnamed_wire:
        raise InputError(f"{settings.file}: {said}")
    return press


def check_columns(settings: PressSettings, press: Press, where: str) -> None:
    """Refuse a press whose measured boundaries or wires no logger fills."""
    ends = (("bottom", press.boundary.bottom), ("top", press.boundary.top))
    for end, boundary in ends:
        if boundary.kind == "measured" and boundary.column not in settings.columns:
            raise InputError(
                f"{where}: press {settings.name}: no logger has channel {boundary.column!r}, which "
                f"boundary.{end} of {settings.file} needs; add it to a logger's channels"
            )
    table = press.press
    named = {"limit_switch": table.limit_switch} if table.limit_switch != CLOSED else {}
    named |= {"pressure": table.pressure.column} if table.pressure else {}
    for key, column in named.items():
        if column not in settings.columns:
            raise InputError(
                f"{where}: press {settings.name}: no logger has channel {column!r}, which {key} names; "
                f"add it to a logger's channels, or remove {key}"
            )
    if named and CLOSED in settings.columns:
        raise InputError(
            f"{where}: press {settings.name}: channel {CLOSED!r} is written from {', '.join(named.values())}; "
            f"give the logger's channel {CLOSED!r} another name"
        )


def _absolute(config: Config, folder: Path) -> Config:
    url = config.store.url if "://" in config.store.url else str(folder / Path(config.store.url).expanduser())
    buffer = folder / (config.store.buffer or "kerntemp-buffer.sqlite")
    store = config.store.model_copy(update={"url": url, "buffer": buffer})
    presses = tuple(
        p.model_copy(update={"file": folder / p.file, "logger": tuple(lg.relative_to(folder) for lg in p.logger)})
        for p in config.press
    )
    tokens = config.server.tokens
    server = config.server.model_copy(update={"tokens": None if tokens is None else folder / tokens})
    mqtt = _files_absolute(config.mqtt, folder, "password_file", "certificates")
    opcua = _files_absolute(config.opcua, folder, "certificate", "key")
    refit = config.refit.model_copy(update={"reports": folder / config.refit.reports})
    found = {"store": store, "press": presses, "server": server, "mqtt": mqtt, "opcua": opcua, "refit": refit}
    return config.model_copy(update=found)


def _files_absolute(table: _Table | None, folder: Path, *names: str) -> _Table | None:
    if table is None:
        return None
    given = {name: folder / path for name in names if (path := getattr(table, name)) is not None}
    return table.model_copy(update=given)
