"""A night of several presses: what goes wrong in one press's ends that one alone, whoever works on it."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from api.cli import main
from daq.simulated.campaign_pressfile import press_toml
from daq.store import open_store
from daq.words import Message
from softsensor.jobs import nights as fleet
from softsensor.jobs.night import refit_press
from softsensor.jobs.nights import refit_presses
from softsensor.jobs.retention import Rules
from softsensor.jobs.run_reader import PROCESS
from tests.softsensor import test_night
from tests.softsensor.test_night import PRESS, configured

store, runs, judging_nothing = test_night.store, test_night.runs, test_night.judging_nothing
FAULTS = {
    "an effect that nothing knows": "effect 'law_of_a_plugin_gone' is not in the catalogue",
    "a model file that nobody foresaw": "unexpected fault",
    "a press file that cannot be read": "north.toml",
}


def harm(fault, store, folder):
    """Let the press north have a fault."""
    if fault == "a press file that cannot be read":
        (folder / "north.toml").write_text("[press", encoding="utf-8")
        return
    effects = [{"name": "law_of_a_plugin_gone", "parameters": {}}]
    store.put_model("north", "north-1", {"coefficients": {}, "effects": effects})
    store.promote_model("north-1", "test")
    if fault == "a model file that nobody foresaw":
        with store.database.writing() as connection:
            connection.exec_driver_sql("UPDATE model SET model_json = 'no JSON'")


def night_of_three(folder, runs, fault, *options):
    """Run the nightly job for three presses of which north has a fault; return how it ended, and what it left."""
    configured(folder)
    config = folder / "kerntemp.toml"
    text = config.read_text(encoding="utf-8")
    before, table = text[: text.index("[[press]]")], text[text.index("[[press]]") :]
    tables = [table.replace('"lab"', f'"{name}"').replace("press.toml", f"{name}.toml") for name in THREE]
    config.write_text(before + "".join(tables), encoding="utf-8")
    with open_store(str(folder / "kerntemp.sqlite")) as store:
        for name in THREE:
            (folder / f"{name}.toml").write_text(press_toml(), encoding="utf-8")
            store.import_runs([replace(runs[0], name=f"{name}-run")], name, press_toml())
        harm(fault, store, folder)
        ended = main(["refit", "--config", str(config), *options])
        nights, alarms = store.newest_nights(), store.journal(level="alarm").items
        fitted = [name for name in THREE if store.fit(f"{name}-run")]
        return ended, fitted, nights, alarms, store.statuses()


THREE = ("east", "north", "west")


def only_north_failed(found, fault):
    """Hold a night of three presses against what it must leave."""
    ended, fitted, nights, alarms, statuses = found
    assert (ended, fitted) == (1, ["east", "west"])
    assert {name: night.night["verdict"] == "failed" for name, night in nights.items()} == {
        name: name == "north" for name in THREE
    }
    (alarm,) = [entry for entry in alarms if entry.message.code == "night-failed"]
    assert alarm.press == "north"
    assert FAULTS[fault] in str(alarm.message)
    assert FAULTS[fault] in str(Message.from_json(nights["north"].night["reason"]))
    assert PROCESS in statuses, "the job came to its end"


@pytest.mark.parametrize("workers", ["1", "2"])
@pytest.mark.parametrize("fault", FAULTS)
def test_whatever_one_press_has_the_others_have_their_nights(fault, workers, tmp_path, runs, capsys):
    found = night_of_three(tmp_path, runs, fault, "--workers", workers)
    only_north_failed(found, fault)
    output = capsys.readouterr()
    assert "north: the nightly job failed" in output.err
    assert FAULTS[fault] in output.err
    assert len(output.err.strip().splitlines()) == 1


@pytest.mark.campaign
@pytest.mark.parametrize("fault", FAULTS)
def test_whatever_one_press_has_the_others_have_their_nights_on_dask(fault, tmp_path, runs):
    from dask.distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
        found = night_of_three(tmp_path, runs, fault, "--dask", cluster.scheduler_address)
    only_north_failed(found, fault)


def test_a_press_whose_night_failed_goes_on_where_the_night_before_ended(store, runs, judging_nothing):
    store.import_runs(runs[:2], "lab", press_toml())
    before = refit_press(store, "lab", PRESS, workers=1)
    store.put_model("lab", "odd", {"coefficients": {}, "effects": [{"name": "gone", "parameters": {}}]})
    store.promote_model("odd", "test")
    (failed,) = refit_presses(store, {"lab": PRESS}, workers=1)
    assert (failed.verdict, failed.runs) == ("failed", 2)
    with store.database.writing() as connection:
        connection.exec_driver_sql("UPDATE model SET status = 'retired'")
    (after,) = refit_presses(store, {"lab": PRESS}, workers=1)
    assert (before.new, after.new, after.fitted) == (2, 0, 0)


class WorkersGone(Exception):
    """What no worker says, but the way to them."""


def test_presses_left_when_the_workers_are_lost_are_worked_on_here(store, judging_nothing, monkeypatch):
    def lost(*_):
        raise WorkersGone("the line is dead")
        yield

    monkeypatch.setattr(fleet, "handed_out", lost)
    outcomes = list(refit_presses(store, {"left": PRESS, "right": PRESS}, workers=2))
    assert [o.press for o in outcomes] == ["left", "right"]
    messages = [entry.message.code for entry in store.journal(level="warning").items]
    assert sorted(messages) == ["night-workers-killed"] * 2 + ["night-workers-lost"]


@pytest.mark.parametrize("fault", ["sisters", "archive"])
def test_a_press_that_cannot_ask_its_sisters_or_the_archive_has_its_night(
    store, fault, tmp_path, judging_nothing, monkeypatch
):
    def broken(*_):
        raise WorkersGone(fault)

    monkeypatch.setattr(fleet, {"sisters": "begin_with_sisters", "archive": "keep_house"}[fault], broken)
    rules = Rules(tmp_path, timedelta(days=1), None, 60.0, datetime.now(UTC))
    (outcome,) = refit_presses(store, {"lab": PRESS}, workers=1, rules=rules, learning=["lab"])
    assert outcome.verdict != "failed"
    (alarm,) = store.journal(level="alarm").items
    assert (alarm.press, fault in str(alarm.message)) == ("lab", True)
