"""The steam a panel bears, learned from panels that were marked blistered or good.

A panel blisters where the steam in it at opening exceeds what its bond bears. That differs from panel to panel,

    ln L ~ N(m, t²),        ln p ~ N(mean, sd²) as the live sensor has it,
    P(blister) = Φ((mean - m) / √(t² + sd²)),

a probit with errors in p. The posterior of m and t is computed on a grid, so few marks and marks of one kind alone
are no trouble: they move the prior as far as they speak. Panels that were let out early enough show only from
where on panels still hold; nothing here calls for pressing until one blisters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from daq.press.resin_file import Resin
from daq.records import Array
from daq.words import Message, say
from softsensor.opening.limits import STEAM_BELIEVED, STEAM_MOST, Normal
from softsensor.signals.unknown import CENTRAL

USUAL_KPA = 100.0
"""MDF delaminates from some 100 kPa on (Forest Products Laboratory, treesearch 25741). [kPa]"""
UNSURE_LOG = 0.35
"""Of ln m where only such a number is known: a factor of two either way is two of it. By hand, 2026-11."""
SCATTER_LOG, SCATTER_UNSURE = 0.15, 0.5
"""Middle of t, and standard deviation of ln t: panels of one board bond 10 to 20 % apart. By hand, 2026-11."""
_REACH, _CELLS = 4.0, (161, 41)
"""The grid goes so many prior standard deviations either way, in so many cells of m and of t."""


@dataclass(frozen=True, repr=False, eq=False)
class LearnedLimit:
    """What is known of the limit: weights of a grid."""

    middle: Array
    """m (M). [ln kPa]"""
    scatter: Array
    """t (T)."""
    weight: Array
    """(M, T), together 1."""
    marks: int
    """How many marked panels it rests on."""
    blistered: int
    """How many of them blistered."""
    believed: tuple[float, float | None] = (USUAL_KPA, None)
    """What was believed of half of the panels before, and how far that may be off (None: `UNSURE_LOG`). [kPa]"""
    foreseen: tuple[float, float] = (math.nan, math.nan)
    """Chance given beforehand to what became of the panels, on geometric average: by what the panels before each
    had taught, and by what was believed before all of them; NaN where less than two are known."""

    def __repr__(self) -> str:
        """Say what half of the panels bear, with its 95 % interval, and from how many marks."""
        low, high = self.ci95_kPa
        marked = f"{self.blistered} of {self.marks} blistered"
        return f"SteamLimit {self.most_kPa:.0f} kPa ({low:.0f} to {high:.0f}), {marked}"

    def chance(self, steam: Normal) -> Array:
        """Return the chance that panels blister, steam as ln kPa (any shape); 1 where steam is not known."""
        from scipy.special import ndtr  # loads slowly, and only who asks needs it

        mean, sd = np.broadcast_arrays(np.asarray(steam.mean, float), np.asarray(steam.sd, float))
        away = mean[..., None, None] - self.middle[:, None]
        found = (ndtr(away / np.hypot(self.scatter, sd[..., None, None])) * self.weight).sum(axis=(-2, -1))
        return np.asarray(np.where(np.isfinite(mean + sd), found, 1.0))

    @cached_property
    def most_kPa(self) -> float:  # noqa: N802
        """What half of the panels bear. [kPa]"""
        return math.exp(float(self.weight.sum(axis=1) @ self.middle))

    @cached_property
    def sd_kPa(self) -> float:  # noqa: N802
        """How far a panel's own limit may be from it, what is not known of it included. [kPa]"""
        by_middle = self.weight.sum(axis=1)
        of_middle = float(by_middle @ self.middle**2) - float(by_middle @ self.middle) ** 2
        of_panels = float(self.weight.sum(axis=0) @ self.scatter**2)
        return self.most_kPa * math.sqrt(of_middle + of_panels)

    @cached_property
    def ci95_kPa(self) -> tuple[float, float]:  # noqa: N802
        """Of what half of the panels bear. [kPa]"""
        reached = np.cumsum(self.weight.sum(axis=1))
        low, high = np.interp(CENTRAL, reached, self.middle)
        return math.exp(low), math.exp(high)

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``blisters --json``. [kPa]"""
        return {
            "marks": self.marks,
            "blistered": self.blistered,
            "steam_most_kPa": round(self.most_kPa, 2),
            "ci95_kPa": [round(end, 2) for end in self.ci95_kPa],
            "sd_kPa": round(self.sd_kPa, 2),
            "believed_kPa": round(self.believed[0], 2),
            "believed_sd_kPa": None if self.believed[1] is None else round(self.believed[1], 2),
            "foreseen": {
                key: None if math.isnan(share) else round(share, 3)
                for key, share in zip(("learned", "stated"), self.foreseen, strict=True)
            },
        }


def limit_messages(limit: LearnedLimit) -> tuple[Message, ...]:
    """Return in words what is learned, and what to write into the resin file."""
    low, high = limit.ci95_kPa
    learned, stated = limit.foreseen
    gain = () if math.isnan(learned) else (say("blisters-foreseen", learned=100 * learned, stated=100 * stated),)
    return (
        say("blisters-marks", marks=limit.marks, blistered=limit.blistered),
        say("blisters-bear", most=limit.most_kPa, low=low, high=high),
        *gain,
        say("blisters-write", most=limit.most_kPa, sd=limit.sd_kPa),
        say("blisters-keep", **_kept(*limit.believed)),
    )


def _kept(believed: float, sd: float | None) -> dict[str, float]:
    """Return what the resin file keeps of the belief before any mark, as `believed_limit` reads it."""
    return {"believed": believed, "sd": UNSURE_LOG * believed if sd is None else sd}


def believed_limit(resin: Resin | None) -> tuple[float, float | None]:
    """Return what was believed of the limit before any mark, and how far that may be off. [kPa]

    A resin file's ``steam_believed_kPa``, else its ``steam_most_kPa``, else what is usual. The limit in force
    holds the marks, once learned, and they count once.
    """
    limits = None if resin is None else resin.limits
    if limits is not None and limits.steam_believed_kPa is not None:
        return limits.steam_believed_kPa, limits.spreads.get(STEAM_BELIEVED)
    if limits is not None and limits.steam_most_kPa is not None:
        return limits.steam_most_kPa, limits.spreads.get(STEAM_MOST)
    return USUAL_KPA, None


def learn_limit(
    steam: Normal, blistered: Array, believed_kPa: float = USUAL_KPA, believed_sd_kPa: float | None = None
) -> LearnedLimit:
    """Return the steam that panels bear, from marked ones.

    Parameters
    ----------
    steam
        ln of the partial pressure at opening (n), in the order in which the panels were pressed. Panels of which
        it is not known count for nothing.
    blistered
        Whether they blistered (n).
    believed_kPa, believed_sd_kPa
        What was believed of half of the panels before any of these marks, and how far that may be off (None:
        `UNSURE_LOG`). [kPa]

    Examples
    --------
    Ten that held at 60 kPa and ten that blistered at 90 leave the limit in between:

    >>> log = np.log(np.repeat([60.0, 90.0], 10))
    >>> found = learn_limit(Normal(log, np.full(20, 0.05)), np.repeat([False, True], 10))
    >>> 65.0 < found.most_kPa < 85.0, found.marks, found.blistered
    (True, 20, 10)
    """
    from scipy.special import log_ndtr

    unsure = UNSURE_LOG if believed_sd_kPa is None else believed_sd_kPa / believed_kPa
    u, v = (np.linspace(-_REACH, _REACH, n) for n in _CELLS)
    middle, scatter = math.log(believed_kPa) + unsure * u, SCATTER_LOG * np.exp(SCATTER_UNSURE * v)
    log = -0.5 * (u[:, None] ** 2 + v**2)
    mean, sd = np.asarray(steam.mean, float), np.asarray(steam.sd, float)
    known = np.isfinite(mean) & np.isfinite(sd)
    before, foreseen = log - _log_sum(log), []
    for m, s, burst in zip(mean[known], sd[known], np.asarray(blistered, bool)[known], strict=True):
        z = (m - middle[:, None]) / np.hypot(scatter, s)
        likelihood = log_ndtr(z if burst else -z)
        foreseen.append((_log_sum(log + likelihood) - _log_sum(log), _log_sum(before + likelihood)))
        log = log + likelihood
    return LearnedLimit(
        middle,
        scatter,
        np.exp(log - _log_sum(log)),
        marks=int(known.sum()),
        blistered=int(np.asarray(blistered, bool)[known].sum()),
        believed=(believed_kPa, believed_sd_kPa),
        foreseen=_later(foreseen),
    )


def _log_sum(log: Array) -> float:
    """Return the logarithm of the sum of numbers given by theirs."""
    highest = float(log.max())
    return highest + math.log(float(np.exp(log - highest).sum()))


def _later(foreseen: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the chances given to what became of all panels but the first, which had nobody to learn from."""
    if len(foreseen) < 2:
        return math.nan, math.nan
    learned, stated = np.exp(np.mean(foreseen[1:], axis=0)).tolist()
    return learned, stated
