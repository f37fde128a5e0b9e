"""Figures of a diagnosis: one run under both models, residuals of all runs, and each run's vote."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from daq.records import Array
from daq.words import Message, say
from daq.words.message import ENGLISH, words
from softsensor.effects.vocabulary import called, place_words
from softsensor.report.fit_figures import CLOSED_SHADE, COLOURS, INK, MUTED, Put, legend_below, sheet, svg

PLAIN, EXTENDED = "#8a94a0", "#c2571a"
Curves = Mapping[str, Any]
"""As `softsensor.diagnosis.curves` makes them."""


def worst_run_figure(curves: Curves, language: str = ENGLISH) -> Figure:
    """The run that the plain model fits worst: readings, both models, core, residuals."""
    put = partial(words, language=language)
    places, time, core = curves["places"], _array(curves["time_s"]), curves["core"]
    drawn = [("plain", PLAIN, say("figure-plain"))]
    if curves["core"]["extended_C"] is not None:
        drawn.append(("extended", EXTENDED, say("figure-extended")))
    with sheet((10.0, 5.8), language, _run_title(curves)) as figure:
        axes = figure.subplots(2, len(places), sharex=True, squeeze=False, height_ratios=[3, 1.5])
        for j, place in enumerate(places):
            top, low = axes[0, j], axes[1, j]
            top.set_title(put(place_words(place["place"])), color=MUTED)
            _shade(top, curves)
            _shade(low, curves)
            _mark(low, curves, place["place"], put)
            reach = {"color": MUTED, "alpha": 0.25, "lw": 0, "label": put(say("figure-channels"))}
            top.fill_between(time, _array(place["low_C"]), _array(place["high_C"]), **reach, zorder=1)
            measured = {"ms": 3.5, "color": INK, "label": put(say("figure-mean"))}
            top.plot(time, _array(place["measured_C"]), ".", **measured, zorder=2)
            for key, colour, model in drawn:
                label, core_label = put(say("figure-model", model=model)), put(say("figure-core", model=model))
                top.plot(time, _array(place[f"{key}_C"]), color=colour, lw=1.3, label=label)
                top.plot(time, _array(core[f"{key}_C"]), color=colour, lw=1.0, ls="--", label=core_label)
                residual = _array(place[f"{key}_residual_K"])
                low.plot(time, residual, ".-", ms=2.5, lw=0.8, color=colour, label=put(model))
            for values in core["measured_C"].values():
                label = put(say("figure-core-measured"))
                top.plot(time, _array(values), "x", ms=3, color=COLOURS[1], label=label)
            low.axhline(0.0, color=MUTED, lw=0.6)
            low.set_xlabel(put(say("figure-time")))
        every = np.abs(np.concatenate([_array(p["plain_residual_K"]) for p in places]))
        reach_K = 1.15 * max(float(np.nanpercentile(every, 98)), 0.2)
        for ax in axes[1]:
            ax.set_ylim(-reach_K, reach_K)
        axes[0, 0].set_ylabel(put(say("figure-temperature")))
        axes[1, 0].set_ylabel(put(say("figure-measured-minus-model")))
        legend_below(figure, 4, *axes[0, -1].get_legend_handles_labels())
    return figure


def _array(values: list[float | None]) -> Array:
    return np.array([np.nan if v is None else v for v in values])


def _run_title(curves: Curves) -> Message:
    run, rms = curves["run"], curves["rmse_K"]
    if len(rms) < 2:
        return say("figure-worst-run", run=run, rms=rms[0])
    causes = tuple(called(n) for n in curves["causes"])
    return say("figure-worst-run-extended", run=run, before=rms[0], after=rms[-1], causes=causes)


def _shade(ax: Any, curves: Curves) -> None:
    if curves["closed_s"] is not None and curves["opened_s"] is not None:
        ax.axvspan(curves["closed_s"], curves["opened_s"], color=CLOSED_SHADE, zorder=0, lw=0)


def _mark(ax: Any, curves: Curves, place: str, put: Put) -> None:
    """Shade where the plain model is most kelvins off in all runs, with what this run measured there."""
    for line, mark in enumerate(m for m in curves["marks"] if m["place"] == place):
        begin, end = mark["from_s"], mark["to_s"]
        ax.axvspan(begin, end, color="#f6e3d7", zorder=0.5, lw=0)
        ax.text(
            (begin + end) / 2,
            0.97 - 0.17 * line,
            put(Message.from_json(mark["said"])),
            transform=ax.get_xaxis_transform(),
            ha="center",
            va="top",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
            zorder=5,
        )


def residual_figure(curves: Curves, language: str = ENGLISH) -> Figure:
    """Residuals of all runs over time since closing, or since they began: grey before, coloured after."""
    put = partial(words, language=language)
    models = [put(say("figure-model", model=model)) for model in (say("figure-plain"), say("figure-extended"))]
    campaign = curves["campaign"]
    places, since = campaign["places"], _array(campaign["since_s"])
    with sheet((10.0, 3.4), language, say("figure-residuals")) as figure:
        axes = figure.subplots(1, len(places), sharey=True, squeeze=False)[0]
        for ax, place in zip(axes, places, strict=True):
            ax.set_title(put(place_words(place["place"])), color=MUTED)
            for key, colour, label in (("plain_K", PLAIN, models[0]), ("extended_K", EXTENDED, models[1])):
                if place[key] is not None:
                    _residual_lines(ax, since, np.array([_array(row) for row in place[key]]), (colour, label))
            ax.axhline(0.0, color=INK, lw=0.6)
            ax.set_xlim(since[0], since[-1])
            ax.set_xlabel(put(say("figure-since-closing" if campaign["closes"] else "figure-since-beginning")))
        axes[0].set_ylabel(put(say("figure-measured-minus-model")))
        every = np.abs(np.concatenate([_array(row) for place in places for row in place["plain_K"]]))
        reach = 1.2 * max(float(np.nanpercentile(every, 97)), 0.2)
        axes[0].set_ylim(-reach, reach)
        axes[-1].legend(loc="upper right")
    return figure


def _residual_lines(ax: Any, since: Array, table: Array, drawn: tuple[str, str]) -> None:
    """Draw every run's residuals (runs, times), and their mean where half of the runs have one."""
    colour, label = drawn
    ax.plot(since, table.T, lw=0.5, color=colour, alpha=0.35)
    enough = np.isfinite(table).sum(axis=0) >= max(min(2, len(table)), len(table) / 2)
    if enough.any():
        ax.plot(since[enough], np.nanmean(table[:, enough], axis=0), lw=2.0, color=colour, label=label)


def votes_figure(curves: Curves, language: str = ENGLISH) -> Figure | None:
    """How much each run, left out, gains by the named cause and by its rivals."""
    put, rivals = partial(words, language=language), curves["votes"]
    if not rivals:
        return None
    names = curves["campaign"]["runs"]
    for_it = int((_array(rivals[0]["gains"]) > 0).sum())
    title = say("figure-votes", better=for_it, runs=len(names), cause=called(rivals[0]["cause"]))
    with sheet((10.0, 3.2), language, title) as figure:
        ax = figure.subplots()
        colours = (EXTENDED, *COLOURS[1:], MUTED)
        for k, rival in enumerate(rivals):
            gains = _array(rival["gains"])
            x = np.arange(len(gains)) + 0.8 * (k - (len(rivals) - 1) / 2) / len(rivals)
            label = put(called(rival["cause"]))
            ax.bar(x, gains, width=0.8 / len(rivals), color=colours[k % len(colours)], label=label)
        ax.set_xticks(range(len(names)), names, rotation=35, ha="right")
        ax.set_yscale("symlog", linthresh=10.0)
        ax.set_axisbelow(True)
        ax.yaxis.set_major_formatter("{x:g}")
        ax.set_ylabel(put(say("figure-misfit-saved")))
        legend_below(figure, 3, *ax.get_legend_handles_labels())
    return figure


def law_figure(law: Mapping[str, Any] | None, language: str = ENGLISH) -> Figure | None:
    """What is missing as a free function, as the contract's JSON has it, with its 95 % band."""
    put = partial(words, language=language)
    if law is None:
        return None
    x, value, low, high = np.array(law["curve"], dtype=float).T
    with sheet((10.0, 3.2), language, say(f"law-kind-{law['kind']}")) as figure:
        ax = figure.subplots()
        ax.fill_between(x, low, high, color=EXTENDED, alpha=0.2, lw=0.0)
        ax.plot(x, value, color=EXTENDED, lw=1.4)
        ax.axhline(1.0 if law["unit"] == "-" else 0.0, color=MUTED, lw=0.6)
        ax.set_xlabel(put(say(f"law-axis-{law['variable']}")))
        ax.set_ylabel(law["unit"].replace("m3", "m³").replace("-", ""))
    return figure


def diagnosis_pictures(curves: Curves, law: Mapping[str, Any] | None, language: str = ENGLISH) -> dict[str, str]:
    """Return every picture of a diagnosis as SVG text by its name; empty where there is nothing to draw."""
    figures = {
        "run_svg": worst_run_figure(curves, language),
        "residual_svg": residual_figure(curves, language),
        "law_svg": law_figure(law, language),
        "votes_svg": votes_figure(curves, language),
    }
    return {name: "" if figure is None else svg(figure) for name, figure in figures.items()}
