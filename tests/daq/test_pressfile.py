from pathlib import Path

import numpy as np
import pytest

from daq import shared_files
from daq.press.header import panel_of
from daq.press.press_file import label_of, parse_press, press_for_run, read_press
from daq.records import InputError, Run

LAB = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"
PANEL = """
[[layer]]
name = "panel"
from_run = true
"""
PLATE = """
[[layer]]
name = "plate"
thickness_mm = 10.0
conductivity_W_mK = 45.0
density_kg_m3 = 7850.0
heat_capacity_J_kgK = 490.0
"""


def run(**header: object) -> Run:
    keys = {key.replace("__", "."): value for key, value in header.items()}
    return Run("r", keys, np.arange(3.0), {}, source="r.csv")


def test_laboratory_press_has_the_six_coefficients_of_the_paper() -> None:
    press = read_press(LAB)
    assert set(press.coefficient_names) == {"h_p_o", "h_p_c", "h_pp_o", "h_pp_c", "h_wa", "h_ap"}
    assert press.has_states


def test_press_without_an_open_entry_has_one_state() -> None:
    assert not parse_press(PANEL).has_states


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x =", "not valid TOML"),
        (PANEL + "[press]\nnam = 'x'", r"press\.nam = 'x': unknown key"),
        (PLATE.replace("10.0", "-1.0"), r"layer\.0\.thickness_mm = -1\.0: .* greater than 0"),
        (
            PLATE.replace("10.0", "1e300"),
            r"layer\.0\.thickness_mm = 1e\+300: .* must be a number from 0\.001 to 10000",
        ),
        (
            PLATE.replace("45.0", "[[20.0, 1.0], [90.0, 1e9]]"),
            r"layer\.0\.conductivity_W_mK: no material has 1e\+09; must be a number from 0\.005 to 5000",
        ),
        (PLATE.replace("45.0", "[[20.0, 1.0], [20.0, 2.0]]"), "temperatures rising"),
        (PLATE.replace("45.0", "[[nan, 1.0], [20.0, 2.0]]"), r"conductivity_W_mK.*finite number"),
        (PLATE.replace("45.0", "[[-9999.0, 1.0], [20.0, 2.0]]"), r"conductivity_W_mK.*greater than -273"),
        (PLATE.replace("thickness_mm = 10.0", ""), "needs thickness_mm"),
        (PANEL + "thickness_mm = 3.0", "remove thickness_mm"),
        (PANEL + PANEL, "layer names must differ"),
        (PANEL + "[boundary.top]\nkind = 'measured'", "needs column"),
        (PANEL + "[[contact]]\nbetween = ['panel', 'plate']\nclosed = 'h'", "not neighbours"),
        (PANEL + "[coefficients.h]\nguess = 1.0", r"coefficients\.h: no contact or boundary uses it"),
        (
            PANEL
            + "[[contact]]\nbetween = ['panel', 'boundary.top']\nclosed = 'h'\n"
            + "[coefficients.h]\nguess = 1.0\nlower = 2.0",
            r"guess = 1 lies outside lower\.\.upper",
        ),
        (PANEL + "[[sensor]]\ncolumns = ['a']\nat = 'b.top'", r"sensor\.0\.at = 'b\.top'"),
        (
            PLATE + "[[sensor]]\ncolumns = ['a']\nat = { layer = 'plate', depth_mm = 11.0 }",
            "outside layer 'plate'",
        ),
        (PLATE + "[core]\nat = 'b.top'", r"core\.at = 'b\.top'"),
        (PLATE + "[core]\nat = { layer = 'plate', depth_mm = 11.0 }", r"core\.at\.depth_mm = 11\.0: .*'plate'"),
        (
            PLATE + "[core]\nat = 4.0",
            r"core\.at = 4\.0: must be a text in quotes; core\.at = 4\.0: must be a table",
        ),
        (PLATE + "[core]\nat = { layer = 'plate' }", r"core\.at\.depth_mm: is missing; add it"),
        (PLATE + "[coefficients.h]\nguess = 1e12", r"coefficients\.h\.guess = 1000000000000\.0: must be less"),
        (PLATE + "[initial]\nkind = 'uniform'", r"initial\.kind = 'uniform': .*needs temperature_C"),
        (PLATE.replace("45.0", "true"), r"layer\.0\.conductivity_W_mK = True: .*valid number"),
        (PLATE.replace("45.0", "'45'"), r"layer\.0\.conductivity_W_mK = '45': .*valid number"),
        (PANEL + "[press]\narea_m2 = '2'", r"press\.area_m2 = '2': .*valid number"),
        (
            PANEL
            + "[boundary.top]\nkind = 'air'\ncoefficient = 'h'\n"
            + "[[contact]]\nbetween = ['panel', 'boundary.top']\nopen = ['a', 'b']\nclosed = 'c'",
            r"contact\.0\.open = \['a', 'b'\]: a layer cannot separate from boundary\.top, which is of kind 'air'",
        ),
    ],
)
def test_wrong_press_file_is_refused_with_key_and_value(text: str, expected: str) -> None:
    with pytest.raises(InputError, match=f"^press file: .*{expected}") as caught:
        parse_press(text)
    assert "\n" not in str(caught.value)


def test_missing_press_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml: cannot read the press file"):
        read_press(tmp_path / "none.toml")


def test_run_overrides_values_of_the_press_by_dotted_key() -> None:
    own = press_for_run(
        read_press(LAB),
        run(layer__plate_top__thickness_mm=12.0, coefficients__h_wa__guess=5.0, contact__0__closed="h_p_o"),
    )
    assert own.layer[2].thickness_mm == 12.0
    assert own.coefficient("h_wa").guess == 5.0
    assert own.contact[0].closed == "h_p_o"


def test_an_override_may_leave_a_coefficient_of_the_press_file_without_use() -> None:
    own = press_for_run(
        read_press(LAB),
        run(contact__1__closed="h_new", contact__2__closed="h_new", coefficients__h_new__guess=200.0),
    )
    assert own.coefficient("h_new").guess == 200.0
    assert "h_pp_c" not in own.coefficient_names
    with pytest.raises(InputError, match=r"r\.csv: header override: coefficients\.h_nwe: no contact"):
        press_for_run(read_press(LAB), run(coefficients__h_nwe__guess=200.0))


def test_an_override_may_put_a_depth_in_place_of_a_named_place() -> None:
    own = press_for_run(read_press(LAB), run(sensor__0__at__layer="panel", sensor__0__at__depth_mm=5.7))
    assert own.sensor[0].label == "panel@5.7mm"


@pytest.mark.parametrize(
    ("text", "core"),
    [
        (PLATE + PANEL, "panel.middle"),
        (PLATE + PANEL + "[[sensor]]\ncolumns = ['c']\nat = 'panel.top'\nrole = 'validation'", "panel.middle"),
        (PLATE + PANEL + "[core]\nat = 'plate.bottom'", "plate.bottom"),
        (PLATE + PANEL + "[core]\nat = { layer = 'panel', depth_mm = 5.7 }", "panel@5.7mm"),
        (PLATE, "plate.middle"),
        (PLATE + "[[sensor]]\ncolumns = ['c']\nat = 'plate.top'\nrole = 'validation'", "plate.top"),
    ],
)
def test_the_core_is_where_the_press_file_says_else_in_the_middle(text: str, core: str) -> None:
    press = parse_press(text)
    assert label_of(press.core_at) == core
    assert label_of(press_for_run(press, run(core__at="plate.top")).core_at) == "plate.top"


def test_only_channels_at_the_core_tell_of_it() -> None:
    buried = "[[sensor]]\ncolumns = ['{}_*']\nat = {}\nrole = 'validation'\n"
    deep = "{ layer = 'panel', depth_mm = 5.7 }"
    text = PANEL + buried.format("core", "'panel.middle'") + buried.format("deep", deep)
    one = Run("r", {}, np.arange(3.0), {name: np.zeros(3) for name in ("deep_1", "core_1", "core_2")})
    assert parse_press(text).at_core(one) == ("core_1", "core_2")
    assert parse_press(text + f"[core]\nat = {deep}").at_core(one) == ("deep_1",)


def test_override_of_an_unknown_place_is_refused() -> None:
    with pytest.raises(InputError, match=r"r\.csv: header key layer\.nothing\.thickness_mm"):
        press_for_run(read_press(LAB), run(layer__nothing__thickness_mm=12.0))


def test_known_material_needs_no_constants() -> None:
    panel = panel_of(run(panel__material="mdf", panel__thickness_mm=16.0, panel__initial_temperature_C=20.0))
    assert panel.conductivity == 0.12
    assert panel.thickness == 0.016


def test_missing_temperature_is_not_blamed_on_the_material() -> None:
    with pytest.raises(InputError, match=r"panel\.initial_temperature_C is missing; add"):
        panel_of(run(panel__material="MDF", panel__thickness_mm=16.0))


def test_a_press_prints_on_one_screen() -> None:
    text = str(read_press(LAB))
    assert text.startswith(
        "Press lab: boundary.bottom, plate_bottom, panel, plate_top, boundary.top\nh_p_o = 500 (10"
    )
    assert text.endswith("\npanel.middle: core_*")
    many = PANEL + "".join(f'[[sensor]]\ncolumns = ["top_{n}"]\nat = "panel.top"\n' for n in range(60))
    assert len(repr(parse_press(many)).splitlines()) <= 25


def test_unknown_material_needs_its_constants() -> None:
    with pytest.raises(InputError, match=r"panel\.density_kg_m3 is missing and material 'cork' is not in the"):
        panel_of(run(panel__material="cork", panel__thickness_mm=16.0, panel__initial_temperature_C=20.0))


@pytest.mark.parametrize(("line", "most"), [("area_m2 = 1e9", 10000), ("side_loss_W_m2K = 1e9", 250)])
def test_an_area_or_a_loss_that_no_press_has_is_refused_with_the_limit(tmp_path, line, most):
    path = tmp_path / "press.toml"
    text = (shared_files() / "presses/lab.toml").read_text().replace("area_m2 = 0.25\n", "")
    path.write_text(text.replace("[press]\n", f"[press]\n{line}\n"))
    with pytest.raises(InputError, match=rf"press\.{line.split()[0]} = 1000000000.0: .*{most}"):
        read_press(path)
