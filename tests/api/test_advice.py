"""When to open: one line out of one look ahead, and no second truth beside it."""

from __future__ import annotations

import math
from typing import Any

import pytest

from api.answers.advice import advice_of
from api.answers.schemas import EstimateNow
from daq.words.message import words


def estimate(state: str = "closed", **beside: Any) -> EstimateNow:
    core = {"core_C": 31.0, "core_sd_K": 1.0, "core_low_C": 29.0, "core_high_C": 33.0}
    known = {"run": "a", "number": 1, "utc": None, "age_s": 0.0, "time_s": 20.0, "state": state, "valid": True}
    return EstimateNow(**{**known, **core, **beside})


def ahead(**changed: float | None) -> dict[str, float | None]:
    forecast: dict[str, float | None] = {"open_in_s": 11.0, "target_in_s": 26.0, "forecast_age_s": 1.0}
    return {**forecast, "open_earliest_s": 8.0, "open_latest_s": 15.0, **changed}


def test_the_opening_has_its_bounds():
    advice = advice_of(estimate(**ahead()), 40.0)
    assert (advice.verdict, advice.open_in_s, advice.open_earliest_s, advice.open_latest_s) == (
        "open_in",
        11.0,
        8.0,
        15.0,
    )
    assert advice.sentence == "open in 11 s (8 to 15)"


def test_a_panel_with_enough_heat_is_to_be_opened_now_and_nothing_else_is_said():
    advice = advice_of(estimate(**ahead(open_in_s=0.0)), 40.0)
    assert (advice.verdict, advice.sentence) == ("open_now", "OPEN NOW")


def test_an_opening_says_what_becomes_of_the_core_by_the_look_ahead_it_rests_on():
    """A panel opened as advised reaches its target; one that has more heat, what it has."""
    assert advice_of(estimate(**ahead(peak_C=31.0)), 40.0).peak_C == 40.0
    assert advice_of(estimate(**ahead(open_in_s=0.0, peak_C=46.0)), 40.0).peak_C == 46.0
    assert advice_of(estimate(**ahead(open_in_s=0.3, peak_C=39.6)), 40.0).peak_C == 40.0
    assert (
        advice_of(estimate(**{**ahead(peak_C=31.0), **CURED, **BOUNDS, "limits_in_s": 11.0}), 40.0).peak_C is None
    )
    assert advice_of(estimate(**{**ahead(peak_C=46.0), **CURED, "open_now": True}), 40.0).peak_C == 46.0


def test_without_a_latest_moment_none_is_made_up():
    advice = advice_of(estimate(**ahead(open_latest_s=None)), 40.0)
    assert advice.open_latest_s is None
    assert advice.sentence == "open in 11 s (8 or later)"


@pytest.mark.parametrize(
    ("estimate_now", "verdict"),
    [
        (estimate(**ahead(open_in_s=None, target_in_s=None)), "too_early"),
        (estimate(**ahead(forecast_age_s=22.0)), "not_known"),
        (estimate(**ahead(forecast_age_s=None)), "not_known"),
        (estimate(valid=False, reason="platen reading missing"), "not_known"),
        (estimate("open"), "not_closed"),
        (estimate("idle", valid=False, reason="no panel in the press"), "no_panel"),
        (None, "not_known"),
    ],
)
def test_what_is_not_foreseen_is_not_advised(estimate_now, verdict):
    found = advice_of(estimate_now, 40.0)
    assert (found.verdict, found.open_in_s) == (verdict, None)


def test_an_old_look_ahead_is_no_advice_and_says_how_old_it_is():
    advice = advice_of(estimate(**ahead(forecast_age_s=22.0)), 40.0)
    assert advice.sentence == "not known, because the last forecast is 22 s old"


def test_times_count_from_now_and_a_look_ahead_ages_with_its_estimate():
    advice = advice_of(estimate(**ahead(), age_s=4.0), 40.0)
    assert (advice.open_in_s, advice.open_earliest_s, advice.open_latest_s, advice.age_s) == (7.0, 4.0, 11.0, 5.0)
    advice = advice_of(estimate(**ahead(), age_s=4.5), 40.0)
    assert advice.sentence == "not known, because the last forecast is 6 s old"


def test_a_clock_of_the_press_that_runs_ahead_makes_no_opening_later():
    advice = advice_of(estimate(**ahead(), age_s=-3.0), 40.0)
    assert (advice.open_in_s, advice.open_earliest_s, advice.open_latest_s, advice.age_s) == (11.0, 8.0, 15.0, 1.0)


@pytest.mark.parametrize("age_s", [5.1, -5.1, None])
def test_an_estimate_that_is_not_of_now_gives_no_advice(age_s):
    given = {**ahead(open_in_s=0.0), **CURED, "limits_in_s": 0.0, "open_now": True}
    assert advice_of(estimate(**given), 40.0).verdict == "open_now"
    assert advice_of(estimate(**given, age_s=age_s), 40.0).verdict == "not_known"


def test_without_a_target_there_is_none_to_open_for():
    assert advice_of(estimate(**ahead()), None).verdict == "no_target"


def test_the_opened_press_tells_the_peak_still_ahead():
    advice = advice_of(estimate("open", peak_C=43.2, forecast_age_s=0.4), 40.0, opened_s=70.0)
    assert (advice.verdict, advice.peak_C, advice.sentence) == ("opened", 43.2, "opened, the core peaks at 43 °C")
    assert math.isclose(advice.age_s or math.nan, 0.4)


def test_the_line_on_the_wall_speaks_german():
    from daq.words import Message

    advice = advice_of(estimate(**ahead()), 40.0).sentence_said
    assert words(Message(advice.code, advice.arguments), "de") == "öffnen in 11 s (8 bis 15)"


CURED = {"limited": True, "cure_top": 0.8, "cure_bottom": 0.82, "cure_low": 0.7, "forecast_age_s": 1.0}
BOUNDS = {"limits_earliest_s": 8.0, "limits_latest_s": 15.0}


@pytest.mark.parametrize(
    ("beside", "verdict", "sentence"),
    [
        ({"limits_in_s": 11.0}, "open_in", "open in 11 s"),
        ({"limits_in_s": 0.0, "open_now": True}, "open_now", "OPEN NOW"),
        ({"limits_blocking": "cure_top"}, "blocked", "the upper face will not be cured within the forecast"),
        ({"limits_blocking": "steam_most"}, "blocked", "too much steam, or its pressure is not known"),
        ({}, "not_known", "not known, because the live sensor has no forecast yet"),
        ({"limits_in_s": 11.0, **BOUNDS}, "open_in", "open in 11 s (8 to 15)"),
        ({"limits_in_s": 11.0, **BOUNDS, "limits_latest_s": None}, "open_in", "open in 11 s (8 or later)"),
        ({"cure_low": None, "open_in_s": 0.0}, "not_known", None),
        ({"limits_in_s": 11.0, "forecast_age_s": 22.0}, "not_known", None),
        ({"limits_in_s": 11.0, "forecast_age_s": None}, "not_known", None),
        ({"limits_in_s": 0.0}, "open_in", None),
    ],
)
def test_with_a_resin_its_limits_alone_decide(beside, verdict, sentence):
    advice = advice_of(estimate(**{**ahead(), **CURED, **beside}), 40.0)
    assert advice.verdict == verdict
    assert sentence in (None, advice.sentence)
    assert (advice.open_in_s is None) == (verdict not in ("open_in", "open_now"))


def test_nothing_is_to_be_opened_in_no_time_while_a_limit_does_not_hold():
    advice = advice_of(estimate(**CURED, limits_in_s=0.2, limits_earliest_s=0.0), None)
    assert (advice.open_in_s, advice.sentence) == (0.5, "open in 1 s (or later)")


def test_bounds_of_limits_count_from_now_too():
    advice = advice_of(estimate(**CURED, **BOUNDS, limits_in_s=11.0, age_s=2.0), None)
    assert (advice.open_in_s, advice.open_earliest_s, advice.open_latest_s) == (9.0, 6.0, 13.0)


def test_a_resin_without_limits_leaves_the_target_of_the_core_in_force():
    advice = advice_of(estimate(**{**ahead(), **CURED, "limited": False}), 40.0)
    assert (advice.verdict, advice.sentence) == ("open_in", "open in 11 s (8 to 15)")


def test_an_invalid_estimate_gives_no_leave():
    advice = advice_of(estimate(valid=False, reason="platen reading missing", **CURED), 40.0)
    assert advice.verdict == "not_known"
