"""Runs as pandas tables and back: scans below one another, the header in ``attrs``. What goes in comes out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from daq.files.qualities import without_unusable
from daq.files.run_rows import CLOSED, TIME, Rows, check_names, check_rows
from daq.press.header import check_header
from daq.records import Array, InputError, Run
from daq.words import say

STARTED = "recorded.started_utc"
"""Header key of the instant at which `time_s` is 0."""


def frame_of(run: Run) -> pd.DataFrame:
    """Return a run as a table indexed by ``time_s``, its header in ``attrs``, its texts as columns."""
    index = pd.Index(run.time_s, name=TIME)
    return _with_attrs(pd.DataFrame({**run.columns, **run.texts}, index=index), {**run.header, "run": run.name})


def run_of(frame: pd.DataFrame, header: Mapping[str, Any] | None = None) -> Run:
    """Return a table as a run.

    Parameters
    ----------
    frame
        One row a scan. Times: a column ``time_s`` or an index of that name [s], or an index of instants, from
        whose first one ``time_s`` is then counted; instants that know their zone go into the header. Numbers
        become channels, texts stay beside them; a value that is missing is NaN.
    header
        Keys of the run file; those of ``frame.attrs`` that it does not name are added.

    Raises
    ------
    InputError
        For times that do not rise, names that come twice, or values that no channel has: column and row are named.
    """
    keys = {**frame.attrs, **(header or {})}
    name = str(keys.get("run", "frame"))
    check_names(name, [str(column) for column in frame.columns])
    times = _times(name, frame, keys)
    columns, texts = {TIME: times}, dict[str, tuple[str, ...]]()
    for column in frame.columns:
        if column == TIME:
            continue
        values = frame[column]
        if pd.api.types.is_numeric_dtype(values) or pd.api.types.is_bool_dtype(values) or column == CLOSED:
            columns[str(column)] = values.to_numpy(dtype=float, na_value=np.nan)
        else:
            texts[str(column)] = tuple("" if pd.isna(cell) else str(cell) for cell in values)
    rows = Rows(columns, texts)
    check_rows(name, rows)
    check_header(keys, name)
    del columns[TIME]
    return without_unusable(Run(name, keys, times, columns, name, texts))


def _times(name: str, frame: pd.DataFrame, keys: dict[str, Any]) -> Array:
    if frame.empty:
        raise InputError(say("frame-without-rows", run=name))
    if TIME in frame.columns:
        return np.asarray(frame[TIME].to_numpy(dtype=float, na_value=np.nan), float)
    if isinstance(frame.index, pd.DatetimeIndex):
        if frame.index.tz is not None:
            keys.setdefault(STARTED, frame.index[0].tz_convert("UTC").to_pydatetime())
        return np.asarray((frame.index - frame.index[0]) / pd.Timedelta(seconds=1), float)
    if frame.index.name == TIME:
        return np.asarray(frame.index.to_numpy(dtype=float), float)
    raise InputError(say("frame-without-times", run=name, columns=tuple(str(c) for c in frame.columns[:8])))


def _with_attrs(frame: pd.DataFrame, attrs: Mapping[str, Any]) -> pd.DataFrame:
    frame.attrs.update(attrs)
    return frame
