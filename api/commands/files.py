"""Files into and out of the store: `import`, `export`; and is all well configured: `check`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from api.commands.calling import taking
from api.commands.inputs import (
    ConfigFile,
    PressFile,
    StoreUrl,
    config_path,
    files_read,
    opened_store,
    say_doubts,
    stored_presses,
    stored_runs,
)
from api.outputs import check_writable, in_words, warn, working, write_all, write_line, write_table
from daq.records import ROOM_C, InputError
from daq.tables import text_in
from daq.words import Message, say, spoken

if TYPE_CHECKING:
    from daq.files.documents import ExitStatus
    from daq.press.press_file import Press
    from daq.process.config import Config, PressSettings
    from daq.records import Run
    from daq.store.store import Store


def import_runs(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="help-import-files")],
    press: PressFile,
    store: StoreUrl = None,
    config: ConfigFile = None,
    mapping: Annotated[Path | None, typer.Option("--mapping", metavar="FILE", help="help-mapping")] = None,
) -> None:
    """Store run files: all of them, or none where one is wrong."""
    from daq.files.manifest import check_listed
    from daq.press.press_file import read_press

    described = read_press(press)
    read = _reader(mapping, described)
    for path in files:
        check_listed(path)
    with working(say("terminal-progress-reading", files=len(files)), len(files)) as done:
        runs = []
        for number, path in enumerate(files, 1):
            runs.append(read(path))
            _refuse_nonsense(runs[-1], described)
            done(number)
    names = [run.name for run in runs]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(say("terminal-import-run-twice", run=twice))
    with opened_store(store, config, create=True) as opened:
        for run in runs:
            _refuse_taken(opened, run)
        with working(say("terminal-progress-storing", runs=len(runs))):
            opened.import_runs(runs, described.name, text_in(press))
    say_doubts(run.header for run in runs)
    write_line(say("terminal-imported", runs=len(runs)))


def _reader(mapping: Path | None, press: Press) -> Callable[[Path], Run]:
    """Return what reads a file: ours, or a foreign logger's by its mapping."""
    boundaries = (press.boundary.bottom.column, press.boundary.top.column)
    temperatures = [*filter(None, boundaries), *(column for sensor in press.sensor for column in sensor.columns)]
    if mapping is None:
        from daq.files.run_file import read_run

        return partial(read_run, temperatures=temperatures)
    from daq.files.mapping import read_foreign, read_mapping

    mapped = read_mapping(mapping)
    return lambda path: read_foreign(path, mapped, temperatures)


def _refuse_nonsense(run: Run, press: Press) -> None:
    """Refuse header values that cannot be; keys that are missing may be added later."""
    from daq.press.header import USUAL_PANEL, listed_constants, panel_of
    from daq.press.press_file import press_for_run

    press_for_run(press, run)
    some = {key: constant.value for key, constant in listed_constants(USUAL_PANEL).items()}
    some |= {**USUAL_PANEL, "panel.initial_temperature_C": ROOM_C}
    panel_of(replace(run, header={**some, **run.header}))


def _refuse_taken(store: Store, run: Run) -> None:
    if store.has_run(run.name):
        raise InputError(say("store-run-taken", file=run.source or run.name, run=run.name))


def beginning_of(day: str) -> datetime:
    """Return when a day begins in UTC, in which lists give when runs began. Raises `ValueError`."""
    try:
        if not day.isascii():
            raise ValueError(day)
        return datetime.strptime(day, "%Y-%m-%d").replace(tzinfo=UTC)
    except ValueError as error:
        raise ValueError(say("key-no-day")) from error


@dataclass(frozen=True)
class ExportOptions:
    """What `export` is called with."""

    runs: Annotated[
        list[str] | None, typer.Argument(metavar="RUN", help="help-export-runs", autocompletion=stored_runs)
    ] = None
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="help-export-out")] = None
    kind: Annotated[
        Literal["csv", "parquet", "jsonl"],
        typer.Option("--format", metavar="csv|parquet|jsonl", help="help-export-format"),
    ] = "csv"
    press: Annotated[
        str | None, typer.Option("--press", metavar="NAME", help="help-list-press", autocompletion=stored_presses)
    ] = None
    material: Annotated[str | None, typer.Option("--material", metavar="NAME", help="help-list-material")] = None
    since: Annotated[
        datetime | None, typer.Option("--from", metavar="DAY", parser=beginning_of, help="help-list-from")
    ] = None
    until: Annotated[
        datetime | None, typer.Option("--to", metavar="DAY", parser=beginning_of, help="help-list-to")
    ] = None
    store: StoreUrl = None
    config: ConfigFile = None


@taking(ExportOptions)
def export_runs(options: ExportOptions) -> None:
    """Write runs of the store as run files, or list what there is."""
    from daq.files.manifest import NAME as MANIFEST
    from daq.files.manifest import update_manifest

    chosen = {
        "press": options.press,
        "material": options.material,
        "since": options.since,
        "until": options.until,
    }
    if options.runs and any(chosen.values()):
        raise InputError(say("terminal-list-alone"))
    with opened_store(options.store, options.config) as opened:
        if not options.runs:
            _list_runs(opened, chosen)
            return
        if options.out is None:
            raise InputError(say("terminal-export-needs-out"))
        for run in options.runs:
            opened.run_record(run)
        targets = _targets(options.runs, options.out, options.kind)
        title = say("terminal-progress-exporting", runs=len(options.runs))
        check_writable(
            *targets, inputs=files_read(opened.database.path, store=options.store, config=options.config)
        )
        contents: dict[Path, str | Callable[[Path], None]] = {}
        with working(title, len(targets)) as done:
            for number, (path, run) in enumerate(targets.items(), 1):
                contents[path] = _content(opened, run, path)
                done(number)
            write_all(contents)
        folder = options.out if options.out.is_dir() else options.out.parent
        if options.out.is_dir() or (folder / MANIFEST).is_file():
            update_manifest(folder, targets)


_END: dict[str, ExitStatus] = {"closed": "success", "interrupted": "abort", "open": None}


def _content(store: Store, run: str, path: Path) -> str | Callable[[Path], None]:
    """Return what goes into the file of a run, by the ending of its name."""
    from daq.files.documents import json_lines
    from daq.files.run_file import write_run

    loaded = store.run_for_file(run)
    if path.suffix.lower() != ".jsonl":
        return partial(write_run, loaded)
    kept = store.run_record(run)
    lines = json_lines(loaded, kept.started_utc, store.units_of(run), _END[kept.status])
    return "".join(f"{line}\n" for line in lines)


def _targets(runs: list[str], out: Path, kind: str) -> dict[Path, str]:
    """Return which file takes which run; the folder for several is made where there is none."""
    if len(runs) == 1 and not out.is_dir():
        if out.suffix.lower() not in (".csv", ".parquet", ".jsonl"):
            raise InputError(say("terminal-run-file-ending", path=str(out)))
        return {out: runs[0]}
    if not out.is_dir():
        if out.suffix or out.exists() or not out.absolute().parent.is_dir():
            raise InputError(say("terminal-folder-for-several", path=str(out)))
        out.mkdir()
    return {out / f"{run}.{kind}": run for run in runs}


def _list_runs(store: Store, chosen: Mapping[str, Any]) -> None:
    if chosen["press"] is not None and chosen["press"] not in (known := tuple(store.presses())):
        raise InputError(say("api-press-unknown", press=chosen["press"], known=known))
    _refuse_unknown_material(store, chosen["material"])
    heads = [say(f"terminal-list-{head}") for head in ("run", "started", "status", "press", "material")]
    write_table(heads, _run_rows(store, chosen))


def _refuse_unknown_material(store: Store, material: str | None) -> None:
    """Refuse a material of which the store has no run, naming those of its runs."""
    from daq.store import every
    from daq.tables import nearest_first

    if material is None or store.runs(material=material, limit=1).items:
        return
    runs = every(lambda cursor: store.runs(cursor=cursor, limit=500))
    if known := {str(run.header["panel.material"]) for run in runs if run.header.get("panel.material")}:
        names = nearest_first(material, sorted(known))
        raise InputError(say("terminal-list-material-unknown", material=material, known=names))


def _run_rows(store: Store, chosen: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    from daq.store import every

    for run in every(lambda cursor: store.runs(cursor=cursor, limit=500, **chosen)):
        material = run.header.get("panel.material", "")
        status = in_words(Message(f"page-run-{run.status}"))
        began = (
            f"{run.started_utc:%Y-%m-%dT%H:%M:%SZ}" if run.started_utc else in_words(Message("page-date-unknown"))
        )
        if run.damage is not None:
            status = in_words(Message("terminal-list-damaged"))
            warn(run.damage)
        yield run.run, began, status, run.press, str(material)


def check(
    config: ConfigFile = None,
    offline: Annotated[bool, typer.Option("--offline", help="help-offline")] = False,
) -> None:
    """Check the configuration, the store and, unless --offline, read every logger once."""
    from daq.process.config import load_config

    path = config_path(config)
    settings = load_config(path)
    write_line(say("terminal-check-well-formed", path=str(path)))
    say_doubts(press.header for press in settings.press)
    failed = _try_buffer(settings)
    with opened_store(None, path, create=True) as store:
        write_line(say("terminal-check-store-opens", store=store.label))
    if not offline:
        failed += [line for press in settings.press for line in _read_loggers(press)]
    if failed:
        failures = " – ".join(in_words(one) for one in failed)
        raise InputError(say("terminal-check-failed", path=str(path), failures=failures))


def _try_buffer(settings: Config) -> list[Message]:
    """See that scans can wait where the configuration says while a server is away; return why they cannot."""
    from daq.store.buffer_place import try_place
    from daq.store.database import store_url

    buffer = settings.store.buffer
    if buffer is None or store_url(settings.store.url).get_backend_name() == "sqlite":  # a file never goes away
        return []
    try:
        hours = try_place(buffer, settings.scans_per_second)
    except InputError as error:
        return [spoken(error)]
    write_line(say("terminal-check-buffer", file=str(buffer), hours=hours))
    return []


def _read_loggers(press: PressSettings) -> list[Message]:
    from daq.drivers import BadFrame, NoReply, open_logger, uncorrected

    failed = []
    for settings in press.logger:
        logger = open_logger(settings)
        try:
            reading = logger.read()
        except (NoReply, BadFrame) as error:
            why = spoken(error)
            failed.append(say("terminal-check-logger-failed", press=press.name, logger=settings.name, why=why))
            continue
        finally:
            logger.close()
        shown = ", ".join(
            f"{channel.name} {value:.1f}"
            if quality.usable
            else f"{channel.name} {in_words(Message(f'page-quality-{quality}'))}"
            for channel, value, quality in zip(logger.channels, reading.values, reading.qualities, strict=True)
        )
        write_line(f"{press.name}, {settings.name}: {shown} °C")
        if sentence := uncorrected(settings):
            write_line(f"{press.name}, {in_words(sentence)}")
    return failed
