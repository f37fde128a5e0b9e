"""What is given from Python, held against what is asked for: anything else is refused in words."""

from __future__ import annotations

import inspect
import math
import os
import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from daq.records import InputError
from daq.words import Message, say
from daq.words.message import choose, languages

NUMBERS = (Real, Decimal, np.bool_)
"""What tables and drivers give as numbers."""
_OURS = ("daq", "softsensor")


def refused(given: object, code: str) -> InputError:
    """Return the error for a thing of another kind than asked for; `code` is the message's.

    >>> str(refused(5, "given-no-press"))
    'int: a press is given as the path of a press file, or as what read_press returned'
    """
    kind = type(given)
    package = kind.__module__.partition(".")[0]
    return InputError(say(code, found=kind.__name__ if package == "builtins" else f"{package}.{kind.__name__}"))


def speak(language: str) -> None:
    """Choose the language of all that is read in this process: printed results, notebook views, figures, refusals.

    It is English until then. Names of columns, codes, and what ``to_json`` returns are the same in every language.

    Raises
    ------
    InputError
        For a language that there are no words in.

    Examples
    --------
    >>> import daq
    >>> daq.speak("de")
    >>> print(refused(5, "given-no-press"))
    int: eine Presse wird mit dem Pfad einer Pressendatei angegeben oder als das, was read_press gab
    >>> daq.speak("en")
    """
    if name_of(language) not in languages():
        raise InputError(say("given-no-language", language=str(language), languages=languages()))
    choose(language)


def path_of(given: object, code: str) -> Path:
    """Return a path that was given as such or as a text. Raises `InputError` for all else."""
    if not isinstance(given, str | os.PathLike):
        raise refused(given, code)
    if "\0" in str(given):
        raise InputError(say("given-path-nul", path=repr(str(given))))
    return Path(given)


def keys_of(given: object, code: str) -> Mapping[str, Any]:
    """Return a mapping by name; None is an empty one. Raises `InputError` for anything else."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise refused(given, code)
    if odd := [repr(key) for key in given if not isinstance(key, str)]:
        raise InputError(say("given-key-no-text", key=odd[0]))
    return given


class DoubtWarning(UserWarning):
    """Something given that can be and is doubtful all the same."""

    def __init__(self, doubt: Message) -> None:
        super().__init__(str(doubt))
        self.doubt = doubt
        """In words of any language."""


def warn(doubt: Message) -> None:
    """Warn of something given from Python, at the line outside our packages that gave it."""
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _OURS:
        frame, level = frame.f_back, level + 1
    warnings.warn(DoubtWarning(doubt), stacklevel=level)


def number_of(given: object) -> float:
    """Return a number that was given; NaN, which lies within no limits, for anything else and beyond all floats.

    >>> number_of(5), number_of("5"), number_of(True), number_of(10**400)
    (5.0, nan, nan, nan)
    """
    try:
        return float(given) if isinstance(given, Real) and not isinstance(given, bool) else math.nan
    except OverflowError:
        return math.nan


def reading_of(given: object) -> float | None:
    """Return a number as a logger or a table gives it, NaN for a missing one; None for anything else.

    >>> from decimal import Decimal
    >>> reading_of(True), reading_of(Decimal("21.5")), reading_of(None), reading_of("21.5")
    (1.0, 21.5, nan, None)
    """
    pandas = sys.modules.get("pandas")  # whoever gives one of its own has loaded it
    if given is None or given is getattr(pandas, "NA", None) or given is getattr(pandas, "NaT", None):
        return math.nan
    try:
        return float(given) if isinstance(given, NUMBERS) else None
    except OverflowError:
        return math.inf
    except ValueError:  # a signalling NaN
        return None


def pair_of(given: object, code: str) -> tuple[float, float]:
    """Return two numbers, such as a range. Raises `InputError` for anything else."""
    if not isinstance(given, Sequence) or isinstance(given, str) or len(given) != 2:
        raise refused(given, code)
    low, high = map(number_of, given)
    return low, high


def name_of(given: object) -> str:
    """Return a name that was given as a text. Raises `InputError` for anything else."""
    if not isinstance(given, str):
        raise refused(given, "given-no-names")
    return given


def names_of(given: object) -> list[str]:
    """Return names that were given as one text or several. Raises `InputError` for anything else."""
    if isinstance(given, Iterable) and not isinstance(given, str):
        return [name_of(name) for name in given]
    return [name_of(given)]
