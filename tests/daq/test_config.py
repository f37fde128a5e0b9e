"""The service configuration: checked at start, wrong keys named."""

import math
from pathlib import Path

import pytest

from daq.process.config import load_config, press_of
from daq.records import InputError

PRESSES = Path(__file__).parents[2] / "deploy" / "presses"
GOOD = """
[store]
url = "plant.sqlite"

[[press]]
name = "lab"
file = "lab.toml"
rate_hz = 10.0
header = { "panel.material" = "MDF", "panel.thickness_mm" = 16.0 }

[[press.logger]]
name = "platens"
profile = "adam-6018"
host = "127.0.0.1"
channels = ["platen_top", "platen_bottom", "", "top_1"]

[server]
port = 9000
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "lab.toml").write_text((PRESSES / "lab.toml").read_text())
    return tmp_path


def test_a_configuration_gives_paths_beside_itself_and_columns_in_order(folder):
    (folder / "kerntemp.toml").write_text(GOOD)
    config = load_config(folder / "kerntemp.toml")
    assert config.store.url == str(folder / "plant.sqlite")
    assert config.press[0].file == folder / "lab.toml"
    assert config.press_named().columns == ("platen_top", "platen_bottom", "top_1")
    assert config.press[0].header["panel.thickness_mm"] == 16.0
    assert config.server.port == 9000
    assert config.clock.speed == 1.0
    assert config.text == GOOD
    assert config.path == folder / "kerntemp.toml"
    with pytest.raises(InputError, match="press 'x' is not in the configuration; it has lab"):
        config.press_named("x")


def test_unquoted_dotted_keys_of_a_configured_header_are_its_keys(folder):
    path = folder / "kerntemp.toml"
    quoted = 'header = { "panel.material" = "MDF", "panel.thickness_mm" = 16.0 }'
    plain = 'header.panel.material = "MDF"\nheader.panel.thickness_mm = 16.0'
    assert quoted in GOOD
    path.write_text(GOOD.replace(quoted, plain))
    assert load_config(path).press[0].header == {"panel.material": "MDF", "panel.thickness_mm": 16.0}


def test_a_resin_of_the_configuration_stands_beside_it_and_is_checked_at_once(folder):
    text = GOOD.replace('file = "lab.toml"', 'file = "lab.toml"\nresin = "own.toml"')
    (folder / "kerntemp.toml").write_text(text)
    with pytest.raises(InputError, match=r"own.toml: cannot read the resin file"):
        load_config(folder / "kerntemp.toml")
    example = PRESSES.parent / "resins" / "melamine_formaldehyde.toml"
    (folder / "own.toml").write_text(example.read_text(encoding="utf-8"), encoding="utf-8")
    assert load_config(folder / "kerntemp.toml").press[0].resin == folder / "own.toml"


def test_a_resin_for_a_press_without_a_panel_is_refused(folder):
    press = (folder / "lab.toml").read_text(encoding="utf-8")
    kept = "thickness_mm = 16.0\nconductivity_W_mK = 0.12\ndensity_kg_m3 = 740.0\nheat_capacity_J_kgK = 1550.0"
    (folder / "lab.toml").write_text(press.replace("from_run = true", kept, 1), encoding="utf-8")
    example = PRESSES.parent / "resins" / "melamine_formaldehyde.toml"
    text = GOOD.replace('file = "lab.toml"', f'file = "lab.toml"\nresin = "{example.as_posix()}"')
    (folder / "kerntemp.toml").write_text(text)
    with pytest.raises(InputError, match="the press has no panel, so no paper cures"):
        load_config(folder / "kerntemp.toml")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("rate_hz", "rate_Hz"), r"press.0.rate_Hz = 10.0: unknown key"),
        (("rate_hz = 10.0", "rate_hz = 200.0"), r"press.0.rate_hz = 200.0: .*less than or equal to 20"),
        (("rate_hz = 10.0", "rate_hz = 0.4"), r"press.0.rate_hz = 0.4: .*greater than or equal to 0.5"),
        (("rate_hz", 'limit_switch = "S7"\nrate_hz'), r"no logger has channel 'S7', which limit_switch names"),
        (('name = "lab"', 'name = "my lab"'), r"press.0.name = 'my lab'"),
        (('name = "lab"', f'name = "{"x" * 101}"'), r"press.0.name = 'x+.*at most 100 characters"),
        (('"top_1"', '"platen_top"'), r"names platen_top twice"),
        (('"platen_bottom"', '"top_2"'), r"no logger has channel 'platen_bottom', which boundary.bottom"),
        (("lab.toml", "none.toml"), r"none.toml: cannot read the press file: No such file"),
        (("port = 9000", "port = 90000"), r"server.port = 90000"),
        (
            ("[store]", "[store]\narchive_after_days = 30.0"),
            r"archive_after_days sets when scans are archived, but there is no archive; name a folder as archive",
        ),
        (
            ("[store]", '[store]\narchive = "a"\narchive_after_days = 0.5'),
            r"store.archive_after_days = 0.5: .*greater than or equal to 1",
        ),
        (
            ("[store]", '[store]\narchive = "a"\npressings_only_after_days = 90'),
            r"pressings_only_after_days = 90: must be more than archive_after_days = 90",
        ),
        (
            ("[store]", "[store]\nkeep_idle_days = 0.5"),
            r"store.keep_idle_days = 0.5: .*greater than or equal to 1",
        ),
        (("[server]", "[sever]"), r"sever: unknown key"),
        (("[server]", "server]"), r"not valid TOML: .*line 17"),
        (('host = "127.0.0.1"\n', ""), r"press.0.logger.0: give either port"),
        (("[store]", 'text = "x"\n[store]'), r"text: unknown key"),
        (
            ('"panel.thickness_mm" = 16.0', '"boundary.topp.incident_W_m2" = 6e4'),
            r"press lab: header override: boundary.topp: unknown key; did you mean top",
        ),
        (
            ('"panel.thickness_mm" = 16.0', '"coefficients.h_pp_c.guess" = nan'),
            r"press lab: header override: coefficients.h_pp_c.guess = nan: must be a finite number",
        ),
        (
            ('"panel.thickness_mm" = 16.0', '"layer.plate_top.thickness_mm" = 1e300'),
            r"press lab: header override: layer.2.thickness_mm = 1e\+300: .* must be a number from 0.001 to 10000",
        ),
    ],
)
def test_a_wrong_configuration_is_refused_by_key_and_value(folder, change, message):
    (folder / "kerntemp.toml").write_text(GOOD.replace(*change))
    with pytest.raises(InputError, match=message) as caught:
        load_config(folder / "kerntemp.toml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("table", "key", "meant"),
    [
        ('[mqtt]\nhost = "m"', "password", "password_file"),
        ('[email]\nhost = "m"\nsender = "a@b.c"\nto = ["a@b.c"]', "pasword_file", "password_file"),
        ('[webhook]\naddress_file = "hook"', "address", "address_file"),
        ("[store]", "password", ""),
        ("[server]", "token", "tokens"),
        ('[opcua]\nhost = "m"', "private_key", ""),
    ],
)
def test_a_secret_that_was_put_into_the_configuration_itself_is_in_no_refusal(folder, table, key, meant):
    given = f'{table}\n{key} = "Hunter-2"\n'
    text = (
        GOOD.replace(f"{table}\n", given, 1) if table in GOOD else GOOD.replace("[server]", f"{given}[server]", 1)
    )
    (folder / "kerntemp.toml").write_text(text)
    with pytest.raises(InputError, match=rf"{key}: unknown key.*{meant}") as caught:
        load_config(folder / "kerntemp.toml")
    assert "Hunter-2" not in str(caught.value)


def test_a_wire_named_like_a_sensor_is_refused_since_a_face_would_take_it_in(folder):
    text = GOOD.replace('"top_1"]', '"top_1", "top_end"]')
    (folder / "kerntemp.toml").write_text(text.replace("rate_hz", 'limit_switch = "top_end"\nrate_hz'))
    with pytest.raises(
        InputError, match=r"press.limit_switch = 'top_end': would be read as a temperature, by 'top_\*'"
    ):
        load_config(folder / "kerntemp.toml")
    press = (folder / "lab.toml").read_text()
    for wires, expected in (
        (
            'pressure = { column = "bottom_bar", closed_above = 2 }',
            "press.pressure.column = 'bottom_bar': would be",
        ),
        ('limit_switch = "platen_top"', "press.limit_switch = 'platen_top': would be read as a temperature"),
        ('pressure = { column = "closed", closed_above = 2 }', "is the limit switch already"),
    ):
        (folder / "lab.toml").write_text(press.replace("[press]\n", f"[press]\n{wires}\n"))
        (folder / "kerntemp.toml").write_text(GOOD)
        with pytest.raises(InputError, match=expected):
            load_config(folder / "kerntemp.toml")


def test_a_wire_is_named_by_the_configuration_or_the_press_file_and_may_stand_still(folder):
    text = GOOD.replace('"top_1"]', '"top_1", "S7"]')
    (folder / "kerntemp.toml").write_text(text.replace("rate_hz", 'limit_switch = "S7"\nrate_hz'))
    settings = load_config(folder / "kerntemp.toml").press[0]
    assert press_of(settings).press.limit_switch == "S7"
    assert settings.logger[0].stale_after_s is None
    press = folder / "lab.toml"
    pressure = 'pressure = { column = "bar", closed_above = 20.0 }\n'
    press.write_text(press.read_text().replace("[press]\n", "[press]\n" + pressure))
    with pytest.raises(InputError, match=r"no logger has channel 'bar', which pressure names; add it to a logger"):
        load_config(folder / "kerntemp.toml")
    own = '[[press.logger]]\nname = "p"\nprofile = "generic"\nhost = "h"\nchannels = ["bar"]\n'
    (folder / "kerntemp.toml").write_text(text.replace("[server]", own + "[server]"))
    assert load_config(folder / "kerntemp.toml").press[0].logger[1].stale_after_s == math.inf
    (folder / "kerntemp.toml").write_text(text.replace("S7", "closed").replace("[server]", own + "[server]"))
    with pytest.raises(InputError, match="channel 'closed' is written from bar; give the logger's channel"):
        load_config(folder / "kerntemp.toml")


def test_a_column_from_two_loggers_is_refused(folder):
    second = GOOD[GOOD.index("[[press.logger]]") : GOOD.index("[server]")].replace('"platens"', '"others"')
    (folder / "kerntemp.toml").write_text(GOOD.replace("[server]", second + "[server]"))
    with pytest.raises(InputError, match="two loggers fill column 'platen_top'"):
        load_config(folder / "kerntemp.toml")


def test_a_missing_configuration_is_named(tmp_path):
    with pytest.raises(InputError, match=r"kerntemp.toml: cannot read the configuration: No such file"):
        load_config(tmp_path / "kerntemp.toml")


def test_a_server_address_stays_as_it_is(folder):
    (folder / "kerntemp.toml").write_text(GOOD.replace("plant.sqlite", "postgresql://eva@db/plant"))
    assert load_config(folder / "kerntemp.toml").store.url == "postgresql://eva@db/plant"
