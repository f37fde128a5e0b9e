"""Event-model documents, checked with that model's own library."""

import json
from datetime import UTC, datetime

import event_model
import numpy as np
import pytest

from daq.files.documents import documents_of, json_lines
from daq.records import Run

EPOCH = datetime.fromtimestamp(0.0, UTC)
RUN = Run(
    "2026-03-04-07",
    {"panel.material": "MDF", "panel.thickness_mm": 16.0},
    np.array([0.0, 0.5, 1.1]),
    {"top_1": np.array([20.8, np.nan, 61.2]), "closed": np.array([0.0, 0.0, 1.0])},
)


def test_every_document_passes_the_models_own_schema_and_refers_to_the_right_one():
    documents = list(documents_of(RUN, datetime.fromtimestamp(1772607600.0, UTC)))
    assert [name for name, _ in documents] == ["start", "descriptor", "event", "event", "event", "stop"]
    for name, content in documents:
        event_model.schema_validators[event_model.DocumentNames[name]].validate(content)
    router = event_model.RunRouter([lambda name, start: ([], [])])
    for name, content in documents:
        router(name, content)


def test_a_reader_of_the_model_gets_the_runs_values_back():
    seen = {}

    class Reader(event_model.DocumentRouter):
        def event(self, doc):
            seen[doc["seq_num"]] = (doc["time"], doc["data"]["top_1"])

    reader = Reader()
    for name, content in documents_of(RUN, datetime.fromtimestamp(100.0, UTC)):
        reader(name, content)
    np.testing.assert_array_equal([t for t, _ in seen.values()], 100.0 + RUN.time_s)
    np.testing.assert_array_equal([v for _, v in seen.values()], RUN.columns["top_1"])


def test_lines_of_json_say_null_for_a_missing_value_and_are_the_same_each_time():
    lines = list(json_lines(RUN, EPOCH))
    assert json.loads(lines[3])[1]["data"]["top_1"] is None
    assert json.loads(lines[0])[1]["header"]["panel:material"] == "MDF"
    assert lines == list(json_lines(RUN, EPOCH))


def test_a_column_has_the_unit_it_is_known_to_have_and_else_none():
    run = Run("r", {}, np.arange(2.0), {"top_1": np.ones(2), "position_mm": np.ones(2), "load": np.ones(2)})
    documents = list(documents_of(run, EPOCH, {"top_1": "C", "load": ""}))
    keys = documents[1][1]["data_keys"]
    assert {name: key.get("units") for name, key in keys.items()} == {
        "top_1": "C",
        "position_mm": None,
        "load": None,
    }
    for name, content in documents:
        event_model.schema_validators[event_model.DocumentNames[name]].validate(content)


def test_an_interrupted_run_says_so_and_one_that_goes_on_has_no_stop_yet():
    assert list(documents_of(RUN, EPOCH, ended="abort"))[-1][1]["exit_status"] == "abort"
    assert [name for name, _ in documents_of(RUN, EPOCH, ended=None)][-1] == "event"


def test_names_and_header_values_that_the_model_does_not_allow_are_told_in_its_way():
    began = datetime(2026, 3, 4, 7, tzinfo=UTC)
    header = {"shifts": [began, 2], "panel": {"lot.number": 7}, "limit": float("inf"), "a": "1", "note": "x/y"}
    columns = {"Temp. oben": np.ones(2), "load kg/m2": np.ones(2), "Temp: oben": np.zeros(2)}
    run = Run("r", header, np.arange(2.0), columns, texts={"said.by": ("eva", "")})
    documents = list(documents_of(run, EPOCH, {"load kg/m2": "kg/m2"}))
    for name, content in documents:
        event_model.schema_validators[event_model.DocumentNames[name]].validate(content)
    kept = documents[0][1]["header"]
    assert kept == {
        "shifts": [began.isoformat(), 2],
        "panel": {"lot:number": 7},
        "limit": "inf",
        "a": "1",
        "note": "x/y",
    }
    keys = documents[1][1]["data_keys"]
    assert list(keys) == ["Temp: oben", "load kg:m2", "Temp: oben_", "said:by"]
    assert keys["load kg:m2"]["source"] == "kerntemp:load kg/m2"
    assert keys["load kg:m2"]["units"] == "kg/m2"
    assert documents[2][1]["data"] == {"Temp: oben": 1.0, "load kg:m2": 1.0, "Temp: oben_": 0.0, "said:by": "eva"}
    for line in json_lines(run, EPOCH):
        json.loads(line, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))


def test_the_documents_of_a_run_of_unknown_date_say_so_and_count_from_its_start():
    documents = dict(documents_of(RUN, None))
    assert (documents["start"]["time_unknown"], documents["start"]["time"]) == (True, 0.0)
    event_model.schema_validators[event_model.DocumentNames.start].validate(documents["start"])
    assert "time_unknown" not in dict(documents_of(RUN, EPOCH))["start"]
