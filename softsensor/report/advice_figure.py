"""The figure of an advice: press time against risk."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from daq.words import say
from daq.words.message import ENGLISH, words
from softsensor.planning.advise import ProgrammeAdvice
from softsensor.planning.summary import advice_title
from softsensor.report.fit_figures import COLOURS, INK, MUTED, sheet


def advice_figure(found: ProgrammeAdvice, language: str = ENGLISH) -> Figure:
    """Chance that a limit is broken, over press time: at the best platens also by limit, at the others thin."""
    put = partial(words, language=language)
    allowed = 1.0 - found.wish.limits.probability
    with sheet((7.2, 4.4), language, advice_title(found)) as figure:
        ax = figure.subplots()
        for tried in found.tried:
            whole = np.broadcast_to(tried.broken.risk, tried.press_time_s.shape)
            mine = tried is found.nearest
            label = put(say("figure-advice-any", platen=tried.programme.platen_C)) if mine else None
            width, colour = (2.0, INK) if mine else (0.7, MUTED)
            ax.plot(tried.press_time_s, 100.0 * whole, lw=width, color=colour, label=label)
        for colour, (name, chance) in zip(COLOURS * 2, found.nearest.broken.chances.items(), strict=False):
            label = put(say(f"advise-limit-{name}"))
            ax.plot(found.nearest.press_time_s, 100.0 * chance, "--", lw=1.2, color=colour, label=label)
        ax.axhline(100.0 * allowed, color=MUTED, lw=0.8, ls=":")
        if found.best is not None:
            ax.axvline(found.best.opening.in_s, color=INK, lw=0.8, ls=":")
        ax.set_yscale("log")
        ax.set_ylim(0.1, 110.0)
        ax.set_xlabel(put(say("figure-advice-press-time")))
        ax.set_ylabel(put(say("figure-advice-risk")))
        ax.legend()
    return figure
