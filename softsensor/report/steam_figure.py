"""The figure of the steam that panels bear."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from daq.words import say
from daq.words.message import ENGLISH, words
from softsensor.opening.blisters import LearnedLimit, limit_messages
from softsensor.report.fit_figures import COLOURS, INK, sheet

if TYPE_CHECKING:
    import pandas as pd


def steam_figure(found: LearnedLimit, chance: pd.Series, language: str = ENGLISH) -> Figure:
    """Draw the chance of a blister over steam [kPa], and what half of the panels bear with its interval."""
    put = partial(words, language=language)
    _, bear, *_ = limit_messages(found)
    with sheet((7.2, 4.0), language, bear) as figure:
        ax = figure.subplots()
        ax.plot(chance.index, 100.0 * chance, color=COLOURS[0], lw=2.0)
        ax.axvspan(*found.ci95_kPa, color=COLOURS[0], alpha=0.12, lw=0)
        ax.axvline(found.most_kPa, color=INK, lw=0.8, ls=":")
        ax.set_xlabel(put(say("figure-steam")))
        ax.set_ylabel(put(say("figure-blister-chance")))
    return figure
