"""The next panel: said before, in the run's header and files afterwards; and what became of it."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import httpx
import pytest

from daq.files.run_file import read_run
from daq.records import Channel, Quality, Scan
from daq.simulated.campaign_pressfile import press_toml
from daq.store.records import NewRun, RunEnd
from daq.store.store import open_store

BEFORE = {"panel.thickness_mm": 16.0, "panel.moisture_percent": 8.0}
MDF = {"panel.material": "MDF", "panel.thickness_mm": 19.0, "setting.core_target_C": 85.0}


@pytest.fixture(scope="module")
def writer(tokens):
    return {"Authorization": f"Bearer {tokens.create('operator', 'write')}"}


@pytest.fixture
def plant(tmp_path, serve_any, writer):
    """A store with one press, a client that may write, and how to press a panel there."""
    with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
        key = store.register_press("lab", (Channel("platen_top"), Channel("platen_bottom")), "")
        store_url = serve_any(store)
        number = iter(range(1000))

        def press_a_panel(started: datetime | None = None) -> str:
            n, started = next(number), started or datetime.now(UTC)
            scan = Scan(n, started, 10.0 * n, (200.0, 200.0), (Quality.GOOD,) * 2)
            begun = NewRun(f"lab-{n}", n, started, 10.0 * n, BEFORE)
            store.append_scans(key, [scan], begin=begun)
            store.append_scans(key, [], end=RunEnd(f"lab-{n}", n, started))
            return f"lab-{n}"

        with httpx.Client(base_url=store_url + "/api/v1", headers=writer, timeout=240) as client:
            yield store, client, press_a_panel


def test_a_run_begins_with_what_was_said_of_the_panel_and_keeps_the_rest(plant):
    store, client, press_a_panel = plant
    start = {"panel.initial_temperature_C": 23.5, "panel.initial_temperature_C.sd": 1.5}
    answer = client.put("/press/next", json={"header": {**MDF, **start}}).json()
    assert (answer["press"], answer["who"]) == ("lab", "operator")
    first, second = (store.run_record(press_a_panel()).header for _ in range(2))
    assert {key: first[key] for key in MDF} == MDF
    assert (first["panel.moisture_percent"], first["panel.initial_temperature_C"]) == (8.0, 23.5)
    assert second["panel.thickness_mm"] == 19.0
    assert start.items() <= first.items()
    assert start.keys().isdisjoint(second)  # of one panel only
    assert client.get("/press/next").json()["header"] == MDF


def test_a_panel_that_was_in_the_press_before_is_not_changed(plant):
    store, client, press_a_panel = plant
    client.put("/press/next", json={"header": MDF})
    run = press_a_panel(datetime.now(UTC) - timedelta(minutes=1))
    assert store.run_record(run).header["panel.thickness_mm"] == 16.0


def test_neither_a_recipe_nor_a_material_is_named_with_characters_that_nobody_sees(plant):
    store, client, press_a_panel = plant
    run = press_a_panel()
    unseen = {"panel.material": "MDF\u202e"}
    answers = [
        client.put("/press/next", json={"recipe": "MDF\u200b 19", "header": MDF}),
        client.put("/press/next", json={"recipe": "91 FDM\u202e", "header": MDF}),
        client.put("/press/next", json={"header": unseen}),
        client.patch(f"/runs/{run}", json={"header": unseen}),
    ]
    assert [answer.status_code for answer in answers] == [422] * 4
    assert all("\u202e" not in answer.text and "\u200b" not in answer.text for answer in answers)
    assert store.recipes() == {}


def test_a_recipe_is_kept_by_name_chosen_again_and_named_in_the_run(plant):
    store, client, press_a_panel = plant
    client.put("/press/next", json={"recipe": "MDF 19", "header": {**MDF, "panel.initial_temperature_C": 30.0}})
    assert client.put("/press/next", json={}).json()["header"] == {}
    assert store.run_record(press_a_panel()).header["panel.thickness_mm"] == 16.0
    answer = client.put("/press/next", json={"recipe": "MDF 19"}).json()
    assert (answer["recipe"], answer["header"], answer["recipes"]) == ("MDF 19", MDF, {"MDF 19": MDF})
    assert store.run_record(press_a_panel()).header["recipe"] == "MDF 19"
    refused = client.put("/press/next", json={"recipe": "oak"})
    assert (refused.status_code, "MDF 19" in refused.json()["detail"]) == (422, True)


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ({"panel.thickness_mm": 0.0}, "panel.thickness_mm"),
        ({"panel.thicknes_mm": 16.0}, "panel.thickness_mm"),
        ({"setting.core_target_C": "hot"}, "setting.core_target_C"),
        ({"panel.verdict": "good"}, "panel.verdict"),
    ],
)
def test_a_panel_that_cannot_be_is_refused_by_name(plant, header, says):
    _, client, _ = plant
    refused = client.put("/press/next", json={"header": header})
    assert refused.status_code == 422
    assert says in refused.json()["detail"]
    assert client.get("/press/next").json()["header"] == {}


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ({"boundary.topp.incident_W_m2": 6e4}, "boundary.topp"),
        ({"layer.plate_botom.thickness_mm": 9.0}, "layer.plate_botom"),
        ({"coefficients.h_pp_c.guess": -5.0}, "coefficients.h_pp_c"),
    ],
)
def test_an_override_that_the_press_file_does_not_take_is_refused_before_a_run_begins_with_it(plant, header, says):
    store, client, _ = plant
    store.register_press("lab", (Channel("platen_top"), Channel("platen_bottom")), press_toml())
    refused = client.put("/press/next", json={"header": header})
    assert refused.status_code == 422
    assert says in refused.json()["detail"]
    taken = client.put("/press/next", json={"header": {"coefficients.h_pp_c.guess": 800.0}})
    assert taken.status_code == 200


def test_a_material_without_constants_is_refused_unless_the_configuration_gives_them(plant, serve_any, writer):
    store, client, _ = plant
    unknown = {"panel.material": "unobtainium"}
    refused = client.put("/press/next", json={"header": unknown})
    assert refused.status_code == 422
    assert "unobtainium" in refused.json()["detail"]
    assert client.get("/press/next").json()["header"] == {}
    own = {"panel.density_kg_m3": 600.0, "panel.conductivity_W_mK": 0.1, "panel.heat_capacity_J_kgK": 1500.0}
    url = serve_any(store, headers={"lab": own})
    taken = httpx.put(url + "/api/v1/press/next", json={"header": unknown}, headers=writer, timeout=240)
    assert taken.status_code == 200


@pytest.mark.parametrize(
    ("header", "code"),
    [
        ({"panel.initial_temperature_C": 190.0}, "header-start-hot"),
        ({"panel.thickness_mm": 190.0}, "panel-not-pressed-before"),
    ],
)
def test_a_panel_unlike_all_before_is_taken_with_a_doubt(plant, header, code):
    store, client, press_a_panel = plant
    press_a_panel()
    answer = client.put("/press/next", json={"header": header}).json()
    assert [doubt["code"] for doubt in answer["doubts_said"]] == [code]
    assert client.get("/press/next").json()["doubts"] == answer["doubts"]
    assert [str(line.message) for line in doubts_in_journal(store)] == [f"press lab: {answer['doubts'][0]}"]
    usual = {"panel.initial_temperature_C": 21.0, "panel.thickness_mm": 16.2}
    assert client.put("/press/next", json={"header": usual}).json()["doubts"] == []


def test_who_may_only_read_changes_neither_panel_nor_verdict(plant, tokens):
    _, client, press_a_panel = plant
    reader = {"Authorization": f"Bearer {tokens.create('reader', 'read')}"}
    run = press_a_panel()
    assert client.put("/press/next", json={"header": MDF}, headers=reader).status_code == 403
    assert client.put(f"/runs/{run}/verdict", json={"verdict": "good"}, headers=reader).status_code == 403


def test_a_verdict_stands_in_list_run_and_file_with_who_said_it(plant, tmp_path):
    store, client, press_a_panel = plant
    run = press_a_panel()
    assert client.get(f"/runs/{run}/verdict").json() == {"run": run, "verdict": None, "who": None, "utc": None}
    client.put(f"/runs/{run}/verdict", json={"verdict": "good"})
    answer = client.put(f"/runs/{run}/verdict", json={"verdict": "blister"}).json()
    assert (answer["verdict"], answer["who"]) == ("blister", "operator")
    assert client.get("/runs").json()["items"][0]["verdict"] == "blister"
    assert [c["after"] for c in client.get(f"/runs/{run}").json()["changes"]] == ["good", "blister"]
    file = tmp_path / "run.csv"
    file.write_bytes(client.get(f"/runs/{run}/samples", params={"format": "csv"}).content)
    assert read_run(file).header["panel.verdict"] == "blister"
    assert client.put(f"/runs/{run}/verdict", json={"verdict": None}).json()["verdict"] is None
    journal = [str(entry.message) for entry in store.journal(limit=3).items]
    assert f"run {run}: panel marked: blister" in journal
    assert f"run {run}: mark of the panel taken back" in journal


@pytest.mark.parametrize("verdict", ["fine", "", 1, None])
def test_a_verdict_nobody_knows_is_refused(plant, verdict):
    _, client, press_a_panel = plant
    run = press_a_panel()
    assert client.patch(f"/runs/{run}", json={"header": {"panel.verdict": verdict or "x"}}).status_code == 422
    if verdict is not None:
        assert client.put(f"/runs/{run}/verdict", json={"verdict": verdict}).status_code == 422


DOUBTFUL = {"panel.material": "MDF", "panel.density_kg_m3": 400.0}


def doubts_in_journal(store):
    return [line for line in store.journal(limit=200).items if line.level == "warning"]


def test_a_panel_far_from_the_material_table_is_taken_with_a_doubt_in_answer_and_journal(plant):
    store, client, _ = plant
    answer = client.put("/press/next", json={"header": DOUBTFUL}).json()
    assert answer["header"] == DOUBTFUL
    [doubt] = answer["doubts"]
    assert "panel.density_kg_m3 = 400" in doubt
    assert answer["doubts_said"][0]["code"] == "header-far-from-table"
    [line] = doubts_in_journal(store)
    assert (line.process, line.press, str(line.message)) == ("operator", "lab", f"press lab: {doubt}")
    assert client.get("/press/next").json()["doubts"] == [doubt]
    sure = client.put("/press/next", json={"header": DOUBTFUL | {"panel.density_kg_m3": 731.0}}).json()
    assert sure["doubts"] == []


def test_a_change_of_a_run_that_is_doubtful_is_taken_with_a_doubt_told_once(plant):
    store, client, press_a_panel = plant
    run = press_a_panel()
    known = {**DOUBTFUL, "panel.initial_temperature_C": 21.0}
    answer = client.patch(f"/runs/{run}", json={"header": known}).json()
    [doubt] = answer["doubts"]
    assert "panel.density_kg_m3 = 400" in doubt
    assert client.patch(f"/runs/{run}", json={"remark": "light"}).json()["doubts"] == [doubt]
    [line] = doubts_in_journal(store)
    assert (line.process, str(line.message)) == ("operator", f"run {run}: {doubt}")


def test_a_run_that_begins_is_doubted_by_what_configuration_and_next_panel_say_together(plant):
    store, client, press_a_panel = plant
    client.put("/press/next", json={"header": {"panel.moisture_percent": 8.0, "panel.colour": "red"}})
    before = len(doubts_in_journal(store))
    first, second = press_a_panel(), press_a_panel()
    client.put("/press/next", json={"header": DOUBTFUL})
    third = press_a_panel()
    messages = [(str(line.message), line.process) for line in reversed(doubts_in_journal(store)[:-before])]
    assert [process for _, process in messages] == ["record", "operator", "record"]
    assert messages[0][0].startswith(f"run {first}: header key panel.colour")
    assert messages[2][0].startswith(f"run {third}: header key panel.density_kg_m3 = 400")
    assert not [text for text, _ in messages if second in text]  # as the run before: told already
