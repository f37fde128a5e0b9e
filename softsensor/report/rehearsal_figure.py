"""The figure of a rehearsal: how often each hidden cause is found, and another one named."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from daq.words import say
from daq.words.message import ENGLISH, words
from softsensor.diagnosis.rehearsal import Rate, Rehearsal
from softsensor.report.fit_figures import COLOURS, legend_below, sheet
from softsensor.report.rehearsal_rows import rehearsal_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LABELS = ("rehearsal-found", "rehearsal-wrong")
"""Of what is drawn for each cause."""


def rehearsal_figure(found: Rehearsal, language: str = ENGLISH) -> Figure:
    """Draw the share of campaigns that find each cause and that name another, with 95 % intervals."""
    put = partial(words, language=language)
    names = [" ".join(put(cell) for cell in row.cells[:2]).strip() for row in rehearsal_rows(found)]
    names.append(put(say("figure-rehearsal-nothing")))
    size = (8.0, 1.8 + 0.5 * len(names))
    with sheet(size, language, say("rehearsal-heading")) as figure:
        ax = figure.subplots()
        rates = [(row.found, row.wrong) for row in found.rows]
        for number, label in enumerate(LABELS):
            drawn = [(at, pair[number]) for at, pair in enumerate(rates)]
            if number:  # where nothing is hidden, whatever is named is wrong
                drawn.append((len(rates), found.nothing))
            _draw(ax, [(at + (number - 0.5) / 4, rate) for at, rate in drawn if rate.of], number, put(say(label)))
        ax.set_yticks(range(len(names)), names)
        ax.set_ylim(len(names) - 0.5, -0.5)
        ax.set_xlim(-2.0, 102.0)
        ax.set_xlabel(put(say("figure-rehearsal-share")))
        legend_below(figure, len(LABELS), frameon=False)
    return figure


def _draw(ax: Axes, rates: Sequence[tuple[float, Rate]], number: int, label: str) -> None:
    """Draw shares at their heights, each with its interval. [%]"""
    share = [100.0 * rate.share for _, rate in rates]
    low, high = ([100.0 * abs(rate.ci95[end] - rate.share) for _, rate in rates] for end in (0, 1))
    heights = [at for at, _ in rates]
    ax.errorbar(share, heights, xerr=[low, high], label=label, fmt="os"[number], ms=5, color=COLOURS[1 - number])
