"""Stores of both kinds, each test with one of its own."""

import os
import secrets

import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.exc import OperationalError

SERVER = os.environ.get("KERNTEMP_TEST_POSTGRESQL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")


def _postgresql(run_in):
    pytest.importorskip("psycopg", reason="the PostgreSQL driver is not installed: pip install psycopg[binary]")
    engine = create_engine(SERVER, isolation_level="AUTOCOMMIT", connect_args={"connect_timeout": 2})
    try:
        with engine.connect() as connection:
            connection.execute(text(run_in))
    except OperationalError as error:
        pytest.skip(f"no PostgreSQL server answers at {SERVER}: {str(error.orig).splitlines()[0]}")
    finally:
        engine.dispose()


@pytest.fixture
def postgresql_url():
    """A database of its own on the test server; skipped where no server runs."""
    name = f"kt_{secrets.token_hex(6)}"
    _postgresql(f"CREATE DATABASE {name}")
    yield SERVER.rpartition("/")[0] + "/" + name
    _postgresql(f"DROP DATABASE {name} WITH (FORCE)")


@pytest.fixture(params=["sqlite", "postgresql"])
def store_url(request, tmp_path):
    """The same test against both engines."""
    if request.param == "sqlite":
        return str(tmp_path / "plant.sqlite")
    return request.getfixturevalue("postgresql_url")
