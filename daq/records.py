"""The vocabulary every part shares: channels, scans, press events, runs. Frozen data, no I/O."""

from __future__ import annotations

import fnmatch
import math
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from enum import StrEnum
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from daq.printed import LINE, in_notebook, in_short, lines_of
from daq.words import Message, say

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


def __getattr__(name: str) -> Any:  # NumPy takes half of the time in which the command line says its help
    if name != "Array":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import numpy as np
    from numpy.typing import NDArray

    return NDArray[np.float64]


Key = TypeVar("Key")
Value = TypeVar("Value")


class FrozenDict(dict[Key, Value]):
    """A dictionary that cannot be changed; unlike a mapping proxy it goes to other processes and into JSON."""

    def _refuse(self, *given: object, **named: object) -> NoReturn:
        raise TypeError("this cannot be changed; change a copy, dict(...)")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __repr__(self) -> str:
        """Return what a dictionary does, in short where that takes more than a line."""
        if len(line := in_short(self)) <= LINE:
            return line
        return "\n".join(lines_of([f"{key!r}: {in_short(one)}" for key, one in self.items()]))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy it as what it is made of."""
        return type(self), (dict(self),)


def frozen(value: Any) -> Any:
    """Return a value so that nobody changes what is in it: arrays read-only, mappings as `FrozenDict`.

    Lists and tuples are gone through and stay what they are. Arrays are not copied: who
    still holds the one beneath can write to it.
    """
    import numpy as np

    if type(value) is tuple and set(map(type, value)) <= {str}:
        return value  # a column of texts, of a million rows perhaps

    if isinstance(value, np.ndarray):
        view = value.view()
        view.flags.writeable = False
        return view
    if isinstance(value, FrozenDict):
        return value
    if isinstance(value, Mapping):
        return FrozenDict({key: frozen(one) for key, one in value.items()})
    return type(value)(frozen(one) for one in value) if type(value) in (list, tuple) else value


def with_frozen_fields(record: Any) -> Any:
    """Return a frozen dataclass whose fields are `frozen`; records in them stay as they are."""
    return replace(record, **{one.name: frozen(getattr(record, one.name)) for one in fields(record)})


ROOM_C = 23.0
"""Of a room where nothing is stated of it: the middle of halls of 16 to 30 °C. [°C]"""
USUAL_WAIT_S, WAIT_SD_S, LONGEST_WAIT_S = 18.0, 9.0, 30.0
"""How long a panel lies in the open press before that closes, where nobody saw or stated it: usually, with what
spread, at most. By hand, 2026-11. [s]"""
COLDEST_C, HOTTEST_C = -273.15, 2000.0
"""Between these lies every temperature in a press or a furnace. [°C]"""
GAS_CONSTANT = 6.02214076e23 * 1.380649e-23
"""Avogadro's constant times Boltzmann's, both exact. (SI brochure, 9th ed. 2019) [J/mol K]"""
STEFAN_BOLTZMANN = 5.670374419e-8
"""CODATA 2018, exact. [W/m²K⁴]"""


class InputError(ValueError):
    """What the user gave is wrong: the text names file, line or key, value, limit and remedy.

    The command line prints it as one line and exits with status 2.
    """


class Nonphysical(InputError):
    """A property, coefficient or temperature that no matter has."""


class OutsideLayer(InputError):
    """A sensor that lies outside the layer it is stated to be in."""


class BrokenTime(InputError):
    """Times that fall or stand still, or rows missing for longer than can be bridged."""


class BoundaryGap(InputError):
    """A measured boundary that is missing for longer than can be bridged."""


class NoSteadyState(InputError):
    """A stack whose steady temperatures before the first row do not exist, or cannot be found."""


class StartNotRead(InputError):
    """A start from first readings of which there is none."""


class Quality(StrEnum):
    """What one value is worth, from the wire to the chart."""

    GOOD = "good"
    """As read."""
    OPEN = "open"
    """The device reports an open circuit, or a value out of range that is at no end of the range."""
    OVER = "over"
    """At or above the most that the channel can measure."""
    UNDER = "under"
    """At or below the least."""
    STALE = "stale"
    """None of the logger's values has changed for too long: it may stand still."""
    BAD_FRAME = "bad_frame"
    """What came over the wire was no answer to what was asked, or what stands in the store is damaged."""
    MISSING = "missing"
    """There is none: an empty cell, no answer from the logger, or a channel that was not there."""
    LATE = "late"
    """Asked for, and not there when its scan had to be taken: a slow logger, or a busy machine."""
    SIMULATED = "simulated"
    """From a virtual press."""

    @property
    def usable(self) -> bool:
        """Whether fits and the live sensor may use the value."""
        return self in (Quality.GOOD, Quality.SIMULATED)


class PressState(StrEnum):
    """What the press is doing: no panel, panel in the open press, or pressing."""

    IDLE = "idle"
    """No panel in the press."""
    OPEN = "open"
    """A panel in the open press."""
    CLOSED = "closed"
    """A panel being pressed."""


class EventSource(StrEnum):
    """What showed a moment of the press."""

    TEMPERATURES = "temperatures"
    """Found in the readings of the sensors."""
    LIMIT_SWITCH = "limit switch"
    """A wire that distinguishes open and closed."""
    PRESSURE_CHANNEL = "pressure channel"
    """A logged pressure."""
    ONE_STATE = "one state"
    """A press that never opens: there was nothing to find."""
    UNKNOWN = "unknown"
    """No column shows it."""
    TRUTH = "truth"
    """The virtual press knows its own moments."""

    @property
    def is_wire(self) -> bool:
        """Whether it is a wire, which knows the moment to a scan."""
        return self in (EventSource.LIMIT_SWITCH, EventSource.PRESSURE_CHANNEL)

    @property
    def message(self) -> Message:
        """The source in words."""
        return say(f"told-by-{self.value.replace(' ', '-')}")


class PressEventKind(StrEnum):
    """The four moments of a pressing, in the order they happen."""

    INSERTED = "inserted"
    CLOSED = "closed"
    OPENED = "opened"
    REMOVED = "removed"


@dataclass(frozen=True)
class Channel:
    """One input of a logger."""

    name: str
    """Column name in run files, such as ``top_1``."""
    unit: str = "C"
    age_s: float = field(default=0.0, compare=False)
    """How old its values are on average when the logger hands them out. [s]"""


@dataclass(frozen=True)
class Reading:
    """What one logger answered to one request: its channels, in the order it declares them."""

    requested_s: float
    """Monotonic time the request left. [s]"""
    received_s: float
    """Monotonic time the reply was complete. [s]"""
    values: tuple[float, ...]
    """Temperatures, NaN where there is none. [C]"""
    qualities: tuple[Quality, ...]


@dataclass(frozen=True)
class Scan:
    """All channels of one press at one moment."""

    number: int
    """Counts up by one for each scheduled scan since the recorder started this press."""
    utc: datetime
    monotonic_s: float
    values: tuple[float, ...]
    """Temperatures in the press's channel order, NaN where there is none. [C]"""
    qualities: tuple[Quality, ...]


@dataclass(frozen=True)
class PressEvent:
    """The press changed state at a moment, noticed at a later one."""

    kind: PressEventKind
    monotonic_s: float
    """When it happened, as well as the scans show. [s]"""
    noticed_s: float
    """The scan at which the detector could say so. [s]"""
    source: EventSource = EventSource.TEMPERATURES


@dataclass(frozen=True)
class Panel:
    """The board in the press: thickness and constants in SI units."""

    material: str
    thickness: float
    """[m]"""
    density: float
    """[kg/m³]"""
    conductivity: float
    """[W/mK]"""
    heat_capacity: float
    """[J/kgK]"""
    initial_temperature: float
    """[°C]"""
    moisture_percent: float | None = None
    conductivity_table: tuple[tuple[float, float], ...] = ()
    """Rows of temperature and conductivity where the header gives a table, whose first row's stands above.
    [°C, W/mK]"""
    heat_capacity_table: tuple[tuple[float, float], ...] = ()
    """The same of the heat capacity. [°C, J/kgK]"""


KEYS_SHOWN = 20
"""Header keys of a run, and lines of a press, shown on one screen of 25 lines."""


UNNAMED = "frame"
"""The name of a run that was given as a table without one."""


def matches(column: str, patterns: Iterable[str]) -> bool:
    """Return whether a column has a name that one of these shell-style patterns means."""
    return any(fnmatch.fnmatchcase(column, pattern) for pattern in patterns)


@dataclass(frozen=True, repr=False, eq=False)
class Run:
    """One measured pressing: what a run file or the store holds, in memory.

    ``columns`` maps every column but ``time_s`` to a float array of the same length,
    NaN where the cell is empty or not usable. ``header`` holds the dotted keys as given. What `daq.run_of` and
    `softsensor.read_run` hand out cannot be changed, mappings and arrays neither; `dataclasses.replace` makes
    another run. Two runs are equal only if they are the same object.
    """

    name: str
    """Which run it is, in files and in the store."""
    header: Mapping[str, Any]
    """By dotted key, as given; units stand in the keys."""
    time_s: Array
    """Of each scan, rising (n). [s]"""
    columns: Mapping[str, Array]
    """By name, NaN where a cell is empty or not usable (n each). [°C, or the column's own unit]"""
    source: str = ""
    """Where it came from, for messages: a file path or ``store``."""
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Columns of remarks, one text a row, kept in files; ``quality`` says why cells are missing."""
    layout: object = None
    """How the pandas table was laid out that it was made of, for `daq.frame_of`."""

    def __repr__(self) -> str:
        """Return on one screen which run it is: scans, columns, header."""
        seconds = (f"{self.time_s[0]:g}", f"{self.time_s[-1]:g}") if len(self.time_s) else ("–", "–")
        head = say("printed-run", run=self.name, scans=len(self.time_s), first=seconds[0], last=seconds[1])
        columns = textwrap.shorten(", ".join((*self.columns, *self.texts)), 300, placeholder=" ...")
        keys = [f"{key} = {value}" for key, value in self.header.items()][:KEYS_SHOWN]
        shown = [textwrap.shorten(key, 100, placeholder=" ...") for key in keys]
        left = len(self.header) - len(shown)
        return "\n".join([str(head), columns, *shown, *([str(say("printed-more", count=left))] if left else [])])

    _repr_html_ = in_notebook

    def at_rows(self, rows: NDArray[np.integer | np.bool_] | slice) -> Run:
        """Return the run with these rows alone: their indices, whether each is one, or a slice of them."""
        import numpy as np

        kept = np.arange(len(self.time_s))[rows]
        return replace(
            self,
            time_s=self.time_s[kept],
            columns={name: values[kept] for name, values in self.columns.items()},
            texts={name: tuple(values[i] for i in kept) for name, values in self.texts.items()},
        )

    def matching(self, patterns: Iterable[str]) -> tuple[str, ...]:
        """Return the columns that match shell-style patterns, in file order, each once."""
        wanted = tuple(patterns)
        return tuple(c for c in self.columns if matches(c, wanted))

    def named(self, patterns: Iterable[str]) -> tuple[str, ...]:
        """Return the columns that shell-style patterns name. Raises `InputError` for a pattern that names none."""
        wanted = tuple(patterns)
        for pattern in wanted:
            if not self.matching([pattern]):
                known = tuple(self.columns)
                raise InputError(say("run-columns-unmatched", pattern=pattern, run=self.name, columns=known))
        return self.matching(wanted)

    @property
    def ambient_temperature(self) -> float:
        """Room temperature, 23 °C where the header is silent. [°C] Raises `InputError` for a text."""
        return self._number("ambient.temperature_C", ROOM_C)

    def setting(self, key: str) -> float | None:
        """Return ``setting.<key>``, or None where the header is silent. Raises `InputError` for a text."""
        full = f"setting.{key}"
        return self._number(full, math.nan) if self.header.get(full) is not None else None

    def _number(self, key: str, default: float) -> float:
        value = self.header.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            problem = say("header-no-number", key=key, value=repr(value))
            raise InputError(say("at-place", place=self.source or self.name, what=problem))
        return float(value)


@dataclass(frozen=True)
class Moments:
    """When a run's press closed and opened, and when the panel came and went. [s of the run]

    NaN where a moment did not happen inside the run. ``ramp_s`` is how long closing takes;
    ``closed_s`` and ``opened_s`` are the middles of the two ramps.
    """

    inserted_s: float = float("nan")
    """When the panel was laid in. [s]"""
    closed_s: float = float("nan")
    """Middle of the closing ramp. [s]"""
    opened_s: float = float("nan")
    """Middle of the opening ramp. [s]"""
    removed_s: float = float("nan")
    """When the panel was taken out, or the press closed on it again: what follows is no part of a pressing. [s]"""
    ramp_s: float = 0.5
    """How long closing takes. [s]"""
    source: EventSource = EventSource.TEMPERATURES
    """What showed closing and opening."""
    closed_again: bool = False
    """Whether the pressing ended so."""
