"""A session of all processes with faults on every line: no secret is in anything it wrote, in any form."""

from __future__ import annotations

import html
import json
import subprocess
import sys
import urllib.request
from base64 import b64encode
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import quote, quote_plus

import psycopg
import pytest

from daq.store import open_store
from daq.store.records import RunStatus
from tests.api.test_alarm_secrets import answering
from tests.api.test_plant_mqtt import MOSQUITTO, Broker
from tests.daq.test_recorder import plant
from tests.daq.test_store_secrets import SECRET, WAYS, server_user  # noqa: F401
from tests.editions import edition
from tests.patience import wait_until

pytestmark = pytest.mark.campaign

MAIL, BROKER, HOOK = "sMtp p%w+77x", "mQtt p%w+88y", "h00k/tok en+99z"
SECTIONS = """
[server]
port = {server}
[mqtt]
host = "127.0.0.1"
port = {broker}
user = "eva"
password_file = "{folder}/secret/mqtt"
[email]
host = "127.0.0.1"
port = {mail}
sender = "k@plant.example"
to = ["eva@plant.example"]
user = "eva"
password_file = "{folder}/secret/mail"
[webhook]
address_file = "{folder}/secret/hook"
"""
ANSWERS = ("health", "events?limit=500", "alarms", "runs", "press", "nights", "channels", "models", "messages/de")


def forms(secret: str) -> set[str]:
    """Return how a secret may be written down: as it is, for addresses, JSON and pages, and as people log in."""
    spelt = {secret, quote(secret), quote(secret, safe=""), quote_plus(secret)}
    logins = [secret, f"\0eva\0{secret}", f"eva:{secret}"]
    encoded = {b64encode(login.encode()).decode().rstrip("=") for login in logins}
    return {*spelt, *encoded, *(json.dumps(one)[1:-1] for one in spelt), *(html.escape(one) for one in spelt)}


@pytest.mark.skipif(MOSQUITTO is None, reason="no mosquitto is installed: apt-get install mosquitto")
@pytest.mark.parametrize("way", list(WAYS)[: edition(1, len(WAYS))])
def test_no_secret_is_in_anything_that_a_session_with_faults_wrote(
    tmp_path: Path,
    server_user: Any,  # noqa: F811
    postgresql_url: str,
    way: str,
) -> None:
    user, place = server_user
    url, folder = WAYS[way].format(user=user, place=place), tmp_path / "plant"
    (folder / "secret").mkdir(parents=True)
    admin = postgresql_url.replace("+psycopg", "")
    with ExitStack() as stack:
        store = stack.enter_context(open_store(postgresql_url))
        made = stack.enter_context(plant(folder, speed=20.0, rate_hz=2.0, store=url))
        broker = Broker(tmp_path)
        stack.callback(broker.kill)
        broker.kill()
        broker._file.write_text(broker._file.read_text().replace("anonymous true", "anonymous false"))
        broker.start()
        mail = stack.enter_context(answering(b"220 mail\r\n", _mail))
        hook = stack.enter_context(answering(b"", _hook))
        (folder / "secret/mqtt").write_text(f"{BROKER}\n")
        (folder / "secret/mail").write_text(f"{MAIL}\n")
        (folder / "secret/hook").write_text(
            f"http://127.0.0.1:{hook}/{quote(HOOK)}?token={quote(HOOK, safe='')}\n"
        )
        sections = SECTIONS.format(server=0, broker=broker.port, mail=mail, folder=folder)
        made.config.write_text(f"{made.config.read_text()}{sections}# as IT wrote: {SECRET}\n")
        commands = {
            "record": ["-m", "daq.recording.recorder", str(made.config)],
            "sense": ["-m", "api", "sense", "--config", str(made.config)],
            "serve": ["-m", "api", "serve", "--config", str(made.config)],
            "publish": ["-m", "api", "publish", "--config", str(made.config)],
        }
        written = tmp_path / "written"
        written.mkdir()
        for name, command in commands.items():
            out = stack.enter_context((written / name).open("wb"))
            child = subprocess.Popen([sys.executable, *command], cwd=ROOT, stdout=out, stderr=out)
            stack.callback(child.wait)
            stack.callback(child.terminate)
            if name == "sense":
                sensing = child
        wait_until(lambda: store.runs(status=RunStatus.CLOSED).items)
        with psycopg.connect(admin, autocommit=True) as connection:
            connection.execute(
                "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE usename = %s", (user,)
            )
        made.config.write_text(made.config.read_text().replace("rate_hz = 2.0", "rate_hz = 99.0"))
        wait_until(lambda: "configuration-refused" in _codes(store))
        made.config.write_text(made.config.read_text().replace("rate_hz = 99.0", "rate_hz = 2.0"))
        sensing.kill()
        wait_until(lambda: sum(code == "alarm-not-delivered" for code in _codes(store)) >= 2)
        wait_until(lambda: "publish" in store.statuses() and store.statuses()["publish"].status["problems"])
        address = next(
            word for word in (written / "serve").read_text().split() if word.startswith("http://127.0.0.1:")
        ).rstrip("/.,;")
        for path in ANSWERS:
            with urllib.request.urlopen(f"{address}/api/v1/{path}") as answer:
                (written / path.replace("/", "-").partition("?")[0]).write_bytes(answer.read())
        with urllib.request.urlopen(f"{address}/metrics") as answer:
            (written / "metrics").write_bytes(answer.read())
        config = ["--config", str(made.config)]
        pressed = [one.run for one in store.runs(status=RunStatus.CLOSED).items]
        _command(written, "refit", *config)
        run = next(run for run in pressed if store.fit(run))
        for name in ("run.csv", "run.jsonl"):
            _command(written, "export", run, *config, "--out", str(written / name))
        pages = ("--json", str(written / "f.json"), "--html", str(written / "f.html"))
        _command(written, "fit", run, *config, "--press", str(made.config.parent / "lab.toml"), *pages)
        for command in (["export"], ["check"], ["check", "--offline"]):
            _command(written, *command, *config)
    with psycopg.connect(admin, autocommit=True) as connection:
        tables = connection.execute("SELECT tablename FROM pg_tables WHERE schemaname = 'public'").fetchall()
        for (table,) in tables:
            rows = connection.execute(f'SELECT t::text FROM "{table}" AS t').fetchall()
            (written / f"table-{table}").write_text("\n".join(row[0] for row in rows))
    found = {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()}
    looked_at = {path.name for path, content in found.items() if content}
    assert {
        "table-event",
        "table-configuration",
        "f.html",
        "run.csv",
        "run.jsonl",
        "events",
        "publish",
    } <= looked_at
    assert any(path.parent.name == "reports" for path in found), "the night's report"
    own = {made.config, *(folder / "secret").iterdir()}
    shown = [
        (path.relative_to(tmp_path), form)
        for path, content in found.items()
        if path not in own
        for secret in (SECRET, MAIL, BROKER, HOOK)
        for form in forms(secret)
        if form.encode() in content
    ]
    assert not shown


ROOT = Path(__file__).parents[2]


def _command(written: Path, *command: str) -> None:
    """Run a command of the terminal, and keep what it says."""
    done = subprocess.run([sys.executable, "-m", "api", *command], cwd=ROOT, capture_output=True, text=True)
    with (written / "terminal").open("a", encoding="utf-8") as out:
        out.write(done.stdout + done.stderr)


def _mail(asked: bytes) -> bytes:
    """Refuse whoever logs in, and repeat all that was sent."""
    if asked.startswith(b"EHLO"):
        return b"250-mail\r\n250 AUTH PLAIN LOGIN\r\n"
    return b"535 no: " + asked.strip() + b" " + MAIL.encode() + b"\r\n"


def _hook(asked: bytes) -> bytes:
    """Refuse what is posted, and repeat its address."""
    if not asked.startswith(b"POST"):
        return b""
    return b"HTTP/1.1 403 no: " + asked.split()[1] + b"\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


def _codes(store: Any) -> list[str]:
    return [entry.message.code for entry in store.journal(limit=500).items]
