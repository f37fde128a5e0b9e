"""What commands take: runs by file or by id, the store they live in, press and model files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.outputs import warn, working
from daq.address import Address
from daq.records import InputError, Run
from daq.words import say

if TYPE_CHECKING:
    from daq.press.press_file import Press
    from daq.store.store import Store

CONFIG_NAME = "kerntemp.toml"
DEFAULT_STORE = Path("kerntemp-data") / "kerntemp.sqlite"
"""Where runs go and come from without --store, --config and kerntemp.toml."""

NAMED_RUNS = 1000
"""Newest runs of a store among which Tab looks: some ms. Set by hand, 2026-11."""


def stored_runs(context: typer.Context, incomplete: str) -> list[str]:
    """Return the ids of the store that begin as typed, newest first, for Tab; none where no store can be asked."""
    from daq.store import every

    def newest(store: Store) -> Iterator[str]:
        runs = every(lambda cursor: store.runs(cursor=cursor, limit=200))
        return (r.run for r in islice(runs, NAMED_RUNS))

    return _asked_of_store(context, newest, incomplete)


def stored_presses(context: typer.Context, incomplete: str) -> list[str]:
    """Return the store's presses that begin as typed, for Tab; none where no store can be asked."""
    return _asked_of_store(context, lambda store: store.presses(), incomplete)


def configured_presses(context: typer.Context, incomplete: str) -> list[str]:
    """Return the presses of the configuration that begin as typed, for Tab; none where it cannot be read."""
    from daq.process.config import load_config

    try:
        settings = load_config(config_path(context.params.get("config")))
    except InputError:
        return []
    return [press.name for press in settings.press if press.name.startswith(incomplete)]


def _asked_of_store(context: typer.Context, names: Callable[[Store], Iterable[str]], incomplete: str) -> list[str]:
    from daq.store.records import StoreUnavailable

    given = {key: context.params.get(key) for key in ("store", "config")}
    try:
        with opened_store(given["store"], given["config"]) as opened:
            return [name for name in names(opened) if name.startswith(incomplete)]
    except (InputError, StoreUnavailable):
        return []


def effect_names(incomplete: str) -> list[str]:
    """Return the effects of the catalogue that begin as typed, for Tab."""
    from softsensor.effects import catalogue

    return [name for name in catalogue() if name.startswith(incomplete)]


Runs = Annotated[list[str], typer.Argument(metavar="RUN", help="help-runs", autocompletion=stored_runs)]
OneRun = Annotated[str, typer.Argument(metavar="RUN", help="help-run", autocompletion=stored_runs)]
PressFile = Annotated[Path, typer.Option("--press", metavar="FILE", help="help-press")]
StoreUrl = Annotated[
    str | None,
    typer.Option("--store", metavar="URL", help="help-store"),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", envvar="KERNTEMP_CONFIG", help="help-config"),
]


def config_path(given: Path | None) -> Path:
    """Return the configuration to use. Raises `InputError` where there is none, or it is not ours to read."""
    path = given or Path(CONFIG_NAME)
    try:
        there = path.is_file()
    except PermissionError as error:
        raise InputError(say("terminal-config-no-permission", path=str(path))) from error
    if not there:
        raise InputError(say("terminal-config-missing", path=str(path)))
    return path


def store_address(store: str | None, config: Path | None) -> Address:
    """Return the store's URL: as given, as the configuration says, else the default's."""
    if store is not None:
        return Address(store)
    if config is None and not Path(CONFIG_NAME).is_file():
        return Address(str(DEFAULT_STORE))
    from daq.process.config import load_config

    return load_config(config_path(config)).store.url


@contextmanager
def opened_store(store: str | None, config: Path | None, *, create: bool = False) -> Iterator[Store]:
    """Open the store for a command."""
    from daq.store.store import open_store

    address = store_address(store, config)
    if address == str(DEFAULT_STORE):
        if create:
            DEFAULT_STORE.parent.mkdir(exist_ok=True)
        elif not DEFAULT_STORE.is_file():
            raise InputError(say("terminal-no-store-here", config=CONFIG_NAME, store=str(DEFAULT_STORE)))
    with open_store(address, create=create) as opened:
        yield opened


def files_read(*given: Path | str | None, store: str | None, config: Path | None) -> list[Path]:
    """Return which files a command reads: those among what was given, the configuration, a store in a file.

    A run's id and the URL of a database server are no files.
    """
    kept = DEFAULT_STORE if store is None else store.removeprefix("sqlite:///")
    named = (*given, config or CONFIG_NAME, kept)
    return [Path(one) for one in named if one is not None and Path(one).is_file()]


def load_runs(arguments: list[str], press: Press, store: str | None, config: Path | None) -> list[Run]:
    """Read every run, from its file or from the store. Raises `InputError` naming the first that fails.

    A column of words is an error where the press takes numbers from it, and so is a panel that nothing describes.
    """
    from daq.files.legible import check_each_once, kelvin_doubt, legible
    from daq.press.header import panel_of

    runs = []
    with working(say("terminal-progress-reading-runs", runs=len(arguments)), len(arguments)) as done:
        for number, argument in enumerate(arguments, start=1):
            runs.append(legible(find_run(argument, store, config), press))
            if press.panel_layers:
                panel_of(runs[-1])
            done(number)
    check_each_once(runs)
    say_doubts(run.header for run in runs)
    for doubt in filter(None, (kelvin_doubt(run, press) for run in runs)):
        warn(doubt)
    return runs


def say_doubts(headers: Iterable[Mapping[str, Any]]) -> None:
    """Say on standard error, once each, what is doubtful in headers."""
    from daq.press.header import doubts

    for doubt in dict.fromkeys(doubt for header in headers for doubt in doubts(header)):
        warn(doubt)


def find_run(argument: str, store: str | None, config: Path | None) -> Run:
    """Read one run: what exists as a file or ends like one is a file, all else an id in the store."""
    path = Path(argument)
    if path.exists() or path.suffix.lower() in (".csv", ".parquet"):
        from daq.files.run_file import read_run

        return read_run(path)
    if store is None and config is None and not Path(CONFIG_NAME).is_file() and not DEFAULT_STORE.is_file():
        raise InputError(say("terminal-run-neither-file-nor-stored", run=argument))
    with opened_store(store, config) as opened:
        return opened.load_run(argument)
