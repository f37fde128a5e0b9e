"""How far each constant may be off: by what is stated, what measured it, and what earlier runs showed."""

from pathlib import Path

import numpy as np
import pytest

from daq.press.press_file import parse_press, press_for_run
from daq.press.resin_file import read_resin
from daq.records import Run
from softsensor.live.curing import resin_setup
from softsensor.signals.doubt import Origin, constant_doubts, one_product

PRESS = """
[[layer]]
name = "plate"
thickness_mm = 10.0
thickness_mm.sd = 0.02
conductivity_W_mK = [[20, 45.0], [200, 44.0]]
density_kg_m3 = 7850.0
heat_capacity_J_kgK = 490.0
[[layer]]
name = "panel"
from_run = true
[boundary.top]
kind = "flux"
incident_W_m2 = 30000.0
incident_W_m2.sd = 300.0
absorptivity = 0.9
[[sensor]]
columns = ["in_1"]
at = { layer = "panel", depth_mm = 8.0 }
"""
HEADER = {
    "panel.material": "MDF",
    "panel.thickness_mm": 16.0,
    "panel.conductivity_W_mK": 0.13,
    "panel.conductivity_W_mK.sd": 0.004,
    "panel.initial_temperature_C": 21.0,
}


def doubts(header, learned=None):
    run = Run("r", HEADER | header, np.arange(3.0), {})
    return constant_doubts(run.header, press_for_run(parse_press(PRESS), run), learned)


def test_a_deviation_beside_a_number_goes_before_every_class():
    found = doubts({})
    assert (found["panel.conductivity_W_mK"].sd, found["panel.conductivity_W_mK"].source) == (
        0.004,
        Origin.STATED,
    )
    assert (found["layer.plate.thickness_mm"].sd, found["layer.plate.thickness_mm"].source) == (
        0.02,
        Origin.STATED,
    )
    assert found["boundary.top.incident_W_m2"].sd == 300.0


def test_a_flux_of_the_run_is_not_as_sure_as_the_press_files_was_stated_to_be():
    found = doubts({"boundary.top.incident_W_m2": 60000.0})["boundary.top.incident_W_m2"]
    assert (found.value, found.sd, found.source) == (60000.0, pytest.approx(1200.0), Origin.DATA_SHEET)
    stated = doubts({"boundary.top.incident_W_m2": 60000.0, "boundary.top.incident_W_m2.sd": 900.0})
    assert (stated["boundary.top.incident_W_m2"].sd, stated["boundary.top.incident_W_m2"].source) == (
        900.0,
        Origin.STATED,
    )


@pytest.mark.parametrize(
    ("key", "value", "source"),
    [
        ("panel.density_kg_m3", 740.0, Origin.STATED),
        ("panel.moisture_percent", 7.5, Origin.GUESS),
        ("ambient.temperature_C", 23.0, Origin.GUESS),
    ],
)
def test_a_standard_deviation_counts_where_the_material_table_or_nobody_gives_the_number(key, value, source):
    alone = {name: given for name, given in HEADER.items() if name != key} | {f"{key}.sd": 0.7}
    for learned in ({}, {key: 0.5}):
        found = constant_doubts(alone, parse_press(PRESS), learned)[key]
        assert (found.value, found.sd, found.source) == (value, 0.7, source)


def test_a_number_of_the_material_table_is_worth_what_the_table_says():
    density = doubts({})["panel.density_kg_m3"]
    assert (density.value, density.relative, density.source) == (
        740.0,
        pytest.approx(0.2),
        Origin.MATERIAL_TABLE,
    )
    given = doubts({"panel.density_kg_m3": 731.0})["panel.density_kg_m3"]
    assert given.relative < 0.05
    assert given.source is Origin.DATA_SHEET


def test_what_runs_have_shown_goes_before_a_class_and_never_before_what_is_stated_or_measured():
    keys = (
        "panel.density_kg_m3",
        "panel.conductivity_W_mK",
        "panel.initial_temperature_C",
        "boundary.bottom.none",
    )
    found = doubts({}, dict.fromkeys(keys, 0.08))
    assert found["panel.density_kg_m3"].sd == pytest.approx(0.08 * 740.0)
    assert found["panel.density_kg_m3"].source is Origin.LEARNED
    assert found["panel.conductivity_W_mK"].source is Origin.STATED
    assert found["panel.initial_temperature_C"].source is Origin.MEASURED
    assert "boundary.bottom.none" not in found


def test_a_table_in_temperature_is_doubted_as_a_whole():
    k = doubts({})["layer.plate.conductivity_W_mK"]
    assert (k.value, k.relative) == (45.0, pytest.approx(0.05))


def test_what_nobody_gave_is_a_guess_and_what_the_rig_lacks_is_not_there():
    found = doubts({})
    assert found["ambient.temperature_C"].source is Origin.GUESS
    assert found["panel.moisture_percent"].source is Origin.GUESS
    bar = parse_press(PRESS.replace("from_run = true", "thickness_mm = 9.0\nconductivity_W_mK = 1.0\n"
                                    "density_kg_m3 = 900.0\nheat_capacity_J_kgK = 800.0"))  # fmt: skip
    assert not [key for key in constant_doubts({}, bar) if key.startswith("panel.")]


def test_thickness_is_known_to_the_standards_tolerance():
    assert doubts({})["panel.thickness_mm"].sd == 0.1
    assert doubts({"panel.thickness_mm": 28.0})["panel.thickness_mm"].sd == 0.15


@pytest.mark.parametrize("header", [{}, {"panel.moisture_percent.sd": 0.3}])
def test_steam_takes_the_moisture_that_the_constants_have(header):
    given = HEADER | {"panel.moisture_percent": 8.0} | header
    doubt = doubts(given)["panel.moisture_percent"]
    resin = read_resin(Path("deploy/resins/urea_formaldehyde.toml"))
    assert resin_setup(resin, given, parse_press(PRESS)).moisture == (doubt.value, doubt.sd)


def test_steam_of_a_panel_whose_moisture_nobody_gave_rests_on_no_guess():
    resin = read_resin(Path("deploy/resins/urea_formaldehyde.toml"))
    assert doubts({})["panel.moisture_percent"].source is Origin.GUESS
    for sd in ({}, {"panel.moisture_percent.sd": 0.7}):  # how sure a number is makes none
        assert np.isnan(resin_setup(resin, HEADER | sd, parse_press(PRESS)).moisture).all()


def test_a_constant_of_the_header_is_as_unsure_in_share_whatever_its_size():
    light, heavy = (doubts({"panel.density_kg_m3": value})["panel.density_kg_m3"] for value in (400.0, 800.0))
    assert 0.0 < light.sd < 0.1 * light.value
    assert heavy.sd == pytest.approx(2.0 * light.sd)


def test_panels_of_one_nominal_thickness_differ_by_twice_the_norms_tolerance_at_most():
    """EN 622-1: 0.2 mm to either side up to 19 mm, 0.3 mm beyond."""
    assert one_product(15.81, 16.19)
    assert not one_product(15.8, 16.25)
    assert one_product(28.0, 28.55)
    assert not one_product(28.0, 28.65)
