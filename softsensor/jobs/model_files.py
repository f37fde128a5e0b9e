"""Model files on the disk, and coefficients given without one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from daq.press.press_file import Press
from daq.records import InputError
from daq.tables import read_json, reason_of, text_in
from daq.words import say
from softsensor.heat.model_file import ModelFile
from softsensor.heat.model_reading import check_coefficient, check_coefficient_names, parse_model


def read_model(path: Path) -> ModelFile:
    """Read a model file. Raises InputError."""
    try:
        content = read_json(text_in(path))
    except OSError as error:
        raise InputError(say("model-file-unreadable", file=str(path), error=reason_of(error))) from error
    except (UnicodeDecodeError, InputError) as error:
        raise InputError(say("model-file-no-json", file=str(path), error=reason_of(error))) from error
    return parse_model(content, str(path))


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
        For a name that the press does not have, and a value that no coefficient can have.
    """
    check_coefficient_names(given, presses, where)
    return {name: check_coefficient(name, value, where) for name, value in given.items()}
