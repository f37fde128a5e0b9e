"""The rule by which a diagnosis names or stops, branch by branch, on evidence made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from softsensor.diagnosis.decision import (
    Claim,
    Evidence,
    Objection,
    Step,
    Verdict,
    decide,
    objection,
)
from softsensor.diagnosis.sign_flips import PatternTest

RUNS = 8
NO_CORES = np.full(RUNS, np.nan)
NOTHING_LEFT, SOMETHING_LEFT = PatternTest(0.6, 0.0, None), PatternTest(0.008, 0.25, None)
LOSS = Claim(
    "edge_loss", measuring=False, needs="panel", at_the_rim=True, size=1.0, unphysical=False, p_value=0.008,
    saved=400.0, saves=np.linspace(30.0, 60.0, RUNS), heldout_gain_K=0.3, heldout_ratio=0.4, core_K=NO_CORES,
)  # fmt: skip
LAG = replace(LOSS, name="thermocouple_lag", measuring=True, at_the_rim=False, saved=350.0)
PLAIN = Evidence(RUNS, SOMETHING_LEFT, NO_CORES)
AFTER = replace(PLAIN, left=NOTHING_LEFT, sets=(("edge_loss",),), shares=(0.95,), heldout_ratio=0.3)


def claims(*some):
    return replace(PLAIN, claims=some)


def fewer(claim, runs, **changes):
    return replace(claim, saves=claim.saves[:runs], core_K=claim.core_K[:runs], **changes)


WEAKER = (
    ({}, None),
    ({"size": 0.2}, Objection.TOO_SMALL),
    ({"size": 0.2, "needs": "load"}, None),
    ({"saves": -LOSS.saves}, Objection.NO_GAIN_LEFT_OUT),
    ({"unphysical": True}, Objection.UNPHYSICAL),
    ({"heldout_gain_K": 0.004}, Objection.HARDLY_SAVES),
    ({"heldout_ratio": 0.99}, Objection.HARDLY_SAVES),
    ({"heldout_ratio": 1.0, "heldout_gain_K": 0.0, "needs": "closed"}, None),
    ({"p_value": 0.051}, Objection.CHANCE),
    ({"saves": np.array([-30.0, -30.0, -30.0, -30.0, 60.0, 60.0, 60.0, 60.0])}, Objection.RUNS_DISAGREE),
    ({"saves": np.array([0.1, -0.1, 0.1, -0.1, -0.1, 60.0, 60.0, 60.0])}, None),
)


@pytest.mark.parametrize(("change", "expected"), WEAKER)
def test_a_cause_is_named_unless_one_thing_speaks_against_it(change, expected):
    claim = replace(LOSS, **change)
    found = decide(claims(claim))
    assert objection(claim, claims(claim)) is expected
    assert found.step is (Step.NO_CAUSE_CONVINCES if expected else Step.CAUSE_NAMED)
    assert found.set == (() if expected else ("edge_loss",))


def test_core_thermocouples_further_off_in_every_run_refute_a_cause():
    met, off = np.full(RUNS, 0.5), np.full(RUNS, 2.0)
    claim = replace(LOSS, core_K=off)
    assert objection(claim, replace(claims(claim), core_K=met)) is Objection.REFUTED_BY_CORES
    assert objection(claim, replace(claims(claim), core_K=off)) is None
    partly = np.where(np.arange(RUNS) == 0, 0.5, off)
    assert objection(replace(LOSS, core_K=partly), replace(claims(LOSS), core_K=met)) is None


def test_a_further_cause_must_save_more_once_what_is_left_is_negligible():
    small = replace(LOSS, name="paper_layer", heldout_gain_K=0.01, heldout_ratio=0.9)
    assert objection(small, PLAIN) is None
    assert objection(small, AFTER) is Objection.HARDLY_SAVES
    assert objection(small, replace(AFTER, left=SOMETHING_LEFT)) is None
    assert objection(replace(small, measuring=True), AFTER) is None
    assert objection(replace(small, heldout_gain_K=0.016), AFTER) is None


def test_few_runs_ask_no_p_value_but_every_run_and_a_larger_gain():
    few = replace(PLAIN, runs=3, core_K=NO_CORES[:3])
    sure = fewer(LOSS, 3, p_value=0.25)
    assert objection(sure, few) is None
    assert objection(replace(sure, saves=np.array([60.0, 60.0, -0.1])), few) is Objection.RUNS_DISAGREE
    assert objection(replace(sure, heldout_ratio=0.9), few) is Objection.RUNS_DISAGREE


def test_of_causes_nothing_speaks_against_the_one_that_saves_most_is_named():
    weak = replace(LOSS, name="resin_cure", saved=150.0, saves=LOSS.saves / 3)
    assert decide(claims(weak, LOSS)).set == ("edge_loss",)
    assert decide(claims(weak, replace(LOSS, p_value=0.5))).set[0] == "resin_cure"


def test_what_the_runs_cannot_tell_from_it_stands_in_its_set_the_measuring_chain_first():
    found = decide(claims(LOSS, LAG))
    assert found.set == ("thermocouple_lag", "edge_loss")
    assert found.strongest == "edge_loss"


APART = (
    ({"saves": LOSS.saves - np.linspace(8.0, 12.0, RUNS)}, "every run prefers the best"),
    ({"saved": 150.0}, "it saves less than half"),
    ({"size": 0.1}, "it is too small"),
)


@pytest.mark.parametrize(("change", "why"), APART)
def test_a_rival_stays_out_of_the_set(change, why):
    rival = replace(LOSS, name="resin_cure", saved=300.0)
    assert decide(claims(LOSS, rival)).set == ("edge_loss", "resin_cure")
    assert decide(claims(LOSS, replace(rival, **change))).set == ("edge_loss",), why


def test_a_set_has_three_names_at_most():
    rivals = [replace(LOSS, name=f"cause_{i}", saved=390.0 - i) for i in range(4)]
    assert decide(claims(*rivals, LOSS)).set == ("edge_loss", "cause_0", "cause_1")


def test_a_cool_rim_settles_a_set_for_the_loss_at_the_rim():
    found = decide(replace(claims(LOSS, LAG), rim_is_cool=True))
    assert found.set == ("edge_loss",)


def test_cores_make_a_set_smaller_and_say_what_they_speak_against():
    met, off = replace(LOSS, core_K=np.full(RUNS, 0.4)), replace(LAG, core_K=np.full(RUNS, 3.0))
    found = decide(replace(claims(met, off), core_K=np.full(RUNS, 3.0)))
    assert found.set == ("edge_loss",)
    assert found.refuted == ("thermocouple_lag",)


STOPS = (
    (replace(PLAIN, runs=1, claims=(LOSS,)), Step.ONE_RUN),
    (replace(PLAIN, claims=(replace(LOSS, p_value=1.0),)), Step.NO_CAUSE_CONVINCES),
    (PLAIN, Step.NOTHING_TO_TRY),
    (replace(AFTER, claims=(LOSS,), sets=(("a",), ("b",), ("c",))), Step.ENOUGH_CAUSES),
)


@pytest.mark.parametrize(("evidence", "step"), STOPS)
def test_a_search_stops_and_says_why(evidence, step):
    assert decide(evidence).step is step


VERDICTS = (
    ("nothing found, nothing left", replace(PLAIN, left=NOTHING_LEFT), Verdict.NO_EFFECT, 0),
    ("nothing found, something left", PLAIN, Verdict.UNKNOWN_EFFECT, 0),
    ("something left, but likely chance", replace(PLAIN, left=PatternTest(0.03, 0.25, None)),
     Verdict.NO_EFFECT, 0),
    ("something left, but negligible", replace(PLAIN, left=PatternTest(0.008, 0.003, None)),
     Verdict.NO_EFFECT, 0),
    ("few runs, nothing found", replace(PLAIN, runs=5), Verdict.TOO_FEW_RUNS, 0),
    ("faulty channels alone", replace(PLAIN, left=NOTHING_LEFT, faulty_channels=True), Verdict.NAMED, 0),
    ("one cause", AFTER, Verdict.NAMED, 1),
    ("one cause of several", replace(AFTER, sets=(("a", "b"),)), Verdict.AMBIGUOUS, 1),
    ("a cause that leaves little", replace(AFTER, left=PatternTest(0.008, 0.03, None)), Verdict.NAMED, 1),
    ("a cause that leaves much", replace(AFTER, left=SOMETHING_LEFT), Verdict.UNKNOWN_EFFECT, 1),
    ("a cause that explains too little", replace(AFTER, left=SOMETHING_LEFT, shares=(0.5,)),
     Verdict.UNKNOWN_EFFECT, 0),
    ("two causes that leave as little as one may",
     replace(AFTER, left=PatternTest(0.008, 0.03, None), sets=(("a",), ("b",)), shares=(0.9, 0.95)),
     Verdict.UNKNOWN_EFFECT, 2),
    ("few runs, one cause", replace(AFTER, runs=3), Verdict.NAMED, 1),
    ("few runs, a cause that does not halve the residual", replace(AFTER, runs=3, heldout_ratio=0.6),
     Verdict.TOO_FEW_RUNS, 0),
    ("few runs, two causes", replace(AFTER, runs=3, sets=(("a",), ("b",)), shares=(0.9, 0.95)),
     Verdict.TOO_FEW_RUNS, 0),
)  # fmt: skip


@pytest.mark.parametrize(("case", "evidence", "verdict", "kept"), VERDICTS)
def test_the_verdict_follows_from_what_was_named_and_what_is_left(case, evidence, verdict, kept):
    found = decide(evidence)
    assert (found.verdict, found.kept) == (verdict, kept), case
