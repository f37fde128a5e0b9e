"""A store of the first schema, killed while it is brought up to date, before any statement of it."""

import os
import signal

import pytest
from sqlalchemy import text

from daq.store import database, open_store
from tests.daq.test_store import record_one_run

pytestmark = pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")


def dies_before(number, store_url):
    """Open the store in a process of its own that is killed before that statement of all migrations."""
    child = os.fork()
    if child:
        assert os.WIFSIGNALED(os.waitpid(child, 0)[1]), "it came to its end"
        return
    real, done = database.statements, iter(range(10**6))

    def fatal(script, dialect):
        for statement in real(script, dialect):
            if next(done) == number:
                os.kill(os.getpid(), signal.SIGKILL)
            yield statement

    database.statements = fatal
    open_store(store_url)
    os._exit(0)


def contents(store_url, monkeypatch, steps):
    """Return what the store holds, seen as its own version sees it."""
    monkeypatch.setattr(database, "migrations", lambda: steps)
    with open_store(store_url) as store, store.database.reading() as connection:
        tables = ("scan", "run", "event", "fit")
        counts = {table: connection.execute(text(f"SELECT count(*) FROM {table}")).scalar() for table in tables}
        version = connection.execute(text("SELECT version FROM schema_version")).scalar()
    monkeypatch.undo()
    return counts, version


@pytest.mark.campaign
def test_killed_before_any_statement_of_its_migrations_a_store_stays_as_it_was(store_url, monkeypatch):
    steps = database.migrations()
    first = {1: steps[1]}
    monkeypatch.setattr(database, "migrations", lambda: first)
    monkeypatch.setattr("daq.store.recording.take_next_panel", lambda *_: {})  # the first schema knew none
    with open_store(store_url) as store:
        name = record_one_run(store)
        with store.database.writing() as connection:
            connection.exec_driver_sql(f"INSERT INTO fit VALUES (1, '{name}', 0.0, 'v1', 1, 0.3, '{{}}')")
        dialect = store.database.dialect
    monkeypatch.undo()
    before = contents(store_url, monkeypatch, first)
    assert before[1] == 1
    last = sum(len(database.statements(sql, dialect)) for number, sql in steps.items() if number > 1)
    for number in range(last):
        dies_before(number, store_url)
        assert contents(store_url, monkeypatch, first) == before, number
    with open_store(store_url) as store:
        assert len(store.load_run(name).time_s) == 37
        assert store.contents().schema == max(steps)
