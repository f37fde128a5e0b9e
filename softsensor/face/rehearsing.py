"""What a diagnosis of these very runs is worth: how often such campaigns find a cause, and name a wrong one."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from daq.given import names_of, path_of, refused
from daq.printed import in_short
from daq.records import InputError
from daq.tables import reason_of
from daq.words import Message, say
from daq.words.message import chosen
from softsensor.diagnosis.rehearsal import (
    NOTHING,
    Hidden,
    Rate,
    Rehearsal,
    RehearsedCause,
    campaign_of,
    hidden_of,
    sized,
)
from softsensor.face.diagnosing import DiagnosisResult
from softsensor.face.showing import head_html, lines_html, printed, shown, table_html
from softsensor.jobs.rehearsals import CAMPAIGNS, check_file, plan_rehearsal
from softsensor.jobs.rehearsals import rehearse as rehearse_campaigns
from softsensor.report.rehearsal_rows import HEADS, lost_messages, none_message, rehearsal_rows

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

_NONE = Rate(0, 0)


@dataclass(frozen=True, repr=False, eq=False)
class RehearsalResult:
    """How often such campaigns find a cause that they hide, and how often they name a wrong one."""

    rehearsal: Rehearsal
    """Of each hidden cause, and of none, in how many campaigns it and others were named."""

    def frame(self) -> pd.DataFrame:
        """Return one row a hidden cause, the last one of campaigns that hide nothing: shares from 0 to 1.

        ``size`` is its first parameter, in its unit. ``found`` is the share that names it, ``alone`` without an
        alternative, ``wrong`` the share that names another; each with its 95 % interval. NaN where nothing counts.
        """
        import pandas as pd

        rows = [*self.rehearsal.rows, RehearsedCause(Hidden(NOTHING), _NONE, _NONE, self.rehearsal.nothing)]
        sizes = [next((value for _, value in row.hidden.parameters), math.nan) for row in rows]
        cells = {"size": sizes, "campaigns": [row.wrong.of for row in rows]}
        for name in ("found", "alone", "wrong"):
            rates = [getattr(row, name) for row in rows]
            cells[name] = [rate.share for rate in rates]
            for number, end in enumerate(("low", "high")):
                cells[f"{name}_{end}"] = [rate.ci95[number] if rate.of else math.nan for rate in rates]
        effects = pd.Index([row.hidden.name or "nothing" for row in rows], name="effect")
        return pd.DataFrame(cells, index=effects)

    def plot(self) -> list[Axes]:
        """Draw how often each cause is found and another one named; return the axes."""
        from softsensor.report.rehearsal_figure import rehearsal_figure

        return shown(rehearsal_figure(self.rehearsal, chosen()))

    def to_json(self) -> str:
        """Return what ``diagnose --rehearse --json`` writes under ``rehearsal``."""
        return json.dumps(self.rehearsal.as_json())

    def __repr__(self) -> str:
        """Show how many campaigns of how many find each cause, and name a wrong one."""
        table = self._table()
        table[table.columns[0]] = self._names()
        for column, kind in zip(table.columns[-3:], ("found", "alone", "wrong"), strict=True):
            rates = [getattr(row, kind) for row in self.rehearsal.rows]
            table[column] = [str(say("rehearsal-counted", count=rate.count, of=rate.of)) for rate in rates]
        above = table.to_string(index=False, max_rows=14) if len(table) else ""
        return printed([[line] for line in self._lines()], above=above)

    def _repr_html_(self) -> str:
        head = head_html(say("rehearsal-title", runs=self.rehearsal.runs))
        table = self._table()
        table.insert(0, "", self._names())
        return head + (table_html(table) if len(table) else "") + lines_html(self._lines())

    def _names(self) -> list[str]:
        return [row.hidden.name for row in self.rehearsal.rows]

    def _table(self) -> pd.DataFrame:
        import pandas as pd

        rows = [[str(cell) for cell in row.cells] for row in rehearsal_rows(self.rehearsal)]
        return pd.DataFrame(rows, columns=[str(say(code)) for code in HEADS])

    def _lines(self) -> list[Message]:
        found = self.rehearsal
        return [none_message(found), *lost_messages(found), say("rehearsal-own-model")]


def rehearse(
    diagnosis: DiagnosisResult,
    *,
    effects: str | Sequence[str] = (),
    campaigns: int = CAMPAIGNS,
    workers: int = 1,
    file: Path | str | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> RehearsalResult:
    """Say what a diagnosis of these very runs is worth, by diagnosing campaigns simulated from them.

    Each hides one cause, or nothing, in the sensor's own model, with these runs' programs, noise, gaps and
    scatter, and is diagnosed as a whole: so many times as long as the diagnosis takes.

    Parameters
    ----------
    diagnosis
        What `diagnose` returned of the runs.
    effects
        Cause or causes to hide, ``NAME`` or ``NAME=SIZE`` with the first parameter in its unit; without, all that
        these runs could show.
    campaigns
        How many of each cause, and of none.
    workers
        Processes that share the work. More than one begin by importing the script that called: it then needs
        ``if __name__ == "__main__":`` around its work. A notebook needs nothing.
    file
        Keeps each finished campaign; with it, a rehearsal that was broken off goes on.
    progress
        Called with what is being done and the share of it done, from 0 to 1.

    Raises
    ------
    InputError
        For what is no diagnosis, a cause that these runs cannot show or that cannot be of such a size, less than
        one campaign or worker, and a file of something else or that cannot be written.

    Examples
    --------
    Three pressings, every fourth row and one cause for speed; so few never name a cause:

    >>> from daq import frame_of, shared_files
    >>> from softsensor import diagnose, read_run
    >>> shared = shared_files()
    >>> files = [shared / "samples" / f"2026-03-04-{number:02}.csv" for number in (6, 7, 8)]
    >>> runs = [read_run(frame_of(read_run(file)).iloc[::4]) for file in files]
    >>> found = diagnose(runs, shared / "presses" / "lab.toml", effects="edge_loss")
    >>> rehearse(found, effects="edge_loss", campaigns=1).frame()["wrong"].to_dict()
    {'edge_loss': 0.0, 'nothing': 0.0}
    """
    if not isinstance(diagnosis, DiagnosisResult):
        raise refused(diagnosis, "given-no-diagnosis")
    for name, value in (("campaigns", campaigns), ("workers", workers)):
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise InputError(say("rehearsal-count", name=name, value=in_short(value)))
    names, keep = names_of(effects), None if file is None else path_of(file, "given-no-file")
    for one in names:
        sized(one)
    with _writing(keep):
        if keep is not None:
            check_file(keep)
    campaign = campaign_of(diagnosis.diagnosis)
    plan = plan_rehearsal(campaign, hidden_of(campaign, names), campaigns, keep)
    total = len(plan.tasks) + len(plan.done)
    what = str(say("terminal-progress-rehearsing", campaigns=total))

    def report(done: int) -> None:
        if progress is not None:
            progress(what, done / total)

    with _writing(keep):
        return RehearsalResult(rehearse_campaigns(plan, report, workers=workers))


@contextmanager
def _writing(file: Path | None) -> Iterator[None]:
    """Say in words why finished campaigns cannot be kept in a file. Raises `InputError`."""
    try:
        yield
    except OSError as error:
        if file is None:
            raise
        raise InputError(say("terminal-output-unwritable", path=str(file), why=reason_of(error))) from error
