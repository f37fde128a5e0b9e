"""Runs as pandas tables and back: scans below one another, the header in ``attrs``. What goes in comes out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from typing import Any

import numpy as np
import pandas as pd

from daq.files.instants import STARTED, for_json, from_json, seconds_of
from daq.files.layout import TableLayout, layout_of, nanoseconds_of, with_index, with_kinds
from daq.files.qualities import OTHERS, rows_alike, without_unusable
from daq.files.run_rows import TIME, Rows, check_names, check_rows, row_place
from daq.files.table_columns import holds_numbers, numbers_in, rows_in
from daq.given import keys_of, refused, warn
from daq.press.header import check_header, doubts, flat_attrs, flat_header
from daq.records import UNNAMED, Array, InputError, Quality, Run, with_frozen_fields
from daq.tables import at
from daq.words import say


def frame_of(run: Run, *, utc: bool = False, as_given: bool = False) -> pd.DataFrame:
    """Return a run as a table, one row a scan: its header in ``attrs``, its texts as columns.

    What JSON does not hold, instants and dates, stands as ISO text in ``attrs``, so that Parquet can be written.
    A run that `run_of` made of a table has that table's columns in their order and of their kinds (whole numbers
    of any size, categories, instants of a zone, narrower floats, objects, texts with gaps), as long as the run
    says the same of them; a column changed since then has what it says now.

    Parameters
    ----------
    utc
        Index the rows by instants in UTC, not by ``time_s``: to join them with other tables.
    as_given
        Index them as that table was: by instants of its zone or of none, by durations, or with a column
        ``time_s`` beside whatever its index was; a run of a file by ``time_s``.

    Raises
    ------
    InputError
        For instants in UTC of a run whose header does not say when it began.

    Examples
    --------
    >>> import pandas as pd
    >>> rows = pd.date_range("2026-03-04 08:00", periods=2, freq="1s", tz="Europe/Berlin", name="at")
    >>> run = run_of(pd.DataFrame({"top_1": [21.4, 21.5], "cycle": [7, 7]}, index=rows))
    >>> frame_of(run).index.tolist(), frame_of(run)["cycle"].tolist()
    ([0.0, 1.0], [7, 7])
    >>> frame_of(run, as_given=True).rename_axis(None)
                               top_1  cycle
    2026-03-04 08:00:00+01:00   21.4      7
    2026-03-04 08:00:01+01:00   21.5      7
    """
    if not isinstance(run, Run):
        raise refused(run, "given-no-run")
    index = _instants(run) if utc else pd.Index(run.time_s, name=TIME)
    frame = pd.DataFrame({**run.columns, **run.texts}, index=index)
    if isinstance(run.layout, TableLayout):
        frame = with_kinds(frame, run.layout, run)
        frame = with_index(frame, run.layout, run) if as_given and not utc else frame
    frame.attrs.update(attrs_of(run))
    return frame


def attrs_of(run: Run) -> dict[str, Any]:
    """Return a run's header as the ``attrs`` of a table that is about it."""
    return for_json({**run.header, "run": run.name})


def qualities_of(run: Run) -> pd.DataFrame:
    """Return what each value is worth, one column a channel (``good``, ``open``, ``stale``, ...), by ``time_s``.

    A missing value without a quality is ``missing``; columns that a row's ``*`` covers have its quality.

    Examples
    --------
    >>> import pandas as pd
    >>> table = pd.DataFrame({"time_s": [0.0, 1.0], "top_1": [21.0, 999.0], "quality": ["", "top_1=open"]})
    >>> qualities_of(run_of(table))["top_1"].tolist(), run_of(table).columns["top_1"].tolist()
    (['good', 'open'], [21.0, nan])
    """
    if not isinstance(run, Run):
        raise refused(run, "given-no-run")
    codes = {quality: np.int8(code) for code, quality in enumerate(Quality)}
    cells = {
        name: np.where(np.isnan(values), codes[Quality.MISSING], codes[Quality.GOOD])
        for name, values in run.columns.items()
    }
    for faults, rows in rows_alike(run):
        for name, of in cells.items():
            if (quality := faults.get(name, faults.get(OTHERS))) is not None:
                of[rows] = codes[quality]
    kind = pd.CategoricalDtype([str(quality) for quality in Quality])
    columns = {name: pd.Categorical.from_codes(of, dtype=kind) for name, of in cells.items()}
    return pd.DataFrame(columns, index=pd.Index(run.time_s, name=TIME))


def run_of(frame: pd.DataFrame, header: Mapping[str, Any] | None = None) -> Run:
    """Return a table as a run, which shares no memory with it and cannot be changed.

    Parameters
    ----------
    frame
        One row a scan. Times: a column ``time_s`` or an index, of that name where it holds numbers [s]. Instants
        are counted from the first one, which goes into the header where they know their zone; durations
        (timedelta) are taken in seconds. Integers, booleans, narrower floats, decimals and objects that are all
        numbers become channels of 64-bit floats, a missing value NaN. All else stays beside them as text:
        categories by their names, instants and dates as ISO text, a missing value as empty text; `frame_of` gives
        both back as they were. A column's label that is no text becomes one.
    header
        Keys of the run file; those of ``frame.attrs`` that it does not name are added. ISO text under a key
        ``recorded.*`` is an instant.

    Raises
    ------
    InputError
        For times that do not rise, names that come twice, values that no channel has, complex numbers, labels or
        times of several levels, or a key of ``attrs`` that is no text: column and row are named.

    Examples
    --------
    >>> import pandas as pd
    >>> run_of(pd.DataFrame({"time_s": [0.0, 0.5], "top_1": [21.0, None]}), {"run": "a", "panel.material": "MDF"})
    Run a: 2 scans, 0 to 0.5 s
    top_1
    run = a
    panel.material = MDF
    """
    if not isinstance(frame, pd.DataFrame):
        raise refused(frame, "given-no-table")
    given = {**frame.attrs, **keys_of(header, "given-no-header")}
    _check_labels(frame, given)
    keys = from_json({**flat_attrs(frame.attrs), **flat_header(header or {})})
    name = str(keys.get("run", UNNAMED))
    check_names(name, [str(column) for column in frame.columns])
    given_times = _times_in(name, frame)
    times = _times(name, frame, given_times, keys)
    found = rows_in(name, frame[[column for column in frame.columns if column != TIME]])
    columns, texts = {TIME: times, **found.columns}, found.texts
    check_rows(name, Rows(columns, texts))
    check_header(keys, name)
    for doubt in doubts(keys):
        warn(doubt)
    del columns[TIME]
    made = Run(name, keys, times, columns, name, texts)
    made = replace(made, layout=layout_of(frame, given_times, made))
    run: Run = with_frozen_fields(without_unusable(made))
    return run


def _check_labels(frame: pd.DataFrame, keys: Mapping[Any, Any]) -> None:
    """Refuse columns and keys that no run file can name."""
    if frame.columns.nlevels > 1:
        raise InputError(say("frame-column-levels", levels=frame.columns.nlevels))
    if odd := [repr(key) for key in keys if not isinstance(key, str)]:
        raise InputError(say("frame-key-no-text", key=odd[0]))


def _times_in(name: str, frame: pd.DataFrame) -> pd.Series[Any]:
    """Return a table's times as they stand there."""
    if frame.empty:
        raise InputError(say("frame-without-rows", run=name))
    if TIME not in frame.columns and frame.index.nlevels > 1:
        levels = tuple("?" if level is None else str(level) for level in frame.index.names)
        raise InputError(say("frame-index-levels", run=name, levels=frame.index.nlevels, names=levels))
    times = frame[TIME] if TIME in frame.columns else frame.index.to_series(name=frame.index.name)
    return times.infer_objects()


def _times(name: str, frame: pd.DataFrame, times: pd.Series[Any], keys: dict[str, Any]) -> Array:
    """Return the times [s]; instants of a zone are counted from the microsecond that goes into the header."""
    if pd.api.types.is_datetime64_any_dtype(times):
        return _seconds(name, pd.DatetimeIndex(times), keys)
    if pd.api.types.is_timedelta64_dtype(times):
        return np.asarray(times.dt.total_seconds(), float)
    if times.name == TIME:
        return numbers_in(name, times, numbers=holds_numbers(times))
    remedy = say("frame-times-of-periods") if isinstance(times.dtype, pd.PeriodDtype) else say("frame-times-here")
    columns = tuple(str(c) for c in frame.columns[:8])
    raise InputError(say("frame-without-times", run=name, columns=columns, remedy=remedy))


def _seconds(name: str, instants: pd.DatetimeIndex, keys: dict[str, Any]) -> Array:
    """Return instants in seconds since the first of them, or since the start that the header gives."""
    if instants.hasnans:
        row = int(np.argmax(instants.isna()))
        raise InputError(at(name, say("at-place", place=row_place(row), what=say("run-time-missing"))))
    return seconds_of(instants.as_unit("ns").asi8, keys, zoned=instants.tz is not None)


def _instants(run: Run) -> pd.DatetimeIndex:
    started = run.header.get(STARTED)
    if not isinstance(started, datetime) or started.tzinfo is None:
        raise InputError(at(run.source or run.name, say("frame-without-start", key=STARTED)))
    return pd.DatetimeIndex(
        pd.Timestamp(started).tz_convert("UTC").as_unit("ns") + pd.to_timedelta(nanoseconds_of(run.time_s)),
        name="utc",
    )
