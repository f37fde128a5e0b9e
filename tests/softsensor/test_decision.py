"""The rules by which a diagnosis names or stops, branch by branch, on evidence made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from softsensor.diagnosis.decision import (
    Claim,
    Evidence,
    Objection,
    Proof,
    Remains,
    SearchStep,
    Verdict,
    VerdictBasis,
    beyond_chance,
    choose,
    conclude,
    explains_the_rest,
    objections,
)
from softsensor.diagnosis.finding import Finding
from softsensor.diagnosis.gains import Gain, paired_gain
from softsensor.diagnosis.sign_flips import PatternTest
from softsensor.diagnosis.summary import sureness
from tests.calibration import gains

RUNS = 8
NO_CORES = np.full(RUNS, np.nan)
SURE = Gain(0.3, (0.2, 0.4))
LOSS = Claim(
    "edge_loss", measuring=False, needs="panel", at_the_rim=True, size=1.0, unphysical=False, p_value=0.008,
    saved=400.0, saves=np.linspace(30.0, 60.0, RUNS), gain=SURE, core_K=NO_CORES,
)  # fmt: skip
LAG = replace(LOSS, name="thermocouple_lag", measuring=True, at_the_rim=False, saved=350.0)
PLAIN = Evidence(RUNS, NO_CORES)


def claims(*some):
    return replace(PLAIN, claims=some)


def fewer(claim, runs, **changes):
    return replace(claim, saves=claim.saves[:runs], core_K=claim.core_K[:runs], **changes)


WEAKER = (
    ({}, set()),
    ({"size": 0.24}, {Objection.TOO_SMALL}),
    ({"size": 0.26}, set()),
    ({"size": 0.03, "needs": "load"}, set()),
    ({"saves": -LOSS.saves}, {Objection.NO_GAIN_LEFT_OUT}),
    ({"unphysical": True}, {Objection.UNPHYSICAL}),
    ({"gain": Gain(0.3, (-0.001, 0.6))}, {Objection.GAIN_NOT_SURE}),
    ({"gain": Gain(0.3, None)}, {Objection.GAIN_NOT_SURE}),
    ({"gain": Gain(-0.3, (-0.5, -0.1))}, {Objection.GAIN_NOT_SURE, Objection.NO_GAIN_LEFT_OUT}),
    ({"p_value": 0.051}, {Objection.CHANCE}),
    ({"p_value": 0.05}, set()),
)


RESTS = (
    (4.09, 2.46, False, "heat capacity beside moisture of another law, 67 %"),
    (1.92, 1.79, False, "a density profile beside moisture of another law, 18 %"),
    (1.51, 1.44, False, "a late sensor beside a contact of another law, 16 %"),
    (2.62, 1.17, True, "a loss at the rim beside a growing contact, 94 %"),
    (1.0, 0.9, False, "nothing was left"),
    (3.0, 8.6**0.5, False, "the last tenth alone"),
    (3.0, 2.21**0.5, False, "hardly less than 85 %"),
    (3.0, 2.19**0.5, True, "hardly more than 85 %"),
)


@pytest.mark.parametrize(("before", "after", "stays", "what"), RESTS)
def test_a_further_cause_explains_what_the_first_leaves_or_the_firsts_law_is_off(before, after, stays, what):
    assert explains_the_rest(before, after) is stays, what


@pytest.mark.parametrize(("change", "expected"), WEAKER)
def test_a_cause_is_taken_in_unless_one_thing_speaks_against_it(change, expected):
    claim = replace(LOSS, **change)
    found = choose(claims(claim))
    assert objections(claim, claims(claim)) == expected
    assert found.step is (SearchStep.NO_CAUSE_CONVINCES if expected else SearchStep.CAUSE_NAMED)
    assert found.set == (() if expected else ("edge_loss",))


def test_what_only_lacks_a_sure_gain_is_suspected_and_what_lacks_more_is_not():
    unsure = replace(LOSS, gain=Gain(0.3, (-0.1, 0.7)))
    assert choose(claims(unsure)).suspected == "edge_loss"
    assert choose(claims(replace(LOSS, gain=Gain(-0.3, (-0.5, -0.1))))).suspected == ""  # surely worse left out
    assert choose(claims(replace(unsure, p_value=0.2))).suspected == ""
    assert choose(claims(LOSS)).suspected == ""


def test_core_thermocouples_further_off_in_every_run_refute_a_cause():
    met, off = np.full(RUNS, 0.5), np.full(RUNS, 2.0)
    claim = replace(LOSS, core_K=off)
    assert objections(claim, replace(claims(claim), core_K=met)) == {Objection.REFUTED_BY_CORES}
    assert objections(claim, replace(claims(claim), core_K=off)) == set()
    partly = np.where(np.arange(RUNS) == 0, 0.5, off)
    assert objections(replace(LOSS, core_K=partly), replace(claims(LOSS), core_K=met)) == set()


def test_few_runs_ask_no_p_value_but_every_run():
    few = replace(PLAIN, runs=5, core_K=NO_CORES[:5])
    sure = fewer(LOSS, 5, p_value=0.25)
    assert objections(sure, few) == set()
    assert objections(replace(sure, saves=np.array([60.0, 60.0, 60.0, 60.0, -0.1])), few) == {Objection.CHANCE}
    six = replace(PLAIN, runs=6, core_K=NO_CORES[:6])
    assert objections(fewer(LOSS, 6, p_value=0.25), six) == {Objection.CHANCE}


def test_of_causes_nothing_speaks_against_the_one_that_saves_most_is_taken():
    weak = replace(LOSS, name="resin_cure", saved=150.0, saves=LOSS.saves / 3)
    assert choose(claims(weak, LOSS)).set == ("edge_loss",)
    assert choose(claims(weak, replace(LOSS, p_value=0.5))).set[0] == "resin_cure"


def test_what_the_runs_cannot_tell_from_it_stands_in_its_set_the_measuring_chain_first():
    found = choose(claims(LOSS, LAG))
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
    assert choose(claims(LOSS, rival)).set == ("edge_loss", "resin_cure")
    assert choose(claims(LOSS, replace(rival, **change))).set == ("edge_loss",), why


def test_a_set_has_three_names_at_most():
    rivals = [replace(LOSS, name=f"cause_{i}", saved=390.0 - i) for i in range(4)]
    assert choose(claims(*rivals, LOSS)).set == ("edge_loss", "cause_0", "cause_1")


def test_a_cool_rim_settles_a_set_for_the_loss_at_the_rim():
    found = choose(replace(claims(LOSS, LAG), rim_is_cool=True))
    assert found.set == ("edge_loss",)


def test_cores_make_a_set_smaller_and_say_what_they_speak_against():
    met, off = replace(LOSS, core_K=np.full(RUNS, 0.4)), replace(LAG, core_K=np.full(RUNS, 3.0))
    found = choose(replace(claims(met, off), core_K=np.full(RUNS, 3.0)))
    assert found.set == ("edge_loss",)
    assert found.refuted == ("thermocouple_lag",)


STOPS = (
    (replace(PLAIN, runs=1, claims=(LOSS,)), SearchStep.ONE_RUN),
    (replace(PLAIN, claims=(replace(LOSS, p_value=1.0),)), SearchStep.NO_CAUSE_CONVINCES),
    (PLAIN, SearchStep.NOTHING_TO_TRY),
    (replace(PLAIN, claims=(LOSS,), causes=3), SearchStep.ENOUGH_CAUSES),
    (replace(PLAIN, claims=(LOSS,), causes=2), SearchStep.CAUSE_NAMED),
)


@pytest.mark.parametrize(("evidence", "step"), STOPS)
def test_a_search_stops_and_says_why(evidence, step):
    assert choose(evidence).step is step


NOTHING, PATTERN = PatternTest(0.6, 0.0, None), PatternTest(0.008, 0.25, None)
QUIET, LOUD = Remains(NOTHING, 0.0, 1.1, True), Remains(PATTERN, 0.0, 4.0, True)
SAVES = np.linspace(20.0, 40.0, RUNS)
GOOD = Proof(("a",), SURE, SURE, SAVES, 1.1, True, 0.4)
HIDDEN = Gain(-0.8, (-2.0, 0.4))
AFTER = replace(QUIET, explained=0.95)
ONE = VerdictBasis(RUNS, (GOOD,), (LOUD, AFTER))
NONE = VerdictBasis(RUNS, (), (QUIET,))


def remains(**changes):
    return replace(NONE, remains=(replace(QUIET, **changes),))


def after(**changes):
    return replace(ONE, remains=(LOUD, replace(AFTER, **changes)))


def proof(**changes):
    return replace(ONE, proofs=(replace(GOOD, **changes),))


TWO = VerdictBasis(RUNS, (GOOD, replace(GOOD, set=("b",))), (LOUD, AFTER, AFTER))
VERDICTS = (
    ("nothing found, nothing left", NONE, Verdict.NO_EFFECT, 0),
    ("nothing found, a common pattern left", remains(pattern=PATTERN), Verdict.UNKNOWN_EFFECT, 0),
    ("a pattern that is likely chance", remains(pattern=PatternTest(0.03, 0.25, None)), Verdict.NO_EFFECT, 0),
    ("a pattern that is negligible", remains(pattern=PatternTest(0.008, 0.003, None)), Verdict.NO_EFFECT, 0),
    ("no pattern, but 1.6 K over 0.44 K of noise", remains(times_noise=1.6 / 0.44), Verdict.UNKNOWN_EFFECT, 0),
    ("no pattern, six tenths more than noise", remains(times_noise=1.6), Verdict.UNKNOWN_EFFECT, 0),
    ("no pattern, hardly more than noise", remains(times_noise=1.4), Verdict.NO_EFFECT, 0),
    ("faces that fit, and cores off alike in all runs", remains(cores_agree=False), Verdict.UNKNOWN_EFFECT, 0),
    ("no pattern, hardly more than noise in all runs together, but more in some than in the others",
     remains(times_noise=1.4, off=(1, 3)), Verdict.UNKNOWN_EFFECT, 0),
    ("six runs, 1.6 K over 0.44 K", replace(remains(times_noise=3.6), runs=6), Verdict.UNKNOWN_EFFECT, 0),
    ("few runs, nothing found", replace(NONE, runs=5), Verdict.TOO_FEW_RUNS, 0),
    ("one run, 16 K off", replace(remains(described=False, times_noise=80.0), runs=1), Verdict.NOT_DESCRIBED, 0),
    ("a pattern says more than a model that is far off", remains(pattern=PATTERN, described=False),
     Verdict.UNKNOWN_EFFECT, 0),
    ("faulty channels alone", replace(NONE, faulty_channels=True), Verdict.NAMED, 0),
    ("one cause", ONE, Verdict.NAMED, 1),
    ("one cause of several", proof(set=("a", "b")), Verdict.AMBIGUOUS, 1),
    ("a cause that leaves a fifth", after(pattern=PATTERN, explained=0.81), Verdict.NAMED, 1),
    ("a cause that leaves more", after(pattern=PATTERN, explained=0.79), Verdict.UNKNOWN_EFFECT, 0),
    ("a gain of -6.3 K", proof(gain=Gain(-6.3, (-9.0, -2.0))), Verdict.UNKNOWN_EFFECT, 0),
    ("a gain whose interval holds nothing", proof(gain=Gain(0.006, (-0.01, 0.02))), Verdict.UNKNOWN_EFFECT, 0),
    ("a gain that predictions surely lose", proof(predicted=Gain(-0.1, (-0.2, -0.01))),
     Verdict.UNKNOWN_EFFECT, 0),
    ("a gain that contacts which scatter hide in predictions", proof(predicted=HIDDEN), Verdict.NAMED, 1),
    ("the same where the model leaves more than noise", proof(predicted=HIDDEN, times_noise=1.6),
     Verdict.UNKNOWN_EFFECT, 0),
    ("a gain that predictions hardly see, where it leaves more than noise",
     proof(predicted=Gain(-0.05, (-0.2, 0.1)), times_noise=30.0), Verdict.NAMED, 1),
    ("a gain hidden in predictions, as many runs less likely as likelier",
     proof(predicted=HIDDEN, saves=SAVES * (-1.0) ** np.arange(RUNS)), Verdict.UNKNOWN_EFFECT, 0),
    ("a gain hidden in predictions, in every run, and in one a hundred times as large",
     proof(predicted=HIDDEN, saves=np.append(np.full(RUNS - 1, 25.0), 2500.0)), Verdict.NAMED, 1),
    ("a gain hidden in predictions that makes one very much likelier",
     proof(predicted=HIDDEN, saves=np.append(np.full(RUNS - 1, -0.3), 900.0)), Verdict.UNKNOWN_EFFECT, 0),
    ("a size that may be nothing", proof(size_is_sure=False), Verdict.UNKNOWN_EFFECT, 0),
    ("a size that may be nothing, and nothing left",
     replace(proof(size_is_sure=False), remains=(QUIET, AFTER)), Verdict.UNKNOWN_EFFECT, 0),
    ("nothing left, a cause beyond chance whose gain is not sure", replace(NONE, suspected=True),
     Verdict.UNKNOWN_EFFECT, 0),
    ("the same beside one that is named", replace(ONE, suspected=True), Verdict.NAMED, 1),
    ("a second cause that is not proven",
     replace(TWO, proofs=(GOOD, replace(GOOD, size_is_sure=False))), Verdict.NAMED, 1),
    ("a second cause on top of one that is not proven",
     replace(TWO, proofs=(replace(GOOD, size_is_sure=False), GOOD)), Verdict.UNKNOWN_EFFECT, 0),
    ("two causes", TWO, Verdict.NAMED, 2),
    ("few runs, one cause", replace(ONE, runs=3), Verdict.NAMED, 1),
    ("few runs, a cause that does not halve the residual", replace(proof(heldout_ratio=0.6), runs=3),
     Verdict.TOO_FEW_RUNS, 0),
    ("few runs, two causes", replace(TWO, runs=3), Verdict.TOO_FEW_RUNS, 0),
    ("few runs, a second cause let go", replace(ONE, runs=3, suspected=True, let_go=True),
     Verdict.TOO_FEW_RUNS, 0),
    ("few runs, a second cause suspected", replace(ONE, runs=3, suspected=True), Verdict.NAMED, 1),
    ("a second cause let go", replace(ONE, suspected=True, let_go=True), Verdict.NAMED, 1),
)  # fmt: skip


@pytest.mark.parametrize(("case", "evidence", "verdict", "named"), VERDICTS)
def test_the_verdict_follows_from_what_is_left_what_explains_it_and_whether_it_gains(
    case, evidence, verdict, named
):
    found = conclude(evidence)
    assert (found.verdict, found.named) == (verdict, named), case


@pytest.mark.parametrize(("runs", "chance"), [(6, 0.0395), (12, 0.0250), (24, 0.0191)])
def test_equal_causes_are_told_apart_by_chance_as_often_as_students_t_says(runs, chance):
    """`chance`: Student's one-sided tail beyond 2.2 standard errors, `runs` - 1 degrees of freedom."""
    campaigns = 20_000
    drawn = np.random.default_rng(1).normal(0.0, 30.0, (campaigns, runs))
    assert beyond_chance(drawn).mean() == pytest.approx(chance, abs=4.0 * np.sqrt(chance / campaigns))


def test_no_name_stands_beside_an_unknown_effect():
    for _, evidence, verdict, _ in VERDICTS:
        if verdict is Verdict.UNKNOWN_EFFECT:
            assert conclude(evidence).named == 0


def test_a_gain_that_all_runs_share_is_that_ratio_of_the_error_and_its_interval_has_no_width():
    before = np.array([1.0, 2.0, 3.0])
    found = paired_gain(before, before / 4)
    assert found.value_K == pytest.approx(0.75 * np.sqrt(14 / 3), rel=1e-5)
    assert found.ci95 == pytest.approx((found.value_K, found.value_K), rel=1e-5)
    assert found.sure


def test_the_interval_of_a_gain_holds_the_truth_in_95_of_100_campaigns_however_few_runs():
    rng = np.random.default_rng(11)
    for runs in (3, 6, 12):
        inside = 0
        for _ in range(1000):
            before = rng.lognormal(0.0, 0.8, runs)
            found = paired_gain(before, before * np.exp(-0.2 + 0.3 * rng.standard_normal(runs)))
            whole = np.sqrt(np.mean(before**2))
            inside += found.ci95[0] <= whole * (1 - np.exp(-0.2)) <= found.ci95[1]
        assert 930 <= inside <= 970


def test_thick_panels_that_show_nothing_do_not_make_a_gain_in_thin_ones_unsure():
    before, after = np.full(12, 0.06), np.full(12, 0.06)
    before[:3], after[:3] = (0.55, 0.76, 0.30), (0.06, 0.05, 0.04)
    moved = np.sqrt(np.maximum(before**2 - after**2, 0.0))
    assert not paired_gain(before, after).sure
    found = paired_gain(before, after, moved)
    assert found.sure
    fallen = np.sqrt(np.mean(before**2)) - np.sqrt(np.mean(after**2))
    assert found.value_K == pytest.approx(fallen, rel=0.05)


def test_a_gain_in_one_run_alone_is_not_sure_however_much_the_cause_could_show_there():
    before, after = np.full(6, 0.06), np.full(6, 0.06)
    before[0] = 5.0
    assert not paired_gain(before, after, np.sqrt(before**2 - after**2)).sure


def test_how_far_two_equally_good_models_lie_apart_makes_no_gain_of_chance():
    sure, worse = 0, 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        _, found = gains.gains(rng, gains.APART["in a quarter far"](rng, 8), 0.5)
        sure, worse = sure + found.sure, worse + found.surely_worse
    assert max(sure, worse) <= 20  # 10 promised each; binomial, 1 in 700 above 20


def test_one_run_has_no_interval_and_no_sure_gain():
    found = paired_gain(np.array([2.0]), np.array([1.0]))
    assert found == Gain(1.0, None)
    assert not found.sure


@pytest.mark.parametrize(("runs", "least"), [(2, "0.5"), (3, "0.25"), (5, "0.062")])
def test_too_few_runs_are_said_to_be_so_with_the_least_p_value_that_their_flips_can_show(runs, least):
    """All signs as they are or all flipped tell the same: one of 2^(runs - 1)."""
    none = Gain(0.3, None)
    named = Finding("edge_loss", ("edge_loss",), {}, 0.5, none, none, 0.9)
    assert f"{runs} runs cannot show less than {least};" in str(sureness(named, runs))
    assert "cannot show" not in str(sureness(named, 6))
