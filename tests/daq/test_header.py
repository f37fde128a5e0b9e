"""A run's header: mistyped keys, numbers that cannot be, standard deviations, doubts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.files.run_file import read_run, write_run
from daq.press.header import CONSTANTS, check_header, doubts, panel_of
from daq.press.press_file import parse_press, press_for_run, read_press
from daq.process.config import load_config
from daq.records import InputError, Run
from daq.store.convert import header_of, header_text

LAB = Path(__file__).resolve().parents[2] / "deploy" / "presses" / "lab.toml"
ROWS = "time_s,platen_top,top_1\n0,200,20\n1,200,21\n"


def file_with(folder, *lines):
    path = folder / "x.csv"
    path.write_text("".join(f"# {line}\n" for line in lines) + ROWS)
    return path


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("boundry.top.incident_W_m2 = 60000", "boundary.top.incident_W_m2"),
        ("panel.thicknes_mm = 16.0", "panel.thickness_mm"),
        ("panel.thickness = 16.0", "panel.thickness_mm"),
        ("thickness_mm = 12.0", "panel.thickness_mm"),
        ("moisture_percent.sd = 0.1", "panel.moisture_percent"),
        ("panel.thicknes_mm.sd = 0.1", "panel.thickness_mm"),
        ("pannel.density_kg_m3 = 700", "panel.density_kg_m3"),
        ("setting.platen_temprature_C = 200", "setting.platen_temperature_C"),
        ("ambiant.temperature_C = 20", "ambient.temperature_C"),
        ("remarks = 'x'", "remark"),
        ("panel.conductivity_W_mK.std = 0.004", "panel.conductivity_W_mK.sd"),
        ("panel.thickness_mm.uncertainty = 0.1", "panel.thickness_mm.sd"),
        ("panel.material.sd = 1.0", "panel.material"),
    ],
)
def test_a_mistyped_header_key_is_refused_with_the_one_that_was_meant(tmp_path, line, meant):
    with pytest.raises(InputError, match=rf"x\.csv: header key .* did you mean {meant}\?"):
        read_run(file_with(tmp_path, line))


def test_a_text_below_a_number_is_kept_with_a_question(tmp_path):
    run = read_run(file_with(tmp_path, "panel.thickness_mm = 16.0", "panel.thickness_mm.source = 'caliper'"))
    assert run.header["panel.thickness_mm.source"] == "caliper"
    assert [m.arguments for m in doubts(run.header) if m.code == "header-key-unknown"] == [
        {"key": "panel.thickness_mm.source"}
    ]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (4301 * "9", "a whole number with more than 300 digits"),
        (3000 * "[" + 3000 * "]", "more than 16 deep"),
        (3000 * "{a=" + "1" + 3000 * "}", "more than 16 deep"),
    ],
)
def test_numbers_and_nesting_that_would_kill_the_reader_are_refused_by_line(tmp_path, value, expected):
    with pytest.raises(InputError, match=rf"x\.csv: line 1: .*{expected}"):
        read_run(file_with(tmp_path, f"x = {value}"))


@pytest.mark.parametrize("line", ['boundary = "x"', "layer = []", 'press = "x"', 'setting = "x"'])
def test_a_table_of_the_press_file_without_its_key_is_kept_with_a_word(tmp_path, line):
    key = line.partition(" ")[0]
    texts = [str(doubt) for doubt in doubts(read_run(file_with(tmp_path, line)).header)]
    assert texts == [f"header key {key} is not known; it is kept, and nothing uses it"]


@pytest.mark.parametrize(
    "line",
    [
        'recorded.started_utc = "2026-03-04T07:00:00Z"',
        'remark = "x"',
        "setting.feed_m_min = 3.0",
        "setting.platen_temperature_top_C = 200",
        "setting.press_time_2_s = 30.0",
        "boundary.top.incident_W_m2 = 60000",
        "panel.thickness_mm.sd = 0.1",
    ],
)
def test_keys_of_today_and_of_a_plants_own_settings_are_read_without_a_word(tmp_path, line):
    run = read_run(file_with(tmp_path, line))
    assert doubts(run.header) == ()
    write_run(run, tmp_path / "again.csv")
    assert read_run(tmp_path / "again.csv").header == {**run.header, "run": "x"}


def test_a_key_that_nothing_knows_is_kept_exported_and_doubted_once(tmp_path):
    run = read_run(file_with(tmp_path, 'panel.supplier = "north"', "shift = 2"))
    assert [str(doubt) for doubt in doubts(run.header)] == [
        "header key panel.supplier is not known; it is kept, and nothing uses it",
        "header key shift is not known; it is kept, and nothing uses it",
    ]
    write_run(run, tmp_path / "again.csv")
    assert read_run(tmp_path / "again.csv").header["panel.supplier"] == "north"


@pytest.mark.parametrize(
    "line",
    [
        'panel.thickness_mm = "sixteen"',
        "panel.thickness_mm = -3",
        "panel.thickness_mm = nan",
        "panel.thickness_mm = true",
        "panel.density_kg_m3 = inf",
        "ambient.temperature_C = -500",
        "ambient.temperature_C = 500",
        "panel.moisture_percent = -1.0",
        'setting.platen_temperature_C = "hot"',
    ],
)
def test_a_number_that_cannot_be_is_refused_in_file_and_configuration_with_its_limits(tmp_path, line):
    key, _, value = line.partition(" = ")
    text = rf"header key {key} = .*: must be a number from .* to .*"
    with pytest.raises(InputError, match=rf"x\.csv: {text}"):
        read_run(file_with(tmp_path, line))
    config = tmp_path / "kerntemp.toml"
    config.write_text(
        f'[[press]]\nname = "lab"\nfile = "{LAB}"\nheader = {{ "{key}" = {value} }}\n'
        '[[press.logger]]\nname = "a"\n'
        'profile = "adam-6018+"\nhost = "h"\nchannels = ["platen_top", "platen_bottom"]\n'
    )
    with pytest.raises(InputError, match=rf"kerntemp\.toml: press lab: {text}"):
        load_config(config)


def test_a_density_far_from_the_material_table_is_doubted_and_a_near_one_is_not():
    far = doubts({"panel.material": "MDF", "panel.density_kg_m3": 400})
    assert [str(doubt) for doubt in far] == [
        "header key panel.density_kg_m3 = 400 kg/m³ lies far from the 740 kg/m³ of MDF in the material table; "
        "check it"
    ]
    assert not doubts({"panel.material": "MDF", "panel.density_kg_m3": 650})
    cork = {"panel.material": "cork", **dict.fromkeys(CONSTANTS, 400.0)}
    assert not doubts(cork)
    assert not doubts({"panel.thickness_mm": 16.0})


def test_a_material_that_nothing_knows_is_doubted_with_what_is_missing_of_it():
    (doubt,) = doubts({"panel.material": "MFD", "panel.density_kg_m3": 740.0})
    assert "material 'MFD' is not in the table" in str(doubt)
    assert "panel.conductivity_W_mK, panel.heat_capacity_J_kgK is given nowhere" in str(doubt)


@pytest.mark.parametrize("value", [0, -1.0, float("nan"), "small", True])
def test_a_standard_deviation_is_a_positive_number_in_header_and_press_file(value):
    with pytest.raises(InputError, match="a standard deviation must be a positive number"):
        check_header({"panel.conductivity_W_mK.sd": value}, "x.csv")
    toml = {float: repr, int: repr, str: lambda x: f'"{x}"', bool: lambda x: "true"}[type(value)](value)
    with pytest.raises(InputError, match="a standard deviation must be a positive number"):
        parse_press(LAB.read_text().replace("guess = 700.0", f"guess = 700.0\nguess.sd = {toml}"))


def test_a_standard_deviation_beside_a_number_of_the_press_file_is_kept_also_through_an_override():
    text = LAB.read_text()
    press = parse_press(text.replace("thickness_mm = 10.0", "thickness_mm = 10.0\nthickness_mm.sd = 0.05", 1))
    assert press.layer[0].sd == (("thickness_mm", 0.05),)
    assert read_press(LAB).layer[0].sd == ()
    assert "sd" not in press.layer[1].model_dump()
    header = {"layer.plate_top.thickness_mm": 12.0, "layer.plate_top.thickness_mm.sd": 0.2}
    own = press_for_run(press, Run("r", header, np.arange(2.0), {}))
    assert own.layer[0].sd == (("thickness_mm", 0.05),)
    assert own.layer[2].sd == (("thickness_mm", 0.2),)
    with pytest.raises(InputError, match=r"colour\.sd: there is no number colour beside it"):
        parse_press(text.replace("area_m2", "colour.sd = 1.0\narea_m2"))


def test_the_header_of_a_run_of_today_makes_the_panel_it_made():
    header = {"panel.material": "MDF", "panel.thickness_mm": 16.0, "panel.initial_temperature_C": 20.0}
    panel = panel_of(Run("r", header, np.arange(2.0), {}))
    assert (panel.density, panel.conductivity, panel.heat_capacity) == (740.0, 0.12, 1550.0)


def test_a_standard_deviation_beside_its_number_goes_through_file_and_store_unchanged(tmp_path):
    run = read_run(file_with(tmp_path, "panel.thickness_mm = 16.0", "panel.thickness_mm.sd = 0.1"))
    assert header_of(header_text(run.header)) == run.header
    for ending in (".csv", ".parquet"):
        write_run(run, tmp_path / f"again{ending}")
        assert read_run(tmp_path / f"again{ending}").header["panel.thickness_mm.sd"] == 0.1


@pytest.mark.parametrize("key", ["setting.feed_m_min", "panel.colour_index", "ambient.humidity_percent"])
@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e400"])
def test_a_number_that_is_none_is_refused_under_a_free_key_as_under_a_known_one(tmp_path, key, value):
    with pytest.raises(InputError, match=rf"x\.csv: header key {key} = .* must be a finite number"):
        read_run(file_with(tmp_path, f"{key} = {value}"))


@pytest.mark.parametrize("key", ["coefficients.h_pp_c.upper", "batch"])
def test_an_override_is_left_to_the_press_file_and_what_nothing_knows_is_kept(tmp_path, key):
    assert read_run(file_with(tmp_path, f"{key} = inf")).header[key] == float("inf")


def test_a_standard_deviation_wider_than_what_its_number_can_be_is_refused():
    check_header({"panel.moisture_percent.sd": 200.0}, "x.csv")
    with pytest.raises(
        InputError, match=r"panel\.moisture_percent\.sd = 1000000000\.0: .* at most 200 %, the width"
    ):
        check_header({"panel.moisture_percent.sd": 1e9}, "x.csv")


@pytest.mark.parametrize(
    ("key", "value", "taken"),
    [
        ("run", "2026-01\u202e-exe", False),
        ("run", "lab\u200b-1", False),
        ("run", "\ufefflab-1", False),
        ("panel.material", "MDF\u00ad", False),
        ("recipe", "16 mm\u2066", False),
        ("panel.material", "\x1b[31mMDF", False),
        ("remark", "line one\n\tline two", True),
        ("remark", "\u0645\u06cc\u200c\u062e\u0648\u0627\u0647\u0645, na\u0308sse", True),
        ("run", "Prüfung-7 (Süd)", True),
    ],
)
def test_a_name_holds_no_character_that_nobody_sees_a_remark_may(key, value, taken):
    """A name is compared, and typed again from what is seen."""
    header = {"panel.material": "MDF", key: value}
    if taken:
        check_header(header, "run.csv")
        return
    with pytest.raises(InputError) as refused:
        check_header(header, "run.csv")
    assert refused.value.args[0].arguments["what"].code == "header-unseen"
    assert key in str(refused.value)
    assert not any(ord(character) > 0x2000 or character == "\x1b" for character in str(refused.value))
