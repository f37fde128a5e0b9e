"""``kerntemp.toml``: the settings of one machine's services, checked at start, unknown keys refused.

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
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from daq.address import SECRET, Address, text_without
from daq.drivers.settings import LoggerSettings
from daq.press.header import check_header, flat_if_tables
from daq.press.press_file import BoundaryKind, Press, overridden, read_press
from daq.press.resin_file import read_resin
from daq.press.wires import CLOSED, Wires
from daq.records import InputError
from daq.tables import at, explained, load_toml, text_in, unknown_key
from daq.words import Message, say

PORT = 8765
"""Of the page and the REST interface, unless the configuration has another. By hand."""
HeaderValue = str | bool | int | float | list[Any]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class StoreSettings(_Table):
    """``[store]``."""

    url: Annotated[Address, SECRET] = Address("kerntemp.sqlite")
    """File path (relative to the configuration), ``sqlite:///path`` or ``postgresql://user@host/name``."""
    buffer: Path | None = None
    """Local file that takes the scans while a database server is away. None: beside the configuration."""
    keep_idle_days: Annotated[float, Field(ge=1)] = 30.0
    """Scans outside every run are thinned after this many days. Runs are never touched: a day is longer than
    what a run takes in from before its insertion, and than its row waits behind its scans in a back-fill."""
    archive: Path | None = None
    """Folder that the nightly job moves the scans of old runs to, one file a run. None: they stay in the store."""
    archive_after_days: Annotated[float, Field(ge=1)] = 90.0
    """Age of a run from which on that is done."""
    pressings_only_after_days: Annotated[float, Field(ge=1)] | None = None
    """Age from which on archived scans are given up; header, moments and fits stay. None: never."""
    archive_minutes: Annotated[float, Field(gt=0)] = 30.0
    """Time of a night that this may take; what is left over goes on in the next one."""

    @model_validator(mode="after")
    def _one_step_after_the_other(self) -> StoreSettings:
        given = self.model_fields_set & {"archive_after_days", "pressings_only_after_days", "archive_minutes"}
        if self.archive is None and given:
            raise ValueError(say("config-no-archive", key=min(given)))
        last = self.pressings_only_after_days
        if last is not None and last <= self.archive_after_days:
            ages = {"days": last, "archived": self.archive_after_days}
            raise ValueError(say("config-pressings-only-too-early", **ages))
        return self


class PressSettings(_Table):
    """``[[press]]``: one recorded press."""

    name: str = Field(min_length=1, max_length=100, pattern=r"^[A-Za-z0-9_-]+$")
    """It begins the names of its runs, and those of files beside the store."""
    file: Path
    """The press file."""
    resin: Path | None = None
    """The resin file: how the paper cures, and what must hold at opening; taken as it stands when a pressing
    begins. None: nobody asks."""
    sisters: bool = True
    """Whether the press begins, while it has no model, with what presses of the same kind in the store know."""
    rate_hz: Annotated[float, Field(ge=0.5, le=20)] = 10.0
    pre_trigger_s: Annotated[float, Field(ge=0, le=600)] = 5.0
    """A run begins this long before the panel's insertion; at least 35 s where no sensor showed it."""
    post_removal_s: Annotated[float, Field(ge=0, le=600)] = 5.0
    """A run ends this long after the panel's removal."""
    longest_run_s: Annotated[float, Field(gt=0)] = 3600.0
    """A run that long is ended: the removal was missed."""
    limit_switch: str | None = Field(default=None, min_length=1)
    """Column of a limit switch, 1 while the press is closed. None: what the press file says."""
    header: Annotated[Mapping[str, HeaderValue], BeforeValidator(flat_if_tables)] = Field(default_factory=dict)
    """Header keys every run of this press begins with: panel, ambient, settings."""
    logger: tuple[LoggerSettings, ...] = Field(min_length=1)

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of all loggers, in order."""
        return tuple(c for logger in self.logger for c in logger.columns)

    @model_validator(mode="after")
    def _distinct(self) -> PressSettings:
        if twice := [c for c, n in Counter(self.columns).items() if n > 1]:
            raise ValueError(say("config-column-twice", column=twice[0]))
        if twice := [c for c, n in Counter(x.name for x in self.logger).items() if n > 1]:
            raise ValueError(say("config-logger-twice", logger=twice[0]))
        return self


class ServerSettings(_Table):
    """``[server]``: the REST interface and page."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = PORT
    tokens: Annotated[Path | None, SECRET] = None
    """File with the tokens of readers and writers. None: reading on loopback only."""


class RefitSettings(_Table):
    """``[refit]``: the nightly job."""

    workers: Annotated[int, Field(ge=1)] | None = None
    """Local processes, each for a press at a time; None: one a core."""
    dask: str = ""
    """Address of a Dask scheduler whose workers take the presses instead; they must reach the store."""
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
    password_file: Annotated[Path | None, SECRET] = None
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
    key: Annotated[Path | None, SECRET] = None


class EmailSettings(_Table):
    """``[email]``: alarms to people, sent by `kerntemp serve`."""

    host: str = Field(min_length=1)
    """The mail server."""
    port: Annotated[int, Field(ge=1, le=65535)] = 25
    sender: str = Field(min_length=3, pattern=r"^[^\s@]+@[^\s@]+$")
    to: tuple[Annotated[str, Field(pattern=r"^[^\s@]+@[^\s@]+$")], ...] = Field(min_length=1)
    security: Literal["none", "starttls", "tls"] = "none"
    user: str = ""
    password_file: Annotated[Path | None, SECRET] = None
    """File with the user's password in its first line."""
    language: str = "en"


class WebhookSettings(_Table):
    """``[webhook]``: alarms as JSON to another system, sent by `kerntemp serve`."""

    address_file: Annotated[Path, SECRET]
    """File with the receiver's http or https address in its first line: such addresses hold secrets."""


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
    email: EmailSettings | None = None
    webhook: WebhookSettings | None = None
    clock: ClockSettings = ClockSettings()
    text: str = Field(default="", exclude=True)
    """The file as it was read, without the store's password; kept with every run."""
    path: Path | None = Field(default=None, exclude=True)
    """Where it was read."""

    @model_validator(mode="after")
    def _distinct(self) -> Config:
        if twice := [c for c, n in Counter(p.name for p in self.press).items() if n > 1]:
            raise ValueError(say("config-press-twice", press=twice[0]))
        return self

    @property
    def scans_per_second(self) -> float:
        """How many scans of all presses are taken in a second of the wall clock."""
        return sum(press.rate_hz for press in self.press) * self.clock.speed

    def press_named(self, name: str | None = None) -> PressSettings:
        """Return the press of that name, the first where none is asked for."""
        found = [p for p in self.press if name in (None, p.name)]
        if not found:
            raise InputError(
                say("config-no-such-press", press=name or "", known=tuple(p.name for p in self.press))
            )
        return found[0]


def load_config(path: Path, unsound: dict[str, InputError] | None = None) -> Config:
    """Read and check a configuration with everything it names.

    Parameters
    ----------
    unsound
        Takes presses whose files or headers are refused, with why; the configuration returned is that of the
        others. Without it, or where no press is left, one refused press is a refused configuration.

    Raises
    ------
    InputError
        Naming file, line or key, value and what is allowed.
    """
    path = Path(path)
    try:
        tree = load_toml(path, say("file-of-configuration"))
        if own := {"text", "path"} & set(tree):
            raise InputError(at(path, say("at-key", key=min(own), what=unknown_key(min(own), ()))))
        config = Config.model_validate({**tree, "text": text_in(path), "path": path})
    except ValidationError as error:
        raise InputError(at(path, explained(error, Config))) from error
    config = config.model_copy(update={"text": text_without(config.text, config.store.url)})
    config = _absolute(config, path.resolve().parent)
    if config.store.url.mistyped:
        raise InputError(at(path, say("at-key", key="store.url", what=say("store-url-mistyped"))))
    presses = []
    for settings in config.press:
        try:
            presses.append(_checked(settings, path))
        except InputError as error:
            if unsound is None:
                raise
            unsound[settings.name] = error
    if unsound and not presses:
        raise next(iter(unsound.values()))
    return config.model_copy(update={"press": tuple(presses)})


def _checked(settings: PressSettings, path: Path) -> PressSettings:
    """Read and check what a configuration names for a press."""
    press = press_of(settings)
    check_columns(settings, press, str(path))
    place = say("config-header", file=str(path), press=settings.name)
    check_header(settings.header, place)
    overridden(press, settings.header, place)
    if settings.resin is not None:
        read_resin(settings.resin)
        if not press.panel_layers:
            raise InputError(at(settings.resin, say("resin-needs-panel")))
    return _resting(settings, press)


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
    if mistake := press.misnamed_wire:
        raise InputError(at(settings.file, mistake))
    return press


def check_columns(settings: PressSettings, press: Press, where: str) -> None:
    """Refuse a press whose measured boundaries or wires no logger fills."""

    def refuse(what: Message) -> None:
        raise InputError(at(where, say("of-press", press=settings.name, what=what)))

    ends = (("bottom", press.boundary.bottom), ("top", press.boundary.top))
    for end, boundary in ends:
        if boundary.kind is BoundaryKind.MEASURED and boundary.column not in settings.columns:
            file = str(settings.file)
            refuse(say("config-no-boundary-channel", channel=boundary.column or "", end=end, file=file))
    table = press.press
    named = {"limit_switch": table.limit_switch} if table.limit_switch != CLOSED else {}
    named |= {"pressure": table.pressure.column} if table.pressure else {}
    for key, column in named.items():
        if column not in settings.columns:
            refuse(say("config-no-wire-channel", channel=column, key=key))
    if named and CLOSED in settings.columns:
        refuse(say("config-closed-twice", channel=CLOSED, wires=tuple(named.values())))


def _absolute(config: Config, folder: Path) -> Config:
    buffer = folder / (config.store.buffer or "kerntemp-buffer.sqlite")
    archive = None if config.store.archive is None else folder / config.store.archive
    places = {"url": config.store.url.beside(folder), "buffer": buffer, "archive": archive}
    store = config.store.model_copy(update=places)
    presses = tuple(
        p.model_copy(
            update={
                "file": folder / p.file,
                "resin": None if p.resin is None else folder / p.resin,
                "logger": tuple(lg.relative_to(folder) for lg in p.logger),
            }
        )
        for p in config.press
    )
    tokens = config.server.tokens
    server = config.server.model_copy(update={"tokens": None if tokens is None else folder / tokens})
    mqtt = _files_absolute(config.mqtt, folder, "password_file", "certificates")
    opcua = _files_absolute(config.opcua, folder, "certificate", "key")
    refit = config.refit.model_copy(update={"reports": folder / config.refit.reports})
    found = {"store": store, "press": presses, "server": server, "mqtt": mqtt, "opcua": opcua, "refit": refit}
    found |= {"email": _files_absolute(config.email, folder, "password_file")}
    found |= {"webhook": _files_absolute(config.webhook, folder, "address_file")}
    return config.model_copy(update=found)


def _files_absolute(table: _Table | None, folder: Path, *names: str) -> _Table | None:
    if table is None:
        return None
    given = {name: folder / path for name in names if (path := getattr(table, name)) is not None}
    return table.model_copy(update=given)
