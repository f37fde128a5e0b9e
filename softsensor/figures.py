"""Figures of a fit: measured against simulated, coefficients over a campaign. Titles say the finding."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from daq.records import Array
from softsensor.campaign import CampaignFit
from softsensor.fit_result import RunFit
from softsensor.fit_unknowns import is_parameter
from softsensor.paper import Reproduction
from softsensor.parameters import plain
from softsensor.residuals import Place

INK, MUTED, GRID = "#1f2933", "#6b7785", "#e3e7ec"
COLOURS = ("#c2571a", "#1f6fb2", "#2f8f6b", "#7a5ba8")
"""Of places, upper face first."""
FEW_TICKS = 8
"""Runs up to which each has its tick."""
CLOSED_SHADE = "#f1f3f6"
STYLE: Mapping[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlesize": 10.5,
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
    "legend.frameon": False,
    "svg.hashsalt": "kerntemp",
    "svg.fonttype": "path",
}


def svg(figure: Figure) -> str:
    """Return a figure as SVG text, the same for the same figure."""
    return _saved(figure, "svg").decode()


def png(figure: Figure, dpi: int = 130) -> bytes:
    """Return a figure as PNG."""
    return _saved(figure, "png", dpi=dpi)


def _saved(figure: Figure, kind: str, **options: Any) -> bytes:
    buffer = io.BytesIO()
    with rc_context(dict(STYLE)):
        figure.savefig(buffer, format=kind, metadata={"Date": None} if kind == "svg" else None, **options)
    return buffer.getvalue()


def campaign_figures(campaign: CampaignFit) -> dict[str, str]:
    """Return every figure of a campaign as SVG text, by name: the runs, the coefficients, what moves together."""
    figures = {"coefficients": svg(coefficients_figure(campaign))}
    if len(campaign.met) > 1:
        figures["coefficients_normalised"] = svg(normalised_figure(campaign))
    for fitted in campaign.runs:
        figures[f"measured_{fitted.run}"] = svg(run_figure(fitted))
        figures[f"correlation_{fitted.run}"] = svg(correlation_figure(fitted))
    return figures


def run_figure(fitted: RunFit) -> Figure:
    """Measured faces with error bars, simulated before and after the fit, residuals below."""
    places = _ordered(fitted.problem.signals.places)[:4]
    after, before = _predictions(fitted)
    with rc_context(dict(STYLE)):
        figure = Figure(figsize=(10.0, 5.6), layout="constrained")
        axes = figure.subplots(2, len(places), sharex=True, squeeze=False, height_ratios=[3, 1.25])
        better = f"{fitted.rmse_K:.2f} K rms, {fitted.initial_rmse_K:.1f} K before"
        told = (
            "the fit meets the sensors to" if fitted.met else "the model does not describe this run, it is off by"
        )
        figure.suptitle(f"{fitted.run}: {told} {better}", x=0.01, ha="left", color=INK, weight="bold")
        for j, place in enumerate(places):
            colour = COLOURS[j % len(COLOURS)]
            _draw_place(axes[:, j], fitted, place, before[place.label], after[place.label], colour)
        limit = 1.1 * max(abs(v) for ax in axes[1] for v in ax.get_ylim())
        for ax in axes[1]:
            ax.set_ylim(-limit, limit)
            ax.set_xlabel("time [s]")
        axes[0, 0].set_ylabel("temperature [°C]")
        axes[1, 0].set_ylabel("measured − sim. [K]")
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


def _draw_place(axes: Any, fitted: RunFit, place: Place, before: Array, after: Array, colour: str) -> None:
    top, low = axes
    signals = fitted.problem.signals
    t = signals.time_s
    present = np.where(fitted.problem.rows > 0, 1.0, np.nan)
    cells = np.stack([signals.cells[c] for c in place.columns], axis=1)
    for ax in axes:
        if np.isfinite(fitted.closed_s):
            end = fitted.opened_s if np.isfinite(fitted.opened_s) else t[-1]
            ax.axvspan(fitted.closed_s, end, color=CLOSED_SHADE, zorder=0, lw=0)
    picked = np.flatnonzero(np.isfinite(place.mean * present))
    picked = picked[:: max(1, len(picked) // 60)]
    spread = np.array([np.nanstd(cells[k]) if np.isfinite(cells[k]).sum() > 1 else 0.0 for k in picked])
    label = f"measured, mean of {len(place.columns)} ± sd" if len(place.columns) > 1 else "measured"
    top.errorbar(t[picked], place.mean[picked], spread, fmt="o", ms=2.6, lw=0.8, color=INK, label=label, zorder=3)
    top.plot(t, before * present, ls=(0, (4, 3)), lw=1.2, color=MUTED, label="simulated before", zorder=2)
    top.plot(t, after * present, lw=1.6, color=colour, label="simulated after", zorder=4)
    top.set_title(_place_name(place.label))
    top.legend(loc="best", fontsize=8)
    offset = float(np.nanmean((place.mean - after) * present))
    band = _scatter(cells)
    residual = (place.mean - after - offset) * present
    low.fill_between(t, residual - band, residual + band, color=colour, alpha=0.18, lw=0)
    low.plot(t, residual, lw=0.9, color=colour)
    low.axhline(0.0, color=MUTED, lw=0.8)
    calm = np.abs(residual[np.isfinite(residual)])
    reach = max(0.5, 1.3 * float(np.percentile(calm, 98.5))) if len(calm) else 1.0
    low.set_ylim(-reach, reach)
    if len(calm) and calm.max() > reach:
        k = int(np.nanargmax(np.abs(residual)))
        words = f"{residual[k]:+.1f} K at {t[k]:.1f} s"
        low.text(0.99, 0.96, words, transform=low.transAxes, ha="right", va="top", fontsize=7.5, color=MUTED)


def _scatter(cells: Array) -> Array:
    """Standard deviation over channels in each row, their own offsets removed. [K]"""
    good = np.isfinite(cells)
    offsets = np.where(good, cells, 0.0).sum(axis=0) / np.maximum(good.sum(axis=0), 1)
    centred = np.where(good, cells - offsets, 0.0)
    count = np.maximum(good.sum(axis=1), 1)
    mean = centred.sum(axis=1) / count
    squares = (np.where(good, centred - mean[:, None], 0.0) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(squares / count))


def _place_name(label: str) -> str:
    layer, _, place = label.rpartition(".")
    names = {"top": "upper face", "bottom": "lower face", "middle": "middle"}
    return f"{layer}, {names[place]}" if place in names and layer else label


def coefficients_figure(campaign: CampaignFit) -> Figure:
    """Every run's coefficients with their intervals, mean and spread: one panel each."""
    names = list(campaign.coefficients)
    columns = min(3, max(len(names), 1))
    rows = -(-len(names) // columns)
    with rc_context(dict(STYLE)):
        figure = Figure(figsize=(10.0, 2.4 * rows + 0.5), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
        figure.suptitle(_campaign_title(campaign), x=0.01, ha="left", color=INK, weight="bold")
        for ax, name in zip(axes.flat, names, strict=False):
            _draw_coefficient(ax, campaign, name)
        for ax in axes.flat[len(names) :]:
            ax.set_axis_off()
        for ax in axes[-1]:
            ax.set_xlabel("run")
    return figure


def _campaign_title(campaign: CampaignFit) -> str:
    total = len(campaign.met)
    if not total:
        return "No coefficient is known: the model does not describe what was measured"
    if len(campaign.runs) == 1:
        told = [n for n, c in campaign.coefficients.items() if c.runs]
        return f"Known from {campaign.runs[0].run}: {', '.join(told) or 'none of the coefficients'}"
    full = [n for n, c in campaign.coefficients.items() if c.runs == total]
    known = "all coefficients" if len(full) == len(campaign.coefficients) else (", ".join(full) or "none")
    worst = max(campaign.coefficients.values(), key=lambda c: c.spread)
    return f"{total} runs: {known} known from every run; spread from run to run up to {100 * worst.spread:.0f} %"


def _draw_coefficient(ax: Any, campaign: CampaignFit, name: str) -> None:
    c = campaign.coefficients[name]
    shared = name in campaign.shared
    spread = f" ± {plain(c.sd, 2)}" if np.isfinite(c.sd) and not shared else ""
    ax.set_title(f"{name} = {plain(c.mean, 3)}{spread} W/m²K{', shared' if shared else ''}")
    if np.isfinite(c.sd):
        ax.axhspan(c.mean - c.sd, c.mean + c.sd, color="#dfeaf4", lw=0, zorder=0)
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


def normalised_figure(campaign: CampaignFit) -> Figure:
    """All coefficients over their means, side by side: which differ from run to run, and how much."""
    names = list(campaign.coefficients)
    with rc_context(dict(STYLE)):
        figure = Figure(figsize=(10.0, 3.3), layout="constrained")
        ax = figure.subplots()
        spreads = {n: c.spread for n, c in campaign.coefficients.items()}
        most = max(spreads, key=lambda n: spreads[n])
        figure.suptitle(
            f"Relative to the mean: {most} differs most from run to run ({100 * spreads[most]:.0f} %)",
            x=0.01, ha="left", color=INK, weight="bold",
        )  # fmt: skip
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
        ax.set_ylabel("value / mean")
        ax.set_ylim(0.0, max(2.0, ax.get_ylim()[1]))
    return figure


def strongest(fitted: RunFit) -> tuple[int, int, float]:
    """Return the coefficient and the other unknown that move together most, and their correlation."""
    matrix = np.abs(fitted.correlation) * (1.0 - np.eye(len(fitted.names)))
    rows = [i for i, name in enumerate(fitted.names) if is_parameter(name)]
    row, j = np.unravel_index(np.argmax(matrix[rows]), matrix[rows].shape)
    i = rows[int(row)]
    return i, int(j), float(fitted.correlation[i, j])


def correlation_figure(fitted: RunFit) -> Figure:
    """Which unknowns of a run move together."""
    names = list(fitted.names)
    matrix = np.where(np.eye(len(names)) > 0, np.nan, fitted.correlation)
    i, j, value = strongest(fitted)
    with rc_context(dict(STYLE)):
        figure = Figure(figsize=(7.4, 6.2), layout="constrained")
        ax = figure.subplots()
        image = ax.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
        ax.set_xticks(range(len(names)), names, rotation=90)
        ax.set_yticks(range(len(names)), names)
        ax.grid(False)
        ax.set_title(f"{fitted.run}: {names[i]} moves most with {names[j]} ({value:+.2f})")
        figure.colorbar(image, ax=ax, shrink=0.7, label="correlation")
    return figure


def roughness_figure(found: Reproduction) -> Figure:
    """Draw the cost along one coefficient for an adaptive and for the exact solver."""
    percent = 100.0 * (found.relative - 1.0)
    with rc_context(dict(STYLE)):
        figure = Figure(figsize=(8.0, 3.6), layout="constrained")
        ax = figure.subplots()
        figure.suptitle(
            "Adaptive steps make the cost rough: differences measure the steps, not the slope",
            x=0.01, ha="left", color=INK, weight="bold",
        )  # fmt: skip
        ax.plot(percent, found.adaptive, "o-", ms=2.5, lw=0.9, color=COLOURS[0], label="adaptive solver")
        ax.plot(percent, found.exact, lw=1.8, color=COLOURS[1], label="exact solver")
        ax.set_xlabel(f"{found.coefficient} from its best value [%]")
        ax.set_ylabel("weighted cost per value, from its minimum")
        ax.legend()
    return figure
