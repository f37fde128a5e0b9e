"""Why the paper's gradient search got stuck, reproduced."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from daq.given import refused
from daq.press.press_file import press_for_run
from daq.records import InputError, Moments, Run
from daq.tables import at
from daq.words import say
from daq.words.message import chosen
from softsensor.face.showing import lines_html, printed, shown, table_html
from softsensor.fitting.paper.procedures import EVERY_RUN_SHOWS, SolverComparison
from softsensor.fitting.paper.procedures import reproduce as compare
from softsensor.heat.model import ThermalModel
from softsensor.jobs.model_files import coefficients_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


class Reproduction(SolverComparison):
    """Two solvers and two kinds of slopes beside each other, and the cost along one coefficient."""

    def frame(self) -> pd.DataFrame:
        """Return one row a combination: how many searches converged, mean time [s] and solves, error (a share)."""
        import pandas as pd

        return pd.DataFrame(self.as_json()["table"]).set_index(["solver", "slopes"])

    def plot(self) -> list[Axes]:
        """Draw the cost along one coefficient for either solver; return the axes."""
        from softsensor.report.fit_figures import roughness_figure

        return shown(roughness_figure(self, chosen()))

    def to_json(self) -> str:
        """Return what ``fit --reproduce-paper --json`` writes."""
        return json.dumps(self.as_json())

    def __repr__(self) -> str:
        """Show the combinations, and what the two curves say."""
        return printed([[self.message]], above=self.frame().to_string(float_format="%.3g"))

    def _repr_html_(self) -> str:
        return table_html(self.frame(), "%.3g") + lines_html([self.message])


def reproduce(
    measurements: Sequence[tuple[Run, Moments, Mapping[str, float]]],
    model: ThermalModel,
    *,
    judged: Sequence[str] = EVERY_RUN_SHOWS,
    seed: int = 1,
    clock: Callable[[], float] = time.perf_counter,
    progress: Callable[[int], None] | None = None,
) -> Reproduction:
    """Compare the four combinations on measurements given with their moments and true coefficients.

    Parameters
    ----------
    judged
        Coefficients whose error against the truth counts: those every run shows.
    seed
        Of the starts, which are off by up to a factor of 3.
    clock
        Seconds since whenever, for how long each search takes.

    Raises
    ------
    InputError
        For no measurement, a run that the model cannot take, a press whose boundaries are not measured, and a
        coefficient that is not among the truths or that no press has.

    Examples
    --------
    A pressing, every fourth row for speed, with what `fit` finds of it for the truth:

    >>> from daq import frame_of, shared_files
    >>> from softsensor import ThermalModel, fit, read_press, read_run
    >>> whole = read_run(shared_files() / "samples" / "2026-03-04-07.csv")
    >>> run = read_run(frame_of(whole).iloc[::4])
    >>> press = read_press(shared_files() / "presses" / "lab.toml")
    >>> (fitted,) = fit(run, press).campaign.runs
    >>> truth = {name: found.value for name, found in fitted.coefficients.items()}
    >>> compared = reproduce([(run, fitted.moments, truth)], ThermalModel(press))
    >>> adaptive, exact = compared.slope_changes
    >>> adaptive > exact
    True
    """
    if not isinstance(model, ThermalModel):
        raise refused(model, "given-no-thermal-model")
    for one in _measured(measurements):
        _check_truths(*one, model, judged)
    found = compare(measurements, model, judged=judged, seed=seed, clock=clock, progress=progress)
    return Reproduction(found.table, found.coefficient, found.relative, found.adaptive, found.exact)


def _measured(given: Any) -> Sequence[tuple[Run, Mapping[str, float]]]:
    """Return runs with their true coefficients. Raises `InputError` for what is none, or no such pair at all."""
    if not isinstance(given, Sequence):
        raise refused(given, "given-no-measurement")
    for one in given:
        if not isinstance(one, tuple) or len(one) != len(_MEASUREMENT):
            raise refused(one, "given-no-measurement")
        for part, kind in zip(one, _MEASUREMENT, strict=True):
            if not isinstance(part, kind):
                raise refused(part, "given-no-measurement")
    if not given:
        raise InputError(say("paper-no-measurement"))
    return [(run, truth) for run, _, truth in given]


_MEASUREMENT = (Run, Moments, Mapping)


def _check_truths(run: Run, truth: Mapping[str, float], model: ThermalModel, judged: Sequence[str]) -> None:
    press, where = press_for_run(model.press, run), run.source or run.name
    names = tuple(name for name in press.coefficient_names if not press.coefficient(name).fixed)
    if missing := tuple(name for name in names if name not in truth):
        raise InputError(at(where, say("paper-truth-missing", names=missing)))
    coefficients_of({name: truth[name] for name in names}, [press], where)
    if not any(name in names for name in judged):
        raise InputError(at(where, say("paper-none-judged", judged=repr(tuple(judged)), known=names)))
