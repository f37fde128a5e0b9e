"""A database's password never leaves the process: searched for in all that a session with faults wrote."""

import os
import subprocess
import sys
from pathlib import Path

import psycopg
import pytest

from daq.address import Address, hidden
from daq.process.config import load_config
from daq.records import InputError
from daq.store import open_store
from tests.daq.test_recorder import plant, wait_until

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
                wait_until(lambda: store.runs().items, 60)
                with psycopg.connect(postgresql_url.replace("+psycopg", ""), autocommit=True) as connection:
                    connection.execute(
                        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE usename = %s", (user,)
                    )
                made.config.write_text(made.config.read_text().replace("rate_hz = 2.0", "rate_hz = 99.0"))
                wait_until(lambda: any(e.message.code == "configuration-refused" for e in store.journal().items))
            finally:
                child.terminate()
        told = [error.read_text()]
        told += [f"{e.message} {e.message.to_json()} {e.detail}" for e in store.journal(limit=1000).items]
        told += [str(s.status) for s in store.statuses().values()]
        told += [store.configuration_of(run.run) for run in store.runs().items]
        told += [repr(load_config_of(made)), str(load_config_of(made).store.url)]
    assert any("[[press]]" in text for text in told)
    for secret in (SECRET, "gehei%20mnis-4711", "mnis-4711"):
        assert not [text for text in told if secret in text]


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
