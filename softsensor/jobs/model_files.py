"""Model files on the disk, and coefficients given without one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from daq.press.press_file import Press
from daq.records import InputError
from daq.tables import reason_of
from daq.words import say
from softsensor.heat.model_file import ModelFile, parse_model


def read_model(path: Path) -> ModelFile:
    """Read a model file. Raises InputError."""
    try:
        return parse_model(json.loads(path.read_text(encoding="utf-8")), str(path))
    except OSError as error:
        raise InputError(say("model-file-unreadable", file=str(path), error=reason_of(error))) from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(say("model-file-no-json", file=str(path), error=reason_of(error))) from error


def coefficients_of(given: Mapping[str, Any], presses: Sequence[Press], where: str) -> dict[str, float]:
    """Return coefficients that were given by name. [W/m²K]

    Parameters
    ----------
    presses
        Of the press file, and as the run's header has it: a name either knows is known.
    where
        The file they stand in, or the argument.

    Raises
    ------
    InputError
        For a value that is no number above 0, and a name that the press does not have.
    """
    for name, value in given.items():
        if isinstance(value, bool) or not isinstance(value, float | int | np.number) or not 0 < value < 1e9:
            raise InputError(say("coefficient-not-positive", where=where, name=str(name), value=repr(value)))
    check_coefficient_names(given, presses, where)
    return {name: float(value) for name, value in given.items()}


def check_coefficient_names(given: Mapping[str, Any], presses: Sequence[Press], where: str) -> None:
    """Refuse a coefficient that neither the press file nor the run's own press has. Raises `InputError`."""
    names = dict.fromkeys(name for press in presses for name in press.coefficient_names)
    if unknown := [name for name in given if name not in names]:
        press, known = presses[0].name, tuple(names)
        raise InputError(say("coefficient-unknown", where=where, name=unknown[0], press=press, known=known))
