"""Figures of a diagnosis: one run under both models, residuals of all runs, and each run's vote."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from daq.records import Array
from daq.words import Message, say
from daq.words.message import ENGLISH, words
from softsensor.diagnosis.finding import Diagnosis
from softsensor.diagnosis.search import SettledModel
from softsensor.diagnosis.sign_flips import inside
from softsensor.diagnosis.where import stretches, temperatures, where_row
from softsensor.effects.vocabulary import called, place_words
from softsensor.report.fit_figures import COLOURS, INK, MUTED, Put, sheet

PLAIN, EXTENDED = "#8a94a0", "#c2571a"

# Numbers without another source were set by hand, 2026-11.

MARKED = 3
"""Stretches shaded where the plain model is most kelvins off."""


def run_figure(found: Diagnosis, language: str = ENGLISH) -> Figure:
    """The run that the plain model fits worst: readings, both models, core, residuals."""
    put = partial(words, language=language)
    plain, final = found.stages[0], found.final
    worst = int(np.argmax([np.nanmean(r.misfit**2) for r in plain.fit.runs]))
    digest = plain.data[worst].digest
    drawn = [(PLAIN, plain, say("figure-plain"))]
    if len(found.stages) > 1:
        drawn.append((EXTENDED, final, say("figure-extended")))
    with sheet((10.0, 5.8), put(_run_title(found, worst))) as figure:
        axes = figure.subplots(2, len(digest.signals), sharex=True, squeeze=False, height_ratios=[3, 1.5])
        for j, signal in enumerate(digest.signals):
            top, low = axes[0, j], axes[1, j]
            top.set_title(put(place_words(signal)), color=MUTED)
            _shade(top, found, worst)
            _shade(low, found, worst)
            _mark(low, found, (worst, signal), put)
            for c in digest.channels[signal]:
                top.plot(digest.run.time_s, digest.run.columns[c], ".", ms=1.2, color="#b9c2cc", zorder=1)
            top.plot(digest.time, digest.y[:, j], ".", ms=3.5, color=INK, label=put(say("figure-mean")), zorder=2)
            for colour, stage, model in drawn:
                run = stage.fit.runs[worst]
                label, core = put(say("figure-model", model=model)), put(say("figure-core", model=model))
                top.plot(digest.time, (run.model + run.shift)[:, j], color=colour, lw=1.3, label=label)
                top.plot(digest.time, run.core, color=colour, lw=1.0, ls="--", label=core)
                low.plot(digest.time, run.misfit[:, j], ".-", ms=2.5, lw=0.8, color=colour, label=put(model))
            for values in digest.cores.values():
                top.plot(digest.time, values, "x", ms=3, color=COLOURS[1], label=put(say("figure-core-measured")))
            low.axhline(0.0, color=MUTED, lw=0.6)
            low.set_xlabel(put(say("figure-time")))
        reach = 1.15 * max(float(np.nanpercentile(np.abs(plain.fit.runs[worst].misfit), 98)), 0.2)
        for ax in axes[1]:
            ax.set_ylim(-reach, reach)
        axes[0, 0].set_ylabel(put(say("figure-temperature")))
        axes[1, 0].set_ylabel(put(say("figure-measured-minus-model")))
        figure.legend(*axes[0, -1].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=7.5)
    return figure


def _run_title(found: Diagnosis, run: int) -> Message:
    name = found.stages[0].data[run].digest.run.name
    rms = [float(np.sqrt(np.nanmean(stage.fit.runs[run].misfit ** 2))) for stage in found.stages]
    if len(rms) < 2:
        return say("figure-worst-run", run=name, rms=rms[0])
    causes = tuple(called(n) for n in found.final.effects)
    return say("figure-worst-run-extended", run=name, before=rms[0], after=rms[-1], causes=causes)


def _shade(ax: Any, found: Diagnosis, run: int) -> None:
    m = found.stages[0].data[run].digest.moments
    if np.isfinite(m.closed_s) and np.isfinite(m.opened_s):
        ax.axvspan(m.closed_s, m.opened_s, color="#eef2f6", zorder=0, lw=0)


def _mark(ax: Any, found: Diagnosis, where: tuple[int, str], put: Put) -> None:
    """Shade where the plain model is most kelvins off in all runs, with what this run measured there."""
    plain, (run, signal) = found.stages[0], where
    digest = plain.data[run].digest
    worst = stretches([white.digest for white in plain.data], [r.misfit for r in plain.fit.runs])[:MARKED]
    for line, p in enumerate(p for p in worst if p.signal == signal):
        rows = inside(digest, p.phase, p.from_s, p.to_s)
        if rows.any():
            times, half = digest.time[rows], digest.width[rows] / 2
            ax.axvspan(times[0] - half[0], times[-1] + half[-1], color="#f6e3d7", zorder=0.5, lw=0)
            at = (float(times.mean()), 0.97 - 0.13 * line)
            ax.text(
                *at,
                put(temperatures(where_row(p, [digest]))),
                transform=ax.get_xaxis_transform(),
                ha="center",
                va="top",
                size=6.5,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
                zorder=5,
            )


def residual_figure(found: Diagnosis, language: str = ENGLISH) -> Figure:
    """Residuals of all runs over time since closing, or since they began: grey before, coloured after."""
    put = partial(words, language=language)
    models = [put(say("figure-model", model=model)) for model in (say("figure-plain"), say("figure-extended"))]
    digests = [white.digest for white in found.stages[0].data]
    signals = digests[0].signals
    closes = any(np.isfinite(d.moments.closed_s) for d in digests)
    span = (-20.0, 160.0) if closes else (0.0, max(float(d.time[-1] - d.time[0]) for d in digests))
    with sheet((10.0, 3.4), put(say("figure-residuals"))) as figure:
        axes = figure.subplots(1, len(signals), sharey=True, squeeze=False)[0]
        for ax, signal in zip(axes, signals, strict=True):
            ax.set_title(put(place_words(signal)), color=MUTED)
            _residual_lines(ax, found.stages[0], signal, span, (PLAIN, models[0]))
            if len(found.stages) > 1:
                _residual_lines(ax, found.final, signal, span, (EXTENDED, models[1]))
            ax.axhline(0.0, color=INK, lw=0.6)
            ax.set_xlabel(put(say("figure-since-closing") if closes else say("figure-since-beginning")))
        axes[0].set_ylabel(put(say("figure-measured-minus-model")))
        every = np.concatenate([np.abs(r.misfit[np.isfinite(r.misfit)]) for r in found.stages[0].fit.runs])
        reach = 1.2 * max(float(np.percentile(every, 97)), 0.2)
        axes[0].set_ylim(-reach, reach)
        axes[-1].legend(loc="upper right", fontsize=7.5)
    return figure


def _residual_lines(
    ax: Any, stage: SettledModel, signal: str, span: tuple[float, float], drawn: tuple[str, str]
) -> None:
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


def votes_figure(found: Diagnosis, language: str = ENGLISH) -> Figure | None:
    """How much each run, left out, gains by the named cause and by its rivals."""
    put, rivals = partial(words, language=language), found.rivals
    if not rivals:
        return None
    names = [white.digest.run.name for white in found.stages[0].data]
    for_it = int((rivals[0][1] > 0).sum())
    title = say("figure-votes", better=for_it, runs=len(names), cause=called(rivals[0][0]))
    with sheet((10.0, 3.2), put(title)) as figure:
        ax = figure.subplots()
        colours = (EXTENDED, *COLOURS[1:], MUTED)
        for k, (name, gains) in enumerate(rivals):
            x = np.arange(len(gains)) + 0.8 * (k - (len(rivals) - 1) / 2) / len(rivals)
            label = put(called(name))
            ax.bar(x, gains, width=0.8 / len(rivals), color=colours[k % len(colours)], label=label)
        ax.set_xticks(range(len(names)), names, rotation=35, ha="right", fontsize=7.5)
        ax.set_yscale("symlog", linthresh=10.0)
        ax.set_axisbelow(True)
        ax.yaxis.set_major_formatter("{x:g}")
        ax.set_ylabel(put(say("figure-misfit-saved")))
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=7.5)
    return figure


def law_figure(found: Diagnosis, language: str = ENGLISH) -> Figure | None:
    """What is missing as a free function, with its 95 % band."""
    put, law = partial(words, language=language), found.law
    if law is None:
        return None
    x, value, low, high = law.curve.T
    with sheet((10.0, 3.2), put(say(f"law-kind-{law.kind}"))) as figure:
        ax = figure.subplots()
        ax.fill_between(x, low, high, color=EXTENDED, alpha=0.2, lw=0.0)
        ax.plot(x, value, color=EXTENDED, lw=1.4)
        ax.axhline(1.0 if law.unit == "-" else 0.0, color=MUTED, lw=0.6)
        ax.set_xlabel(put(say(f"law-axis-{law.variable}")))
        ax.set_ylabel(law.unit.replace("m3", "m³").replace("-", ""))
    return figure
