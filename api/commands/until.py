"""``--until``: where each run ends for a command, by time, by a sensor's temperature or by an event of the press.

``900`` is a moment of ``time_s``; ``bottom_1=140`` the first row in which a column (patterns allowed) reads as
much; ``opened`` an event of the press. ``RUN:`` before any of them makes it that run's own, and goes before what
is stated for all. The option may be repeated; a run ends at the first that comes. Where a temperature or an event
does not come, nothing is left out, and a warning says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from api.outputs import warn
from daq.records import InputError, PressEventKind, Run
from daq.words import say

if TYPE_CHECKING:
    from daq.press.press_file import Press

Until = Annotated[
    list[str] | None,
    typer.Option("--until", metavar="SECONDS|COLUMN=C|EVENT", help="help-until"),
]
EVENTS = tuple(kind.value for kind in PressEventKind)


@dataclass(frozen=True)
class End:
    """One end of runs, as it was asked for."""

    text: str
    run: str
    """Whose it is; empty for all."""
    seconds: float = math.nan
    column: str = ""
    event: str = ""

    @classmethod
    def of(cls, text: str) -> End:
        """Read one value of the option. Raises `InputError`."""
        run, _, what = text.rpartition(":")
        column, equals, number = what.rpartition("=")
        if what in EVENTS:
            return cls(text, run, event=what)
        try:
            seconds = float(number)
        except ValueError:
            seconds = math.nan
        if math.isnan(seconds) or (equals and not column):
            raise InputError(say("terminal-until-not-read", until=text, events=EVENTS))
        return cls(text, run, seconds, column)

    def moment(self, run: Run, press: Press) -> float:
        """Return the last moment of `time_s` this leaves to a run; infinite where it does not come."""
        if self.event:
            from softsensor.signals.moments import moments_of

            at = float(getattr(moments_of(run, press), f"{self.event}_s"))
            return math.inf if math.isnan(at) else at
        if not self.column:
            return self.seconds
        columns = run.matching([self.column])
        if not columns:
            known = tuple(run.columns)
            raise InputError(say("terminal-until-no-column", run=run.name, column=self.column, known=known))
        import numpy as np

        hot = np.flatnonzero(np.any([run.columns[name] >= self.seconds for name in columns], axis=0))
        return float(np.nextafter(run.time_s[hot[0]], -math.inf)) if len(hot) else math.inf


def shortened(runs: Sequence[Run], press: Press, until: Sequence[str] | None) -> list[Run]:
    """Return the runs without the rows after their ends.

    Raises
    ------
    InputError
        For an end that cannot be read or names what is not there, and where fewer than two rows are left.
    """
    ends = [End.of(text) for text in until or ()]
    names = {run.name for run in runs}
    if wrong := next((end for end in ends if end.run and end.run not in names), None):
        raise InputError(say("terminal-until-no-run", until=wrong.text, run=wrong.run, known=tuple(sorted(names))))
    found, whole = [], dict[str, list[str]]()
    for run in runs:
        own = [end for end in ends if end.run == run.name] or [end for end in ends if not end.run]
        moments = {end.moment(run, press): end for end in own}
        last_s = min(moments, default=math.inf)
        if moments and last_s == math.inf:
            whole.setdefault(moments[last_s].text, []).append(run.name)
        found.append(_rows_until(run, last_s, moments[last_s].text) if moments else run)
    for text, of in whole.items():
        warn(say("terminal-until-not-reached", until=text, runs=tuple(of)))
    return found


def _rows_until(run: Run, last_s: float, until: str) -> Run:
    import numpy as np

    rows = int(np.searchsorted(run.time_s, last_s, side="right"))
    if rows < 2:
        kept = {"rows": rows, "all": len(run.time_s), "first": float(run.time_s[0])}
        raise InputError(say("terminal-until-leaves-too-little", run=run.name, until=until, **kept))
    return run.at_rows(slice(rows))
