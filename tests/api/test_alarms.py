"""Alarms: raised once, kept over a restart, delivered to a real mail server and a real receiver, acknowledged."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import ssl
import subprocess
import sys
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from email import message_from_bytes
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from pathlib import Path

import httpx
import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import AuthResult
from cryptography import x509

from api.alarms import watch
from api.alarms.watch import look, send_due, watching
from api.alarms.ways import NotDelivered, ways_of
from api.answers.alarms import alarm_of
from api.answers.health import NEVER_SEEN, SILENT_S, health_of, standing_alarms
from daq.process.config import EmailSettings, WebhookSettings
from daq.records import Channel, InputError, PressEvent, PressEventKind, Quality, Scan
from daq.store import open_store
from daq.store.records import NewRun, StandingAlarm, StoredEstimate
from daq.store.write_batch import Entry
from daq.supervision import CALM_S, IN_USE_S
from daq.words import say
from daq.words.message import words
from tests.api.certificates import self_signed
from tests.patience import wait_until

LAB = Path(__file__).parents[2] / "deploy/presses/lab.toml"
LOGGER = 'profile = "exemys-rme1-tc"\nhost = "127.0.0.1"\nchannels = ["platen_top", "platen_bottom"]\n'
NOW = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
CHANNELS = (Channel("platen_top"), Channel("platen_bottom"), Channel("top_1"))
HOT = StandingAlarm("hot", "lab", say("alarm-core-above", press="lab", limit=110.0))


@pytest.fixture
def store(store_url):
    with open_store(store_url) as opened:
        yield opened


class Inbox:
    """Takes e-mails as a mail server does; refuses for now where told to."""

    def __init__(self):
        self.mails, self.refusals = [], 0

    async def handle_DATA(self, server, session, envelope):
        if self.refusals:
            self.refusals -= 1
            return "451 try again later"
        self.mails.append(message_from_bytes(envelope.content))
        return "250 taken"


@pytest.fixture
def mail():
    inbox = Inbox()
    server = Controller(inbox, hostname="127.0.0.1", port=free_port())
    server.start()
    yield (
        inbox,
        EmailSettings(
            host="127.0.0.1", port=server.port, sender="press@plant.example", to=("shift@plant.example",)
        ),
    )
    server.stop()


MAIL = "email shift@plant.example"
"""The way to the mailbox."""


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return taken.getsockname()[1]


class Receiver:
    """Takes posts as another system does."""

    def __init__(self, port=0):
        posts = self.posts = []
        refuse = self.refuse = []

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                if not refuse:
                    posts.append((self.headers["Idempotency-Key"], json.loads(body)))
                self.send_response(503 if refuse else 204)
                self.end_headers()

            def log_message(self, *_):
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self.port = self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def close(self):
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture
def receiver():
    running = Receiver()
    yield running
    running.close()


def hook(folder, port):
    (folder / "hook").write_text(f"http://127.0.0.1:{port}/hook?secret=s3cr3t\n", encoding="utf-8")
    return WebhookSettings(address_file=folder / "hook")


def seconds(s):
    return NOW + timedelta(seconds=s)


def test_a_condition_that_stands_is_raised_once_and_ends_when_it_has_been_calm(store):
    assert [store.watch_alarms([HOT], [], seconds(s)) for s in (0, 2, 4)] == [1, 0, 0]
    assert [store.watch_alarms([], [], seconds(s)) for s in (6, 30)] == [0, 0]  # flickers about the limit
    assert store.watch_alarms([HOT], [], seconds(40)) == 0
    store.watch_alarms([], [], seconds(120))
    (alarm,) = store.alarms().items
    assert (alarm.raised_utc, alarm.ended_utc) == (NOW, seconds(40))
    assert store.watch_alarms([HOT], [], seconds(130)) == 1
    assert [a.ended_utc is None for a in store.alarms().items] == [True, False]


def test_each_alarm_of_the_journal_is_taken_up_once_also_those_of_a_time_nobody_watched(store):
    store.log("alarm", "record", say("run-fit-killed", run="old"))
    store.watch_alarms([], [MAIL], NOW)  # what was before the first look is history
    for run in ("a", "b"):
        store.log("alarm", "record", say("run-fit-killed", run=run), "lab")
        store.log("info", "record", say("run-fit-killed", run=run), "lab")
    assert [store.watch_alarms([], [MAIL], NOW) for _ in range(2)] == [2, 0]
    assert [a.message.arguments["run"] for a in store.alarms(pending=True).items] == ["b", "a"]


@pytest.mark.parametrize("pending", [False, True])
def test_every_alarm_is_on_one_page(store, pending):
    for i in range(5):
        store.watch_alarms([replace(HOT, key=f"hot {i}")], [], seconds(0))
    found, cursor = [], None
    for _ in range(5):
        page = store.alarms(limit=2, cursor=cursor, pending=pending)
        found.append([alarm.number for alarm in page.items])
        if (cursor := page.next_cursor) is None:
            break
    assert [len(page) for page in found] == [2, 2, 1]
    numbers = [number for page in found for number in page]
    assert numbers == sorted(set(numbers), reverse=True)


def test_the_first_to_acknowledge_an_alarm_is_kept(store):
    store.watch_alarms([HOT], [], NOW)
    number = store.alarms().items[0].number
    first = store.acknowledge_alarm(number, "foreman")
    assert store.acknowledge_alarm(number, "other") == first
    assert (first.acknowledged_by, first.ended_utc) == ("foreman", None)
    assert store.alarms(pending=True).items == (first,)  # it stands, whoever knows of it
    store.watch_alarms([], [], seconds(120))
    assert store.alarms(pending=True).items == ()
    with pytest.raises(InputError, match="no alarm 999"):
        store.acknowledge_alarm(999, "foreman")


def test_an_alarm_reaches_mailbox_and_receiver_once_each(store, mail, receiver, tmp_path):
    inbox, settings = mail
    ways = ways_of(settings, hook(tmp_path, receiver.port), "store")
    store.watch_alarms([HOT], [way.name for way in ways], NOW)
    assert [send_due(store, ways, lambda: NOW) for _ in range(2)] == [2, 0]
    (letter,), ((key, post),) = inbox.mails, receiver.posts
    number = store.alarms().items[0].number
    assert letter["Subject"] == "Kerntemp: lab: the core is above 110 °C" or "=?utf-8?" in letter["Subject"]
    assert letter["Message-ID"].startswith(f"<alarm-{number}.")
    assert "110" in letter.get_payload(decode=True).decode()
    assert (key, post["id"], post["message_said"]["code"]) == (f"alarm-{number}", str(number), "alarm-core-above")


def test_a_mail_in_german_where_the_plant_reads_german(store, mail):
    inbox, settings = mail
    ways = ways_of(settings.model_copy(update={"language": "de"}), None, "store")
    store.watch_alarms([HOT], [MAIL], NOW)
    send_due(store, ways, lambda: NOW)
    assert "der Kern ist über 110 °C" in inbox.mails[0].get_payload(decode=True).decode()
    with pytest.raises(InputError, match="is not available; choose one of en, de"):
        ways_of(settings.model_copy(update={"language": "fr"}), None, "store")


class TlsController(Controller):
    """A mail server that speaks TLS from the first byte and takes a known user alone."""

    def __init__(self, inbox, context, without=()):
        self.logins = []
        super().__init__(
            inbox,
            hostname="127.0.0.1",
            port=free_port(),
            ssl_context=context,
            authenticator=self.known,
            auth_required=True,
            auth_exclude_mechanism=without,
            auth_require_tls=False,  # aiosmtpd counts STARTTLS alone
        )

    def known(self, server, session, envelope, mechanism, data):
        self.logins.append((data.login.decode(), data.password.decode()))
        return AuthResult(success=self.logins[-1] == ("schicht", "Prüfstand"), handled=False)


@pytest.fixture(params=[(), ("PLAIN",)], ids=["any", "login-alone"])
def tls_mail(request, tmp_path, monkeypatch):
    certificate, key = self_signed(tmp_path, "mail", x509.IPAddress(ip_address("127.0.0.1")))
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    with warnings.catch_warnings():  # of what aiosmtpd thinks of a login without STARTTLS
        warnings.simplefilter("ignore")
        server = TlsController(Inbox(), context, request.param)
        server.start()
        password = tmp_path / "password"
        values = {"security": "tls", "user": "schicht", "password_file": password}
        to = ("shift@plant.example",)
        settings = EmailSettings(host="127.0.0.1", port=server.port, sender="press@plant.example", to=to, **values)
        yield server, settings, password
        server.stop()


def test_a_mail_goes_over_tls_also_with_a_password_that_is_no_ascii(store, tls_mail):
    server, settings, password = tls_mail
    password.write_text("Prüfling\n", encoding="utf-8")
    ways = ways_of(settings, None, "store")
    store.watch_alarms([HOT], [MAIL], NOW)
    assert send_due(store, ways, lambda: NOW) == 0
    (entry,) = store.journal(level="warning").items
    assert "535" in str(entry.message)
    password.write_text("Prüfstand\n", encoding="utf-8-sig")  # as some editors write it
    assert send_due(store, ways, lambda: seconds(6)) == 1
    assert server.logins == [("schicht", "Prüfling"), ("schicht", "Prüfstand")]
    assert len(server.handler.mails) == 1


def test_a_password_file_that_is_no_text_is_told_and_keeps_no_other_way_waiting(store, mail, receiver, tmp_path):
    _, settings = mail
    (tmp_path / "password").write_bytes(b"\xff\xfe")
    (way,) = ways_of(settings, None, "store")
    changed = settings.model_copy(update={"user": "press", "password_file": tmp_path / "password"})
    with pytest.raises(InputError, match="password"):
        ways_of(changed, None, "store")
    ways = [replace(way, settings=changed), *ways_of(None, hook(tmp_path, receiver.port), "store")]
    store.watch_alarms([HOT], [way.name for way in ways], NOW)
    assert send_due(store, ways, lambda: NOW) == 1
    assert len(receiver.posts) == 1


def test_a_receiver_that_refuses_is_asked_again_later_and_told_of_once(store, mail, receiver, tmp_path):
    inbox, settings = mail
    inbox.refusals = 2
    receiver.refuse.append(True)
    ways = ways_of(settings, hook(tmp_path, receiver.port), "store")
    store.watch_alarms([HOT], [way.name for way in ways], NOW)
    sent = [send_due(store, ways, lambda s=s: seconds(s)) for s in (0, 1, 5, 6, 15)]
    assert sent == [0, 0, 0, 0, 1]  # after 5 s, then after another 10
    receiver.refuse.clear()
    assert send_due(store, ways, lambda: seconds(60)) == 1
    assert (len(inbox.mails), len(receiver.posts)) == (1, 1)
    warnings = [str(e.message) for e in store.journal(level="warning").items]
    assert len(warnings) == 2
    assert not any("s3cr3t" in line for line in warnings)


def test_a_delivery_is_in_one_hand_at_a_time(store):
    store.watch_alarms([HOT], [MAIL], NOW)
    mine = store.take_delivery([MAIL], NOW)
    assert store.take_delivery([MAIL], seconds(40)) is None
    again = store.take_delivery([MAIL], seconds(50))  # the first hand was killed
    assert (mine.tries, again.tries, again.alarm) == (1, 2, mine.alarm)
    store.delivered(again, seconds(51))
    assert store.take_delivery([MAIL], seconds(9999)) is None


def test_what_a_server_has_in_hand_whose_clock_is_ahead_is_not_sent_twice(store):
    store.watch_alarms([HOT], [MAIL], NOW)
    mine = store.take_delivery([MAIL], seconds(900))  # by a clock that is a quarter of an hour ahead
    for s in range(0, 40, 2):
        assert store.take_delivery([MAIL], seconds(s)) is None
    store.delivered(mine, seconds(940))
    assert store.take_delivery([MAIL], seconds(9999)) is None


def test_a_clock_that_is_set_back_keeps_no_alarm_waiting_and_hides_none(store):
    day_s = 86400.0
    store.watch_alarms([HOT], [MAIL], seconds(day_s))
    refused = store.take_delivery([MAIL], seconds(day_s))
    store.put_off(refused, "refused", seconds(day_s))
    assert store.take_delivery([MAIL], NOW) is None  # by now the clock is set back
    again = store.take_delivery([MAIL], seconds(46))
    assert again.alarm.number == refused.alarm.number
    store.delivered(again, seconds(46))
    for s in (2, 2.5 + CALM_S):
        assert store.watch_alarms([], [MAIL], seconds(s)) == 0
    assert not any(alarm.ended_utc is None for alarm in store.alarms().items)
    assert store.watch_alarms([HOT], [MAIL], seconds(90)) == 1


@pytest.mark.parametrize("ahead_s", [90.0, 900.0])
def test_what_a_server_sees_whose_clock_is_ahead_is_one_alarm_and_ends_when_it_is_over(store, ahead_s):
    new = [
        store.watch_alarms([HOT] if ahead else [], [MAIL], seconds(s + (ahead_s if ahead else 0.0)))
        for s in range(0, 200, 2)
        for ahead in (True, False)
    ]
    assert sum(new) == 1
    for s in range(200, 204 + int(CALM_S), 2):
        assert store.watch_alarms([], [MAIL], seconds(s)) == 0
    assert [alarm.ended_utc is None for alarm in store.alarms().items] == [False]


@pytest.mark.parametrize("off_s", [-900.0, 900.0])
def test_what_one_server_sees_another_does_not_end_whose_clock_differs(store, store_url, monkeypatch, off_s):
    looks = {False: 0, True: 0}

    def standing(opened, now):
        looks[other := abs((now - datetime.now(UTC)).total_seconds()) > 60.0] += 1
        return [] if other else [HOT]  # as where a reading is too old by this clock

    monkeypatch.setattr(watch, "standing_alarms", standing)
    monkeypatch.setattr(watch, "LOOK_S", 0.01)
    with open_store(store_url) as beside, watching(store, []):
        monkeypatch.setattr(watch, "utc_now", lambda: datetime.now(UTC) + timedelta(seconds=off_s))
        with watching(beside, []):
            wait_until(lambda: min(looks.values()) > 10)
    assert [alarm.ended_utc for alarm in store.alarms().items] == [None]


@pytest.mark.parametrize("ahead_s", [300.0, 86400.0])
def test_an_alarm_whose_clock_is_ahead_is_due_at_once(store, ahead_s):
    store.watch_alarms([], [MAIL], NOW)
    line = Entry("alarm", "record", say("run-fit-killed", run="a"), "lab", unix_s=seconds(ahead_s).timestamp())
    store.write_batches([], [line])
    assert store.watch_alarms([], [MAIL], seconds(2)) == 1
    assert store.take_delivery([MAIL], seconds(2)).alarm.raised_utc == seconds(ahead_s)


def test_a_receiver_that_is_gone_and_one_that_sends_elsewhere_have_not_taken_it(tmp_path, store):
    store.watch_alarms([HOT], [], NOW)
    with pytest.raises(NotDelivered, match="refused"):
        ways_of(None, hook(tmp_path, free_port()), "store")[0].deliver(store.alarms().items[0])


SERVE = """
import sys
from datetime import datetime
from api.alarms.watch import watching
from api.alarms.ways import ways_of
from api.answers.records import utc_now
from daq.process.config import EmailSettings, WebhookSettings
from daq.store import open_store
from pathlib import Path
url, port, hook, began, speed = sys.argv[1:]
email = EmailSettings(host="127.0.0.1", port=int(port), sender="press@plant.example", to=("shift@plant.example",))
store, began = open_store(url), datetime.fromisoformat(began)
def clock():
    return began + float(speed) * (utc_now() - began)
with watching(store, ways_of(email, WebhookSettings(address_file=Path(hook)), "store"), clock):
    print("watching", flush=True)
    sys.stdin.read()
"""


def end(process):
    process.kill()
    process.wait(240)
    process.stdin.close()
    process.stdout.close()


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_no_alarm_is_lost_over_a_kill_and_none_doubled(store, store_url, mail, tmp_path, request):
    inbox, settings = mail
    running, port, began = [], free_port(), datetime.now(UTC)
    request.addfinalizer(lambda: [end(one) for one in running])
    webhook = hook(tmp_path, port)
    # The clock runs twenty times as fast, for what the killed hand held is free after 45 s.
    arguments = (store_url, str(settings.port), str(webhook.address_file), began.isoformat(), "20")
    command = [sys.executable, "-c", SERVE, *arguments]

    def started():
        running.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True))
        assert running[-1].stdout.readline() == "watching\n"
        return running[-1]

    def until(done):
        wait_until(done, lambda: store.alarms().items)

    def of(code):
        return [a for a in store.alarms(limit=100).items if a.message.code == code]

    store.watch_alarms([], [], began)
    store.log("alarm", "record", say("run-fit-killed", run="first"), "lab")
    first = started()
    until(lambda: [m for m in inbox.mails if "first" in m.get_payload(decode=True).decode()])  # mail up, hook down
    until(lambda: store.journal(level="warning").items)
    first.send_signal(signal.SIGKILL)
    first.wait(240)
    store.log("alarm", "record", say("run-fit-killed", run="second"), "lab")  # nobody watches
    late = Receiver(port)
    second = started()
    wanted = {"run-fit-killed", "health-process-never-seen"}
    until(lambda: of("health-process-never-seen"))
    until(lambda: len(of("run-fit-killed")) == 2 and len(late.posts) >= len(store.alarms(limit=100).items))
    until(lambda: len(inbox.mails) >= len(store.alarms(limit=100).items))
    second.stdin.close()
    assert second.wait(240) == 0
    late.close()
    numbers = sorted(a.number for a in store.alarms(limit=100).items)
    assert {a.message.code for a in store.alarms(limit=100).items} == wanted
    assert sorted(int(post["id"]) for _, post in late.posts) == numbers
    assert sorted(int(m["Message-ID"].split("-")[1].split(".")[0]) for m in inbox.mails) == numbers


def test_what_a_server_without_mail_raises_is_mailed_once_by_one_that_has_it(store, mail):
    inbox, settings = mail
    mails = ways_of(settings, None, "store")
    assert look(store, [], NOW, up_s=1.0) == 0
    look(store, mails, NOW, up_s=1.0)
    assert store.watch_alarms([HOT], [], seconds(2)) == 1  # the server without mail is faster
    store.log("alarm", "record", say("run-fit-killed", run="one"), "lab")
    assert store.watch_alarms([HOT], [], seconds(4)) == 1
    assert store.watch_alarms([HOT], [MAIL], seconds(6)) == 0
    assert [send_due(store, ways, lambda: datetime.now(UTC)) for ways in ([], mails, mails)] == [0, 2, 0]
    assert len({m["Message-ID"] for m in inbox.mails}) == 2


def test_servers_with_other_readers_and_receivers_over_one_store_reach_everybody_once(
    store, mail, receiver, tmp_path, request
):
    inbox, settings = mail
    other = Receiver()
    request.addfinalizer(other.close)
    (tmp_path / "other").mkdir()
    both = settings.model_copy(update={"to": ("shift@plant.example", "Boss@plant.example")})
    servers = [
        ways_of(settings, hook(tmp_path, receiver.port), "store"),
        ways_of(both, hook(tmp_path / "other", other.port), "store"),
    ]
    for ways in servers:
        store.watch_alarms([HOT], [way.name for way in ways], NOW)
    assert [send_due(store, ways, lambda: NOW) for ways in (*servers, *servers)] == [2, 2, 0, 0]
    assert sorted(m["To"] for m in inbox.mails) == ["Boss@plant.example", "shift@plant.example"]
    assert len({m["Message-ID"] for m in inbox.mails}) == 2
    assert [len(one.posts) for one in (receiver, other)] == [1, 1]
    assert "secret" not in repr(servers)


def test_what_stands_goes_by_a_way_that_is_new_and_what_is_over_does_not(store, mail):
    inbox, settings = mail
    ended = replace(HOT, key="ended")
    store.watch_alarms([HOT, ended], [], NOW)
    store.watch_alarms([HOT], [], seconds(30))
    store.watch_alarms([HOT], [], seconds(90))
    later = seconds(90) + timedelta(seconds=IN_USE_S)
    for at in (seconds(90), later, later + timedelta(seconds=IN_USE_S + 1)):  # there, still there, back again
        store.watch_alarms([HOT], [MAIL], at)
        assert send_due(store, ways_of(settings, None, "store"), lambda: seconds(90 + 4 * IN_USE_S)) in (0, 1)
    assert len(inbox.mails) == 1


def test_what_came_and_went_while_a_way_was_gone_is_not_sent_when_it_is_back(store, mail):
    inbox, settings = mail
    before, during = replace(HOT, key="before"), replace(HOT, key="during")
    store.watch_alarms([before], [MAIL], NOW)  # in its hands when it went
    store.watch_alarms([during], [], seconds(120))
    store.watch_alarms([], [], seconds(300))
    back = seconds(IN_USE_S + 60)
    store.watch_alarms([], [MAIL], back)
    assert [send_due(store, ways_of(settings, None, "store"), lambda: back) for _ in range(2)] == [1, 0]
    assert len(inbox.mails) == 1


def test_a_way_that_no_server_has_any_longer_is_not_queued_for(store):
    store.watch_alarms([], [MAIL, "webhook"], NOW)
    store.watch_alarms([], ["webhook"], seconds(IN_USE_S))
    store.watch_alarms([HOT], [], seconds(IN_USE_S + 1))
    assert store.take_delivery([MAIL], seconds(IN_USE_S + 2)) is None
    assert store.take_delivery(["webhook"], seconds(IN_USE_S + 2)) is not None


def test_two_servers_that_look_at_the_same_moment_raise_an_alarm_once(store, store_url):
    store.watch_alarms([], [MAIL], NOW)
    with ThreadPoolExecutor(4) as pool, ExitStack() as opened:
        stores = [opened.enter_context(open_store(store_url)) for _ in range(4)]
        for n in range(10):
            store.log("alarm", "record", say("run-fit-killed", run=f"run-{n}"), "lab")
            standing = [replace(HOT, key=f"hot-{n}")]
            list(pool.map(lambda s, now=standing: s.watch_alarms(now, [], NOW), stores))
    assert len(store.alarms(limit=100).items) == 20


@pytest.fixture
def serve_on(request, tmp_path):
    """Starts `kerntemp serve` over a store, with further configuration, until the test ends."""

    def start(name, url, more=""):
        config = tmp_path / f"{name}.toml"
        press = f'[[press]]\nname = "lab"\nfile = "{LAB.as_posix()}"\n[[press.logger]]\nname = "x"\n{LOGGER}'
        config.write_text(f'[store]\nurl = "{url}"\n{press}{more}', encoding="utf-8")
        command = [sys.executable, "-m", "api", "serve", "--config", str(config), "--port", str(free_port())]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        request.addfinalizer(lambda: end(process))
        assert process.stdout.readline()
        return process

    return start


def test_alarms_are_mailed_whichever_of_two_servers_raises_them(store, store_url, mail, serve_on):
    inbox, settings = mail
    to = f"sender = '{settings.sender}'\nto = {list(settings.to)}"
    email = f"[email]\nhost = '127.0.0.1'\nport = {settings.port}\n{to}\n"

    def until(done):
        wait_until(done, lambda: (store.alarms().items, inbox.mails))

    def log(run):
        store.log("alarm", "record", say("run-fit-killed", run=run), "lab")

    store.watch_alarms([], [], datetime.now(UTC))
    log("early")
    with_mail = serve_on("mails", store_url, email)
    until(lambda: inbox.mails)
    with_mail.kill()
    with_mail.wait(240)
    serve_on("plain", store_url)  # it has no [email]
    log("alone")
    until(lambda: "alone" in [a.message.arguments.get("run") for a in store.alarms(limit=100).items])
    serve_on("mails-again", store_url, email)
    for n in range(4):
        log(f"both-{n}")

    def raised():
        return sorted(a.number for a in store.alarms(limit=100).items)

    def mailed():
        return sorted(int(m["Message-ID"].split("-")[1].split(".")[0]) for m in list(inbox.mails))

    until(lambda: len(raised()) >= 6 and set(mailed()) == set(raised()))
    assert len(mailed()) == len(set(mailed()))


def press_with(store, platen=200.0, core=95.0, when=NOW):
    key = store.register_press("lab", CHANNELS, "")
    n = key.next_number
    scan = Scan(n, when, float(n), (platen, 199.0, 90.0), (Quality.GOOD,) * 3)
    closed = PressEvent(PressEventKind.CLOSED, float(n), float(n))
    store.append_scans(key, [scan], [closed], NewRun("lab-1", n, when, float(n)))
    store.append_estimates("lab", [StoredEstimate(n, float(n), "closed", core, 1.0, core - 2, core + 2, True)])


def crossed(store, now=NOW):
    return {a.message.code for a in standing_alarms(store, now) if a.key.startswith("threshold:")}


def test_limits_that_are_crossed_stand_in_health_and_nowhere_else(store):
    press_with(store)
    assert crossed(store) == set()
    limits = {"core_above_C": 94.0, "platen_below_C": 199.5, "platen_above_C": 210.0, "silence_s": 30.0}
    store.put_alarm_thresholds("lab", limits, "engineer")
    assert crossed(store) == {"alarm-core-above", "alarm-platen-below"}
    assert "lab: platen_bottom is below 199.5 °C" in health_of(store, NOW).alarms
    assert crossed(store, seconds(6)) == set()  # too old to say anything of the press now, as on the page
    assert crossed(store, seconds(20)) == set()
    assert crossed(store, seconds(31)) == {"alarm-silence"}
    store.put_diagnosis("lab", {"verdict": "unknown_effect"})
    store.put_alarm_thresholds("lab", {"verdict_unknown": True}, "engineer")
    assert crossed(store) == {"alarm-verdict"}
    store.put_diagnosis("lab", {"verdict": "named"})
    assert crossed(store) == set()


def test_a_limit_that_is_crossed_comes_before_all_else_that_is_wrong(store):
    press_with(store)
    store.put_alarm_thresholds("lab", {"platen_below_C": 199.5}, "engineer")
    store.log("alarm", "import", say("plain-text", text="a file is damaged"))
    first, second, *others = health_of(store, NOW).alarms
    assert (first, second) == ("lab: platen_bottom is below 199.5 °C", "a file is damaged")
    assert len(others) == 2  # record and sense were never seen


def test_a_silence_that_grows_from_seconds_to_hours_is_one_alarm(store):
    store.beat("record", {"state": "running"})
    began = datetime.now(UTC)
    for s in (0, 20, 9000):
        look(store, [], began + timedelta(seconds=s))
    assert [a.message.code for a in store.alarms().items if a.message.arguments["process"] == "record"] == [
        "health-process-silent"
    ]


def test_a_process_that_somebody_stopped_is_no_silent_one_however_long_ago(store):
    store.beat("record", {"state": "stopped"})
    began = datetime.now(UTC)
    for s in (0, 20, 9000):
        look(store, [], began + timedelta(seconds=s))
    found = [a.message for a in store.alarms().items if a.message.arguments["process"] == "record"]
    assert [words(one) for one in found] == ["record: was stopped; start kerntemp record"]
    assert words(found[0], "de") == "record: wurde beendet; kerntemp record starten"


@pytest.fixture
def plant(tmp_path, serve_any, tokens):
    with open_store(str(tmp_path / "kerntemp.sqlite")) as opened:
        press_with(opened)
        url = serve_any(opened) + "/api/v1"
        writer = {"Authorization": f"Bearer {tokens.create('engineer', 'write')}"}
        with httpx.Client(base_url=url, headers=writer, timeout=240) as client:
            yield opened, client, url


def test_an_engineer_sets_limits_and_acknowledges_by_rest(plant):
    store, client, url = plant
    answer = client.put("/alarms/thresholds/lab", json={"core_above_C": 94.0}).json()
    assert (answer["who"], answer["thresholds"]["core_above_C"], answer["thresholds"]["silence_s"]) == (
        "engineer",
        94,
        None,
    )
    assert client.get("/alarms/thresholds").json()["items"] == [answer]
    look(store, [], NOW)
    (alarm,) = client.get("/alarms?pending=true&press=lab").json()["items"]
    assert (alarm["message"], alarm["stands"]) == ("lab: the core is above 94 °C", False)  # that was long ago
    done = client.post(f"/alarms/{alarm['id']}/acknowledge").json()
    assert done["acknowledged_by"] == "engineer"
    assert client.get("/alarms?limit=1").json()["next_cursor"] is not None
    assert client.post("/alarms/999/acknowledge").status_code == 404
    assert client.put("/alarms/thresholds/elsewhere", json={}).status_code == 404
    assert client.put("/alarms/thresholds/lab", json={"core_abov_C": 1.0}).status_code == 422
    crossed = client.put("/alarms/thresholds/lab", json={"platen_below_C": 9.5, "platen_above_C": 8.0})
    assert crossed.status_code == 422
    assert re.search(r"too cold \(9\.5 °C\) .* too hot \(8 °C\)", crossed.json()["detail"])
    for change in (httpx.put, httpx.post):
        path = "/alarms/thresholds/lab" if change is httpx.put else f"/alarms/{alarm['id']}/acknowledge"
        assert change(url + path, json={}).status_code == 401


def test_health_and_the_list_of_alarms_tell_the_same_of_a_limit_at_any_moment(store, serve_any):
    press_with(store, when=datetime.now(UTC) - timedelta(seconds=30))
    url = serve_any(store) + "/api/v1"

    def shown():
        alarms = [a["message"] for a in httpx.get(url + "/alarms", timeout=240).json()["items"] if a["stands"]]
        return httpx.get(url + "/health", timeout=240).json()["alarms"], alarms

    for limits, stands in (({}, False), ({"silence_s": 20.0}, True), ({}, False), ({"silence_s": 20.0}, True)):
        store.put_alarm_thresholds("lab", limits, "engineer")
        assert [any(m.startswith("lab: ") for m in each) for each in shown()] == [stands, stands]
    assert len(store.alarms().items) == 1  # calm for less than a minute: the same one


def test_an_alarm_that_stands_says_for_how_long_by_now_and_one_that_is_over_as_it_was_raised(store):
    def silent(seconds):
        return say("health-process-silent", process="sense", seconds=seconds, command="sense")

    store.watch_alarms([StandingAlarm("silent", None, silent(15.0))], [], NOW)
    (stored,) = store.alarms().items
    texts = [alarm_of(stored, standing).message for standing in ({"silent": silent(290.0)}, {}, None)]
    assert texts == [str(silent(290.0)), str(silent(15.0)), str(silent(15.0))]
    assert "4 min 50 s" in texts[0]


def test_a_process_that_starts_with_the_watch_is_missed_only_when_it_could_have_spoken(store):
    assert look(store, [], NOW, up_s=1.0) == 0
    assert look(store, [], NOW, up_s=SILENT_S) == 2
    assert {alarm.message.code for alarm in store.alarms().items} == {NEVER_SEEN}
