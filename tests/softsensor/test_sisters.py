"""A press without a model begins with what presses of its kind know, and says so."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student_t

from daq.press.press_file import parse_press
from daq.process.config import PressSettings
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.physics_pressing import Plates
from daq.store import open_store
from softsensor.heat.model_file import FittedValue, ModelFile, Sisters, SisterScatter
from softsensor.heat.model_reading import parse_model
from softsensor.jobs import night_comparison, night_judgement
from softsensor.jobs.model_in_force import fingerprint, up_to_date
from softsensor.jobs.nights import refit_presses
from softsensor.jobs.press_follower import Follower
from softsensor.jobs.run_fits import RunFits
from softsensor.jobs.sisters import Sister, begin_with_sisters, learned_from, one_more

PRESS = parse_press(press_toml())
CONTACT = "h_pp_c"


def fit_entry(value):
    return {"coefficients": {CONTACT: {"value": value, "sd": 0.05 * value, "identifiable": True}}}


def sister(name, values, *effects):
    parameters = {"W_m3K": FittedValue(1000.0, 100.0)}
    return Sister(
        name, ModelFile("", "lab", {}, tuple((e, parameters) for e in effects)), [*map(fit_entry, values)]
    )


def test_many_presses_tell_their_centre_and_how_far_a_further_one_may_lie():
    """By the law they are drawn from: 95 % of Student's t lie within its quantile times the scale."""
    means = 0.4 + student_t(4).ppf((np.arange(100) + 0.5) / 100) * 0.2
    centre, sd = one_more(means, np.full(100, 0.01), 0.0, 0.7)
    assert centre == pytest.approx(0.4, abs=0.01)
    assert 1.96 * sd == pytest.approx(0.2 * student_t(4).ppf(0.975), rel=0.1)


def test_no_press_tells_nothing_and_one_alone_little():
    centre, sd = one_more(np.array([]), np.array([]), 3.0, 0.7)
    assert centre == pytest.approx(3.0)
    assert sd > 0.7
    assert one_more(np.array([3.2]), np.array([0.05]), 3.0, 0.7)[1] > 0.35


def test_an_odd_press_moves_what_is_expected_far_less_than_it_moves_the_mean():
    usual = np.array([-0.25, -0.15, -0.05, 0.0, 0.05, 0.15, 0.25])
    with_odd = np.append(usual[:-1], 1.5)
    moved = one_more(with_odd, np.full(7, 0.06), 0.0, 0.7)[0] - one_more(usual, np.full(7, 0.06), 0.0, 0.7)[0]
    assert abs(moved) < 0.25 * (with_odd.mean() - usual.mean())


def test_own_pressings_count_beside_the_kind_as_their_scatter_says():
    """Two Gaussians multiplied: what the kind expects of the press, and what its one pressing says."""
    kind = replace(
        ModelFile("kind", "lab", {CONTACT: FittedValue(700.0, 250.0)}),
        sisters=Sisters(("left", "right"), {CONTACT: SisterScatter(between=0.3, within=0.1)}),
    )
    own, error = math.log(1400.0), math.sqrt(math.log1p(0.05**2))
    weight, prior = 1.0 / (0.1**2 + error**2), 1.0 / 0.3**2
    expected = math.exp((weight * own + prior * math.log(700.0)) / (weight + prior))
    found = up_to_date(PRESS, kind, [fit_entry(1400.0)]).coefficients[CONTACT]
    assert found.value == pytest.approx(expected)
    assert parse_model(kind.as_json(), "kind").sisters == kind.sisters
    broken = kind.as_json() | {
        "sisters": {"presses": ["left"], "scatter": {CONTACT: {"between": 0.0, "within": 1.0}}}
    }
    with pytest.raises(InputError, match=r"broken: sisters is not as fit, diagnose and the nightly job write it"):
        parse_model(broken, "broken")


def test_sisters_with_other_effects_than_most_are_not_asked():
    most = [sister(f"press-{i}", [600.0, 620.0, 640.0], "edge_loss") for i in range(3)]
    other = [sister(f"other-{i}", [6000.0] * 3) for i in range(2)]
    learned = learned_from(PRESS, [*other, *most])
    assert learned.sisters.presses == ("press-0", "press-1", "press-2")
    assert [name for name, _ in learned.effects] == ["edge_loss"]
    assert learned.coefficients[CONTACT].value == pytest.approx(620.0, rel=0.05)
    assert dict(learned.effects)["edge_loss"]["W_m3K"].value == pytest.approx(1000.0, rel=0.1)
    assert learned_from(PRESS, []) is None


@pytest.fixture
def store(tmp_path):
    """Presses with models and fits, one of another kind and one whose model cannot be read."""
    ((run, _),) = make_campaign(51, 1, None, Plan(rate_hz=1.0, thickness_mm=16.0, press_time_s=(25.0, 40.0)))
    thick = press_toml(plates=Plates(0.02, 40.0, 7800.0, 470.0))
    with open_store(str(tmp_path / "kerntemp.sqlite")) as opened:
        for name, text, value in (("a", press_toml(), 600.0), ("b", press_toml(), 640.0), ("c", thick, 9000.0)):
            opened.import_run(replace(run, name=f"{name}-1"), name, text)
            model = ModelFile(f"{name}-model", name, {CONTACT: FittedValue(value, 50.0)})
            opened.put_model(name, model.version, model.as_json())
            opened.promote_model(model.version, "test")
            mark = fingerprint(opened.run_record(f"{name}-1"), parse_press(text), model)
            opened.put_fit(f"{name}-1", {**fit_entry(value), "fingerprint": mark}, model.version)
        opened.import_run(replace(run, name="d-1"), "d", press_toml())
        opened.put_model("d", "d-model", {"coefficients": {CONTACT: {"value": -1.0}}})
        opened.promote_model("d-model", "test")
        yield opened


def test_a_new_press_begins_with_those_of_its_kind_and_its_model_says_so(store):
    learned = begin_with_sisters(store, "new", PRESS, "test")
    active = store.active_model("new")
    assert (active.version, learned.sisters.presses) == (learned.version, ("a", "b"))
    assert 600.0 < learned.coefficients[CONTACT].value < 660.0
    assert active.reason == "learned from 2 presses of the same kind: a, b"
    assert active.model["basis"]["reason"]["code"] == "model-from-sisters"
    assert begin_with_sisters(store, "new", PRESS, "test") is None, "it has a model now"
    assert store.active_model("a").version == "a-model"


def test_a_press_that_is_not_to_learn_has_no_model_before_its_own_pressings(store):
    list(refit_presses(store, {"new": PRESS}, workers=1))
    assert store.active_model("new") is None
    list(refit_presses(store, {"new": PRESS}, workers=1, learning=["new"]))
    assert store.active_model("new").model["sisters"]["presses"] == ["a", "b"]


def test_the_night_in_which_a_press_learned_from_its_sisters_says_so_and_the_next_one_does_not(store):
    outcomes = []
    for _ in range(2):
        (outcome,) = refit_presses(store, {"new": PRESS}, workers=1, learning=["new"])
        (night,) = store.nights(press="new", limit=1).items
        outcomes.append((outcome.promoted, night.night["promoted"], night.night["reason"]["code"]))
    version = store.active_model("new").version
    assert outcomes[0] == (True, version, "model-from-sisters")
    assert outcomes[1][:2] == (False, "")


def test_the_live_sensor_begins_with_sisters_unless_its_press_is_not_to(store):
    logger = {"name": "x", "profile": "m-7018", "host": "127.0.0.1", "channels": ["platen_top"]}
    for name, learns in (("alone", False), ("new", True)):
        settings = PressSettings(name=name, file="press.toml", logger=(logger,), sisters=learns)
        sense = Follower(store, settings, PRESS, RunFits(store, name, PRESS, None))
        sense.model.refresh()
        assert (sense.model.file is not None) == learns
    assert sense.model.file.sisters.presses == ("a", "b")


@pytest.mark.parametrize(("known", "promoted"), [(Sisters(("a", "b"), {}), True), (None, False)])
def test_the_same_effects_found_by_its_own_runs_take_the_place_of_its_sisters_model(
    store, monkeypatch, known, promoted
):
    """Its sisters' sizes scatter; of a model of its own runs, a diagnosis like it is no news."""
    rim = ModelFile("d-model", "d", {}, (("edge_loss", {"W_m3K": FittedValue(1000.0, 300.0)}),), sisters=known)
    (record,) = store.pressings("d", limit=1)
    records = [replace(record, run=f"d-{i}") for i in range(6)]
    fits = {r.run: {"rmse_K": 0.3} for r in records}
    report = {"verdict": "named", "base": {}, "extended": {}}
    own = replace(rim, effects=(("edge_loss", {"W_m3K": FittedValue(1100.0, 50.0)}),), sisters=None)
    monkeypatch.setattr(night_judgement, "_diagnose", lambda night, asked: (report, own, []))
    monkeypatch.setattr(night_judgement, "_fits_with", lambda night, candidate, runs: {r: fits[r] for r in runs})
    monkeypatch.setattr(night_comparison, "_core_rmse", lambda *_: None)
    night = night_judgement.NightBasis(store, "d", PRESS, rim, records, fits)
    outcome = night_judgement.judge_night(night, night_judgement.NightOutcome("d", 6, 0, 0, "d-model"))
    assert outcome.promoted is promoted
    assert not promoted or "sisters" not in store.active_model("d").model
