"""The OPC UA server, asked by a real client."""

from __future__ import annotations

import asyncio
import logging
import math
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua

from api.http.tokens import TokenFile
from api.plant.client_log import ClientLog
from api.plant.opcua import NAMESPACE, PressServer, _Readers, check_settings
from daq.process.config import OpcuaSettings
from daq.records import Channel, InputError, PressEvent, PressEventKind, PressState, Quality, Scan
from daq.store import NewRun, Store, StoredEstimate, open_store
from tests.api.certificates import self_signed

LAB = (Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml").read_text()
CHANNELS = (*(Channel(name) for name in ("platen_top", "top_1", "top_2", "top_3")), Channel("bar", "bar"))
BEGAN = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with open_store(str(tmp_path / "plant.sqlite")) as opened:
        yield opened


class Clock:
    """What the server takes for the present: a busy machine makes nothing old."""

    utc = BEGAN

    def __call__(self) -> datetime:
        return self.utc


@contextmanager
def serving(store: Store, folder: Path, clock: Clock | None = None, **settings: Any) -> Iterator[PressServer]:
    tokens = TokenFile(folder / "tokens.json")
    server = PressServer(store, OpcuaSettings(port=0, **settings), tokens, clock or Clock())
    stop, started = threading.Event(), threading.Event()
    thread = threading.Thread(target=lambda: asyncio.run(server.run(stop, started)))
    thread.start()
    try:
        assert started.wait(240)
        yield server
    finally:
        stop.set()
        thread.join(240)
        assert not thread.is_alive()


def write(
    store: Store, utc: datetime, *, valid: bool = True, followed: bool = True, leave: bool = True
) -> datetime:
    key = store.register_press("lab", CHANNELS, LAB)
    values = (201.5, 99.25, math.nan, 99.0, 42.0)
    scan = Scan(
        key.next_number,
        utc,
        10.0 + key.next_number,
        values,
        (Quality.GOOD, Quality.GOOD, Quality.OPEN, Quality.STALE, Quality.GOOD),
    )
    first = key.next_number == 0
    begin = NewRun("lab-2026-03-04-01", 0, utc, 10.0) if first else None
    kinds = (PressEventKind.INSERTED, PressEventKind.CLOSED) if first and valid else ()
    store.append_scans(key, [scan], [PressEvent(kind, 10.0, 10.4) for kind in kinds], begin)
    if not followed:
        return scan.utc
    core = 84.5 if valid else math.nan
    estimate = StoredEstimate(
        scan.number,
        scan.monotonic_s,
        PressState.CLOSED if valid else PressState.IDLE,
        core,
        0.5,
        core - 1.0,
        core + 1.0,
        valid,
        "" if valid else "no panel in the press",
        "lab-7",
        detail={"open_now": leave},
    )
    store.append_estimates("lab", [estimate])
    return scan.utc


async def read(server: PressServer, *keys: str) -> dict[str, ua.DataValue]:
    async with Client(server.address) as client:
        index = await client.get_namespace_index(NAMESPACE)
        nodes = {key: client.get_node(ua.NodeId(f"lab.{key}", index)) for key in keys}
        return {key: await node.read_data_value(raise_on_bad_status=False) for key, node in nodes.items()}


def test_values_come_with_status_codes_units_and_the_time_of_their_scan(tmp_path, store):
    utc = write(store, BEGAN)
    with serving(store, tmp_path) as server:
        found = asyncio.run(
            read(
                server,
                "core",
                "core_low",
                "channel.top_1",
                "channel.top_2",
                "channel.top_3",
                "state",
                "model",
                "run",
            )
        )
        units = asyncio.run(
            read(server, "core.units", "core_sd.units", "channel.top_1.units", "channel.bar.units")
        )
    codes = {key: value.StatusCode.name for key, value in found.items()}
    assert codes["core"] == codes["channel.top_1"] == "Good"
    assert codes["channel.top_2"] == "BadSensorFailure"
    assert codes["channel.top_3"] == "UncertainLastUsableValue"
    assert found["core"].Value.Value == 84.5
    assert found["core_low"].Value.Value == 83.5
    assert found["channel.top_1"].Value.Value == 99.25
    stamp = found["channel.top_1"].SourceTimestamp.replace(tzinfo=UTC)
    assert abs(stamp - utc) < timedelta(milliseconds=1)
    texts = {key: found[key].Value.Value for key in ("state", "model", "run")}
    assert texts == {"state": "closed", "model": "lab-7", "run": "lab-2026-03-04-01"}
    assert {key: unit.Value.Value.DisplayName.Text for key, unit in units.items()} == {
        "core.units": "°C",
        "core_sd.units": "K",
        "channel.top_1.units": "°C",
        "channel.bar.units": "bar",
    }


def test_a_core_of_a_silent_live_sensor_is_no_data_while_the_press_goes_on(tmp_path, store):
    clock = Clock()
    before = write(store, BEGAN)
    clock.utc = after = write(store, before + timedelta(seconds=25), followed=False)
    with serving(store, tmp_path, clock) as server:
        found = asyncio.run(read(server, "core", "core_high", "channel.top_1", "state", "reason"))
    codes = [found[key].StatusCode.name for key in ("core", "core_high", "channel.top_1")]
    assert codes == ["BadNoData", "BadNoData", "Good"]
    for key, utc in (("core", before), ("channel.top_1", after)):
        assert abs(found[key].SourceTimestamp.replace(tzinfo=UTC) - utc) < timedelta(milliseconds=1)
    assert found["reason"].Value.Value == "the live sensor has given no estimate for 25 s"
    assert found["state"].Value.Value == "closed"


async def becomes(server: PressServer, expected: tuple[bool, str]) -> None:
    """Wait until a client that follows `open_now` has been told this value and status."""
    values: list[tuple[bool, str]] = []

    class Handler:
        def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
            item = data.monitored_item.Value
            values.append((item.Value.Value, item.StatusCode.name))

    async with Client(server.address) as client:
        node = client.get_node(ua.NodeId("lab.open_now", await client.get_namespace_index(NAMESPACE)))
        subscription = await client.create_subscription(50, Handler())
        await subscription.subscribe_data_change(node)
        async with asyncio.timeout(240):
            while values[-1:] != [expected]:
                await asyncio.sleep(0.02)
        value = await node.read_data_value(raise_on_bad_status=False)
    assert (value.Value.Value, value.StatusCode.name) == expected


def test_leave_to_open_is_false_and_uncertain_wherever_it_is_not_known(tmp_path, store):
    clock = Clock()
    good, unknown = (True, "Good"), (False, "UncertainSubstituteValue")
    steps: tuple[tuple[tuple[bool, str], float, dict[str, Any] | None], ...] = (
        (good, 0.0, {}),
        (unknown, 1.0, {"valid": False}),
        (good, 2.0, {}),
        (unknown, 25.0, {"followed": False}),  # the live sensor is silent
        (good, 26.0, {}),
        (unknown, 31.5, None),  # recorder and sensor are silent together
        (good, 32.0, {}),
        (unknown, -60.0, None),  # the recorder's clock runs ahead of ours
        ((False, "Good"), 33.0, {"leave": False}),
    )
    write(store, BEGAN)
    with serving(store, tmp_path, clock) as server:
        for expected, at_s, given in steps:
            if at_s and given is not None:
                write(store, BEGAN + timedelta(seconds=at_s), **given)
            clock.utc = BEGAN + timedelta(seconds=at_s)
            asyncio.run(becomes(server, expected))


def test_no_leave_to_open_stands_while_the_store_takes_its_time(tmp_path, store, monkeypatch):
    write(store, BEGAN)
    monkeypatch.setattr("api.plant.opcua.SILENT_S", 0.3)
    hold, held = threading.Event(), threading.Event()
    with serving(store, tmp_path) as server:
        asyncio.run(becomes(server, (True, "Good")))
        read = store.standing

        def slow(press: str) -> Any:
            held.set()
            hold.wait(240)
            return read(press)

        monkeypatch.setattr(store, "standing", slow)
        try:
            assert held.wait(240)
            asyncio.run(becomes(server, (False, "UncertainSubstituteValue")))
        finally:
            hold.set()
        asyncio.run(becomes(server, (True, "Good")))


def test_a_press_may_have_any_name(tmp_path, store):
    write(store, BEGAN)
    store.register_press("presses", [Channel("top_1")], LAB)
    with serving(store, tmp_path) as server:
        assert asyncio.run(read(server, "core"))["core"].Value.Value == 84.5


def test_without_a_panel_there_is_no_data_and_without_scans_no_communication(tmp_path, store):
    write(store, BEGAN, valid=False)
    with serving(store, tmp_path) as server:
        found = asyncio.run(read(server, "core", "reason"))
        assert found["core"].StatusCode.name == "BadNoData"
        assert found["reason"].Value.Value == "no panel in the press"
    with open_store(str(tmp_path / "old.sqlite")) as old:
        write(old, BEGAN - timedelta(seconds=30))
        with serving(old, tmp_path) as server:
            found = asyncio.run(read(server, "core", "channel.top_1"))
    assert {value.StatusCode.name for value in found.values()} == {"BadNoCommunication"}


def test_a_subscriber_is_told_of_new_values_and_press_events(tmp_path, store):
    write(store, BEGAN)
    values, events = [], []

    class Handler:
        def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
            values.append(value)

        def event_notification(self, event: Any) -> None:
            events.append(event.Message.Text)

    async def follow(server: PressServer) -> None:
        async with Client(server.address) as client:
            index = await client.get_namespace_index(NAMESPACE)
            subscription = await client.create_subscription(50, Handler())
            await subscription.subscribe_data_change(client.get_node(ua.NodeId("lab.event", index)))
            await subscription.subscribe_events(client.get_node(ua.NodeId("lab", index)))
            key = store.register_press("lab", CHANNELS, LAB)
            store.append_scans(key, [], [PressEvent(PressEventKind.CLOSED, 10.5, 10.9)])
            async with asyncio.timeout(240):
                while "closed" not in values or "closed" not in events:
                    await asyncio.sleep(0.02)

    with serving(store, tmp_path) as server:
        asyncio.run(follow(server))
    assert values[-1] == events[-1] == "closed"


def test_nothing_can_be_written_from_outside(tmp_path, store):
    write(store, BEGAN)

    async def overwrite(server: PressServer) -> None:
        async with Client(server.address) as client:
            index = await client.get_namespace_index(NAMESPACE)
            await client.get_node(ua.NodeId("lab.core", index)).write_value(20.0)

    with (
        serving(store, tmp_path) as server,
        pytest.raises(ua.UaStatusCodeError, match=r"BadUserAccessDenied|NotWritable"),
    ):
        asyncio.run(overwrite(server))


def certificate(folder: Path) -> tuple[Path, Path]:
    from cryptography import x509

    uri = x509.UniformResourceIdentifier("urn:kerntemp:server")
    usage = x509.KeyUsage(True, True, True, True, False, True, False, False, False)
    return self_signed(folder, "press-pc", uri, x509.DNSName("press-pc"), usage=usage)


@pytest.mark.filterwarnings("ignore::DeprecationWarning:asyncua", "ignore::DeprecationWarning:cryptography")
def test_beyond_loopback_a_token_is_the_password_and_the_line_is_encrypted(tmp_path, store):
    write(store, BEGAN)
    tokens = TokenFile(tmp_path / "tokens.json")
    token = tokens.create("scada", "read")
    pem, key = certificate(tmp_path)
    everywhere = {"host": "0.0.0.0", "certificate": pem, "key": key}

    async def core(server: PressServer, password: str) -> float:
        client = Client(server.address.replace("0.0.0.0", "127.0.0.1"))
        client.application_uri = "urn:kerntemp:server"
        client.set_user("scada")
        client.set_password(password)
        await client.set_security_string(f"Basic256Sha256,SignAndEncrypt,{pem},{key}")
        async with client:
            index = await client.get_namespace_index(NAMESPACE)
            return float(await client.get_node(ua.NodeId("lab.core", index)).read_value())

    async def unencrypted(server: PressServer) -> None:
        async with Client(server.address.replace("0.0.0.0", "127.0.0.1")):
            pass

    with serving(store, tmp_path, **everywhere) as server:
        assert asyncio.run(core(server, token)) == 84.5
        with pytest.raises(ua.UaStatusCodeError):
            asyncio.run(core(server, token[:-1] + "x"))
        with pytest.raises(Exception, match=r"No matching endpoints|BadSecurity"):
            asyncio.run(unencrypted(server))


def test_unsafe_settings_are_refused_with_what_to_do(tmp_path):
    tokens = TokenFile(tmp_path / "tokens.json")
    with pytest.raises(InputError, match="beyond loopback a certificate is needed"):
        check_settings(OpcuaSettings(host="0.0.0.0"), tokens)
    pem, key = certificate(tmp_path)
    with pytest.raises(InputError, match="kerntemp token create NAME"):
        check_settings(OpcuaSettings(host="0.0.0.0", certificate=pem, key=key), tokens)
    with pytest.raises(InputError, match="belong together"):
        check_settings(OpcuaSettings(certificate=pem), tokens)


HOSTILE = (
    b"",
    b"GET / HTTP/1.1\r\n\r\n",
    b"HELF\xff\xff\xff\xff" + b"x" * 40,
    b"HELF\x08\x00\x00\x00",
    b"MSGF\x18\x00\x00\x00" + b"\x01" * 16,
    b"OPNF\x20\x00\x00\x00" + b"\xff" * 24,
    b"\x00" * 64,
)


def test_hostile_clients_leave_few_lines_and_no_traceback(store: Store, tmp_path: Path, caplog: Any) -> None:
    write(store, BEGAN)
    with caplog.at_level(logging.WARNING), serving(store, tmp_path) as server:
        host, _, port = server.address.removeprefix("opc.tcp://").partition("/")[0].partition(":")
        for _ in range(20):
            for sent in HOSTILE:
                with socket.create_connection((host, int(port)), 10) as client:
                    client.sendall(sent)
                    client.shutdown(socket.SHUT_WR)
                    while client.recv(4096):
                        pass
        assert asyncio.run(read(server, "core"))["core"].Value.Value == 84.5
    lines = [record.getMessage() for record in caplog.records]
    about_clients = [line for line in lines if line.startswith("OPC UA client 127.0.0.1: ")]
    assert 1 <= len(about_clients) <= len(HOSTILE), lines
    assert len(lines) <= len(about_clients) + 3, "what the server says of itself"
    assert not any(record.exc_info for record in caplog.records)
    assert not any("\n" in line for line in lines)


def test_a_line_about_clients_comes_again_after_a_minute_and_counts_those_left_out(caplog: Any) -> None:
    now = [0.0]
    log = ClientLog(logging.getLogger("kerntemp.publish"), lambda: now[0])
    record = logging.LogRecord("asyncua", logging.WARNING, "x.py", 1, "bad\nheader", None, None)
    with caplog.at_level(logging.WARNING):
        for _ in range(5):
            log.emit(record)
        now[0] = 61.0
        log.emit(record)
    first, second = (entry.getMessage() for entry in caplog.records)
    assert first.endswith("bad header")
    assert second.endswith("; 4 more like it since the last line")


def test_a_damaged_token_file_lets_nobody_in_and_breaks_nothing(tmp_path: Path) -> None:
    (tmp_path / "tokens.json").write_text("{")
    assert _Readers(TokenFile(tmp_path / "tokens.json"), False).get_user(None, "x", "kt_any") is None
    assert _Readers(TokenFile(tmp_path / "tokens.json"), True).get_user(None, "x", "kt_any") is not None
