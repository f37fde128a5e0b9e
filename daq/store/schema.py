"""The tables as SQLAlchemy sees them. The migrations make them; a test holds the two together."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Column, Double, Integer, MetaData, Table, Text
from sqlalchemy.types import TypeEngine

METADATA = MetaData()


def _table(table: str, key: str, /, **columns: type[TypeEngine[Any]]) -> Table:
    keys = key.split()
    return Table(table, METADATA, *(Column(c, kind(), primary_key=c in keys) for c, kind in columns.items()))


PRESS = _table("press", "press_id", press_id=Integer, name=Text, kind=Text, press_file=Text, created_unix_s=Double)
LAYOUT = _table(
    "channel_layout", "layout_id", layout_id=Integer, press_id=Integer, columns_json=Text, created_unix_s=Double
)
SCAN = _table(
    "scan",
    "press_id number",
    press_id=Integer,
    number=Integer,
    unix_s=Double,
    monotonic_s=Double,
    layout_id=Integer,
    readings=Text,
    faults=Text,
)
CONFIGURATION = _table(
    "configuration", "configuration_id", configuration_id=Integer, text=Text, created_unix_s=Double
)
RUN = _table(
    "run",
    "run_number",
    run_number=Integer,
    run=Text,
    press_id=Integer,
    status=Text,
    started_unix_s=Double,
    ended_unix_s=Double,
    zero_monotonic_s=Double,
    first_scan=Integer,
    last_scan=Integer,
    inserted_s=Double,
    closed_s=Double,
    opened_s=Double,
    removed_s=Double,
    panel_material=Text,
    panel_thickness_mm=Double,
    header_toml=Text,
    remark=Text,
    configuration_id=Integer,
    software_version=Text,
)
RUN_CHANGE = _table(
    "run_change",
    "run_change_id",
    run_change_id=Integer,
    run=Text,
    unix_s=Double,
    who=Text,
    field=Text,
    before_toml=Text,
    after_toml=Text,
)
PRESS_EVENT = _table(
    "press_event",
    "press_event_id",
    press_event_id=Integer,
    press_id=Integer,
    kind=Text,
    unix_s=Double,
    monotonic_s=Double,
    noticed_monotonic_s=Double,
    scan_number=Integer,
    source=Text,
)
ESTIMATE = _table(
    "estimate",
    "press_id number",
    press_id=Integer,
    number=Integer,
    monotonic_s=Double,
    state=Text,
    core_celsius=Double,
    core_sd_kelvin=Double,
    core_low_celsius=Double,
    core_high_celsius=Double,
    valid=Integer,
    reason=Text,
    model_version=Text,
    detail_json=Text,
)
FIT = _table(
    "fit",
    "fit_id",
    fit_id=Integer,
    run=Text,
    created_unix_s=Double,
    model_version=Text,
    converged=Integer,
    rmse_kelvin=Double,
    fit_json=Text,
)
COEFFICIENT = _table(
    "coefficient",
    "fit_id name",
    fit_id=Integer,
    name=Text,
    value=Double,
    sd=Double,
    low=Double,
    high=Double,
    identifiable=Integer,
)
MODEL = _table(
    "model",
    "model_number",
    model_number=Integer,
    version=Text,
    press=Text,
    created_unix_s=Double,
    status=Text,
    reason=Text,
    model_json=Text,
)
DIAGNOSIS = _table(
    "diagnosis",
    "diagnosis_id",
    diagnosis_id=Integer,
    press=Text,
    created_unix_s=Double,
    verdict=Text,
    diagnosis_json=Text,
)
EVENT = _table(
    "event",
    "event_id",
    event_id=Integer,
    unix_s=Double,
    level=Text,
    process=Text,
    press=Text,
    message=Text,
    detail_json=Text,
)
STATUS = _table("status", "process", process=Text, unix_s=Double, status_json=Text)
