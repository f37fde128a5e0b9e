"""The core as the live sensor would have estimated it in a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from daq.given import names_of
from daq.press.resin_file import Resin
from daq.records import Run
from softsensor.face.inputs import read_press, resin_of, run_for
from softsensor.face.models import model_for
from softsensor.face.showing import about, axes_over_time, head_html, lists, shown, table_html, table_text
from softsensor.jobs.first_start import WorkKind, compile_for
from softsensor.live.replay import Replay, replay

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from softsensor.face.kinds import AnyModel, AnyPress, AnyRun


@dataclass(frozen=True, repr=False, eq=False)
class Prediction:
    """The core as the live sensor would have estimated it, scan by scan. [°C]"""

    replayed: Replay
    """The run and an `Estimate` of each of its scans."""

    def frame(self) -> pd.DataFrame:
        """Return the columns of ``predict --out``, indexed by ``time_s``, the run's header in ``attrs``. [°C]"""
        import pandas as pd

        return about(self.replayed.run, pd.DataFrame(self.replayed.columns()).set_index("time_s"))

    def plot(self) -> list[Axes]:
        """Draw the core with its 95 % band, and a measured core where the run has one; return the axes."""
        table, run = self.frame(), self.replayed.run
        ax = axes_over_time("figure-core-live")
        sure = table["valid"] == 1
        ax.fill_between(table.index, table["core_low_C"], table["core_high_C"], where=sure, alpha=0.25, lw=0)
        ax.plot(table.index[sure], table["core_C"][sure], label="core_C")
        for name in run.matching(["core_*"]):
            ax.plot(run.time_s, run.columns[name], ".", ms=2, label=name)
        ax.legend(frameon=False)
        return shown(ax.figure)

    def to_json(self) -> str:
        """Return the table as JSON, a list a column; null where there is no value."""
        return lists(self.frame())

    def __repr__(self) -> str:
        """Show the first and the last scans."""
        return f"{self.replayed.run.name}\n{table_text(self.frame(), '%.2f')}"

    def _repr_html_(self) -> str:
        return head_html(self.replayed.run.name) + table_html(self.frame(), "%.2f")


def predict(
    run: AnyRun,
    press: AnyPress,
    model: AnyModel | None = None,
    *,
    without: str | Sequence[str] = (),
    resin: Resin | Path | str | None = None,
) -> Prediction:
    """Replay a run through the live sensor, causally: row i rests on nothing later than scan i. [°C]

    Parameters
    ----------
    model
        Coefficients and effects from earlier runs; the press file's guesses without.
    without
        Column or columns (patterns) that it does not see; each must match one.
    resin
        A resin file: adds cure at both faces (0 to 1), steam [kPa] and leave to open.

    Raises
    ------
    InputError
        For a run, press, model or resin file that cannot be read, words in a column that the press file names, a
        pattern that matches no column, a run without a platen's column or the panel's data, and a resin for a
        press without a panel.

    Examples
    --------
    >>> from daq import shared_files
    >>> from softsensor import read_run
    >>> run, press = shared_files() / "samples" / "2026-03-04-07.csv", shared_files() / "presses" / "lab.toml"
    >>> found = predict(run, press).frame()
    >>> len(found) == len(read_run(run).time_s)
    True
    >>> sure = found[found["valid"] == 1]
    >>> bool((sure["core_low_C"] <= sure["core_C"]).all() and (sure["core_C"] <= sure["core_high_C"]).all())
    True
    """
    described = read_press(press)
    loaded = run_for(run, described)
    known = None if model is None else model_for(model, described, loaded.header)
    compile_for(WorkKind.LIVE)
    replayed = replay(described, loaded, known, loaded.named(_patterns(loaded, without)), resin=resin_of(resin))
    return Prediction(replayed)


def _patterns(run: Run, without: str | Sequence[str]) -> list[str]:
    """Return patterns of columns: a text that means none of the run's holds several, with commas between them."""
    if isinstance(without, str) and not run.matching([without]):
        return [pattern.strip() for pattern in without.split(",")]
    return names_of(without)
