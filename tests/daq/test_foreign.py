"""Files of foreign loggers: explained by a mapping, tried on measured ones."""

import re
import tomllib
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from packaging.requirements import Requirement

from daq.files.mapped_rows import _ROWS_AT_ONCE
from daq.files.mapping import _rounded, read_foreign, read_mapping
from daq.files.run_file import read_run, write_run
from daq.press.events import find_moments
from daq.press.press_file import press_for_run, read_press
from daq.records import InputError, Run
from tests.measured import (
    COPPER_DISC,
    DRY_DISCS,
    INERT_BOARD,
    MOIST_DISCS_40_KW,
    PINE_DEPTH,
    PINE_SLABS,
    PMMA_25_KW,
    PMMA_50_KW,
    PRESS_RIG,
    ROOT,
    measured,
)

GERMAN = """Messung;Presse 2
Zeit;Platte oben;Fläche oben 1;Kraft
;°C;K;kN
04.03.2026 23:59:59;199,8;293,95;1.250,5
05.03.2026 00:00:00;199,7;---;1.251,0

05.03.2026 00:00:00;199,7;294,05;1.251,0
05.03.2026 00:00:56;199,5;1400,00;1.249,5
"""
MAPPING = """
[file]
delimiter = ";"
decimal = ","
header_line = 2
units_lines = 1
[time]
column = "Zeit"
format = "%d.%m.%Y %H:%M:%S"
repeated = "first"
[[column]]
from = "Platte oben"
to = "platen_top"
[[column]]
from = "Fläche oben 1"
to = "top_1"
unit = "K"
upper = 1000.0
[[column]]
from = "Kraft"
to = "load"
unit = ""
scale = 1000.0
[header]
"panel.material" = "MDF"
[header_from."panel.initial_temperature_C"]
column = "top_1"
[[variant]]
match = "shift*"
header = { "setting.platen_temperature_C" = 200 }
"""


@pytest.fixture
def files(tmp_path):
    (tmp_path / "shift 7.csv").write_text(GERMAN)
    (tmp_path / "map.toml").write_text(MAPPING)
    return tmp_path


def test_decimal_commas_units_dates_gaps_and_faults_become_a_run_file(files):
    run = read_foreign(files / "shift 7.csv", read_mapping(files / "map.toml"))
    assert run.name == "shift 7"
    assert run.time_s.tolist() == [0.0, 1.0, 57.0]
    assert run.columns["platen_top"].tolist() == [199.8, 199.7, 199.5]
    np.testing.assert_array_equal(run.columns["top_1"], [20.8, np.nan, np.nan])
    assert run.columns["load"].tolist() == [1250500.0, 1251000.0, 1249500.0]
    assert run.header == {
        "run": "shift 7",
        "panel.material": "MDF",
        "setting.platen_temperature_C": 200,
        "panel.initial_temperature_C": 20.8,
    }
    write_run(run, files / "out.csv")
    assert read_run(files / "out.csv").columns["load"].tolist() == run.columns["load"].tolist()


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("map.toml", ('unit = "K"', 'unit = "R"'), r"map.toml: column.1.unit = 'R'"),
        ("map.toml", ('to = "top_1"', 'to = "platen_top"'), r"column.to = 'platen_top' occurs twice"),
        ("map.toml", ('column = "top_1"', 'column = "top_2"'), r"'top_2': no \[\[column\]\] maps to it"),
        ("map.toml", ('delimiter = ";"', 'separator = ";"'), r"file.separator = ';': unknown key"),
        ("map.toml", ('from = "Kraft"', 'from = "Druck"'), r"column 'Druck' of the mapping is not in the file"),
        ("map.toml", ('repeated = "first"', ""), r"line 7: column Zeit: '05.03.2026 00:00:00' does not rise"),
        ("map.toml", ("%d.%m.%Y", "%m/%d/%Y"), r"line 4: column Zeit: '04.03.2026 23:59:59' is not"),
        ("shift 7.csv", ("199,7;---", "199.7;---"), r"line 5: column Platte oben: '199.7' is not a number"),
        ("shift 7.csv", ("199,5;1400,00;1.249,5", "199,5"), r"line 8: 2 cells, but line 2 names 4 columns"),
    ],
)
def test_what_a_mapping_does_not_explain_is_named(files, name, change, message):
    path = files / name
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(InputError, match=message) as caught:
        read_foreign(files / "shift 7.csv", read_mapping(files / "map.toml"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("layout", "cells", "expected"),
    [
        ("seconds", ["40698.16", "40698.845"], [0.0, 0.685]),
        ("minutes", ["1", "1.5"], [0.0, 30.0]),
        ("milliseconds", ["100", "350"], [0.0, 0.25]),
        ("clock", ["23:59:59.5", "00:00:01.0"], [0.0, 1.5]),
        ("iso", ["2026-03-04T07:00:00Z", "2026-03-04T09:00:01+02:00"], [0.0, 1.0]),
        ("%H:%M:%S.%f", ["07:00:00.25", "07:00:01.00"], [0.0, 0.75]),
    ],
)
def test_times_are_understood_in_many_ways(tmp_path, layout, cells, expected):
    (tmp_path / "a.csv").write_text("t,x\n" + "".join(f"{c},1\n" for c in cells))
    (tmp_path / "m.toml").write_text(
        f'[time]\ncolumn = "t"\nformat = "{layout}"\n[[column]]\nfrom = "x"\nto = "x"\n'
    )
    run = read_foreign(tmp_path / "a.csv", read_mapping(tmp_path / "m.toml"))
    np.testing.assert_allclose(run.time_s, expected, atol=1e-5)


LONG_GAP = [0.0, 3000.0, 3001.0, 3599.0, 3600.0, 3601.0, 3602.0, 6000.0]
TWICE = [
    (["02:30:00", "02:30:00", "02:30:01"], [0.0, 1.0]),
    (["02:59:59", "02:59:59", "02:00:00", "02:00:00", "02:00:01"], [0.0, 1.0, 2.0]),
    (["02:30:00", "02:30:01", "02:30:00", "02:30:02"], [0.0, 1.0, 2.0]),
    (["02:50:00", "02:15:00", "02:30:00"], [0.0, 1500.0, 2400.0]),
    (["02:20:00", "02:10:00", "02:10:01", "02:19:59", "02:20:00", "02:20:01", "02:20:02", "03:00:00"], LONG_GAP),
    (["02:19:58", "02:19:59", "02:20:00", "02:10:00", "02:10:01"], [0.0, 1.0, 2.0, 3002.0, 3003.0]),
    (["02:30:00", "02:45:00", "02:00:00", "02:15:00"], [0.0, 900.0, 1800.0, 2700.0]),
    (["02:00:00", "02:30:00", "02:00:00", "02:30:00"], [0.0, 1800.0, 3600.0, 5400.0]),
    (["02:59:59", "02:00:00", "02:59:58", "02:00:01"], [0.0, 1.0, 2.0]),
]


@pytest.mark.parametrize(("cells", "expected"), TWICE)
def test_within_the_hour_that_comes_twice_a_repeated_or_late_row_is_no_change_of_clocks(tmp_path, cells, expected):
    (tmp_path / "night.csv").write_text("t,x\n" + "".join(f"2026-10-25T{cell},20\n" for cell in cells))
    (tmp_path / "m.toml").write_text(
        '[time]\ncolumn = "t"\nformat = "iso"\nzone = "Europe/Berlin"\nrepeated = "first"\n'
        '[[column]]\nfrom = "x"\nto = "x"\n'
    )
    run = read_foreign(tmp_path / "night.csv", read_mapping(tmp_path / "m.toml"))
    assert run.time_s.tolist() == expected


def test_date_and_time_in_two_columns_over_the_hour_that_comes_twice(tmp_path):
    (tmp_path / "night.csv").write_text(
        "Datum;Uhrzeit;T1\n25.10.2026;02:59:58;20,5\n25.10.2026;02:59:59;20,6\n25.10.2026;02:00:00;20,7\n"
        "25.10.2026;02:00:01;20,8\n25.10.2026;03:00:00;20,9\n"
    )
    mapping = (
        '[file]\ndelimiter = ";"\ndecimal = ","\n[time]\ncolumn = ["Datum", "Uhrzeit"]\n'
        'format = "%d.%m.%Y %H:%M:%S"\nzone = "Europe/Berlin"\n[[column]]\nfrom = "T1"\nto = "top_1"\n'
    )
    (tmp_path / "m.toml").write_text(mapping)
    run = read_foreign(tmp_path / "night.csv", read_mapping(tmp_path / "m.toml"))
    assert run.time_s.tolist() == [0.0, 1.0, 2.0, 3.0, 3602.0]
    assert run.header["recorded.started_utc"] == datetime(2026, 10, 25, 0, 59, 58, tzinfo=UTC)
    (tmp_path / "m.toml").write_text(mapping.replace("Europe/Berlin", "Europe/Bärlin"))
    with pytest.raises(InputError, match=r"time.zone = 'Europe/Bärlin'.*such as Europe/Berlin"):
        read_mapping(tmp_path / "m.toml")
    (tmp_path / "m.toml").write_text(mapping)
    (tmp_path / "night.csv").write_text("Datum;Uhrzeit;T1;T1\n25.10.2026;02:59:58;20,5;7\n")
    with pytest.raises(InputError, match="column 'T1' of the mapping is in the file twice"):
        read_foreign(tmp_path / "night.csv", read_mapping(tmp_path / "m.toml"))


@pytest.mark.parametrize(
    ("mapping", "press", "names", "sensors"),
    [
        ("press_rig", "rig", PRESS_RIG, {"T_Inco1", "T_Inco2"}),
        (
            "inert_board",
            "inert_board",
            INERT_BOARD,
            {"depth_5_72mm", "depth_11_44mm", "depth_17_16mm"},
        ),
        ("pine_slab", "pine_slab", PINE_SLABS, {"bottom_1"}),
        ("pine", "pine_disc", (*MOIST_DISCS_40_KW, *DRY_DISCS), {"bottom_1"}),
        ("pine_depth", "pine_depth", PINE_DEPTH, {"depth_17_2mm"}),
        ("pmma", "pmma", PMMA_25_KW, {"bottom_1", "bottom_2"}),
        ("pmma", "pmma", PMMA_50_KW[:2], {"bottom_1", "bottom_2", "bottom_3"}),
    ],
)
def test_measured_files_are_read_whole_and_fit_their_press_file(mapping, press, names, sensors, tmp_path):
    explained = read_mapping(ROOT / "deploy" / "mappings" / f"{mapping}.toml")
    rig = read_press(ROOT / "deploy" / "presses" / f"{press}.toml")
    for path in measured(names):
        run = read_foreign(path, explained)
        assert set(rig.sensors_of(run)) == sensors
        for boundary in (rig.boundary.bottom, rig.boundary.top):
            assert boundary.column is None or np.isfinite(run.columns[boundary.column]).all()
        assert press_for_run(rig, run).name == rig.name
        for column in sensors:
            assert np.nanmin(run.columns[column]) > 10.0
        assert not rig.has_states
        assert find_moments(run, rig).inserted_s == run.time_s[0]
        write_run(run, tmp_path / "out.parquet")
        assert read_run(tmp_path / "out.parquet").time_s.tobytes() == run.time_s.tobytes()


def test_the_rig_is_driven_by_two_thermocouples_and_pressed_with_245_kilopascals():
    path = measured(["press_rig/230918-1117-med2.dat"])[0]
    run = read_foreign(path, read_mapping(ROOT / "deploy" / "mappings" / "press_rig.toml"))
    # the bar is 16.25 mm thick; 5.2 kg weigh 51 N
    assert np.max(run.columns["load"]) == pytest.approx(5.2 * 9.81 / (np.pi / 4 * 0.01625**2) / 1000, rel=0.01)
    drop = run.columns["T_Inco1"] - run.columns["T_Inco2"]
    assert (drop.min(), drop.max()) == pytest.approx((28.0, 38.0), abs=0.5)
    assert np.median(np.diff(run.time_s)) == pytest.approx(0.70, abs=0.02)


def test_pmma_discs_are_read_with_their_thickness():
    explained = read_mapping(ROOT / "deploy" / "mappings" / "pmma.toml")
    thick = {p.stem[-2:]: read_foreign(p, explained) for p in measured(PMMA_25_KW)}
    assert {k: r.header["panel.thickness_mm"] for k, r in thick.items()} == {"R1": 6.26, "R2": 6.15, "R3": 5.8}


def test_every_shipped_mapping_takes_the_flux_its_file_names_and_the_start_its_sensor_reads():
    explained = read_mapping(ROOT / "deploy" / "mappings" / "pine.toml")
    for path in measured((*MOIST_DISCS_40_KW, *DRY_DISCS)):
        run = read_foreign(path, explained)
        assert run.header["boundary.top.incident_W_m2"] == 1000.0 * float(
            path.stem.partition("kW")[0].split("_")[-1]
        )
        assert run.header["panel.initial_temperature_C"] == pytest.approx(run.columns["bottom_1"][0], abs=1e-3)
        assert run.header["panel.mass_after_g"] < run.header["panel.mass_before_g"]


def test_a_slabs_file_is_not_read_as_a_discs_whose_columns_have_the_same_names(tmp_path):
    slab = tmp_path / "TIFP+UCT_Wood_Gasification_30kW_hor_parallel_R1.csv"
    slab.write_text("Time (s),Mass (g),TC back 1 (K)\n0,92.16,298.65\n1,91.98,298.65\n")
    with pytest.raises(InputError, match="name matches none of the mapping's variants of 'apparatus'"):
        read_foreign(slab, read_mapping(ROOT / "deploy" / "mappings" / "pine.toml"))


VARIANTS = """
required_variants = ["flux"]
[time]
column = "t"
[[column]]
from = "T1"
to = "a"
[[column]]
from = ["T2", "T_2"]
to = "b"
[[computed]]
to = "mean"
terms = { a = 0.25, b = 0.75 }
offset = 1.0
[header_from.remark_end]
column = "b"
row = "last"
[[variant]]
of = "flux"
match = "*_40kW_*"
header = { "boundary.top.incident_W_m2" = 40000.0 }
[[variant]]
of = "flux"
match = "*_q40_*"
header = { "boundary.top.incident_W_m2" = 41000.0 }
"""


def _variant(tmp_path, name, text="t,T1,T_2\n0,10,20\n1,,22\n2,14,24\n", mapping=VARIANTS):
    (tmp_path / "m.toml").write_text(mapping, encoding="utf-8")
    (tmp_path / name).write_text(text, encoding="utf-8")
    return read_foreign(tmp_path / name, read_mapping(tmp_path / "m.toml"))


def test_column_goes_by_the_first_of_its_names_that_the_file_has_and_others_are_computed(tmp_path):
    run = _variant(tmp_path, "x_40kW_R1.csv")
    assert run.columns["b"].tolist() == [20.0, 22.0, 24.0]
    np.testing.assert_array_equal(run.columns["mean"], [18.5, np.nan, 22.5])
    assert run.header["remark_end"] == 24.0
    assert run.header["boundary.top.incident_W_m2"] == 40000.0


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("x_60kW_R1.csv", r"x_60kW_R1\.csv: this file's name matches none of the mapping's variants of 'flux'"),
        ("x_40kW_q40_R1.csv", r"two variants of 'flux', '\*_40kW_\*' and '\*_q40_\*'"),
    ],
)
def test_file_of_a_variant_that_nobody_described_is_refused_not_taken_for_another(tmp_path, name, message):
    with pytest.raises(InputError, match=message):
        _variant(tmp_path, name)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("a = 0.25", "c = 0.25"), "no .*column.* leads to its term 'c'"),
        (('required_variants = ["flux"]', 'required_variants = ["grain"]'), "no .*variant.* has of = 'grain'"),
        (('to = "mean"', 'to = "a"'), "column.to = 'a' occurs twice"),
    ],
)
def test_mapping_that_computes_or_asks_for_what_it_lacks_is_refused(tmp_path, change, message):
    with pytest.raises(InputError, match=message):
        _variant(tmp_path, "x_40kW_R1.csv", mapping=VARIANTS.replace(*change))


def test_run_without_the_flux_that_its_press_file_leaves_to_it_is_refused():
    disc = read_press(ROOT / "deploy" / "presses" / "pine_disc.toml")
    run = Run("r", {"panel.initial_temperature_C": 20.0}, np.arange(3.0), {"bottom_1": np.arange(3.0)})
    with pytest.raises(InputError, match=r"header key boundary\.top\.incident_W_m2 is missing"):
        press_for_run(disc, run)
    given = replace(run, header={**run.header, "boundary.top.incident_W_m2": 60000.0})
    assert press_for_run(disc, given).boundary.top.incident_W_m2 == 60000.0


def test_every_named_time_series_is_explained_by_a_mapping():
    mappings = [read_mapping(path) for path in sorted((ROOT / "deploy" / "mappings").glob("*.toml"))]
    discs = (*MOIST_DISCS_40_KW, *DRY_DISCS)
    tables = measured((*PRESS_RIG, *INERT_BOARD, *COPPER_DISC, *PMMA_25_KW, *PINE_DEPTH, *PINE_SLABS, *discs))

    def rows(path):
        for mapping in mappings:
            with suppress(InputError):
                yield len(read_foreign(path, mapping).time_s)

    assert not [path.name for path in tables if max(rows(path), default=0) < 100]


def test_time_zones_come_with_the_installation_where_the_system_has_none():
    wanted = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    windows = {"sys_platform": "win32", "platform_system": "Windows", "os_name": "nt"}
    installed = [Requirement(text) for text in wanted["dependencies"]]
    assert "tzdata" in {one.name for one in installed if one.marker is None or one.marker.evaluate(windows)}


def test_a_quoted_cell_of_several_lines_moves_no_line_number(tmp_path):
    mapped = _mapping(tmp_path, '[time]\ncolumn = "t"\n[[column]]\nfrom = "a"\nto = "top_1"\n')
    file = tmp_path / "x.csv"
    file.write_text('t,a,note\n0,1,"door\nopen"\n1,2,\n')
    assert read_foreign(file, mapped).columns["top_1"].tolist() == [1, 2]
    file.write_text('t,a,note\n0,1,"door\nopen"\n1,hot,\n')
    with pytest.raises(InputError, match="line 4: column a: 'hot' is not a number"):
        read_foreign(file, mapped)
    file.write_text('t,a,note\n0,1,"door\n1,2,\n')
    with pytest.raises(InputError, match=r"line 2: .*check its quotation marks"):
        read_foreign(file, mapped)


def test_what_is_no_temperature_is_refused_by_line_unless_the_mapping_calls_it_missing(tmp_path):
    text = '[time]\ncolumn = "t"\n[[column]]\nfrom = "a"\nto = "top_1"\n[[column]]\nfrom = "p"\nto = "load_N"\n'
    file = tmp_path / "x.csv"
    file.write_text("t,a,p\n0,20,50000\n1,-9999,60000\n")
    with pytest.raises(InputError, match=r"line 3: column a: -9999 °C is no temperature; .* set its lower"):
        read_foreign(file, _mapping(tmp_path, text), ["top_*"])
    run = read_foreign(file, _mapping(tmp_path, text.replace('"top_1"', '"top_1"\nlower = -50')), ["top_*"])
    assert np.isnan(run.columns["top_1"][1])
    assert run.columns["load_N"].tolist() == [50000, 60000]


@pytest.mark.parametrize(
    ("unit", "cell", "found"), [("K", "-5", -278.15), ("C", "-9999", -9999), ("F", "5000", 2760)]
)
def test_a_column_whose_unit_is_a_temperatures_holds_nothing_else_whoever_reads_it(tmp_path, unit, cell, found):
    text = f'[time]\ncolumn = "t"\n[[column]]\nfrom = "a"\nto = "top_1"\nunit = "{unit}"\n'
    (tmp_path / "x.csv").write_text(f"t,a\n0,300\n1,{cell}\n")
    mapped = _mapping(tmp_path, text)
    for temperatures in ([], ["top_*"]):
        with pytest.raises(InputError, match=rf"line 3: column a: {found:g} °C is no temperature"):
            read_foreign(tmp_path / "x.csv", mapped, temperatures)
    run = read_foreign(tmp_path / "x.csv", _mapping(tmp_path, text.replace(f'"{unit}"', '""')))
    assert run.columns["top_1"].tolist() == [300.0, float(cell)]


def _mapping(tmp_path, text):
    (tmp_path / "m.toml").write_text(text)
    return read_mapping(tmp_path / "m.toml")


@pytest.mark.parametrize(("time", "cell"), [("0", "٢١"), ("٠", "21"), ("0", "2_1"), ("0_0", "21")])
def test_digits_of_another_script_or_parted_by_dashes_are_no_numbers_in_a_foreign_file(tmp_path, time, cell):
    (tmp_path / "a.csv").write_text(f"t,x\n{time},{cell}\n1,22\n")
    (tmp_path / "m.toml").write_text('[time]\ncolumn = "t"\n[[column]]\nfrom = "x"\nto = "x"\n')
    with pytest.raises(InputError, match=r"line 2: column [tx]: '[٢١٠_012]+' is not"):
        read_foreign(tmp_path / "a.csv", read_mapping(tmp_path / "m.toml"))


TIMED = '[time]\ncolumn = "t"\nformat = "{}"\n{}\n[[column]]\nfrom = "x"\nto = "x"\n'


def _timed(tmp_path, layout, cells, more=""):
    (tmp_path / "a.csv").write_text("t,x\n" + "".join(f"{cell},1\n" for cell in cells))
    return read_foreign(tmp_path / "a.csv", _mapping(tmp_path, TIMED.format(layout, more)))


@pytest.mark.parametrize(
    ("layout", "cell"),
    [
        *(("seconds", cell) for cell in ("NaN", "nan", "inf", "-inf", "1e400", "")),
        *(("hours", cell) for cell in ("1e308", "Infinity")),
        *(("clock", f"08:{rest}") for rest in ("00:nan", "00:inf", "61:75", "60:00", "59:60", "-1:00", "00:-1")),
        *(("clock", cell) for cell in ("-1:00:00", f"{'9' * 400}:00:00", "1e1:00:00")),
        ("iso", "0001-01-01T00:00:00+02:00"),
    ],
)
@pytest.mark.parametrize("repeated", ["refuse", "first"])
def test_a_time_that_no_clock_shows_is_refused_by_line(tmp_path, layout, cell, repeated):
    first = "9999-01-01T00:00:00Z" if layout == "iso" else "08:00:00" if layout == "clock" else "0"
    why = (
        "is no time; every row needs one" if cell in ("NaN", "nan", "") else f"is not '{layout}'; set time.format"
    )
    for cells, line in (([cell, first], 2), ([first, cell], 3)):
        with pytest.raises(InputError, match=re.escape(f"a.csv: line {line}: column t: '{cell}' {why}")):
            _timed(tmp_path, layout, cells, f'repeated = "{repeated}"')


@pytest.mark.parametrize("layout", ["%H:%H:%S", "%d.%m.%Y %m:%H", "%"])
def test_a_format_that_says_something_twice_or_nothing_is_refused_by_line(tmp_path, layout):
    with pytest.raises(InputError, match=re.escape(f"line 2: column t: '08:00:00' is not '{layout}'; set time.f")):
        _timed(tmp_path, layout, ["08:00:00", "08:00:01"])


def test_times_that_differ_by_less_than_a_microsecond_do_not_rise(tmp_path):
    """The store counts microseconds: there they would be one."""
    with pytest.raises(InputError, match=r"line 4: column t: '0\.0000012' does not rise"):
        _timed(tmp_path, "seconds", ["0", "0.000001", "0.0000012"])
    run = _timed(tmp_path, "seconds", ["0", "0.000001", "0.0000012", "1"], 'repeated = "first"')
    assert run.time_s.tolist() == [0.0, 1e-6, 1.0]


@pytest.mark.parametrize(
    ("layout", "cells", "expected"),
    [
        ("%H:%M:%S", ["23:59:59", "00:00:01", "23:00:00", "00:00:00"], [0.0, 2.0, 82801.0, 86401.0]),
        ("%H.%M.%S;%f", ["23.59.59;5", "00.00.00;25"], [0.0, 0.75]),
        ("%I:%M:%S %p", ["11:59:59 PM", "12:00:01 AM"], [0.0, 2.0]),
        ("%H:%M:%S%z", ["23:59:59+0100", "00:00:01+0100"], [0.0, 2.0]),
    ],
)
@pytest.mark.parametrize("zone", ["", 'zone = "Europe/Berlin"'])
def test_a_time_of_day_passes_midnight_and_gives_no_date(tmp_path, layout, cells, expected, zone):
    run = _timed(tmp_path, layout, cells, zone)
    assert run.time_s.tolist() == expected
    assert "recorded.started_utc" not in run.header


@pytest.mark.parametrize("layout", ["clock", "%H:%M:%S"])
def test_a_row_of_before_midnight_that_comes_late_is_no_day_further_on(tmp_path, layout):
    cells = ["23:59:58", "23:59:59", "00:00:00", "23:59:59", "00:00:01", "00:00:02"]
    with pytest.raises(InputError, match="line 5: column t: '23:59:59'"):
        _timed(tmp_path, layout, cells)
    run = _timed(tmp_path, layout, cells, 'repeated = "first"')
    assert run.time_s.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_time_of_a_weekday_is_no_time_of_day_alone(tmp_path):
    with pytest.raises(InputError, match="line 3: column t: 'Mon 06:00:00'"):
        _timed(tmp_path, "%a %H:%M:%S", ["Fri 23:50:00", "Mon 06:00:00"])


def test_a_date_without_its_year_is_no_date(tmp_path):
    run = _timed(tmp_path, "%d.%m. %H:%M:%S", ["04.03. 23:59:59", "05.03. 00:00:01"], 'zone = "Europe/Berlin"')
    assert run.time_s.tolist() == [0.0, 2.0]
    assert "recorded.started_utc" not in run.header
    with_year = _timed(tmp_path, "%d.%m.%y %H:%M", ["04.03.26 07:00", "04.03.26 07:01"], 'zone = "Europe/Berlin"')
    assert with_year.header["recorded.started_utc"] == datetime(2026, 3, 4, 6, tzinfo=UTC)


NESTED = """
[time]
column = "t"
[[column]]
from = "x"
to = "top_1"
[header]
panel.density_kg_m3 = 760.0
panel.conductivity_W_mK = [[20.0, 0.11], [100.0, 0.13]]
"panel.thickness_mm" = 12.0
[header_from.panel.initial_temperature_C]
column = "top_1"
[[variant]]
match = "*.csv"
header.panel.material = "pine"
header.boundary.top.incident_W_m2 = 4e4
"""


def test_unquoted_dotted_keys_of_a_mapping_are_the_keys_of_a_header(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,21.5\n1,22\n")
    run = read_foreign(tmp_path / "a.csv", _mapping(tmp_path, NESTED))
    assert run.header == {
        "run": "a",
        "panel.density_kg_m3": 760.0,
        "panel.conductivity_W_mK": [[20.0, 0.11], [100.0, 0.13]],
        "panel.thickness_mm": 12.0,
        "panel.material": "pine",
        "boundary.top.incident_W_m2": 4e4,
        "panel.initial_temperature_C": 21.5,
    }
    with pytest.raises(
        InputError, match=r"m\.toml: header: header key panel\.thickness_mm is given twice; keep one"
    ):
        _mapping(tmp_path, NESTED.replace("[header]", "[header]\npanel.thickness_mm = 11.0", 1))
    twice = '[header_from."panel.initial_temperature_C"]\ncolumn = "top_1"\n[[variant]]'
    with pytest.raises(InputError, match=r"m\.toml: header_from: .* panel\.initial_temperature_C is given twice"):
        _mapping(tmp_path, NESTED.replace("[[variant]]", twice))
    with pytest.raises(InputError, match=r"m\.toml: header_from\.panel\.initial_temperature_C\.rows = 'last'"):
        _mapping(tmp_path, NESTED.replace('column = "top_1"', 'column = "top_1"\nrows = "last"'))


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (("panel.density_kg_m3", "panel.densty_kg_m3"), "panel.densty_kg_m3 .*panel.density_kg_m3"),
        (("panel.material", "panel.materal"), "panel.materal .*panel.material"),
        (
            ("[header_from.panel.initial_t", "[header_from.panel.inital_t"),
            "panel.inital_temperature_C .*initial_t",
        ),
        (("panel.density_kg_m3 = 760.0", "panel.density_kg_m3 = 1.0"), "panel.density_kg_m3 = 1.0"),
    ],
)
def test_a_mistyped_key_of_a_mapping_is_refused_where_it_stands(tmp_path, change, key):
    with pytest.raises(InputError, match=rf"m\.toml: .*{key}"):
        _mapping(tmp_path, NESTED.replace(*change))


def test_a_number_that_the_files_column_gives_is_refused_with_the_file(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,900\n1,22\n")
    with pytest.raises(InputError, match=r"a\.csv: .*panel\.initial_temperature_C = 900"):
        read_foreign(tmp_path / "a.csv", _mapping(tmp_path, NESTED))


LONG = """
[time]
column = "t"
[[column]]
from = "a"
to = "top_1"
unit = "K"
[[column]]
from = "b"
to = "load"
unit = ""
scale = 0.1
offset = -3.0
upper = 90.0
"""

LONG_ROWS = 2 * _ROWS_AT_ONCE + 100


def _long_file(path, changes=()):
    """Write a file of more rows than are parsed at once; `changes` put another text into a line."""
    lines = ["t,a,b", *(f"{i / 10},{290 + i / 70:.3f},{i}" for i in range(LONG_ROWS))]
    for line, text in changes:
        lines[line - 1] = text
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_file_read_many_rows_at_once_has_the_numbers_of_each_cell(tmp_path):
    run = read_foreign(_long_file(tmp_path / "a.csv", [(400, "39.8,---,NaN")]), _mapping(tmp_path, LONG))
    kelvin = [round(float(f"{290 + i / 70:.3f}") - 273.15, 9) for i in range(LONG_ROWS)]
    load = [i * 0.1 - 3.0 if i * 0.1 - 3.0 <= 90.0 else np.nan for i in range(LONG_ROWS)]
    kelvin[398] = load[398] = np.nan
    np.testing.assert_array_equal(run.columns["top_1"], kelvin)
    np.testing.assert_array_equal(run.columns["load"], load)
    assert run.time_s.tolist() == [round(i / 10, 6) for i in range(LONG_ROWS)]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([(700, "69.8,hot,1"), (699, "69.7,300,heavy")], "line 699: column b: 'heavy' is not a number"),
        ([(700, "69.8,hot,heavy")], "line 700: column a: 'hot' is not a number"),
        ([(700, "nan,300,1"), (600, "59.8,-5,1")], "line 600: column a: -278.15 °C is no temperature"),
        ([(700, "0,300,1"), (701, "69.9,hot,1")], "line 700: column t: '0' does not rise"),
        (
            [(5001, "499.9,-5,1"), (5002, "0,300,1"), (5003, "500.1,hot,1")],
            "line 5001: column a: -278.15 °C is no",
        ),
        ([(5002, "0,300,1"), (5003, "500.1,-5,1")], "line 5002: column t: '0' does not rise"),
        ([(5002, "500.0,300")], "line 5002: 2 cells"),
    ],
)
def test_of_several_faults_in_a_file_the_first_is_named(tmp_path, changes, message):
    with pytest.raises(InputError, match=re.escape(message)):
        read_foreign(_long_file(tmp_path / "a.csv", changes), _mapping(tmp_path, LONG))


CELLS = st.sampled_from([
    "21.5", "1e5", "+3", " 7 ", "", "NaN", "nan", "-", "---", "1,5", "1.5", "1.234,5", "1_0", "inf", "-Infinity",
    "1e999", "nan(1)", "0x10", "-999", " -999", "-999.0", "-300", ".5", "5.", "٣", "1d3", "1 2",
    "4\N{NO-BREAK SPACE}", "-0.0", " 0", "0", "0.5\t",
])  # fmt: skip


@given(
    rows=st.lists(st.tuples(CELLS, CELLS), min_size=1, max_size=4),
    times=st.sampled_from([["0", "1", "2", "3"], ["0", "1", "1", "3"], [" 0", "0.5 ", "nan", "3"]]),
    decimal=st.sampled_from([".", ","]),
    missing=st.sampled_from([["", "NaN"], ["---", "-999"], ["0"], []]),
    repeated=st.sampled_from(["first", "refuse"]),
    unit=st.sampled_from(["K", "C", ""]),
)
def test_a_file_has_the_numbers_and_the_faults_of_the_same_with_quotation_marks(
    tmp_path_factory, rows, times, decimal, missing, repeated, unit
):
    """Those take another way: pyarrow's parser, and cell by cell."""
    folder = tmp_path_factory.mktemp("quoted")
    mapping = _mapping(
        folder,
        f'[file]\ndelimiter = ";"\ndecimal = "{decimal}"\nmissing = {missing}\n'
        f'[time]\ncolumn = "t"\nrepeated = "{repeated}"\n'
        f'[[column]]\nfrom = "a"\nto = "top_1"\nunit = "{unit}"\n[[column]]\nfrom = "b"\nto = "load"\nunit = ""\n',
    )
    cells = [("t", "a", "b"), *((time, *row) for time, row in zip(times, rows, strict=False))]

    def read(mark):
        (folder / "x.csv").write_text("".join(";".join(f"{mark}{c}{mark}" for c in row) + "\n" for row in cells))
        try:
            run = read_foreign(folder / "x.csv", mapping)
        except InputError as error:
            return str(error)
        return [v.tobytes() for v in (run.time_s, run.columns["top_1"], run.columns["load"])]

    assert read("") == read('"')


def test_blanks_that_part_columns_may_be_several_and_leave_no_column_empty(tmp_path):
    table = '[file]\ndelimiter = "space"\n[time]\ncolumn = "t"\n'
    mapping = _mapping(
        tmp_path, table + '[[column]]\nfrom = "a"\nto = "top_1"\n[[column]]\nfrom = "b"\nto = "top_2"\n'
    )
    (tmp_path / "a.txt").write_text(" t   a    b\n 0  21.5  9.0 \n 10 121.5 19.0\n")
    run = read_foreign(tmp_path / "a.txt", mapping)
    assert [run.columns[name].tolist() for name in ("top_1", "top_2")] == [[21.5, 121.5], [9.0, 19.0]]
    (tmp_path / "a.txt").write_text("t a b\n0 21.5 9.0\n10  21.5\n")
    with pytest.raises(InputError, match="line 3: 2 cells"):
        read_foreign(tmp_path / "a.txt", mapping)


def test_a_number_that_says_missing_does_so_with_a_blank_beside_it(tmp_path):
    table = '[file]\nmissing = ["0"]\n[time]\ncolumn = "t"\n'
    mapping = _mapping(tmp_path, table + '[[column]]\nfrom = "a"\nto = "top_1"\n')
    (tmp_path / "a.csv").write_text("t,a\n1,21.5\n2, 0\n3,0\n4,0.0\n")
    found = read_foreign(tmp_path / "a.csv", mapping).columns["top_1"]
    np.testing.assert_array_equal(found, [21.5, np.nan, np.nan, 0.0])


@given(st.lists(st.floats(-1e9, 1e9) | st.integers(-(10**6), 10**6).map(lambda n: n / 2e9) | st.just(np.nan)))
def test_temperatures_are_rounded_as_python_rounds_them(values):
    assert repr(_rounded(np.array(values, float)).tolist()) == repr([round(float(v), 9) for v in values])
