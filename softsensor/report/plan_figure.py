"""The figure of a plan: what a pressing of each kind is worth to each open point."""

from __future__ import annotations

import re
import textwrap
from functools import partial
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter, SymmetricalLogLocator

from daq.printed import LINE
from daq.words import say
from daq.words.message import ENGLISH, words
from softsensor.planning.plan import PressingPlan
from softsensor.planning.summary import point_message
from softsensor.report.fit_figures import COLOURS, legend_below, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plan_figure(found: PressingPlan, language: str = ENGLISH) -> Figure:
    """Draw a bar a pressing for each open point, the most open on top."""
    put = partial(words, language=language)
    kinds = ("best", "with_core", "repeated")
    bar = 1.0 / (len(kinds) + 1)  # with a gap of one between points
    with sheet((8.0, 1.8 + 0.8 * len(found.points)), language, say("figure-worth-of-pressing")) as figure:
        ax = figure.subplots()
        for number, kind in enumerate(kinds):
            pressings = [(at, getattr(advice, kind)) for at, advice in enumerate(found.points)]
            bars = [(at + (number - 1) * bar, one.prospect.worth) for at, one in pressings if one is not None]
            if bars:
                label = put(say(f"figure-plan-{kind.replace('_', '-')}"))
                places, worth = zip(*bars, strict=True)
                ax.barh(places, worth, height=bar, color=COLOURS[number], label=label)
        names = [_label(put(point_message(advice.point))) for advice in found.points]
        ax.set_yticks(range(len(names)), names)
        ax.invert_yaxis()
        _scale_worth(ax)
        ax.set_axisbelow(True)
        ax.set_xlabel(put(say("figure-worth")))
        if names:
            legend_below(figure, len(kinds), frameon=False)
    return figure


def _label(words: str) -> str:
    """Return words in short lines, none of which ends between a number and its unit."""
    return textwrap.fill(re.sub(r"(?<=\d) (?=[K%])", "\N{NO-BREAK SPACE}", words), LINE // 3)


def _scale_worth(ax: Axes) -> None:
    """Draw less than a nat in proportion, more by decades: a cause is worth hundreds, a coefficient tenths."""
    linear = 1.0
    if ax.dataLim.xmax <= linear:
        return
    ax.set_xscale("symlog", linthresh=linear)
    ax.xaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=linear, subs=(1, 2, 5)))
    ax.xaxis.set_major_formatter(ScalarFormatter())
