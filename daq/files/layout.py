"""How a pandas table was laid out that a run was made of: the order and kinds of its columns, and its index.

A run holds channels of 64-bit floats and texts; what the table had besides is kept here, so that it comes back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from daq.files.instants import STARTED
from daq.files.run_rows import TIME
from daq.records import Array, Run


@dataclass(frozen=True)
class Layout:
    """What a table had that a run has not."""

    kinds: Mapping[str, Any]
    """pandas' dtype of each column, in the table's order; of `time_s` that of the times."""
    in_index: bool
    """Whether the times stood in the index, not in a column."""
    index: Any
    """The index' name."""
    first: pd.Timestamp | None
    """The first of instants without a zone, which no header tells."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Let it go to another process, which a read-only mapping does not by itself."""
        return _made, (dict(self.kinds), self.in_index, self.index, self.first)


def _made(kinds: Mapping[str, Any], in_index: bool, index: Any, first: pd.Timestamp | None) -> Layout:
    return Layout(MappingProxyType(dict(kinds)), in_index, index, first)


def layout_of(frame: pd.DataFrame, times: pd.Series[Any]) -> Layout:
    """Return how a table is laid out whose times are these."""
    in_index = TIME not in frame.columns
    kinds = {str(column): kind for column, kind in frame.dtypes.items()} | {TIME: times.dtype}
    naive = pd.api.types.is_datetime64_dtype(times.dtype)
    return _made(kinds, in_index, frame.index.name, times.iloc[0] if naive else None)


def with_kinds(frame: pd.DataFrame, layout: Layout) -> pd.DataFrame:
    """Return a run's table with its columns in the order and of the kinds that the layout tells."""
    order = [column for column in layout.kinds if column in frame.columns]
    order += [column for column in frame.columns if column not in layout.kinds]
    if order != list(frame.columns):
        frame = frame[order]
    changed = {
        column: _of_kind(frame[column], kind)
        for column, kind in layout.kinds.items()
        if column in frame.columns and frame[column].dtype != kind
    }
    return frame.assign(**changed) if changed else frame


def with_index(frame: pd.DataFrame, layout: Layout, run: Run) -> pd.DataFrame:
    """Return a run's table with its times where the layout has them, as instants, durations or seconds."""
    times = _times(run, layout)
    if layout.in_index:
        return frame.set_index(times.rename(layout.index))
    placed = frame.reset_index(drop=True)
    columns = list(layout.kinds)
    placed.insert(min(columns.index(TIME), placed.shape[1]), TIME, times)
    return placed


def _times(run: Run, layout: Layout) -> pd.Index:
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
