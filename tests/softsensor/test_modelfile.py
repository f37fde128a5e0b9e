"""Model files: what is written is read, what is wrong is named."""

import json

import numpy as np
import pytest

from daq.records import InputError
from daq.words import spoken
from daq.words.message import words
from softsensor.heat.model_file import FittedValue, ModelFile, PressedPanel, Scatter, model_text
from softsensor.heat.model_reading import parse_model
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
        ({"coefficients": {"h_wa": 12.0}}, r"coefficients\.h_wa = 12: needs numbers value and sd"),
        (
            {"coefficients": {"h_wa": {"value": "nan"}}},
            r"coefficients\.h_wa = \{'value': 'nan'\}: needs numbers value and sd",
        ),
        (
            {"coefficients": {"h_wa": {"value": -3.0}}},
            r"coefficients\.h_wa\.value = -3: must be a number from 0\.001 to 1000000000 W/m²K",
        ),
        ({"effects": [{"parameters": {}}]}, r"effects\.0 has no name"),
        ({"effects": [{"name": "draft"}]}, "model.json: effect 'draft' is not in the catalogue"),
        (
            {"effects": [{"name": "edge_loss", "parameters": {"h": {"value": 1.0}}}]},
            r"effects\.0\.parameters\.h: edge_loss has W_m3K",
        ),
        (
            {"coefficients": {"h_wa": {"value": 1e12, "sd": 1.0}}},
            r"h_wa\.value = 1e\+12: must be a number from 0\.001 to 1000000000 W/m²K",
        ),
        ({"coefficients": {"h_wa": {"value": "12", "sd": 1.0}}}, r"h_wa = \{.*\}: needs numbers value and sd"),
        ({"coefficients": {"h_wa": {"value": 12.0, "std": 1.0}}}, r"h_wa = \{.*\}: needs numbers value and sd"),
        ({"coefficients": {"h_wa": {"value": 12.0, "sd": -1.0}}}, r"h_wa\.sd = -1: a standard deviation must be"),
        ({"coefficients": {"h_wa": {"value": 12.0, "sd": float("nan")}}}, r"h_wa\.sd = nan: a standard deviation"),
        ({"coeficients": {}}, "key 'coeficients' is not known; did you mean coefficients"),
        (
            {"effects": [{"name": "edge_loss", "parameter": {}}]},
            "edge_loss has no size; give under parameters W_m3K",
        ),
        (
            {"effects": 2 * [{"name": "edge_loss", "parameters": {"W_m3K": {"value": 1.0, "sd": 1.0}}}]},
            r"effects\.1: edge_loss stands in effects twice",
        ),
        (
            {"effects": [{"name": "edge_loss", "parameters": {"W_m3K": {"value": 70000.0, "sd": 1.0}}}]},
            r"parameters\.W_m3K = 70000 \(edge_loss\) lies outside its limits 0 to 20000 W/m³K$",
        ),
        ({"effects": {"name": "edge_loss"}}, "effects is not as fit, diagnose and the nightly job write it"),
        ({"effects": None}, "effects is not as fit, diagnose and the nightly job write it"),
        ({"panels": [{"thickness_mm": 16.0}]}, "panels is not as fit, diagnose and"),
        ({"panels": [{"thickness_mm": -16.0, "runs": 3}]}, "panels is not as fit, diagnose and"),
        ({"panels": 16.0}, "panels is not as fit, diagnose and"),
        ({"covariance": 3}, "covariance is not as fit, diagnose and"),
        (
            {"covariance": {"names": ["h_wa"], "matrix": [[1.0, 2.0]]}},
            "matrix is 1 x 2, and covariance.names has 1",
        ),
        ({"covariance": {"names": ["h_wa"], "matrix": [[float("nan")]]}}, "covariance of h_wa and h_wa = nan"),
        ({"covariance": {"names": ["h_wa"], "matrix": [[-0.01]]}}, r"covariance of h_wa and h_wa = -0\.01"),
        (
            {"covariance": {"names": ["h_wa", "h_pp_c"], "matrix": [[0.01, 0.02], [0.02, 0.01]]}},
            r"covariance of h_wa and h_pp_c = 0\.02: no covariance matrix has that there",
        ),
        (
            {"covariance": {"names": ["h_zz"], "matrix": [[0.1]]}},
            "names has h_zz, which the file gives no value of",
        ),
        ({"adequacy": {"runs": 3, "nothing": 7.0, "unexplained_K": 0.1, "causes": {}}}, "adequacy is not as fit"),
        ({"scatter": {"panel.thickness_mm": {"sd": -0.1, "runs": 3}}}, "scatter is not as fit, diagnose and"),
        (
            {"scatter": {"panel.density_kg_m3": {"sd": 1e9, "runs": 3}}},
            r"scatter\.panel\.density_kg_m3\.sd = 1e\+09: a share of the header's value, above 0 and at most 5000",
        ),
        (
            {"scatter": {"panel.thickness_mm": {"sd": 0.1, "runs": 3, "panel": 0.2}}},
            "scatter is not as fit, diagnose and",
        ),
    ],
)
def test_a_wrong_model_file_is_refused_with_its_key(change, message):
    with pytest.raises(InputError, match=message):
        parse_model(json.loads(model_text(MODEL)) | change, "model.json")


def test_limits_of_an_effect_are_in_the_readers_language():
    wrong = {"name": "moisture_evaporation", "parameters": {"moisture_percent": {"value": 70.0, "sd": 1.0}}}
    with pytest.raises(InputError) as refused:
        parse_model(json.loads(model_text(MODEL)) | {"effects": [wrong]}, "model.json")
    text = words(spoken(refused.value), "de")
    assert text.endswith("liegt außerhalb der Grenzen 0 bis 30 % der Trockenmasse")


def test_a_file_that_is_no_model_is_refused(tmp_path):
    path = tmp_path / "model.json"
    with pytest.raises(InputError, match="cannot read the model file"):
        read_model(path)
    path.write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match="not a JSON model file"):
        read_model(path)
    for text, expected in ((9000 * "[", "more than 16 deep"), ('{"coefficients": ' + 5000 * "1", "300 digits")):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=f"not a JSON model file: .*{expected}"):
            read_model(path)
    path.write_text("[]", encoding="utf-8")
    with pytest.raises(InputError, match="key 'coefficients' is missing"):
        read_model(path)
