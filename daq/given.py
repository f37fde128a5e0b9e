"""What is given from Python, held against what is asked for: anything else is refused in words."""

from __future__ import annotations

import inspect
import math
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Any

from daq.records import InputError
from daq.words import Message, say
from daq.words.message import choose, languages

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
    if language not in languages():
        raise InputError(say("given-no-language", language=str(language), languages=languages()))
    choose(language)


def path_of(given: object, code: str) -> Path:
    """Return a path that was given as such or as a text. Raises `InputError` for anything else."""
    if isinstance(given, str | os.PathLike):
        return Path(given)
    raise refused(given, code)


def keys_of(given: object, code: str) -> Mapping[str, Any]:
    """Return a mapping by name; None is an empty one. Raises `InputError` for anything else."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise refused(given, code)
    if odd := [repr(key) for key in given if not isinstance(key, str)]:
        raise InputError(say("given-key-no-text", key=odd[0]))
    return given


def warn(doubt: Message) -> None:
    """Warn of something given from Python, at the line outside our packages that gave it."""
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _OURS:
        frame, level = frame.f_back, level + 1
    warnings.warn(str(doubt), stacklevel=level)


def number_of(given: object) -> float:
    """Return a number that was given; NaN, which lies within no limits, for anything else.

    >>> number_of(5), number_of("5"), number_of(True)
    (5.0, nan, nan)
    """
    return float(given) if isinstance(given, Real) and not isinstance(given, bool) else math.nan


def pair_of(given: object, code: str) -> tuple[float, float]:
    """Return two numbers, such as a range. Raises `InputError` for anything else."""
    if not isinstance(given, Sequence) or isinstance(given, str) or len(given) != 2:
        raise refused(given, code)
    low, high = map(number_of, given)
    return low, high


def names_of(given: object) -> list[str]:
    """Return names that were given as one text or several. Raises `InputError` for anything else."""
    if isinstance(given, str):
        return [given]
    names: list[Any] = list(given) if isinstance(given, Iterable) else [given]
    if odd := [name for name in names if not isinstance(name, str)]:
        raise refused(odd[0], "given-no-names")
    return names
