"""Figures of a diagnosis: one run under both models, residuals of all runs, and each run's vote."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from daq.records import Array
from softsensor.diagnosis import Diagnosis
from softsensor.diagnosis_search import Stage
from softsensor.diagnosis_tests import inside
from softsensor.diagnosis_where import stretches, where_row
from softsensor.diagnosis_words import temperatures
from softsensor.figures import COLOURS, INK, MUTED, STYLE
from softsensor.vocabulary import place_words, readable

PLAIN, EXTENDED = "#8a94a0", "#c2571a"
MARKED = 3
"""Stretches shaded where the plain model is most kelvins off."""


def run_figure(found: Diagnosis) -> Figure:
    """The run the plain model meets worst: readings, both models, core, residuals."""
    plain, final = found.stages[0], found.final
    worst = int(np.argmax([np.nanmean(r.misfit**2) for r in plain.fit.runs]))
    digest = plain.data[worst].digest
    a, b = plain.fit.runs[worst], final.fit.runs[worst]
    extended = len(found.stages) > 1
    with rc_context(dict(STYLE)):
        figure = Figure(figsize=(10.0, 5.8), layout="constrained")
        axes = figure.subplots(2, len(digest.signals), sharex=True, squeeze=False, height_ratios=[3, 1.5])
        figure.suptitle(_run_title(found, worst), x=0.01, ha="left", color=INK, weight="bold")
        for j, signal in enumerate(digest.signals):
            top, low = axes[0, j], axes[1, j]
            top.set_title(place_words(signal), color=MUTED)
            _shade(top, found, worst)
            _shade(low, found, worst)
            _mark(low, found, worst, signal)
            for c in digest.channels[signal]:
                top.plot(digest.run.time_s, digest.run.columns[c], ".", ms=1.2, color="#b9c2cc", zorder=1)
            top.plot(digest.time, digest.y[:, j], ".", ms=3.5, color=INK, label="measured (mean)", zorder=2)
            top.plot(digest.time, (a.model + a.shift)[:, j], color=PLAIN, lw=1.3, label="plain model")
            top.plot(digest.time, a.core, color=PLAIN, lw=1.0, ls="--", label="core, plain")
            low.plot(digest.time, a.misfit[:, j], ".-", ms=2.5, lw=0.8, color=PLAIN, label="plain")
            if extended:
                top.plot(digest.time, (b.model + b.shift)[:, j], color=EXTENDED, lw=1.3, label="extended model")
                top.plot(digest.time, b.core, color=EXTENDED, lw=1.0, ls="--", label="core, extended")
                low.plot(digest.time, b.misfit[:, j], ".-", ms=2.5, lw=0.8, color=EXTENDED, label="extended")
            for values in digest.cores.values():
                top.plot(digest.time, values, "x", ms=3, color=COLOURS[1], label="core, measured")
            low.axhline(0.0, color=MUTED, lw=0.6)
            low.set_xlabel("time [s]")
        reach = 1.15 * max(float(np.nanpercentile(np.abs(a.misfit), 98)), 0.2)
        for ax in axes[1]:
            ax.set_ylim(-reach, reach)
        axes[0, 0].set_ylabel("temperature [°C]")
        axes[1, 0].set_ylabel("measured − model [K]")
        figure.legend(*axes[0, -1].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=7.5)
    return figure


def _run_title(found: Diagnosis, run: int) -> str:
    name = found.stages[0].data[run].digest.run.name

    def rms(stage: Any) -> float:
        return float(np.sqrt(np.nanmean(stage.fit.runs[run].misfit ** 2)))

    before = rms(found.stages[0])
    if len(found.stages) < 2:
        return f"{name}, the run met worst: the plain model is {before:.2f} K off (rms of place means)"
    return f"{name}: {before:.2f} K off with the plain model, {rms(found.final):.2f} K with {_names(found)}"


def _names(found: Diagnosis) -> str:
    return " and ".join(readable(n) for n in found.final.effects)


def _shade(ax: Any, found: Diagnosis, run: int) -> None:
    m = found.stages[0].data[run].digest.moments
    if np.isfinite(m.closed_s) and np.isfinite(m.opened_s):
        ax.axvspan(m.closed_s, m.opened_s, color="#eef2f6", zorder=0, lw=0)


def _mark(ax: Any, found: Diagnosis, run: int, signal: str) -> None:
    """Shade where the plain model is most kelvins off in all runs, with what this run measured there."""
    plain = found.stages[0]
    digest = plain.data[run].digest
    worst = stretches([white.digest for white in plain.data], [r.misfit for r in plain.fit.runs])[:MARKED]
    for line, p in enumerate(p for p in worst if p.signal == signal):
        rows = inside(digest, p.phase, p.from_s, p.to_s)
        if rows.any():
            times, half = digest.time[rows], digest.width[rows] / 2
            ax.axvspan(times[0] - half[0], times[-1] + half[-1], color="#f6e3d7", zorder=0.5, lw=0)
            at = (float(times.mean()), 0.97 - 0.13 * line)
            told = temperatures(where_row(p, [digest]))
            ax.text(
                *at,
                told,
                transform=ax.get_xaxis_transform(),
                ha="center",
                va="top",
                size=6.5,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
                zorder=5,
            )


def residual_figure(found: Diagnosis) -> Figure:
    """Residuals of all runs over time since closing, or since they began: grey before, coloured after."""
    digests = [white.digest for white in found.stages[0].data]
    signals = digests[0].signals
    closes = any(np.isfinite(d.moments.closed_s) for d in digests)
    span = (-20.0, 160.0) if closes else (0.0, max(float(d.time[-1] - d.time[0]) for d in digests))
    with rc_context(dict(STYLE)):
        figure = Figure(figsize=(10.0, 3.4), layout="constrained")
        axes = figure.subplots(1, len(signals), sharey=True, squeeze=False)[0]
        for ax, signal in zip(axes, signals, strict=True):
            ax.set_title(place_words(signal), color=MUTED)
            _residual_lines(ax, found.stages[0], signal, span, (PLAIN, "plain model"))
            if len(found.stages) > 1:
                _residual_lines(ax, found.final, signal, span, (EXTENDED, "extended model"))
            ax.axhline(0.0, color=INK, lw=0.6)
            ax.set_xlabel("time since closing [s]" if closes else "time since the beginning [s]")
        axes[0].set_ylabel("measured − model [K]")
        every = np.concatenate([np.abs(r.misfit[np.isfinite(r.misfit)]) for r in found.stages[0].fit.runs])
        reach = 1.2 * max(float(np.percentile(every, 97)), 0.2)
        axes[0].set_ylim(-reach, reach)
        axes[-1].legend(loc="upper right", fontsize=7.5)
        title = "What all runs have in common is what the model lacks"
        figure.suptitle(title, x=0.01, ha="left", color=INK, weight="bold")
    return figure


def _residual_lines(ax: Any, stage: Stage, signal: str, span: tuple[float, float], drawn: tuple[str, str]) -> None:
    colour, label = drawn
    grid = np.concatenate([np.arange(span[0], 0.0, 2.0), np.geomspace(0.5, span[1], 60)])
    lines: list[Array] = []
    for white, run in zip(stage.data, stage.fit.runs, strict=True):
        d = white.digest
        if signal not in d.signals:
            continue
        start = d.moments.closed_s if np.isfinite(d.moments.closed_s) else d.time[0]
        values = run.misfit[:, d.signals.index(signal)]
        good = np.isfinite(values)
        ax.plot(d.time[good] - start, values[good], lw=0.5, color=colour, alpha=0.35)
        line = np.interp(grid, d.time[good] - start, values[good], left=np.nan, right=np.nan)
        lines.append(line)
    table = np.array(lines)
    enough = np.isfinite(table).sum(axis=0) >= max(min(2, len(table)), len(table) / 2)
    if enough.any():
        ax.plot(grid[enough], np.nanmean(table[:, enough], axis=0), lw=2.0, color=colour, label=label)
    ax.set_xlim(*span)


def votes_figure(found: Diagnosis) -> Figure | None:
    """How much each run, left out, gains by the named cause and by its rivals."""
    rivals = found.rivals
    if not rivals:
        return None
    with rc_context(dict(STYLE)):
        figure = Figure(figsize=(10.0, 3.2), layout="constrained")
        ax = figure.subplots()
        colours = (EXTENDED, *COLOURS[1:], MUTED)
        for k, (name, gains) in enumerate(rivals):
            x = np.arange(len(gains)) + 0.8 * (k - (len(rivals) - 1) / 2) / len(rivals)
            label = readable(name)
            ax.bar(x, gains, width=0.8 / len(rivals), color=colours[k % len(colours)], label=label)
        names = [white.digest.run.name for white in found.stages[0].data]
        ax.set_xticks(range(len(names)), names, rotation=35, ha="right", fontsize=7.5)
        ax.set_yscale("symlog", linthresh=10.0)
        ax.set_axisbelow(True)
        ax.yaxis.set_major_formatter("{x:g}")
        ax.set_ylabel("misfit saved [variances of the noise]")
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7.5)
        for_it = int((rivals[0][1] > 0).sum())
        title = (
            f"{for_it} of {len(names)} runs, each left out in turn, are met better with {readable(rivals[0][0])}"
        )
        figure.suptitle(title, x=0.01, ha="left", color=INK, weight="bold")
    return figure
