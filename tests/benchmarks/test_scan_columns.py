"""Readings of a scan kept as text, as a typed column each, as one binary value, side by side on both engines.

60,000 scans of 16 channels at 0.1 K in one table of the store's shape. Asserts that every bit comes back; sizes
and rates are printed, and their ratios to text, which the store keeps.
"""

import time

import numpy as np
import pytest
from sqlalchemy import BigInteger, Column, Double, LargeBinary, MetaData, Table, Text, insert, select, text

from daq.store.convert import readings_json, readings_table
from daq.store.database import Database
from tests.daq.test_store_archive import heating

SCANS, CHANNELS, AT_ONCE = 60_000, 16, 1000
NAMES = [f"c{i}" for i in range(CHANNELS)]


def columns_of(kept):
    """Return the columns that hold a scan's readings."""
    if kept == "typed columns":
        return [Column(name, Double) for name in NAMES]
    return [Column("readings", Text if kept == "text" else LargeBinary)]


def cells_of(kept, values):
    """Return a scan's readings as rows hold them."""
    if kept == "typed columns":
        return dict(zip(NAMES, values, strict=True))
    return {"readings": readings_json(values) if kept == "text" else np.array(values).tobytes()}


def table_of(kept, rows):
    """Return the readings of rows (scans, channels)."""
    if kept == "typed columns":
        return np.array(rows, dtype=float)
    cells = [cell for (cell,) in rows]
    return (
        readings_table(cells, CHANNELS) if kept == "text" else np.frombuffer(b"".join(cells)).reshape(-1, CHANNELS)
    )


def measured(database, kept, values):
    """Return bytes a scan, and scans written and read a second."""
    schema = MetaData()
    head = [Column(name, BigInteger, primary_key=True) for name in ("press_id", "number")]
    times = [Column(name, Double) for name in ("unix_s", "monotonic_s")]
    readings = columns_of(kept)
    made = {"sqlite_with_rowid": False}
    table = Table(f"kept_{len(kept)}", schema, *head, *times, Column("layout_id", BigInteger), *readings, **made)
    before = database_bytes(database)
    schema.create_all(database.engine)
    began = time.perf_counter()
    for start in range(0, SCANS, AT_ONCE):
        rows = [
            {"press_id": 1, "number": n, "unix_s": 1.7e9 + n / 10, "monotonic_s": n / 10, "layout_id": 1}
            | cells_of(kept, values[n].tolist())
            for n in range(start, start + AT_ONCE)
        ]
        with database.writing() as connection:
            connection.execute(insert(table), rows)
    written = SCANS / (time.perf_counter() - began)
    began = time.perf_counter()
    with database.reading() as connection:
        found = connection.execute(select(*readings).order_by(table.c.number)).all()
    back = table_of(kept, found)
    read = SCANS / (time.perf_counter() - began)
    assert back.tobytes() == values.tobytes()
    return (database_bytes(database) - before) / SCANS, written, read


def database_bytes(database):
    """Return how large the store is, with nothing left in its log."""
    with database.engine.connect() as connection:
        if database.dialect == "postgresql":
            return connection.execute(text("SELECT pg_database_size(current_database())")).scalar()
        connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
    return database.path.stat().st_size


@pytest.mark.benchmark
@pytest.mark.timeout(300)
def test_readings_as_text_as_typed_columns_and_as_one_binary_value(store_url):
    database = Database(store_url)
    values = heating(SCANS) * 0.1
    values = np.array([[float(f"{v:.9g}") for v in row] for row in values.tolist()])
    found = {kept: measured(database, kept, values) for kept in ("text", "typed columns", "binary")}
    print(f"\n{database.dialect}, {SCANS} scans of {CHANNELS} channels; in brackets the ratio to text")
    for kept, figures in found.items():
        size, written, read = ((f, f / t) for f, t in zip(figures, found["text"], strict=True))
        print(
            f"{kept:14} {size[0]:5.0f} bytes a scan ({size[1]:.2f})"
            f"  written {written[0]:7.0f}/s ({written[1]:.2f})  read {read[0]:7.0f}/s ({read[1]:.2f})"
        )
    database.close()
