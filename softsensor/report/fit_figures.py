"""Figures of a fit: measured against simulated, coefficients over a campaign. Titles say the finding."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from threading import RLock
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, ScalarFormatter, StrMethodFormatter

from daq.records import Array
from daq.words import Message, say
from daq.words.message import ENGLISH, words
from softsensor.effects.vocabulary import place_words
from softsensor.fitting.campaign import CampaignFit
from softsensor.fitting.core import FittedCore, fitted_core
from softsensor.fitting.paper.procedures import SolverComparison
from softsensor.fitting.result import RunFit, rounded
from softsensor.fitting.unknowns import is_coefficient
from softsensor.signals.places import Place
from softsensor.signals.robust import channel_scatter

INK, MUTED, GRID = "#1f2933", "#6b7785", "#e3e7ec"
COLOURS = ("#c2571a", "#1f6fb2", "#2f8f6b", "#7a5ba8")
"""Of places, upper face first."""
Put = Callable[[Message | str], str]
"""Puts a message into the language of a figure."""

# Numbers without another source were set by hand, 2026-11.

FEW_TICKS = 8
"""Runs up to which each has its tick."""
CLOSED_SHADE = "#f1f3f6"
LETTERS_PT = 10.5
"""Of all letters, the smallest too: a picture 10 in wide is shown as narrow as 640 px, where they are 9 px high
or more."""
STYLE: Mapping[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": LETTERS_PT,
    "figure.titlesize": 10.8,
    "xtick.labelsize": LETTERS_PT,
    "ytick.labelsize": LETTERS_PT,
    "legend.fontsize": LETTERS_PT,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlesize": 11.0,
    "axes.titleweight": "bold",
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "legend.facecolor": "white",
    "legend.edgecolor": "none",
    "legend.framealpha": 0.85,
    "svg.hashsalt": "kerntemp",
    "svg.fonttype": "path",
}


_STYLING = RLock()
"""A style belongs to the whole process, and a server draws in several threads."""


@contextmanager
def sheet(size: tuple[float, float], language: str, title: Message | None = None) -> Iterator[Figure]:
    """Make a figure [in] in the reports' style, under a title; its axes have the language's decimal sign."""
    with _STYLING, rc_context(dict(STYLE)):
        figure = Figure(figsize=size, layout="constrained")
        if title is not None:
            figure.suptitle(words(title, language), x=0.01, ha="left", color=INK, weight="bold", wrap=True)
        yield figure
        sign = words(say("report-tenths", value=0.5), language)[1]
        for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
            formatter = axis.get_major_formatter()
            if isinstance(formatter, ScalarFormatter):
                axis.set_major_formatter(_Signed(sign))
            elif isinstance(formatter, StrMethodFormatter):
                axis.set_major_formatter(FuncFormatter(_with_sign(formatter, sign)))


def legend_below(figure: Figure, most: int, *given: Any, **style: Any) -> None:
    """Put a legend below the axes, in as many columns up to `most` as the figure is wide."""
    for columns in range(most, 0, -1):
        legend = figure.legend(*given, loc="outside lower center", ncols=columns, **style)
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


def svg(figure: Figure) -> str:
    """Return a figure as SVG text, the same for the same figure."""
    buffer = io.BytesIO()
    with _STYLING, rc_context(dict(STYLE)):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue().decode()


def _with_sign(formatter: StrMethodFormatter, sign: str) -> Callable[[float, int | None], str]:
    return lambda value, place: formatter(value, place).replace(".", sign)


class _Signed(ScalarFormatter):
    """What an axis' numbers are by default, with a language's decimal sign."""

    def __init__(self, sign: str) -> None:
        super().__init__()
        self._sign = sign

    def __call__(self, value: float, pos: int | None = None) -> str:
        return super().__call__(value, pos).replace(".", self._sign)

    def get_offset(self) -> str:
        return super().get_offset().replace(".", self._sign)


def campaign_figures(campaign: CampaignFit, language: str = ENGLISH) -> dict[str, str]:
    """Return every figure of a campaign as SVG text, by name: the runs, the coefficients, what moves together."""
    figures = {"coefficients": svg(coefficients_figure(campaign, language))}
    if scattered(campaign):
        figures["coefficients_normalised"] = svg(normalised_figure(campaign, language))
    for fitted in campaign.runs:
        figures[f"measured_{fitted.run}"] = svg(fitted_run_figure(fitted, language))
        if (core := fitted_core(fitted)) is not None:
            figures[f"core_{fitted.run}"] = svg(core_figure(fitted, core, language))
        figures[f"correlation_{fitted.run}"] = svg(correlation_figure(fitted, language))
    return figures


def fitted_run_figure(fitted: RunFit, language: str = ENGLISH) -> Figure:
    """Measured faces with error bars, simulated with guesses and with the fit, residuals below."""
    put = partial(words, language=language)
    places = _ordered(fitted.problem.signals.places)[:4]
    after, before = _predictions(fitted)
    off = {"fit": fitted.rmse_K, "guesses": fitted.initial_rmse_K}
    code = "figure-fit" if fitted.met else "figure-not-described"
    with sheet((10.0, 5.6), language, Message(code, {"run": fitted.run, **off})) as figure:
        axes = figure.subplots(2, len(places), sharex=True, squeeze=False, height_ratios=[3, 1.25])
        for j, place in enumerate(places):
            colour = COLOURS[j % len(COLOURS)]
            _draw_measured(axes[0, j], fitted, place, put)
            _draw_simulated(axes[0, j], fitted, (before[place.label], after[place.label]), (colour, put))
            _draw_residual(axes[1, j], fitted, (place.mean - after[place.label], place), (colour, put))
            axes[0, j].legend(loc="best")
        limit = 1.1 * max(abs(v) for ax in axes[1] for v in ax.get_ylim())
        for ax in axes[1]:
            ax.set_ylim(-limit, limit)
            ax.set_xlabel(put(say("figure-time")))
        axes[0, 0].set_ylabel(put(say("figure-temperature")))
        axes[1, 0].set_ylabel(put(say("figure-measured-minus-model")))
    return figure


def core_figure(fitted: RunFit, found: FittedCore, language: str = ENGLISH) -> Figure:
    """Draw the core by the fitted model with its 95 % band, and the measured one where a thermocouple reads it."""
    put = partial(words, language=language)
    t, widest = fitted.problem.signals.time_s, 0.5 * float(np.nanmax(found.high - found.low))
    measured = np.flatnonzero(np.isfinite(found.measured))
    known: dict[str, float | str] = {"run": fitted.run, "half": widest}
    title = say("figure-core-fitted-measured", **known, error=found.error_K)
    with sheet((10.0, 3.2), language, title if len(measured) else say("figure-core-fitted", **known)) as figure:
        ax = figure.subplots()
        ax.fill_between(
            t, found.low, found.high, color=COLOURS[0], alpha=0.22, lw=0, label=put(say("figure-core-band"))
        )
        ax.plot(t, found.core, lw=1.6, color=COLOURS[0], label=put(say("figure-core-by-fit")), zorder=3)
        if len(measured):
            picked = measured[:: max(1, len(measured) // 60)]
            dots: dict[str, Any] = {"ms": 2.6, "color": INK, "label": put(say("figure-core-measured"))}
            ax.plot(t[picked], found.measured[picked], "o", **dots, zorder=4)
        _shade_closed(ax, fitted)
        ax.set_xlabel(put(say("figure-time")))
        ax.set_ylabel(put(say("figure-temperature")))
        ax.legend(loc="best")
    return figure


def _ordered(places: Sequence[Place]) -> list[Place]:
    return sorted(places, key=lambda p: p.label.endswith("bottom"))


def _predictions(fitted: RunFit) -> tuple[dict[str, Array], dict[str, Array]]:
    """By place, simulated at the fit and at the press file's guesses."""
    problem = fitted.problem
    guesses = dict(problem.values) | {
        n: problem.case.press.coefficient(n).guess for n in problem.case.press.coefficient_names
    }
    first = problem.model.solve(problem.case, guesses)
    fit = fitted.minimum.evaluation.solution
    after, before = {}, {}
    for i, place in enumerate(problem.signals.places):
        column = fit.columns.index(place.columns[0])
        after[place.label] = fit.sensors[:, column] + (problem.correction[i] if problem.correction else 0.0)
        before[place.label] = first.sensors[:, column]
    return after, before


def _draw_measured(ax: Any, fitted: RunFit, place: Place, put: Put) -> None:
    signals = fitted.problem.signals
    cells = np.stack([signals.cells[c] for c in place.columns], axis=1)
    picked = np.flatnonzero(np.isfinite(place.mean) & (fitted.problem.rows > 0))
    picked = picked[:: max(1, len(picked) // 60)]
    spread = np.array([np.nanstd(cells[k]) if np.isfinite(cells[k]).sum() > 1 else 0.0 for k in picked])
    many = len(place.columns) > 1
    label = say("figure-measured-mean", channels=len(place.columns)) if many else say("figure-measured")
    times, means = signals.time_s[picked], place.mean[picked]
    ax.errorbar(times, means, spread, fmt="o", ms=2.6, lw=0.8, color=INK, label=put(label), zorder=3)
    ax.set_title(put(place_words(place.label)))


def _draw_simulated(ax: Any, fitted: RunFit, simulated: tuple[Array, Array], drawn: tuple[str, Put]) -> None:
    """Draw what guesses and fit make of a place (rows), in the rows that were fitted."""
    (guesses, fit), (colour, put), t = simulated, drawn, fitted.problem.signals.time_s
    present = np.where(fitted.problem.rows > 0, 1.0, np.nan)
    label = put(say("figure-with-guesses"))
    ax.plot(t, guesses * present, ls=(0, (4, 3)), lw=1.2, color=MUTED, label=label, zorder=2)
    ax.plot(t, fit * present, lw=1.6, color=colour, label=put(say("figure-with-fit")), zorder=4)
    _shade_closed(ax, fitted)


def _shade_closed(ax: Any, fitted: RunFit) -> None:
    if np.isfinite(fitted.closed_s):
        end = fitted.opened_s if np.isfinite(fitted.opened_s) else fitted.problem.signals.time_s[-1]
        ax.axvspan(fitted.closed_s, end, color=CLOSED_SHADE, zorder=0, lw=0)


def _draw_residual(ax: Any, fitted: RunFit, off: tuple[Array, Place], drawn: tuple[str, Put]) -> None:
    """Draw the residual of a place (rows), its constant offset taken out, and the scatter of its sensors."""
    (difference, place), (colour, put), t = off, drawn, fitted.problem.signals.time_s
    _shade_closed(ax, fitted)
    residual = np.where(fitted.problem.rows > 0, difference, np.nan)
    residual = residual - float(np.nanmean(residual))
    band = channel_scatter(
        np.stack([fitted.problem.signals.cells[c] for c in place.columns], axis=1), own_offsets=True
    )
    ax.fill_between(t, residual - band, residual + band, color=colour, alpha=0.18, lw=0)
    ax.plot(t, residual, lw=0.9, color=colour)
    ax.axhline(0.0, color=MUTED, lw=0.8)
    calm = np.abs(residual[np.isfinite(residual)])
    reach = max(0.5, 1.3 * float(np.percentile(calm, 98.5))) if len(calm) else 1.0
    ax.set_ylim(-reach, reach)
    if len(calm) and calm.max() > reach:
        k = int(np.nanargmax(np.abs(residual)))
        sign = "−" if residual[k] < 0 else "+"
        largest = put(say("figure-largest", sign=sign, kelvin=abs(float(residual[k])), at=float(t[k])))
        at = {"transform": ax.transAxes, "ha": "right", "va": "top"}
        ax.text(0.99, 0.96, largest, **at, color=MUTED)


def coefficients_figure(campaign: CampaignFit, language: str = ENGLISH) -> Figure:
    """Every run's coefficients with their intervals, mean and spread: one panel each."""
    put = partial(words, language=language)
    names = list(campaign.coefficients)
    columns = min(3, max(len(names), 1))
    rows = -(-len(names) // columns)
    with sheet((10.0, 2.4 * rows + 0.5), language, _campaign_title(campaign)) as figure:
        axes = figure.subplots(rows, columns, squeeze=False)
        for ax, name in zip(axes.flat, names, strict=False):
            _draw_coefficient(ax, campaign, name, put)
        for ax in axes.flat[len(names) :]:
            ax.set_axis_off()
        for ax in axes[-1]:
            ax.set_xlabel(put(say("figure-run")))
    return figure


def _campaign_title(campaign: CampaignFit) -> Message:
    total, coefficients = len(campaign.met), campaign.coefficients
    if not total:
        return say("figure-nothing-known")
    known = tuple(n for n, c in coefficients.items() if c.runs == total)
    which = known_names(known, len(coefficients))
    if len(campaign.runs) == 1:
        return say("figure-known-from-run", run=campaign.runs[0].run, known=which)
    worst = max((coefficients[name].spread for name in scattered(campaign)), default=0.0)
    return say("figure-known-from-runs", runs=total, known=which, percent=100 * worst)


def known_names(known: tuple[str, ...], of: int) -> Message:
    """Say which coefficients are known, of so many."""
    if not known:
        return say("known-none")
    return say("known-all") if len(known) == of else say("list-of-names", names=known)


def _draw_coefficient(ax: Any, campaign: CampaignFit, name: str, put: Put) -> None:
    c = campaign.coefficients[name]
    ax.set_title(put(_coefficient_title(campaign, name)))
    if np.isfinite(c.sd):
        ax.axhspan(c.mean - c.sd, c.mean + c.sd, color="#dfeaf4", lw=0, zorder=0)
    if c.runs:
        ax.axhline(c.mean, color=COLOURS[1], lw=1.2, zorder=1)
    tops = [c.mean]
    for i, f in enumerate(campaign.runs, start=1):
        one = f.coefficients[name]
        if one.identifiable:
            low, high = one.ci95
            bars = [[max(one.value - low, 0.0)], [max(high - one.value, 0.0)]]
            ax.errorbar([i], [one.value], bars, fmt="o", ms=3.4, lw=1.0, color=INK, zorder=3)
            tops.append(min(high, 3.0 * c.mean))
        else:
            ax.plot([i], [c.mean], marker="x", ms=5, color=MUTED, zorder=2)
    ax.set_ylim(0.0, 1.15 * max(tops))
    ax.set_xlim(0.4, len(campaign.runs) + 0.6)
    if len(campaign.runs) <= FEW_TICKS:
        ax.set_xticks(range(1, len(campaign.runs) + 1))
    else:
        ax.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=FEW_TICKS))


def _coefficient_title(campaign: CampaignFit, name: str) -> Message:
    """Say what the runs know of a coefficient, to the digits of its interval."""
    c = campaign.coefficients[name]
    if not c.runs:
        return say("figure-coefficient-unknown", name=name)
    mean = rounded(c.mean, c.ci95)
    if name in campaign.shared:
        return say("figure-coefficient-shared", name=name, mean=mean)
    if np.isfinite(c.sd):
        return say("figure-coefficient-spread", name=name, mean=mean, sd=c.sd)
    return say("figure-coefficient", name=name, mean=mean)


def scattered(campaign: CampaignFit) -> list[str]:
    """Return the coefficients that several runs know: of the others nothing shows how they differ."""
    return [name for name, c in campaign.coefficients.items() if c.runs > 1]


def normalised_figure(campaign: CampaignFit, language: str = ENGLISH) -> Figure:
    """All coefficients over their means, side by side: which differ from run to run, and how much."""
    put = partial(words, language=language)
    names = scattered(campaign)
    most = max(names, key=lambda n: campaign.coefficients[n].spread)
    title = say("figure-normalised", name=most, percent=100 * campaign.coefficients[most].spread)
    with sheet((10.0, 3.3), language, title) as figure:
        ax = figure.subplots()
        for j, name in enumerate(names):
            c = campaign.coefficients[name]
            values = [
                f.coefficients[name].value / c.mean for f in campaign.runs if f.coefficients[name].identifiable
            ]
            places = j + np.linspace(-0.28, 0.28, len(values)) if len(values) > 1 else np.array([float(j)])
            ax.plot(places[: len(values)], values, "o", ms=3.2, color=INK, alpha=0.75, zorder=3)
            if np.isfinite(c.sd):
                ax.errorbar([j], [1.0], [c.sd / c.mean], fmt="_", ms=26, lw=7, color=COLOURS[1], alpha=0.3)
        ax.axhline(1.0, color=MUTED, lw=0.8)
        ax.set_xticks(range(len(names)), names)
        ax.set_ylabel(put(say("figure-over-mean")))
        ax.set_ylim(0.0, max(2.0, ax.get_ylim()[1]))
    return figure


def strongest_correlation(fitted: RunFit) -> tuple[int, int, float]:
    """Return the coefficient and the other unknown that move together most, and their correlation."""
    matrix = np.abs(fitted.correlation) * (1.0 - np.eye(len(fitted.names)))
    rows = [i for i, name in enumerate(fitted.names) if is_coefficient(name)]
    row, j = np.unravel_index(np.argmax(matrix[rows]), matrix[rows].shape)
    i = rows[int(row)]
    return i, int(j), float(fitted.correlation[i, j])


def moves_with(fitted: RunFit) -> Message:
    """Say which coefficient moves most with another unknown in a run."""
    i, j, value = strongest_correlation(fitted)
    sign = "−" if value < 0 else "+"
    return say(
        "figure-moves-with", run=fitted.run, one=fitted.names[i], other=fitted.names[j], sign=sign, size=abs(value)
    )


def correlation_figure(fitted: RunFit, language: str = ENGLISH) -> Figure:
    """Which unknowns of a run move together."""
    put = partial(words, language=language)
    names = list(fitted.names)
    matrix = np.where(np.eye(len(names)) > 0, np.nan, fitted.correlation)
    with sheet((7.4, 6.2), language) as figure:
        ax = figure.subplots()
        image = ax.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
        ax.set_xticks(range(len(names)), names, rotation=90)
        ax.set_yticks(range(len(names)), names)
        ax.grid(False)
        ax.set_title(put(moves_with(fitted)))
        figure.colorbar(image, ax=ax, shrink=0.7, label=put(say("figure-correlation")))
    return figure


def roughness_figure(found: SolverComparison, language: str = ENGLISH) -> Figure:
    """Draw the cost along one coefficient for an adaptive and for the exact solver."""
    put = partial(words, language=language)
    percent = 100.0 * (found.relative - 1.0)
    with sheet((8.0, 3.6), language, say("figure-roughness")) as figure:
        ax = figure.subplots()
        ax.plot(percent, found.adaptive, "o-", ms=2.5, lw=0.9, color=COLOURS[0], label=put(say("figure-adaptive")))
        ax.plot(percent, found.exact, lw=1.8, color=COLOURS[1], label=put(say("figure-exact")))
        ax.set_xlabel(put(say("figure-from-best", name=found.coefficient)))
        ax.set_ylabel(put(say("figure-cost")))
        ax.legend()
    return figure
