"""What the simulation gets wrong, why, and what knowing it is worth."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from textwrap import fill
from typing import TYPE_CHECKING, Any

from daq.given import names_of
from daq.records import with_frozen_fields
from daq.words import say
from daq.words.message import chosen
from softsensor.diagnosis.finding import Diagnosis
from softsensor.diagnosis.summary import law_messages, verdict_messages
from softsensor.diagnosis.verdict import diagnose as diagnose_runs
from softsensor.face.inputs import read_press, runs_of
from softsensor.face.showing import WIDTH, head_html, lines_html, printed, shown, table_html, table_text
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.campaign import diagnosed_model

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from softsensor.face.kinds import AnyPress, AnyRun, Until


@dataclass(frozen=True, repr=False, eq=False)
class DiagnosisResult:
    """What the simulation gets wrong, the causes, and what knowing them is worth. [K]"""

    diagnosis: Diagnosis
    """The causes with the fits and tests behind them."""

    @property
    def content(self) -> dict[str, Any]:
        """What ``diagnose --json`` writes, each time a copy of one's own."""
        return deepcopy(self.diagnosis.as_json())

    @property
    def verdict(self) -> str:
        """``no_effect``, ``named``, ``ambiguous``, ``unknown_effect``, ``too_few_runs`` or ``not_described``."""
        return str(self.diagnosis.verdict)

    def frame(self) -> pd.DataFrame:
        """Return one row a parameter of each cause, those named and those suspected: value and 95 % interval."""
        import pandas as pd

        columns = ["effect", "parameter", "value", "low", "high", "p_value", "heldout_gain_K", "named"]
        rows, content = [], self.content
        for effect in (*content["effects"], *content["suspected"]):
            common = (effect["p_value"], effect["heldout_gain_K"], effect in content["effects"])
            for name, entry in effect["parameters"].items():
                low, high = entry["ci95"] if isinstance(entry, Mapping) and entry.get("ci95") else (None, None)
                value = entry["value"] if isinstance(entry, Mapping) else entry
                rows.append((effect["name"], name, value, low, high, *common))
        return pd.DataFrame(rows, columns=columns).set_index(["effect", "parameter"])

    def plot(self) -> list[Axes]:
        """Draw one run under both models with its residuals; return the axes."""
        from softsensor.diagnosis.curves import curves_of
        from softsensor.report.diagnosis_figures import worst_run_figure

        return shown(worst_run_figure(curves_of(self.diagnosis), chosen()))

    def model(self) -> ModelFile:
        """Return the extended model, as ``diagnose --model`` writes it."""
        return self._model

    @cached_property
    def _model(self) -> ModelFile:
        found: ModelFile = with_frozen_fields(diagnosed_model(self.diagnosis))
        return found

    def to_json(self) -> str:
        """Return what ``diagnose --json`` writes."""
        return json.dumps(self.content)

    def __repr__(self) -> str:
        """Show verdict, causes, error before and after, a free law, what to measure next, and notes."""
        head, *rest = self._lines()
        table = [table_text(self.frame(), "%.4g", rows=12)] if len(self.frame()) else []
        return printed([[line] for line in rest], above="\n".join([fill(head, WIDTH), *table]))

    def _repr_html_(self) -> str:
        head, *rest = self._lines()
        table = table_html(self.frame()) if len(self.frame()) else ""
        return head_html(head) + table + lines_html(rest)

    def _lines(self) -> list[str]:
        found = self.diagnosis
        residual = say("diagnosed-residual", base=found.base.rmse_K, extended=found.extended.rmse_K)
        verdict = " ".join(map(str, verdict_messages(found)))
        rest = (residual, *law_messages(found), found.next_measurement, *found.warnings)
        return [f"{self.verdict}: {verdict}", *map(str, rest)]


def diagnose(
    runs: AnyRun | Sequence[AnyRun],
    press: AnyPress,
    *,
    until: Until | None = None,
    effects: str | Sequence[str] | None = None,
    law: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> DiagnosisResult:
    r"""Say what the simulation of these runs gets wrong, why, and what knowing it is worth. [K]

    The gain of a cause is what errors of n runs left out fall by, from b to a, with d = ln(b / a) and Student's
    interval of its mean:

    $$\mathrm{gain} = \sqrt{\frac{1}{n} \sum_i b_i^2} \left(1 - e^{-\overline{d}}\right), \quad
    \mathrm{ci95}: \overline{d} \pm t_{n - 1} \frac{s}{\sqrt{n}}$$

    Its p-value holds the sum of what the runs show, x of each in standard deviations, against the sums under all F
    patterns σ of flipped signs, the largest of all causes j that were looked for:

    $$p_k = \frac{1}{F} \sum_{\sigma} \left[\max_j \left|\sum_i \sigma_i z_{ij}\right| \geq
    \left|\sum_i z_{ik}\right|\right], \quad z = \frac{x}{1 + |x| / 9}$$

    Parameters
    ----------
    runs
        One run or several, as files, tables or `Run`. [°C, s]
    until
        Where each run ends, as ``--until`` takes it: a moment [s], ``bottom_1=140`` for the first row in which a
        column reads as much, an event such as ``opened``, each with ``RUN:`` before it for one run alone; of
        several the earliest counts.
    effects
        Cause or causes to look for, by name; the whole catalogue without.
    law
        Look for what is missing as a free function, also where a cause is named; where the verdict is
        ``unknown_effect`` this is done anyway.
    progress
        Called with what is being done and the share done, from 0 to 1.

    Raises
    ------
    InputError
        As `fit`, and for an effect that the catalogue does not have.

    Examples
    --------
    Three pressings, every fourth row and one cause for speed; a verdict needs more of them, and says so:

    >>> from daq import frame_of, shared_files
    >>> from softsensor import read_run
    >>> shared = shared_files()
    >>> files = [shared / "samples" / f"2026-03-04-{number:02}.csv" for number in (6, 7, 8)]
    >>> runs = [read_run(frame_of(read_run(file)).iloc[::4]) for file in files]
    >>> found = diagnose(runs, shared / "presses" / "lab.toml", effects="edge_loss")
    >>> found.verdict, [effect["name"] for effect in found.content["suspected"]]
    ('too_few_runs', ['edge_loss'])
    >>> print(found.diagnosis.next_measurement)  # doctest: +ELLIPSIS
    Press at least 3 more panels, with different press times and, if possible, thicknesses...
    """
    described = read_press(press)
    wanted = None if effects is None else names_of(effects)
    found = diagnose_runs(described, runs_of(runs, described, until), progress, wanted, law=True if law else None)
    return DiagnosisResult(found)
