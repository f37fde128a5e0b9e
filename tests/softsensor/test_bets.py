"""Bets over nights: never sure of nothing, soon sure of something, each run counted once."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from softsensor.diagnosis.run_scores import ways
from softsensor.jobs.bets import WAIT, Bets
from softsensor.signals.unknown import ALPHA

FIRST = Bets().facing("plain")


def bet(bets, scores, first=1):
    """Settle rows of scores (runs, ways)."""
    for number, row in enumerate(scores, first):
        bets = bets.after(f"run-{number}", number, dict(zip(ways(), row.tolist(), strict=True)))
    return bets


def test_each_run_multiplies_what_is_there_by_one_in_the_mean():
    """By both signs of a run's scores in turn: exact, whatever the scores are."""
    rng = np.random.default_rng(5)
    bets = bet(FIRST, rng.standard_t(2, (6, len(ways()))))
    scores = rng.standard_t(2, (1, len(ways())))
    assert np.mean([bet(bets, sign * scores).average for sign in (1, -1)]) == pytest.approx(bets.average)


def test_what_has_no_score_costs_nothing():
    assert FIRST.average == pytest.approx(1.0)
    assert FIRST.after("run", 1, {}).average == pytest.approx(1.0)


def test_with_nothing_missing_it_is_hardly_ever_sure():
    rng = np.random.default_rng(6)
    presses = [bet(FIRST, np.clip(rng.standard_normal((150, len(ways()))), -3, 3)) for _ in range(10)]
    assert sum(bool(press.sure) for press in presses) <= 1  # one in forty of many


def test_a_cause_that_begins_late_makes_it_sure_and_no_more_is_bet():
    rng = np.random.default_rng(7)
    scores = np.clip(rng.standard_normal((140, len(ways()))), -3, 3)
    scores[100:, 3] = np.clip(scores[100:, 3] + 2.5, -3, 3)
    sure = bet(FIRST, scores)
    assert 110 <= int(sure.sure.removeprefix("run-")) <= 125
    assert sure.wealth == {}


def test_runs_that_may_have_made_a_model_are_not_bet_on_against_it():
    bets = bet(FIRST, np.zeros((5, len(ways()))))
    assert bets.facing("plain", 9) is bets
    other = bets.facing("extended", 9)
    assert (other.counted, other.runs, other.average) == (9, 0, pytest.approx(1.0))
    assert bets.facing("another press file").counted == 5


def test_all_models_together_have_one_share_of_false_alarms():
    bets, shares = Bets(), []
    for model in range(2000):
        bets = bets.facing(str(model), model)
        shares.append(1.0 / bets.limit)
    assert sum(shares) == pytest.approx(ALPHA, rel=1e-3)


def test_they_come_back_from_the_store_as_they_were():
    bets = bet(FIRST, np.random.default_rng(8).standard_normal((4, len(ways()))))
    assert Bets.stored(json.loads(json.dumps(asdict(bets)))) == bets


def test_what_waits_is_not_lost_while_nothing_is_there():
    """Half of a unit is laid at the first run, and half of the rest in as many runs as `WAIT` says."""
    bets = bet(FIRST, np.full((1 + int(WAIT), len(ways())), -3.0))
    assert bets.waiting == pytest.approx(0.25)
    assert bets.average == pytest.approx(bets.waiting, abs=0.01)


def test_bets_of_before_what_waits_was_kept_go_on_as_they_stood():
    """Three runs had laid two thirds of the unit; the next lays a part of the third that waits."""
    older = {"against": "plain", "models": 1, "counted": 3, "runs": 3, "wealth": {w: [0.2, 0.3] for w in ways()}}
    bets = Bets.stored(older)
    assert bets.average == pytest.approx(1 / 3 + 0.5)
    assert bets.facing("plain").after("run-4", 4, {}).average == pytest.approx(bets.average)
    assert Bets.stored({}) == Bets()
