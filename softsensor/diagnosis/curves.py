"""A diagnosis as curves: one run under both models, residuals of all runs, each run's vote.

What report and page draw, a night's from the store as well as one just made.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from daq.records import Array
from softsensor.diagnosis.finding import Diagnosis
from softsensor.diagnosis.settling import SettledModel
from softsensor.diagnosis.sign_flips import inside
from softsensor.diagnosis.where import stretches, temperatures, where_row
from softsensor.fitting.result import json_number, rms
from softsensor.signals.digest import Digest

MARKED = 3
"""Stretches marked where the plain model is most kelvins off. Set by hand, 2026-11."""
BEFORE_S, AFTER_S = 20.0, 160.0
"""Around closing, what residuals of all runs are compared over. Set by hand, 2026-11. [s]"""


def curves_of(found: Diagnosis) -> dict[str, Any]:
    """Return the curves as JSON content: temperatures [°C] and residuals, measured minus model [K], by place.

    `run` is the one the plain model fits worst, its bins at `time_s` [s of the run]; what is missing is null, what
    only an extended model has is null where nothing was named. `campaign` has a row a run at `since_s`, seconds
    since closing (since the run began where the press has one state). `votes` is what each run, left out, saves by
    a cause [sigma²].
    """
    plain, last = found.stages[0], found.final
    extended = last if len(found.stages) > 1 else None
    worst = int(np.argmax([np.nanmean(r.misfit**2) for r in plain.fit.runs]))
    digest = plain.data[worst].digest
    both = (plain, extended)
    return {
        "run": digest.run.name,
        "closed_s": json_number(digest.moments.closed_s),
        "opened_s": json_number(digest.moments.opened_s),
        "time_s": _row(digest.time),
        "rmse_K": [rms([s.fit.runs[worst].misfit]) for s in both if s is not None],
        "causes": list(last.effects),
        "places": [_place(digest, both, worst, j) for j in range(len(digest.signals))],
        "core": {
            "measured_C": {name: _row(values) for name, values in digest.cores.items()},
            "plain_C": _row(plain.fit.runs[worst].core),
            "extended_C": _row(extended.fit.runs[worst].core) if extended is not None else None,
        },
        "marks": _marks(plain, worst),
        "campaign": _campaign(plain, extended),
        "votes": [{"cause": name, "gains": _row(gains)} for name, gains in found.rivals],
    }


def _place(digest: Digest, both: Sequence[SettledModel | None], run: int, j: int) -> dict[str, Any]:
    low, high = _reach(digest, digest.channels[digest.signals[j]])
    row: dict[str, Any] = {
        "place": digest.signals[j],
        "measured_C": _row(digest.y[:, j]),
        "low_C": _row(low),
        "high_C": _row(high),
    }
    for name, stage in zip(("plain", "extended"), both, strict=True):
        fitted = stage.fit.runs[run] if stage is not None else None
        row[f"{name}_C"] = _row((fitted.model + fitted.shift)[:, j]) if fitted is not None else None
        row[f"{name}_residual_K"] = _row(fitted.misfit[:, j]) if fitted is not None else None
    return row


def _reach(digest: Digest, columns: Sequence[str]) -> tuple[Array, Array]:
    """Return the lowest and highest reading of a place's channels in each bin, NaN where there is none. [°C]"""
    low, high = np.full(len(digest.time), np.nan), np.full(len(digest.time), np.nan)
    table = np.stack([digest.run.columns[c] for c in columns])
    for i, (at, width) in enumerate(zip(digest.time, digest.width, strict=True)):
        values = table[:, np.abs(digest.run.time_s - at) <= width / 2]
        values = values[np.isfinite(values)]
        if len(values):
            low[i], high[i] = values.min(), values.max()
    return low, high


def _marks(plain: SettledModel, run: int) -> list[dict[str, Any]]:
    """Return where the plain model is most kelvins off in all runs, with what this run measured there."""
    digest, found = plain.data[run].digest, []
    for p in stretches([d.digest for d in plain.data], [r.misfit for r in plain.fit.runs])[:MARKED]:
        rows = inside(digest, p.phase, p.from_s, p.to_s)
        if p.signal in digest.signals and rows.any():
            times, half = digest.time[rows], digest.width[rows] / 2
            message = temperatures(where_row(p, [digest])).to_json()
            ends = {"from_s": float(times[0] - half[0]), "to_s": float(times[-1] + half[-1])}
            found.append({"place": p.signal, **ends, "said": message})
    return found


def _campaign(plain: SettledModel, extended: SettledModel | None) -> dict[str, Any]:
    digests = [d.digest for d in plain.data]
    closes = any(np.isfinite(d.moments.closed_s) for d in digests)
    before, after = (BEFORE_S, AFTER_S) if closes else (0.0, max(float(d.time[-1] - d.time[0]) for d in digests))
    since = np.concatenate([np.arange(-before, 0.0, 2.0), np.geomspace(0.5, after, 60)])
    return {
        "closes": closes,
        "runs": [d.run.name for d in digests],
        "since_s": _row(since),
        "places": [
            {
                "place": signal,
                "plain_K": _lines(plain, signal, since),
                "extended_K": _lines(extended, signal, since),
            }
            for signal in digests[0].signals
        ],
    }


def _lines(stage: SettledModel | None, signal: str, since: Array) -> list[list[float | None]] | None:
    """Return a place's residuals, a row a run, at times since closing. [K]"""
    if stage is None:
        return None
    rows = []
    for white, run in zip(stage.data, stage.fit.runs, strict=True):
        d, line = white.digest, np.full(len(since), np.nan)
        if signal in d.signals:
            start = d.moments.closed_s if np.isfinite(d.moments.closed_s) else d.time[0]
            values = run.misfit[:, d.signals.index(signal)]
            good = np.isfinite(values)
            if good.any():
                line = np.interp(since, d.time[good] - start, values[good], left=np.nan, right=np.nan)
        rows.append(_row(line))
    return rows


def _row(values: Array) -> list[float | None]:
    """Return numbers to a thousandth, null where there is none."""
    return [round(float(v), 3) if np.isfinite(v) else None for v in values]
