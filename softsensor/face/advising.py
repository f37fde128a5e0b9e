"""How long to press a panel not pressed yet."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.given import keys_of, name_of, number_of, warn
from daq.press.header import USUAL_PANEL, check_header, doubts, flat_header
from daq.press.resin_file import Resin
from daq.records import ROOM_C, USUAL_WAIT_S, InputError
from daq.words import say
from daq.words.message import chosen
from softsensor.face.inputs import read_press, resin_of
from softsensor.face.models import model_for
from softsensor.face.showing import lines_html, printed, shown, table_html
from softsensor.planning.advise import DEFAULT_RANGES, PRESSURE, Goal, ProgrammeAdvice, Wish, limits_of
from softsensor.planning.advise import advise as advise_on
from softsensor.planning.made_up import ADVISED, Task
from softsensor.planning.program import given_ranges
from softsensor.planning.summary import advice_messages
from softsensor.planning.wishes import OPEN_S, PRICE, USUAL_OPEN_S, WAITING_S

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from softsensor.face.kinds import AnyModel, AnyPress


@dataclass(frozen=True, repr=False, eq=False)
class AdviceResult:
    """Press time and platens for a panel not pressed yet, and those beside them."""

    advised: ProgrammeAdvice
    """Programs looked at, the best one, what was asked; press times [s], platens [°C], chances from 0 to 1."""

    def frame(self) -> pd.DataFrame:
        """Return one row a program looked at: press time [s], risk, energy [kWh], cost [€].

        NaN where no press time will do or nobody asked; ``blocking`` is empty where no limit is in the way.
        """
        import pandas as pd

        table = pd.DataFrame(self.advised.as_json()["programs"]).set_index("platen_temperature_C")
        numbers = dict.fromkeys(table.columns.drop("blocking"), float)
        return table.astype(numbers).fillna({"blocking": ""})

    def plot(self) -> list[Axes]:
        """Draw press time against risk; return the axes."""
        from softsensor.report.advice_figure import advice_figure

        return shown(advice_figure(self.advised, chosen()))

    def to_json(self) -> str:
        """Return what ``advise --json`` writes."""
        return json.dumps(self.advised.as_json())

    def __repr__(self) -> str:
        """Say the answer, what it costs, and what to measure to press shorter."""
        return printed([[line] for line in advice_messages(self.advised)])

    def _repr_html_(self) -> str:
        return lines_html(advice_messages(self.advised)) + table_html(self.frame())


def advise(  # noqa: PLR0913 - one argument a wish
    press: AnyPress,
    model: AnyModel,
    resin: Resin | Path | str | None = None,
    *,
    panel: Mapping[str, Any] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    limits: Mapping[str, float] | None = None,
    goal: str = "time",
    price_per_kWh: float | None = None,
    waiting_s: float = USUAL_WAIT_S,
    open_s: float = USUAL_OPEN_S,
    progress: Callable[[str, float], None] | None = None,
) -> AdviceResult:
    """Work out press time and platen temperature for a panel not pressed yet.

    Parameters
    ----------
    resin
        The resin file: kinetics, sorption and limits; without it the core alone can be limited.
    panel
        Keys of a run's header, such as ``panel.thickness_mm``; MDF of 16 mm without.
    ranges
        ``platen_temperature_C``, ``press_time_s``, ``pressure_N_cm2`` from and to.
    limits
        ``cure_least``, ``core_least_C``, ``core_most_C``, ``steam_most_kPa``, ``probability``, before the resin's.
    goal
        ``time``, ``energy`` or ``throughput``.
    price_per_kWh
        In euros.
    waiting_s, open_s
        From laying the panel in to closing; and how long the press is open between two panels. [s]

    Raises
    ------
    InputError
        For no limit, limits that contradict each other, one of steam without the panel's moisture, or a panel,
        range, time, price or press that cannot be.

    Examples
    --------
    The core of a thin panel is to pass 60 °C, at platens of 180 °C:

    >>> from daq import shared_files
    >>> from softsensor import FittedValue, ModelFile
    >>> model = ModelFile("mine", "lab", {"h_pp_c": FittedValue(650.0, 80.0)})
    >>> found = advise(
    ...     shared_files() / "presses" / "lab.toml",
    ...     model,
    ...     panel={"panel.thickness_mm": 8.0},
    ...     ranges={"platen_temperature_C": (180.0, 180.0), "press_time_s": (20.0, 120.0)},
    ...     limits={"core_least_C": 60.0},
    ... )
    >>> at_180 = found.frame().loc[180.0]
    >>> bool(at_180["likely_press_time_s"] < at_180["press_time_s"] < 90.0)
    True
    """
    if name_of(goal) not in (known := tuple(one.value for one in Goal)):
        raise InputError(say("advise-goal-unknown", goal=goal, known=known))
    _check("waiting_s", waiting_s, WAITING_S)
    _check("open_s", open_s, OPEN_S)
    _check("price_per_kWh", 0.0 if price_per_kWh is None else price_per_kWh, PRICE)
    loaded = resin_of(resin)
    wanted = limits_of(loaded, keys_of(limits, "given-no-limits"))
    settable = keys_of(ranges, "given-no-ranges")
    allowed = given_ranges(settable, DEFAULT_RANGES)
    given = flat_header(keys_of(panel, "given-no-header"))
    check_header(given, ADVISED)
    for doubt in doubts(given):
        warn(doubt)
    header = {**USUAL_PANEL, "panel.initial_temperature_C": ROOM_C, **given}
    described = read_press(press)
    task = Task(described, model_for(model, described, header), header, waiting_s, allowed["press_time_s"][1])
    if PRESSURE in settable and not task.follows_load:
        raise InputError(say("advise-pressure-unknown", name=PRESSURE))
    wish = Wish(wanted, loaded, allowed, Goal(goal), open_s, price_per_kWh)
    return AdviceResult(advise_on(task, wish, progress))


def _check(name: str, value: object, within: tuple[float, float]) -> None:
    """Refuse a number that lies outside. Raises `InputError`."""
    low, high = within
    if not low <= number_of(value) <= high:
        raise InputError(say("solve-value-out-of-range", name=name, value=repr(value), lower=low, upper=high))
