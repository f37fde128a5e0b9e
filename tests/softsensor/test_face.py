"""Kerntemp from Python: what goes in comes out, results are those of the command line, errors too."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import daq
import softsensor
from api.cli import main
from daq.files.run_file import read_run

ROOT = Path(__file__).resolve().parents[2]
LAB = ROOT / "deploy/presses/lab.toml"
SAMPLES = sorted((ROOT / "deploy/samples").glob("2026-*.csv"))
SHORT = SAMPLES[6]


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


@pytest.mark.parametrize("package", [softsensor, daq])
def test_every_public_name_is_there_and_says_what_it_is(package):
    for name in package.__all__:
        assert getattr(package, name).__doc__
    with pytest.raises(AttributeError, match="it has"):
        _ = package.not_a_name


def test_a_run_file_through_a_table_is_the_same_run():
    run = softsensor.read_run(SHORT)
    again = softsensor.read_run(daq.frame_of(run))
    assert again.name == run.name
    assert dict(again.header) == dict(run.header)
    assert again.time_s.tobytes() == run.time_s.tobytes()
    for name, values in run.columns.items():
        assert again.columns[name].tobytes() == values.tobytes()


@settings(deadline=None)
@given(
    values=st.lists(st.one_of(st.none(), st.floats(-200.0, 1300.0)), min_size=1, max_size=30),
    start=st.floats(0.0, 1e6),
    zone=st.sampled_from([None, "UTC", "Europe/Berlin"]),
)
def test_any_table_comes_back_as_it_went_in(values, start, zone):
    column = np.array([np.nan if v is None else v for v in values])
    if zone is None:
        index = pd.Index(start + 0.5 * np.arange(len(column)), name="time_s")
    else:
        index = pd.date_range("2026-10-25 01:59:58", periods=len(column), freq="500ms", tz=zone)
    frame = pd.DataFrame({"top_1": column}, index=index)
    frame.attrs["panel.material"] = "MDF"
    run = daq.run_of(frame)
    back = daq.frame_of(run)
    assert back["top_1"].to_numpy().tobytes() == column.tobytes()
    assert back.attrs["panel.material"] == "MDF"
    assert np.allclose(np.diff(back.index), 0.5)
    if zone is not None:
        assert run.header["recorded.started_utc"] == index[0]


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (pd.DataFrame({"top_1": [1.0]}), "the table has no times"),
        (pd.DataFrame({"time_s": [], "top_1": []}), "the table has no rows"),
        (pd.DataFrame({"time_s": [1.0, 0.5], "top_1": [1.0, 2.0]}), "time_s"),
        (pd.DataFrame({"time_s": [0.0], "closed": [3.0]}), "column closed: 3 must be 0"),
    ],
)
def test_a_table_that_is_no_run_is_refused_with_what_to_do(frame, words):
    with pytest.raises(daq.InputError, match=words):
        softsensor.read_run(frame)


def test_fit_gives_what_the_command_writes(fitted, written):
    told = json.loads((written / "fit.json").read_text())
    ours = json.loads(fitted.to_json())
    assert [r["run"] for r in ours["runs"]] == [r["run"] for r in told["runs"]]
    assert ours["campaign"] == told["campaign"]
    table = fitted.frame()
    first = told["runs"][0]
    for name, entry in first["coefficients"].items():
        assert table.loc[(first["run"], name), "value"] == pytest.approx(entry["value"], rel=1e-4)
    assert fitted.plot()
    assert len(repr(fitted)) < 3000


def test_predict_gives_what_the_command_writes(fitted, written, tmp_path):
    model = written / "model.json"
    out = tmp_path / "core.csv"
    assert main(["predict", str(SHORT), "--press", str(LAB), "--model", str(model), "--out", str(out)]) == 0
    assert {line.split(",")[6] for line in out.read_text().splitlines()[1:]} <= {"0", "1"}
    told = pd.read_csv(out, keep_default_na=True).set_index("time_s")
    ours = softsensor.predict(SHORT, LAB, model)
    assert np.allclose(ours.frame()["core_C"], told["core_C"], atol=6e-4, equal_nan=True)
    assert ours.frame()["valid"].tolist() == told["valid"].tolist()
    assert ours.plot()
    example = LAB.parents[1] / "resins" / "melamine_formaldehyde.toml"
    cured = softsensor.predict(SHORT, LAB, model, resin=example).frame()
    assert list(cured)[-6:] == ["cure_top", "cure_bottom", "cure_low", "steam_kPa", "steam_high_kPa", "open_now"]
    assert cured["cure_low"].max() > 0.9
    without = softsensor.predict(SHORT, LAB, fitted, without=["top_*", "bottom_*"]).frame()
    assert set(without["reason"]) == {"press state unknown"}


def test_simulate_takes_a_model_or_coefficients(fitted):
    plain = softsensor.simulate(SHORT, LAB)
    assert list(plain.frame().columns)[-1] == "core_C"
    with_model = softsensor.simulate(SHORT, LAB, fitted)
    given_ = softsensor.simulate(SHORT, LAB, fitted.model().values)
    assert np.allclose(with_model.frame()["core_C"], given_.frame()["core_C"])
    assert max(with_model.simulated.rmse.values()) < max(plain.simulated.rmse.values())
    assert len(repr(plain)) < 3000


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
        for table in (store.estimates(SAMPLES[0].stem), store.coefficients(), store.events()):
            assert isinstance(table, pd.DataFrame)
    moments = daq.find_moments(samples, LAB)
    assert 0.0 < moments.closed_s < moments.opened_s


def test_every_result_prints_on_one_screen_is_drawn_for_a_notebook_and_is_json(fitted):
    from matplotlib import pyplot
    from matplotlib.axes import Axes

    def no_number(text):
        raise AssertionError(text)

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


def test_an_effect_of_ones_own_is_known_by_name_once():
    from softsensor.effects import catalogue, find_effect

    effect = replace(find_effect("edge_loss"), name="own_loss", words={})
    with pytest.raises(daq.InputError, match="own_loss"):
        softsensor.add_effect(effect)
    assert "own_loss" not in catalogue()
    with pytest.raises(daq.InputError, match="edge_loss"):
        softsensor.add_effect(find_effect("edge_loss"))


def test_keys_given_beside_a_file_count_before_its_own():
    path = SAMPLES[0]
    run = softsensor.read_run(path, header={"panel.thickness_mm": 12.0})
    assert run.header == {**softsensor.read_run(path).header, "panel.thickness_mm": 12.0}
    assert softsensor.read_run(run, header={"run": "other"}).name == "other"
    with pytest.raises(daq.InputError, match=r"panel\.thickness_mm"):
        softsensor.read_run(path, header={"panel.thicknes_mm": 12.0})
