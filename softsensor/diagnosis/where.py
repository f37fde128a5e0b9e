"""Where and when a model is wrong: stretches of time at one place, and the temperatures measured there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from daq.records import Array
from daq.words import Message, say
from softsensor.diagnosis.decision import NEGLIGIBLE_K
from softsensor.diagnosis.sign_flips import (
    SINCE_S,
    Pocket,
    ResidualPhase,
    Stretch,
    inside,
    pocket,
    signals_of,
    trusted,
)
from softsensor.signals.digest import Digest

LATER_S = tuple(float(round(SINCE_S[-2] * 1.25**i)) for i in range(1, 30))
"""Where the last bin of time since an event is cut on: what is heated for an hour is not wrong throughout. [s]"""

# Numbers without another source were set by hand, 2026-11.

ALIKE = 2 / 3
"""Neighbours of one sign are one stretch down to this share of the largest."""
STANDS_OUT_T = 2.5
"""Standard errors over runs beyond which a mean residual stands out."""
MOST = 8
"""Stretches shown in an answer."""


def stretches(digests: Sequence[Digest], residuals: Sequence[Array]) -> list[Pocket]:
    """Return where residuals (bins, signals) of the runs stand out, most kelvins first; one run may be enough."""
    found = []
    residuals = trusted(digests, residuals)
    for signal in signals_of(digests):
        for phase in ResidualPhase:
            cuts = pairwise((*SINCE_S[:-1], *LATER_S, SINCE_S[-1]))
            row = [pocket(digests, residuals, signal, Stretch(phase, a, b)) for a, b in cuts]
            row = [p for p in row if np.isfinite(p.means).any()]
            found += [pocket(digests, residuals, signal, Stretch(phase, a, b)) for a, b in _joined(row)]
    return sorted(found, key=lambda p: (-abs(p.mean), p.signal, p.phase, p.from_s))


def _joined(row: Sequence[Pocket]) -> Iterator[tuple[float, float]]:
    """Yield from when to when neighbours that stand out are alike, each about the largest that is left. [s]"""
    left = [_stands_out(p) for p in row]
    while any(left):
        first = last = max((i for i, there in enumerate(left) if there), key=lambda i: abs(row[i].mean))
        alike = [there and p.mean / row[first].mean >= ALIKE for there, p in zip(left, row, strict=True)]
        while first > 0 and alike[first - 1]:
            first -= 1
        while last + 1 < len(row) and alike[last + 1]:
            last += 1
        left[first : last + 1] = [False] * (last + 1 - first)
        yield row[first].from_s, row[last].to_s


def _stands_out(p: Pocket) -> bool:
    values = p.means[np.isfinite(p.means)]
    if len(values) < max(min(2, len(p.means)), (len(p.means) + 1) // 2):
        return False
    if len(values) < 2:
        return abs(p.mean) > 3 * NEGLIGIBLE_K
    return bool(
        abs(p.mean) > max(NEGLIGIBLE_K, STANDS_OUT_T * float(np.std(values, ddof=1)) / np.sqrt(len(values)))
    )


def where_row(p: Pocket, digests: Sequence[Digest]) -> dict[str, Any]:
    """Return a stretch as the contract's row, and the temperatures measured in it (means over runs). [°C]"""
    closes = any(np.isfinite(d.moments.closed_s) for d in digests)
    low, high, goes_on = [], [], False
    for d in digests:
        if p.signal not in d.signals:
            continue
        measured = d.y[:, d.signals.index(p.signal)]
        here = measured[inside(d, p.phase, p.from_s, p.to_s) & np.isfinite(measured)]
        if len(here):
            low.append(float(here.min()))
            high.append(float(here.max()))
        goes_on |= bool(inside(d, p.phase, p.to_s, np.inf).any())
    phase = _phase_message(p.phase, closes)
    return {
        "signal": p.signal,
        "state": "closed" if p.phase is ResidualPhase.CLOSED else "open",
        "from_s": p.from_s,
        "to_s": p.to_s if goes_on else None,
        "residual_K": float(f"{p.mean:.6g}"),
        "phase": str(phase),
        "phase_said": phase.to_json(),
        "low_C": float(f"{np.mean(low):.4g}"),
        "high_C": float(f"{np.mean(high):.4g}"),
    }


def _phase_message(phase: ResidualPhase, closes: bool) -> Message:
    if phase is ResidualPhase.OPEN:
        return say("phase-before-closing") if closes else say("phase-since-run-began")
    return say("phase-closed") if phase is ResidualPhase.CLOSED else say("phase-after-opening")


def temperatures(row: Mapping[str, Any]) -> Message:
    """Return the temperatures measured in a stretch that is off."""
    low, high = round(row["low_C"]), round(row["high_C"])
    return say("measured-at", at=low) if low == high else say("measured-between", low=low, high=high)
