"""Which pressings are worth most next."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from daq.given import keys_of
from daq.records import InputError
from daq.words import say
from daq.words.message import chosen
from softsensor.face.diagnosing import DiagnosisResult, diagnose
from softsensor.face.inputs import read_press
from softsensor.face.showing import lines_html, printed, shown
from softsensor.planning.open_points import PointKind
from softsensor.planning.plan import PressingPlan
from softsensor.planning.plan import plan as plan_after
from softsensor.planning.summary import best_message, plan_messages, point_message, standing_messages

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from softsensor.face.kinds import AnyPress, AnyRun, Until


HALF = ((PointKind.COEFFICIENT, "half_share"), (PointKind.CORE_BAND, "half_K"))
"""Under which column what is left of a half interval stands, by what is open."""


@dataclass(frozen=True, repr=False, eq=False)
class PlanResult:
    """The next pressings worth most, and what each would settle."""

    planned: PressingPlan
    """The open points, and for each the pressings that would settle it; what one is worth in nats."""

    def frame(self) -> pd.DataFrame:
        """Return one row an open point and pressing: its settings, chance to settle it, and runs needed.

        ``worth_nats`` is by what pressings are compared. What is left of a half interval afterwards stands under
        ``half_share`` of a coefficient [of its logarithm: exp of it is the factor either way] and under ``half_K``
        of the core [K]; NaN elsewhere.
        """
        import pandas as pd

        rows = []
        for number, point in enumerate(self.planned.as_json()["open"]):
            for which in ("best", "with_core", "repeated"):
                if (pressing := point[which]) is not None:
                    about = {"open": number, "kind": point["kind"], "name": point["name"], "pressing": which}
                    prospect = {
                        "worth_nats": pressing["worth"],
                        "chance": pressing["chance"],
                        "runs": pressing["runs"],
                    }
                    half = {
                        unit: pressing["half_interval"] if point["kind"] == kind else None for kind, unit in HALF
                    }
                    rows.append(about | prospect | half | dict(pressing["settings"]))
        index = ["open", "kind", "name", "pressing"]
        if not rows:
            return pd.DataFrame(columns=index).set_index(index)
        numbers = dict.fromkeys(("chance", "runs", "half_share", "half_K"), float)
        return pd.DataFrame(rows).astype(numbers).set_index(index)

    def plot(self) -> list[Axes]:
        """Draw what one pressing of each kind is worth to each open point; return the axes."""
        from softsensor.report.plan_figure import plan_figure

        return shown(plan_figure(self.planned, chosen()))

    def to_json(self) -> str:
        """Return what ``plan --json`` writes."""
        return json.dumps(self.planned.as_json())

    def __repr__(self) -> str:
        """Say what is open, and the best pressing for it; the notebook's view and the table hold the others."""
        points = [(point_message(advice.point), best_message(advice)) for advice in self.planned.points]
        return printed([*([one] for one in standing_messages(self.planned)), *points])

    def _repr_html_(self) -> str:
        return lines_html(plan_messages(self.planned))


def plan(
    runs: AnyRun | Sequence[AnyRun] | DiagnosisResult,
    press: AnyPress,
    *,
    until: Until | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> PlanResult:
    """Say which pressings are worth most next, and what each would settle.

    Parameters
    ----------
    runs
        Measured runs, or their diagnosis, which saves making it again.
    until
        Where each run ends, as ``--until`` takes it: a moment [s], ``bottom_1=140`` for the first row in which a
        column reads as much, an event such as ``opened``, each with ``RUN:`` before it for one run alone; of
        several the earliest counts.
    ranges
        What can be set and how far, by name (``thickness_mm``, ``platen_temperature_C``, ``press_time_s``,
        ``start_temperature_C``, ``waiting_s``, ``pressure_N_cm2``); the runs' own, modestly widened, without.
    progress
        Called with what is being done and the share of it done, from 0 to 1: of the diagnosis, then of the plan.

    Raises
    ------
    InputError
        As `diagnose`, for a range that cannot be, and for an end of runs beside their diagnosis.

    Examples
    --------
    After three pressings, every fourth row and one cause for speed, where the press time alone can be chosen:

    >>> from daq import frame_of, shared_files
    >>> from softsensor import read_run
    >>> shared = shared_files()
    >>> press = shared / "presses" / "lab.toml"
    >>> files = [shared / "samples" / f"2026-03-04-{number:02}.csv" for number in (6, 7, 8)]
    >>> runs = [read_run(frame_of(read_run(file)).iloc[::4]) for file in files]
    >>> found = diagnose(runs, press, effects="edge_loss")
    >>> held = {"thickness_mm": 16, "platen_temperature_C": 200, "start_temperature_C": 20, "waiting_s": 20}
    >>> ranges = {name: (value, value) for name, value in held.items()} | {"press_time_s": (30, 60)}
    >>> table = plan(found, press, ranges=ranges).frame()
    >>> sorted(set(table.index.get_level_values("kind")))
    ['cause', 'coefficient', 'core_band']
    >>> bool((table.xs("best", level="pressing")["worth_nats"] > 0.0).all())
    True
    """
    if isinstance(runs, DiagnosisResult) and until is not None:
        raise InputError(say("plan-until-of-diagnosis"))
    found = runs if isinstance(runs, DiagnosisResult) else diagnose(runs, press, until=until, progress=progress)
    return PlanResult(plan_after(read_press(press), found.diagnosis, keys_of(ranges, "given-no-ranges"), progress))
