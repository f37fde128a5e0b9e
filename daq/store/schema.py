"""The tables as SQLAlchemy sees them, each after those it refers to: copies of a store go in this order.

The migrations make them; a test holds the two together.

Readings of a scan are text here, typed columns in the archive. A column for each channel was measured
(`tests/benchmarks/test_scan_columns.py`): about as large, written no faster and read at an eighth to a half of
the rate; one binary value is larger and is read faster, but no SQL tool can read it, and a press's view shows
channels by name.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import BigInteger, Column, Double, MetaData, Table, Text
from sqlalchemy.types import TypeEngine

METADATA = MetaData()


def _table(table: str, key: str, /, **columns: type[TypeEngine[Any]]) -> Table:
    keys = key.split()
    return Table(table, METADATA, *(Column(c, kind(), primary_key=c in keys) for c, kind in columns.items()))


PRESS = _table(
    "press", "press_id", press_id=BigInteger, name=Text, kind=Text, press_file=Text, created_unix_s=Double
)
LAYOUT = _table(
    "channel_layout",
    "layout_id",
    layout_id=BigInteger,
    press_id=BigInteger,
    columns_json=Text,
    created_unix_s=Double,
)
SCAN = _table(
    "scan",
    "press_id number",
    press_id=BigInteger,
    number=BigInteger,
    unix_s=Double,
    monotonic_s=Double,
    layout_id=BigInteger,
    readings=Text,
    faults=Text,
)
SCAN_REMARK = _table("scan_remark", "press_id number", press_id=BigInteger, number=BigInteger, texts_json=Text)
IDLE_THINNED = _table("idle_thinned", "press_id", press_id=BigInteger, number=BigInteger)
CONFIGURATION = _table(
    "configuration", "configuration_id", configuration_id=BigInteger, text=Text, created_unix_s=Double
)
RUN = _table(
    "run",
    "run_number",
    run_number=BigInteger,
    run=Text,
    press_id=BigInteger,
    status=Text,
    ended_unix_s=Double,
    zero_monotonic_s=Double,
    first_scan=BigInteger,
    last_scan=BigInteger,
    inserted_s=Double,
    closed_s=Double,
    opened_s=Double,
    removed_s=Double,
    panel_material=Text,
    panel_thickness_mm=Double,
    header_toml=Text,
    remark=Text,
    configuration_id=BigInteger,
    software_version=Text,
    started_unix_s=Double,
)
ARCHIVE = _table(
    "archive",
    "run",
    run=Text,
    file=Text,
    sha256=Text,
    bytes=BigInteger,
    scans=BigInteger,
    layouts_json=Text,
    archived_unix_s=Double,
    checked_unix_s=Double,
    problem=Text,
    removed_unix_s=Double,
    estimates_sha256=Text,
    core_at_opening_celsius=Double,
    core_band_kelvin=Double,
    core_highest_celsius=Double,
)
ARCHIVE_TOTAL = _table(
    "archive_total",
    "place",
    place=BigInteger,
    folder=Text,
    runs=BigInteger,
    scans=BigInteger,
    bytes=BigInteger,
    removed=BigInteger,
)
RUN_CHANGE = _table(
    "run_change",
    "run_change_id",
    run_change_id=BigInteger,
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
    press_event_id=BigInteger,
    press_id=BigInteger,
    kind=Text,
    unix_s=Double,
    monotonic_s=Double,
    noticed_monotonic_s=Double,
    scan_number=BigInteger,
    source=Text,
)
ESTIMATE = _table(
    "estimate",
    "press_id number",
    press_id=BigInteger,
    number=BigInteger,
    monotonic_s=Double,
    state=Text,
    core_celsius=Double,
    core_sd_kelvin=Double,
    core_low_celsius=Double,
    core_high_celsius=Double,
    valid=BigInteger,
    reason=Text,
    model_version=Text,
    detail_json=Text,
)
FIT = _table(
    "fit",
    "fit_id",
    fit_id=BigInteger,
    run=Text,
    created_unix_s=Double,
    model_version=Text,
    converged=BigInteger,
    rmse_kelvin=Double,
    fit_json=Text,
)
NEWEST_FIT = _table("newest_fit", "press_id", press_id=BigInteger, fit_id=BigInteger)
COEFFICIENT = _table(
    "coefficient",
    "fit_id name",
    fit_id=BigInteger,
    name=Text,
    value_w_m2k=Double,
    sd_w_m2k=Double,
    low_w_m2k=Double,
    high_w_m2k=Double,
    identifiable=BigInteger,
)
MODEL = _table(
    "model",
    "model_number",
    model_number=BigInteger,
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
    diagnosis_id=BigInteger,
    press=Text,
    created_unix_s=Double,
    verdict=Text,
    diagnosis_json=Text,
)
EVENT = _table(
    "event",
    "event_id",
    event_id=BigInteger,
    unix_s=Double,
    level=Text,
    process=Text,
    press=Text,
    message=Text,
    detail_json=Text,
    message_json=Text,
)
STATUS = _table("status", "process", process=Text, unix_s=Double, status_json=Text)
NEXT_PANEL = _table("next_panel", "press", press=Text, unix_s=Double, who=Text, recipe=Text, header_toml=Text)
RECIPE = _table("recipe", "name", name=Text, header_toml=Text)
NIGHT = _table(
    "night",
    "night_id",
    night_id=BigInteger,
    press=Text,
    started_unix_s=Double,
    ended_unix_s=Double,
    night_json=Text,
    progress_json=Text,
)
UNFITTED = _table("unfitted", "run", run=Text, press=Text, kind=Text, fingerprint=Text)
ALARM = _table(
    "alarm",
    "alarm_id",
    alarm_id=BigInteger,
    key=Text,
    press=Text,
    message_json=Text,
    raised_unix_s=Double,
    seen_unix_s=Double,
    ended_unix_s=Double,
    acknowledged_unix_s=Double,
    acknowledged_by=Text,
)
ALARM_DELIVERY = _table(
    "alarm_delivery",
    "alarm_id way",
    alarm_id=BigInteger,
    way=Text,
    due_unix_s=Double,
    tries=BigInteger,
    delivered_unix_s=Double,
    problem=Text,
)
ALARM_POSITION = _table("alarm_position", "journal", journal=Text, event_id=BigInteger)
ALARM_WAY = _table("alarm_way", "way", way=Text, seen_unix_s=Double)
ALARM_THRESHOLD = _table("alarm_threshold", "press", press=Text, unix_s=Double, who=Text, thresholds_json=Text)
