"""What all tests share: a guardian, no missing parts in CI, and stores of both kinds, each test with its own."""

import gc
import os
import secrets
import sys

import pytest
from hypothesis import settings
from sqlalchemy import create_engine, text
from sqlalchemy.exc import OperationalError

from api.cli import ONE_THREAD
from tests.guarding import guard

os.environ.setdefault(ONE_THREAD, "1")  # as the command line does, before anything imports NumPy
SERVER = os.environ.get("KERNTEMP_TEST_POSTGRESQL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")


NO_PARTS = ("measured files are not here", "this kernel has no such seal", "no small file system can be mounted")
"""Reasons to skip that stand in CI too: what nobody can install there."""


settings.register_profile("unhurried", deadline=None)
"""A busy machine fails no test."""


def pytest_configure():
    settings.load_profile("unhurried")
    _keep_bytecode()
    guard()
    gc.disable()  # until all is collected: none of it goes, and looking through it again and again takes 4 of 10 s


def pytest_collection_finish():
    gc.freeze()
    gc.enable()


def _keep_bytecode():
    """Compile each module once, not in every worker and in every program that a test starts."""
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def pytest_collection_modifyitems(items):
    """Begin with the gates: the type checker takes longest, and at the end everybody would wait for it."""
    items.sort(key=lambda item: item.path.name != "test_gates.py")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    """Let no missing part pass where KERNTEMP_ALL_PARTS says that all are there, as CI does."""
    report = yield
    if report.skipped and not hasattr(report, "wasxfail") and os.environ.get("KERNTEMP_ALL_PARTS"):
        reason = report.longrepr[2].removeprefix("Skipped: ")
        if not reason.startswith(NO_PARTS):
            report.outcome, report.longrepr = "failed", f"skipped where no part may be missing: {reason}"
    return report


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
