"""Hostile OPC UA clients over real sockets: what the server holds stays small, and sound clients are served."""

from __future__ import annotations

import asyncio
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from asyncua import Client, ua

from api.plant.client_lines import MOST_CLIENTS
from api.plant.opcua import NAMESPACE
from daq.store import Store, open_store
from tests.api.test_plant_opcua import BEGAN, write
from tests.patience import wait_until

CONFIGURATION = """
[store]
url = "{store}"
[opcua]
port = {port}
[[press]]
name = "lab"
file = "{press}"
[[press.logger]]
name = "x"
profile = "m-7018"
host = "127.0.0.1"
channels = ["platen_top", "platen_bottom"]
"""
PRESS = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"
ADDRESS = b"opc.tcp://127.0.0.1:4840"
HELLO = struct.pack("<4sI5Ii", b"HELF", 32 + len(ADDRESS), 0, 65535, 65535, 0, 0, len(ADDRESS)) + ADDRESS
MB = 1_000_000


class Published:
    """A real `kerntemp publish` with an OPC UA server."""

    def __init__(self, store: Store, folder: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        config = folder / "kerntemp.toml"
        config.write_text(CONFIGURATION.format(store=store.database.path, port=self.port, press=PRESS))
        command = [sys.executable, "-m", "api", "publish", "--config", str(config)]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        self.peak_MB = 0.0
        self._watched = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()
        wait_until(self._listens)
        wait_until(self.serves)

    @property
    def memory_MB(self) -> float:
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.partition("VmRSS:")[2].split()[0]) / 1024

    def _watch(self) -> None:
        with suppress(OSError, IndexError):
            while not self._watched.wait(0.01):
                self.peak_MB = max(self.peak_MB, self.memory_MB)

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), 20)

    def serves(self) -> bool:
        """Whether a sound client is answered."""

        async def read() -> str:
            async with Client(f"opc.tcp://127.0.0.1:{self.port}/kerntemp", timeout=60) as client:
                index = await client.get_namespace_index(NAMESPACE)
                return str(await client.get_node(ua.NodeId("lab.state", index)).read_value())

        try:
            return asyncio.run(read()) == "unknown"  # its recorder has stopped
        except ua.UaError:  # the press is not there yet
            return False

    def _listens(self) -> bool:
        try:
            self.connect().close()
        except OSError:
            return False
        return True

    def end(self) -> str:
        """End it, and return what it wrote to standard error; nothing at a second call."""
        self._watched.set()
        if self.process.poll() is not None:
            return ""
        self.process.terminate()
        return self.process.communicate()[1]


@pytest.fixture
def published(tmp_path: Path) -> Iterator[Published]:
    with open_store(str(tmp_path / "plant.sqlite")) as store:
        write(store, BEGAN)
        server = Published(store, tmp_path)
        try:
            yield server
        finally:
            server.end()


def claims_much(line: socket.socket) -> None:
    line.sendall(b"MSGF" + struct.pack("<I", 0xFFFFFFF0))
    for _ in range(20):
        line.sendall(b"x" * MB)


def sends_many_small_chunks(line: socket.socket) -> None:
    line.sendall(HELLO + (b"MSGC" + struct.pack("<I", 24) + b"\1" * 16) * 100_000)


def sends_a_message_in_many_chunks(line: socket.socket) -> None:
    line.sendall(HELLO)
    for _ in range(200):
        line.sendall(b"MSGC" + struct.pack("<I", 65535) + b"\1" * (65535 - 8))


def fetches_no_answer(line: socket.socket) -> None:
    for _ in range(200):
        line.sendall(HELLO * 1000)


ATTACKS = (claims_much, sends_many_small_chunks, sends_a_message_in_many_chunks, fetches_no_answer)


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.__name__)
def test_whatever_twenty_clients_send_before_a_session_the_server_holds_a_bounded_amount(
    published: Published, attack: Callable[[socket.socket], None]
) -> None:
    published.peak_MB = before = published.memory_MB

    def run() -> None:
        with suppress(OSError), published.connect() as line:
            line.settimeout(3.0)
            attack(line)

    threads = [threading.Thread(target=run) for _ in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120)
    sys.stdout.write(f"{attack.__name__}: {published.peak_MB - before:.1f} MB\n")
    assert published.peak_MB - before < 20 * 0.65 + 12.0, "twenty lines, and what a sound client takes"
    assert published.serves()
    assert published.process.poll() is None


def test_lines_that_nobody_uses_keep_no_client_out(published: Published) -> None:
    with ExitStack() as stack:
        for _ in range(2 * MOST_CLIENTS):
            stack.enter_context(published.connect())
        assert published.serves()
    assert "is let go" in published.end()
