"""A database's password never leaves the process: searched for in all that a session with faults wrote."""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import psycopg
import pytest

from api.cli import main
from daq.address import Address, hidden, text_without
from daq.process.config import load_config
from daq.records import InputError
from daq.store import open_store
from daq.words import say
from tests.daq.test_config import PRESSES
from tests.daq.test_recorder import plant
from tests.patience import wait_until

SECRET = "gehei mnis-4711"
WAYS = {
    "in the query": "postgresql://{user}@{place}?password=gehei%20mnis-4711",
    "with a blank": "postgresql://{user}:gehei mnis-4711@{place}",
    "escaped": "postgresql://{user}:gehei%20mnis-4711@{place}",
}


@pytest.fixture
def server_user(postgresql_url):
    """A user with the secret as password, who owns the test's database."""
    admin = postgresql_url.replace("+psycopg", "")
    name = "u" + admin.rpartition("_")[2]
    with psycopg.connect(admin, autocommit=True) as connection:
        connection.execute(f"CREATE ROLE {name} LOGIN PASSWORD '{SECRET}' SUPERUSER")
    yield name, admin.rpartition("@")[2]
    with psycopg.connect(admin, autocommit=True) as connection:
        connection.execute(f"REASSIGN OWNED BY {name} TO CURRENT_USER")
        connection.execute(f"DROP ROLE {name}")


@pytest.mark.skipif(os.name == "nt", reason="needs a PostgreSQL server of POSIX")
@pytest.mark.parametrize("way", WAYS)
def test_a_password_is_nowhere_in_what_a_session_with_faults_wrote(tmp_path, server_user, postgresql_url, way):
    user, place = server_user
    url = WAYS[way].format(user=user, place=place)
    with plant(tmp_path, speed=20.0, rate_hz=2.0, store=url) as made, open_store(postgresql_url) as store:
        made.config.write_text(made.config.read_text() + f"# as told by IT: {SECRET}\n")
        command = [sys.executable, "-m", "daq.recording.recorder", str(made.config)]
        error = tmp_path / "stderr"
        with (
            error.open("wb") as written,
            subprocess.Popen(command, cwd=Path(__file__).parents[2], stdout=written, stderr=written) as child,
        ):
            try:
                wait_until(lambda: store.runs().items)
                with psycopg.connect(postgresql_url.replace("+psycopg", ""), autocommit=True) as connection:
                    connection.execute(
                        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE usename = %s", (user,)
                    )
                made.config.write_text(made.config.read_text().replace("rate_hz = 2.0", "rate_hz = 99.0"))
                wait_until(lambda: any(e.message.code == "configuration-refused" for e in store.journal().items))
            finally:
                child.terminate()
        texts = [error.read_text()]
        texts += [f"{e.message} {e.message.to_json()} {e.detail}" for e in store.journal(limit=1000).items]
        texts += [str(s.status) for s in store.statuses().values()]
        texts += [store.configuration_of(run.run) for run in store.runs().items]
        texts += [repr(load_config_of(made)), str(load_config_of(made).store.url)]
    assert any("[[press]]" in text for text in texts)
    for secret in (SECRET, "gehei%20mnis-4711", "mnis-4711"):
        assert not [text for text in texts if secret in text]


def load_config_of(made):
    made.config.write_text(made.config.read_text().replace("rate_hz = 99.0", "rate_hz = 2.0"))
    return load_config(made.config)


@pytest.mark.parametrize(
    "url",
    ["postgresql://eva:se@cret@db/plant", "postgresql://eva:secret@db:port/plant", "nothing://eva:secret@db"],
)
def test_a_refused_address_is_named_without_its_password(url):
    with pytest.raises(InputError) as caught:
        open_store(url)
    assert "cret" not in str(caught.value)


def test_an_address_prints_no_password_and_is_compared_whole():
    url = Address("postgresql://eva:se cret@db.plant/kerntemp?password=x&sslmode=require")
    assert url == "postgresql://eva:se cret@db.plant/kerntemp?password=x&sslmode=require"
    assert f"{url}" == str(url) == "postgresql://eva:***@db.plant/kerntemp?***"
    assert "cret" not in repr([url])
    assert hidden("sqlite:///a?b@c.sqlite") == "sqlite:///a?b@c.sqlite"
    assert hidden("plant.sqlite") == "plant.sqlite"


WHOLE = (
    "postgresql://[::1]:5432/x?password=S3cr3tPw",
    "postgresql://%2Frun/x?password=S3cr3tPw",
    "postgresql://h:5432,h2:5433/x?password=S3cr3tPw",
    "postgresql://h/my%20db?password=S3cr3tPw",
    "postgresql://h/x?password=S3cr3t@Pw",
    "postgresql://eva:12?S3cr3tPw@h",
    "postgresql://eva:12@3?S3cr3tPw@h",
    "postgresql://eva:12/S3cr3tPw@h/x",
    "postgresql://h/x;password=S3cr3tPw",
    "sqlite+pysqlcipher://:S3cr3tPw@/x.sqlite",
)
MISTYPED = (
    "postgresql:/eva:S3cr3tPw@h/x",
    "eva:S3cr3tPw@h",
    "eva:S3cr3tPw@h/x",
    "host=h user=eva password=S3cr3tPw",
    "host=h user=eva password = S3cr3tPw",
)
FRAGMENTS = ("S3cr", "3tPw", "eva:12")


@pytest.mark.parametrize("url", [*WHOLE, *MISTYPED])
def test_no_form_of_an_address_shows_its_password_whatever_is_done_with_it(url):
    address = Address(url)
    for text in (str(address), repr(address), f"{address}", f"{address!s:>80}", f"{vars_of(address)}"):
        assert not [fragment for fragment in FRAGMENTS if fragment in text]
    for misuse in (
        lambda: json.dumps({"url": address}),
        lambda: ",".join([address]),
        lambda: "store " + address,
        lambda: address + "",
        lambda: address[:5],
        lambda: address.strip(),
        lambda: address.replace("x", "y"),
        lambda: list(address),
    ):
        with pytest.raises((TypeError, AttributeError)):
            misuse()
    assert address.revealed() == url
    assert pickle.loads(pickle.dumps(address)) == address  # a worker connects too


def vars_of(address):
    return getattr(address, "__dict__", {})


@pytest.mark.parametrize("url", [*WHOLE, *MISTYPED])
def test_a_configuration_kept_with_a_run_holds_no_password(url, tmp_path):
    text = f'{press_and_logger(tmp_path)}\n[store]\nurl = "{url}"\n# url = "{url}"\n'
    kept = text_without(text, Address(url))
    assert not [fragment for fragment in FRAGMENTS if fragment in kept and url not in MISTYPED[1:3]]
    assert "[[press]]" in kept


def test_a_commented_out_address_and_password_are_not_kept_either(tmp_path):
    (tmp_path / "kerntemp.toml").write_text(
        '# url = "postgresql://e:0ldS3cr3t@h/x"\n#url="postgresql:/e:0ld \'S3cr3t@h/x"  # till May\n'
        "# password = '0ldS3cr3t'\n# psql 'host=h password=0ldS3cr3t'\n" + press_and_logger(tmp_path)
    )
    kept = load_config(tmp_path / "kerntemp.toml").text
    assert "S3cr3t" not in kept
    assert kept.endswith(press_and_logger(tmp_path))


def press_and_logger(folder):
    (folder / "lab.toml").write_text((PRESSES / "lab.toml").read_text())
    return """[[press]]
name = "lab"
file = "lab.toml"
[[press.logger]]
name = "platens"
profile = "adam-6018+"
host = "127.0.0.1"
channels = ["platen_top", "platen_bottom"]
[mqtt]
host = "h"
password_file = "mqtt.txt"
"""


@pytest.mark.parametrize("url", [*MISTYPED, *WHOLE])
def test_what_is_no_path_is_refused_before_a_file_is_made_and_not_printed(url, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kerntemp.toml").write_text(f'{press_and_logger(tmp_path)}[store]\nurl = "{url}"\n')
    there = sorted(tmp_path.iterdir())
    assert main(["check", "--offline"]) in (1, 2)
    assert main(["export", "x", "--store", url]) in (1, 2)
    output = "".join(capsys.readouterr())
    assert "store" in output
    assert not [fragment for fragment in FRAGMENTS if fragment in output]
    assert sorted(tmp_path.iterdir()) == there


@pytest.mark.parametrize("table", ["[store]\nulr", "[stor]\nurl", "url", "[store]\nkeep_idle_days"])
@pytest.mark.parametrize("url", ["postgresql://eva:S3cr3tPw@h/x", "postgresql:/eva:S3cr3tPw@h/x"])
def test_an_address_under_a_mistyped_key_is_not_printed(url, table, tmp_path):
    text = press_and_logger(tmp_path)
    (tmp_path / "kerntemp.toml").write_text(f'{table} = "{url}"\n{text}')
    with pytest.raises(InputError) as caught:
        load_config(tmp_path / "kerntemp.toml")
    assert "S3cr3tPw" not in str(caught.value)


def test_a_folder_with_an_at_sign_is_a_folder_where_it_is_there(tmp_path):
    home = tmp_path / "eva@plant.local"
    home.mkdir()
    (home / "kerntemp.toml").write_text(press_and_logger(home))
    with open_store(load_config(home / "kerntemp.toml").store.url) as store:
        assert store.label == str(home / "kerntemp.sqlite")


ASTRAY = """fit {url} --press p|fit a --press {url}|check --config {url}|export {url}|import {url} --press p
backup {url}
predict {url} --press p --out o|simulate a --press {url} --out o|diagnose {url}|record {url}|sense --config {url}
serve --config {url}|refit --config {url}|publish --config {url}|token {url}|calibrate --room {url}|{url}
probe --port {url}|probe --host {url}|demo --hide {url}|demo --port {url}|plan {url} --press p
advise --press {url} --model m|advise --press p --model {url}|fit a --press p --until {url}"""


@pytest.mark.parametrize("url", ["postgresql://eva:S3cr3tPw@h.invalid/x", "eva:S3cr3tPw@h.invalid/x"])
@pytest.mark.parametrize("call", ASTRAY.replace("\n", "|").split("|"))
def test_an_address_where_none_belongs_is_refused_without_its_password(call, url, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(call.format(url=url).split()) in (1, 2)
    assert not [fragment for fragment in FRAGMENTS if fragment in "".join(capsys.readouterr())]


def test_no_message_keeps_a_password_that_somebody_typed_or_a_library_says():
    kept = say("plain-text", text="cannot reach mqtt://eva:S3cr3tPw@broker", more=["eva:S3cr3tPw@h", "top_1"])
    assert "S3cr3tPw" not in json.dumps(kept.to_json())
    assert say("plain-text", text="12:30 /home/eva@plant/x http://h:80").arguments["text"].count("*") == 0
