"""The figure of an advice: press time against risk."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from daq.records import Array
from daq.words import say
from daq.words.message import ENGLISH, words
from softsensor.planning.advise import ProgrammeAdvice, TriedProgramme
from softsensor.planning.summary import advice_title
from softsensor.report.fit_figures import COLOURS, INK, MUTED, legend_below, sheet

_SHOWN_PERCENT = (0.1, 100.0)
"""Least and largest chance shown: below the least no limit of probability is set."""


def advice_figure(found: ProgrammeAdvice, language: str = ENGLISH) -> Figure:
    """Chance that a limit is broken, over press time: at the best platens also by limit, at the others thin."""
    put = partial(words, language=language)
    mine, others = found.nearest, [tried for tried in found.tried if tried is not found.nearest]
    with sheet((7.2, 4.8), language, advice_title(found)) as figure:
        ax = figure.subplots()
        platens = [tried.programme.platen_C for tried in others]
        for k, tried in enumerate(others):
            label = None if k else put(say("figure-advice-others", low=min(platens), high=max(platens)))
            ax.plot(tried.press_time_s, _percent(tried), lw=0.7, color=MUTED, label=label)
        label = put(say("figure-advice-any", platen=mine.programme.platen_C))
        ax.plot(mine.press_time_s, _percent(mine), lw=2.0, color=INK, label=label)
        for colour, (name, chance) in zip(COLOURS * 2, mine.broken.chances.items(), strict=False):
            ax.plot(
                mine.press_time_s,
                100.0 * chance,
                "--",
                lw=1.2,
                color=colour,
                label=put(say(f"advise-limit-{name}")),
            )
        ax.axhline(100.0 * (1.0 - found.wish.limits.probability), color=MUTED, lw=0.8, ls=":")
        if found.best is not None:
            ax.axvline(found.best.opening.in_s, color=INK, lw=0.8, ls=":")
        ax.set_yscale("log")
        ax.set_ylim(_SHOWN_PERCENT[0], 1.1 * _SHOWN_PERCENT[1])
        ax.yaxis.set_major_formatter("{x:g}")
        ax.set_xlim(0.0, 1.05 * max(map(_last_shown_s, found.tried)))
        ax.set_xlabel(put(say("figure-advice-press-time")))
        ax.set_ylabel(put(say("figure-advice-risk")))
        legend_below(figure, 2, frameon=False)
    return figure


def _percent(tried: TriedProgramme) -> Array:
    return 100.0 * np.broadcast_to(tried.broken.risk, tried.press_time_s.shape)


def _last_shown_s(tried: TriedProgramme) -> float:
    """Return the last press time with a chance that is shown. [s]"""
    shown = tried.press_time_s[_percent(tried) >= _SHOWN_PERCENT[0]]
    return float(shown[-1] if len(shown) else tried.press_time_s[-1])
