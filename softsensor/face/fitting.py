"""Coefficients of each run and of the campaign."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from daq.given import name_of, names_of
from daq.records import with_frozen_fields
from daq.words import Message, say
from daq.words.message import chosen
from softsensor.face.inputs import read_press, runs_of
from softsensor.face.showing import UNKNOWN, about, lines_html, printed, shown, table_html
from softsensor.fitting.campaign import CampaignFit
from softsensor.fitting.identifiability import is_verdict_on
from softsensor.fitting.options import check_shared, full_method
from softsensor.fitting.remarks import remarks_together
from softsensor.fitting.result import rounded
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.campaign import fit_campaign

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from softsensor.face.kinds import AnyPress, AnyRun, Until


@dataclass(frozen=True, repr=False, eq=False)
class FitResult:
    """Coefficients of each run and of the campaign. [W/m²K]"""

    campaign: CampaignFit
    """Of each run (``campaign.runs``) its coefficients [W/m²K], residuals by channel [K], moments [s], warnings;
    of all together the population they are draws from."""

    def frame(self) -> pd.DataFrame:
        """Return one row a run and coefficient: value, sd and 95 % interval [W/m²K], and whether it is known.

        ``rmse_K`` is what the fit leaves of the run [K]. Of one run its header stands in ``attrs``.
        """
        import pandas as pd

        rows = [
            {"run": run.run, "coefficient": name, "value": c.value, "sd": c.sd}
            | {"low": c.ci95[0], "high": c.ci95[1], "identifiable": c.identifiable, "rmse_K": run.rmse_K}
            for run in self.campaign.runs
            for name, c in run.coefficients.items()
        ]
        frame = pd.DataFrame(rows).set_index(["run", "coefficient"])
        return about(self.campaign.runs[0].problem.case.run, frame) if len(self.campaign.runs) == 1 else frame

    def plot(self) -> list[Axes]:
        """Draw the coefficients over the runs; return the axes."""
        from softsensor.report.fit_figures import coefficients_figure

        return shown(coefficients_figure(self.campaign, chosen()))

    def model(self) -> ModelFile:
        """Return the campaign's model, as ``fit --model`` writes it."""
        from softsensor.diagnosis.missing_causes import with_missing_causes

        found: ModelFile = with_frozen_fields(with_missing_causes(self.campaign.model_file(), self.campaign.runs))
        return found

    def to_json(self) -> str:
        """Return what ``fit --json`` writes; of it ``profiles`` where the fit was asked for them."""
        return json.dumps(self.campaign.as_json())

    def __repr__(self) -> str:
        """Show what is known from each run, to the digits it is known to; of several runs mean and scatter.

        Then which runs the model does not describe, and what else is to be known of them.
        """
        table = self._table(_digits).to_string(max_rows=12)
        return printed([[remark] for remark in self._remarks()], above=table)

    def _repr_html_(self) -> str:
        return table_html(self._table(_with_ends)) + lines_html(self._remarks())

    def _table(self, known: Callable[[float, tuple[float, float]], str]) -> pd.DataFrame:
        """Return what is shown of each run and of all together; `known` writes a value with its interval."""
        import pandas as pd

        over = self.campaign.coefficients
        rows = {}
        for run in self.campaign.runs:
            found = {name: run.coefficients[name] for name in over}
            cells = {n: known(c.value, c.ci95) if c.identifiable else UNKNOWN for n, c in found.items()}
            rows[run.run] = {**cells, "rmse_K": f"{run.rmse_K:.2f}"}
        if len(rows) > 1:
            rows[str(say("terminal-fit-mean"))] = {
                n: known(c.mean, c.ci95) if c.runs else UNKNOWN for n, c in over.items()
            }
            rows[str(say("terminal-fit-sd"))] = {
                n: f"{c.sd:.2g}" if math.isfinite(c.sd) else UNKNOWN for n, c in over.items()
            }
        return pd.DataFrame.from_dict(rows, orient="index").fillna("")

    def _remarks(self) -> list[Message]:
        """Return what is to be known besides: the table shows verdicts on single coefficients itself."""
        short = self.campaign.shortfall
        own = {
            run.run: [
                one
                for one in run.warnings
                if one.code != "fit-not-described-check" and not is_verdict_on(one, run.coefficients)
            ]
            for run in self.campaign.runs
        }
        return [*([short] if short else []), *remarks_together(own)]


def _digits(value: float, ends: tuple[float, float]) -> str:
    return f"{rounded(value, ends):.4g}"


def _with_ends(value: float, ends: tuple[float, float]) -> str:
    low, high = (_digits(end, ends) for end in ends)
    return f"{_digits(value, ends)} ({low} … {high})"


def fit(  # noqa: PLR0913 - one argument a wish
    runs: AnyRun | Sequence[AnyRun],
    press: AnyPress,
    *,
    until: Until | None = None,
    shared: str | Sequence[str] = (),
    method: str = "default",
    averages: bool = False,
    profiles: bool = False,
) -> FitResult:
    """Fit the heat transfer coefficients of each run and of all together. [W/m²K]

    Parameters
    ----------
    runs
        One run or several, as files, tables or `Run`. [°C, s]
    until
        Where each run ends, as ``--until`` takes it: a moment [s], ``bottom_1=140`` for the first row in which a
        column reads as much, an event such as ``opened``, each with ``RUN:`` before it for one run alone; of
        several the earliest counts.
    shared
        Coefficient or coefficients with one value in all runs.
    method
        ``default``, or one of the paper's: ``least_squares``, ``nelder_mead``, ``nelder_mead_then_least_squares``.
    averages
        With a method of the paper: averages of the upper and of the lower sensors, not every sensor.
    profiles
        Work out the likelihood's profile of each coefficient too, for the JSON; it takes longer.

    Raises
    ------
    InputError
        For a run or press file that cannot be read, words in a column that the press file names, a run without a
        platen's column, without sensors or without the panel's data, no run at all, an unknown method, and a
        shared coefficient that the press file fixes.

    Examples
    --------
    >>> from daq import shared_files
    >>> run, press = shared_files() / "samples" / "2026-03-04-07.csv", shared_files() / "presses" / "lab.toml"
    >>> found = fit(run, press).frame().loc["2026-03-04-07"]
    >>> sorted(found.index[found["identifiable"]])
    ['h_pp_c', 'h_pp_o', 'h_wa']
    >>> bool(found.loc["h_pp_c", "low"] < found.loc["h_pp_c", "value"] < found.loc["h_pp_c", "high"])
    True
    """
    described = read_press(press)
    together, full = names_of(shared), full_method(name_of(method), averages=averages)
    check_shared(described, together)
    read = runs_of(runs, described, until)
    found = with_frozen_fields(fit_campaign(described, read, shared=together, profiles=profiles, method=full))
    return FitResult(replace(found, runs=tuple(map(with_frozen_fields, found.runs))))
