"""The steam that a press's panels bear, learned from the marked ones as the live sensor saw them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from api.answers.kept import Kept
from api.answers.schemas import Blisters, MarkedPanel
from api.answers.words import message_answer
from daq.press.header import BLISTER, GOOD, VERDICT
from daq.press.resin_file import Resin
from daq.records import InputError
from daq.store.records import RunRecord, StoredEstimate, every
from daq.store.store import Store
from softsensor.signals.unknown import BAND

MOST = 300
"""Marked panels taken, the newest: so many leave of the limit's doubt 1/√300 of what one panel's own limit differs
by, 0.9 % of 15 %."""
CURVE_KPA = np.linspace(2.0, 300.0, 150)
"""Where the chance of a blister is given: up to three times what MDF bears. [kPa]"""
REMEMBERED = 30 * MOST
"""Panels whose steam is kept in memory, the last asked for: all that thirty presses show."""
_STEAM: Kept[tuple[str, str, int | None], tuple[float, float]] = Kept(REMEMBERED)


def blisters_of(store: Store, press: str, resin: Resin | None) -> Blisters:
    """Return the marked panels of a press and what they say of the steam that panels bear."""
    from softsensor.opening.blisters import believed_limit, learn_limit, limit_messages
    from softsensor.opening.limits import Normal

    runs = every(lambda at: store.runs(press=press, cursor=at, limit=500))
    marked = [run for run in runs if run.header.get(VERDICT) in (GOOD, BLISTER)][:MOST]
    steam = _steam_of(store, marked)
    log = np.array(steam).reshape(-1, 2)
    burst = np.array([run.header[VERDICT] == BLISTER for run in marked], dtype=bool)
    believed = believed_limit(resin)
    found = learn_limit(Normal(log[::-1, 0], log[::-1, 1]), burst[::-1], *believed)
    lines = limit_messages(found)
    return Blisters(
        press=press,
        panels=[_panel(run, *one) for run, one in zip(marked, steam, strict=True)],
        marks=found.marks,
        blistered=found.blistered,
        stated_kPa=believed[0],
        steam_most_kPa=round(found.most_kPa, 1),
        sd_kPa=round(found.sd_kPa, 1),
        ci95_kPa=(round(found.ci95_kPa[0], 1), round(found.ci95_kPa[1], 1)),
        curve_kPa=CURVE_KPA.round(2).tolist(),
        chance=found.chance(Normal(np.log(CURVE_KPA), np.zeros(len(CURVE_KPA)))).round(4).tolist(),
        sentences=[str(line) for line in lines],
        sentences_said=[message_answer(line) for line in lines],
    )


def _steam_of(store: Store, marked: Sequence[RunRecord]) -> list[tuple[float, float]]:
    keys = [(store.label, run.run, run.last_scan) for run in marked]
    found = _STEAM.get_all(keys, lambda lacking: {key: _at_opening(store, key[1]) for key in lacking})
    return [found[key] for key in keys]


def _panel(run: RunRecord, mean: float, sd: float) -> MarkedPanel:
    known = math.isfinite(mean + sd)
    return MarkedPanel(
        run=run.run,
        verdict=run.header[VERDICT],
        steam_kPa=round(math.exp(mean), 2) if known else None,
        steam_high_kPa=round(math.exp(mean + BAND * sd), 2) if known else None,
    )


def _at_opening(store: Store, run: str) -> tuple[float, float]:
    """Return ln of the last steam before the press opened, and its deviation; NaN where none was. [ln kPa]"""
    estimates: Sequence[tuple[float, StoredEstimate]] = ()
    with suppress(InputError):  # in an archive that is away, or deleted by rule
        estimates = store.estimates(run)
    last: Mapping[str, Any] = next((e.detail or {} for _, e in reversed(estimates) if e.state == "closed"), {})
    middle, high = last.get("steam_kPa", math.nan), last.get("steam_high_kPa", math.nan)
    if middle > 0.0 and high > middle:
        return math.log(middle), math.log(high / middle) / BAND
    return math.nan, math.nan
