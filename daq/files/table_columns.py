"""Columns of pandas tables: numbers for what holds numbers, texts for all else, here and from Parquet."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from daq.files.qualities import QUALITY
from daq.files.run_rows import CLOSED, Rows, check_no_words
from daq.given import NUMBERS
from daq.records import Array, InputError
from daq.words import say


def rows_in(name: str, frame: pd.DataFrame) -> Rows:
    """Return a table's columns: as numbers what holds numbers, all else as texts. Raises `InputError`."""
    columns, texts = dict[str, Array](), dict[str, tuple[str, ...]]()
    for column in frame.columns:
        values = frame[column]
        numbers = holds_numbers(values)
        if numbers or column == CLOSED:
            columns[str(column)] = numbers_in(name, values, numbers=numbers)
        else:
            texts[str(column)] = _texts(values)
    return Rows(columns, texts)


_COMPLEX = (complex, np.complexfloating)
_MISSING = (type(None), type(pd.NA), type(pd.NaT))


def holds_numbers(values: pd.Series[Any]) -> bool:
    """Return whether a column holds numbers; one of objects does if each is a number or missing, as in a file.

    Raises `InputError` for complex ones, which no channel holds.
    """
    objects = values.dtype == object
    kinds = set(map(type, values.to_numpy())) if objects else {values.dtype.type}
    if any(issubclass(kind, _COMPLEX) for kind in kinds):
        raise InputError(say("frame-column-complex", column=str(values.name)))
    if objects:
        return values.name != QUALITY and all(issubclass(kind, (*NUMBERS, *_MISSING)) for kind in kinds)
    return bool(pd.api.types.is_numeric_dtype(values) or pd.api.types.is_bool_dtype(values))


def _texts(values: pd.Series[Any] | pd.Index[Any]) -> tuple[str, ...]:
    found = values.astype(object)
    return tuple(found.where(values.notna(), "").astype(str).tolist())


def numbers_in(name: str, values: pd.Series[Any], *, numbers: bool) -> Array:
    """Return a copy of a column of numbers, as its table may be written to. Raises `InputError` for words."""
    if not numbers:
        check_no_words(name, str(values.name), _texts(values))
    return np.asarray(values.to_numpy(dtype=float, na_value=np.nan, copy=True))
