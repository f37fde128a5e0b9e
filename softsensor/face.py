"""Kerntemp from Python: read a run, fit, diagnose, predict, simulate; results as pandas tables and figures.

Everything here takes what is at hand: a run as a file's path, a table or a `Run`; a press as a file's path or a
`Press`; a model as a file's path, a `ModelFile`, or the result of a fit or a diagnosis. Errors are those of the
command line.

What it hands out cannot be changed: results, runs with their headers and columns, and the mappings and arrays of
what a result is about (`FitResult.campaign` and its runs, `Simulation.simulated`); the tables, lists and JSON that
a method returns are made anew each time. Deeper down, where a fit keeps its solver (``problem``, ``minimum``,
``model``), nothing is promised. Results and runs are equal only if they are the same object, and can be keys.
"""

from __future__ import annotations

import html
import json
import math
import numbers
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeAlias

import pandas as pd

from daq.files.frames import attrs_of, run_of
from daq.files.legible import legible
from daq.files.mapping import read_foreign, read_mapping
from daq.files.run_file import read_run as read_run_file
from daq.press.header import check_header
from daq.press.press_file import Press
from daq.press.press_file import read_press as read_press_file
from daq.press.resin_file import Resin, read_resin
from daq.records import ROOM_C, FrozenDict, InputError, Run, with_frozen_fields
from daq.words import Message, say
from softsensor.diagnosis.finding import Diagnosis
from softsensor.diagnosis.summary import verdict_said
from softsensor.diagnosis.verdict import diagnose as diagnose_runs
from softsensor.fitting.campaign import CampaignFit
from softsensor.fitting.result import Coefficient, rounded
from softsensor.fitting.simulated_run import Simulated, simulate_run
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.campaign import diagnosed_model, fit_campaign
from softsensor.jobs.first_start import Work, compile_for
from softsensor.jobs.model_files import read_model as read_model_file
from softsensor.live.replay import Replay, replay
from softsensor.live.sensor import Estimate
from softsensor.live.sensor import LiveSensor as ScanSensor
from softsensor.planning.advise import DEFAULT_RANGES, Goal, ProgrammeAdvice, Wish, limits_of
from softsensor.planning.advise import advise as advise_on
from softsensor.planning.made_up import Task
from softsensor.planning.plan import Plan
from softsensor.planning.plan import plan as plan_after
from softsensor.planning.program import given_ranges
from softsensor.planning.summary import advice_said, plan_said

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

UNKNOWN = "–"

AnyRun: TypeAlias = Run | pd.DataFrame | Path | str
AnyPress: TypeAlias = Press | Path | str


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
        rows = [
            {"run": run.run, "coefficient": name, "value": c.value, "sd": c.sd}
            | {"low": c.ci95[0], "high": c.ci95[1], "identifiable": c.identifiable, "rmse_K": run.rmse_K}
            for run in self.campaign.runs
            for name, c in run.coefficients.items()
        ]
        frame = pd.DataFrame(rows).set_index(["run", "coefficient"])
        return _about(self.campaign.runs[0].problem.case.run, frame) if len(self.campaign.runs) == 1 else frame

    def plot(self) -> list[Axes]:
        """Draw the coefficients over the runs; return the axes."""
        from softsensor.report.fit_figures import coefficients_figure

        return _shown(coefficients_figure(self.campaign))

    def model(self) -> ModelFile:
        """Return the campaign's model, as ``fit --model`` writes it."""
        from softsensor.diagnosis.missing_causes import with_missing_causes

        return with_missing_causes(self.campaign.model_file(), self.campaign.runs)

    def to_json(self) -> str:
        """Return what ``fit --json`` writes."""
        return json.dumps(self.campaign.as_json())

    def __repr__(self) -> str:
        """Show what is known from each run, to the digits it is known to; of several runs mean and scatter."""
        over = self.campaign.coefficients
        rows = {
            run.run: {n: _known(run.coefficients[n]) for n in over} | {"rmse_K": f"{run.rmse_K:.2f}"}
            for run in self.campaign.runs
        }
        if len(rows) > 1:
            rows["mean"] = {n: _digits(c.mean, c.ci95) if c.runs else UNKNOWN for n, c in over.items()}
            rows["sd"] = {n: f"{c.sd:.2g}" if math.isfinite(c.sd) else UNKNOWN for n, c in over.items()}
        table = pd.DataFrame.from_dict(rows, orient="index").fillna("")
        short = self.campaign.shortfall
        return "\n".join([table.to_string(max_rows=12), *([str(short)] if short else [])])

    def _repr_html_(self) -> str:
        return str(self.frame().to_html(float_format="%.4g", max_rows=24))


def _known(found: Coefficient) -> str:
    return _digits(found.value, found.ci95) if found.identifiable else UNKNOWN


def _digits(value: float, ends: tuple[float, float]) -> str:
    return f"{rounded(value, ends):.4g}"


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
        columns = ["effect", "parameter", "value", "low", "high", "p_value", "heldout_gain_K", "named"]
        rows, content = [], self.content
        for effect in (*content["effects"], *content["suspected"]):
            common = (effect["p_value"], effect["heldout_gain_K"], effect in content["effects"])
            for name, told in effect["parameters"].items():
                low, high = told["ci95"] if isinstance(told, Mapping) and told.get("ci95") else (None, None)
                value = told["value"] if isinstance(told, Mapping) else told
                rows.append((effect["name"], name, value, low, high, *common))
        return pd.DataFrame(rows, columns=columns).set_index(["effect", "parameter"])

    def plot(self) -> list[Axes]:
        """Draw one run under both models with its residuals; return the axes."""
        from softsensor.diagnosis.curves import curves_of
        from softsensor.report.diagnosis_figures import worst_run_figure

        return _shown(worst_run_figure(curves_of(self.diagnosis)))

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
        """Show verdict, causes, error before and after, and what to measure next."""
        head, *rest = self._lines()
        table = [self.frame().to_string(float_format="%.4g")] if len(self.frame()) else []
        return "\n".join([head, *table, *rest])

    def _repr_html_(self) -> str:
        head, *rest = (html.escape(line) for line in self._lines())
        table = str(self.frame().to_html(float_format="%.4g")) if len(self.frame()) else ""
        return f"<p><b>{head}</b></p>{table}" + "".join(f"<p>{line}</p>" for line in rest)

    def _lines(self) -> list[str]:
        found = self.diagnosis
        residual = say("diagnosed-residual", base=found.base.rmse_K, extended=found.extended.rmse_K)
        said = " ".join(map(str, verdict_said(found)))
        return [f"{self.verdict}: {said}", str(residual), str(found.next_measurement)]


@dataclass(frozen=True, repr=False, eq=False)
class Prediction:
    """The core as the live sensor would have said it, scan by scan. [°C]"""

    replayed: Replay
    """The run and what was said at each of its scans, an `Estimate` each."""

    def frame(self) -> pd.DataFrame:
        """Return the columns of ``predict --out``, indexed by ``time_s``, the run's header in ``attrs``. [°C]"""
        return _about(self.replayed.run, pd.DataFrame(self.replayed.columns()).set_index("time_s"))

    def plot(self) -> list[Axes]:
        """Draw the core with its 95 % band, and a measured core where the run has one; return the axes."""
        table, run = self.frame(), self.replayed.run
        ax = _axes("figure-core-live")
        sure = table["valid"] == 1
        ax.fill_between(table.index, table["core_low_C"], table["core_high_C"], where=sure, alpha=0.25, lw=0)
        ax.plot(table.index[sure], table["core_C"][sure], label="core_C")
        for name in run.matching(["core_*"]):
            ax.plot(run.time_s, run.columns[name], ".", ms=2, label=name)
        ax.legend(frameon=False)
        return _shown(ax.figure)

    def to_json(self) -> str:
        """Return the table as JSON, a list a column; null where there is no value."""
        return _lists(self.frame())

    def __repr__(self) -> str:
        """Show the first and the last scans."""
        return f"{self.replayed.run.name}\n{self.frame().to_string(max_rows=12, float_format='%.2f')}"

    def _repr_html_(self) -> str:
        return str(self.frame().to_html(max_rows=24, float_format="%.2f"))


@dataclass(frozen=True, repr=False, eq=False)
class Simulation:
    """A run as the model has it, open loop from its platen temperatures. [°C]"""

    run: Run
    simulated: Simulated
    """Temperatures at every place and through the panel [°C], and how far the readings are off [K]."""

    def frame(self) -> pd.DataFrame:
        """Return the columns of ``simulate --out``, indexed by ``time_s``, the run's header in ``attrs``. [°C]"""
        state = [str(state) for state in self.simulated.state]
        columns = {"state": state, **self.simulated.places, "core_C": self.simulated.core}
        return _about(self.run, pd.DataFrame(columns, index=pd.Index(self.simulated.time_s, name="time_s")))

    def plot(self) -> list[Axes]:
        """Draw every place, measured as dots and simulated as lines; return the axes."""
        ax = _axes("figure-dots-and-lines")
        for place, values in self.simulated.places.items():
            (line,) = ax.plot(self.simulated.time_s, values, label=place)
            ax.plot(self.simulated.time_s, self.simulated.measured[place], ".", ms=2, color=line.get_color())
        ax.plot(self.simulated.time_s, self.simulated.core, label="core_C", color="black")
        ax.legend(frameon=False)
        return _shown(ax.figure)

    def to_json(self) -> str:
        """Return the table as JSON, a list a column; null where there is no value."""
        return _lists(self.frame())

    def __repr__(self) -> str:
        """Show the error at each place, and the first and last rows."""
        errors = ", ".join(f"{place} {value:.2f} K" for place, value in self.simulated.rmse.items())
        return f"{self.run.name}: {errors}\n{self.frame().to_string(max_rows=8, float_format='%.2f')}"

    def _repr_html_(self) -> str:
        return str(self.frame().to_html(max_rows=24, float_format="%.2f"))


@dataclass(frozen=True, repr=False, eq=False)
class PlanResult:
    """The next pressings worth most, and what each would settle."""

    planned: Plan

    def frame(self) -> pd.DataFrame:
        """Return one row an open point and pressing: its settings, chance to settle it, and runs needed."""
        rows = []
        for number, point in enumerate(self.planned.as_json()["open"]):
            for which in ("best", "with_core", "repeated"):
                if (pressing := point[which]) is not None:
                    about = {"open": number, "kind": point["kind"], "name": point["name"], "pressing": which}
                    told = {key: pressing[key] for key in ("worth", "chance", "runs", "half_interval")}
                    rows.append(about | told | dict(pressing["settings"]))
        index = ["open", "kind", "name", "pressing"]
        return pd.DataFrame(rows).set_index(index) if rows else pd.DataFrame(columns=index).set_index(index)

    def plot(self) -> list[Axes]:
        """Draw what one pressing of each kind is worth to each open point; return the axes."""
        ax = _axes("figure-worth-of-pressing")
        table = self.frame()
        if len(table):
            table["worth"].unstack("pressing").plot.barh(ax=ax)
            ax.set_xlabel("nats")
        return _shown(ax.figure)

    def to_json(self) -> str:
        """Return what ``plan --json`` writes."""
        return json.dumps(self.planned.as_json())

    def __repr__(self) -> str:
        """Say what is open and the pressings for it."""
        return "\n".join(map(str, plan_said(self.planned)))

    def _repr_html_(self) -> str:
        return "".join(f"<p>{html.escape(str(line))}</p>" for line in plan_said(self.planned))


@dataclass(frozen=True, repr=False, eq=False)
class AdviceResult:
    """Press time and platens for a panel not pressed yet, and those beside them."""

    advised: ProgrammeAdvice

    def frame(self) -> pd.DataFrame:
        """Return one row a program looked at: press time, risk, energy; NaN where no press time will do."""
        return pd.DataFrame(self.advised.as_json()["programs"]).set_index("platen_temperature_C")

    def plot(self) -> list[Axes]:
        """Draw press time against risk; return the axes."""
        from softsensor.report.advice_figure import advice_figure

        return _shown(advice_figure(self.advised))

    def to_json(self) -> str:
        """Return what ``advise --json`` writes."""
        return json.dumps(self.advised.as_json())

    def __repr__(self) -> str:
        """Say the answer, what it costs, and what to measure to press shorter."""
        return "\n".join(map(str, advice_said(self.advised)))

    def _repr_html_(self) -> str:
        return "".join(f"<p>{html.escape(str(line))}</p>" for line in advice_said(self.advised))


AnyModel: TypeAlias = ModelFile | FitResult | DiagnosisResult | Path | str


def read_run(source: AnyRun, *, mapping: Path | str | None = None, header: Mapping[str, Any] | None = None) -> Run:
    """Return a run from a CSV or Parquet file, a pandas table, or another logger's file.

    Parameters
    ----------
    mapping
        The TOML file that explains another logger's columns, units and times.
    header
        Keys beside those that the table or file has: panel, ambient, settings. The ones given here count.

    Raises
    ------
    InputError
        Naming file, line or column, value, limit and what to do.
    """
    if isinstance(source, pd.DataFrame):
        return run_of(source, header)
    if isinstance(source, Run):
        found = source
    elif mapping is not None:
        found = read_foreign(Path(source), read_mapping(Path(mapping)))
    else:
        found = read_run_file(Path(source))
    if header is None:
        return _frozen_run(found)
    keys = {**found.header, **header}
    check_header(keys, found.source or found.name)
    return _frozen_run(replace(found, header=keys, name=str(keys.get("run", found.name))))


def _frozen_run(run: Run) -> Run:
    """Return a run that cannot be changed: itself where it is one."""
    if isinstance(run.header, FrozenDict) and isinstance(run.columns, FrozenDict):
        return run
    made: Run = with_frozen_fields(run)
    return made


def read_press(path: AnyPress) -> Press:
    """Return the press that a press file describes. Raises `InputError`."""
    return path if isinstance(path, Press) else read_press_file(Path(path))


def read_model(model: AnyModel) -> ModelFile:
    """Return a model from its file, or out of the result of a fit or a diagnosis. Raises `InputError`."""
    if isinstance(model, FitResult | DiagnosisResult):
        return model.model()
    return model if isinstance(model, ModelFile) else read_model_file(Path(model))


def fit(runs: AnyRun | Sequence[AnyRun], press: AnyPress, *, profiles: bool = False) -> FitResult:
    """Fit the heat transfer coefficients of each run and of all together. [W/m²K]

    Parameters
    ----------
    runs
        One run or several, as files, tables or `Run`. [°C, s]
    profiles
        Work out the likelihood's profile of each coefficient too, for the JSON; it takes longer.

    Raises
    ------
    InputError
        For a run or press file that cannot be read, words in a column that the press file names, a run without a
        platen's column, without sensors or without the panel's data, and no run at all.
    """
    described = read_press(press)
    found = with_frozen_fields(fit_campaign(described, _runs(runs, described), profiles=profiles))
    return FitResult(replace(found, runs=tuple(map(with_frozen_fields, found.runs))))


def diagnose(
    runs: AnyRun | Sequence[AnyRun], press: AnyPress, *, effects: Sequence[str] | None = None
) -> DiagnosisResult:
    """Say what the simulation of these runs gets wrong, why, and what knowing it is worth. [K]

    Parameters
    ----------
    runs
        One run or several, as files, tables or `Run`. [°C, s]
    effects
        Causes to look for, by name; the whole catalogue without.

    Raises
    ------
    InputError
        As `fit`, and for an effect that the catalogue does not have.
    """
    described = read_press(press)
    return DiagnosisResult(diagnose_runs(described, _runs(runs, described), effects=effects))


def plan(
    runs: AnyRun | Sequence[AnyRun] | DiagnosisResult,
    press: AnyPress,
    *,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> PlanResult:
    """Say which pressings are worth most next, and what each would settle.

    Parameters
    ----------
    runs
        Measured runs, or their diagnosis, which saves making it again.
    ranges
        What can be set and how far, by name (``thickness_mm``, ``platen_temperature_C``, ``press_time_s``,
        ``start_temperature_C``, ``waiting_s``, ``pressure_N_cm2``); the runs' own, modestly widened, without.

    Raises
    ------
    InputError
        As `diagnose`, and for a range that cannot be.
    """
    found = runs if isinstance(runs, DiagnosisResult) else diagnose(runs, press)
    return PlanResult(plan_after(read_press(press), found.diagnosis, ranges or {}))


USUAL_PANEL: Mapping[str, Any] = MappingProxyType({"panel.material": "MDF", "panel.thickness_mm": 16.0})
"""What is advised on where nothing is said of the panel; the answer names it."""


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
    waiting_s: float = 10.0,
    open_s: float = 30.0,
    progress: Callable[[str, float], None] | None = None,
) -> AdviceResult:
    """Say how long to press a panel not pressed yet, and how hot, under limits at a wanted probability.

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
        For no limit, or a panel, range or press that cannot be.
    """
    if goal not in (known := tuple(one.value for one in Goal)):
        raise InputError(say("advise-goal-unknown", goal=goal, known=known))
    loaded = _resin(resin)
    wanted = limits_of(loaded, limits or {})
    allowed = given_ranges(ranges or {}, DEFAULT_RANGES)
    header = {**USUAL_PANEL, "panel.initial_temperature_C": ROOM_C, **(panel or {})}
    task = Task(read_press(press), read_model(model), header, waiting_s, allowed["press_time_s"][1])
    wish = Wish(wanted, loaded, allowed, Goal(goal), open_s, price_per_kWh)
    return AdviceResult(advise_on(task, wish, progress))


def predict(
    run: AnyRun,
    press: AnyPress,
    model: AnyModel | None = None,
    *,
    without: Sequence[str] = (),
    resin: Resin | Path | str | None = None,
) -> Prediction:
    """Replay a run through the live sensor, causally: row i rests on nothing later than scan i. [°C]

    Parameters
    ----------
    model
        Coefficients and effects from earlier runs; the press file's guesses without.
    without
        Columns (patterns) that it does not see; each must match one.
    resin
        A resin file: adds cure at both faces (0 to 1), steam [kPa] and leave to open.

    Raises
    ------
    InputError
        For a run, press, model or resin file that cannot be read, words in a column that the press file names, a
        pattern that matches no column, a run without a platen's column or the panel's data, and a resin for a
        press without a panel.
    """
    described = read_press(press)
    loaded = legible(read_run(run), described)
    known = None if model is None else read_model(model)
    compile_for(Work.LIVE)
    replayed = replay(described, loaded, known, loaded.named(without), resin=_resin(resin))
    return Prediction(replayed)


def simulate(run: AnyRun, press: AnyPress, model: AnyModel | Mapping[str, float] | None = None) -> Simulation:
    """Simulate a run, open loop, from its platen temperatures. [°C]

    Parameters
    ----------
    model
        A model, or coefficients by name [W/m²K]; what it does not name stays at the press file's guess.

    Raises
    ------
    InputError
        For a run, press or model file that cannot be read, words in a column that the press file names, a run
        without a platen's column, a sensor or the panel's data, and a coefficient that is unknown or nonphysical.
    """
    described = read_press(press)
    loaded = legible(read_run(run), described)
    if model is None or isinstance(model, Mapping):
        thermal = ThermalModel(described)
        return _simulation(loaded, described, thermal, {**thermal.guesses, **(model or {})})
    content = read_model(model)
    values = {**ThermalModel(described).guesses, **content.values}
    return _simulation(loaded, described, content.model(described), values)


def _simulation(run: Run, press: Press, model: ThermalModel, values: Mapping[str, float]) -> Simulation:
    return Simulation(run, with_frozen_fields(simulate_run(run, press, model, values)))


class LiveSensor(ScanSensor):
    """A live sensor fed by hand: takes scans and says what the core is doing.

    Parameters
    ----------
    press
        Where sensors lie and which columns are platens.
    header
        The run's header: panel, ambient, settings; of a table, its ``attrs``.
    model
        Coefficients and effects from earlier runs; without, the press file's guesses.
    resin
        How the paper cures and what must hold at opening; without, nobody asks.

    Raises
    ------
    InputError
        For a header that cannot be, or what is wrong in a file.
    """

    def __init__(
        self,
        press: AnyPress,
        header: Mapping[str, Any],
        model: AnyModel | None = None,
        resin: Resin | Path | str | None = None,
    ) -> None:
        check_header(header, "LiveSensor")
        compile_for(Work.LIVE)
        super().__init__(read_press(press), header, None if model is None else read_model(model), _resin(resin))
        self._newest_s = -math.inf

    def update(self, time_s: float, values: Mapping[str, float | None]) -> Estimate:
        """Take a scan and return what is known then.

        Parameters
        ----------
        time_s
            Later than that of any scan before. [s]
        values
            By column, a row of a table for instance; missing ones None, NaN or left out. [°C, or the column's own]

        Raises
        ------
        InputError
            For a time that does not rise, a value that is no number, and at the first scan for what press or panel
            lacks in header or columns.
        """
        if not self._newest_s < time_s < math.inf:
            raise InputError(say("live-time-not-rising", time_s=float(time_s), newest_s=self._newest_s))
        said = super().update(float(time_s), {name: _reading(name, value) for name, value in values.items()})
        self._newest_s = float(time_s)
        return said


def _reading(column: str, value: float | None) -> float:
    """Return a channel's value, NaN where there is none."""
    if value is None or value is pd.NA:
        return math.nan
    if not isinstance(value, numbers.Real):
        raise InputError(say("live-value-no-number", column=column, value=repr(value)))
    return float(value)


def _resin(resin: Resin | Path | str | None) -> Resin | None:
    return resin if resin is None or isinstance(resin, Resin) else read_resin(Path(resin))


def _runs(runs: AnyRun | Sequence[AnyRun], press: Press) -> list[Run]:
    given = [runs] if isinstance(runs, Run | pd.DataFrame | Path | str) else runs
    return [legible(read_run(run), press) for run in given]


def _about(run: Run, frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table with the header of the run it is about."""
    frame.attrs.update(attrs_of(run))
    return frame


def _lists(frame: pd.DataFrame) -> str:
    table = frame.reset_index().astype(object)
    return json.dumps(table.where(table.notna(), None).to_dict("list"))


def _shown(figure: Figure) -> list[Axes]:
    """Hand a figure to pyplot, so that a notebook shows it and ``plt.show()`` does; return its axes."""
    from matplotlib import pyplot

    pyplot.figure(figure)
    return list(figure.axes)


def _axes(title: str) -> Any:
    """Return axes of temperature over time, under a title given by its code."""
    from matplotlib.figure import Figure

    ax = Figure(figsize=(8.0, 4.0), layout="constrained").add_subplot()
    ax.set(title=str(Message(title)), xlabel=str(say("figure-time")), ylabel=str(say("figure-temperature")))
    return ax
