"""Runs as pandas tables and back: scans below one another, the header in ``attrs``. What goes in comes out."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

import numpy as np
import pandas as pd

from daq.files.qualities import OTHERS, row_faults, without_unusable
from daq.files.run_rows import CLOSED, TIME, Rows, check_names, check_rows, row_place
from daq.press.header import check_header
from daq.records import Array, InputError, Quality, Run
from daq.tables import at
from daq.words import say

STARTED = "recorded.started_utc"
"""Header key of the instant at which `time_s` is 0."""


def frame_of(run: Run, *, utc: bool = False) -> pd.DataFrame:
    """Return a run as a table, one row a scan: its header in ``attrs``, its texts as columns.

    Parameters
    ----------
    utc
        Index the rows by instants in UTC, not by ``time_s``: to join them with other tables.

    Raises
    ------
    InputError
        For instants of a run whose header does not say when it began.
    """
    index = _instants(run) if utc else pd.Index(run.time_s, name=TIME)
    frame = pd.DataFrame({**run.columns, **run.texts}, index=index)
    frame.attrs.update({**run.header, "run": run.name})
    return frame


def qualities_of(run: Run) -> pd.DataFrame:
    """Return what each value is worth, one column a channel (``good``, ``open``, ``stale``, ...), by ``time_s``.

    A missing value that nothing is said of is ``missing``; columns that a row's ``*`` covers have its quality.
    """
    codes = {quality: np.int8(code) for code, quality in enumerate(Quality)}
    cells = {
        name: np.where(np.isnan(values), codes[Quality.MISSING], codes[Quality.GOOD])
        for name, values in run.columns.items()
    }
    for row, faults in enumerate(row_faults(run) or ()):
        for name in cells if faults else ():
            if (quality := faults.get(name, faults.get(OTHERS))) is not None:
                cells[name][row] = codes[quality]
    kind = pd.CategoricalDtype([str(quality) for quality in Quality])
    columns = {name: pd.Categorical.from_codes(of, dtype=kind) for name, of in cells.items()}
    return pd.DataFrame(columns, index=pd.Index(run.time_s, name=TIME))


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
            columns[str(column)] = _numbers(values)
        else:
            texts[str(column)] = tuple(values.astype(object).where(values.notna(), "").astype(str).tolist())
    rows = Rows(columns, texts)
    check_rows(name, rows)
    check_header(keys, name)
    del columns[TIME]
    return without_unusable(Run(name, keys, times, columns, name, texts))


def _numbers(values: pd.Series[Any] | pd.Index[Any]) -> Array:
    """Return a column of numbers; one of 64-bit floats is not copied."""
    return np.asarray(values) if values.dtype == np.float64 else values.to_numpy(dtype=float, na_value=np.nan)


def _times(name: str, frame: pd.DataFrame, keys: dict[str, Any]) -> Array:
    """Return the times [s]; instants of a zone are counted from the microsecond that goes into the header."""
    if frame.empty:
        raise InputError(say("frame-without-rows", run=name))
    if TIME in frame.columns:
        return _numbers(frame[TIME])
    if isinstance(frame.index, pd.DatetimeIndex):
        if frame.index.hasnans:
            row = int(np.argmax(frame.index.isna()))
            raise InputError(at(name, say("at-place", place=row_place(row), what=say("run-time-missing"))))
        start = frame.index[0]
        if frame.index.tz is not None:
            given = keys.get(STARTED)
            known = isinstance(given, datetime) and given.tzinfo is not None and given <= start
            start = pd.Timestamp(given) if known else start.floor("us")
            keys[STARTED] = start.tz_convert("UTC").to_pydatetime()
        return np.asarray((frame.index.as_unit("ns") - start).asi8 / 1e9, float)
    if frame.index.name == TIME:
        return _numbers(frame.index)
    raise InputError(say("frame-without-times", run=name, columns=tuple(str(c) for c in frame.columns[:8])))


def _instants(run: Run) -> pd.DatetimeIndex:
    started = run.header.get(STARTED)
    if not isinstance(started, datetime) or started.tzinfo is None:
        raise InputError(at(run.source or run.name, say("frame-without-start", key=STARTED)))
    nanoseconds = np.rint(run.time_s * 1e9).astype(np.int64)
    return pd.DatetimeIndex(
        pd.Timestamp(started).tz_convert("UTC").as_unit("ns") + pd.to_timedelta(nanoseconds), name="utc"
    )
