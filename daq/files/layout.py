"""How a pandas table was laid out that a run was made of: the order and kinds of its columns, and its index.

A run holds channels of 64-bit floats and texts; what the table had besides is kept here, so that it comes back.
What those cannot hold (a gap among texts, whole numbers above 2**53, objects) is kept as it was given, and comes
back while the run still says the same of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from daq.files.instants import STARTED
from daq.files.run_rows import TIME
from daq.records import Array, Run

WHOLE = 2**53
"""Beyond it not every whole number is a 64-bit float. (IEEE 754-2019, binary64: 53 bits)"""


@dataclass(frozen=True, eq=False)
class TableLayout:
    """What a table had that a run has not."""

    kinds: Mapping[str, Any]
    """pandas' dtype of each column, in the table's order; of `time_s` that of the times."""
    in_index: bool
    """Whether the times stood in the index, not in a column."""
    index: Any
    """The index' name."""
    freq: Any
    """How far apart the instants or durations of its index are, where pandas knows them to be even."""
    first: pd.Timestamp | None
    """The first of instants without a zone, which no header states."""
    rows: pd.Index
    """Its times in the run, by which the rows of what is kept are found. [s]"""
    labels: pd.Index | None
    """Its index, where the times stood in a column beside one that does not just count."""
    heads: Any
    """The name of its columns' axis."""
    kept: Mapping[str, tuple[pd.Series[Any], pd.Series[Any]]]
    """By column what was given and what the run holds of it, where that alone does not give it back."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Let it go to another process, which a read-only mapping does not by itself."""
        held = {one.name: getattr(self, one.name) for one in fields(self)}
        return _made, (held | {"kinds": dict(self.kinds), "kept": dict(self.kept)},)

    def places(self, time_s: Array) -> Any:
        """Return at which of the table's rows these times stand; None where one stands at none."""
        found = self.rows.get_indexer(pd.Index(time_s))
        return None if (found < 0).any() else found


def _made(held: Mapping[str, Any]) -> TableLayout:
    layout = TableLayout(**held)
    return replace(layout, kinds=MappingProxyType(layout.kinds), kept=MappingProxyType(layout.kept))


def layout_of(frame: pd.DataFrame, times: pd.Series[Any], run: Run) -> TableLayout:
    """Return how a table is laid out whose times are these, and which became this run."""
    in_index = TIME not in frame.columns
    kinds = {str(column): kind for column, kind in frame.dtypes.items()} | {TIME: times.dtype}
    naive = pd.api.types.is_datetime64_dtype(times.dtype)
    kept = {}
    for column in frame.columns.drop(TIME, errors="ignore"):
        given, held = frame[column].reset_index(drop=True), {**run.columns, **run.texts}[str(column)]
        if _is_more_than_held(given):
            kept[str(column)] = (given.copy(), pd.Series(held))
    counts = isinstance(frame.index, pd.RangeIndex) and frame.index.equals(pd.RangeIndex(len(frame)))
    labels = None if in_index or (counts and frame.index.name is None) else frame.index
    first = times.iloc[0] if naive else None
    timed = isinstance(frame.index, pd.DatetimeIndex | pd.TimedeltaIndex)
    places = {"in_index": in_index, "index": frame.index.name, "rows": pd.Index(run.time_s), "labels": labels}
    places |= {"freq": frame.index.freq if timed else None}
    return _made({"kinds": kinds, "first": first, "heads": frame.columns.name, "kept": kept} | places)


def _is_more_than_held(given: pd.Series[Any]) -> bool:
    """Return whether a column's kind does not give it back from what a run holds of it."""
    if pd.api.types.is_integer_dtype(given.dtype):
        return bool((given.lt(-WHOLE) | given.gt(WHOLE)).any())
    gaps = isinstance(given.dtype, pd.StringDtype) and given.isna().any()
    return bool(gaps) or pd.api.types.is_object_dtype(given.dtype)


def with_kinds(frame: pd.DataFrame, layout: TableLayout, run: Run) -> pd.DataFrame:
    """Return a run's table with its columns in the order and of the kinds of its layout."""
    order = [column for column in layout.kinds if column in frame.columns]
    order += [column for column in frame.columns if column not in layout.kinds]
    if order != list(frame.columns):
        frame = frame[order]
    places = layout.places(run.time_s) if layout.kept else None
    changed = {
        column: _as_given(frame[column], layout, places)
        for column, kind in layout.kinds.items()
        if column in frame.columns and (frame[column].dtype != kind or column in layout.kept)
    }
    return (frame.assign(**changed) if changed else frame).rename_axis(columns=layout.heads)


def _as_given(values: pd.Series[Any], layout: TableLayout, places: Any) -> pd.Series[Any]:
    """Return a column as it was given, as far as the run still says the same of it."""
    column = str(values.name)
    if column in layout.kept and places is not None:
        given, held = (one.take(places) for one in layout.kept[column])
        if held.reset_index(drop=True).equals(values.reset_index(drop=True)):
            return given.set_axis(values.index)
    return _of_kind(values, layout.kinds[column])


def with_index(frame: pd.DataFrame, layout: TableLayout, run: Run) -> pd.DataFrame:
    """Return a run's table with its times where the layout has them, as instants, durations or seconds."""
    times = _times(run, layout)
    if layout.in_index:
        return frame.set_index(_evenly(times, layout.freq).rename(layout.index))
    placed = frame.reset_index(drop=True)
    columns = list(layout.kinds)
    placed.insert(min(columns.index(TIME), placed.shape[1]), TIME, times)
    places = layout.places(run.time_s)
    if layout.labels is None or places is None:
        return placed
    return placed.set_index(_evenly(layout.labels.take(places), layout.freq))


def _evenly(times: pd.Index, freq: Any) -> pd.Index:
    """Return times that know how far apart they are, where they are so still."""
    if freq is None or not isinstance(times, pd.DatetimeIndex | pd.TimedeltaIndex):
        return times
    try:
        return type(times)(times, freq=freq)
    except ValueError:
        return times


def _times(run: Run, layout: TableLayout) -> pd.Index:
    kind = layout.kinds[TIME]
    if not pd.api.types.is_datetime64_any_dtype(kind) and not pd.api.types.is_timedelta64_dtype(kind):
        return pd.Index(_of_kind(pd.Series(run.time_s), kind))
    durations = pd.to_timedelta(nanoseconds_of(run.time_s))
    if pd.api.types.is_timedelta64_dtype(kind):
        return pd.Index(durations.astype(kind))
    start = run.header[STARTED] if layout.first is None else layout.first
    instants = pd.Timestamp(start).as_unit("ns") + durations
    return pd.Index(pd.Series(instants).astype(kind))


def nanoseconds_of(time_s: Array) -> Any:
    """Return times in whole nanoseconds."""
    return np.rint(time_s * 1e9).astype(np.int64)


def _of_kind(values: pd.Series[Any], kind: Any) -> pd.Series[Any]:
    """Return a column as it was; unchanged where its kind cannot hold what is in it now."""
    if isinstance(kind, pd.CategoricalDtype):
        return _categories(values, kind)
    if not pd.api.types.is_numeric_dtype(values.dtype):
        return _from_texts(values, kind)
    whole = isinstance(kind, np.dtype) and kind.kind in "iub"
    if pd.api.types.is_object_dtype(kind) or (whole and values.isna().any()):
        return values
    try:
        with np.errstate(invalid="ignore"):
            found = values.astype(kind)
            back = found.to_numpy(dtype=float, na_value=np.nan)
    except (TypeError, ValueError):
        return values
    return found if np.array_equal(back, values.to_numpy(dtype=float), equal_nan=True) else values


def _categories(values: pd.Series[Any], kind: pd.CategoricalDtype) -> pd.Series[Any]:
    texts: Sequence[str] = values.tolist()
    codes = {"": -1} | {str(category): code for code, category in enumerate(kind.categories)}
    if not codes.keys() >= set(texts):
        return values
    found = pd.Categorical.from_codes([codes[text] for text in texts], dtype=kind)
    return pd.Series(found, index=values.index)


def _from_texts(values: pd.Series[Any], kind: Any) -> pd.Series[Any]:
    """Return instants and durations from the texts that a run keeps of them; other texts stay."""
    missing = values.where(values != "", None)
    try:
        if pd.api.types.is_datetime64_any_dtype(kind):
            zoned = isinstance(kind, pd.DatetimeTZDtype)
            return pd.to_datetime(missing, utc=zoned, format="ISO8601").astype(kind)
        if pd.api.types.is_timedelta64_dtype(kind):
            return pd.to_timedelta(missing).astype(kind)
    except ValueError:
        return values
    return values.astype(kind) if isinstance(kind, pd.StringDtype) else values
