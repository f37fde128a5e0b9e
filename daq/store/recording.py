"""What recorder and import write: presses, scans, press events, runs. Each function works in one transaction."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Literal

from sqlalchemy import Connection, and_, func, insert, select, text, true, update
from sqlalchemy.exc import IntegrityError

from daq.address import masked
from daq.files.qualities import QUALITY, row_faults
from daq.press.header import new_doubts
from daq.records import Channel, InputError, PressEvent, Quality, Run, Scan
from daq.store.convert import faults_json, header_of, header_text, known_utc, null, readings_json, unix_of
from daq.store.journal import log
from daq.store.last_written import LastWritten
from daq.store.next_panel import take_next_panel
from daq.store.origin import LATEST_UNIX_S, REMARK, columns_from_header
from daq.store.reading import has_run, run_row
from daq.store.records import (
    NewRun,
    NumbersTaken,
    PressGone,
    PressKey,
    RunChange,
    RunEnd,
    RunStatus,
    ScansUnreadable,
)
from daq.store.run_ends import changes_of_short
from daq.store.schema import CONFIGURATION, LAYOUT, PRESS, PRESS_EVENT, RUN, RUN_CHANGE, SCAN, SCAN_REMARK
from daq.store.sound_rows import rows_with_damage, stored_header
from daq.tables import unseen
from daq.words import say

PROCESS = "record"
"""Who the journal says found out what a write brings to light."""
Kind = Literal["recorded", "imported"]
_NAME = re.compile(r"(?!\.{1,2}$)[^\x00-\x1f\x7f-\x9f/\\]+")
"""A run's name is a file's name on export, part of a URL, and a cell of a list."""

# Numbers without another source were set by hand, 2026-11.

_LONGEST_RUN_NAME = 200
"""A file system takes 255, an ending and a draft's sign among them. [bytes]"""
_ROWS_AT_ONCE = 1 << 13
"""Rows of a run imported in one statement: a long run never stands in memory twice."""


def register_press(
    connection: Connection, name: str, channels: Sequence[Channel], press_file: str = "", kind: Kind = "recorded"
) -> PressKey:
    """Return the press's key, made or brought up to date."""
    now = unix_of(datetime.now(UTC))
    row = connection.execute(select(PRESS).where(PRESS.c.name == name, PRESS.c.kind == kind)).first()
    if row is None:
        press_id = _inserted(connection, PRESS, name=name, kind=kind, press_file=press_file, created_unix_s=now)
    else:
        press_id = int(row.press_id)
        if press_file and press_file != row.press_file:
            connection.execute(update(PRESS).where(PRESS.c.press_id == press_id).values(press_file=press_file))
    layout_id = (
        layout_of(connection, press_id, name, channels)
        if kind == "recorded"
        else _layout(connection, press_id, channels, now)
    )
    return PressKey(press_id, name, layout_id, tuple(channels), _next_number(connection, press_id))


def layout_of(connection: Connection, press_id: int, press: str, channels: Sequence[Channel]) -> int:
    """Return the number of a recorded press's layout, made where it is new; the press's view shows it."""
    layout_id = _layout(connection, press_id, channels, unix_of(datetime.now(UTC)))
    _make_view(connection, press, press_id, layout_id, channels)
    return layout_id


def with_layouts(connection: Connection, keys: Iterable[PressKey]) -> dict[PressKey, PressKey]:
    """Return keys by themselves with the layouts their channels have in the store now, made where they lack.

    A store that went back to an older state may lack a layout, or have given its number to another press.
    """
    asked = dict.fromkeys(keys)
    ids = {key.press_id for key in asked}
    newest = select(func.max(LAYOUT.c.layout_id), LAYOUT.c.press_id, LAYOUT.c.columns_json)
    grouped = newest.where(LAYOUT.c.press_id.in_(ids)).group_by(LAYOUT.c.press_id, LAYOUT.c.columns_json)
    there = {(press_id, columns): number for number, press_id, columns in connection.execute(grouped)}
    found = {}
    for key in asked:
        number = there.get((key.press_id, _columns(key.channels)))
        if number is None:
            number = layout_of(connection, key.press_id, key.name, key.channels)
        found[key] = replace(key, layout_id=number)
    return found


def _columns(channels: Sequence[Channel]) -> str:
    return json.dumps([[c.name, c.unit] for c in channels], ensure_ascii=False)


def _layout(connection: Connection, press_id: int, channels: Sequence[Channel], now: float) -> int:
    columns = _columns(channels)
    same = select(func.max(LAYOUT.c.layout_id)).where(
        LAYOUT.c.press_id == press_id, LAYOUT.c.columns_json == columns
    )
    found = connection.execute(same).scalar()
    if found is not None:
        return int(found)
    return _inserted(connection, LAYOUT, press_id=press_id, columns_json=columns, created_unix_s=now)


def _next_number(connection: Connection, press_id: int) -> int:
    scan = connection.execute(select(func.max(SCAN.c.number)).where(SCAN.c.press_id == press_id)).scalar()
    run = connection.execute(select(func.max(RUN.c.last_scan)).where(RUN.c.press_id == press_id)).scalar()
    return max(-1 if scan is None else scan, -1 if run is None else run) + 1


def _make_view(
    connection: Connection, name: str, press_id: int, layout_id: int, channels: Sequence[Channel]
) -> None:
    """Make ``scan_of_<press>``: the newest layout's scans under real channel names, for any SQL tool."""
    view = _quoted(_view_name(connection, name, press_id))
    if connection.dialect.name == "sqlite":
        values = [f"json_extract(readings, '$[{i}]')" for i in range(len(channels))]
        utc = "strftime('%Y-%m-%dT%H:%M:%fZ', unix_s, 'unixepoch')"
    else:
        values = [f"(readings::json ->> {i})::double precision" for i in range(len(channels))]
        utc = "to_timestamp(unix_s) AT TIME ZONE 'UTC'"
    plain = [c.name + ("_celsius" if c.unit == "C" else "") for c in channels]
    titles = _distinct(plain, range(len(plain)), _OWN_COLUMNS)
    named = [f"{value} AS {_quoted(title)}" for title, value in zip(titles, values, strict=True)]
    columns = ", ".join([*_OWN_COLUMNS[:1], f"{utc} AS utc", "monotonic_s", *named, "faults"])
    connection.execute(text(f"DROP VIEW IF EXISTS {view}"))
    body = f"CREATE VIEW {view} AS SELECT {columns} FROM scan"
    connection.exec_driver_sql(
        f"{body} WHERE press_id = {press_id} AND layout_id = {layout_id}".replace("%", "%%")
        if connection.dialect.name == "postgresql"
        else f"{body} WHERE press_id = {press_id} AND layout_id = {layout_id}"
    )


_OWN_COLUMNS = ("number", "utc", "monotonic_s", "faults")
_LONGEST_NAME = 63
"""A server cuts longer names off without a word. [bytes] (PostgreSQL, NAMEDATALEN - 1)"""


def _view_name(connection: Connection, press: str, press_id: int) -> str:
    """Return the name of a press's view; of presses an engine takes for the same the first has the plain one."""
    recorded = select(PRESS.c.press_id, PRESS.c.name).where(PRESS.c.kind == "recorded").order_by(PRESS.c.press_id)
    rows = connection.execute(recorded).all()
    names = _distinct([_plain(row.name) for row in rows], [row.press_id for row in rows])
    place = [row.press_id for row in rows].index(press_id)
    return names[place]


def _plain(press: str) -> str:
    return "scan_of_" + "".join(c if c.isalnum() else "_" for c in press)


def _distinct(names: Sequence[str], numbers: Sequence[int], taken: Sequence[str] = ()) -> list[str]:
    """Return names that differ for every engine from one another and those taken; an earlier one stays plain."""
    used, distinct = set(taken), []
    for name, number in zip(names, numbers, strict=True):
        tries = itertools.chain([""], (f"_{number}" + "_" * more for more in itertools.count()))
        short = next(one for ending in tries if (one := _cut(name, ending)).casefold() not in used)
        used.add(short.casefold())
        distinct.append(short)
    return distinct


def _cut(name: str, ending: str = "") -> str:
    """Return a name with an ending, no longer than an engine keeps."""
    room = _LONGEST_NAME - len(ending.encode())
    return name.encode()[:room].decode("utf-8", "ignore") + ending


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def newest_of(connection: Connection, keys: Iterable[PressKey], store: str) -> dict[str, int]:
    """Return the number of the newest scan the store has of each press, by its name; -1 without one.

    Raises `PressGone` for those it does not have under that number and name: it may have another press under the
    number. `store` is for its message.
    """
    asked_for = list(dict.fromkeys(keys))
    if not asked_for:
        return {}
    newest = select(func.max(SCAN.c.number)).where(SCAN.c.press_id == PRESS.c.press_id).scalar_subquery()
    numbers = {key.press_id for key in asked_for}
    asked = select(PRESS.c.press_id, PRESS.c.name, newest.label("newest")).where(PRESS.c.press_id.in_(numbers))
    rows = {int(row.press_id): row for row in connection.execute(asked)}
    gone = [key for key in asked_for if key.press_id not in rows or rows[key.press_id].name != key.name]
    if gone:
        raise PressGone(say("store-press-gone", store=store, press=gone[0].name), gone)
    return {row.name: -1 if row.newest is None else int(row.newest) for row in rows.values()}


def end_runs_left_open(
    connection: Connection, newest: Mapping[str, int], so_far: Mapping[str, LastWritten]
) -> None:
    """Have runs interrupted that an older state of the store shows open, but for the one under way.

    Their ends are lost, and what moves the press now belongs to another panel.
    """
    for press, number in newest.items():
        last = so_far.get(press)
        if last is not None and last.scan > number:
            for run in interrupt_open_runs(connection, press, under_way=last.run):
                log(connection, "warning", PROCESS, say("run-interrupted", run=run), press, None)


def append(
    connection: Connection,
    key: PressKey,
    scans: Sequence[Scan],
    events: Sequence[PressEvent] = (),
    begin: NewRun | None = None,
    end: RunEnd | None = None,
) -> None:
    """Write scans, then what they brought about: a run's begin, press events, a run's end.

    Writing the same scans again does no harm. A press event sets its moment in the open run.
    """
    _append_scans(connection, key, scans)
    if begin is not None:
        _begin_run(connection, key, begin, unix_of(scans[-1].utc if scans else begin.started_utc))
    for event in events:
        _append_event(connection, key, event, scans[-1].number if scans else key.next_number)
    if end is not None:
        _end_run(connection, key, end)


def _append_scans(connection: Connection, key: PressKey, scans: Sequence[Scan]) -> None:
    if not scans:
        return
    rows = [
        {
            "press_id": key.press_id,
            "number": scan.number,
            "unix_s": unix_of(scan.utc),
            "monotonic_s": scan.monotonic_s,
            "layout_id": key.layout_id,
            "readings": readings_json(scan.values),
            "faults": faults_json(key.channels, scan.qualities),
        }
        for scan in scans
    ]
    try:
        with connection.begin_nested():
            connection.execute(insert(SCAN), rows)
    except IntegrityError:
        _append_unless_there(connection, key, rows)


def _append_unless_there(connection: Connection, key: PressKey, rows: list[dict[str, Any]]) -> None:
    """Write again what a lost acknowledgement may have written already; refuse a second recorder's numbers."""
    for row in rows:
        same = select(SCAN).where(SCAN.c.press_id == key.press_id, SCAN.c.number == row["number"])
        there = connection.execute(same).mappings().first()
        if there is None:
            connection.execute(insert(SCAN), row)
        elif there["monotonic_s"] != row["monotonic_s"] or there["readings"] != row["readings"]:
            newest = connection.execute(select(func.max(SCAN.c.number)).where(SCAN.c.press_id == key.press_id))
            taken = say("store-scan-taken", press=key.name, scan=row["number"])
            raise NumbersTaken(taken, key, int(newest.scalar_one()))


def _begin_run(connection: Connection, key: PressKey, new: NewRun, noticed_unix_s: float) -> None:
    """Open a run, under the next free name where its own is taken; one that is there already stays as it is."""
    same = (
        RUN.c.press_id == key.press_id,
        RUN.c.first_scan >= new.first_scan,  # later where its first scans were lost
        RUN.c.zero_monotonic_s == new.zero_monotonic_s,
    )
    if connection.execute(select(RUN.c.run).where(*same)).first():
        return
    name = _free_name(connection, new.run)
    if name != new.run:
        log(connection, "warning", PROCESS, say("run-renamed", run=new.run, name=name), key.name, None)
    for run in interrupt_open_runs(connection, key.name, before=new.first_scan):
        log(connection, "warning", PROCESS, say("run-interrupted", run=run), key.name, None)
    header = {**new.header, **take_next_panel(connection, key.name, noticed_unix_s), "run": name}
    _journal_doubts(connection, key, name, header)
    connection.execute(
        insert(RUN),
        {
            "run": name,
            "press_id": key.press_id,
            "status": RunStatus.OPEN.value,
            "started_unix_s": unix_of(new.started_utc),
            "zero_monotonic_s": new.zero_monotonic_s,
            "first_scan": new.first_scan,
            "configuration_id": _configuration(connection, new.configuration),
            **_header_columns(header),
        },
    )


def _journal_doubts(connection: Connection, key: PressKey, run: str, header: Mapping[str, Any]) -> None:
    """Journal what is doubtful in the header of a run that begins, and was not in that of the run before."""
    mine = select(RUN.c.run, RUN.c.header_toml, RUN.c.remark).where(RUN.c.press_id == key.press_id)
    before: Mapping[str, Any] = {}
    with suppress(ScansUnreadable):  # the run before is damaged: this one begins all the same
        for row in rows_with_damage(connection, mine.order_by(RUN.c.run_number.desc()).limit(1)):
            before = stored_header(connection, row)
    for doubt in new_doubts(header, before):
        log(connection, "warning", PROCESS, say("of-run", run=run, what=doubt), key.name, None)


def _free_name(connection: Connection, name: str) -> str:
    """Return a run's name or, where it is taken, one that is free."""
    while has_run(connection, name):
        prefix, dash, number = name.rpartition("-")
        if not (dash and number.isdecimal()):
            prefix, number = name, "1"
        name = f"{prefix}-{_next_free(connection, prefix + '-', int(number)):02d}"
    return name


def _next_free(connection: Connection, prefix: str, number: int) -> int:
    """Return a number above `number` and above all that runs of this prefix have."""
    own = select(RUN.c.run).where(RUN.c.run.startswith(prefix, autoescape=True))
    endings = [row.run.removeprefix(prefix) for row in rows_with_damage(connection, own)]
    return max([number, *(int(ending) for ending in endings if ending.isdecimal())]) + 1


def _end_run(connection: Connection, key: PressKey, end: RunEnd) -> None:
    """Close a run, also one taken for interrupted meanwhile; an end without its run is an alarm.

    One that lacks its first or last scan is interrupted: others were lost, and reported then.
    """
    which = RUN.c.run == end.run
    if end.first_scan is not None:
        which = and_(RUN.c.press_id == key.press_id, RUN.c.first_scan.between(end.first_scan, end.last_scan))
    newest = select(RUN.c.run, RUN.c.status, RUN.c.first_scan).where(which).order_by(RUN.c.run_number.desc())
    row = connection.execute(newest).first()
    if row is None:
        log(
            connection,
            "alarm",
            PROCESS,
            say("run-end-without-run", run=end.run, scan=end.last_scan),
            key.name,
            None,
        )
        return
    if row.status == RunStatus.CLOSED.value:
        return
    ended: dict[str, Any] = {
        "status": end.status.value,
        "last_scan": end.last_scan,
        "ended_unix_s": unix_of(end.ended_utc),
    }
    ended |= changes_of_short(connection, key.press_id, row.first_scan, end.last_scan)
    connection.execute(update(RUN).where(RUN.c.run == row.run).values(**ended))


def _header_columns(header: Mapping[str, Any]) -> dict[str, Any]:
    thickness = header.get("panel.thickness_mm")
    material = header.get("panel.material")
    return {
        "panel_material": None if material is None else str(material),
        "panel_thickness_mm": null(thickness) if isinstance(thickness, int | float) else None,
        "header_toml": header_text({key: value for key, value in header.items() if key != REMARK}),
        "remark": str(header.get(REMARK, "")),
        "software_version": software_version(),
    }


def software_version() -> str:
    """Return the installed version, for the record."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("kerntemp")
    except PackageNotFoundError:
        return "uninstalled"


def _configuration(connection: Connection, content: str) -> int | None:
    if not content:
        return None
    content = masked(content)  # a password does not belong into every backup: the text may come from elsewhere
    found = connection.execute(
        select(CONFIGURATION.c.configuration_id).where(CONFIGURATION.c.text == content)
    ).scalar()
    if found is not None:
        return int(found)
    return _inserted(connection, CONFIGURATION, text=content, created_unix_s=unix_of(datetime.now(UTC)))


def _append_event(connection: Connection, key: PressKey, event: PressEvent, number: int) -> None:
    there = select(PRESS_EVENT.c.monotonic_s).where(
        PRESS_EVENT.c.press_id == key.press_id,
        PRESS_EVENT.c.scan_number == number,
        PRESS_EVENT.c.kind == event.kind.value,
    )
    if (same := connection.execute(there).first()) is not None:
        if same.monotonic_s != event.monotonic_s:
            message = say("event-twice", kind=event.kind.value, scan=number, press=key.name)
            log(connection, "alarm", PROCESS, message, key.name, {"monotonic_s": event.monotonic_s})
        return
    before = (
        select(SCAN.c.unix_s)
        .where(
            SCAN.c.press_id == key.press_id,
            SCAN.c.number <= number,
            SCAN.c.number > number - 1000,
            SCAN.c.monotonic_s <= event.monotonic_s,
        )
        .order_by(SCAN.c.number.desc())
        .limit(1)
    )
    connection.execute(
        insert(PRESS_EVENT),
        {
            "press_id": key.press_id,
            "kind": event.kind.value,
            "unix_s": connection.execute(before).scalar(),
            "monotonic_s": event.monotonic_s,
            "noticed_monotonic_s": event.noticed_s,
            "scan_number": number,
            "source": event.source,
        },
    )
    moment = RUN.c[f"{event.kind.value}_s"]
    connection.execute(
        update(RUN)
        .where(RUN.c.press_id == key.press_id, RUN.c.status == RunStatus.OPEN.value, moment.is_(None))
        .values({moment: event.monotonic_s - RUN.c.zero_monotonic_s})
    )


def interrupt_open_runs(
    connection: Connection, press: str, before: int | None = None, under_way: int | None = None
) -> list[str]:
    """Mark runs that a crash, or an older state of the store, left open; their data stay. Returns their names.

    `before` is the first scan that is not theirs; None: all are. The run that begins with the scan `under_way`
    stays as it is.
    """
    is_open = (
        select(RUN.c.run, RUN.c.press_id, RUN.c.first_scan)
        .join(PRESS, PRESS.c.press_id == RUN.c.press_id)
        .where(PRESS.c.name == press, RUN.c.status == RunStatus.OPEN.value)
        .where(true() if under_way is None else RUN.c.first_scan != under_way)
    )
    theirs = SCAN.c.number < before if before is not None else true()
    names = []
    for run, press_id, first_scan in connection.execute(is_open).all():
        last = connection.execute(
            select(SCAN.c.number, SCAN.c.unix_s)
            .where(SCAN.c.press_id == press_id, SCAN.c.number >= first_scan, theirs)
            .order_by(SCAN.c.number.desc())
            .limit(1)
        ).first()
        connection.execute(
            update(RUN)
            .where(RUN.c.run == run)
            .values(
                status=RunStatus.INTERRUPTED.value,
                last_scan=last.number if last else first_scan,
                ended_unix_s=last.unix_s if last else None,
            )
        )
        names.append(str(run))
    return names


def unused_run_name(connection: Connection, press: str, when: datetime) -> str:
    """Return ``press-date-NN`` with the next free number of the day."""
    prefix = f"{press}-{when:%Y-%m-%d}-"
    return f"{prefix}{_next_free(connection, prefix, 0):02d}"


def import_run(connection: Connection, run: Run, press: str, press_file: str = "") -> str:
    """Store a run from elsewhere whole; raises `InputError` where its name is taken or no name.

    When it was stays unknown where the file does not say.
    """
    _check_name(run)
    if has_run(connection, run.name):
        raise InputError(say("store-run-taken", file=run.source or run.name, run=run.name))
    origin = columns_from_header(run.header, run.source or run.name)
    channels = tuple(Channel(name, _unit(name)) for name in run.columns)
    key = register_press(connection, press, channels, press_file, "imported")
    number = key.next_number
    count, faults = len(run.time_s), row_faults(run)
    for first in range(0, count, _ROWS_AT_ONCE):
        connection.execute(insert(SCAN), list(_imported_scans(run, first, faults, key)))
    append_remarks(connection, key, ((number + i, texts) for i, texts in remarks_in(run)))
    started = origin.get("started_unix_s")
    lasted_s = float(run.time_s[-1] - run.time_s[0]) if count else 0.0
    connection.execute(
        insert(RUN),
        {
            "run": run.name,
            "press_id": key.press_id,
            "status": RunStatus.CLOSED.value,
            "started_unix_s": started,
            "ended_unix_s": None if started is None else min(started + lasted_s, LATEST_UNIX_S),
            "zero_monotonic_s": 0.0,
            "first_scan": number,
            "last_scan": number + count - 1,
            **_header_columns({**run.header, "run": run.name}),
            **origin,
        },
    )
    return run.name


def _imported_scans(
    run: Run, first: int, faults: Sequence[Mapping[str, Quality]] | None, key: PressKey
) -> Iterator[dict[str, Any]]:
    """Yield a piece of a run, from a row on, as rows of the table of scans."""
    part = slice(first, first + _ROWS_AT_ONCE)
    times = run.time_s[part].tolist()
    cells = (
        zip(*(c[part].tolist() for c in run.columns.values()), strict=True)
        if run.columns
        else itertools.repeat(())
    )
    named_in = faults[part] if faults else itertools.repeat({})
    rows = zip(times, cells, named_in, strict=False)  # what repeats has no end
    for i, (time_s, values, named) in enumerate(rows, key.next_number + first):
        yield {
            "press_id": key.press_id,
            "number": i,
            "unix_s": None,
            "monotonic_s": time_s,
            "layout_id": key.layout_id,
            "readings": readings_json(values),
            "faults": json.dumps(named, separators=(",", ":")) if named else None,
        }


def remarks_in(run: Run) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield by row what a run's text columns say, but for qualities that are kept as such."""
    columns = {n: texts for n, texts in run.texts.items() if n != QUALITY or row_faults(run) is None}
    for i, row in enumerate(zip(*columns.values(), strict=True)):
        if texts := {name: text for name, text in zip(columns, row, strict=True) if text}:
            yield i, texts


def append_remarks(
    connection: Connection, key: PressKey, remarks: Iterable[tuple[int, Mapping[str, str]]]
) -> None:
    """Write beside scans, by their number, what text columns say of them."""
    rows = (
        {"press_id": key.press_id, "number": number, "texts_json": json.dumps(texts, ensure_ascii=False)}
        for number, texts in remarks
    )
    while rows_at := list(itertools.islice(rows, _ROWS_AT_ONCE)):
        connection.execute(insert(SCAN_REMARK), rows_at)


def _check_name(run: Run) -> None:
    given = run.header.get("run", run.name)
    fits = _NAME.fullmatch(run.name) and len(run.name.encode("utf-8", "replace")) <= _LONGEST_RUN_NAME
    if isinstance(given, list | bool) or not fits or unseen(run.name) or run.name != run.name.strip():
        raise InputError(say("store-run-name", file=run.source or "run", name=repr(given)))


def _unit(column: str) -> str:
    return "C" if column.partition("_")[0] in ("platen", "top", "bottom", "core", "T") else ""


def annotate_run(connection: Connection, run: str, changes: Mapping[str, Any], who: str) -> None:
    """Change header keys (``panel.density_kg_m3``) or ``remark``; None removes a key. History is kept.

    Raises `InputError` where there is no such run, `ScansUnreadable` where its header is damaged.
    """
    row = run_row(connection, run)
    header, remark = stored_header(connection, row), row.remark
    if "run" in changes:
        raise InputError(say("store-run-renamed", run=run))
    now = unix_of(datetime.now(UTC))
    for field, after in changes.items():
        before = remark if field == "remark" else header.get(field)
        if field == "remark":
            remark = str(after)
        elif after is None:
            header.pop(field, None)
        else:
            header[field] = after
        connection.execute(
            insert(RUN_CHANGE),
            {
                "run": run,
                "unix_s": now,
                "who": who,
                "field": field,
                "before_toml": None if before is None else header_text({"value": before}),
                "after_toml": None if after is None else header_text({"value": after}),
            },
        )
    columns = {k: v for k, v in _header_columns(header).items() if k != "software_version"}
    connection.execute(update(RUN).where(RUN.c.run == run).values({**columns, "remark": remark}))


def run_changes(connection: Connection, run: str) -> list[RunChange]:
    """Return the edits of a run's metadata, oldest first."""
    rows = connection.execute(
        select(RUN_CHANGE).where(RUN_CHANGE.c.run == run).order_by(RUN_CHANGE.c.run_change_id)
    ).all()
    return [
        RunChange(known_utc(r.unix_s), r.who, r.field, _value(r.before_toml), _value(r.after_toml)) for r in rows
    ]


def _value(content: str | None) -> Any:
    return None if content is None else header_of(content).get("value")


def _inserted(connection: Connection, table: Any, **values: Any) -> int:
    key = connection.execute(insert(table), values).inserted_primary_key
    if key is None:
        raise AssertionError("insert gave no key")
    return int(key[0])
