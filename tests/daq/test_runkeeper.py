"""Runs cut from scans: begun before the insertion, ended after the removal, never overlapping."""

from datetime import UTC, datetime, timedelta

from hypothesis import given, settings
from hypothesis import strategies as st

from daq.recording.run_keeper import RunKeeper, RunNames, RunRules
from daq.records import PressEvent, PressEventKind, Quality, Scan
from daq.store import RunStatus

BEGAN = datetime(2026, 3, 4, 23, 59, 0, tzinfo=UTC)
G = Quality.GOOD


def scan(number, value=21.0):
    return Scan(number, BEGAN + timedelta(seconds=number / 10), 500 + number / 10, (200.0, value), (G, G))


def keeper(**rules):
    times = {"pre_trigger_s": 5.0, "post_removal_s": 5.0, "longest_run_s": 3600.0}
    return RunKeeper(RunRules("lab", **times | rules), RunNames("lab", "lab-2026-03-04-07"), panel_places=[1])


def event(kind, at, noticed=None):
    return PressEvent(kind, 500 + at, 500 + (at if noticed is None else noticed))


def play(one, events, count):
    """Feed scans; `events` maps scan numbers to events noticed then."""
    return [change for n in range(count) for change in one.take(scan(n), events.get(n, []))]


def test_a_run_begins_before_the_insertion_and_ends_after_the_removal():
    events = {
        110: [event(PressEventKind.INSERTED, 10.0, 11.0)],
        300: [event(PressEventKind.CLOSED, 29.5)],
        980: [event(PressEventKind.REMOVED, 90.0, 98.0)],
    }
    (begin, none), (nothing, end) = play(keeper(), events, 1100)
    assert none is None
    assert nothing is None
    assert begin.run == "lab-2026-03-04-07"
    assert begin.first_scan == 50
    assert begin.zero_monotonic_s == 505.0
    assert begin.started_utc == scan(50).utc
    assert begin.header == {"panel.initial_temperature_C": 21.0}
    assert end.run == begin.run
    assert end.last_scan == 950
    assert end.status is RunStatus.CLOSED


def test_a_run_whose_panel_nobody_saw_coming_begins_longer_before():
    unseen = {600: [event(PressEventKind.INSERTED, 59.0, 60.0), event(PressEventKind.CLOSED, 60.0, 60.0)]}
    (begin, _) = play(keeper(), unseen, 700)[0]
    assert begin.zero_monotonic_s == 500.0 + 59.0 - (30.0 + 3.0)  # the longest wait, and the start before it
    one, begins = keeper(), []
    for n in range(700):  # sensors plugged in with the panel, 5.5 s after it came
        quality = G if n >= 600 else Quality.MISSING
        plugged = Scan(n, BEGAN, 500 + n / 10, (200.0, 60.0), (G, quality))
        events = [event(PressEventKind.INSERTED, 60.0, 61.0)] if n == 610 else []
        begins += [new for new, _ in one.take(plugged, events)]
    assert begins[0].zero_monotonic_s == 500.0 + 60.0 - (30.0 + 3.0)


def test_a_start_temperature_that_was_given_is_kept():
    rules = {"header": {"panel.initial_temperature_C": 19.0}}
    changes = play(keeper(**rules), {110: [event(PressEventKind.INSERTED, 10.0)]}, 120)
    assert changes[0][0].header == {"panel.initial_temperature_C": 19.0}


def test_a_recorder_that_begins_with_a_panel_on_the_hot_plate_takes_no_start_temperature_from_it():
    """Only the closing shows that there is one: its lower face is at 60 °C by then, the upper one still cool."""
    times = RunRules("lab", pre_trigger_s=5.0, post_removal_s=5.0, longest_run_s=3600.0)
    concluded = [event(PressEventKind.INSERTED, 9.0, 10.0), event(PressEventKind.CLOSED, 10.0)]
    for lower, header in (([60.0] * 3, {}), ([60.0, 23.0, 23.0], {"panel.initial_temperature_C": 23.0})):
        one, begins = RunKeeper(times, RunNames("lab", "lab-2026-03-04-07"), panel_places=range(1, 7)), []
        for n in range(110):
            values = (200.0, *lower, 23.0, 23.0, 23.0)
            row = Scan(n, BEGAN, 500 + n / 10, values, (G,) * 7)
            begins += [new for new, _ in one.take(row, concluded if n == 100 else []) if new]
        assert [new.header for new in begins] == [header]


def test_names_count_up_within_a_day_and_start_anew_at_midnight_utc():
    events = {
        100: [event(PressEventKind.INSERTED, 10.0)],
        400: [event(PressEventKind.REMOVED, 40.0)],
        900: [event(PressEventKind.INSERTED, 90.0)],
    }
    names = [b.run for b, _ in play(keeper(), events, 1000) if b]
    assert names == ["lab-2026-03-04-07", "lab-2026-03-05-01"]


def test_a_removal_that_was_missed_ends_the_run_at_the_next_insertion_or_after_the_longest_time():
    events = {100: [event(PressEventKind.INSERTED, 10.0)], 500: [event(PressEventKind.INSERTED, 50.0)]}
    changes = play(keeper(), events, 600)
    assert [(b.run[-2:] if b else None, e.last_scan if e else None) for b, e in changes] == [
        ("07", None),
        (None, 449),
        ("08", None),
    ]
    changes = play(keeper(longest_run_s=30.0), {100: [event(PressEventKind.INSERTED, 10.0)]}, 600)
    assert changes[1][1].last_scan == 351


def test_a_run_cut_off_is_interrupted():
    one = keeper()
    play(one, {100: [event(PressEventKind.INSERTED, 10.0)]}, 200)
    end = one.stop()
    assert (end.last_scan, end.status) == (199, RunStatus.INTERRUPTED)
    assert one.stop() is None


kinds = st.sampled_from(list(PressEventKind))


@given(st.dictionaries(st.integers(1, 399), st.lists(kinds, min_size=1, max_size=3), max_size=12))
@settings(max_examples=100, deadline=None)
def test_whatever_happens_runs_alternate_and_do_not_overlap(noticed):
    events = {n: [event(k, n / 10 - 0.5, n / 10) for k in what] for n, what in noticed.items()}
    one, is_open, last = keeper(), None, -1
    for begin, end in play(one, events, 400):
        if begin is not None:
            assert is_open is None
            assert begin.first_scan > last
            is_open = begin
        else:
            assert end.run == is_open.run
            assert end.last_scan >= is_open.first_scan
            is_open, last = None, end.last_scan
