"""Model files: what is written is read, what is wrong is named."""

import json

import numpy as np
import pytest

from daq.records import InputError
from softsensor.heat.model_file import FittedValue, ModelFile, PressedPanel, Scatter, model_text, parse_model
from softsensor.jobs.model_files import read_model

MODEL = ModelFile(
    version="2026-03-04T00:00:00Z",
    press="lab",
    coefficients={"h_pp_c": FittedValue(700.0, 80.0), "h_wa": FittedValue(12.0, 2.0)},
    effects=(("edge_loss", {"W_m3K": FittedValue(900.0, 100.0)}),),
    names=("h_pp_c", "h_wa", "edge_loss.W_m3K"),
    covariance=np.diag([0.01, 0.02, 1e4]),
    scatter={"panel.conductivity_W_mK": Scatter(0.06, 12, 0.05)},
    panels=(PressedPanel(16.0, 8), PressedPanel(19.1, 4)),
)


def test_what_is_written_is_read(tmp_path):
    path = tmp_path / "model.json"
    path.write_text(model_text(MODEL), encoding="utf-8")
    back = read_model(path)
    assert back.coefficients == MODEL.coefficients
    assert back.effects == MODEL.effects
    assert back.names == MODEL.names
    assert back.learned == {"panel.conductivity_W_mK": 0.06}
    assert back.scatter == MODEL.scatter
    assert back.panels == MODEL.panels
    assert np.array_equal(back.covariance, MODEL.covariance)
    assert back.values == {"h_pp_c": 700.0, "h_wa": 12.0, "edge_loss.W_m3K": 900.0}


def test_a_file_without_panels_does_not_know_which_there_were():
    content = json.loads(model_text(MODEL))
    assert content.pop("panels") == [{"thickness_mm": 16.0, "runs": 8}, {"thickness_mm": 19.1, "runs": 4}]
    assert parse_model(content, "model.json").panels == ()


def test_a_scatter_that_does_not_say_what_panels_differ_by_is_all_of_that():
    content = json.loads(model_text(MODEL))
    content["scatter"] = {"panel.conductivity_W_mK": {"sd": 0.06, "runs": 12}}
    assert parse_model(content, "model.json").scatter["panel.conductivity_W_mK"] == Scatter(0.06, 12, 0.06)


def test_a_model_file_names_its_effects_to_the_thermal_model(lab_press):
    assert [e.name for e in MODEL.model(lab_press).effects] == ["edge_loss"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"coefficients": None}, "coefficients must be an object"),
        ({"coefficients": {"h_wa": 12.0}}, r"coefficients\.h_wa = 12\.0: needs numbers value and sd"),
        ({"coefficients": {"h_wa": {"value": "nan"}}}, r"coefficients\.h_wa\.value is not finite"),
        ({"coefficients": {"h_wa": {"value": -3.0}}}, r"coefficients\.h_wa\.value = -3: must be above 0"),
        ({"effects": [{"parameters": {}}]}, r"effects\.0 has no name"),
        ({"effects": [{"name": "draft"}]}, "effect 'draft' is not in the catalogue"),
        (
            {"effects": [{"name": "edge_loss", "parameters": {"h": {"value": 1.0}}}]},
            r"effects\.0\.parameters\.h: edge_loss has W_m3K",
        ),
        ({"panels": [{"thickness_mm": 16.0}]}, "panels is not as `fit` writes it"),
        ({"panels": [{"thickness_mm": -16.0, "runs": 3}]}, "panels is not as `fit` writes it"),
        ({"panels": 16.0}, "panels is not as `fit` writes it"),
        ({"scatter": {"panel.thickness_mm": {"sd": -0.1, "runs": 3}}}, "scatter is not as `fit` writes it"),
        (
            {"scatter": {"panel.thickness_mm": {"sd": 0.1, "runs": 3, "panel": 0.2}}},
            "scatter is not as `fit` writes",
        ),
    ],
)
def test_a_wrong_model_file_is_refused_with_its_key(change, message):
    with pytest.raises(InputError, match=message):
        parse_model(json.loads(model_text(MODEL)) | change, "model.json")


def test_a_file_that_is_no_model_is_refused(tmp_path):
    path = tmp_path / "model.json"
    with pytest.raises(InputError, match="cannot read the model file"):
        read_model(path)
    path.write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match="not a JSON model file"):
        read_model(path)
    path.write_text("[]", encoding="utf-8")
    with pytest.raises(InputError, match="key 'coefficients' is missing"):
        read_model(path)
