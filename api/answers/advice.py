"""When to open: one line out of one look ahead, or why it is not known. No store, no clock.

The forecast of the live sensor says when to open so that the core just reaches ``setting.core_target_C`` by the
heat that is in the panel then: what a panel left on the hot plate still gets is not counted.
Its bounds are those of 95 %: by how far that peak is known.

Where a resin file sets limits, they alone decide, whatever is known of cure and steam: the press may open from
when on all of them hold together with the wanted probability, as the live sensor foresees it. ``open_now`` is its
word at the newest scan. Bounds are those of 95 % of the moment at which that word will come.

Times count from now: the estimate's age is taken off. An estimate that is not of now gives no advice.
"""

from __future__ import annotations

import math

from api.answers.present import is_of_now
from api.answers.schemas import Advice, EstimateNow
from api.answers.words import message_answer
from daq.supervision import SILENT_S
from daq.words import Message, say
from softsensor.live.validity import reason_message

AT_ONCE_S = 0.5
"""An opening this near is now: the look ahead resolves no less. [s]"""


def advice_of(estimate: EstimateNow | None, target_C: float | None, opened_s: float = math.nan) -> Advice:  # noqa: N803
    """Return what to do with the panel in the press.

    Parameters
    ----------
    target_C
        ``setting.core_target_C`` of the run, None without one. [°C]
    opened_s
        When the press opened on this panel, NaN where it has not yet. [s]
    """
    if estimate is None:
        return _known("not_known", say("advice-not-known", why=say("reason-no-estimate-yet")), target_C)
    if estimate.state == "idle":
        return _known("no_panel", say("advice-no-panel"), target_C)
    if not estimate.valid:
        why = reason_message(estimate.reason, estimate.reason_arguments)
        return _known("not_known", say("advice-not-known", why=why), target_C)
    if not is_of_now(estimate.age_s):
        why = say("advice-estimate-old", seconds=estimate.age_s or 0.0)
        return _known("not_known", say("advice-not-known", why=why), target_C)
    if estimate.state != "closed":
        return _of_open_press(estimate, target_C, opened_s)
    limited = estimate.cure_low is not None if estimate.limited is None else estimate.limited
    return _of_limits(estimate, target_C) if limited else _of_closed_press(estimate, target_C)


def _of_open_press(estimate: EstimateNow, target_C: float | None, opened_s: float) -> Advice:  # noqa: N803
    if not math.isfinite(opened_s):
        return _known("not_closed", say("advice-not-closed"), target_C)
    peak_C = estimate.peak_C  # noqa: N806
    message = say("advice-opened") if peak_C is None else say("advice-opened-peak", peak_C=peak_C)
    return _known("opened", message, target_C, peak_C=peak_C, age_s=_age_of_look(estimate))


def _age_of_look(estimate: EstimateNow) -> float | None:
    """Return how old the look ahead is now, None where there is none. [s]"""
    age_s = estimate.forecast_age_s
    return None if age_s is None else round(age_s + _since(estimate), 3)


def _from_now(seconds: float | None, estimate: EstimateNow) -> float | None:
    """Return a time foreseen at the estimate as it counts from now; what is past is now. [s]"""
    return None if seconds is None else max(seconds - _since(estimate), 0.0)


def _since(estimate: EstimateNow) -> float:
    """Return how long ago the estimate was; none is of the future, whatever the press' clock says. [s]"""
    return max(estimate.age_s or 0.0, 0.0)


def _of_closed_press(estimate: EstimateNow, target_C: float | None) -> Advice:  # noqa: N803
    if target_C is None:
        return _known("no_target", say("advice-no-target"), None)
    age_s = _age_of_look(estimate)
    if age_s is None:
        return _known("not_known", say("advice-not-known", why=say("advice-no-look-ahead")), target_C)
    if age_s > SILENT_S:
        why = say("advice-old", seconds=age_s)
        return _known("not_known", say("advice-not-known", why=why), target_C, age_s=age_s)
    foreseen = (estimate.open_in_s, estimate.open_earliest_s, estimate.open_latest_s)
    at, low, high = (_from_now(seconds, estimate) for seconds in foreseen)
    if at is None:
        return _known("too_early", say("advice-too-early"), target_C, age_s=age_s)
    if at > AT_ONCE_S:
        return _open_in(at, (low, high), target_C, age_s, peak_C=target_C)
    peak_C = None if estimate.peak_C is None else max(estimate.peak_C, target_C)  # noqa: N806
    now = {"open_in_s": round(at, 1), **_rounded(low, high), "peak_C": peak_C}
    return _known("open_now", say("advice-open-now"), target_C, age_s=age_s, **now)


def _of_limits(estimate: EstimateNow, target_C: float | None) -> Advice:  # noqa: N803
    """Return from when on every limit of the resin file holds."""
    age_s = _age_of_look(estimate)
    if estimate.open_now:
        peak_C = estimate.peak_C if age_s is not None and age_s <= SILENT_S else None  # noqa: N806
        return _known("open_now", say("advice-open-now"), target_C, open_in_s=0.0, age_s=age_s, peak_C=peak_C)
    if age_s is None or age_s > SILENT_S:
        why = say("advice-no-look-ahead") if age_s is None else say("advice-old", seconds=age_s)
        return _known("not_known", say("advice-not-known", why=why), target_C, age_s=age_s)
    foreseen = (estimate.limits_in_s, estimate.limits_earliest_s, estimate.limits_latest_s)
    at, low, high = (_from_now(seconds, estimate) for seconds in foreseen)
    if at is not None:
        at = max(at, AT_ONCE_S)  # not yet, or the newest scan would show it
        return _open_in(at, (low, None if high is None else max(high, at)), target_C, age_s)
    if not estimate.limits_blocking:
        return _known("not_known", say("advice-not-known", why=say("advice-no-look-ahead")), target_C, age_s=age_s)
    message = say("advice-blocked", limit=estimate.limits_blocking)
    return _known("blocked", message, target_C, age_s=age_s, blocking=estimate.limits_blocking)


def _open_in(
    at: float,
    bounds: tuple[float | None, float | None],
    target_C: float | None,  # noqa: N803
    age_s: float,
    peak_C: float | None = None,  # noqa: N803
) -> Advice:
    """Return that the press may open some seconds from now, with what is known of the bounds of that."""
    low, high = bounds
    whole = {"seconds": math.ceil(at)}  # nobody opens too early by a rounded number, and none is 0
    if low is None:
        message = say("advice-open-in", **whole)
    elif high is None and round(low) == 0:  # two bounds that bound nothing
        message = say("advice-open-in-or-later", **whole)
    elif high is None:
        message = say("advice-open-in-at-least", **whole, low=low)
    else:
        message = say("advice-open-in-between", **whole, low=low, high=high)
    ahead = {"open_in_s": round(at, 1), **_rounded(low, high), "peak_C": peak_C}
    return _known("open_in", message, target_C, age_s=age_s, **ahead)


def _rounded(low: float | None, high: float | None) -> dict[str, float | None]:
    return {
        "open_earliest_s": None if low is None else round(low, 1),
        "open_latest_s": None if high is None else round(high, 1),
    }


def _known(verdict: str, message: Message, target_C: float | None, **numbers: float | str | None) -> Advice:  # noqa: N803
    given = {"verdict": verdict, "target_C": target_C, **numbers}
    return Advice.model_validate({**given, "sentence": str(message), "sentence_said": message_answer(message)})
