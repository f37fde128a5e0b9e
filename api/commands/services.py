"""The long-running processes: `record`, `sense`, `serve`, the nightly `refit`, and `token`."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from api.commands.inputs import CONFIG_NAME, ConfigFile, StoreUrl, config_path
from api.outputs import WorkFailed, working
from daq.records import InputError

Host = Annotated[str | None, typer.Option("--host", help="Address to listen on; the configuration's without.")]
Port = Annotated[
    int | None, typer.Option("--port", min=0, max=65535, help="Port; 0 takes a free one and prints it.")
]


def record(config: ConfigFile = None) -> None:
    """Log all presses of the configuration, without end."""
    from daq.config import load_config
    from daq.recorder import record as run

    settings = load_config(config_path(config))
    log_to_stderr()
    run(settings)


def sense(config: ConfigFile = None) -> None:
    """Run the live sensor on all presses of the configuration, without end."""
    from daq.config import load_config
    from softsensor.service import sense as run

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
    certificate: Annotated[Path | None, typer.Option(help="TLS certificate chain, PEM.")] = None,
    key: Annotated[Path | None, typer.Option(help="Its private key, PEM.")] = None,
    store: StoreUrl = None,
) -> None:
    """Serve REST and the page; on loopback only unless tokens exist."""
    from api.server import Listening, address_of, run_server
    from api.tokens import TokenFile
    from daq.config import ServerSettings, load_config
    from daq.store.store import open_store

    path = Path(CONFIG_NAME) if store is not None and config is None else config_path(config)
    settings = load_config(path) if path.is_file() else None
    server = settings.server if settings else ServerSettings()
    tokens = TokenFile(server.tokens or token_file_beside(path))
    listening = Listening(host or server.host, server.port if port is None else port, certificate, key)
    listening.check(tokens)
    address = store or (settings.store.url if settings else "")
    with open_store(address, create=store is None, later=True) as opened:
        bound = listening.bind()
        sys.stdout.write(f"kerntemp serves {address_of(bound, tls=certificate is not None)}\n")
        sys.stdout.flush()
        run_server(opened, tokens, listening, bound)


def refit(
    config: ConfigFile = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Local processes; see [refit] workers.")] = None,
    dask: Annotated[
        str,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler whose workers take the fits; see [refit] dask."),
    ] = "",
    roll_back: Annotated[
        str, typer.Option("--roll-back", metavar="PRESS", help="Only go back to this press's model before.")
    ] = "",
) -> None:
    """Refit all runs, diagnose, extend, and promote or reject a model version: the nightly job."""
    from daq.config import load_config
    from daq.pressfile import read_press
    from daq.store.store import open_store
    from softsensor import nightly, nightly_judge
    from softsensor.nightly_report import write_report

    settings = load_config(config_path(config))
    with open_store(settings.store.url) as store:
        if roll_back:
            name = settings.press_named(roll_back).name
            sys.stdout.write(
                f"{name}: model {nightly.roll_back(store, name, 'kerntemp refit')} is in force again\n"
            )
            return
        failed, outcomes = [], []
        for press in settings.press:
            with working(f"Refitting {press.name}"):
                outcome = nightly.refit_press(
                    store,
                    press.name,
                    read_press(press.file),
                    workers=workers or settings.refit.workers,
                    dask=dask or settings.refit.dask,
                )
            sys.stdout.write(f"{outcome.line}\n")
            outcomes.append(outcome)
            try:
                page = write_report(store, outcome, settings.refit.reports)
                sys.stdout.write(f"{press.name}: report {page}\n")
            except InputError as error:  # its work is in the store; the other presses wait for theirs
                store.log("warning", nightly_judge.PROCESS, str(error), press.name)
                failed.append(str(error))
            if outcome.newly_unfit:
                failed.append(f"{press.name}: {outcome.newly_unfit} of {outcome.runs} runs could not be fitted")
        nightly.sign_off(store, outcomes)
    if failed:
        raise WorkFailed("; ".join(failed) + "; the journal names them")


def token_file_beside(config: Path) -> Path:
    """Return where tokens are kept when the configuration does not say."""
    return config.resolve().parent / "kerntemp-tokens.json"


def token(
    action: Annotated[Literal["create", "revoke", "list"], typer.Argument(help="What to do.")],
    name: Annotated[str, typer.Argument(help="Whom the token is for.")] = "",
    scope: Annotated[Literal["read", "write"], typer.Option(help="write includes read.")] = "read",
    config: ConfigFile = None,
) -> None:
    """Make, list and revoke access tokens; a new one is shown once."""
    from api.tokens import TokenFile
    from daq.config import load_config

    path = config_path(config)
    settings = load_config(path)
    tokens = TokenFile(settings.server.tokens or token_file_beside(path))
    if action == "list":
        for kept in tokens.tokens():
            sys.stdout.write(f"{kept.id}  {kept.scope:5}  {kept.created_utc}  {kept.name}\n")
        return
    if not name:
        raise InputError(f"kerntemp token {action}: needs a name")
    if action == "revoke":
        tokens.revoke(name)
        _note_in_journal(settings.store.url, f"token {name} revoked")
    else:
        sys.stdout.write(tokens.create(name, scope) + "\n")
        _note_in_journal(settings.store.url, f"token {name} created, scope {scope}")


def _note_in_journal(url: str, sentence: str) -> None:
    """Write down who may come in; a store that is not there yet or away is no reason to refuse the change."""
    from daq.store.records import StoreUnavailable
    from daq.store.store import open_store

    try:
        with open_store(url, create=False, busy_s=2.0) as store:
            store.log("info", "token", sentence)
    except (InputError, StoreUnavailable) as error:
        sys.stderr.write(f"{sentence}; not noted in the journal: {error}\n")
