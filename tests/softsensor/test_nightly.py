"""The nightly job: only what changed, nothing lost, the old model in place until a better one is proved."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from daq.pressfile import parse_press
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.store import open_store
from softsensor import nightly
from softsensor.modelfile import Estimate, ModelFile, parse_model
from softsensor.nightly import Task, fit_all, refit_press, roll_back
from softsensor.nightly_report import write_report

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


def without_panel_sensors(run):
    return replace(
        run,
        name="blind",
        header=dict(run.header) | {"run": "blind"},
        columns={n: v for n, v in run.columns.items() if not n.startswith(("top", "bottom"))},
    )


def test_a_run_that_cannot_be_fitted_does_not_stop_the_others(store, runs):
    fill(store, [without_panel_sensors(runs[0]), *runs[1:3]])
    outcome = refit_press(store, "lab", PRESS, workers=1)
    assert (outcome.fitted, outcome.failed) == (2, 1)
    assert outcome.verdict == "too_few_runs"
    assert any("blind" in entry.message for entry in store.journal().items)


def test_a_run_that_cannot_be_fitted_is_named_once_and_tried_again_when_it_has_changed(store, runs):
    def nightly_job():
        outcome = refit_press(store, "lab", PRESS, workers=1)
        nightly.sign_off(store, [outcome])
        return outcome

    fill(store, [without_panel_sensors(runs[0])])
    first, second = nightly_job(), nightly_job()
    assert (first.failed, first.newly_unfit) == (1, 1)
    assert (second.failed, second.newly_unfit) == (1, 0)
    assert sum("could not be fitted" in entry.message for entry in store.journal().items) == 1
    assert store.statuses()["refit"].status["state"] == "done"
    store.annotate_run("blind", {"panel.density_kg_m3": 700.0}, "tester")
    assert nightly_job().newly_unfit == 1


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


def test_the_page_of_the_night_says_what_was_done(store, runs, tmp_path):
    fill(store, runs[:3])
    outcome = refit_press(store, "lab", PRESS, workers=1)
    page = write_report(store, outcome, tmp_path / "reports").read_text(encoding="utf-8")
    assert f"Model {outcome.version} was promoted" in page
    assert "3 of 3 runs were fitted anew, 0 could not be" in page
    assert all(run.name in page for run in runs[:3])
    assert "h_pp_c" in page
    assert [p.suffix for p in (tmp_path / "reports").iterdir()] == [".html"]


def test_a_folder_that_cannot_be_written_is_named(store, runs, tmp_path):
    fill(store, runs[:1])
    (tmp_path / "reports").write_text("in the way", encoding="utf-8")
    outcome = refit_press(store, "lab", PRESS, workers=1)
    with pytest.raises(InputError, match=r"reports.*cannot write the report"):
        write_report(store, outcome, tmp_path / "reports")


CONFIG = """
[store]
url = "kerntemp.sqlite"
[refit]
workers = 1
dask = "{dask}"
[[press]]
name = "lab"
file = "press.toml"
[[press.logger]]
name = "x"
profile = "m-7018"
host = "127.0.0.1"
channels = ["platen_top", "platen_bottom", "top_1", "bottom_1"]
"""


def configured(folder, dask=""):
    (folder / "press.toml").write_text(press_toml(), encoding="utf-8")
    (folder / "kerntemp.toml").write_text(CONFIG.format(dask=dask), encoding="utf-8")
    return [sys.executable, "-m", "api", "refit", "--config", str(folder / "kerntemp.toml")]


def values(fit):
    return {name: c["value"] for name, c in fit["coefficients"].items()}


@pytest.mark.campaign
def test_killed_at_any_moment_it_leaves_the_old_model_and_goes_on_next_time(tmp_path):
    plan = replace(PLAN, press_time_s=(40.0, 90.0))
    pressings = [run for run, _ in make_campaign(53, 12, "edge_loss", plan)]
    known = {n: Estimate(PRESS.coefficient(n).guess, 50.0) for n in PRESS.coefficient_names}
    command = configured(tmp_path)
    with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
        fill(store, pressings)
        store.put_model("lab", "lab-old", ModelFile("lab-old", "lab", known).as_json())
        store.promote_model("lab-old", "test")
        fitted = []
        for after in (0.3, 3.0, 4.5, 6.0, 8.0, 11.0):
            job = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            time.sleep(after)
            job.send_signal(signal.SIGKILL)
            job.wait()
            active = store.active_model("lab")
            parse_model(active.model, "model in force")
            assert active.version == "lab-old" or store.diagnoses(press="lab").items
            fitted.append(sum(store.fit(run.name) is not None for run in pressings))
        assert fitted == sorted(fitted)  # what was fitted stays fitted
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "edge_loss" in [name for name, _ in parse_model(store.active_model("lab").model, "model").effects]
        assert list((tmp_path / "reports").glob("lab-*.html"))


@pytest.fixture
def dask_address(tmp_path):
    """A scheduler and a worker, each a process of its own."""
    dask = str(Path(sys.executable).parent / "dask")
    file = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    begin = [
        dask,
        "scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--no-dashboard",
        "--scheduler-file",
        str(file),
    ]
    scheduler = subprocess.Popen(begin, **quiet)
    deadline = time.monotonic() + 60.0
    while not file.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    address = json.loads(file.read_text(encoding="utf-8"))["address"]
    worker = subprocess.Popen([dask, "worker", address, "--nthreads", "1", "--no-dashboard"], **quiet)
    yield address
    for process in (worker, scheduler):
        process.terminate()
        process.wait(30)


@pytest.mark.campaign
def test_dask_workers_find_what_local_ones_find(tmp_path, runs, dask_address):
    found = []
    for name, address in (("local", ""), ("dask", dask_address)):
        folder = tmp_path / name
        folder.mkdir()
        with open_store(str(folder / "kerntemp.sqlite")) as store:
            fill(store, runs)
            command = configured(folder, address)
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr
            found.append({run.name: values(store.fit(run.name)) for run in runs})
    local, dask = found
    assert dask == {run: pytest.approx(table, rel=1e-9) for run, table in local.items()}


@pytest.mark.campaign
def test_a_dask_scheduler_that_is_not_there_is_named(tmp_path, runs):
    command = configured(tmp_path, "tcp://127.0.0.1:9")
    with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
        fill(store, runs[:3])
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "tcp://127.0.0.1:9" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
