"""The probe finds out what hangs on a wire, in the words of kerntemp.toml."""

from __future__ import annotations

import threading

import pytest
import serial

from api.commands.probing import _stations
from daq.drivers import LoggerSettings, ReadFailure, open_logger
from daq.drivers.probe import interpretations, probe
from daq.records import InputError, Quality
from daq.simulated.devices import kind_of, simulated, station
from daq.simulated.devices_converter import Switches
from daq.simulated.devices_line import serve_serial

TEXT = ("34970a", "daq970a", "sr630", "adam-4118-ascii", "m-7019r-dcon")
ANSWER_S = 0.4
"""A simulated device answers in milliseconds, on a busy machine later."""


def room(profile):
    return lambda now_s: [20.0 + 0.3 * k for k in range(kind_of(profile).inputs)]


def wire_of(server, **more):
    return dict(server.place) | more


@pytest.mark.parametrize(
    ("profile", "family"),
    [
        ("adam-4118", {"adam-4118"}),
        ("m-7019r", {"m-7019r"}),
        ("adam-4118-ascii", {"adam-4118-ascii", "m-7019r-dcon"}),
        ("exemys-rme1-tc", {"exemys-rme1-tc"}),
        ("adam-6018+", {"adam-6018+"}),
        ("34970a", {"34970a"}),
        ("daq970a", {"daq970a"}),
        ("sr630", {"sr630"}),
        ("labjack-t7", {"labjack-t7"}),
        ("sequent-smtc", {"sequent-smtc"}),
    ],
)
def test_the_right_profile_is_proposed_for_a_device_at_room_temperature(profile, family):
    with simulated(profile, room(profile), refresh_s=0) as server:
        report = probe(wire_of(server), timeout_s=ANSWER_S, profiles=TEXT if family & set(TEXT) else None)
        (proposal,) = report.proposals
        assert {proposal.settings["profile"], *proposal.ambiguous_with} == family
        inputs = kind_of(profile).inputs
        names = [f"c{k}" for k in range(inputs)]
        logger = open_logger(LoggerSettings(**proposal.settings, channels=names))
        reading = logger.read()
        assert reading.values == pytest.approx(room(profile)(0), abs=0.06)
        assert set(reading.qualities) == {Quality.GOOD}
        logger.close()


def test_the_scaling_in_doubt_of_the_adam_4018_is_settled_by_room_temperature():
    with simulated("adam-4018+", room("adam-4018+"), refresh_s=0) as server:
        report = probe(wire_of(server), profiles=["adam-4018+"])
    assert report.proposals[0].settings["scaling"] == "hundredth"
    assert not {a.scaling: a.fits for a in report.attempts if a.station == 1}["fullscale"]


def test_two_scalings_that_both_look_like_a_room_are_both_named_the_likelier_first():
    with simulated("m-7018", room("m-7018"), refresh_s=0) as server:
        (proposal,) = probe(wire_of(server), profiles=["m-7018"]).proposals
    assert proposal.settings["scaling"] == "engineering"
    assert tuple(map(str, proposal.ambiguous_with)) == ("m-7018 with scaling hex",)


def test_an_unknown_device_gets_a_generic_map_from_its_registers():
    with simulated("generic", room("generic"), refresh_s=0) as server:
        report = probe(wire_of(server), profiles=["exemys-rme1-tc"])
        (proposal,) = report.proposals
        assert proposal.settings["profile"] == "generic"
        logger = open_logger(LoggerSettings(**proposal.settings, channels=[f"c{k}" for k in range(16)]))
        assert logger.read().values == pytest.approx(room("generic")(0), abs=0.06)
        logger.close()


def test_each_module_on_a_bus_is_proposed_at_its_own_address():
    first = station("adam-4118", room("adam-4118"), address=2, refresh_s=0)
    second = station("m-7019r", room("m-7019r"), address=3, refresh_s=0)
    lines = []
    with serve_serial(first, second) as server:
        report = probe(
            wire_of(server),
            stations=(1, 2, 3),
            profiles=["adam-4118", "m-7019r"],
            timeout_s=0.15,
            progress=lines.append,
        )
    assert report.stations == (2, 3)
    assert [(p.settings["profile"], p.settings["address"]) for p in report.proposals] == [
        ("adam-4118", 2),
        ("m-7019r", 3),
    ]
    assert {block.station for block in report.registers} == {2, 3}
    assert any("station 1" in str(line) for line in lines)


def test_a_silent_wire_proposes_nothing_and_says_why():
    with simulated("adam-4118", room("adam-4118"), switches=Switches(silent=True)) as server:
        report = probe(wire_of(server), profiles=["adam-4118-ascii", "sr630"], timeout_s=0.1)
    assert not report.proposals
    assert all(str(a.outcome).startswith("silent") for a in report.attempts)


def test_a_port_that_does_not_open_is_said_at_once_and_not_taken_for_a_silent_wire(tmp_path):
    pytest.importorskip("fcntl", reason="ports are always exclusive on Windows")
    with (
        simulated("adam-4118", room("adam-4118")) as server,
        serial.Serial(server.port, exclusive=True),
        pytest.raises(ReadFailure, match="port in use; another program has it open"),
    ):
        probe(wire_of(server))
    with pytest.raises(ReadFailure, match="no port; check adapter and name"):
        probe({"port": str(tmp_path / "ttyUSB9")})


def test_a_port_that_another_program_is_just_letting_go_of_is_waited_for():
    pytest.importorskip("fcntl", reason="ports are always exclusive on Windows")
    with simulated("adam-4118", room("adam-4118"), refresh_s=0) as server:
        holder = serial.Serial(server.port, exclusive=True)
        threading.Timer(0.2, holder.close).start()
        report = probe(wire_of(server), profiles=["adam-4118"])
    assert report.proposals[0].settings["profile"] == "adam-4118"


def test_registers_are_shown_under_every_reading_the_most_plausible_first():
    floats = [0x41A8, 0x0000, 0x41B0, 0x0000]
    best = interpretations(floats)[0]
    assert (str(best.meaning), best.values) == ("float", (21.0, 22.0))
    swapped = interpretations([0x0000, 0x41A8])[0]
    assert swapped.word_order == "little"


def test_a_probe_without_a_wire_is_refused():
    with pytest.raises(InputError, match="--port or --host"):
        probe({})


@pytest.mark.parametrize("text", ["²", "٣", "1-99999999999", "1-" + "9" * 5000, "-", "1-2-3", "300"])
def test_stations_that_are_no_numbers_are_refused_whatever_their_length(text):
    with pytest.raises(InputError):
        _stations(text)


def test_stations_come_as_numbers_and_spans():
    assert _stations("1, 3-5,247") == [1, 3, 4, 5, 247]
