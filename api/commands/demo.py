"""`demo`: the whole system on a virtual press."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from api.commands.inputs import effect_names
from api.outputs import write_line
from daq.records import InputError
from daq.words import say, spoken


def demo(
    speed: Annotated[float, typer.Option(min=0.1, max=200.0, metavar="X", help="help-speed")] = 1.0,
    pressings: Annotated[int | None, typer.Option(min=1, max=1000, metavar="N", help="help-pressings")] = None,
    hide: Annotated[str, typer.Option(metavar="EFFECT", help="help-hide", autocompletion=effect_names)] = "",
    port: Annotated[int, typer.Option(min=0, max=65535, metavar="N", help="help-page-port")] = 0,
    data: Annotated[Path | None, typer.Option(metavar="DIR", help="help-data")] = None,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="help-seed")] = 1,
) -> None:
    """Run logging, live sensor, refits and page on a virtual press."""
    hidden = tuple(name.strip() for name in hide.split(",") if name.strip())
    check_effects(hidden)
    check_port(port)
    from api.demo.processes import DemoPlan, started
    from daq.process.loading import loading

    end_in_order()
    plan = DemoPlan(speed=speed, pressings=pressings, hide=hidden, port=port, seed=seed)
    with started(plan, data) as children:
        with loading():
            from api.demo.demonstration import run_demo  # while the others come up

        run_demo(plan, children, write_line, kept=data is not None)


def end_in_order() -> None:
    """Let a kill or a closed terminal end the other processes too, and Ctrl-C where a shell's `&` ignores it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for name in ("SIGTERM", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), _end)


def _end(number: int, _frame: object) -> NoReturn:
    raise SystemExit(128 + number)


def check_effects(names: tuple[str, ...]) -> None:
    """Refuse names the virtual press does not know. Raises `InputError`."""
    if not names:
        return
    from daq.simulated.effects import split_names

    try:
        split_names(names)
    except InputError as error:
        raise InputError(say("terminal-hide-unknown", why=spoken(error))) from error


def check_port(port: int) -> None:
    """Look for a taken port before warming up, which may take a minute. Raises `InputError`."""
    if port:
        from api.http.binding import take_port

        take_port("127.0.0.1", port).close()
