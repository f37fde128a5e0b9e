"""Kerntemp from Python: what goes in comes out, results are those of the command line, errors too."""

import ast
import doctest
import html
import inspect
import json
import math
import pickle
import re
import subprocess
import sys
import warnings
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from datetime import UTC, datetime
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from types import FunctionType
from typing import get_args, get_type_hints
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import daq
import softsensor
from api.cli import main
from daq.face import COEFFICIENT, ENTRY, ESTIMATE, EVENT, RUN
from daq.files.run_file import read_run, write_run
from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.words import say
from softsensor.diagnosis.gains import Gain
from softsensor.diagnosis.laws.choice import Law
from softsensor.diagnosis.summary import core_messages, law_messages
from softsensor.effects import catalogue
from softsensor.effects.effect import LawOf
from softsensor.face import kinds
from softsensor.face.inputs import runs_of
from softsensor.heat.model_file import model_text
from softsensor.planning.summary import point_message
from tests.screens import COLUMNS, ROWS, flooding, parts_of, rows_of

ROOT = Path(__file__).resolve().parents[2]
LAB = ROOT / "deploy/presses/lab.toml"
SAMPLES = sorted((ROOT / "deploy/samples").glob("2026-*.csv"))
SHORT = SAMPLES[6]
CAUSES = tuple(catalogue())
HELD = {"thickness_mm": 16, "platen_temperature_C": 200, "start_temperature_C": 20, "waiting_s": 20}
PRESS_TIME = {name: (value, value) for name, value in HELD.items()} | {"press_time_s": (30, 60)}
"""Ranges of a plan in which nothing but the press time may change."""


@pytest.fixture(scope="module")
def fitted():
    return softsensor.fit(SAMPLES[5:8], LAB)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """What the command writes of the same runs."""
    place = tmp_path_factory.mktemp("fit")
    out = ["--json", str(place / "fit.json"), "--model", str(place / "model.json")]
    assert main(["fit", *[str(path) for path in SAMPLES[5:8]], "--press", str(LAB), *out]) == 0
    return place


def test_nothing_is_loaded_before_it_is_used():
    heavy = "('numba', 'pandas', 'scipy', 'sqlalchemy')"
    code = f"import sys, softsensor, daq; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


def test_reading_a_run_and_fitting_it_loads_no_pandas_and_no_live_sensor():
    asked = "softsensor.read_run('deploy/samples/2026-03-04-07.csv'), softsensor.read_press, softsensor.fit"
    unused = "('pandas', 'softsensor.diagnosis.search', 'softsensor.live', 'softsensor.planning')"
    code = f"import sys, softsensor; {asked}; print([m for m in {unused} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("package", [softsensor, daq])
def test_every_public_name_is_there_and_says_what_it_is(package):
    for name in package.__all__:
        assert getattr(package, name).__doc__
    with pytest.raises(AttributeError, match="it has"):
        _ = package.not_a_name


def public_words():
    """Return the docstrings that the reference shows, by the public name they are of."""
    for package in (softsensor, daq):
        for name in package.__all__:
            one = getattr(package, name)
            inside = (
                [member for member in vars(one).values() if hasattr(member, "__doc__")]
                if isinstance(one, type)
                else []
            )
            yield name, [words for words in (one.__doc__, *(m.__doc__ for m in inside)) if isinstance(words, str)]


def test_examples_of_the_reference_import_public_names_alone():
    private = re.compile(r"(?:from|import) (?:daq|softsensor|api)\.")
    lines = [
        (name, line.source)
        for name, of in public_words()
        for words in of
        for line in doctest.DocTestParser().get_examples(words)
    ]
    assert len(lines) > 100
    assert [(name, line) for name, line in lines if private.search(line)] == []


def fields_without_words(cls):
    """Return the public fields of a class, and those of them under which no words stand, its parents' included."""
    ours = [one for one in cls.__mro__ if one.__module__.partition(".")[0] in ("daq", "softsensor")]
    bodies = [ast.parse(inspect.getsource(one)).body[0].body for one in ours]
    pairs = [pair for body in bodies for pair in zip(body, [*body[1:], ast.Pass()], strict=True)]
    named, silent = [], []
    for node, following in pairs:
        target = getattr(node, "target", None) or next(iter(getattr(node, "targets", ())), None)
        if not isinstance(target, ast.Name) or target.id[0] == "_" or target.id == "model_config":  # pydantic's
            continue
        words = following.value if isinstance(following, ast.Expr) else None
        named.append(target.id)
        if not (isinstance(words, ast.Constant) and isinstance(words.value, str)):
            silent.append(target.id)
    return named, silent


def test_words_stand_under_every_field_of_every_public_class():
    public = {getattr(package, name) for package in (softsensor, daq) for name in package.__all__}
    found = {one.__name__: fields_without_words(one) for one in public if isinstance(one, type)}
    assert {"time_s", "core_C"} <= set(found["Estimate"][0])  # as a walk that finds no field finds no lack either
    assert {"NOTHING", "PANEL"} <= set(found["Need"][0])
    assert {name: silent for name, (_, silent) in found.items() if silent} == {}


@pytest.mark.parametrize("name", ["advise", "diagnose", "fit", "plan", "predict", "read_run", "simulate"])
def test_every_public_function_says_what_it_refuses(name):
    docstring = getattr(softsensor, name).__doc__
    assert "Raises\n    ------\n    InputError\n" in docstring


def test_every_error_that_a_public_name_says_it_raises_is_public():
    public = {name: getattr(package, name) for package in (softsensor, daq) for name in package.__all__}
    documented_by = {}
    for name, one in public.items():
        members = [member for key, member in vars(one).items() if key[0] != "_"] if isinstance(one, type) else []
        for documented in (one, *members):
            _, _, raised = inspect.cleandoc(documented.__doc__ or "").partition("Raises\n------\n")
            errors = re.findall(r"^(\w+)$", raised.partition("\n\n")[0], re.M)
            errors += re.findall(r"Raises `(\w+)`", documented.__doc__ or "")
            documented_by.update(dict.fromkeys(errors, name))
    assert documented_by.keys() >= {"InputError", "StoreUnavailable"}
    assert {error: name for error, name in documented_by.items() if error not in public} == {}


def test_a_nonphysical_coefficient_is_refused():
    with pytest.raises(daq.InputError):
        softsensor.simulate(SHORT, LAB, {"h_pp_c": -5.0})


def test_a_cause_that_the_catalogue_does_not_have_is_refused():
    with pytest.raises(daq.InputError, match="no_such"):
        softsensor.diagnose(SHORT, LAB, effects=["no_such"])


def own_classes(hint):
    """Return our classes in an annotation."""
    parts = [one for part in get_args(hint) for one in own_classes(part)]
    ours = isinstance(hint, type) and hint.__module__.partition(".")[0] in ("daq", "softsensor")
    return [*parts, hint] if ours else parts


def test_what_results_hold_is_public():
    public = {getattr(package, name) for package in (softsensor, daq) for name in package.__all__}
    results = [one for one in public if isinstance(one, type) and one.__module__.startswith("softsensor.face.")]
    held = {
        (result.__name__, found)
        for result in results
        for name, hint in get_type_hints(result, localns={"pd": pd, "Axes": object, **vars(kinds)}).items()
        if name[0] != "_"
        for found in own_classes(hint)
    }
    assert {found.__name__ for _, found in held} >= {"PressingPlan", "ProgrammeAdvice", "Simulated", "Combination"}
    assert {(of, found.__name__) for of, found in held if found not in public} == set()


def test_what_public_functions_take_and_give_is_public():
    from matplotlib.axes import Axes

    public = [getattr(package, name) for package in (softsensor, daq) for name in package.__all__]
    known = {one for one in public if isinstance(one, type)}
    asked = [one for one in public if isinstance(one, FunctionType)]
    asked += [softsensor.LiveSensor.__init__]
    for one in known:
        if one.__module__.startswith(("softsensor.face.", "daq.face")):
            members = [getattr(member, "fget", member) for name, member in vars(one).items() if name[0] != "_"]
            asked += [member for member in members if isinstance(member, FunctionType)]
    missing = {
        f"{function.__qualname__}: {found.__name__}"
        for function in asked
        for hint in get_type_hints(function, localns={"Axes": Axes, "pd": pd, **vars(kinds)}).values()
        for found in own_classes(hint)
        if found not in known
    }
    assert missing <= {"LiveSensor.mixture: Mixture"}  # what it weighs, for our own tests


def test_a_live_sensor_takes_what_the_other_functions_take_and_rows_as_pandas_has_them():
    table = daq.frame_of(softsensor.read_run(SHORT)).iloc[:40]
    by_hand = softsensor.LiveSensor(LAB, table.attrs)
    estimate = [by_hand.update(time_s, row) for time_s, row in table.iterrows()]
    replayed = softsensor.predict(softsensor.read_run(table), LAB).frame()
    assert [one.core_C for one in estimate if one.valid] == replayed.loc[replayed["valid"] == 1, "core_C"].tolist()
    gaps = softsensor.LiveSensor(LAB, table.attrs)
    assert gaps.update(0.0, {**table.iloc[0], "top_1": None, "top_2": pd.NA}).state is not None


def test_a_live_sensor_takes_a_stores_rows_with_their_qualities_and_remarks(tmp_path):
    daq.play(SAMPLES[6], tmp_path / "a.sqlite", "lab")
    with daq.open_store(tmp_path / "a.sqlite") as store:
        table = store.samples("2026-03-04-07").assign(note="by hand")
    assert table["quality"].str.len().max() > 0
    live = softsensor.LiveSensor(LAB, table.attrs)
    estimates = [live.update(time_s, row) for time_s, row in table.iterrows()]
    replayed = softsensor.predict(table, LAB).frame()
    assert [one.core_C for one in estimates if one.valid] == replayed.loc[
        replayed["valid"] == 1, "core_C"
    ].tolist()


def test_what_a_quality_calls_unusable_is_missing_whatever_number_stands_there():
    table = daq.frame_of(softsensor.read_run(SHORT)).iloc[:40]
    first, second = (softsensor.LiveSensor(LAB, table.attrs) for _ in range(2))
    for time_s, row in table.iterrows():
        named = first.update(time_s, {**row, "top_1": 999.0, "quality": "top_1=open"})
        left_out = second.update(time_s, {**row, "top_1": None})
    assert repr(named) == repr(left_out)


def test_a_platen_left_out_of_the_first_scan_is_read_from_the_next_on():
    table = daq.frame_of(softsensor.read_run(SHORT)).iloc[:40]
    live = softsensor.LiveSensor(LAB, table.attrs)
    rows = list(table.iterrows())
    assert not live.update(rows[0][0], rows[0][1].drop("platen_bottom")).valid
    assert [live.update(time_s, row) for time_s, row in rows[1:]][-1].valid


@pytest.mark.parametrize(
    ("time_s", "values", "expected"),
    [
        (1.0, {}, "a scan at 1 s after one at 1 s: times must rise"),
        (math.nan, {}, "times must rise"),
        (2.0, {"top_1": "20"}, "column top_1: '20' is not a number"),
        (2.0, None, "NoneType: a scan is given as a mapping of numbers by column"),
        (pd.Timestamp("2026-03-04", tz="UTC"), {}, "its time is given in seconds, as a number"),
    ],
)
def test_a_live_sensor_refuses_scans_that_cannot_be_and_goes_on(time_s, values, expected):
    table = daq.frame_of(softsensor.read_run(SHORT))
    sensor = softsensor.LiveSensor(LAB, table.attrs)
    sensor.update(1.0, table.iloc[0])
    with pytest.raises(daq.InputError, match=re.escape(expected)):
        sensor.update(time_s, values)
    assert sensor.update(3.0, table.iloc[1]).time_s == 3.0


@pytest.mark.parametrize("given", ["table", "mapping", "beside a run", "file"])
def test_a_header_key_that_nothing_knows_is_warned_of_from_python_in_the_words_of_the_command(given, tmp_path):
    run, odd = softsensor.read_run(SHORT), {"shift.supervisor": "Kurz"}
    path = tmp_path / "run.csv"
    path.write_text('# shift.supervisor = "Kurz"\n' + SHORT.read_text(encoding="utf-8"), encoding="utf-8")
    table = daq.frame_of(run)
    source, header = {"beside a run": (run, odd), "file": (path, None)}.get(given, (table, odd))
    if given == "table":
        table.attrs.update(odd)
        header = None
    with pytest.warns(UserWarning, match=r"^header key shift\.supervisor is not known; it is kept, and") as warned:
        read = softsensor.read_run(source, header=header)
    assert read.header["shift.supervisor"] == "Kurz"
    softsensor.read_run(read)  # what is known already is not said twice
    (one,) = warned
    assert one.filename == __file__  # at the line that gave it
    with pytest.warns(UserWarning, match="shift"):
        softsensor.LiveSensor(LAB, read.header)


def test_readings_in_kelvin_and_a_conductivity_no_board_has_are_warned_of_wherever_a_run_is_taken(
    capsys, tmp_path
):
    table = daq.frame_of(softsensor.read_run(SHORT))
    hot = table.copy()
    faces = [name for name in hot if name.startswith(("top_", "bottom_", "platen_"))]
    hot[faces] += 273.15
    with pytest.warns(UserWarning, match="are the readings in kelvin"):
        softsensor.simulate(hot, LAB)
    hot.attrs["panel.conductivity_W_mK"] = 120.0
    with pytest.warns(UserWarning, match="conductivity_W_mK = 120"):
        read = softsensor.read_run(hot)
    path = tmp_path / "kelvin.csv"
    write_run(read, path)
    assert main(["simulate", str(path), "--press", str(LAB), "--out", str(tmp_path / "core.csv")]) == 0
    output = " ".join(capsys.readouterr().err.split())
    assert "are the readings in kelvin" in output
    assert "120" in output


def test_a_run_that_a_store_does_not_have_is_refused_with_what_a_python_user_does_next(tmp_path):
    daq.play(SHORT, tmp_path / "runs.sqlite", "lab", scans=500)
    with daq.open_store(tmp_path / "runs.sqlite") as store:
        for ask in (store.samples, store.estimates):
            with pytest.raises(
                daq.InputError, match=r"run 'nope' is not in store .*; runs\(\) lists those that are"
            ):
                ask("nope")


@pytest.mark.parametrize(
    "value", [np.True_, True, Decimal("21.5"), Fraction(43, 2), np.float32(21.5), None, pd.NA, pd.NaT, math.nan]
)
def test_a_live_sensor_fed_by_hand_takes_every_number_and_gap_that_a_table_does(value):
    run = softsensor.read_run(SHORT)
    row = {**daq.frame_of(run).iloc[0].to_dict(), "top_1": value, "closed": 0}
    estimate = softsensor.LiveSensor(LAB, run.header).update(Decimal(0), row)
    table = pd.DataFrame({"time_s": [0.0], "top_1": pd.Series([value], dtype=object)})
    expected = math.nan if value is None or pd.isna(value) else float(value)
    assert daq.run_of(table).columns["top_1"].tolist() == pytest.approx([expected], nan_ok=True)
    assert math.isfinite(estimate.core_C)


@pytest.mark.parametrize(
    ("column", "value", "expected"),
    [
        ("closed", 7, r"column closed: 7 must be 0 \(open\) or 1 \(closed\)"),
        ("closed", 0.5, "column closed: 0.5 must be 0"),
        ("top_1", math.inf, "column top_1: infinite; must be a number"),
        ("top_1", 10**400, "column top_1: infinite; must be a number"),
        ("top_1", Decimal("sNaN"), "column top_1: .* is not a number"),
        ("top_1", 1j, "column top_1: 1j is not a number"),
    ],
)
def test_a_live_sensor_fed_by_hand_refuses_what_no_run_file_holds(column, value, expected):
    run = softsensor.read_run(SHORT)
    live = softsensor.LiveSensor(LAB, run.header)
    with pytest.raises(daq.InputError, match=expected):
        live.update(0.0, {**daq.frame_of(run).iloc[0].to_dict(), column: value})


@pytest.mark.parametrize("given", [[], {}, pd.DataFrame(), pd.Series([1.0]), 5])
@pytest.mark.parametrize(
    "ask",
    [
        softsensor.find_effect,
        daq.speak,
        lambda given: softsensor.fit(SHORT, LAB, method=given),
        lambda given: softsensor.advise(LAB, softsensor.ModelFile("m", "lab", {}), goal=given),
    ],
)
def test_what_is_no_name_is_refused_in_one_line_of_words(ask, given):
    with pytest.raises(daq.InputError, match=r"^\S+: names are given as one text or several$"):
        ask(given)


def test_a_live_sensor_takes_columns_whose_labels_are_no_texts_as_a_table_does():
    table = daq.frame_of(softsensor.read_run(SHORT)).assign(**{"7": 1.0}).rename(columns={"7": 7})
    live, run = softsensor.LiveSensor(LAB, table.attrs), softsensor.read_run(table)
    assert "7" in run.columns
    for time_s, row in table.iloc[:20].iterrows():
        newest = live.update(time_s, row)
    assert newest.core_C == softsensor.predict(run, LAB).frame()["core_C"].iloc[19]


def test_a_whole_number_beyond_all_floats_is_refused_in_words():
    with pytest.raises(daq.InputError, match=r"panel\.thickness_mm = 1000"):
        softsensor.read_run(SHORT, header={"panel.thickness_mm": 10**400})


def test_a_live_sensor_refuses_a_mistyped_header_at_once():
    with pytest.raises(daq.InputError, match=r"did you mean panel\.thickness_mm"):
        softsensor.LiveSensor(LAB, {"panel.thicknes_mm": 16.0})


def test_a_run_that_is_played_is_in_the_store_as_it_was(tmp_path):
    run = softsensor.read_run(SAMPLES[0])
    url = tmp_path / "played.sqlite"
    daq.play(run, url, "lab", scans=50)
    with daq.open_store(url) as store:
        assert store.runs().loc[run.name, "status"] == "closed"
        samples = store.samples(run.name)
        instants, began = store.samples(run.name, utc=True).index, store.runs().loc[run.name, "started_utc"]
    assert np.allclose((instants - began).total_seconds(), run.time_s, atol=1e-3)
    assert [name for name in samples.columns if name != "quality"] == list(run.columns)
    assert np.allclose(samples["top_1"], run.columns["top_1"], atol=1e-3, equal_nan=True)
    assert np.allclose(samples.index, run.time_s, atol=1e-6)
    assert samples.attrs["panel.material"] == "MDF"
    with pytest.raises(daq.InputError, match="is in the store already"):
        daq.play(run, url, "other")
    with daq.open_store(url) as store:
        assert list(store.runs().index) == [run.name]
        assert repr(store) == f"StoreTables {url}"


def test_a_run_that_is_played_keeps_qualities_texts_of_rows_and_remark(tmp_path):
    table = daq.frame_of(softsensor.read_run(SHORT, header={"remark": "left plate cleaned", "run": "played"}))
    table["quality"], table["note"] = "", ""
    table.iloc[3, table.columns.get_loc("quality")] = "top_3=open bottom_1=stale"
    table.iloc[5, table.columns.get_loc("quality")] = "top_2=late *=simulated"
    table.iloc[7, table.columns.get_loc("quality")] = "*=stale"
    table.iloc[8, table.columns.get_loc("quality")] = "top_3=late *=open"
    table.iloc[4, table.columns.get_loc("note")] = "door opened"
    run, url = softsensor.read_run(table), tmp_path / "played.sqlite"
    daq.play(run, url, "lab", scans=2)
    with daq.open_store(url) as store:
        samples, remark = store.samples("played"), store.runs().loc["played", "remark"]
    assert remark == samples.attrs["remark"] == "left plate cleaned"
    assert samples["note"].tolist() == list(run.texts["note"])
    pd.testing.assert_frame_equal(
        daq.qualities_of(daq.run_of(samples)).reset_index(drop=True), daq.qualities_of(run).reset_index(drop=True)
    )


def test_a_run_file_through_a_table_is_the_same_run():
    run = softsensor.read_run(SHORT)
    again = softsensor.read_run(daq.frame_of(run))
    assert again.name == run.name
    assert dict(again.header) == dict(run.header)
    assert again.time_s.tobytes() == run.time_s.tobytes()
    for name, values in run.columns.items():
        assert again.columns[name].tobytes() == values.tobytes()


KINDS = {
    "float64": st.one_of(st.none(), st.floats(-200.0, 1300.0)),
    "float32": st.one_of(st.none(), st.floats(-200.0, 1300.0, width=32)),
    "int64": st.integers(-(2**63), 2**63 - 1),
    "int8": st.integers(-128, 127),
    "Int64": st.one_of(st.none(), st.integers(-(2**63), 2**63 - 1)),
    "bool": st.booleans(),
    "boolean": st.one_of(st.none(), st.booleans()),
    "object": st.one_of(st.none(), st.booleans(), st.integers(-9, 9), st.floats(-200.0, 1300.0)),
    "str": st.sampled_from([None, "", "steady", "Brett schräg", "=1+1"]),
}
"""Columns of a table by pandas' name of their kind."""
ZONES = [None, "UTC", "Europe/Berlin", "America/St_Johns", "Asia/Kathmandu"]


@settings(deadline=None)
@given(
    data=st.data(),
    kinds=st.lists(st.sampled_from(sorted(KINDS)), min_size=1, max_size=5),
    rows=st.integers(1, 30),
    start=st.floats(0.0, 1e6),
    zone=st.sampled_from(ZONES),
    beside=st.booleans(),
)
def test_any_table_comes_back_as_it_went_in(data, kinds, rows, start, zone, beside):
    if zone is None:
        index = pd.Index(start + 0.5 * np.arange(rows), name="time_s")
    else:
        index = pd.date_range("2026-10-25 01:59:58", periods=rows, freq="500ms", tz=zone)
    columns = {
        f"c{i}_{kind}": pd.Series(data.draw(st.lists(KINDS[kind], min_size=rows, max_size=rows)), dtype=kind)
        for i, kind in enumerate(kinds)
    }
    frame = pd.DataFrame(columns).set_index(index).rename_axis(columns="channel")
    if zone is None and beside:
        frame = frame.reset_index().set_index(pd.date_range("2026-10-25", periods=rows, freq="1h", name="at"))
    frame.attrs["panel.material"] = "MDF"
    run = daq.run_of(frame)
    back = daq.frame_of(run, as_given=True)
    pd.testing.assert_frame_equal(back, frame)
    for name in frame:
        if name.endswith("_object"):
            assert list(map(type, back[name])) == list(map(type, frame[name]))
    some = run.at_rows(slice(rows // 2, None))
    pd.testing.assert_frame_equal(daq.frame_of(some), daq.frame_of(run).iloc[rows // 2 :])
    assert back.attrs == {"panel.material": "MDF", "run": run.name} | (
        {} if zone is None else {"recorded.started_utc": index[0].tz_convert("UTC").isoformat()}
    )
    by_seconds = daq.frame_of(run)
    assert by_seconds.index.name == "time_s"
    assert np.allclose(np.diff(by_seconds.index), 0.5)
    for name, values in frame.items():
        if name != "time_s" and not name.endswith("_str"):
            numbers = np.array([np.nan if pd.isna(v) else float(v) for v in values])
            assert run.columns[name].tobytes() == numbers.tobytes()
    if zone is not None:
        assert run.header["recorded.started_utc"] == index[0]
    pd.testing.assert_frame_equal(daq.frame_of(daq.run_of(by_seconds)), by_seconds)


def test_tables_of_results_know_the_run_they_are_about():
    run = softsensor.read_run(SHORT, header={"recorded.started_utc": datetime(2026, 3, 4, 7, tzinfo=UTC)})
    attributes = daq.frame_of(run).attrs
    assert softsensor.predict(run, LAB).frame().attrs == attributes
    assert softsensor.simulate(run, LAB).frame().attrs == attributes
    assert softsensor.fit(run, LAB).frame().attrs == attributes


def keyed(frame, key):
    """Return it with a key in its header."""
    frame.attrs[key] = 1.0
    return frame


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (pd.DataFrame({"top_1": [1.0]}), "the table has no times; give a column or an index time_s in seconds"),
        (
            pd.DataFrame({"top_1": [1.0]}, index=pd.period_range("2026-03-04", periods=1, freq="s")),
            r"no times; its index is of periods, so take table\.to_timestamp\(\)",
        ),
        (pd.DataFrame({"time_s": [], "top_1": []}), "the table has no rows"),
        (pd.DataFrame({"time_s": [1.0, 0.5], "top_1": [1.0, 2.0]}), "time_s"),
        (pd.DataFrame({"time_s": [0.0], "closed": [3.0]}), "column closed: 3 must be 0"),
        (pd.DataFrame({"time_s": [0.0], "top_1": [1.0 + 2.0j]}), "column top_1 holds complex numbers; give"),
        (pd.DataFrame({"time_s": [0.0], "top_1": pd.Series([2.0j], dtype=object)}), "top_1 holds complex numbers"),
        (pd.DataFrame([[0.0, 1.0]], columns=[["time_s", "top"], ["", "1"]]), "labels have 2 levels; join them"),
        (
            pd.DataFrame({"top_1": [1.0]}, index=pd.MultiIndex.from_tuples([("a", 0.0)], names=["run", "time_s"])),
            "the index has 2 levels .run, time_s.; give one run at a time",
        ),
        (keyed(pd.DataFrame({"time_s": [0.0], "top_1": [1.0]}), 7), "key 7 of attrs is not a text"),
    ],
)
def test_a_table_that_is_no_run_is_refused_with_what_to_do(frame, words):
    with pytest.raises(daq.InputError, match=words):
        softsensor.read_run(frame)


def test_numbers_of_numpy_are_numbers_in_a_header_and_others_are_shown_in_short():
    frame = daq.frame_of(softsensor.read_run(SHORT))
    frame.attrs["panel.thickness_mm"] = np.float32(16.0)
    assert softsensor.read_run(frame).header["panel.thickness_mm"] == 16.0
    assert softsensor.read_run(SHORT, header={"panel.density_kg_m3": np.int64(700)}).header is not None
    frame.attrs["panel.thickness_mm"] = pd.Series([16.0, 17.0])
    with pytest.raises(daq.InputError, match=r"thickness_mm = array \(2,\) from 16 to 17: must be a number"):
        softsensor.read_run(frame)


def test_one_switch_chooses_the_language_of_results_figures_and_refusals_and_no_json(fitted):
    english = fitted.to_json()
    with pytest.raises(daq.InputError, match="language tlh is not available; choose one of en, de"):
        daq.speak("tlh")
    daq.speak("de")
    try:
        with pytest.raises(daq.InputError, match="int: eine Presse wird mit dem Pfad"):
            softsensor.read_press(5)
        assert repr(softsensor.read_run(SHORT)).startswith("Pressung 2026-03-04-07: 127 Scans, 0 bis 125.995 s")
        assert repr(fitted.model()).startswith("Modell fit der Presse lab")
        assert [line.split()[0] for line in repr(fitted).splitlines()[-2:]] == ["Mittel", "Streuung"]
        drawn = [text.get_text() for text in fitted.plot()[0].figure.findobj(lambda one: hasattr(one, "get_text"))]
        assert any("Pressung" in text for text in drawn)
        assert fitted.to_json() == english
    finally:
        daq.speak("en")
    assert repr(softsensor.read_run(SHORT)).startswith("Run 2026-03-04-07: 127 scans")


@pytest.mark.parametrize(
    "use", [softsensor.fit, softsensor.diagnose, softsensor.predict, softsensor.simulate], ids=lambda f: f.__name__
)
@pytest.mark.parametrize("column", ["top_1", "platen_top"])
def test_words_in_a_column_that_the_press_file_names_are_refused_by_row(use, column):
    frame = daq.frame_of(softsensor.read_run(SHORT)).astype({column: object})
    frame.iloc[4, frame.columns.get_loc(column)] = "abc"
    with pytest.raises(daq.InputError, match=f"row 5: column {column}: 'abc' is not a number; leave a missing"):
        use(frame, LAB)


def test_numbers_kept_as_objects_are_the_same_run():
    frame = daq.frame_of(softsensor.read_run(SHORT))
    mixed = frame.astype(object).where(frame.notna(), None)
    ours, theirs = softsensor.read_run(mixed), softsensor.read_run(frame)
    assert all(ours.columns[name].tobytes() == values.tobytes() for name, values in theirs.columns.items())


def test_a_pattern_that_hides_nothing_is_refused_as_by_the_command(tmp_path, capsys):
    with pytest.raises(
        daq.InputError, match=r"no column of run '2026-03-04-07' matches zzz\*; it has platen_"
    ) as refused:
        softsensor.predict(SHORT, LAB, without=["top_*", "zzz*"])
    out = ["--out", str(tmp_path / "core.csv")]
    assert main(["predict", str(SHORT), "--press", str(LAB), "--without", "top_*, zzz*", *out]) == 2
    assert str(refused.value) in " ".join(capsys.readouterr().err.split())


def test_fit_gives_what_the_command_writes(fitted, written):
    content = json.loads((written / "fit.json").read_text())
    ours = json.loads(fitted.to_json())
    assert [r["run"] for r in ours["runs"]] == [r["run"] for r in content["runs"]]
    assert ours["campaign"] == content["campaign"]
    table = fitted.frame()
    first = content["runs"][0]
    for name, entry in first["coefficients"].items():
        assert table.loc[(first["run"], name), "value"] == pytest.approx(entry["value"], rel=1e-4)
    assert fitted.plot()
    assert len(repr(fitted)) < 3000


def test_a_fit_takes_what_the_command_takes(tmp_path):
    runs, out = [str(path) for path in SAMPLES[5:8]], tmp_path / "fit.json"
    paper = ["--method", "least_squares", "--averages"]
    assert main(["fit", *runs, "--press", str(LAB), "--shared", "h_pp_c", *paper, "--json", str(out)]) == 0
    found = softsensor.fit(runs, LAB, shared="h_pp_c", method="least_squares", averages=True)
    ours, theirs = json.loads(found.to_json()), json.loads(out.read_text())
    assert ours["campaign"] == theirs["campaign"]
    assert [r["coefficients"] for r in ours["runs"]] == [r["coefficients"] for r in theirs["runs"]]
    assert found.campaign.shared == ("h_pp_c",)
    with pytest.raises(daq.InputError, match="method annealing: must be one of default, least_squares"):
        softsensor.fit(runs, LAB, method="annealing")
    with pytest.raises(daq.InputError, match="averages goes with one of the paper's methods"):
        softsensor.fit(runs, LAB, averages=True)
    with pytest.raises(daq.InputError, match="shared h_x: must be one of h_p_o"):
        softsensor.fit(runs, LAB, shared=["h_x"])


def test_a_fit_of_one_run_tells_one_number_a_coefficient_and_no_scatter():
    one = softsensor.fit(SHORT, LAB)
    (run,) = one.campaign.runs
    text = repr(one)
    assert "nan" not in text.lower()
    assert len(text.splitlines()) == 2  # heads and the run: one run has neither mean nor scatter
    heads, row = (line.split() for line in text.splitlines())
    cells = dict(zip(heads, row[1:], strict=True))
    drawn = [ax.get_title(loc="left") for ax in one.plot()]
    titles = {title.split()[0]: title for title in drawn if title}
    assert cells.keys() == {*run.coefficients, "rmse_K"}
    assert {c.identifiable for c in run.coefficients.values()} == {True, False}
    for name, found in run.coefficients.items():
        if not found.identifiable:
            assert (cells[name], titles[name]) == ("–", f"{name} [W/m²K] is not known")
            continue
        assert titles[name] == f"{name} = {float(cells[name]):,g} W/m²K"
        half = (found.ci95[1] - found.ci95[0]) / 2
        assert abs(float(cells[name]) - found.value) <= 0.05 * half


ENDS = [
    ("opened", ["--until", "opened"]),
    ([45, "2026-03-04-07:bottom_1=60"], ["--until", "45", "--until", "2026-03-04-07:bottom_1=60"]),
]


@pytest.mark.parametrize(("until", "options"), ENDS)
def test_runs_end_from_python_where_the_command_lets_them_end(until, options, tmp_path):
    command = ["fit", *map(str, SAMPLES[5:8]), "--press", str(LAB), "--json", str(tmp_path / "fit.json"), *options]
    assert main(command) == 0
    found = softsensor.fit(SAMPLES[5:8], LAB, until=until)
    of_command = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    assert json.loads(found.to_json())["campaign"] == of_command["campaign"]
    assert len(found.campaign.runs[1].problem.case.run.time_s) < len(read_run(SHORT).time_s)


@pytest.mark.parametrize(
    ("until", "expected"),
    [
        ("lunch", "^until lunch: give seconds"),
        (None, None),
        (float("nan"), "^until nan: give seconds"),
        ("other:45", "^until other:45: no run 'other' is given"),
        (-1, r"until -1\.0 leaves 0 of"),
        ([[3]], "list: names are given"),
        (b"45", "bytes: names are given"),
    ],
)
def test_an_end_of_runs_that_cannot_be_is_refused_from_python(until, expected):
    if expected is None:
        assert len(runs_of(SHORT, softsensor.read_press(LAB), until)[0].time_s) == len(read_run(SHORT).time_s)
        return
    with pytest.raises(daq.InputError, match=expected):
        softsensor.diagnose(SHORT, LAB, until=until)


def test_a_diagnosis_has_its_runs_already(results):
    with pytest.raises(daq.InputError, match=r"^until: a diagnosis has its runs already"):
        softsensor.plan(results["diagnose"], LAB, until="opened")


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ({"effects": "edge_loss=much"}, "^edge_loss=much: the size must be a number"),
        ({"effects": "no_such"}, "no_such"),
        ({"campaigns": 0}, "^campaigns = 0: give a whole number of at least 1"),
        ({"workers": True}, "^workers = True: give"),
        ({"file": SHORT}, "holds something else than finished campaigns"),
        ({"file": ROOT}, "cannot write"),
        ({"file": 5}, "^int: a file is given by its path"),
    ],
)
def test_a_rehearsal_that_cannot_be_is_refused_in_words(results, asked, expected):
    with pytest.raises(daq.InputError, match=expected):
        softsensor.rehearse(results["diagnose"], **asked)
    with pytest.raises(daq.InputError, match=r"^str: a diagnosis is given as what diagnose returned"):
        softsensor.rehearse("diagnosis", **asked)


def test_a_rehearsal_tells_shares_with_their_intervals_and_keeps_what_is_finished(results, tmp_path):
    found, kept = results["rehearse"], tmp_path / "finished.jsonl"
    table = found.frame()
    assert list(table.index) == ["moisture_evaporation", "nothing"]
    assert (table["campaigns"] == 1).all()
    assert table.loc["nothing", ["wrong", "wrong_low"]].tolist() == [0.0, 0.0]
    assert table.loc["nothing", "wrong_high"] == pytest.approx(0.975)  # of one, none: 1 - 0.025
    assert table.loc["nothing", ["found", "alone"]].isna().all()
    asked = {"effects": "moisture_evaporation", "campaigns": 1, "file": kept}
    first = softsensor.rehearse(results["diagnose"], **asked)
    assert first.to_json() == found.to_json()
    assert len(kept.read_text(encoding="utf-8").splitlines()) == 2
    done = []
    again = softsensor.rehearse(results["diagnose"], **asked, progress=lambda what, share: done.append(share))
    assert (again.to_json(), done) == (found.to_json(), [])


def test_a_rehearsal_of_every_cause_prints_on_one_screen_in_both_languages(results):
    (row,), rate = results["rehearse"].rehearsal.rows, softsensor.Rate(10, 10)
    hidden = [row.hidden, *(softsensor.Hidden(name) for name in CAUSES)]
    rows = tuple(softsensor.RehearsedCause(one, rate, rate, rate) for one in hidden)
    whole = softsensor.RehearsalResult(replace(results["rehearse"].rehearsal, rows=rows, lost=2))
    for language in ("de", "en"):
        daq.speak(language)
        lines = repr(whole).splitlines()
        assert len(lines) <= ROWS
        assert max(map(len, lines)) <= COLUMNS


def test_predict_gives_what_the_command_writes(fitted, written, tmp_path):
    model = written / "model.json"
    out = tmp_path / "core.csv"
    assert main(["predict", str(SHORT), "--press", str(LAB), "--model", str(model), "--out", str(out)]) == 0
    assert {line.split(",")[6] for line in out.read_text().splitlines()[1:]} <= {"0", "1"}
    table = pd.read_csv(out, keep_default_na=True).set_index("time_s")
    ours = softsensor.predict(SHORT, LAB, model)
    assert np.allclose(ours.frame()["core_C"], table["core_C"], atol=6e-4, equal_nan=True)
    assert ours.frame()["valid"].tolist() == table["valid"].tolist()
    assert ours.plot()
    example = LAB.parents[1] / "resins" / "melamine_formaldehyde.toml"
    cured = softsensor.predict(SHORT, LAB, model, resin=example).frame()
    assert list(cured)[-6:] == ["cure_top", "cure_bottom", "cure_low", "steam_kPa", "steam_high_kPa", "open_now"]
    assert cured["cure_low"].max() > 0.9
    without = softsensor.predict(SHORT, LAB, fitted, without=["top_*", "bottom_*"]).frame()
    assert set(without["reason"]) == {"press state unknown"}


def test_what_is_handed_out_cannot_be_changed_and_is_compared_as_the_object_it_is(fitted):
    run = softsensor.read_run(SHORT)
    simulation, prediction = softsensor.simulate(run, LAB, fitted), softsensor.predict(run, LAB, fitted)
    assert simulation.run is prediction.replayed.run is run
    for handed in (run, simulation.simulated, fitted.campaign, *fitted.campaign.runs):
        values = vars(handed).values()
        mappings = [value for value in values if isinstance(value, Mapping)]
        arrays = [value for value in values if isinstance(value, np.ndarray)]
        arrays += [one for table in mappings for one in table.values() if isinstance(one, np.ndarray)]
        assert not any(array.flags.writeable for array in arrays)
        for table in mappings:
            with pytest.raises(TypeError, match="change a copy"):
                table["a"] = 1.0
    for one, other in (
        (run, softsensor.read_run(SHORT)),
        (simulation, softsensor.simulate(run, LAB, fitted)),
        (simulation.simulated, softsensor.simulate(run, LAB, fitted).simulated),
        (prediction, softsensor.predict(run, LAB, fitted)),
        (fitted, other_fit := softsensor.fit(SHORT, LAB)),
        (fitted.campaign, other_fit.campaign),
        (fitted.campaign.runs[0], fitted.campaign.runs[1]),
    ):
        assert one != other
        assert len({one, other, one}) == 2
    again = pickle.loads(pickle.dumps(fitted))
    assert again.to_json() == fitted.to_json()


@pytest.mark.parametrize("kind", ["path", "run", "table"])
def test_a_recorders_instant_given_as_text_is_one_whatever_it_stands_beside(kind):
    read, text = softsensor.read_run(SHORT), "2026-03-04T08:00:00.5+01:00"
    source = {"path": SHORT, "run": read, "table": daq.frame_of(read)}[kind]
    run = softsensor.read_run(source, header={"recorded.started_utc": text})
    assert run.header["recorded.started_utc"] == datetime.fromisoformat(text)
    assert daq.frame_of(run, utc=True).index[0] == pd.Timestamp(text)


def test_the_answer_of_a_diagnosis_stays_what_it_is():
    found = softsensor.diagnose(SHORT, LAB, effects=["edge_loss"])
    verdict, text = found.verdict, found.to_json()
    found.content["verdict"] = "mine"
    found.content["base"].clear()
    found.content["where"].append({})
    found.content["candidates"][:1] = [{}]
    for one in found.content["where"]:
        one["signal"] = "mine"
    assert found.verdict == verdict
    assert found.to_json() == text
    assert hash(found) != hash(softsensor.DiagnosisResult(found.diagnosis))


def test_a_diagnosis_hands_out_the_model_that_the_command_writes(tmp_path):
    file = tmp_path / "model.json"
    assert main(["diagnose", str(SHORT), "--press", str(LAB), "--model", str(file)]) == 0
    model = softsensor.diagnose(SHORT, LAB).model()
    assert [panel.thickness_mm for panel in model.panels] == [19.0]
    assert model.scatter
    assert model.missing is not None
    assert json.loads(model_text(model)) == json.loads(file.read_text(encoding="utf-8"))


def test_simulate_takes_a_model_or_coefficients(fitted):
    plain = softsensor.simulate(SHORT, LAB)
    assert list(plain.frame().columns)[-1] == "core_C"
    with_model = softsensor.simulate(SHORT, LAB, fitted)
    given_ = softsensor.simulate(SHORT, LAB, fitted.model().values)
    assert np.allclose(with_model.frame()["core_C"], given_.frame()["core_C"])
    assert max(with_model.simulated.rmse.values()) < max(plain.simulated.rmse.values())
    assert len(repr(plain)) < 3000


def test_a_fitted_model_cannot_be_changed_and_one_effect_may_be_a_text(fitted):
    with pytest.raises(TypeError, match="cannot be changed"):
        fitted.model().coefficients["h_pp_c"] = None
    with pytest.raises(daq.InputError, match="effect 'moisture' is not in the catalogue"):
        softsensor.diagnose(SAMPLES[5:7], LAB, effects="moisture")


def test_a_run_counts_once_and_tables_without_a_name_are_told_apart():
    with pytest.raises(daq.InputError, match="given twice; each run counts once"):
        runs_of([SHORT, SHORT], softsensor.read_press(LAB))
    table = daq.frame_of(read_run(SHORT))
    table.attrs.pop("run")
    with pytest.raises(daq.InputError, match=f"run 'frame' holds the readings of run '{SHORT.stem}'"):
        runs_of([SHORT, table], softsensor.read_press(LAB))
    other, third = table + 0.1, table + 0.2
    assert [run.name for run in runs_of([other, SHORT, third], softsensor.read_press(LAB))] == [
        "frame-1",
        SHORT.stem,
        "frame-2",
    ]


def test_a_store_answers_in_tables(tmp_path):
    url = str(tmp_path / "runs.sqlite")
    assert main(["import", *[str(p) for p in SAMPLES[:2]], "--press", str(LAB), "--store", url]) == 0
    with daq.open_store(url) as store:
        runs = store.runs()
        assert sorted(runs.index) == [p.stem for p in SAMPLES[:2]]
        samples = store.samples(SAMPLES[0].stem)
        assert samples["top_1"].to_numpy().tobytes() == read_run(SAMPLES[0]).columns["top_1"].tobytes()
        assert samples.attrs["panel.material"] == "MDF"
        again = softsensor.read_run(samples)
        assert again.name == SAMPLES[0].stem
        assert again.header["panel.thickness_mm"] == read_run(SAMPLES[0]).header["panel.thickness_mm"]
        assert set(daq.qualities_of(again)["top_1"]) <= {"good", "missing"}
        assert list(runs.columns)[:6] == [*RUN]
        assert list(store.events().columns) == [*ENTRY]
        assert tuple(store.estimates(SAMPLES[0].stem).columns) == ESTIMATE
        assert tuple(store.coefficients().columns) == COEFFICIENT
    moments = daq.find_moments(samples, LAB)
    assert 0.0 < moments.closed_s < moments.opened_s


def test_a_store_that_is_closed_answers_no_more(tmp_path):
    daq.play(SHORT, tmp_path / "runs.sqlite", "lab", scans=500)
    with daq.open_store(tmp_path / "runs.sqlite") as store:
        (name,) = store.runs().index
    store.close()
    for ask in (store.runs, store.coefficients, store.events, lambda: store.samples(name)):
        with pytest.raises(daq.InputError, match=r"runs\.sqlite: is closed; open it again by daq\.open_store"):
            ask()


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"scans": 0}, "scans = 0: must be a whole number, at least 1"),
        ({"scans": 2.5}, "scans = 2.5: must be a whole number"),
        ({"pause_s": -1.0}, "pause_s = -1: must be a number of seconds, at least 0"),
        ({"press": None}, "NoneType: the name of a press is given as a text"),
        ({"store": 5}, "int: a store is given as the path of its file"),
    ],
)
def test_a_run_is_not_played_where_store_press_or_pace_cannot_be(given, expected, tmp_path):
    with pytest.raises(daq.InputError, match=expected):
        daq.play(**{"run": SHORT, "store": tmp_path / "runs.sqlite", "press": "lab"} | given)
    with pytest.raises(daq.InputError, match="NoneType: a store is given as the path of its file"):
        daq.open_store(None)
    assert not (tmp_path / "runs.sqlite").exists()


def test_a_store_that_is_not_there_is_not_made(tmp_path):
    with pytest.raises(daq.InputError, match="does not exist; start kerntemp record, or give the right path"):
        daq.open_store(tmp_path / "typo.sqlite")
    assert not list(tmp_path.iterdir())


def test_tables_without_rows_have_the_columns_of_those_with(tmp_path):
    from daq.store.store import open_store

    url = str(tmp_path / "runs.sqlite")
    open_store(url).close()
    with daq.open_store(url) as store:
        tables = (store.runs(), store.coefficients(), store.events())
        for table, columns in zip(tables, (RUN, COEFFICIENT, ENTRY), strict=True):
            assert table.empty
            assert tuple(table.columns) == columns
    quiet = daq.run_of(
        pd.DataFrame({"platen_top": 190.0, "top_1": 21.0}, index=pd.Index([0.0, 1.0], name="time_s"))
    )
    assert list(daq.find_events(quiet, LAB).columns) == [*EVENT]


def test_every_result_prints_on_one_screen_is_drawn_for_a_notebook_and_is_json(fitted):
    from matplotlib import pyplot
    from matplotlib.axes import Axes

    for result in (fitted, softsensor.simulate(SHORT, LAB, fitted), softsensor.predict(SHORT, LAB, fitted)):
        lines = repr(result).splitlines()
        assert len(lines) <= 24
        assert max(map(len, lines)) <= 200
        assert "<table" in result._repr_html_()
        axes = result.plot()
        assert all(isinstance(ax, Axes) for ax in axes)
        assert axes[0].figure.number in pyplot.get_fignums()
        pyplot.close(axes[0].figure)
        assert json.loads(result.to_json(), parse_constant=no_number)
        with pytest.raises(AttributeError):
            result.anything = 1


def no_number(text):
    raise AssertionError(text)


@pytest.fixture(scope="module")
def said():
    """What was said meanwhile of how far a diagnosis and a plan are, by the function."""
    return {"diagnose": [], "plan": [], "rehearse": []}


@pytest.fixture(scope="module")
def results(fitted, said):
    """Return the answer of every public function that works something out."""
    resin = LAB.parents[1] / "resins/melamine_formaldehyde.toml"
    wet = {"panel.moisture_percent": 8.0, "panel.verdict": "blister"}
    (measured,) = make_campaign(77, 1, plan=Plan(rate_hz=1.0, thickness_mm=16.0))
    run, truth = measured
    model = softsensor.ThermalModel(parse_press(press_toml()))

    def saying(name):
        return {"progress": lambda what, share: said[name].append((what, share))}

    found = softsensor.diagnose(SAMPLES[5:8], LAB, effects=["moisture_evaporation"], **saying("diagnose"))
    return {
        "advise": softsensor.advise(LAB, fitted, limits={"core_least_C": 90.0}),
        "diagnose": found,
        "fit": fitted,
        "learn_steam_limit": softsensor.learn_steam_limit(
            [softsensor.read_run(SAMPLES[0], header=wet)], LAB, fitted, resin=resin
        ),
        "plan": softsensor.plan(found, LAB, ranges=PRESS_TIME, **saying("plan")),
        "predict": softsensor.predict(SHORT, LAB, fitted),
        "rehearse": softsensor.rehearse(found, effects="moisture_evaporation", campaigns=1, **saying("rehearse")),
        "reproduce": softsensor.reproduce([(run, truth.moments, truth.coefficients)], model),
        "simulate": softsensor.simulate(SHORT, LAB, fitted),
    }


def test_every_public_result_is_a_table_a_figure_a_screen_a_notebooks_view_and_json(results):
    from matplotlib import pyplot
    from matplotlib.axes import Axes

    taken_in = {softsensor.Press, softsensor.ModelFile, softsensor.Effect, daq.Run}
    public = {name: getattr(softsensor, name) for name in softsensor.__all__}
    functions = {name: one for name, one in public.items() if isinstance(one, FunctionType)}
    answers = {name: public.get(one.__annotations__["return"]) for name, one in functions.items()}
    answers = {name: kind for name, kind in answers.items() if kind not in (None, *taken_in)}
    assert {name: type(one) for name, one in results.items()} == answers
    for name, result in results.items():
        table = result.frame()
        assert len(table), name
        assert not table.map(lambda cell: cell is None).to_numpy().any(), name
        axes = result.plot()
        assert axes, name
        assert all(isinstance(ax, Axes) for ax in axes)
        pyplot.close(axes[0].figure)
        assert flooding(result) == {}
        assert "<object" not in repr(result)
        for shown in (repr(result), result._repr_html_()):
            assert not re.search(r"\b(nan|none)\b", shown, re.I), (name, shown)
        assert "<p>" in result._repr_html_() or "<table" in result._repr_html_()
        assert json.loads(result.to_json(), parse_constant=no_number)
    assert "<table" in results["advise"]._repr_html_()
    assert max(map(len, repr(results["diagnose"]).splitlines())) <= 100


def words_of(view):
    """Return what stands in a notebook's view or a printed text, without tags and the space between words."""
    return " ".join(html.unescape(re.sub("<[^>]+>", " ", view) if "<" in view else view).split())


def in_fahrenheit():
    table = daq.frame_of(softsensor.read_run(SHORT))
    changed = table * 1.8 + 32.0
    changed.attrs = table.attrs
    return changed


def with_a_dead_channel():
    table = daq.frame_of(softsensor.read_run(SHORT))
    return table.assign(top_3=20.0)


@pytest.mark.parametrize(
    ("given", "warned"),
    [
        (in_fahrenheit, {"fit-start-before-insertion", "fit-not-converged"}),
        (with_a_dead_channel, {"channel-loose"}),
    ],
)
def test_what_is_to_be_known_of_a_fit_stands_in_what_it_prints_and_in_the_notebook(given, warned):
    found = softsensor.fit(given(), LAB)
    (run,) = found.campaign.runs
    verdicts = [f"{name} is" for name, c in run.coefficients.items() if not c.identifiable]
    about_it = [one for one in run.warnings if not str(one).startswith(tuple(verdicts))]
    assert warned <= {one.code for one in about_it}
    for view in (repr(found), found._repr_html_()):
        assert [one.code for one in about_it if " ".join(str(one).split()) not in words_of(view)] == []
        assert not any(verdict in words_of(view) for verdict in verdicts)  # a dash in the table says it
    assert rows_of(repr(found)) <= ROWS
    assert max(map(len, repr(found).splitlines())) <= COLUMNS


def test_a_run_that_the_model_does_not_describe_is_one_in_the_notebook_too(fitted):
    first, *rest = fitted.campaign.runs
    lost = replace(first, misfit=say("fit-misfit-span", rmse=12.0, span=150.0))
    found = softsensor.FitResult(replace(fitted.campaign, runs=(lost, *rest)))
    for view in (repr(found), found._repr_html_()):
        assert words_of(str(found.campaign.shortfall)) in words_of(view)


def test_what_is_to_be_known_of_a_diagnosis_stands_in_what_it_prints_and_in_the_notebook():
    found = softsensor.diagnose([with_a_dead_channel(), *SAMPLES[4:6]], LAB, effects="edge_loss")
    assert any("top_3" in str(one) for one in found.diagnosis.warnings)
    for view in (repr(found), found._repr_html_()):
        assert [one for one in found.diagnosis.warnings if words_of(str(one)) not in words_of(view)] == []
    assert rows_of(repr(found)) <= ROWS


def test_a_free_law_is_looked_for_on_demand_and_stands_in_what_a_diagnosis_prints():
    plain = softsensor.diagnose(SAMPLES[4:6], LAB, effects="edge_loss")
    asked = softsensor.diagnose(SAMPLES[4:6], LAB, effects="edge_loss", law=True)
    for view in (repr, lambda found: found._repr_html_()):
        assert "No free law" not in view(plain)
        assert "No free law" in view(asked)
    curve = np.stack([np.linspace(0.0, 30.0, 5), *[np.linspace(0.5, 1.0, 5)] * 3], axis=1)
    fields = (LawOf.CONTACT, "time_since_closing_s", "-", curve, Gain(0.8, (0.5, 1.0)), ("contact",), None)
    law = Law(*fields, stage=asked.diagnosis.final, kept={})
    found = softsensor.DiagnosisResult(replace(asked.diagnosis, law=law))
    assert found.content["law"]["heldout_gain_K"] == 0.8
    for view in (repr(found), found._repr_html_()):
        for line in law_messages(found.diagnosis):
            assert words_of(str(line)) in words_of(view)
    assert rows_of(repr(found)) <= ROWS
    said = [str(one) for one in core_messages(found.diagnosis)]
    assert said
    assert not any("stays as it is" in one for one in said)  # the model file holds the law


def test_a_prediction_with_a_resin_and_a_long_reason_prints_on_one_screen():
    with warnings.catch_warnings(action="ignore"):
        run = softsensor.read_run(softsensor.read_run(SHORT), header={"panel.initial_temperature_C": 45.0})
        found = softsensor.predict(run, LAB, resin=daq.shared_files() / "resins/melamine_formaldehyde.toml")
    assert "start temperature contradicted" in repr(found)
    assert rows_of(repr(found)) <= ROWS


def test_a_diagnosis_with_a_faulty_channel_in_all_runs_prints_beside_its_other_causes():
    runs = [daq.frame_of(softsensor.read_run(sample)).assign(top_3=20.0) for sample in SAMPLES[3:6]]
    found = softsensor.diagnose(runs, LAB, effects="edge_loss")
    assert len(found.frame()) > 1
    for view in (repr(found), found._repr_html_()):
        assert "sensor_fault" in view
        assert "top_3" in view


def test_a_fit_of_many_runs_with_much_to_be_known_prints_on_one_screen(fitted):
    run = fitted.campaign.runs[0]
    remarks = [say("channel-empty", column=f"top_{number}") for number in range(30)]
    many = tuple(replace(run, run=f"r{i}", warnings=(*run.warnings, *remarks[i : i + 2])) for i in range(30))
    found = softsensor.FitResult(replace(fitted.campaign, runs=many))
    assert rows_of(repr(found)) <= ROWS
    assert re.search(r"\.\.\. and \d+ more$", repr(found))
    assert str(remarks[0]) in repr(found)
    assert all(str(remark) in words_of(found._repr_html_()) for remark in remarks)


def test_a_notebook_shows_what_the_text_does(results):
    fitted = results["fit"]
    five = tuple(replace(fitted.campaign.runs[0], run=f"r{i}") for i in range(5))
    shown = {**results, "fit of five": softsensor.FitResult(replace(fitted.campaign, runs=five))}
    resin = LAB.parents[1] / "resins/melamine_formaldehyde.toml"
    shown["with a resin"] = softsensor.predict(SHORT, LAB, fitted, resin=resin)
    for name, result in shown.items():
        view = words_of(result._repr_html_()).split()
        assert [word for word in repr(result).split() if word not in (*view, "...", "\\")] == [], name
        assert max(map(len, repr(result).splitlines())) <= 100, name


def arrays_of(value):
    """Return the arrays that a comparison of a value meets."""
    parts = value.values() if isinstance(value, Mapping) else value if isinstance(value, (tuple, list)) else ()
    return [value] if isinstance(value, np.ndarray) else [found for part in parts for found in arrays_of(part)]


def test_nothing_public_that_a_result_leads_to_compares_arrays_as_if_they_were_numbers(results):
    public = {getattr(module, name) for module in (daq, softsensor) for name in module.__all__}
    todo, seen, odd = list(results.values()), set(), set()
    while todo:
        one = todo.pop()
        if type(one) in seen:
            continue
        if type(one).__module__.partition(".")[0] in ("daq", "softsensor"):
            seen.add(type(one))
        todo += [part for _, part in parts_of(one)]
        if type(one) in public and is_dataclass(one) and one.__dataclass_params__.eq:
            odd |= {type(one).__name__ for f in fields(one) if arrays_of(getattr(one, f.name))}
    assert odd == set()
    assert seen >= {softsensor.Diagnosis, daq.Run}


def test_models_of_the_same_content_are_equal(fitted, tmp_path):
    model = fitted.model()
    path = tmp_path / "model.json"
    path.write_text(model.to_json(), encoding="utf-8")
    again = softsensor.read_model(path)
    assert again == model
    assert model in [again]
    assert len({model, again}) == 1
    assert json.loads(model.to_json()) == model.as_json()
    name, one = next(iter(model.coefficients.items()))
    other = replace(model, coefficients={**model.coefficients, name: replace(one, value=2.0 * one.value)})
    assert other != model
    assert model != model.as_json()


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"coefficients": {"h_pp_c": 700.0}}, "model v: coefficients.h_pp_c = 700: needs numbers value and sd"),
        (
            {"coefficients": {}, "effects": (("edge_loss", {"W_m3K": 5.0}),)},
            "model v: effects.0.parameters.W_m3K = 5: needs numbers value and sd",
        ),
    ],
)
def test_a_model_takes_no_value_without_its_standard_deviation(given, expected):
    with pytest.raises(daq.InputError, match=re.escape(expected)):
        softsensor.ModelFile("v", "lab", **given)


def test_a_fits_json_is_that_of_the_command_but_for_profiles_which_are_there_where_asked_for(written):
    content = json.loads((written / "fit.json").read_text())["runs"][0]
    without, asked = (
        json.loads(softsensor.fit(SAMPLES[5], LAB, profiles=profiles).to_json())["runs"][0]
        for profiles in (False, True)
    )
    assert content.keys() - without.keys() == {"profiles"}
    assert asked.keys() == content.keys()


@pytest.mark.parametrize(
    ("time_s", "values", "expected"),
    [
        (None, {"platen_top": 200.0}, "a scan at None: its time is given in seconds"),
        (pd.NaT, {"platen_top": 200.0}, "a scan at NaT: its time is given in seconds"),
    ],
)
def test_a_live_sensors_first_scan_names_what_is_wrong_with_it(time_s, values, expected):
    live = softsensor.LiveSensor(LAB, softsensor.read_run(SHORT).header)
    with pytest.raises(daq.InputError, match=re.escape(expected)):
        live.update(time_s, values)


def test_an_estimate_is_json_as_its_row_of_the_prediction(results):
    predicted = results["predict"]
    table = json.loads(predicted.to_json())
    for i, estimate in enumerate(predicted.replayed.estimates):
        row = json.loads(estimate.to_json(), parse_constant=no_number)
        assert {name: row[name] for name in table} == {name: values[i] for name, values in table.items()}
        assert (row["steam_kPa"], row["open_now"]) == (None, 0)


def test_diagnosis_and_plan_report_how_far_they_are(results, said):
    """From Python as at the terminal: a notebook has half a minute of silence otherwise."""
    assert results.keys() > said.keys()
    shares = [share for _, share in said["diagnose"]]
    assert len(shares) >= 3
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] <= shares[-1] <= 1.0
    assert said["plan"]
    assert [share for _, share in said["rehearse"]] == [0.5, 1.0]


def test_a_plan_is_drawn_in_words_and_its_legend_lies_over_no_bar(results):
    (ax,) = results["plan"].plot()
    ax.figure.canvas.draw()
    labels = [label.get_text() for label in ax.get_yticklabels()]
    assert [line for label in labels for line in label.splitlines() if re.match("[K%]", line)] == []
    names = [re.sub(r"\s", " ", label) for label in labels]
    assert names == [str(point_message(advice.point)) for advice in results["plan"].planned.points]
    (legend,) = ax.figure.legends
    assert not legend.get_window_extent().overlaps(ax.get_window_extent())
    assert ax.get_legend() is None


@pytest.mark.parametrize("share", [0.5, 0.99, 2.0, 300.0])
def test_the_worth_of_pressings_is_drawn_over_an_axis_of_round_numbers(results, share):
    planned = results["plan"].planned
    most = max(one.prospect.worth for of in planned.points for one in (of.best, of.with_core, of.repeated) if one)

    def scaled(one):
        worth = share * one.prospect.worth / most if one else None
        return one and replace(one, prospect=replace(one.prospect, worth=worth))

    points = [
        replace(of, best=scaled(of.best), with_core=scaled(of.with_core), repeated=scaled(of.repeated))
        for of in planned.points
    ]
    (ax,) = softsensor.PlanResult(replace(planned, points=tuple(points))).plot()
    ax.figure.canvas.draw()
    low, high = ax.get_xlim()
    ticks = [
        label.get_text()
        for at, label in zip(ax.get_xticks(), ax.get_xticklabels(), strict=True)
        if low <= at <= high
    ]
    assert len(ticks) >= 3
    assert all(len(text) <= 4 for text in ticks), ticks


def test_a_live_sensor_says_which_press_it_follows_and_what_it_said_last(fitted):
    live = softsensor.LiveSensor(LAB, softsensor.read_run(SHORT).header, fitted)
    assert repr(live) == str(say("live-sensor-of-press", press="lab")) == "live sensor of press lab"
    live.update(2.5, {"platen_top": 200.0})
    assert "time_s = 2.5" in repr(live)
    assert "invalid = Invalid(reason = platen reading missing" in repr(live)
    assert rows_of(repr(live)) <= ROWS


def test_runs_presses_models_and_estimates_are_tables_in_a_notebook(fitted):
    run = softsensor.read_run(SHORT, header={"remark": "<b>wet & cold</b>"})
    live = softsensor.LiveSensor(LAB, run.header, fitted)
    estimate = live.update(2.5, {"platen_top": 200.0})
    for one in (run, softsensor.read_press(LAB), fitted.model(), estimate, live):
        head, *lines = repr(one).splitlines()
        shown = ElementTree.fromstring(f"<div>{one._repr_html_()}</div>")
        assert shown.findtext("p/b") == head
        assert len(shown.findall("table/tbody/tr")) == len(lines) > 0
    assert "<b>wet" not in run._repr_html_()
    assert "<th>time_s</th><td>2.5</td>" in estimate._repr_html_()


def test_a_plans_table_keeps_nats_shares_and_kelvins_apart(results):
    table, written = results["plan"].frame(), json.loads(results["plan"].to_json())["open"]
    best = table.xs("best", level="pressing")
    for column, kind in (("half_share", "coefficient"), ("half_K", "core_band")):
        expected = [one["best"]["half_interval"] if one["kind"] == kind else None for one in written]
        np.testing.assert_array_equal(best[column], np.array(expected, float))
    assert best["worth_nats"].tolist() == [one["best"]["worth"] for one in written]
    assert "half_interval" not in table


def test_whatever_a_result_leads_to_prints_on_one_screen(results):
    fitted, resin = results["fit"], LAB.parents[1] / "resins/melamine_formaldehyde.toml"
    live = softsensor.LiveSensor(LAB, softsensor.read_run(SHORT).header, fitted)
    led_to = (
        *(fitted, fitted.model(), softsensor.read_press(LAB), live.update(0.0, {"platen_top": 200.0})),
        *(results["simulate"], results["diagnose"]),
        softsensor.predict(SHORT, LAB, fitted, resin=resin),
    )
    assert {type(one).__name__: flooding(one) for one in led_to} == {type(one).__name__: {} for one in led_to}


def test_an_effect_of_ones_own_is_known_by_name_once():
    from softsensor.effects import catalogue, find_effect

    effect = replace(find_effect("edge_loss"), name="own_loss", words={})
    with pytest.raises(daq.InputError, match="own_loss"):
        softsensor.add_effect(effect)
    assert "own_loss" not in catalogue()
    with pytest.raises(daq.InputError, match="edge_loss"):
        softsensor.add_effect(find_effect("edge_loss"))


MODEL = softsensor.ThermalModel(softsensor.read_press(LAB))


def measured(**truths):
    """Return a measurement for the paper's comparison, the press file's guesses its truths but for some."""
    run = softsensor.read_run(SHORT)
    return run, daq.find_moments(run, LAB), {**MODEL.guesses, **truths}


def advise(**asked):
    """Ask for advice on a core of 60 °C."""
    return softsensor.advise(LAB, softsensor.ModelFile("mine", "lab", {}), limits={"core_least_C": 60.0}, **asked)


@pytest.mark.parametrize(
    ("ask", "expected"),
    [
        (lambda: softsensor.read_run(5), "int: a run is given as the path of a CSV"),
        (lambda: softsensor.read_run("a\0b"), "NUL character; correct the path"),
        (lambda: daq.open_store("a\0b"), "NUL character; correct the path"),
        (lambda: daq.run_of(daq.frame_of(softsensor.read_run(SHORT)), 5), "int: a header is given as"),
        (lambda: softsensor.LiveSensor(LAB, None), "NoneType: a header is given as"),
        (lambda: softsensor.read_run({"time_s": [0.0]}), "dict: a run is given as"),
        (lambda: softsensor.fit(None, LAB), "NoneType: a run is given as"),
        (lambda: softsensor.fit([SHORT, 5], LAB), "int: a run is given as"),
        (lambda: softsensor.read_run(SHORT, mapping=5), "int: a mapping is given as the path"),
        (lambda: softsensor.read_run(pd.DataFrame({"time_s": [0.0]}), mapping=LAB), "DataFrame: a mapping"),
        (lambda: softsensor.read_run(softsensor.read_run(SHORT), mapping=LAB), "Run: a mapping explains the file"),
        (lambda: softsensor.read_run(SHORT, header=[("panel.thickness_mm", 1.0)]), "list: a header is given as"),
        (lambda: softsensor.read_run(SHORT, header={5: 1.0}), "key 5 is not a text"),
        (lambda: softsensor.read_press(5), "int: a press is given as"),
        (lambda: softsensor.read_model(None), "NoneType: a model is given as"),
        (lambda: softsensor.simulate(SHORT, LAB, 5), "int: a model is given as"),
        (lambda: softsensor.simulate(SHORT, LAB, settings=5), "int: settings are given as"),
        (lambda: softsensor.simulate(SHORT, LAB, settings={"press_time_s": "a"}), "press_time_s = 'a': must be a"),
        (lambda: softsensor.predict(SHORT, LAB, resin=5), "int: a resin is given as"),
        (lambda: softsensor.predict(SHORT, LAB, without=5), "int: names are given as one text or several"),
        (lambda: softsensor.diagnose(SHORT, LAB, effects=[5]), "int: names are given as one text or several"),
        (lambda: softsensor.LiveSensor(LAB, 5), "int: a header is given as"),
        (lambda: softsensor.add_effect(5), "int: an effect is given as an Effect"),
        (lambda: advise(ranges={"press_time_s": 5}), "int: ranges are given as"),
        (
            lambda: advise(ranges={"press_time_s": (500.0, 5.0)}),
            "range of press_time_s from 500 to 5: give the lower end",
        ),
        (lambda: advise(goal="speed"), "goal speed: must be one of time, energy, throughput"),
        (lambda: advise(waiting_s=math.nan), "waiting_s = nan: must be a number from 1 to 600"),
        (lambda: advise(open_s="30"), "open_s = '30': must be a number from 1 to 3600"),
        (lambda: advise(price_per_kWh=-3), "price_per_kWh = -3: must be a number from 0"),
        (lambda: softsensor.plan(SHORT, LAB, ranges={"press_time_s": 5}), "int: ranges are given as"),
        (lambda: softsensor.reproduce([], MODEL), "there is no measurement"),
        (lambda: softsensor.reproduce(SHORT, MODEL), "measurements are given as a list of tuples"),
        (lambda: softsensor.reproduce([(SHORT, None, {})], MODEL), "measurements are given as a list of tuples"),
        (lambda: softsensor.reproduce([(softsensor.read_run(SHORT), {})], MODEL), "tuple: measurements are given"),
        (lambda: softsensor.reproduce([measured()], LAB), "a thermal model is given as ThermalModel(press)"),
        (lambda: softsensor.reproduce([measured(h_pp_c=-1.0)], MODEL), "h_pp_c = -1:"),
        (lambda: softsensor.reproduce([(*measured()[:2], {})], MODEL), "the true value of h_p_o, h_p_c"),
        (
            lambda: softsensor.reproduce([measured()], MODEL, judged=["x"]),
            "judged = ('x',): none of them is fitted",
        ),
        (lambda: daq.run_of({"time_s": [0.0]}), "dict: a table is given as a pandas DataFrame"),
        (lambda: daq.frame_of(5), "int: a run is given as"),
        (lambda: daq.qualities_of(pd.DataFrame()), "pandas.DataFrame: a run is given as"),
        (lambda: daq.find_moments(5, LAB), "int: a run is given as"),
        (lambda: daq.find_events(SHORT, None), "NoneType: a press is given as"),
    ],
)
def test_what_is_of_another_kind_than_asked_for_is_refused_in_words(ask, expected):
    with pytest.raises(daq.InputError, match=re.escape(expected)):
        ask()


@pytest.mark.parametrize("given", [{"h_x": 5.0}, {"h_pp_c": -5.0}, {"h_pp_c": "a"}])
def test_wrong_coefficients_are_refused_as_by_the_command(given, tmp_path, capsys):
    with pytest.raises(daq.InputError) as ours:
        softsensor.simulate(SHORT, LAB, given)
    path = tmp_path / "coefficients.json"
    path.write_text(json.dumps(given))
    out = ["--coefficients", str(path), "--out", str(tmp_path / "out.csv")]
    assert main(["simulate", str(SHORT), "--press", str(LAB), *out]) == 2
    output = " ".join(capsys.readouterr().err.split())
    assert str(ours.value).removeprefix("model: ") in output
    assert f"{path.name}: " in output


MADE = softsensor.ModelFile("made", "lab", {"h_zz": softsensor.FittedValue(700.0, 70.0)})


@pytest.mark.parametrize(
    "use",
    [
        lambda model: softsensor.simulate(SHORT, LAB, model),
        lambda model: softsensor.predict(SHORT, LAB, model),
        lambda model: softsensor.LiveSensor(LAB, softsensor.read_run(SHORT).header, model),
        lambda model: softsensor.advise(LAB, model, limits={"core_least_C": 60.0}),
    ],
)
def test_a_model_made_in_python_is_held_to_its_press_and_to_what_matter_can_be(use):
    with pytest.raises(
        daq.InputError, match="model made: h_zz: press 'lab' has no such coefficient; it has h_p_o"
    ):
        use(MADE)
    with pytest.raises(daq.InputError, match=r"coefficients\.h_pp_c = 700: needs numbers value and sd"):
        use(replace(MADE, coefficients={"h_pp_c": 700.0}))


def test_a_model_of_another_press_is_warned_about_as_at_the_terminal():
    model = softsensor.ModelFile("1", "rig", {"h_pp_c": softsensor.FittedValue(700.0, 70.0)})
    with pytest.warns(UserWarning, match="model 1 is of press 'rig', the press file is of 'lab'"):
        softsensor.simulate(SHORT, LAB, model)


def test_one_pattern_may_be_a_text_and_a_run_a_file_for_every_function():
    predicted = softsensor.predict(SHORT, LAB, without="top_*").frame()
    pd.testing.assert_frame_equal(predicted, softsensor.predict(SHORT, LAB, without=["top_*"]).frame())
    assert daq.find_moments(SHORT, LAB) == daq.find_moments(softsensor.read_run(SHORT), LAB)


def test_a_model_prints_on_one_screen(fitted):
    lines = repr(fitted.model()).splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 200
    assert lines[0].endswith("of press lab")
    for name in fitted.model().coefficients:
        assert any(line.startswith(f"{name} = ") for line in lines)


def test_keys_given_beside_a_file_count_before_its_own():
    path = SAMPLES[0]
    run = softsensor.read_run(path, header={"panel.thickness_mm": 12.0})
    assert run.header == {**softsensor.read_run(path).header, "panel.thickness_mm": 12.0}
    assert softsensor.read_run(run, header={"run": "other"}).name == "other"
    with pytest.raises(daq.InputError, match=r"^read_run: .*panel\.thickness_mm"):
        softsensor.read_run(path, header={"panel.thicknes_mm": 12.0})


def test_a_header_of_tables_is_read_as_its_dotted_keys():
    nested = {
        "panel": {"thickness_mm": 12.0, "thickness_mm.sd": 0.1},
        "recorded": {"started_utc": "2026-03-04T07Z"},
    }
    flat = {"panel.thickness_mm": 12.0, "panel.thickness_mm.sd": 0.1}
    flat["recorded.started_utc"] = datetime(2026, 3, 4, 7, tzinfo=UTC)
    plain = softsensor.read_run(SHORT)
    table = daq.frame_of(plain)
    tagged = table.copy()
    tagged.attrs = {**table.attrs, **nested}
    for key in ("panel.thickness_mm", "recorded.started_utc"):
        tagged.attrs.pop(key, None)
    for run in (
        softsensor.read_run(SHORT, header=nested),
        softsensor.read_run(plain, header=nested),
        softsensor.read_run(table, header=nested),
        softsensor.read_run(tagged),
        softsensor.read_run(replace(plain, header={**plain.header, **flat, "panel": {"moisture_percent": 5.0}})),
    ):
        assert {key: run.header[key] for key in flat} == flat
        assert not [value for value in run.header.values() if isinstance(value, dict)]
    assert run.header["panel.moisture_percent"] == 5.0
    twice = {"panel.thickness_mm": 11.0, "panel": {"thickness_mm": 12.0}}
    for work in (
        lambda: softsensor.read_run(SHORT, header=twice),
        lambda: softsensor.read_run(table, header=twice),
        lambda: softsensor.LiveSensor(LAB, twice),
    ):
        with pytest.raises(daq.InputError, match=r"header key panel\.thickness_mm is given twice; keep one"):
            work()


def test_a_table_that_shows_nothing_of_the_press_is_refused_where_its_moments_are_asked_for():
    table = daq.frame_of(softsensor.read_run(SHORT))
    foreign, worded = table.add_prefix("x_"), table.astype({"top_1": object})
    worded.loc[worded.index[1], "top_1"] = "hot"
    for find in (daq.find_events, daq.find_moments):
        with pytest.raises(daq.InputError, match="press state unknown: no reading of the panel and no column"):
            find(foreign, LAB)
        with pytest.raises(daq.InputError, match=r"row 2: column top_1: 'hot' is not a number"):
            find(worded, LAB)


def test_moments_are_found_by_the_wire_that_the_runs_header_names():
    table = daq.frame_of(softsensor.read_run(SHORT))
    closed, opened = (daq.find_moments(SHORT, LAB).closed_s, daq.find_moments(SHORT, LAB).opened_s)
    table = table[["platen_top", "platen_bottom"]].assign(door=0.0, note="by hand")
    table.loc[(table.index >= closed) & (table.index < opened), "door"] = 1.0
    table.attrs = {"press.limit_switch": "door"}
    found = daq.find_moments(table, LAB)
    assert (found.closed_s, found.opened_s) == pytest.approx((closed, opened), abs=1.01)  # a row
    assert {"closed", "opened"} <= set(daq.find_events(table, LAB)["event"])
    worded = table.assign(door="no")
    for find in (daq.find_events, daq.find_moments):
        with pytest.raises(daq.InputError, match="column door: 'no' is not a number"):
            find(worded, LAB)


def test_words_in_a_column_that_shows_no_movement_of_the_press_hide_none():
    table = daq.frame_of(softsensor.read_run(SHORT)).assign(core_1="n/a")
    assert daq.find_events(table, LAB)["event"].tolist() == daq.find_events(SHORT, LAB)["event"].tolist()
    assert daq.find_moments(table, LAB) == daq.find_moments(SHORT, LAB)


@pytest.mark.parametrize(
    "own", [{"press": {"operator": "Ann"}}, {"sensors": {"top_1": "K"}}, {"remark": {"a": 1}}]
)
def test_what_else_stands_in_a_tables_attrs_is_no_header(own, tmp_path):
    table = daq.frame_of(softsensor.read_run(SHORT))
    table.attrs |= {**own, "panel": {"density_kg_m3": 712.0}}
    del table.attrs["panel.density_kg_m3"]
    table.to_parquet(tmp_path / "a.parquet")
    for source in (table, tmp_path / "a.parquet"):
        with warnings.catch_warnings(action="ignore"):
            run = softsensor.read_run(softsensor.read_run(source))
            simulated = softsensor.simulate(run, LAB)
        assert run.header["panel.density_kg_m3"] == 712.0
        assert len(simulated.frame()) == len(table)


def test_columns_are_left_out_by_one_text_with_commas_as_on_the_command_line():
    one, several = (
        softsensor.predict(SHORT, LAB, without=given) for given in ("top_1, top_2", ["top_1", "top_2"])
    )
    pd.testing.assert_frame_equal(one.frame(), several.frame())
    with pytest.raises(daq.InputError, match="tpo"):
        softsensor.predict(SHORT, LAB, without="top_1,tpo_*")


def test_the_first_examples_run_in_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(softsensor)
    assert result.attempted >= 4  # the lines of the package's first example
    assert result.failed == 0
