"""An OPC UA server with the present values of every press. Clients read and subscribe; nothing can be written.

Node identifiers are strings of the namespace `NAMESPACE` and stay the same for ever: ``lab.core``,
``lab.core_low``, ``lab.core_high``, ``lab.core_sd``, ``lab.open_now``, ``lab.state``, ``lab.run``, ``lab.model``,
``lab.event``, and ``lab.channel.top_1`` for each channel. Temperatures carry `EngineeringUnits`, a pressure
channel its own; the source timestamp is that of the scan a value belongs to. Press events come as OPC UA events of
the press's node, too.

=======================================  ===================================================
status code                              meaning
=======================================  ===================================================
Good                                     measured, or predicted within its band
UncertainLastUsableValue                 the logger repeats itself: the channel stands still
UncertainSubstituteValue                 `open_now` alone: false because something is not known or old
BadSensorFailure                         thermocouple open
BadOutOfRange                            above or below what the logger can measure
BadNoCommunication                       the logger does not answer, or no scan for 5 s
BadNoData                                no estimate: no panel, the press's state is unknown, or the live
                                         sensor has been silent for 5 s
BadWaitingForInitialData                 nothing yet
=======================================  ===================================================

Beyond loopback the server needs a certificate, and clients give a token of scope read as password
(`kerntemp token create scada`); on loopback reading is free, as it is over REST.
"""

from __future__ import annotations

import asyncio
import logging
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua import Node, Server, ua
from asyncua.crypto.permission_rules import User, UserRole

from api.answers.health import installed_version
from api.answers.present import Present, present_of
from api.answers.records import utc_now
from api.http.gate import is_loopback
from api.http.tokens import TokenFile
from api.outputs import in_words, spoken_language
from api.plant.client_lines import limits, listen
from api.plant.client_log import LIBRARY, client_log_thinned
from daq.process.config import OpcuaSettings
from daq.records import Channel, InputError, Quality
from daq.store.records import StoredPressEvent, StoreUnavailable
from daq.store.store import Store
from daq.supervision import SILENT_S, Steps
from daq.tables import reason_of
from daq.words import Message, say, spoken
from softsensor.live.validity import Invalid, InvalidReason, reason_message

LOG = logging.getLogger("kerntemp.publish")
NAMESPACE = "urn:kerntemp:press"
PERIOD_S = 0.1
"""How often the store is asked. [s]"""
STATUS = {
    Quality.GOOD: ua.StatusCodes.Good,
    Quality.SIMULATED: ua.StatusCodes.Good,
    Quality.STALE: ua.StatusCodes.UncertainLastUsableValue,
    Quality.OPEN: ua.StatusCodes.BadSensorFailure,
    Quality.OVER: ua.StatusCodes.BadOutOfRange,
    Quality.UNDER: ua.StatusCodes.BadOutOfRange,
    Quality.BAD_FRAME: ua.StatusCodes.BadNoCommunication,
    Quality.MISSING: ua.StatusCodes.BadNoCommunication,
    Quality.LATE: ua.StatusCodes.BadTimeout,
}
_CELSIUS = ("°C", "degree Celsius", 4408652)
_KELVIN = ("K", "kelvin", 4932940)
_NO_CODE = -1
"""OPC UA's number for a unit outside its list."""
_ESTIMATES = {"core": _CELSIUS, "core_low": _CELSIUS, "core_high": _CELSIUS, "core_sd": _KELVIN}
_LEAVE = "open_now"
_TEXTS = ("state", "run", "model", "reason", "event")


class _Readers:
    """Who may read: anybody on loopback, elsewhere holders of a token."""

    def __init__(self, tokens: TokenFile, free: bool) -> None:
        self._tokens, self._free = tokens, free

    def get_user(
        self, iserver: Any, username: str | None = None, password: Any = None, certificate: Any = None
    ) -> User | None:
        """Return the user, or None to refuse."""
        if self._free:
            return User(UserRole.User, username)
        given = password.decode("utf-8", "replace") if isinstance(password, bytes) else password
        try:
            token = self._tokens.find(given) if given else None
        except InputError as error:
            logging.getLogger(LIBRARY).warning("%s", error)  # among what clients meet: logged sparingly
            return None
        return User(UserRole.User, username) if token is not None and token.allows("read") else None


@dataclass
class _PressNodes:
    """The nodes of one press and what they show."""

    name: str
    nodes: dict[str, Node] = field(default_factory=dict)
    shown: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    events: Any = None
    last_event: int = 0


PressNews = tuple[Present, Sequence[StoredPressEvent]]
"""A press now, and its events that have not been shown yet."""
NOTHING: PressNews = (Present(None, (), None, (), None, "unknown", None, None), ())
"""What is known of a press while the store does not answer."""


def check_settings(settings: OpcuaSettings, tokens: TokenFile) -> None:
    """Refuse what would not be safe. Raises `InputError`."""
    if (settings.certificate is None) != (settings.key is None):
        raise InputError(say("plant-certificate-needs-key"))
    for path in (settings.certificate, settings.key):
        if path is not None and not path.is_file():
            raise InputError(say("plant-certificate-missing", path=str(path)))
    if is_loopback(settings.host):
        return
    if settings.certificate is None:
        raise InputError(say("plant-certificate-needed", host=settings.host))
    if not tokens.tokens():
        raise InputError(say("plant-tokens-needed", host=settings.host))


class PressServer:
    """The server over one store."""

    def __init__(
        self, store: Store, settings: OpcuaSettings, tokens: TokenFile, clock: Callable[[], datetime] = utc_now
    ) -> None:
        self.problem: Message | None = None
        self.address = ""
        self._steps = Steps("opcua")
        self._store, self._settings, self._tokens, self._clock = store, settings, tokens, clock
        self._presses: dict[str, _PressNodes] = {}

    def stalled(self) -> Message | None:
        """Return that it stands still; None while it works or waits."""
        return self._steps.stalled()

    async def run(self, stop: threading.Event, started: threading.Event | None = None) -> None:
        """Serve until stopped. Raises `InputError` where the port is taken."""
        with client_log_thinned(LOG):
            await self._serve(stop, started)

    async def _serve(self, stop: threading.Event, started: threading.Event | None) -> None:
        server = await self._prepared()
        index = await server.register_namespace(NAMESPACE)
        root = await server.nodes.objects.add_folder(ua.NodeId(1, index), "Kerntemp")  # no press has this name
        await server.start()
        listener: asyncio.Server | None = None
        try:
            listener = await self._listener(server)
            self.address = f"opc.tcp://{self._settings.host}:{listener.sockets[0].getsockname()[1]}/kerntemp"
            with self._steps.step():
                await self._refresh(server, root, index)
            if started is not None:
                started.set()
            while not stop.is_set():
                await asyncio.sleep(PERIOD_S)
                with self._steps.step():
                    await self._refresh(server, root, index)
        finally:
            if listener is not None:
                listener.close()
            await server.stop()

    async def _listener(self, server: Server) -> asyncio.Server:
        host, port = self._settings.host, self._settings.port
        try:
            return await listen(server, host, port)
        except OSError as error:
            raise InputError(say("plant-address-taken", host=host, port=port, why=reason_of(error))) from error

    async def _prepared(self) -> Server:
        free = is_loopback(self._settings.host)
        server = Server(user_manager=_Readers(self._tokens, free))
        server.product_uri, server.manufacturer_name = NAMESPACE, "Kerntemp"
        await server.init()
        await server.set_application_uri("urn:kerntemp:server")
        server.allow_remote_admin(False)
        server.set_endpoint(f"opc.tcp://{self._settings.host}:{self._settings.port}/kerntemp")
        server.socket_address, server.limits = ("127.0.0.1", 0), limits()  # clients meet bounded lines instead
        server.set_server_name(f"Kerntemp {installed_version()}")
        tokens = [ua.UserNameIdentityToken, *([ua.AnonymousIdentityToken] if free else [])]
        server.set_identity_tokens(tokens)
        secure = [ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt]
        if self._settings.certificate is not None and self._settings.key is not None:
            await server.load_certificate(self._settings.certificate, _format(self._settings.certificate))
            await server.load_private_key(self._settings.key, format=_format(self._settings.key))
            server.set_security_policy([*secure, *([ua.SecurityPolicyType.NoSecurity] if free else [])])
        else:
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        return server

    async def _refresh(self, server: Server, root: Node, index: int) -> None:
        reading = asyncio.ensure_future(asyncio.to_thread(self._read))
        await asyncio.wait({reading}, timeout=SILENT_S)
        if not reading.done():  # nothing stands as known while a store takes its time
            await self._show_all(server, dict.fromkeys(self._presses, NOTHING), index)
        try:
            now = await reading
            self.problem = None
        except StoreUnavailable as error:
            self.problem = spoken(error)
            now = dict.fromkeys(self._presses, NOTHING)
        for name in now:
            if name not in self._presses:
                self._presses[name] = await _make_press(server, root, index, name)
                newest = await asyncio.to_thread(_newest_event, self._store, name)
                self._presses[name].last_event = newest.number if newest else 0
                if newest is not None:
                    await self._show_event(server, self._presses[name], newest)
        await self._show_all(server, now, index)

    def _read(self) -> dict[str, PressNews]:
        found: dict[str, PressNews] = {}
        for name in self._store.presses():
            shown = self._presses.get(name)
            events = self._store.press_events(name, after=shown.last_event) if shown else ()
            found[name] = (present_of(self._store, name, self._clock()), events)
        return found

    async def _show_all(self, server: Server, now: Mapping[str, PressNews], index: int) -> None:
        for name, (present, events) in now.items():
            await self._show(server, self._presses[name], present, index)
            for event in events:
                await self._send_event(server, self._presses[name], event)

    async def _show(self, server: Server, press: _PressNodes, present: Present, index: int) -> None:
        for channel in present.channels:
            if f"channel.{channel.name}" not in press.nodes:
                await _add_channel(press, channel, index)
        utc = present.scan.utc if present.scan else None
        for key, (value, code) in _channel_values(press, present).items():
            await _write(server, press, key, value, code, utc)
        for key, (value, code) in _estimate_values(present).items():
            await _write(server, press, key, value, code, present.estimate_utc or utc)
        await _write(server, press, _LEAVE, *_leave(present), present.estimate_utc or utc)
        for key, text in _texts(present).items():
            await _write(server, press, key, text, ua.StatusCodes.Good, utc)

    async def _send_event(self, server: Server, press: _PressNodes, event: StoredPressEvent) -> None:
        press.last_event = event.number
        await self._show_event(server, press, event)
        press.events.event.Message = ua.LocalizedText(event.kind)
        press.events.event.Severity = 100
        await press.events.trigger(message=event.kind)

    async def _show_event(self, server: Server, press: _PressNodes, event: StoredPressEvent) -> None:
        await _write(server, press, "event", event.kind, ua.StatusCodes.Good, event.utc)


def _format(path: Path) -> str:
    """Distinguish PEM and DER by what is in the file."""
    return "pem" if path.read_bytes().lstrip().startswith(b"-----BEGIN") else "der"


def _newest_event(store: Store, press: str) -> StoredPressEvent | None:
    newest: StoredPressEvent | None = None
    while events := store.press_events(press, after=newest.number if newest else 0):
        newest = events[-1]
    return newest


def _live(present: Present) -> bool:
    """Whether the newest scan is of now."""
    return present.scan is not None and present.late is None


def _channel_values(press: _PressNodes, present: Present) -> dict[str, tuple[float, int]]:
    """Return value and status of every channel the press ever had; one that is gone has no communication."""
    known = (key for key in press.nodes if key.startswith("channel."))
    scan, names = present.scan, (channel.name for channel in present.channels)
    values = dict(zip(names, zip(scan.values, scan.qualities, strict=True), strict=True)) if scan else {}
    found = {}
    for key in known:
        value, quality = values.get(key.removeprefix("channel."), (math.nan, Quality.MISSING))
        found[key] = (value, STATUS[quality] if _live(present) else ua.StatusCodes.BadNoCommunication)
    return found


def _estimate_values(present: Present) -> dict[str, tuple[float, int]]:
    estimate = present.estimate
    if estimate is None or not estimate.valid:
        code = ua.StatusCodes.BadNoData
        if not _live(present):
            code = ua.StatusCodes.BadNoCommunication if present.scan else ua.StatusCodes.BadWaitingForInitialData
        return dict.fromkeys(_ESTIMATES, (math.nan, code))
    values = (
        estimate.core_celsius,
        estimate.core_low_celsius,
        estimate.core_high_celsius,
        estimate.core_sd_kelvin,
    )
    return {key: (value, ua.StatusCodes.Good) for key, value in zip(_ESTIMATES, values, strict=True)}


def _leave(present: Present) -> tuple[bool, int]:
    """Return whether the press may open now, and whether that is known: a bad status would carry no value."""
    known = ua.StatusCodes.Good if present.known else ua.StatusCodes.UncertainSubstituteValue
    return present.open_now, known


def _texts(present: Present) -> dict[str, str]:
    estimate = present.estimate
    if present.late is not None:
        reason = present.late.message
    elif estimate is None:
        reason = Invalid(InvalidReason.NO_ESTIMATE_YET).message
    else:
        reason = reason_message(estimate.reason, (estimate.detail or {}).get("reason_arguments"))
    return {
        "state": present.state,
        "run": present.run.run if present.run else "",
        "model": estimate.model_version if estimate is not None and _live(present) else "",
        "reason": str(reason),
    }


async def _make_press(server: Server, root: Node, index: int, name: str) -> _PressNodes:
    home = await root.add_object(ua.NodeId(name, index), name)
    press = _PressNodes(name)
    for key, unit in _ESTIMATES.items():
        press.nodes[key] = await _add_number(home, index, f"{name}.{key}", key, _meaning(key), unit)
    node = await home.add_variable(ua.NodeId(f"{name}.{_LEAVE}", index), _LEAVE, False, ua.VariantType.Boolean)
    await _describe(node, _meaning(_LEAVE))
    press.nodes[_LEAVE] = node
    for key in _TEXTS:
        node = await home.add_variable(ua.NodeId(f"{name}.{key}", index), key, "", ua.VariantType.String)
        await _describe(node, _meaning(key))
        press.nodes[key] = node
    press.nodes["channels"] = await home.add_folder(ua.NodeId(f"{name}.channels", index), "channels")
    press.events = await server.get_event_generator(emitting_node=home)
    return press


async def _add_channel(press: _PressNodes, channel: Channel, index: int) -> None:
    warm = channel.unit == "C"
    unit = _CELSIUS if warm else (channel.unit, channel.unit, _NO_CODE)
    kind = "thermocouple" if warm else "pressure" if channel.unit else "wire"
    meaning = Message(f"plant-node-{kind}", {"channel": channel.name})
    place = f"{press.name}.channel.{channel.name}"
    node = await _add_number(press.nodes["channels"], index, place, channel.name, meaning, unit)
    press.nodes[f"channel.{channel.name}"] = node


async def _add_number(
    home: Node, index: int, place: str, name: str, meaning: Message, unit: tuple[str, str, int]
) -> Node:
    node = await home.add_variable(ua.NodeId(place, index), name, math.nan, ua.VariantType.Double)
    short, long, code = unit
    units = ua.EUInformation(
        NamespaceUri="http://www.opcfoundation.org/UA/units/un/cefact",
        UnitId=code,
        DisplayName=ua.LocalizedText(short),
        Description=ua.LocalizedText(long),
    )
    await node.add_property(ua.NodeId(f"{place}.units", index), ua.QualifiedName("EngineeringUnits", 0), units)
    await _describe(node, meaning)
    return node


def _meaning(key: str) -> Message:
    return Message(f"plant-node-{key.replace('_', '-')}")


async def _describe(node: Node, meaning: Message) -> None:
    text = ua.DataValue(ua.Variant(ua.LocalizedText(in_words(meaning), spoken_language())))
    await node.write_attribute(ua.AttributeIds.Description, text)


async def _write(
    server: Server, press: _PressNodes, key: str, value: float | str, code: int, utc: datetime | None
) -> None:
    """Write a value where it, its status or its time has changed."""
    shown = ("nan" if value != value else value, code, utc)
    if press.shown.get(key) == shown:
        return
    press.shown[key] = shown
    plain = ua.VariantType.Boolean if isinstance(value, bool) else ua.VariantType.Double
    kind = ua.VariantType.String if isinstance(value, str) else plain
    data = ua.DataValue(
        ua.Variant(value, kind),
        StatusCode=ua.StatusCode(ua.UInt32(code)),
        SourceTimestamp=utc,
        ServerTimestamp=datetime.now(UTC),
    )
    await server.write_attribute_value(press.nodes[key].nodeid, data)
