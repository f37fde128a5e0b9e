"""`kerntemp serve` as a process of its own: TLS, slow and greedy clients, tokens in the journal."""

import json
import logging
import os
import shutil
import signal
import socket
import sqlite3
import ssl
import subprocess
import sys
import threading
from contextlib import closing, contextmanager
from pathlib import Path

import httpx
import pytest
import uvicorn

from api.cli import main
from api.http.app import create_app
from api.http.gate import MAX_BODY_BYTES, Gate
from api.http.server import ConnectionWatchdog, Listening, SparingLog, make_server
from api.http.tokens import Attempts
from daq.records import InputError
from daq.store.store import open_store
from tests.daq.test_store_damage import spoil
from tests.patience import wait_until

PATIENT_S = 240.0
"""A busy machine answers late, and fails no test for it. [s]"""

LAB = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"
LOGGER = 'name = "x"\nprofile = "labjack-t7"\nhost = "127.0.0.1"\nchannels = ["platen_top", "platen_bottom"]\n'
CHANGE = "/api/v1/runs/lab-2026-03-04-01"


@pytest.fixture
def plant(tmp_path):
    """A folder with a configuration and an empty store."""
    (tmp_path / "kerntemp.toml").write_text(
        f'[[press]]\nname = "lab"\nfile = "{LAB.as_posix()}"\n[[press.logger]]\n{LOGGER}'
    )
    open_store(str(tmp_path / "kerntemp.sqlite")).close()
    return tmp_path


@contextmanager
def served(plant, *options):
    command = [sys.executable, "-m", "api", "serve", "--config", str(plant / "kerntemp.toml"), "--port", "0"]
    with (plant / "serve.log").open("w") as log:
        server = subprocess.Popen([*command, *options], stdout=subprocess.PIPE, stderr=log, text=True)
    try:
        address = server.stdout.readline().split()[-1]
        if os.name != "nt":
            for one in (signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2):  # a closed terminal ends none of these
                server.send_signal(one)
        yield address
    finally:
        server.terminate()
        server.wait(240)
        server.stdout.close()


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    """A certificate made here, as a plant would make one for its own network."""
    folder = tmp_path_factory.mktemp("tls")
    made = ["-keyout", str(folder / "key.pem"), "-out", str(folder / "cert.pem")]
    subject = ["-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1"]
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", *subject, *made]
    subprocess.run(command, check=True, capture_output=True)
    return folder / "cert.pem", folder / "key.pem"


def test_the_page_is_there_before_its_database_and_says_that_it_is_away(plant):
    config = plant / "kerntemp.toml"
    config.write_text('[store]\nurl = "postgresql://x@127.0.0.1:9/none"\n' + config.read_text())
    with served(plant) as address, httpx.Client(base_url=address, timeout=240) as client:
        health = client.get("/api/v1/health").json()
        assert (health["status"], health["store"]["kind"]) == ("down", "PostgreSQL")
        assert "check that the database server runs" in health["alarms"][0]
        assert client.get("/").status_code == 200
        assert "kerntemp_store_up 0.0" in client.get("/metrics").text


def outdated_for(path):
    """Make a store one of a newer version."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("UPDATE schema_version SET version = 999")
        connection.commit()


def test_a_store_of_a_newer_version_ends_the_server_with_a_sentence(plant):
    outdated_for(plant / "kerntemp.sqlite")
    command = [sys.executable, "-m", "api", "serve", "--config", str(plant / "kerntemp.toml"), "--port", "0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENT_S, check=False)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "made by a newer version (schema 999" in line


def test_a_store_that_becomes_one_of_a_newer_version_while_served_is_no_fault_of_the_program(plant):
    place, away = plant / "kerntemp.sqlite", plant / "away.sqlite"
    outdated_for(place)
    shutil.copy(place, away)
    spoil(place, 0, 4096, b"\xa5")
    with served(plant) as address, httpx.Client(base_url=address, timeout=240) as client:
        assert client.get("/api/v1/health").json()["status"] == "down"
        shutil.copy(away, place)
        answer = client.get("/api/v1/runs")
        assert answer.status_code == 422
        assert "made by a newer version" in answer.json()["detail"]
        wait_until(lambda: "made by a newer version" in (plant / "serve.log").read_text(), PATIENT_S)
    log = (plant / "serve.log").read_text()
    assert "Traceback" not in log
    assert "please report" not in log
    assert log.count("made by a newer version") == 1


def test_with_certificate_files_the_server_speaks_tls_only(plant, certificate):
    cert, key = certificate
    with served(plant, "--certificate", str(cert), "--key", str(key)) as address:
        assert address.startswith("https://127.0.0.1:")
        trusting = ssl.create_default_context(cafile=str(cert))
        assert httpx.get(address + "api/v1/health", verify=trusting, timeout=PATIENT_S).status_code == 200
        with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
            httpx.get(address, timeout=PATIENT_S)
        with pytest.raises(httpx.RemoteProtocolError):
            httpx.get(address.replace("https", "http"), timeout=PATIENT_S)


def test_a_key_that_does_not_belong_to_the_certificate_is_told_at_the_start(certificate, tmp_path, tokens):
    cert, key = certificate
    with pytest.raises(InputError, match="belong together"):
        Listening(certificate=cert).check(tokens)
    with pytest.raises(InputError, match="no such file"):
        Listening(certificate=cert, key=tmp_path / "none.pem").check(tokens)
    broken = tmp_path / "key.pem"
    broken.write_text(key.read_text()[:400])
    with pytest.raises(InputError, match="give both as PEM"):
        Listening(certificate=cert, key=broken).check(tokens)


def test_tokens_are_noted_in_the_journal_by_name_and_shown_nowhere_else(plant, capsys):
    config = ["--config", str(plant / "kerntemp.toml")]
    assert main(["token", "create", "tablet", "--scope", "write", *config]) == 0
    text = capsys.readouterr().out.strip()
    with served(plant) as address:
        wrong = text[:-1] + ("A" if text[-1] != "A" else "B")
        change = address + "api/v1/models/1/promote"
        for given, status in ((text, 404), (wrong, 401), *[(f"kt_guess{i}", 401) for i in range(9)], (text, 404)):
            answer = httpx.post(change, headers={"Authorization": f"Bearer {given}"}, timeout=PATIENT_S)
            assert answer.status_code == status, answer.text
    assert main(["token", "revoke", "tablet", *config]) == 0
    with open_store(str(plant / "kerntemp.sqlite")) as store:
        messages = [str(entry.message) for entry in store.journal().items]
    assert messages == ["token tablet revoked", "token tablet created, scope write"]
    log = (plant / "serve.log").read_text()
    assert "too many wrong tokens from 127.0.0.1" in log
    secret = text.split("_", 2)[2]  # may hold underscores itself
    kept = [path for path in plant.iterdir() if secret.encode() in path.read_bytes()]
    assert kept == []


@pytest.fixture
def raw(client):
    """A bare socket to the server."""
    host, port = client.base_url.host, client.base_url.port
    with socket.create_connection((host, port), timeout=240) as opened:
        yield opened


def answer_of(opened: socket.socket) -> tuple[int, dict[str, object]]:
    received = b""
    while b"\r\n\r\n" not in received or not received.rstrip().endswith(b"}"):
        part = opened.recv(65536)
        if not part:
            break
        received += part
    head, _, body = received.partition(b"\r\n\r\n")
    return int(head.split()[1]), json.loads(body)


def test_a_body_of_unstated_length_is_refused_as_soon_as_it_is_too_long(raw):
    raw.sendall(f"PATCH {CHANGE} HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n".encode())
    piece = b"4000\r\n" + b"x" * 0x4000 + b"\r\n"
    for _ in range(MAX_BODY_BYTES // 0x4000 + 1):
        raw.sendall(piece)
    status, problem = answer_of(raw)
    assert status == 413
    assert "65536 bytes" in problem["detail"]


@pytest.mark.parametrize(
    ("head", "status"),
    [
        (f"PATCH {CHANGE} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 99999999", 413),
        ("GET /api/v1/runs/%00 HTTP/1.1\r\nHost: 127.0.0.1", 422),
        ("GET /api/v1/runs?material=a%00b HTTP/1.1\r\nHost: 127.0.0.1", 422),
        ("GET /api/v1/../../etc/passwd HTTP/1.1\r\nHost: 127.0.0.1", 404),
        ("GET /api/v1/runs/..%2f..%2fetc%2fpasswd HTTP/1.1\r\nHost: 127.0.0.1", 404),
        ("GET /static/..%2f..%2fdaq/config.py HTTP/1.1\r\nHost: 127.0.0.1", 404),
        ("GET /static/%2fetc/passwd HTTP/1.1\r\nHost: 127.0.0.1", 404),
        ("GET //api/v1/runs HTTP/1.1\r\nHost: 127.0.0.1", 404),
        ("GET /api/v1/runs?limit=1e3 HTTP/1.1\r\nHost: 127.0.0.1", 422),
        (f"GET {CHANGE}/samples?from=abc HTTP/1.1\r\nHost: 127.0.0.1", 422),
        (f"GET {CHANGE}/samples?max_points=99999999999999999999 HTTP/1.1\r\nHost: 127.0.0.1", 422),
        ("GET /api/v1/runs?cursor=99999999999999999999 HTTP/1.1\r\nHost: 127.0.0.1", 422),
        (f"GET /api/v1/live HTTP/1.1\r\nHost: 127.0.0.1\r\nLast-Event-ID: {'9' * 30}/0//", 422),
    ],
)
def test_hostile_requests_get_a_clear_refusal(raw, head, status):
    raw.sendall(f"{head}\r\nConnection: close\r\n\r\n".encode())
    found, problem = answer_of(raw)
    assert found == status, problem
    assert problem["status"] == status


@contextmanager
def running(server, sockets=None):
    """A server in a thread until the block ends."""
    thread = threading.Thread(target=server.run, args=(sockets,), daemon=True)
    thread.start()
    wait_until(lambda: server.started)
    try:
        yield server.servers[0].sockets[0].getsockname()[1]
    finally:
        server.should_exit = True
        thread.join(240)


def test_a_body_that_does_not_arrive_in_time_is_given_up(store, tokens):
    impatient = Gate(create_app(store, tokens), tokens, Attempts(), body_s=0.2)
    server = uvicorn.Server(uvicorn.Config(impatient, port=0, log_level="warning", lifespan="off"))
    with running(server) as port, socket.create_connection(("127.0.0.1", port), timeout=240) as slow:
        slow.sendall(f"PATCH {CHANGE} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 50\r\n\r\n{{".encode())
        status, problem = answer_of(slow)
    assert status == 408
    assert "did not arrive within 0.2 s" in problem["detail"]


class Connection:
    """What the server keeps of a connection, as far as watchdog looks at it."""

    def __init__(self) -> None:
        self.cycle = self.transport = None
        self.transport = self
        self.cut = False

    def abort(self) -> None:
        self.cut = True


def test_who_asks_nothing_is_cut_off_and_who_asks_is_not():
    now = [0.0]
    watchdog = ConnectionWatchdog(idle_s=20.0, now=lambda: now[0])
    silent, busy, streaming = Connection(), Connection(), Connection()
    streaming.cycle = type("Request", (), {"response_complete": False})()
    for second in range(30):
        now[0] = float(second)
        busy.cycle = type("Request", (), {"response_complete": True})()
        watchdog.look([silent, busy, streaming])
        assert silent.cut == (second > 20)
    assert not busy.cut
    assert not streaming.cut


def test_beyond_the_limit_the_oldest_idle_connections_go_first():
    now = [0.0]
    watchdog = ConnectionWatchdog(most=2, now=lambda: now[0])
    first, second, third = Connection(), Connection(), Connection()
    for opened in ([first], [first, second], [first, second, third]):
        now[0] += 1.0
        watchdog.look(opened)
    assert (first.cut, second.cut, third.cut) == (True, False, False)


def test_connections_that_ask_nothing_lose_their_place_in_a_running_server(store, tokens):
    listening = Listening(port=0, idle_s=0.5)
    with running(make_server(store, tokens, listening), [listening.bind()]) as port:
        silent = [socket.create_connection(("127.0.0.1", port), timeout=240) for _ in range(20)]
        begun = socket.create_connection(("127.0.0.1", port), timeout=240)
        begun.sendall(b"GET /api/v1/health HTTP/1.1\r\nHost:")
        for opened in (*silent, begun):
            with opened:
                assert opened.recv(1) == b""
        assert httpx.get(f"http://127.0.0.1:{port}/api/v1/health", timeout=PATIENT_S).status_code == 200


@pytest.mark.skipif(sys.platform != "linux", reason="TCP_USER_TIMEOUT exists on Linux only")
def test_a_client_that_takes_nothing_of_an_answer_is_cut_off(store, tokens):
    listening = Listening(port=0, unread_s=0.5)
    server = make_server(store, tokens, listening)
    with running(server, [listening.bind()]) as port, socket.socket() as greedy:
        greedy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        greedy.connect(("127.0.0.1", port))
        greedy.sendall(f"GET {CHANGE}/samples HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode() * 300)
        wait_until(lambda: server.server_state.total_requests and not server.server_state.connections)
        assert server.server_state.total_requests < 300


def test_hostile_requests_do_not_flood_the_log(plant):
    def ask(place, request):
        with socket.create_connection(place, PATIENT_S) as wire:
            wire.sendall(request)
            wire.recv(100)

    with served(plant) as address:
        place = httpx.URL(address).host, httpx.URL(address).port
        for _ in range(20):
            ask(place, b"\x16\x03\x01\x02\r\n\r\n")
            ask(place, b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\r\n")
    lines = (plant / "serve.log").read_text().splitlines()
    assert any("Invalid HTTP request" in line for line in lines)
    assert len(lines) < 20, lines


def test_what_was_left_out_of_the_log_is_counted_and_faults_of_our_own_are_not_left_out():
    now = [0.0]
    sparing = SparingLog(lambda: now[0])

    def logged(level, message):
        record = logging.LogRecord("uvicorn.error", level, "h11_impl.py", 7, message, (), None)
        return record.getMessage() if sparing.filter(record) else None

    assert [logged(logging.WARNING, "gone") for _ in range(4)] == ["gone", None, None, None]
    assert [logged(logging.ERROR, "fault") for _ in range(2)] == ["fault", "fault"]
    now[0] = 60.0
    assert [logged(logging.WARNING, "gone") for _ in range(2)] == ["gone (+3)", None]
    now[0] = 120.0
    assert logged(logging.WARNING, "gone") == "gone (+1)"


def test_a_server_that_starts_loads_no_compiler():
    """The page is there a third sooner; whoever asks for what needs it waits then."""
    heavy = "('numba', 'scipy', 'pandas', 'matplotlib', 'softsensor.heat.model')"
    code = f"import sys, api.http.app; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
