"""The long-running processes: `record`, `sense`, `serve`, the nightly `refit`, and `token`."""

from __future__ import annotations

import logging
import socket
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from api.commands.inputs import CONFIG_NAME, ConfigFile, StoreUrl, config_path, configured_presses
from api.outputs import WorkFailed, in_words, spoken_language, working, write_line, write_table
from daq.records import InputError
from daq.words import Message, say, spoken

if TYPE_CHECKING:
    from api.http.tokens import TokenFile
    from daq.address import Address
    from daq.process.config import Config, ServerSettings
    from daq.store.store import Store
    from softsensor.jobs.night_basis import NightOutcome
    from softsensor.jobs.retention import Rules

Host = Annotated[str | None, typer.Option("--host", metavar="ADDRESS", help="help-host")]
Port = Annotated[int | None, typer.Option("--port", min=0, max=65535, metavar="N", help="help-port")]


def record(config: ConfigFile = None) -> None:
    """Log all presses of the configuration, without end."""
    from daq.process.loading import loading

    with loading():
        from daq.process.config import load_config
        from daq.recording.recorder import record as run

    settings = load_config(config_path(config))
    log_to_stderr()
    run(settings)


def sense(config: ConfigFile = None) -> None:
    """Run the live sensor on all presses of the configuration, without end."""
    from daq.process.loading import loading

    with loading():
        from daq.process.config import load_config
        from softsensor.jobs.live_service import sense as run

    settings = load_config(config_path(config))
    log_to_stderr()
    run(settings)


def log_to_stderr() -> None:
    """Send what a long-running process has to say to standard error, with the time."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr)


def serve(
    config: ConfigFile = None,
    host: Host = None,
    port: Port = None,
    certificate: Annotated[Path | None, typer.Option(metavar="FILE", help="help-certificate")] = None,
    key: Annotated[Path | None, typer.Option(metavar="FILE", help="help-key")] = None,
    store: StoreUrl = None,
) -> None:
    """Serve REST and the page; on loopback only unless tokens exist."""
    from daq.process.loading import loading

    with loading():
        from api.alarms.watch import watching
        from api.alarms.ways import ways_of
        from api.http.server import Listening, address_of, make_server, run_server
        from daq.process.config import ServerSettings, load_config
        from daq.process.stopping import outlive_hangup
        from daq.store.records import StoreUnavailable
        from daq.store.store import open_store
        from daq.store.waiting import ending_reported

    outlive_hangup()
    path = Path(CONFIG_NAME) if store is not None and config is None else config_path(config)
    settings = load_config(path) if path.is_file() else None
    server = settings.server if settings else ServerSettings()
    tokens = token_file(server, path)
    listening = Listening(host or server.host, server.port if port is None else port, certificate, key)
    listening.check(tokens)
    address = store or (settings.store.url if settings else "")
    with open_store(address, create=store is None, later=True) as opened:
        with suppress(StoreUnavailable):  # the page says so; a store that is wrong in itself ends the server
            opened.database.prepare()
        ways = ways_of(settings.email, settings.webhook, opened.label) if settings else []
        bound = listening.bind()
        write_line(say("terminal-serves", address=address_of(bound, tls=certificate is not None)))
        with ending_reported(opened, "serve"), watching(opened, ways) as stalled:
            resins = {press.name: press.resin for press in (settings.press if settings else ()) if press.resin}
            headers = {press.name: press.header for press in (settings.press if settings else ())}
            run_server(make_server(opened, tokens, listening, resins, headers, stalled), bound)


def refit(
    config: ConfigFile = None,
    workers: Annotated[int | None, typer.Option(min=1, metavar="N", help="help-workers")] = None,
    dask: Annotated[str, typer.Option(metavar="ADDRESS", help="help-dask")] = "",
    roll_back: Annotated[
        str,
        typer.Option("--roll-back", metavar="PRESS", help="help-roll-back", autocompletion=configured_presses),
    ] = "",
) -> None:
    """Refit all runs, diagnose, extend, and promote or reject a model version: the nightly job."""
    from daq.process.config import load_config

    if roll_back:
        _roll_back(load_config(config_path(config)), roll_back)
        return
    from daq.store.store import open_store
    from daq.store.waiting import ending_reported
    from softsensor.jobs.night import sign_off

    unsound: dict[str, InputError] = {}
    settings = load_config(config_path(config), unsound)
    names = [*unsound, *(press.name for press in settings.press)]
    failed: list[Message] = []
    outcomes: dict[str, NightOutcome] = {}
    with open_store(settings.store.url) as store, ending_reported(store, "refit"):
        nights = _nights(store, settings, unsound, workers or settings.refit.workers, dask or settings.refit.dask)
        with working(say("terminal-progress-refitting", presses=len(names)), len(names)) as done:
            for outcome in nights:
                outcomes[outcome.press] = outcome
                failed += _report(store, outcome, settings)
                done(len(outcomes))
        sign_off(store, [outcomes[name] for name in names])
    if failed:
        raise WorkFailed(say("terminal-refit-failed", failures=tuple(failed)))


def _nights(
    store: Store, settings: Config, unsound: Mapping[str, InputError], workers: int | None, dask: str
) -> Iterator[NightOutcome]:
    """Yield the night of every press; of one whose files are refused, that it failed."""
    from daq.press.press_file import read_press
    from softsensor.jobs.night import failed_night
    from softsensor.jobs.nights import refit_presses

    for name, error in unsound.items():
        yield failed_night(store, name, datetime.now(UTC), spoken(error))
    yield from refit_presses(
        store,
        {press.name: read_press(press.file) for press in settings.press},
        workers=workers,
        dask=dask,
        rules=_rules(settings),
        learning=[press.name for press in settings.press if press.sisters],
    )


def _rules(settings: Config) -> Rules | None:
    """Return what becomes of old scans; the presses share the night's time for it."""
    from softsensor.jobs.retention import Rules

    kept = settings.store
    if kept.archive is None:
        return None
    last = kept.pressings_only_after_days
    return Rules(
        folder=kept.archive,
        archive_after=timedelta(days=kept.archive_after_days),
        pressings_only_after=None if last is None else timedelta(days=last),
        seconds=60.0 * kept.archive_minutes / len(settings.press),
        began=datetime.now(UTC),
    )


def _report(store: Store, outcome: NightOutcome, settings: Config) -> list[Message]:
    """Show a press's night and write its page; return what went wrong, in this and in its fits."""
    from softsensor.jobs.night import reason_of
    from softsensor.jobs.night_basis import FAILED
    from softsensor.jobs.night_record import night_record
    from softsensor.jobs.run_reader import PROCESS
    from softsensor.report.night_report import write_report

    if outcome.verdict == FAILED:
        return [outcome.line]
    failed = []
    write_line(outcome.line)
    if outcome.archive is not None:
        write_line(outcome.archive)
    try:
        page = write_report(
            night_record(store, outcome), settings.refit.reports, spoken_language(), _page_address(settings.server)
        )
        write_line(say("terminal-refit-report", press=outcome.press, page=str(page)))
    except Exception as error:  # noqa: BLE001 - its work is in the store; the other presses wait for theirs
        why = reason_of(error)
        store.log("warning", PROCESS, why, outcome.press)
        failed.append(why)
    if outcome.archive_problem is not None:
        failed.append(outcome.archive_problem)
    failed += outcome.unread
    if outcome.newly_unfit:
        unfit = {"failed": outcome.newly_unfit, "runs": outcome.runs}
        failed.append(say("terminal-refit-unfit", press=outcome.press, **unfit))
    return failed


def _page_address(server: ServerSettings) -> str:
    """Return where the page is; a server that listens everywhere is found by its machine's name."""
    everywhere = server.host in ("", "0.0.0.0", "::")
    host = socket.gethostname() if everywhere else server.host
    return f"http://{f'[{host}]' if ':' in host else host}:{server.port}/"


def _roll_back(settings: Config, press: str) -> None:
    """Put the model before into force again."""
    from daq.store.store import open_store

    name = settings.press_named(press).name  # refused before what loads slowly
    from softsensor.jobs.night import roll_back

    with open_store(settings.store.url) as store:
        version = roll_back(store, name, "kerntemp refit")
    write_line(say("terminal-model-in-force-again", press=name, version=version))


def token_file(server: ServerSettings, config: Path) -> TokenFile:
    """Return where tokens are kept: beside the configuration where that names no file."""
    from api.http.tokens import TokenFile

    return TokenFile(server.tokens or config.resolve().parent / "kerntemp-tokens.json")


def _configured_tokens(config: Path | None) -> tuple[TokenFile, Config]:
    """Return where the tokens of a configuration are kept, and the configuration."""
    from daq.process.config import load_config

    path = config_path(config)
    settings = load_config(path)
    return token_file(settings.server, path), settings


def tokens_to_revoke(context: typer.Context, incomplete: str) -> list[str]:
    """Return the names of tokens that begin as typed, for Tab; none where nothing is revoked."""
    if context.params.get("action") != "revoke":
        return []
    try:
        tokens, _ = _configured_tokens(context.params.get("config"))
        return [kept.name for kept in tokens.tokens() if kept.name.startswith(incomplete)]
    except InputError:
        return []


def token(
    action: Annotated[
        Literal["create", "revoke", "list"], typer.Argument(metavar="create|revoke|list", help="help-token-action")
    ],
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="help-token-name", autocompletion=tokens_to_revoke)
    ] = "",
    scope: Annotated[Literal["read", "write"], typer.Option(metavar="read|write", help="help-scope")] = "read",
    config: ConfigFile = None,
) -> None:
    """Make, list and revoke access tokens; a new one is shown once."""
    tokens, settings = _configured_tokens(config)
    if action == "list":
        heads = [say(f"terminal-list-{head}") for head in ("token", "scope", "created", "name")]
        write_table(heads, ((kept.id, kept.scope, str(kept.created_utc), kept.name) for kept in tokens.tokens()))
        return
    if not name:
        raise InputError(say("terminal-token-needs-name", action=action))
    if action == "revoke":
        tokens.revoke(name)
        _note_in_journal(settings.store.url, say("token-revoked", name=name))
    else:
        sys.stdout.write(tokens.create(name, scope) + "\n")
        _note_in_journal(settings.store.url, say("token-created", name=name, scope=scope))


def _note_in_journal(url: Address, message: Message) -> None:
    """Write down who may come in; a store that is not there yet or away is no reason to refuse the change."""
    from daq.store.records import StoreUnavailable
    from daq.store.store import open_store

    try:
        with open_store(url, create=False, busy_s=2.0) as store:
            store.log("info", "token", message)
    except (InputError, StoreUnavailable) as error:
        sys.stderr.write(in_words(say("terminal-not-noted", what=message, why=spoken(error))) + "\n")
