"""Why the paper's gradient search got stuck, reproduced."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from daq.records import Moments, Run
from softsensor.face.showing import lines_html, shown, table_html
from softsensor.fitting.paper.procedures import EVERY_RUN_SHOWS
from softsensor.fitting.paper.procedures import Reproduction as Compared
from softsensor.fitting.paper.procedures import reproduce as compare
from softsensor.heat.model import ThermalModel

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


class Reproduction(Compared):
    """Two solvers and two kinds of slopes beside each other, and the cost along one coefficient."""

    def frame(self) -> pd.DataFrame:
        """Return one row a combination: how many searches converged, mean time [s] and solves, error (a share)."""
        import pandas as pd

        return pd.DataFrame(self.as_json()["table"]).set_index(["solver", "slopes"])

    def plot(self) -> list[Axes]:
        """Draw the cost along one coefficient for either solver; return the axes."""
        from softsensor.report.fit_figures import roughness_figure

        return shown(roughness_figure(self))

    def to_json(self) -> str:
        """Return what ``fit --reproduce-paper --json`` writes."""
        return json.dumps(self.as_json())

    def __repr__(self) -> str:
        """Show the combinations, and what the two curves say."""
        return f"{self.frame().to_string(float_format='%.3g')}\n{self.said}"

    def _repr_html_(self) -> str:
        return table_html(self.frame(), "%.3g") + lines_html([self.said])


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
    """
    found = compare(measurements, model, judged=judged, seed=seed, clock=clock, progress=progress)
    return Reproduction(found.table, found.coefficient, found.relative, found.adaptive, found.exact)
