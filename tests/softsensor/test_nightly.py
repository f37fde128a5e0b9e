"""The nightly job: only what changed, nothing lost, the old model in place until a better one is proved."""

from dataclasses import replace

import pytest

from daq.pressfile import parse_press
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.store import open_store
from softsensor import nightly
from softsensor.modelfile import Estimate, ModelFile
from softsensor.nightly import Task, fit_all, refit_press, roll_back

PRESS = parse_press(press_toml())
PLAN = Plan(
    rate_hz=1.0, thickness_mm=16.0, start_before_s=6.0, closed_column=True,
    press_time_s=(25.0, 40.0), open_before_s=(6.0, 8.0), open_after_s=(20.0, 25.0),
)  # fmt: skip


@pytest.fixture
def store(tmp_path):
    with open_store(str(tmp_path / "kerntemp.sqlite")) as opened:
        yield opened


def fill(store, runs):
    for run in runs:
        store.import_run(run, "lab", "press file")


@pytest.fixture(scope="module")
def runs():
    return [run for run, _ in make_campaign(51, 4, None, PLAN)]


def test_runs_are_fitted_once_and_a_first_model_is_promoted(store, runs):
    fill(store, runs[:3])
    first = refit_press(store, "lab", PRESS, workers=1)
    assert (first.runs, first.fitted, first.failed) == (3, 3, 0)
    assert first.promoted
    model = store.active_model("lab")
    assert model is not None
    assert set(model.model["coefficients"]) == set(PRESS.coefficient_names)
    assert model.model["effects"] == []
    again = refit_press(store, "lab", PRESS, workers=1)
    assert (again.runs, again.fitted, again.promoted) == (3, 0, False)
    fill(store, runs[3:])
    store.annotate_run(runs[0].name, {"panel.density_kg_m3": 700.0}, "tester")
    third = refit_press(store, "lab", PRESS, workers=1)
    assert (third.runs, third.fitted) == (4, 2)
    assert store.active_model("lab").version == model.version


def test_a_job_killed_among_the_fits_goes_on_where_it_was(store, runs, monkeypatch):
    fill(store, runs[:3])
    whole = nightly.fit_stored
    left = [2]

    def dying(task):
        if left[0] == 0:
            raise KeyboardInterrupt
        left[0] -= 1
        return whole(task)

    with monkeypatch.context() as patched:
        patched.setattr(nightly, "fit_stored", dying)
        with pytest.raises(KeyboardInterrupt):
            refit_press(store, "lab", PRESS, workers=1)
    assert store.active_model("lab") is None
    assert refit_press(store, "lab", PRESS, workers=1).fitted == 1


def test_a_run_that_cannot_be_fitted_does_not_stop_the_others(store, runs):
    blind = replace(
        runs[0],
        name="blind",
        header=dict(runs[0].header) | {"run": "blind"},
        columns={n: v for n, v in runs[0].columns.items() if not n.startswith(("top", "bottom"))},
    )
    fill(store, [blind, *runs[1:3]])
    outcome = refit_press(store, "lab", PRESS, workers=1)
    assert (outcome.fitted, outcome.failed) == (2, 1)
    assert outcome.verdict == "too_few_runs"
    assert any("blind" in entry.message for entry in store.journal().items)


@pytest.mark.campaign
def test_workers_find_what_one_process_finds(store, runs):
    fill(store, runs)
    tasks = [Task(store.database.url.render_as_string(), PRESS, run.name, None) for run in runs]

    def values(results):
        return {run: {n: c["value"] for n, c in fit["coefficients"].items()} for run, fit, _ in results}

    alone = values(fit_all(tasks, 1))
    shared = values(fit_all(tasks, 2))
    assert shared == {run: pytest.approx(table, rel=1e-9) for run, table in alone.items()}


def test_the_model_before_comes_back_by_one_call(store, runs):
    fill(store, runs[:1])
    table = {n: Estimate(PRESS.coefficient(n).guess, 10.0) for n in PRESS.coefficient_names}
    for version in ("lab-1", "lab-2"):
        store.put_model("lab", version, ModelFile(version, "lab", table).as_json())
        store.promote_model(version, "test")
    assert roll_back(store, "lab") == "lab-1"
    assert store.active_model("lab").version == "lab-1"


def test_there_is_nothing_before_the_first_model(store):
    with pytest.raises(InputError, match="no earlier model"):
        roll_back(store, "lab")


@pytest.mark.campaign
def test_a_hidden_cause_is_named_and_the_better_model_promoted(store):
    fill(store, [run for run, _ in make_campaign(52, 12, "edge_loss", replace(PLAN, press_time_s=(40.0, 90.0)))])
    outcome = refit_press(store, "lab", PRESS)
    assert outcome.promoted
    assert "edge_loss" in outcome.reason
    assert store.active_model("lab").model["effects"][0]["name"] == "edge_loss"
