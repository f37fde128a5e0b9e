"""What a fit can be asked for, refused before any work; `dashes` stand before an option's name at the terminal."""

from __future__ import annotations

from collections.abc import Iterable

from daq.press.press_file import Press
from daq.records import InputError
from daq.words import say


def full_method(method: str, *, averages: bool, dashes: str = "") -> str:
    """Return a method's full name. Raises `InputError` for an unknown one, and for averages without one."""
    if method != "default":
        from softsensor.fitting.paper.procedures import METHODS  # its solvers load slowly

        if method not in METHODS:
            option, known = f"{dashes}method", ("default", *METHODS)
            raise InputError(say("fit-option-method-unknown", option=option, method=method, known=known))
    elif averages:
        raise InputError(say("fit-option-averages-alone", option=f"{dashes}averages"))
    return f"{method}:averages" if averages else method


def check_shared(press: Press, shared: Iterable[str], *, dashes: str = "") -> None:
    """Raise `InputError` for a shared coefficient that the press file does not leave free."""
    free, option = press.free_coefficients, f"{dashes}shared"
    if wrong := [name for name in shared if name not in free]:
        if not free:
            raise InputError(say("fit-option-shared-fixed", option=option, name=wrong[0]))
        raise InputError(say("fit-option-shared-unknown", option=option, name=wrong[0], known=tuple(free)))
