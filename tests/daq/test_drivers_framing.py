"""A reply is taken only if it is the whole, undamaged answer to the very request that was sent."""

from __future__ import annotations

import itertools
import struct
from types import SimpleNamespace

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from daq.drivers.bus import Bus, LineTiming
from daq.drivers.dcon import checksum, values_of
from daq.drivers.lines import ascii_line, line_reply
from daq.drivers.modbus import Request, bits, crc16, registers, rtu_frame, rtu_reply, tcp_frame, tcp_reply
from daq.drivers.protocol import BadFrame, NoReply, ReadFailure
from daq.records import Quality

STATION = 7
READ = Request(3, 0, 8)


def sealed(body):
    return body + struct.pack("<H", crc16(body))


def good_rtu(words, station=STATION, function=3):
    return sealed(bytes([station, function, 2 * len(words)]) + struct.pack(f">{len(words)}H", *words))


def good_tcp(words, transaction, station=STATION):
    pdu = bytes([3, 2 * len(words)]) + struct.pack(f">{len(words)}H", *words)
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, station) + pdu


def outcome(take, data):
    """What the reader makes of bytes: payload, None or the cause of refusal."""
    try:
        return take(bytearray(data))
    except ReadFailure as failure:
        return failure.cause


words_of_eight = st.lists(st.integers(0, 0xFFFF), min_size=8, max_size=8)


def test_a_request_is_framed_as_in_the_modbus_specification():
    assert rtu_frame(1, Request(3, 0, 8)) == bytes.fromhex("010300000008440C")
    assert rtu_frame(17, Request(6, 1, 1, b"\x00\x03")) == bytes.fromhex("110600010003 9A9B".replace(" ", ""))
    assert tcp_frame(1, 255, Request(4, 0, 1)) == bytes.fromhex("000100000006FF0400000001")


@given(words_of_eight)
def test_a_sound_reply_gives_its_registers_back(words):
    assert registers(rtu_reply(STATION, READ)(bytearray(good_rtu(words)))) == tuple(words)
    assert registers(tcp_reply(5, STATION, READ)(bytearray(good_tcp(words, 5)))) == tuple(words)


@given(words_of_eight, st.data())
def test_no_part_of_a_reply_is_taken_for_the_whole(words, data):
    for frame, take in (
        (good_rtu(words), rtu_reply(STATION, READ)),
        (good_tcp(words, 5), tcp_reply(5, STATION, READ)),
    ):
        cut = data.draw(st.integers(0, len(frame) - 1))
        assert outcome(take, frame[:cut]) is None


@given(words_of_eight, st.data())
def test_no_flipped_bit_passes_the_rtu_checksum(words, data):
    frame = bytearray(good_rtu(words))
    place = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[place // 8] ^= 1 << place % 8
    assert not isinstance(outcome(rtu_reply(STATION, READ), frame), bytes)


@given(st.binary(min_size=1, max_size=40))
def test_noise_is_never_taken_for_a_reply(noise):
    assert not isinstance(outcome(rtu_reply(STATION, READ), noise), bytes)
    assert not isinstance(outcome(tcp_reply(5, STATION, READ), noise), bytes)


@given(st.integers(1, 16), st.sampled_from([1, 2, 3, 4]))
def test_a_reply_of_another_shape_or_function_is_refused(count, function):
    assume((function, count) != (3, 8))
    size = 2 * count if function > 2 else (count + 7) // 8
    reply = sealed(bytes([STATION, function, size]) + bytes(size))
    assert outcome(rtu_reply(STATION, READ), reply) in ("wrong shape", None)


def test_the_reply_of_another_station_is_passed_over_and_ours_behind_it_is_taken():
    foreign, ours = good_rtu([1] * 8, station=3), good_rtu([2] * 8)
    assert registers(outcome(rtu_reply(STATION, READ), foreign + ours)) == (2,) * 8
    assert outcome(rtu_reply(STATION, READ), foreign) is None
    assert outcome(rtu_reply(STATION, READ), foreign[:-1] + b"\x00" + ours) == "wrong id"


def test_the_reply_of_another_station_in_pieces_is_passed_over_too_and_a_damaged_one_is_refused_when_it_is_whole():
    foreign, ours = good_rtu([1] * 8, station=3), good_rtu([2] * 8)
    take, buffer, got = rtu_reply(STATION, READ), bytearray(), None
    for byte in foreign + ours:
        assert got is None
        buffer.append(byte)
        got = take(buffer)
    assert registers(got) == (2,) * 8
    damaged = foreign[:-1] + bytes([foreign[-1] ^ 1])
    assert outcome(rtu_reply(STATION, READ), damaged[:-1]) is None
    assert outcome(rtu_reply(STATION, READ), damaged) == "wrong id"


def test_older_transactions_are_dropped_and_ours_behind_them_is_taken():
    take = tcp_reply(5, STATION, READ)
    assert registers(outcome(take, good_tcp([1] * 8, 4) + good_tcp([2] * 8, 5))) == (2,) * 8
    assert outcome(take, good_tcp([1] * 8, 4)) is None
    assert outcome(take, good_tcp([2] * 8, 5) + b"\x00") == "surplus"
    assert outcome(take, good_tcp([2] * 8, 5, station=9)) == "wrong id"


def test_a_doubled_reply_in_one_piece_is_refused():
    assert outcome(rtu_reply(STATION, READ), 2 * good_rtu([1] * 8)) == "surplus"


def test_exceptions_tell_busy_from_refused():
    for code, cause in ((6, "busy"), (5, "busy"), (11, "busy"), (2, "refused"), (1, "refused")):
        assert outcome(rtu_reply(STATION, READ), sealed(bytes([STATION, 0x83, code]))) == cause
        frame = struct.pack(">HHHBBB", 5, 0, 3, STATION, 0x83, code)
        assert outcome(tcp_reply(5, STATION, READ), frame) == cause
    with pytest.raises(NoReply, match="illegal address"):
        rtu_reply(STATION, READ)(bytearray(sealed(bytes([STATION, 0x83, 2]))))


def test_a_local_echo_is_skipped_where_it_is_announced_and_refused_where_not():
    sent, reply = rtu_frame(STATION, READ), good_rtu([4] * 8)
    assert registers(outcome(rtu_reply(STATION, READ, local_echo=True), sent + reply)) == (4,) * 8
    assert outcome(rtu_reply(STATION, READ, local_echo=True), reply) == "echo"
    assert outcome(rtu_reply(STATION, READ), sent + reply) == "wrong shape"


def test_an_echo_in_pieces_is_skipped_too():
    sent, reply = rtu_frame(STATION, READ), good_rtu([4] * 8)
    take, buffer, got = rtu_reply(STATION, READ, local_echo=True), bytearray(), None
    for byte in sent + reply:
        buffer.append(byte)
        got = take(buffer)
    assert registers(got) == (4,) * 8


@given(st.lists(st.booleans(), min_size=1, max_size=16))
def test_bits_come_lowest_first(flags):
    packed = bytearray((len(flags) + 7) // 8)
    for k, flag in enumerate(flags):
        packed[k // 8] |= flag << k % 8
    assert bits(bytes(packed), len(flags)) == tuple(flags)


def test_text_lines_must_end_and_hold_nothing_else():
    take = line_reply(b"\r")
    assert outcome(take, b">+0025.1") is None
    assert outcome(take, b">+0025.1\r") == b">+0025.1"
    assert outcome(take, b">+0025.1\r>+00") == "surplus"
    assert outcome(line_reply(b"\r", longest=10), b"x" * 11) == "garbage"
    with pytest.raises(BadFrame, match="no text"):
        ascii_line(b"\xff\x80")


def test_adam_cells_are_read_by_their_vendor_meaning():
    payload = "+0025.1+888888" + " " * 7 + "+9999" + "-0000" + "-0012.3"
    values = values_of(payload, 6, 7)
    assert [q for _, q in values] == [
        Quality.GOOD,
        Quality.OPEN,
        Quality.MISSING,
        Quality.OVER,
        Quality.UNDER,
        Quality.GOOD,
    ]
    assert (values[0][0], values[5][0]) == (25.1, -12.3)


@pytest.mark.parametrize(
    ("cell", "quality"),
    [
        ("+9999  ", Quality.OVER),
        ("  +9999", Quality.OVER),
        ("+9999.9", Quality.OVER),
        ("-0000  ", Quality.UNDER),
        ("-0000.0", Quality.UNDER),
        ("-9999.9", Quality.UNDER),
        ("+888888", Quality.OPEN),
        ("       ", Quality.MISSING),
        ("-0000.1", Quality.GOOD),
        ("+0000.0", Quality.GOOD),
    ],
)
def test_a_code_costs_its_own_input_only_however_it_is_padded(cell, quality):
    found = values_of(f"+0025.1{cell}-0012.3", 3, 7)
    assert [q for _, q in found] == [Quality.GOOD, quality, Quality.GOOD]
    assert (found[0][0], found[2][0]) == (25.1, -12.3)


@pytest.mark.parametrize("payload", ["+0025.1+9999 -0012.3", "+0025.1 +9999-0012.3 ", "+0025.1+00 1.0-0012.3"])
def test_a_line_whose_values_have_no_sure_place_is_refused_whole(payload):
    with pytest.raises(BadFrame):
        values_of(payload, 3, 7)


@pytest.mark.parametrize(
    "payload", ["+0025.1", "+0025.1+00", "+0025.1+0025,1", "0025.10+0025.1", "+0025.1+025.12."]
)
def test_a_line_that_is_not_the_expected_number_of_values_is_refused(payload):
    with pytest.raises(BadFrame):
        values_of(payload, 2, 7)


def test_the_dcon_checksum_is_that_of_the_manual():
    assert checksum("$012") == "B7"


class Wire:
    """A link and its place: bytes that wait, and what each request is answered with."""

    is_socket, key = True, "wire"

    def __init__(self, waiting, replies):
        self.waiting, self.replies, self.closed = list(waiting), list(replies), 0

    def open(self):
        return self

    def write(self, data):
        self.waiting.append(self.replies.pop(0))

    def read(self, wait_s):
        return self.waiting.pop(0) if self.waiting else b""

    def close(self):
        self.closed += 1

    def __str__(self):
        return self.key


def test_what_waits_on_a_network_before_a_request_is_thrown_away_whatever_number_it_carries(monkeypatch):
    now_s = [0.0]

    def monotonic():
        now_s[0] += 0.001  # of a line that is asked over and over instead of waited for
        return now_s[0]

    monkeypatch.setattr("daq.drivers.bus.time", SimpleNamespace(monotonic=monotonic))
    early, sound = good_tcp([9] * 8, 1), good_tcp([1] * 8, 1)
    wire = Wire([early[:5], early[5:]], [sound])
    at_once = wire.read

    def read(wait_s):
        data = at_once(wait_s)
        now_s[0] += 0.0 if data else wait_s
        return data

    wire.read = read
    bus = Bus(wire, numbered=True)
    number = bus.next_transaction()
    timing = LineTiming(timeout_s=1.0, drain_s=0.5)
    reply = bus.exchange(tcp_frame(number, STATION, READ), tcp_reply(number, STATION, READ), timing)
    assert registers(reply.payload) == (1,) * 8
    assert wire.closed == 0
    assert now_s[0] < 0.4, "a network owes no silence as long as a serial line's"


def test_a_network_device_that_never_falls_silent_is_refused_and_its_connection_closed():
    wire = Wire([], [])
    wire.read = lambda wait_s: b"\x00"
    bus = Bus(wire, numbered=True)
    with pytest.raises(BadFrame, match="never falls silent"):
        bus.exchange(b"", tcp_reply(1, STATION, READ), LineTiming(timeout_s=0.1, drain_s=0.02))
    assert wire.closed == 1


def test_a_machine_too_busy_to_look_in_time_does_not_take_its_own_pause_for_silence(monkeypatch):
    early, sound = good_tcp([9] * 8, 1), good_tcp([1] * 8, 1)
    wire, moments = Wire([early[:5], early[5:9], early[9:]], [sound]), itertools.count(0.0, 0.05)
    monkeypatch.setattr("daq.drivers.bus.time", SimpleNamespace(monotonic=lambda: next(moments)))
    bus = Bus(wire, numbered=True)
    timing = LineTiming(timeout_s=10.0, drain_s=0.5)
    reply = bus.exchange(tcp_frame(1, STATION, READ), tcp_reply(1, STATION, READ), timing)
    assert registers(reply.payload) == (1,) * 8
