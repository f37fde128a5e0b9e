"""The tables of a mapping, which explains a foreign logger's file: `daq.files.mapping` shows one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, TypeAlias
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator

from daq.press.header import flat_header, flat_if_tables
from daq.words import say


class _MappingTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class FileTable(_MappingTable):
    """``[file]``: how the text is laid out."""

    encoding: str = "utf-8-sig"
    delimiter: Literal[",", ";", "|", "tab", "space"] = ","
    decimal: Literal[".", ","] = "."
    header_line: int = Field(default=1, ge=1)
    units_lines: int = Field(default=0, ge=0)
    comment: str = "#"
    missing: tuple[str, ...] = ("", "NaN", "nan", "NA", "---")


class TimeTable(_MappingTable):
    """``[time]``: what the time column holds."""

    column: str | tuple[str, ...]
    format: str = "seconds"
    zone: str = ""
    """Of dates and times that have none of their own; without, they are only counted from the first row."""
    from_zero: bool = True
    """Count from the first row; instants always do."""
    repeated: Literal["refuse", "first"] = "refuse"

    @field_validator("zone")
    @classmethod
    def _known_zone(cls, zone: str) -> str:
        try:
            return zone and ZoneInfo(zone).key
        except (ZoneInfoNotFoundError, ValueError, OSError) as error:
            raise ValueError(say("mapping-no-zone")) from error

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns whose cells, joined by blanks, give the time."""
        return (self.column,) if isinstance(self.column, str) else self.column


class ColumnTable(_MappingTable):
    """``[[column]]``: one column of the run file."""

    source: str | tuple[str, ...] = Field(alias="from", min_length=1)
    """Its name in the file; of several the first that is there."""
    to: str = Field(min_length=1)
    unit: Literal["C", "K", "F", ""] = "C"
    scale: float = 1.0
    offset: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    optional: bool = False
    """The file may lack it."""

    @property
    def sources(self) -> tuple[str, ...]:
        """Its possible names in the file, the likeliest first."""
        return (self.source,) if isinstance(self.source, str) else self.source

    def found(self, names: Sequence[str]) -> str | None:
        """Return the name it goes by in a file, None where the file lacks it."""
        return next((source for source in self.sources if source in names), None)


class ComputedTable(_MappingTable):
    """``[[computed]]``: a weighted sum of mapped columns, empty where one of them is."""

    to: str = Field(min_length=1)
    terms: Mapping[str, float] = Field(min_length=1)
    """Weight of each column, by its name in the run file."""
    offset: float = 0.0


class HeaderFrom(_MappingTable):
    """``[header_from.KEY]``: a header key from the first or last value of a mapped column."""

    column: str
    scale: float = 1.0
    digits: int = 3
    row: Literal["first", "last"] = "first"


def _flat_sources(tables: Any) -> Any:
    """Return by dotted key what `[header_from]` holds, of which each table of tables is a part of a key."""
    if not isinstance(tables, Mapping):
        return tables
    wrapped = {key: _wrapped(value) for key, value in tables.items()}
    return {key: value[0] if isinstance(value, tuple) else value for key, value in flat_header(wrapped).items()}


def _wrapped(value: Any) -> Any:
    """Return a table of tables as such with each table of values in a tuple, which nothing looks into."""
    if not isinstance(value, Mapping):
        return value
    if value and all(isinstance(one, Mapping) for one in value.values()):
        return {key: _wrapped(one) for key, one in value.items()}
    return (value,)


Header: TypeAlias = Annotated[Mapping[str, Any], BeforeValidator(flat_if_tables)]
"""Keys of a run's header, also where an unquoted dotted key made tables of them."""


class Variant(_MappingTable):
    """``[[variant]]``: header keys for files whose name matches."""

    match: str
    header: Header
    of: str = ""
    """What it answers; a file that matches two answers to one question is refused."""


class Mapped(_MappingTable):
    """The whole mapping."""

    file: FileTable = FileTable()
    time: TimeTable
    column: tuple[ColumnTable, ...] = Field(min_length=1)
    computed: tuple[ComputedTable, ...] = ()
    header: Header = Field(default_factory=dict)
    header_from: Annotated[Mapping[str, HeaderFrom], BeforeValidator(_flat_sources)] = Field(default_factory=dict)
    variant: tuple[Variant, ...] = ()
    required_variants: tuple[str, ...] = ()
    """Questions (`Variant.of`) that a file's name has to answer."""
