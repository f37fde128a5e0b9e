"""The steam that panels bear, learned from what became of panels."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from daq.press.header import BLISTER, GOOD, VERDICT
from daq.press.resin_file import Resin
from daq.records import InputError, PressState
from daq.words import say
from daq.words.message import chosen
from softsensor.face.inputs import read_press, resin_of, runs_of
from softsensor.face.models import read_model
from softsensor.face.predicting import predict
from softsensor.face.showing import lines_html, printed, shown
from softsensor.opening.blisters import LearnedLimit, believed_limit, learn_limit, limit_messages
from softsensor.opening.limits import Normal

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from softsensor.face.kinds import AnyModel, AnyPress, AnyRun


DRAWN = np.linspace(0.0, 2.0, 81)[1:]
"""Pressures at which the chance of a blister is given, over what half of the panels bear. By hand, 2026-11."""


class SteamLimit(LearnedLimit):
    r"""What is known of the steam that panels bear: weights of a grid. [kPa]

    A panel blisters where steam at opening exceeds what its bond bears, whose logarithm has mean m and scatter t;
    ln p is known to sd:

    $$P(\mathrm{blister}) = \Phi\left(\frac{\ln p - m}{\sqrt{t^2 + \mathrm{sd}^2}}\right)$$
    """

    def frame(self) -> pd.DataFrame:
        """Return the chance of a blister over the partial pressure of steam at opening. [kPa]"""
        import pandas as pd

        steam = self.most_kPa * DRAWN
        chance = self.chance(Normal(np.log(steam), np.zeros_like(steam)))
        return pd.DataFrame({"steam_kPa": steam, "blister_chance": chance}).set_index("steam_kPa")

    def plot(self) -> list[Axes]:
        """Draw the chance of a blister over steam, and what half of the panels bear; return the axes."""
        from softsensor.report.steam_figure import steam_figure

        return shown(steam_figure(self, self.frame()["blister_chance"], chosen()))

    def to_json(self) -> str:
        """Return what ``blisters --json`` writes."""
        return json.dumps(self.as_json())

    def __repr__(self) -> str:
        """Say what half of the panels bear, and what that rests on."""
        return printed([[line] for line in limit_messages(self)])

    def _repr_html_(self) -> str:
        return lines_html(limit_messages(self))


def learn_steam_limit(
    runs: Sequence[AnyRun], press: AnyPress, model: AnyModel | None = None, *, resin: Resin | Path | str
) -> SteamLimit:
    """Return the partial pressure of steam that panels bear, from runs marked ``good`` or ``blister``. [kPa]

    The mark is ``panel.verdict`` in a run's header, as the page and REST keep it; other marks say nothing of
    blisters. Runs are given in the order in which they were pressed, so that each is also foreseen by those before
    it (`SteamLimit.foreseen`). Steam is the live sensor's last before the press opened, with its band. What is
    believed before any mark is the resin file's ``steam_believed_kPa``, else its ``steam_most_kPa``, each with its
    ``sd``, else 100 kPa within a factor of two. What comes out can stand there, as ``steam_most_kPa``
    (`SteamLimit.most_kPa`) and its ``sd`` (`SteamLimit.sd_kPa`), with ``steam_believed_kPa`` beside it: then the
    marks count once when it is learned anew.

    Raises
    ------
    InputError
        As `predict`; and where no marked run states its panel's moisture and shows its steam at opening.

    Examples
    --------
    What is believed of steam falls where a panel blisters:

    >>> from daq import shared_files
    >>> from softsensor import read_run
    >>> shared = shared_files()
    >>> marked = {"panel.moisture_percent": 8.0, "panel.verdict": "blister"}
    >>> run = read_run(shared / "samples" / "2026-03-04-07.csv", header=marked)
    >>> resin = shared / "resins" / "melamine_formaldehyde.toml"
    >>> found = learn_steam_limit([run], shared / "presses" / "lab.toml", resin=resin)
    >>> found.blistered, found.most_kPa < found.believed[0]
    (1, True)
    """
    described, cures = read_press(press), resin_of(resin)
    known = None if model is None else read_model(model)
    marked = [run for run in runs_of(runs, described) if run.header.get(VERDICT) in (GOOD, BLISTER)]
    steam = [_at_opening(run, described, known, cures) for run in marked]
    read = Normal(np.array([float(one.mean) for one in steam]), np.array([float(one.sd) for one in steam]))
    if not np.isfinite(read.mean).any():
        raise InputError(say("steam-limit-no-marks", key=VERDICT, runs=len(marked)))
    blistered = np.array([run.header[VERDICT] == BLISTER for run in marked])
    found = learn_limit(read, blistered, *believed_limit(cures))
    return SteamLimit(**{one.name: getattr(found, one.name) for one in fields(found)})


def _at_opening(run: AnyRun, press: AnyPress, model: AnyModel | None, resin: Resin | None) -> Normal:
    """Return ln of the steam's pressure at the last scan before the press opened, NaN where it is not known."""
    estimates = predict(run, press, model, resin=resin).replayed.estimates
    leave = next((one.leave for one in reversed(estimates) if one.state is PressState.CLOSED), None)
    unknown = Normal(np.array(np.nan), np.array(np.nan))
    return unknown if leave is None or leave.panel is None else leave.panel.steam
