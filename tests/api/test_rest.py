import io
import json
import re
from datetime import UTC, datetime, timedelta
from xml.etree import ElementTree

import httpx
import numpy as np
import pyarrow.parquet as pq
import pytest
from sqlalchemy import event

from api.answers.events import press_event_of
from api.answers.health import health_of, hours_left, is_missed
from api.answers.schemas import ProcessHealth
from daq.materials import MATERIALS
from daq.records import Channel, Quality, Run, Scan
from daq.store import open_store
from daq.store.records import StoredPressEvent
from daq.words import Message
from daq.words.message import languages
from softsensor.heat.step_terms import BOILING_C
from tests.api.conftest import STARTED
from tests.curves import CURVES

RUN = "/api/v1/runs/lab-2026-03-04-01"
JSON = {"Content-Type": "application/json"}


def problem(answer: httpx.Response, status: int) -> dict[str, object]:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    document = answer.json()
    assert set(document) == {"type", "title", "status", "detail", "detail_said", "instance"}
    assert str(Message.from_json(document["detail_said"])) == document["detail"]
    assert document["status"] == status
    return document


def test_the_catalogue_of_words_is_handed_out_in_each_language_and_tagged(client):
    for language in languages():
        answer = client.get(f"/api/v1/messages/{language}")
        catalogue = answer.json()
        assert (catalogue["language"], catalogue["languages"]) == (language, list(languages()))
        assert "$language" in catalogue["messages"]["api-no-such-language"]
        again = client.get(f"/api/v1/messages/{language}", headers={"If-None-Match": answer.headers["etag"]})
        assert again.status_code == 304
    refused = problem(client.get("/api/v1/messages/tlh"), 404)
    assert refused["detail"] == "language tlh is not available; choose one of en, de"


def test_runs_come_newest_first_in_pages_whose_cursor_leads_to_the_next(client):
    first = client.get("/api/v1/runs", params={"limit": 2}).json()
    assert [run["run"] for run in first["items"]] == ["lab-2026-03-04-03", "lab-2026-03-04-02"]
    second = client.get("/api/v1/runs", params={"limit": 2, "cursor": first["next_cursor"]}).json()
    assert [run["run"] for run in second["items"]] == ["lab-2026-03-04-01"]
    assert second["next_cursor"] is None


def test_runs_are_filtered_by_status_material_and_time(client):
    def names(**filters: str) -> list[str]:
        items = client.get("/api/v1/runs", params=filters).json()["items"]
        return [item["run"][-2:] for item in items]

    assert names(status="open") == ["03"]
    assert names(material="oak") == []
    assert names(**{"from": "2026-03-04T07:05:00Z", "to": "2026-03-04T07:15:00Z"}) == ["02"]


def test_a_run_tells_its_header_its_columns_and_its_phases(client, campaign):
    run, truth = campaign[0]
    detail = client.get(RUN).json()
    assert detail["header"]["panel.thickness_mm"] == 16.0
    assert detail["columns"] == list(run.columns)
    assert [phase["state"] for phase in detail["phases"]] == ["open", "closed", "open"]
    assert detail["closed_s"] == pytest.approx(truth.moments.closed_s)


def test_samples_in_json_hold_the_measured_values_and_null_where_there_is_none(client, campaign):
    run, _ = campaign[0]
    samples = client.get(f"{RUN}/samples", params={"columns": "top_1,platen_top"}).json()
    assert list(samples["columns"]) == ["top_1", "platen_top"]
    assert samples["rows"] == len(run.time_s)
    assert samples["columns"]["platen_top"][5] == pytest.approx(run.columns["platen_top"][5], abs=1e-3)


def test_decimated_samples_keep_the_highest_and_lowest_value_of_every_column(client, campaign):
    run, _ = campaign[0]
    samples = client.get(f"{RUN}/samples", params={"max_points": 40}).json()
    assert samples["decimated"]
    assert len(samples["time_s"]) <= 40
    for name in ("top_1", "platen_top"):
        shown = [v for v in samples["columns"][name] if v is not None]
        assert max(shown) == pytest.approx(max(run.columns[name]), abs=1e-3)
        assert min(shown) == pytest.approx(min(run.columns[name]), abs=1e-3)


def test_samples_say_why_values_are_missing_also_where_they_are_decimated(client, store, campaign, tmp_path):
    from daq.files.run_file import read_run

    gaps = {name: np.flatnonzero(np.isnan(column)) for name, column in campaign[0][0].columns.items()}
    rows = {name: len(places) for name, places in gaps.items() if len(places)}
    assert rows, "the campaign has no missing value"
    for points in (None, 40):
        spans = client.get(f"{RUN}/samples", params={"max_points": points} if points else {}).json()["quality"]
        assert {s["column"]: 0 for s in spans}.keys() == rows.keys()
        assert {s["quality"] for s in spans} == {"open"}
        for name, count in rows.items():
            assert sum(s["rows"] for s in spans if s["column"] == name) == count
    for points in (None, 40):
        form = {"format": "csv"} | ({"max_points": points} if points else {})
        (tmp_path / "x.csv").write_bytes(client.get(f"{RUN}/samples", params=form).content)
        run = read_run(tmp_path / "x.csv")
        for i, quality in enumerate(run.texts.get("quality", ())):
            missing = {name for name, column in run.columns.items() if np.isnan(column[i])}
            assert set(quality.split()) == {f"{name}=open" for name in missing}


def test_samples_between_two_times_lie_between_them(client):
    samples = client.get(f"{RUN}/samples", params={"from": 3, "to": 6}).json()
    assert samples["rows"] > 10
    assert all(3 <= t <= 6 for t in samples["time_s"])


def test_a_downloaded_csv_is_a_run_file_that_reads_back_as_the_stored_run(client, store, tmp_path):
    from daq.files.run_file import read_run

    answer = client.get(f"{RUN}/samples", params={"format": "csv"})
    assert answer.headers["content-type"].startswith("text/csv")
    assert 'filename="lab-2026-03-04-01.csv"' in answer.headers["content-disposition"]
    path = tmp_path / "downloaded.csv"
    path.write_bytes(answer.content)
    there, here = store.load_run("lab-2026-03-04-01"), read_run(path)
    assert {k: v for k, v in here.header.items() if not k.startswith("recorded.")} == dict(there.header)
    assert here.header["recorded.started_utc"] == store.run_record("lab-2026-03-04-01").started_utc
    assert there.columns["top_3"].tolist() == pytest.approx(here.columns["top_3"].tolist(), nan_ok=True)


def test_parquet_carries_the_same_table(client):
    answer = client.get(f"{RUN}/samples", params={"format": "parquet"})
    table = pq.read_table(io.BytesIO(answer.content))
    assert table.column_names[0] == "time_s"
    assert table.num_rows == client.get(f"{RUN}/samples").json()["rows"]


def test_estimates_bound_the_core_from_both_sides(client):
    estimates = client.get(f"{RUN}/estimates").json()
    assert estimates["rows"] == len(estimates["core_C"]) > 50
    for low, core, high in zip(
        estimates["core_low_C"], estimates["core_C"], estimates["core_high_C"], strict=True
    ):
        assert low < core < high


def test_the_fit_of_a_run_and_the_history_of_coefficients_agree(client):
    fit = client.get(f"{RUN}/fit").json()
    history = client.get("/api/v1/coefficients").json()["items"]
    assert [point["run"][-2:] for point in history] == ["02", "01"]
    assert history[1]["coefficients"] == fit["coefficients"]


def test_a_run_without_a_fit_says_how_to_fit_it(client):
    document = problem(client.get("/api/v1/runs/lab-2026-03-04-03/fit"), 404)
    assert "kerntemp refit" in str(document["detail"])


def test_a_press_whose_recorder_is_silent_stands_as_nobody_knows(client):
    press = client.get("/api/v1/press").json()["items"][0]
    assert press["press"] == "lab"
    assert press["run"] == "lab-2026-03-04-03"
    assert press["state"] == press["estimate"]["state"] == "unknown"  # its newest scan is of last March
    assert (press["estimate"]["valid"], press["estimate"]["reason"]) == (False, "no scans")
    (advice,) = client.get("/api/v1/advice").json()["items"]
    assert advice["advice"]["sentence_said"]["arguments"]["why"]["code"] == "reason-no-scans"
    assert len(press["channels"]) == 16
    assert set(press["coefficients"]) == {"h_p_o", "h_p_c", "h_pp_o", "h_pp_c", "h_wa", "h_ap"}


def test_channels_models_diagnoses_and_events_are_lists(client):
    for path in ("channels", "models", "diagnoses", "events", "press"):
        document = client.get(f"/api/v1/{path}").json()
        assert set(document) == {"items", "next_cursor"}, path
        assert document["items"], path


@pytest.mark.parametrize("language", ["en", "de"])
def test_the_report_of_a_night_has_its_pictures_and_leads_to_the_runs(client, language):
    night = client.get("/api/v1/nights?press=lab&limit=1").json()["items"][0]["id"]
    answer = client.get(f"/api/v1/nights/{night}/report?language={language}")
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert f'<html lang="{language}">' in answer.text
    assert answer.text.count("<svg") == 3
    assert f'href="{client.base_url}/#/runs/' in answer.text  # whole: with a token the page is saved as a file
    assert client.get("/api/v1/nights/999/report").status_code == 404
    assert client.get(f"/api/v1/nights/{night}/report?language=xx").status_code == 404


def test_curves_of_a_diagnosis_are_asked_for_by_its_number_and_do_not_burden_the_list(client):
    newest = client.get("/api/v1/diagnoses?press=lab&limit=1").json()["items"][0]
    assert newest["has_curves"]
    assert "curves" not in newest["diagnosis"]
    answer = client.get(f"/api/v1/diagnoses/{newest['id']}/curves").json()
    assert answer["curves"]["places"][0]["plain_residual_K"] == CURVES["places"][0]["plain_residual_K"]
    assert client.get("/api/v1/diagnoses/999/curves").status_code == 404


def test_a_night_is_told_by_press_in_lists_and_numbers(client):
    document = client.get("/api/v1/nights?press=lab&limit=1").json()
    (night,) = document["items"]
    assert document["next_cursor"] is None
    assert (night["new"], night["fitted"], night["not_fitted"], night["refused"]) == (2, 1, 1, "2")
    assert night["left_out"][0]["why_said"]["code"] == "run-fit-killed"
    assert night["reason"] == "too few runs to judge by"
    assert client.get("/api/v1/nights?press=elsewhere").json()["items"] == []
    assert client.get("/api/v1/nights?pres=lab").status_code == 422
    numbers = client.get("/metrics").text
    assert 'kerntemp_night_runs{press="lab",what="new"} 2.0' in numbers
    assert 'kerntemp_night_seconds{press="lab"} 51.5' in numbers
    assert 'kerntemp_night_named{effect="edge_loss",press="lab"} 1.0' in numbers
    assert 'kerntemp_night_model{press="lab",what="refused"} 1.0' in numbers
    assert 'kerntemp_night_left_out{press="lab",why="run-fit-killed"} 1.0' in numbers
    assert 'kerntemp_night_failed{press="lab"} 0.0' in numbers
    assert "kerntemp_night_memory_bytes{" not in numbers  # not known here


def test_health_names_the_process_that_is_missing_and_the_alarm_that_stands(client, store):
    store.beat("record", {"state": "running"})  # that of the fixture may be old on a busy machine
    health = client.get("/api/v1/health").json()
    assert health["status"] == "degraded"
    assert health["store"]["size_bytes"] > 10_000
    assert any("sense" in alarm for alarm in health["alarms"])
    assert "logger platens: no reply in 2 s" in health["alarms"]
    assert {p["name"]: p["alive"] for p in health["processes"]} == {"record": True, "sense": False}


@pytest.mark.parametrize(
    ("kind", "age_s", "state", "missed"),
    [
        ("record", 60.0, "stopped", True),
        ("publish", 2.0, "running", False),
        ("publish", 60.0, "running", True),
        ("publish", 60.0, "stopped", False),
        ("publish", 8 * 86400.0, "running", False),
        ("publish", None, "silent", False),
        ("refit", 60.0, "running", False),
    ],
)
def test_a_process_that_died_is_missed_but_not_a_feed_that_was_switched_off(kind, age_s, state, missed):
    alive = age_s is not None and age_s < 10.0
    process = ProcessHealth(name=f"{kind}@pc", alive=alive, state=state, message="", utc=None, age_s=age_s)
    assert is_missed(process) is missed


def test_how_long_the_disk_lasts_is_told_only_after_enough_was_recorded(client):
    assert client.get("/api/v1/health").json()["store"]["hours_left"] is None  # 1500 scans so far
    assert hours_left(17_000_000, 10**9, 5_999, 10.0) is None
    assert hours_left(15_000_000, 10**9, 60_000, 10.0) is None
    assert hours_left(18_000_000, 10**9, 60_000, 10.0) == pytest.approx(92.6)


def test_imported_runs_do_not_shorten_how_long_the_disk_lasts(tmp_path):
    channels = tuple(Channel(f"top_{i}") for i in range(40))
    table = np.round(np.random.default_rng(0).normal(100.0, 30.0, (60_000, 40)), 2)
    began = datetime(2026, 3, 4, tzinfo=UTC)
    with open_store(str(tmp_path / "s.sqlite")) as store:
        columns = {c.name: table[:, i] for i, c in enumerate(channels)}
        store.import_run(Run("old", {}, np.arange(60_000.0), columns), "lab")
        key = store.register_press("lab", channels)
        good = (Quality.GOOD,) * 40
        rows = table[:7000].tolist()
        store.append_scans(
            key, [Scan(i, began + timedelta(seconds=i / 10), i / 10, tuple(x), good) for i, x in enumerate(rows)]
        )
        sizes = store.sizes()
        assert health_of(store, datetime.now(UTC)).store.hours_left is None, "nobody records"
        store.beat("record", {"state": "running", "presses": [{"press": "lab", "rate_hz": 5.0, "speed": 2.0}]})
        hours_left = health_of(store, datetime.now(UTC)).store.hours_left
        expected = store.sizes().free_bytes / (sizes.bytes / 67_000 * 10.0 * 3600.0)
    assert hours_left == pytest.approx(expected, rel=0.05)


def test_health_asks_the_store_as_often_however_many_presses_there_are(tmp_path):
    asked, counts = [], []
    with open_store(str(tmp_path / "s.sqlite")) as store:
        store.presses()
        event.listen(store.database.engine, "before_cursor_execute", lambda *arguments: asked.append(arguments[2]))
        for count in (1, 30):
            for number in range(count):
                key = store.register_press(f"press-{number}", (Channel("top_1"),))
                now = datetime.now(UTC)
                store.append_scans(key, [Scan(key.next_number, now, 0.0, (20.0,), (Quality.GOOD,))])
            asked.clear()
            assert health_of(store, now).store.size_bytes > 0
            counts.append(len(asked))
        assert store.sizes().bytes_per_scan == pytest.approx(store.sizes().bytes / 31)
    assert counts[0] == counts[1]


def test_metrics_speak_prometheus(client, store):
    store.beat("record", {"state": "running"})  # that of the fixture may be old on a busy machine
    text = client.get("/metrics").text
    assert 'kerntemp_process_up{process="record"} 1.0' in text
    assert 'kerntemp_press_state{press="lab",state="unknown"} 1.0' in text
    assert "kerntemp_scans_total" in text


@pytest.mark.parametrize(
    ("path", "status", "says"),
    [
        ("/api/v1/runs/nothing", 404, "does not exist"),
        ("/api/v1/runs?limit=0", 422, "limit"),
        ("/api/v1/runs?cursor=abc", 422, "cursor"),
        ("/api/v1/runs?from=2026-03-04T07:00:00", 422, "no time zone"),
        ("/api/v1/runs?from=2026", 422, "must be an instant, such as 2026-03-04T07:00:00Z"),
        ("/api/v1/runs?to=20260304", 422, "must be an instant, such as 2026-03-04T07:00:00Z"),
        ("/api/v1/runs?from=2026-03-04T25:00:00Z", 422, "must be an instant, such as 2026-03-04T07:00:00Z"),
        ("/api/v1/runs?status=gone", 422, "status"),
        (f"{RUN}/samples?format=xml", 422, "format"),
        (f"{RUN}/samples?columns=nope", 404, "no column"),
        (f"{RUN}/samples?max_points=1", 422, "max_points"),
        ("/api/v1/models/99", 404, "does not exist"),
        ("/api/v1/nothing", 404, ""),
        ("/static/../app.py", 404, ""),
        ("/static/%2e%2e/app.py", 404, ""),
    ],
)
def test_every_refusal_is_a_problem_document_that_says_what_is_wrong(client, path, status, says):
    document = problem(client.get(path), status)
    assert says in str(document["detail"])


def test_a_method_that_is_not_offered_is_a_problem_too(client):
    problem(client.delete("/api/v1/runs"), 405)


def test_a_refused_method_names_those_the_path_has(client):
    methods = {"get", "post", "put", "patch", "delete"}
    for path, offered in client.get("/api/v1/openapi.json").json()["paths"].items():
        has = {method.upper() for method in offered.keys() & methods}
        has |= {"HEAD"} if "GET" in has and path != "/api/v1/live" else set()
        for method in sorted(methods - offered.keys()):
            refused = client.request(method, path.replace("{", "").replace("}", ""))
            assert refused.status_code == 405, path
            assert set(refused.headers["allow"].split(", ")) == has, path
    assert client.delete("/static/index.html").headers["allow"] == "GET, HEAD"


def test_an_answer_that_has_not_changed_is_not_sent_again(client):
    first = client.get(f"{RUN}/fit")
    again = client.get(f"{RUN}/fit", headers={"If-None-Match": first.headers["etag"]})
    assert again.status_code == 304
    assert again.content == b""


def test_long_answers_are_compressed(client):
    answer = client.get(f"{RUN}/samples")
    assert answer.headers["content-encoding"] == "gzip"


def test_the_page_and_the_api_pages_ask_nothing_of_another_host(client):
    for path in ("/", "/docs", "/static/app.js", "/static/docs.js", "/static/style.css"):
        answer = client.get(path)
        assert answer.status_code == 200, path
        assert "http://" not in answer.text.replace("http://www.w3.org", "")
        assert "https://" not in answer.text
        assert "default-src 'self'" in answer.headers["content-security-policy"]


def test_every_reference_of_the_openapi_document_leads_to_a_schema(client):
    text = client.get("/api/v1/openapi.json").text
    named = set(re.findall(r'"\$ref": ?"([^"]+)"', text))
    assert named
    assert named <= {f"#/components/schemas/{name}" for name in json.loads(text)["components"]["schemas"]}


def test_the_openapi_document_describes_every_error_as_a_problem(client):
    described = client.get("/api/v1/openapi.json").json()
    assert "Problem" in described["components"]["schemas"]
    for path, methods in described["paths"].items():
        for operation in methods.values():
            for status, answer in operation["responses"].items():
                if status.startswith("4"):
                    assert list(answer["content"]) == ["application/problem+json"], path
    assert "HTTPValidationError" not in json.dumps(described)


def test_a_run_is_simulated_at_every_sensor_position_with_its_fitted_coefficients(client):
    simulation = client.get(f"{RUN}/simulation").json()
    assert list(simulation["positions"]) == ["panel.top", "panel.bottom"]
    rows = len(simulation["time_s"])
    assert {len(v) for v in (*simulation["positions"].values(), *simulation["measured"].values())} == {rows}
    assert len(simulation["profile_C"]) == len(simulation["profile_time_s"])
    assert simulation["profile_depth_mm"][-1] == 16.0
    assert simulation["boiling_C"] == BOILING_C
    panel, profile = client.get(RUN).json()["header"], np.array(simulation["profile_C"])
    warmer = np.trapezoid(profile[-1] - profile[0], simulation["profile_depth_mm"]) / 1e3
    heat = panel["panel.density_kg_m3"] * MATERIALS["MDF"].heat_capacity.value * warmer / 1e3
    assert simulation["profile_heat_kJ_m2"][-1] == pytest.approx(heat, rel=0.01)
    inserted = client.get(RUN).json()["phases"][0]["from_s"]
    measured = [t for t, v in zip(simulation["time_s"], simulation["measured"]["panel.top"], strict=True) if v]
    assert measured[0] >= inserted > simulation["time_s"][0]  # hands on sensors before it are nothing measured


def test_a_run_is_asked_what_if_by_whoever_may_read(client):
    was = client.get(f"{RUN}/what-if").json()
    longer = client.get(
        f"{RUN}/what-if", params={"press_time_s": was["settings"]["press_time_s"]["was"] + 30}
    ).json()
    assert longer["settings"]["press_time_s"]["value"] == pytest.approx(
        was["settings"]["press_time_s"]["was"] + 30
    )
    assert longer["opened_s"] == pytest.approx(was["opened_s"] + 30, abs=0.01)
    assert longer["at_opening"]["core_C"][1] > was["at_opening"]["core_C"][1] + 1
    assert (was["at_opening"]["cure"], was["at_opening"]["grade"]) == ([None] * 3, "")  # no resin file
    refused = client.get(f"{RUN}/what-if", params={"press_time_s": 2})
    assert (refused.status_code, refused.json()["detail_said"]["code"]) == (422, "api-request-invalid")
    assert "press_time_s" in refused.json()["detail"]


def test_the_figure_is_an_svg_that_names_the_run(client):
    answer = client.get(f"{RUN}/figure.svg")
    assert answer.headers["content-type"].startswith("image/svg+xml")
    root = ElementTree.fromstring(answer.text)
    assert root.tag.endswith("svg")
    texts = [text.text or "" for text in root.iter("{http://www.w3.org/2000/svg}text")]
    assert any("lab-2026-03-04-01" in text for text in texts)
    assert {"Platens", "Core as predicted live, with its 95 % band"} <= set(texts)
    paths = list(root.iter("{http://www.w3.org/2000/svg}path"))
    assert [p.get("fill") for p in paths if p.get("opacity") == ".18"]
    assert [p.get("stroke-dasharray") for p in paths if p.get("fill") == "none"][-2:] == ["none", "6 4"]


def test_the_figure_speaks_the_language_that_is_asked_for(client):
    assert "temperature [°C]" in client.get(f"{RUN}/figure.svg").text
    german = client.get(f"{RUN}/figure.svg?language=de").text
    assert all(text in german for text in ("Temperatur [°C]", "Platte, Oberseite", "geschlossen"))
    assert client.get(f"{RUN}/figure.svg?language=xx").status_code == 404


def test_what_people_write_down_is_kept_with_its_history(client, tokens, store):
    writer = {"Authorization": f"Bearer {tokens.create('foreman', 'write')}"}
    other = "/api/v1/runs/lab-2026-03-04-02"
    before = client.get(other).json()["header"]["panel.density_kg_m3"]
    changes = {"remark": "Plate had a dent.\nTop left.", "header": {"panel.density_kg_m3": 712.5, "order": "A-17"}}
    changed = client.patch(other, json=changes, headers=writer).json()
    assert changed["remark"] == "Plate had a dent.\nTop left."
    assert changed["header"]["panel.density_kg_m3"] == 712.5
    assert changed["header"]["order"] == "A-17"
    assert [(c["who"], c["field"], c["before"], c["after"]) for c in changed["changes"]] == [
        ("foreman", "panel.density_kg_m3", before, 712.5),
        ("foreman", "order", None, "A-17"),
        ("foreman", "remark", "", "Plate had a dent.\nTop left."),
    ]
    assert client.get("/api/v1/events").json()["items"][0]["process"] == "foreman"
    removed = client.patch(other, json={"header": {"order": None}}, headers=writer).json()
    assert "order" not in removed["header"]
    same = client.patch(other, json=changes | {"header": {}}, headers=writer).json()
    assert len(same["changes"]) == 4
    assert client.get(other).json() == same


def test_a_body_that_is_not_said_to_be_json_is_told_how(client, tokens):
    writer = {"Authorization": f"Bearer {tokens.create('curl', 'write')}"}
    answer = client.patch(RUN, data={"remark": "x"}, headers=writer)
    assert "Content-Type: application/json" in str(problem(answer, 422)["detail"])


def test_metadata_changes_only_with_a_token_that_may_write(client, tokens):
    reader = {"Authorization": f"Bearer {tokens.create('visitor', 'read')}"}
    problem(client.patch(RUN, json={"remark": "x"}), 401)
    problem(client.patch(RUN, json={"remark": "x"}, headers=reader), 403)
    assert client.get(RUN).json()["remark"] == ""


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"header": {"panel.thickness_mm": -5.0}}, "from 0.1 to 500"),
        ({"header": {"panel.thickness_mm": "thick"}}, "must be a number"),
        ({"header": {"panel.thickness_mm": None}}, "panel.thickness_mm is missing"),
        ({"header": {"panel": 3}}, "header.panel"),
        (
            {"header": {"setting.pressure_N_cm2": "high"}},
            "header.setting.pressure_N_cm2 = 'high': must be a number",
        ),
        ({"header": {"setting.press_time_s": True}}, "header.setting.press_time_s"),
        ({"header": {"ambient.temperature_C": "warm"}}, "header.ambient.temperature_C"),
        ({"header": {"layer.plate_top.colour": "blue"}}, "colour = 'blue': unknown key"),
        ({"header": {"ambient.temperature_C": -500.0}}, "ambient.temperature_C = -500.0: must be a number from"),
        ({"header": {"panel.thicknes_mm": 16.0}}, "did you mean panel.thickness_mm"),
        ({"header": {"panel.thickness_mm.sd": 0}}, "a standard deviation must be a positive number"),
        ({"header": {"run": "other"}}, "header.run"),
        ({"header": {"two words": 1}}, "header"),
        ({"header": {"x": [1, 2]}}, "header.x"),
        ({"header": {"x": 10**400}}, "header.x"),
        ({"remark": "bell \u0007"}, "body.remark"),
        ({"remark": "half \ud800"}, "remark"),
        ({"remark": 5}, "remark"),
        ({"remark": "x" * 4001}, "remark"),
        ({"colour": "blue"}, "colour"),
        ([], "body"),
    ],
)
def test_metadata_that_could_not_be_used_is_refused_by_name_and_changes_nothing(client, tokens, changes, says):
    writer = {"Authorization": f"Bearer {tokens.create('clerk', 'write')}"}
    try:
        answer = client.patch(RUN, content=json.dumps(changes), headers=writer | JSON)
        assert says in str(problem(answer, 422)["detail"])
        assert client.get(RUN).json()["changes"] == []
    finally:
        tokens.revoke("clerk")


def test_a_change_that_leaves_no_panel_to_reckon_with_is_refused_with_the_reason(client, tokens):
    writer = {"Authorization": f"Bearer {tokens.create('joiner', 'write')}"}
    unknown = {"panel.material": "Unobtainium", "panel.density_kg_m3": None}
    answer = client.patch(RUN, json={"header": unknown}, headers=writer)
    assert "Unobtainium" in str(problem(answer, 422)["detail"])
    answer = client.patch(RUN, json={"header": unknown | {"panel.initial_temperature_C": 5000}}, headers=writer)
    problem(answer, 422)


def test_the_simulation_and_the_figure_follow_a_change_of_the_header(client, tokens):
    writer = {"Authorization": f"Bearer {tokens.create('weigher', 'write')}"}
    other = "/api/v1/runs/lab-2026-03-04-02"
    density = client.get(other).json()["header"]["panel.density_kg_m3"]
    before = client.get(f"{other}/simulation").json(), client.get(f"{other}/figure.svg").text
    client.patch(other, json={"header": {"panel.density_kg_m3": 0.5 * density}}, headers=writer)
    after = client.get(f"{other}/simulation").json(), client.get(f"{other}/figure.svg").text
    client.patch(other, json={"header": {"panel.density_kg_m3": density}}, headers=writer)
    assert max(after[0]["core_C"]) > max(before[0]["core_C"]) + 2
    assert after[1] != before[1]


@pytest.mark.parametrize(
    "path", ["/", "/docs", "/metrics", "/api/v1/health", "/api/v1/runs", RUN, f"{RUN}/figure.svg"]
)
def test_head_answers_like_get_without_the_body(client, path):
    asked = client.head(path)
    assert asked.status_code == 200
    assert asked.content == b""
    assert asked.headers["content-type"] == client.get(path).headers["content-type"]
    assert client.head("/api/v1/runs/nothing").status_code == 404
    assert client.head("/api/v1/live").status_code == 405


def test_a_tag_is_known_with_and_without_its_sign_of_weakness(client):
    strong = client.get(f"{RUN}/fit").headers["etag"].removeprefix("W/")
    assert client.get(f"{RUN}/fit", headers={"If-None-Match": f'"x", {strong}'}).status_code == 304
    assert client.get(f"{RUN}/fit", headers={"If-None-Match": '"x"'}).status_code == 200


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_run_file_is_not_sent_again_until_the_run_is_another(client, tokens, form):
    other = "/api/v1/runs/lab-2026-03-04-02"
    writer = {"Authorization": f"Bearer {tokens.create(f'clerk-{form}', 'write')}"}
    asked = {"params": {"format": form}}
    tag = client.get(f"{other}/samples", **asked).headers["etag"]
    same = client.get(f"{other}/samples", **asked, headers={"If-None-Match": tag})
    assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", tag)
    client.patch(other, json={"header": {"batch": form}}, headers=writer)
    assert client.get(f"{other}/samples", **asked, headers={"If-None-Match": tag}).status_code == 200


def test_who_refuses_gzip_gets_none(client):
    answer = client.get(f"{RUN}/samples", headers={"Accept-Encoding": "gzip;q=0, identity"})
    assert "content-encoding" not in answer.headers


def test_a_misspelt_filter_is_refused_with_those_there_are(client):
    detail = str(problem(client.get("/api/v1/runs?matrial=oak"), 422)["detail"])
    assert detail.startswith("query.matrial")
    assert "material" in detail
    problem(client.get("/api/v1/models/1?full=1"), 422)
    problem(client.get(f"{RUN}/samples", params={"columns": ","}), 422)
    assert client.get("/api/v1/runs?cursor=").json() == client.get("/api/v1/runs").json()


def test_decimated_values_stand_at_the_times_they_were_measured_at(client, campaign):
    run, _ = campaign[0]
    samples = client.get(f"{RUN}/samples", params={"max_points": 60}).json()
    rows = np.searchsorted(run.time_s, np.asarray(samples["time_s"]) - 1e-6)
    assert len(run.time_s) > 2 * samples["rows"] > 60
    for name, values in samples["columns"].items():
        shown = np.array([np.nan if v is None else v for v in values])
        assert shown == pytest.approx(run.columns[name][rows], abs=1e-3, nan_ok=True), name


def test_decimated_estimates_keep_the_highest_and_the_lowest(client):
    whole = client.get(f"{RUN}/estimates").json()
    thin = client.get(f"{RUN}/estimates", params={"max_points": 9}).json()
    assert thin["rows"] <= 9
    assert (max(thin["core_C"]), min(thin["core_C"])) == (max(whole["core_C"]), min(whole["core_C"]))
    pairs = set(zip(whole["time_s"], whole["core_C"], strict=True))
    assert set(zip(thin["time_s"], thin["core_C"], strict=True)) <= pairs


@pytest.mark.parametrize("points", [2, 3, 4, 7])
def test_even_two_points_span_the_measured_values(client, campaign, points):
    run, _ = campaign[0]
    samples = client.get(f"{RUN}/samples", params={"max_points": points, "columns": "top_1"}).json()
    assert 2 <= samples["rows"] <= points
    assert max(samples["columns"]["top_1"]) == pytest.approx(max(run.columns["top_1"]), abs=1e-3)


def test_notes_and_press_events_stand_in_the_journal_and_a_note_is_refused_without_leave(client, tokens, store):
    writer = {"Authorization": f"Bearer {tokens.create('shift-2', 'write')}"}
    problem(client.post("/api/v1/events", json={"press": "lab", "text": "x"}), 401)
    problem(client.post("/api/v1/events", json={"press": "nowhere", "text": "x"}, headers=writer), 404)
    kept = client.post("/api/v1/events", json={"press": "lab", "text": "steam at the left"}, headers=writer).json()
    assert (kept["process"], kept["message"]) == ("shift-2", "Note: steam at the left")
    assert client.get("/api/v1/events?process=shift-2&limit=1").json()["items"] == [kept]
    pressed = client.get("/api/v1/events?kind=press&limit=3").json()
    assert {one["press"] for one in pressed["items"]} == {"lab"}
    following = client.get(f"/api/v1/events?kind=press&cursor={pressed['next_cursor']}").json()["items"]
    stored = store.press_events("lab")
    assert [int(one["id"]) for one in (*pressed["items"], *following)] == [e.number for e in reversed(stored)]
    assert {store.run_record(one["run"]).press for one in following if one["run"]} == {"lab"}


def test_a_press_event_of_a_time_nobody_knows_has_none():
    event = press_event_of(StoredPressEvent(7, "lab", "closes", None, 12.0, 12.5, 30, "temperatures"), "lab-01")
    assert json.loads(event.model_dump_json())["utc"] is None


def test_a_note_is_answered_with_its_own_line_whatever_the_same_hand_keeps_meanwhile(store):
    line = store.note("lab", "steam at the left", "tablet")
    store.note("lab", "steam at the right", "tablet")
    assert line.message.arguments["text"] == "steam at the left"


def test_scans_between_two_instants_keep_each_peak_in_its_step_of_time(client, store, campaign):
    asked = {"press": "lab", "from": STARTED.isoformat(), "to": (STARTED + timedelta(minutes=10)).isoformat()}
    answer = client.get("/api/v1/scans", params={**asked, "points": 50}).json()
    run, _ = campaign[0]
    step = (run.time_s / answer["step_s"]).astype(int)
    assert answer["step_s"] == 12.0
    assert answer["scans"] == np.bincount(step, minlength=50).tolist()
    for name, values in run.columns.items():
        for i in range(50):
            own = values[(step == i) & np.isfinite(values)]
            expected = [None, None] if not len(own) else [own.min(), own.max()]
            assert [answer["columns"][name][side][i] for side in ("low", "high")] == pytest.approx(
                expected, abs=1e-4
            )
    late = {**asked, "to": (STARTED + timedelta(hours=26)).isoformat()}
    for wrong, status in ((late, 422), ({**asked, "to": asked["from"]}, 422), ({**asked, "press": "none"}, 404)):
        assert client.get("/api/v1/scans", params=wrong).status_code == status
