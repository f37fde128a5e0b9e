"""Where each run ends for a work: by time, by a sensor's temperature or by an event of the press.

``900`` is a moment of ``time_s``; ``bottom_1=140`` the first row in which a column (patterns allowed) reads as
much; ``opened`` an event of the press. ``RUN:`` before any of them makes it that run's own, and goes before what
is stated for all. Several may be given; a run ends at the first that comes. Where a temperature or an event does
not come, nothing is left out, and a warning says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np

from daq.given import names_of, number_of, warn
from daq.press.press_file import Press
from daq.records import InputError, PressEventKind, Run
from daq.words import say
from softsensor.signals.moments import moments_of

if TYPE_CHECKING:
    from softsensor.face.kinds import Until

EVENTS = tuple(kind.value for kind in PressEventKind)


@dataclass(frozen=True)
class End:
    """One end of runs, as it was asked for."""

    text: str
    run: str
    """Whose it is; empty for all."""
    option: str = "until"
    seconds: float = math.nan
    column: str = ""
    event: str = ""

    @classmethod
    def of(cls, text: str, option: str = "until") -> End:
        """Read one end; `option` is what the place is called where it was given. Raises `InputError`."""
        run, _, what = text.rpartition(":")
        column, equals, number = what.rpartition("=")
        if what in EVENTS:
            return cls(text, run, option, event=what)
        try:
            seconds = float(number)
        except ValueError:
            seconds = math.nan
        if math.isnan(seconds) or (equals and not column):
            raise InputError(say("terminal-until-not-read", option=option, until=text, events=EVENTS))
        return cls(text, run, option, seconds, column)

    def moment(self, run: Run, press: Press) -> float:
        """Return the last moment of `time_s` this leaves to a run; infinite where it does not come."""
        if self.event:
            at = float(getattr(moments_of(run, press), f"{self.event}_s"))
            return math.inf if math.isnan(at) else at
        if not self.column:
            return self.seconds
        columns = run.matching([self.column])
        if not columns:
            where = {"run": run.name, "option": self.option, "column": self.column}
            raise InputError(say("terminal-until-no-column", known=tuple(run.columns), **where))
        hot = np.flatnonzero(np.any([run.columns[name] >= self.seconds for name in columns], axis=0))
        return float(np.nextafter(run.time_s[hot[0]], -math.inf)) if len(hot) else math.inf


def shortened(runs: Sequence[Run], press: Press, until: Until | None, option: str = "until") -> list[Run]:
    """Return the runs without the rows after their ends; warn of an end that does not come.

    Raises
    ------
    InputError
        For an end that cannot be read or names what is not there, and where fewer than two rows are left.
    """
    ends = [End.of(text, option) for text in _texts(until)]
    names = {run.name for run in runs}
    if wrong := next((end for end in ends if end.run and end.run not in names), None):
        given = {"option": option, "until": wrong.text, "run": wrong.run}
        raise InputError(say("terminal-until-no-run", known=tuple(sorted(names)), **given))
    found, whole = [], dict[str, list[str]]()
    for run in runs:
        own = [end for end in ends if end.run == run.name] or [end for end in ends if not end.run]
        moments = {end.moment(run, press): end for end in own}
        last_s = min(moments, default=math.inf)
        if moments and last_s == math.inf:
            whole.setdefault(moments[last_s].text, []).append(run.name)
        found.append(_rows_until(run, last_s, moments[last_s]) if moments else run)
    for text, of in whole.items():
        warn(say("terminal-until-not-reached", option=option, until=text, runs=tuple(of)))
    return found


def _rows_until(run: Run, last_s: float, end: End) -> Run:
    rows = int(np.searchsorted(run.time_s, last_s, side="right"))
    if rows < 2:
        kept = {"rows": rows, "all": len(run.time_s), "first": float(run.time_s[0])}
        asked = {"option": end.option, "until": end.text}
        raise InputError(say("terminal-until-leaves-too-little", run=run.name, **asked, **kept))
    return run.at_rows(slice(rows))


def _texts(until: Until | None) -> list[str]:
    """Return ends as texts: one or several, numbers among them. Raises `InputError` for anything else."""
    given = until if isinstance(until, Sequence) and not isinstance(until, str | bytes) else [until]
    return names_of([str(number_of(one)) if isinstance(one, Real) else one for one in given if one is not None])
