"""Profiles and settings: what is not established must be said, and registers mean what they say."""

from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from daq.drivers import LoggerSettings, open_logger
from daq.drivers.decode import decode, number
from daq.drivers.opening import line_timing_of
from daq.drivers.profile import check_profile, merged, profile_for, profile_names, profile_table
from daq.records import InputError, Quality
from daq.thermocouple import voltage

EIGHT = tuple(f"c{k}" for k in range(8))
GENERIC = {
    "inputs": 2,
    "scaling": "tenth",
    "block": {"function": 3, "address": 0, "count": 2},
    "values": {"format": "s16"},
}


def settings(profile, **changes):
    return LoggerSettings(**{"name": "left", "profile": profile, "channels": EIGHT, "port": "COM5"} | changes)


def generic(**changes):
    return check_profile(merged(profile_table("generic"), merged(GENERIC, changes)), "generic")


def read(profile, words, flags=None, scaling=None, cold=None):
    return decode(profile, profile.scalings[scaling or profile.scaling], words, flags, cold)


@pytest.mark.parametrize("name", sorted(set(profile_names()) - {"generic"}))
def test_every_packaged_profile_is_well_formed(name):
    assert check_profile(profile_table(name), name).name == name


@pytest.mark.parametrize(
    ("profile", "changes", "message"),
    [
        ("adam-4018+", {}, "scaling is not established.*fullscale, tenth, hundredth"),
        ("adam-4118", {"scaling": "half"}, "scaling 'half' is unknown.*fullscale"),
        ("m-7018", {"scaling": "hex", "address": 1}, "baud is not established"),
        ("m-7018", {"scaling": "hex", "baud": 9600}, "address is not established"),
        ("m-7019r-dcon", {"baud": 9600}, "address is not established"),
        ("34970a", {}, "baud is not established"),
        ("sequent-smtc", {}, "address is not established"),
        ("adam-4118", {"port": "socket://gateway"}, "socket://host:port"),
        ("adam-4118", {"port": "socket://gateway:٤٠٠١"}, "socket://host:port"),
        ("adam-4118", {"port": "socket://gateway:4²"}, "socket://host:port"),
        ("generic", {"baud": 9600, "address": 1}, "needs the table block, values"),
        ("adam-4119", {}, "no such profile; known are 34970a, adam-4018"),
        ("adam-4118", {"channels": (*EIGHT, "c8")}, "9 channels, the device has 8 inputs"),
        ("adam-4118", {"override": {"blok": {}}}, "blok: unknown key; did you mean block"),
        ("adam-4118", {"override": {"timing": {"response_s": -1}}}, "timing.response_s"),
    ],
)
def test_what_is_not_established_or_wrong_is_named_with_its_remedy(profile, changes, message):
    with pytest.raises(InputError, match=message):
        open_logger(settings(profile, **changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"port": None}, "either port"),
        ({"host": "a"}, "either port"),
        ({"tcp_port": 502}, "tcp_port needs host"),
        ({"transport": "tcp"}, "needs host"),
        ({"channels": ("a", "a")}, "a twice"),
        ({"channels": ("", "")}, "names no column"),
        ({"speed": 3}, "Extra inputs"),
        ({"port": None, "host": "a", "transport": "rtu"}, "rtu_over_tcp"),
    ],
)
def test_settings_that_cannot_be_wired_are_refused(changes, message):
    with pytest.raises(ValidationError, match=message):
        settings("adam-4118", **changes)


def test_two_loggers_may_not_ask_for_different_speeds_of_one_port():
    first = open_logger(settings("adam-4118", port="COM77"))
    with pytest.raises(InputError, match=r"COM77: two loggers on one port .*115200"):
        open_logger(settings("adam-4118", port="COM77", baud=115200))
    first.close()
    open_logger(settings("adam-4118", port="COM77", baud=115200)).close()


def test_a_user_keeps_a_profile_of_his_own_in_a_file(tmp_path):
    path = tmp_path / "mine.toml"
    text = (
        'name = "mine"\ntitle = "x"\nprotocol = "modbus"\ninputs = 2\naddress = 1\nscaling = "s"\n'
        "timing = { response_s = 0.1, refresh_s = 1.0 }\nblock = { function = 3, address = 9, count = 2 }\n"
        'values = { format = "s16" }\nscalings = { s = { scale = 0.5 } }\nserial = { baud = 19200 }\n'
    )
    path.write_text(text)
    profile = profile_for(settings(str(path), channels=("a", "b")))
    assert read(profile, (40, 50))[0] == (20.0, 25.0)
    path.write_text(text + "x = = 1")
    with pytest.raises(InputError, match=r"mine.toml"):
        profile_for(settings(str(path)))


def test_a_file_name_is_taken_relative_to_the_configuration(tmp_path):
    moved = settings("own.toml", calibration="cal.toml").relative_to(tmp_path)
    assert (moved.profile, moved.calibration) == (str(tmp_path / "own.toml"), tmp_path / "cal.toml")
    assert settings("adam-4118").relative_to(tmp_path).profile == "adam-4118"


def test_a_check_with_the_shape_of_the_value_read_is_refused():
    twin = [{"what": "twin", "function": 3, "address": 100, "count": 2, "expect": [1]}]
    with pytest.raises(InputError, match="late reply could be mistaken"):
        generic(checks=twin)


def test_status_bits_with_the_shape_of_a_block_of_bits_are_refused_and_so_are_wide_values_of_bits():
    block = {"function": 2, "address": 0, "count": 2}
    with pytest.raises(InputError, match="status_bits has the shape of the value read"):
        generic(block=block, status_bits={"function": 2, "address": 16})
    with pytest.raises(InputError, match=r"values.format = 'f32': block.function 1 and 2 bring bits"):
        generic(block={**block, "count": 8}, values={"format": "f32"})


def test_values_must_fit_into_the_block():
    with pytest.raises(InputError, match=r"block.count = 2, but 2 values end at 4"):
        generic(values={"format": "f32"})


def test_the_drain_is_never_shorter_than_the_worst_response():
    profile = profile_for(settings("adam-4118"))
    assert line_timing_of(settings("adam-4118", timeout_s=0.05), profile).drain_s == profile.timing.response_s
    assert line_timing_of(settings("adam-4118", timeout_s=2.0), profile).drain_s == 2.0


def test_word_and_byte_order_are_four_ways_to_write_one_float():
    assert number((0x41C8, 0x0000), "f32") == 25.0
    assert number((0x0000, 0x41C8), "f32", "little") == 25.0
    assert number((0xC841, 0x0000), "f32", "big", "little") == 25.0
    assert number((0x0000, 0xC841), "f32", "little", "little") == 25.0
    assert number((0xFFFF, 0xFFFE), "s32") == -2.0


@pytest.mark.parametrize(("unit", "raw"), [("K", 3731), ("F", 2120), ("C", 1000)])
def test_boiling_water_reads_a_hundred_degrees_in_every_unit(unit, raw):
    values, _ = read(generic(values={"format": "s16", "unit": unit}), (raw, raw))
    assert values == pytest.approx((100.0, 100.0), abs=0.06)


def test_an_error_code_that_is_also_a_temperature_counts_only_with_its_status_bit():
    profile = generic(
        errors=[{"raw": -1, "quality": "open", "with_status": True}],
        status_bits={"function": 2, "address": 0, "quality": "over"},
    )
    values, qualities = read(profile, (0xFFFF, 0xFFFF), flags=(False, True))
    assert qualities == (Quality.GOOD, Quality.OPEN)
    assert values[0] == pytest.approx(-0.1)
    assert math.isnan(values[1])


@pytest.mark.parametrize(
    ("profile", "scaling", "raw", "flag", "quality"),
    [
        ("m-7018", "hex", 0xE6D0, None, Quality.UNDER),
        ("m-7018", "hex", 0xE6D1, None, Quality.GOOD),
        ("m-7018", "engineering", -2700 & 0xFFFF, None, Quality.UNDER),
        ("m-7018", "engineering", 13720, None, Quality.OVER),
        ("m-7018", "engineering", 13719, None, Quality.GOOD),
        ("m-7018", "hex", 13720, None, Quality.GOOD),
        ("m-7019r", "hex", 0xE6D0, True, Quality.UNDER),
        ("m-7019r", "hex", 0x7FFF, True, Quality.OPEN),
        ("m-7019r", "engineering", 13720, True, Quality.OVER),
        ("m-7019r", "engineering", 250, True, Quality.OPEN),
        ("adam-4118", "fullscale", 0xFFFF, False, Quality.OVER),
        ("adam-4118", "fullscale", 0x0000, False, Quality.UNDER),
        ("adam-4018+", "hundredth", 0xFFFF, True, Quality.OPEN),
    ],
)
def test_codes_and_range_ends_of_a_device_say_which_way_it_is_out_of_range(profile, scaling, raw, flag, quality):
    flags = None if flag is None else (flag,) * 8
    found = read(check_profile(profile_table(profile), profile), (raw,) * 8, flags, scaling)
    assert set(found[1]) == {quality}
    assert math.isnan(found[0][0]) is (quality is not Quality.GOOD)


def test_a_labjack_input_in_error_is_open():
    words = [0xC61C, 0x3C00] * 16
    _, qualities = read(check_profile(profile_table("labjack-t7"), "x"), words)
    assert set(qualities) == {Quality.OPEN}


def test_status_registers_name_their_codes_and_an_unknown_code_is_no_value():
    profile = check_profile(profile_table("exemys-rme1-tc"), "x")
    words = (200,) * 8 + (0, 1, 2, 9, 0, 0, 0, 0)
    assert read(profile, words)[1][:4] == (Quality.GOOD, Quality.UNDER, Quality.OVER, Quality.MISSING)


def test_bare_millivolts_are_turned_into_temperature_with_the_cold_junction_of_the_settings():
    changes = {
        "values": {"format": "s16", "unit": "uV"},
        "cold_junction": {"kind": "setting"},
        "scaling": "unit",
    }
    profile = generic(**changes)
    measured = round(1000 * float(voltage(180.0) - voltage(24.0)))
    values, _ = read(profile, (measured, measured), cold=24.0)
    assert values == pytest.approx((180.0, 180.0), abs=0.02)
    configured = settings("generic", channels=("a", "b"), baud=9600, address=1, override=merged(GENERIC, changes))
    with pytest.raises(InputError, match="give cold_junction_C"):
        profile_for(configured)


def test_the_implied_cold_junction_survives_broken_channels():
    profile = check_profile(profile_table("sequent-smtc"), "x")
    truth = [25.0, 60.0, 120.0, 180.0, 200.0, 90.0, 300.0, 45.0]
    words = [round(t * 100) for t in truth] + [round(1000 * float(voltage(t) - voltage(31.0))) for t in truth]
    words = [word & 0xFFFF for word in words]
    words[1] = words[9] = 0x7FFF
    values, qualities = read(profile, words)
    assert qualities[1] is Quality.OVER
    assert [values[0], *values[2:]] == pytest.approx([truth[0], *truth[2:]], abs=0.03)


def test_what_no_type_k_can_read_is_over_or_under_range():
    profile = generic(values={"format": "f32"}, block={"count": 4}, scaling="unit")
    _, qualities = read(profile, (0xC61C, 0x3C00, 0x4680, 0x0000))
    assert qualities == (Quality.UNDER, Quality.OVER)
