"""A pressing under way when recording begins is a run, or a word about it: never neither."""

import pytest

from daq.press.events import PressEventDetector
from daq.press.late_beginning import LateBeginning
from daq.press.press_file import parse_press
from daq.records import PressEventKind, PressState
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.press import VirtualPress, VirtualPressSettings

PRESS = parse_press(press_toml())
PERIOD_S = 0.5


@pytest.fixture(scope="module")
def virtual():
    press = VirtualPress(VirtualPressSettings(press_time_s=(40.0, 60.0), keep=40), 5)
    press.cycle(600.0)
    return press


def recorded(press, begin_s, until_s, *, columns=None, wire=False):
    """Record from a moment on; return the events, and when it was said that a panel was hot already."""
    detector, late, events, late_at = PressEventDetector(PRESS), LateBeginning(PRESS), [], []
    for i in range(int((until_s - begin_s) / PERIOD_S)):
        at = begin_s + i * PERIOD_S
        values = {n: round(v, 1) for n, v in press.temperatures(at).items() if columns is None or n in columns}
        if wire and i >= 2:  # its logger is slower
            values["closed"] = float(press.closed(at))
        found = detector.update(at, values)
        events += found
        if late.look(at, values, known=bool(found) or detector.closed_by_wire is not None):
            late_at.append(at)
    return events, late_at


def begin(press, share, number=1):
    """Return a moment within a pressing, by its share between closing and opening, and when it is over."""
    cycle = press.cycles[number]
    m = cycle.moments
    return m.closed_s + share * (m.opened_s - m.closed_s), m.opened_s + 2.0


@pytest.mark.parametrize("columns", ["all", "no upper sensor", "no platen"])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_wherever_within_a_pressing_recording_begins_it_is_said_once_or_a_run_is_begun(virtual, number, columns):
    names = set(virtual.temperatures(0.0))
    left = {"all": "none", "no upper sensor": "top_", "no platen": "platen_"}[columns]
    kept = {name for name in names if not name.startswith(left)}
    for share in (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9):
        first, over = begin(virtual, share, number)
        events, late_at = recorded(virtual, first, over, columns=kept)
        begun = [e for e in events if e.kind is PressEventKind.INSERTED]
        assert len(late_at) + len(begun) == 1, (share, events, late_at)
        assert not late_at or late_at[0] - first <= 4.0


@pytest.mark.parametrize("number", [1, 2])
def test_a_press_that_is_cold_idle_or_open_with_a_cool_panel_says_nothing(virtual, number):
    cycle = virtual.cycles[number]
    for at in (cycle.moments.inserted_s - 4.0, cycle.moments.inserted_s + 0.5 * 3.0):
        if virtual.state(at) is PressState.CLOSED:
            continue
        events, late_at = recorded(virtual, at, cycle.moments.opened_s)
        assert not late_at
        assert PressEventKind.CLOSED in [e.kind for e in events]


def test_a_wire_that_answers_late_makes_the_run_and_nothing_is_said(virtual):
    first, over = begin(virtual, 0.3)
    events, late_at = recorded(virtual, first, over, wire=True)
    assert not late_at
    assert [e.kind for e in events][:2] == [PressEventKind.INSERTED, PressEventKind.CLOSED]


def test_a_sensor_that_is_hot_for_one_scan_is_no_panel():
    late = LateBeginning(PRESS)
    first = {"platen_top": 200.0, "top_1": 150.0, "bottom_1": 150.0}
    assert not late.look(0.0, first, known=False)
    cold = {"platen_top": 200.0, "top_1": 21.0, "bottom_1": 21.0}
    assert not any(late.look(0.5 * i, cold, known=False) for i in range(1, 20))
