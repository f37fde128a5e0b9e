"""Press events against the virtual press: found, placed, and never invented."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import erfc

from daq.press.detector import FaceRow
from daq.press.events import PressEventDetector, find_moments
from daq.press.faces import Face
from daq.press.moments import closing_moment, opening_moment
from daq.press.press_file import parse_press
from daq.records import PressEventKind, PressState, Run
from daq.simulated.campaign import Plan, make_campaign, press_toml
from daq.simulated.campaign_sensors import CHANNELS, Nuisances
from daq.simulated.press import VirtualPress, VirtualPressSettings
from softsensor.signals.moments import moments_seen
from tests.editions import edition

PRESS = parse_press(press_toml())
FACES = [f"{face}_{i}" for face in ("top", "bottom") for i in range(1, 8)]
IN_ORDER = ["inserted", "closed", "opened"]


def replay(run, detector=None, columns=None):
    detector = detector or PressEventDetector(PRESS)
    names = list(run.columns) if columns is None else columns
    rows = np.array([run.columns[n] for n in names]).T.tolist()
    return [
        event
        for t, row in zip(run.time_s.tolist(), rows, strict=True)
        for event in detector.update(t, dict(zip(names, row, strict=True)))
    ]


def with_rough_sensors(run, rng):
    """One dead, one noisy and one loose sensor on each face, beyond what the run has."""
    columns = dict(run.columns)
    for face in ("top", "bottom"):
        dead, noisy, loose = (f"{face}_{i}" for i in rng.permutation(7)[:3] + 1)
        columns[dead] = np.full(len(run.time_s), np.nan if rng.random() < 0.5 else 1370.0)
        columns[noisy] = columns[noisy] + rng.normal(0.0, 5.0, len(run.time_s))
        rattle = np.clip(0.6 + 0.15 * rng.standard_normal(len(run.time_s)), 0.0, 1.0)
        columns[loose] = 23.0 + rattle * (columns[loose] - 23.0)
    return Run(run.name, run.header, run.time_s, columns)


def campaign(first_seed, count, rate_hz, skew_s):
    plan = Plan(rate_hz=rate_hz, closed_column=False, nuisances=Nuisances(skew_s=skew_s))
    return [
        pair
        for seed in range(first_seed, first_seed + count // 10)
        for pair in make_campaign(seed, 10, None, plan)
    ]


def share_within(limit, errors):
    return np.mean(np.abs(errors) <= limit)


def check_pressings(count, rate_hz, limit_s, skew_s):
    """Compare events, found causally and afterwards, with the virtual press's truth."""
    rng = np.random.default_rng(7)
    live, late, after, seen = [], [], [], []
    for run, truth in campaign(int(1000 * rate_hz), count, rate_hz, skew_s):
        run = with_rough_sensors(run, rng)
        events = replay(run)
        assert [e.kind.value for e in events] == IN_ORDER, run.name
        found = find_moments(run, PRESS)
        m = truth.moments
        live += [events[1].monotonic_s - m.closed_s, events[2].monotonic_s - m.opened_s]
        late += [events[1].noticed_s - m.closed_s, events[2].noticed_s - m.opened_s]
        after += [found.closed_s - m.closed_s, found.opened_s - m.opened_s]
        seen += [run.time_s[run.time_s >= at][0] - at for at in (m.closed_s, m.opened_s)]
        assert math.isnan(found.removed_s)
        assert abs(found.inserted_s - m.inserted_s) < 1.0
    own = np.array(late) - np.array(seen)
    print(
        f"{rate_hz:g} Hz: {count} pressings, within {limit_s:g} s {share_within(limit_s, live):.2%} live and "
        f"{share_within(limit_s, after):.2%} afterwards, at worst {np.abs(live).max():.2f} s; told after "
        f"{np.quantile(late, 0.99):.2f} s (p99), {max(late):.2f} s (longest), later than the first scan that "
        f"follows by {np.quantile(own, 0.99):.2f} s (p99), {own.max():.2f} s (longest)"
    )
    assert share_within(limit_s, live) >= 0.99
    assert share_within(limit_s, after) >= 0.99
    assert np.quantile(late, 0.99) <= 1.0
    assert max(late) <= 1.2


@pytest.mark.parametrize(("rate_hz", "limit_s", "skew_s"), [(10.0, 0.1, 0.05), (1.0, 0.5, 0.25)])
def test_closing_and_opening_are_found_to_the_scan_with_dead_noisy_and_loose_sensors(rate_hz, limit_s, skew_s):
    check_pressings(50, rate_hz, limit_s, skew_s)


@pytest.mark.campaign
@pytest.mark.parametrize(("rate_hz", "limit_s", "skew_s"), [(10.0, 0.1, 0.05), (1.0, 0.5, 0.25)])
def test_a_thousand_pressings_are_found_to_the_scan(rate_hz, limit_s, skew_s):
    check_pressings(edition(200, 1000), rate_hz, limit_s, skew_s)


@pytest.mark.parametrize("rate_hz", [10.0, 1.0])
def test_whole_days_of_pressing_give_each_event_once_and_in_order(rate_hz):
    for seed in range(2):
        virtual = VirtualPress(VirtualPressSettings(thickness_mm=(16.0, 8.0)[seed]), seed)
        detector, kinds, t = PressEventDetector(PRESS), [], 0.0
        while virtual.cycle(t).number <= 8:
            scan = {name: round(value, 1) for name, value in virtual.temperatures(t).items()}
            for event in detector.update(t, scan):
                kinds.append(event.kind.value)
                moments = min(
                    (c.moments for c in virtual.cycles), key=lambda m: abs(m.closed_s - event.monotonic_s)
                )
                if event.kind is not PressEventKind.REMOVED:
                    true = getattr(moments, f"{event.kind.value}_s")
                    assert event.monotonic_s == pytest.approx(true, abs=0.12 if rate_hz == 10 else 0.6)
            t += 1 / rate_hz
        assert kinds == (["inserted", "closed", "opened", "removed"] * 8)[: len(kinds)]
        assert len(kinds) >= 31


def idle_hours(rng, hours, rate_hz, heating):
    """Sensors on hands and in the air, a door that opens, platens steady or heated up and down."""
    n = int(hours * 3600 * rate_hz)
    t = np.arange(n) / rate_hz
    platen = 110 - 90 * np.cos(2 * np.pi * t / 7200) if heating else np.full(n, 195.0)
    air = 23 + 4 * np.sin(2 * np.pi * t / 28800)
    for begin in rng.integers(0, n, int(2 * hours) + 1):
        air[begin : begin + int(rng.uniform(30, 200) * rate_hz)] -= rng.uniform(2, 6)
    around = {name: air.copy() for name in FACES}
    for name in FACES:
        for begin in rng.integers(0, n, int(40 * hours)):
            around[name][begin : begin + int(rng.uniform(0.5, 20) * rate_hz) + 1] = rng.uniform(28, 36)
    for begin in rng.integers(0, n, int(10 * hours)):
        face, warm = ("top", "bottom")[int(rng.integers(2))], rng.uniform(30, 36)
        for i in range(1, 8):
            around[f"{face}_{i}"][begin : begin + int(rng.uniform(1, 20) * rate_hz) + 1] = warm
    columns = {"platen_top": platen + 0.5 * np.sin(t / 25), "platen_bottom": platen}
    for name, target in around.items():
        keep = np.exp(-1 / rate_hz / rng.uniform(0.3, 2.5))
        values = lfilter([1 - keep], [1, -keep], target, zi=[keep * target[0]])[0]
        columns[name] = np.round(values + rng.normal(0, 0.3) + rng.normal(0, 0.05, n), 1)
    return Run("idle", {}, t, columns)


@pytest.mark.parametrize("heating", [False, True])
@pytest.mark.parametrize("rate_hz", [10.0, 1.0])
def test_hands_doors_and_heating_platens_are_no_events(rate_hz, heating):
    hours = 1 if rate_hz == 10 else 6
    assert replay(idle_hours(np.random.default_rng(11), hours, rate_hz, heating)) == []


@pytest.mark.campaign
@pytest.mark.parametrize("heating", [False, True])
@pytest.mark.parametrize("rate_hz", edition([1.0], [10.0, 2.0, 1.0, 0.5]))
def test_a_day_of_hands_doors_and_heating_platens_has_no_event(rate_hz, heating):
    assert replay(idle_hours(np.random.default_rng(13), 24, rate_hz, heating)) == []


def one_run(rate_hz=10.0, seed=42, **plan):
    return make_campaign(seed, 1, None, Plan(rate_hz=rate_hz, **plan))[0]


@pytest.mark.parametrize("at_s", [4.0, 6.0])
@pytest.mark.parametrize("rate_hz", [10.0, 2.0])
def test_a_resin_that_has_cured_within_seconds_does_not_open_the_press(rate_hz, at_s):
    """Its heat lifts both faces, and they fall by kelvins as it ends."""
    plan = Plan(rate_hz=rate_hz, closed_column=False)
    for run, truth in make_campaign(12, 3, None, plan):
        since = (run.time_s - truth.moments.closed_s - at_s) / 0.8
        bump = {name: run.columns[name] + 12.0 * np.exp(-(since**2)) for name in run.columns if name in FACES}
        cured = Run(run.name, run.header, run.time_s, {**run.columns, **bump})
        events = replay(cured)
        assert [e.kind.value for e in events] in (IN_ORDER, [*IN_ORDER, "closed", "opened"])
        assert events[-1].monotonic_s == pytest.approx(truth.moments.opened_s, abs=0.5 / rate_hz)
        found = find_moments(cured, PRESS)
        assert found.closed_s == pytest.approx(truth.moments.closed_s, abs=0.5 / rate_hz)
        assert found.opened_s == pytest.approx(truth.moments.opened_s, abs=0.5 / rate_hz)
        pressed = cured.time_s < truth.moments.opened_s - 1.0
        cut = Run(run.name, run.header, run.time_s[pressed], {n: v[pressed] for n, v in cured.columns.items()})
        assert math.isnan(find_moments(cut, PRESS).opened_s)


def test_a_single_noisy_sensor_that_rises_after_the_opening_does_not_close_the_press():
    run = next(run for run, _ in campaign(10500, 10, 10.0, 0.05) if run.name == "v10500-05")
    events = replay(run, columns=["platen_top", "platen_bottom", "top_5", "bottom_6"])
    assert [e.kind.value for e in events] == IN_ORDER


def pressed_again(run, truth, open_s):
    """The run until so long after the opening, then its pressing once more on the hot panel; when that is."""
    t, m = run.time_s, truth.moments
    first = t < m.opened_s + open_s
    again = (t > m.closed_s - 0.3) & (t < m.opened_s - 1.0)
    columns = {n: np.concatenate([c[first], np.maximum(c[again], c[first][-1])]) for n, c in run.columns.items()}
    if "closed" in columns:
        columns["closed"] = np.concatenate([run.columns["closed"][rows] for rows in (first, again)])
    start = t[first][-1] + 0.1
    times = np.concatenate([t[first], start + t[again] - t[again][0]])
    return Run(run.name, run.header, times, columns), start + 0.3


@pytest.mark.parametrize(("closed_column", "open_s"), [(True, 2.5), (True, 8.0), (False, 8.0)])
def test_a_pressing_ends_where_the_press_closes_on_the_same_panel_again(closed_column, open_s):
    run, truth = one_run(closed_column=closed_column)
    twice, closed_s = pressed_again(run, truth, open_s)
    found, once = find_moments(twice, PRESS), find_moments(run, PRESS)
    assert found.closed_again
    assert (found.closed_s, found.opened_s) == pytest.approx((once.closed_s, once.opened_s), abs=0.05)
    assert closed_s - 1.7 < found.removed_s < closed_s - 0.3
    assert not once.closed_again


def test_a_switch_that_flickers_on_an_open_press_ends_no_pressing():
    run, truth = one_run(closed_column=True)
    opened = truth.moments.opened_s + 1.0
    flicker = (run.time_s > opened) & (run.time_s < opened + 0.3)
    closed = np.where(flicker, 1.0, run.columns["closed"])
    found = find_moments(Run("flicker", {}, run.time_s, {**run.columns, "closed": closed}), PRESS)
    assert found == find_moments(run, PRESS)


def test_a_limit_switch_goes_before_the_temperatures():
    run, _ = one_run(closed_column=True)
    late = Run("late", {}, run.time_s, {**run.columns, "closed": np.roll(run.columns["closed"], 12)})
    first, last = np.flatnonzero(late.columns["closed"])[[0, -1]]
    found = find_moments(late, PRESS)
    assert found.source == "limit switch"
    assert found.closed_s == late.time_s[first]
    assert found.opened_s == late.time_s[last + 1]
    events = replay(late)
    assert [e.kind.value for e in events] == IN_ORDER
    assert [e.source for e in events] == ["temperatures", "limit switch", "limit switch"]
    assert events[1].monotonic_s == late.time_s[first]


def wired(run, wire="", **columns):
    """A run without `closed`, with other columns instead, and the press file that names them."""
    kept = {n: c for n, c in run.columns.items() if n != "closed"}
    press = parse_press(press_toml().replace("[press]\n", f"[press]\n{wire}\n"))
    return Run("wired", run.header, run.time_s, {**kept, **columns}), press


def test_a_limit_switch_of_any_name_goes_before_the_temperatures_live_and_in_files():
    run, _ = one_run(closed_column=True)
    late = np.roll(run.columns["closed"], 12)
    first, last = np.flatnonzero(late)[[0, -1]]
    named, press = wired(run, 'limit_switch = "S7"', S7=late)
    found = find_moments(named, press)
    assert (found.source, found.closed_s, found.opened_s) == (
        "limit switch",
        run.time_s[first],
        run.time_s[last + 1],
    )
    assert [e.source for e in replay(named, PressEventDetector(press))] == [
        "temperatures",
        "limit switch",
        "limit switch",
    ]
    named, press = wired(run, S7=late)
    by_header = Run("own", {**run.header, "press.limit_switch": "S7"}, run.time_s, named.columns)
    assert find_moments(named, press).source == "temperatures"
    assert find_moments(by_header, press) == found


def test_a_pressure_channel_closes_above_one_threshold_and_opens_below_another():
    run, truth = one_run(closed_column=False)
    m, t = truth.moments, run.time_s
    bar = np.interp(
        t, [m.closed_s, m.closed_s + 2, m.opened_s - 10, m.opened_s - 8, m.opened_s], [0, 90, 90, 14, 0]
    )
    bar += np.random.default_rng(1).normal(0.0, 1.0, len(t))
    pressed, press = wired(run, 'pressure = { column = "bar", closed_above = 20.0, open_below = 8.0 }', bar=bar)
    events = replay(pressed, PressEventDetector(press))
    assert [e.kind.value for e in events] == IN_ORDER
    assert [e.source for e in events[1:]] == ["pressure channel", "pressure channel"]
    assert events[1].monotonic_s == pytest.approx(m.closed_s + 0.44, abs=0.15)
    assert bar[np.searchsorted(t, events[2].monotonic_s)] < 8.0
    assert events[2].monotonic_s > m.opened_s - 8.0
    found = find_moments(pressed, press)
    assert found.source == "pressure channel"
    assert [found.closed_s, found.opened_s] == [e.monotonic_s for e in events[1:]]


@pytest.mark.parametrize("wire", ["switch", "pressure", "temperatures"])
def test_numbers_of_numpy_say_what_plain_ones_say(wire):
    run, _ = one_run(closed_column=wire == "switch")
    bar = np.where((run.time_s > 25.0) & (run.time_s < 90.0), 30.0, 1.0)
    if wire == "pressure":
        run, press = wired(run, 'pressure = { column = "bar", closed_above = 20.0 }', bar=bar)
    else:
        press = PRESS
    detector, events = PressEventDetector(press), []
    for i, t in enumerate(run.time_s):
        events += detector.update(t, {name: values[i] for name, values in run.columns.items()})
    assert events == replay(run, PressEventDetector(press))


def test_where_the_switch_is_silent_the_pressure_decides_and_where_both_are_the_temperatures():
    run, truth = one_run(closed_column=True)
    nothing = np.full(len(run.time_s), np.nan)
    wire = 'limit_switch = "S7"\npressure = { column = "bar", closed_above = 20.0 }'
    logged, press = wired(run, wire, S7=nothing, bar=90.0 * run.columns["closed"])
    assert find_moments(logged, press).source == "pressure channel"
    silent, press = wired(run, wire, S7=nothing, bar=nothing)
    events = replay(silent, PressEventDetector(press))
    assert [(e.kind.value, e.source) for e in events] == [(kind, "temperatures") for kind in IN_ORDER]
    assert events[1].monotonic_s == pytest.approx(truth.moments.closed_s, abs=0.1)


def test_a_switch_that_contradicts_the_temperatures_is_reported():
    run, truth = one_run(closed_column=False)
    stuck = Run("stuck", {}, run.time_s, {**run.columns, "closed": np.zeros(len(run.time_s))})
    detector, reported = PressEventDetector(PRESS), set()
    for i, t in enumerate(run.time_s.tolist()):
        detector.update(t, {name: float(c[i]) for name, c in stuck.columns.items()})
        if truth.moments.closed_s + 15 < t < truth.moments.opened_s - 1:
            reported.add(str(detector.disagreement))
    assert reported == {"the limit switch reports open, but the upper face is hot; check it"}


def kinds(events):
    return [e.kind.value for e in events]


def test_a_limit_switch_that_bounces_tells_each_moment_once():
    run, _ = one_run(closed_column=True)
    clean = run.columns["closed"]
    first, last = np.flatnonzero(clean)[[0, -1]]
    bouncing = clean.copy()
    bouncing[[first + 1, first + 3]] = 0.0
    bouncing[[last + 2, last + 4]] = 1.0
    named, press = wired(run, 'limit_switch = "S7"', S7=bouncing)
    found = find_moments(named, press)
    assert (found.closed_s, found.opened_s) == (run.time_s[first], run.time_s[last + 1])
    assert kinds(replay(named, PressEventDetector(press))) == IN_ORDER


@pytest.mark.parametrize("share", [0.1, 0.7])
def test_a_single_row_in_which_the_switch_slips_is_no_movement_of_the_press_in_a_file(share):
    run, _ = one_run(closed_column=True)
    clean = run.columns["closed"]
    first, last = np.flatnonzero(clean)[[0, -1]]
    slip = int(share * last) if share > 0.5 else int(share * first)
    slipping = clean.copy()
    slipping[slip] = 1.0 - clean[slip]
    named, press = wired(run, 'limit_switch = "S7"', S7=slipping)
    found = find_moments(named, press)
    assert (found.closed_s, found.opened_s) == (run.time_s[first], run.time_s[last + 1])


def after_idle(run, seconds, closed):
    """The run after some seconds of idle scans; the switch was closed in a part of them."""
    idle = np.arange(0.0, seconds, 0.1)
    rng = np.random.default_rng(4)
    columns = {n: np.concatenate([c[0] + rng.normal(0, 0.03, len(idle)), c]) for n, c in run.columns.items()}
    columns["closed"][: len(idle)] = (idle > closed[0]) & (idle < closed[1])
    return Run("later", run.header, np.concatenate([idle, seconds + run.time_s - run.time_s[0]]), columns)


@pytest.mark.parametrize("blind", [False, True])
def test_a_press_closed_with_nothing_in_it_leaves_the_next_panel_its_own_insertion(blind):
    run, truth = one_run(closed_column=True)
    later = after_idle(run, 100.0, (20.0, 60.0))
    if blind:
        for name in FACES:
            later.columns[name][later.time_s < 80.0] = np.nan
    events = replay(later)
    assert kinds(events) == ["inserted", "closed", "opened", "removed", *IN_ORDER]
    assert events[3].monotonic_s == pytest.approx(80.0 if blind else 60.0, abs=0.2)
    inserted = 100.0 + truth.moments.inserted_s - run.time_s[0]
    assert events[4].monotonic_s == pytest.approx(inserted, abs=0.3)


def test_pressings_without_any_panel_sensor_are_told_apart_by_the_switch():
    run, _ = one_run(closed_column=True)
    columns = {n: np.concatenate([c, c]) for n, c in run.columns.items() if n not in FACES}
    times = np.concatenate([run.time_s, run.time_s + run.time_s[-1] + 0.1])
    events = replay(Run("blind", run.header, times, columns))
    one = ["inserted", "closed", "opened"]
    assert kinds(events) == [*one, "removed", *one]


def test_a_switch_that_comes_late_or_is_lost_leaves_the_other_moment_to_the_temperatures():
    run, truth = one_run(closed_column=True)
    m, t, switch = truth.moments, run.time_s, run.columns["closed"]
    middle = 0.5 * (m.closed_s + m.opened_s)
    for silent in (t < middle, t > middle):
        named, press = wired(run, 'limit_switch = "S7"', S7=np.where(silent, np.nan, switch))
        for found in (find_moments(named, press), moments_seen(named, press)):
            assert found.closed_s == pytest.approx(m.closed_s, abs=0.12)
            assert found.opened_s == pytest.approx(m.opened_s, abs=0.12)


def test_a_panel_that_cools_while_the_press_eases_off_is_not_gone_before_a_wire_tells_of_the_opening():
    plan = Plan(
        rate_hz=1.0, thickness_mm=8.0, press_time_s=(30.0, 30.0), open_before_s=(5.0, 8.0),
        open_after_s=(15.0, 20.0), eased=(0.2, 0.5), closed_column=True,
    )  # fmt: skip
    press = parse_press(press_toml(loaded=True))
    for run, truth in make_campaign(24_202, 2, {"contact_levelling": {"share": 0.5}}, plan):
        found = moments_seen(run, press)
        assert found.opened_s == pytest.approx(truth.moments.opened_s, abs=0.6)
        assert not found.removed_s < found.opened_s
        assert math.isnan(truth.moments.removed_s)


@pytest.mark.parametrize("after_s", [0.3, 0.5, 0.7, 0.9])
def test_a_switch_that_comes_back_while_a_closing_is_being_placed_tells_it_once(after_s):
    run, truth = one_run(closed_column=True, seed=7)
    back = truth.moments.closed_s + after_s
    silent = (run.time_s > back - 5.0) & (run.time_s < back)
    named, press = wired(run, 'limit_switch = "S7"', S7=np.where(silent, np.nan, run.columns["closed"]))
    assert kinds(replay(named, PressEventDetector(press))) == IN_ORDER


@pytest.mark.parametrize("blinks", [True, False])
def test_an_upper_face_that_only_falls_is_no_insertion_when_the_lower_one_is_not_heard(blinks):
    """A recorder that begins in mid-press: faces hot, then the press opens and late scans lack the lower face."""
    detector = PressEventDetector(PRESS)
    found = []
    for t in np.arange(0.0, 45.0, 1.0).tolist():
        cooling = 1.0 - math.exp(-max(t - 10.0, 0.0) / 12.0)
        values = {"platen_top": 200.0, "platen_bottom": 199.0}
        values |= {f"top_{k}": 185.0 - 80.0 * cooling for k in range(1, 4)}
        lost = t % 4 == 0 if blinks else True
        values |= {f"bottom_{k}": math.nan if lost else 184.0 - 35.0 * cooling for k in range(1, 4)}
        found += detector.update(t, values)
    assert found == []
    assert detector.state is PressState.IDLE


def test_an_upper_face_that_warms_alone_still_shows_the_panel():
    detector = PressEventDetector(PRESS)
    found = []
    for t in np.arange(0.0, 45.0, 1.0).tolist():
        values = {"platen_top": 200.0, "platen_bottom": 199.0, "top_1": 22.0 + 1.2 * max(t - 5.0, 0.0)}
        found += detector.update(t, values)
    assert [event.kind for event in found] == [PressEventKind.INSERTED]


@pytest.mark.parametrize("face", ["top", "bottom"])
def test_one_face_alone_still_shows_closing_and_opening(face):
    run, truth = one_run()
    columns = {n: c for n, c in run.columns.items() if n.startswith((face, "platen"))}
    found = find_moments(Run("half", run.header, run.time_s, columns), PRESS)
    assert found.closed_s == pytest.approx(truth.moments.closed_s, abs=0.3)
    assert found.opened_s == pytest.approx(truth.moments.opened_s, abs=0.3)


def test_a_single_sensor_on_each_face_with_missing_cells_is_enough():
    run, truth = one_run(rate_hz=2.0)
    rng = np.random.default_rng(3)
    columns = {n: run.columns[n].copy() for n in ("platen_top", "top_3", "bottom_5")}
    for column in columns.values():
        column[rng.random(len(column)) < 0.1] = np.nan
    found = find_moments(Run("few", run.header, run.time_s, columns), PRESS)
    assert found.closed_s == pytest.approx(truth.moments.closed_s, abs=0.5)
    assert found.opened_s == pytest.approx(truth.moments.opened_s, abs=0.5)


@pytest.mark.parametrize("blind_s", [1.0, 20.0])
def test_a_lower_sensor_that_is_blind_for_a_while_is_no_removal(blind_s):
    run, truth = one_run(closed_column=False, open_before_s=(30.0, 31.0))
    columns = {n: run.columns[n].copy() for n in ("platen_top", "platen_bottom", "top_3", "bottom_5")}
    begin = truth.moments.closed_s - 4.0 - blind_s
    columns["bottom_5"][(run.time_s > begin) & (run.time_s < begin + blind_s)] = np.nan
    assert [e.kind.value for e in replay(Run("blinks", run.header, run.time_s, columns))] == IN_ORDER


@pytest.mark.parametrize("rate_hz", [10.0, 1.0])
def test_a_sensor_that_rattles_does_not_shake_its_face(rate_hz):
    rng, face, level = np.random.default_rng(5), Face(), []
    for _ in range(int(60 * rate_hz)):
        level.append(face.update({"a": 20.0, "b": 20.5, "c": 21.0, "d": 20.5 + 5.0 * rng.normal()}, 1.0 / rate_hz))
    assert np.ptp(level[int(40 * rate_hz) :]) < 0.05
    assert level[-1] == pytest.approx(20.5, abs=0.05)  # of the three that stand still


def test_the_level_of_a_face_that_loses_a_sensor_goes_over_to_the_rest_in_some_ten_seconds():
    detector, levels = PressEventDetector(PRESS), []
    for t in range(100, 140):
        detector.update(float(t), {"top_1": 60.0} | ({"top_2": 90.0} if t < 110 else {}))
        levels.append(detector._top.level)
    assert levels[:12] == [75.0] * 12  # the last value stands for a moment
    assert levels[21] == pytest.approx(60.0 + 15.0 / np.e)  # ten seconds after the loss was seen
    assert np.all(np.diff(levels[11:]) < 0.0)


@pytest.mark.parametrize("rate_hz", [10.0, 1.0])
def test_the_loss_of_the_hottest_sensor_of_each_face_is_no_opening(rate_hz):
    """A face's median goes on from where it was."""
    run, truth = one_run(closed_column=False, rate_hz=rate_hz)
    columns = {n: run.columns[n].copy() for n in ("platen_top", "platen_bottom", "top_3", "bottom_5")}
    lost = run.time_s > 0.5 * (truth.moments.closed_s + truth.moments.opened_s)
    for name, near in (("top_4", "top_3"), ("bottom_6", "bottom_5")):
        columns[name] = np.where(lost, np.nan, columns[near] + 30.0)
    events = replay(Run("lost", run.header, run.time_s, columns))
    assert [e.kind.value for e in events] == IN_ORDER
    assert events[2].monotonic_s == pytest.approx(truth.moments.opened_s, abs=0.6)


@pytest.mark.parametrize("slow", ["bottom", "top", "platen"])
def test_a_logger_slower_than_the_scans_shows_the_same_events(slow):
    run, truth = one_run(closed_column=False, rate_hz=1.0)
    unanswered = np.arange(len(run.time_s)) % 3 > 0
    columns = {n: np.where(unanswered & n.startswith(slow), np.nan, c) for n, c in run.columns.items()}
    events = replay(Run("slow", run.header, run.time_s, columns))
    m = truth.moments
    assert [e.kind.value for e in events] == IN_ORDER
    moments = [m.inserted_s, m.closed_s, m.opened_s]
    assert [e.monotonic_s for e in events] == pytest.approx(moments, abs=1.5)  # half of three seconds


def test_a_moment_lies_between_the_scans_that_show_what_was_before_and_after_it_however_far_apart():
    plan = Plan(rate_hz=2.0, press_time_s=(120.0, 180.0), open_before_s=(25.0, 40.0), closed_column=False)
    for first, (run, truth) in enumerate(make_campaign(8, 6, None, plan)):
        found = find_moments(run.at_rows(slice(3 * first, None, 20)), PRESS)
        times = run.time_s[3 * first :: 20]
        for name in ("closed_s", "opened_s"):
            after = int(np.searchsorted(times, getattr(truth.moments, name)))
            assert times[after - 1] - 0.5 <= getattr(found, name) <= times[after]


def test_a_value_from_before_a_standstill_is_not_taken_for_one_of_now():
    detector = PressEventDetector(PRESS)
    for t in range(5):
        detector.update(float(t), {"top_1": 60.0, "bottom_1": 90.0})
    detector.update(40.0, {"top_1": 61.0, "bottom_1": math.nan})
    assert detector._rows[-1].bottoms == {}


@pytest.mark.campaign
@pytest.mark.parametrize(("rate_hz", "limit_s", "skew_s"), [(10.0, 0.1, 0.05), (1.0, 0.5, 0.25)])
def test_one_sensor_on_each_face_finds_a_hundred_pressings(rate_hz, limit_s, skew_s):
    rng = np.random.default_rng(9)
    live, late = [], []
    for run, truth in campaign(int(1000 * rate_hz) + 500, edition(30, 100), rate_hz, skew_s):
        names = ["platen_top", "platen_bottom", *(f"{face}_{rng.integers(1, 8)}" for face in ("top", "bottom"))]
        events = replay(run, columns=names)
        assert [e.kind.value for e in events] == IN_ORDER, run.name
        for event, at in zip(events[1:], (truth.moments.closed_s, truth.moments.opened_s), strict=True):
            live.append(event.monotonic_s - at)
            late.append(event.noticed_s - at)
    print(
        f"{rate_hz:g} Hz, one sensor a face: within {limit_s:g} s {share_within(limit_s, live):.1%}, at worst "
        f"{np.abs(live).max():.2f} s; told after {np.quantile(late, 0.99):.2f} s (p99), {max(late):.2f} s at most"
    )
    assert share_within(limit_s, live) >= 0.98


def test_without_panel_columns_and_switch_the_state_is_unknown():
    run, _ = one_run(closed_column=False)
    blind = Run("blind", {}, run.time_s, {n: run.columns[n] for n in ("platen_top", "platen_bottom")})
    detector = PressEventDetector(PRESS)
    assert replay(blind, detector) == []
    assert detector.state is None
    found = find_moments(blind, PRESS)
    assert found.source == "unknown"
    assert math.isnan(found.closed_s)


def test_the_state_follows_the_panel_and_gets_lost_with_the_sensors():
    run, truth = one_run(closed_column=False, start_before_s=8.0)
    detector, states = PressEventDetector(PRESS), {}
    for i, t in enumerate(run.time_s.tolist()):
        detector.update(t, {name: float(c[i]) for name, c in run.columns.items()})
        states[t] = detector.state
    m = truth.moments
    for t, state in states.items():
        if 1 < t < m.inserted_s:
            assert state is PressState.IDLE
        if m.inserted_s + 3 < t < m.closed_s or t > m.opened_s + 1:
            assert state is PressState.OPEN
        if m.closed_s + 1 < t < m.opened_s:
            assert state is PressState.CLOSED
    for k in range(50):
        detector.update(run.time_s[-1] + 0.1 * (k + 1), dict.fromkeys(CHANNELS, math.nan))
    assert detector.state is None


def test_a_run_cut_at_the_opening_has_no_opening():
    run, truth = one_run(closed_column=False)
    n = int(np.searchsorted(run.time_s, truth.moments.opened_s - 1))
    short = Run("short", {}, run.time_s[:n], {name: c[:n] for name, c in run.columns.items()})
    found = find_moments(short, PRESS)
    assert found.closed_s == pytest.approx(truth.moments.closed_s, abs=0.1)
    assert math.isnan(found.opened_s)


def test_a_sensors_lag_is_learned_and_does_not_delay_the_moments():
    plan = Plan(rate_hz=10.0, closed_column=False)
    for run, truth in make_campaign(5, 6, {"thermocouple_lag": {"time_constant_s": 0.6}}, plan):
        found = find_moments(run, PRESS)
        assert found.closed_s == pytest.approx(truth.moments.closed_s, abs=0.15)
        assert found.opened_s == pytest.approx(truth.moments.opened_s, abs=0.15)


def test_closing_is_placed_on_the_closed_form_of_a_half_space_at_once_in_contact():
    # Carslaw & Jaeger 2.7: rise = 1 - exp(a² t) erfc(a √t), contact a = h / effusivity
    t = np.arange(-6.0, 1.0, 0.1)
    since = np.clip(t - 0.037, 0.0, None)
    rise = 1 - np.exp(1.9**2 * since) * erfc(1.9 * np.sqrt(since))
    placed = closing_moment(t, 23.0 + 170.0 * rise, 193.0, 0.4)
    assert placed.middle == pytest.approx(0.037, abs=0.08)
    assert placed.ramp < 0.35


def test_opening_is_placed_on_the_closed_form_of_a_lost_flux():
    # Carslaw & Jaeger 2.9: a flux that starts at once changes the face by the root of time
    t = np.arange(-4.0, 1.0, 0.1)
    fall = 20.0 * np.sqrt(np.clip(t - 0.013, 0.0, None))
    assert opening_moment(t, [170.0 + 0.2 * t - fall], 0.3).middle == pytest.approx(0.013, abs=0.06)


@pytest.mark.parametrize(
    ("hidden", "plan"),
    [
        (None, Plan(rate_hz=5.0, thickness_mm=3.0, press_time_s=(200.0, 300.0), closed_column=False)),
        (None, Plan(rate_hz=10.0, press_time_s=(5.0, 8.0), open_before_s=(2.0, 3.0), closed_column=False)),
        (None, Plan(rate_hz=5.0, platen_C=(90.0, 120.0), closed_column=False)),
        (None, Plan(rate_hz=2.0, nuisances=Nuisances(missing=0.1), closed_column=False)),
        ("lifted_panel", Plan(rate_hz=5.0, closed_column=False)),
        ("contact_lapse", Plan(rate_hz=5.0, closed_column=False)),
        ("paper_layer", Plan(rate_hz=5.0, closed_column=False)),
    ],
    ids=["heated through", "short", "cool platens", "many gaps", "lifted", "contact lapse", "paper"],
)
def test_unusual_pressings_are_found_too_and_none_is_taken_for_removed(hidden, plan):
    for run, truth in make_campaign(77, 6, hidden, plan):
        found = find_moments(run, PRESS)
        assert found.closed_s == pytest.approx(truth.moments.closed_s, abs=0.4)
        assert found.opened_s == pytest.approx(truth.moments.opened_s, abs=0.4)
        assert math.isnan(found.removed_s)
        assert [e.kind.value for e in replay(run)] == IN_ORDER


def whole_pressing(seed, after_s, apart_s):
    """Return times and readings from before a panel's insertion until after its removal, and the truth."""
    virtual = VirtualPress(VirtualPressSettings(), seed)
    moments = virtual.cycle(0.0).moments
    times = np.arange(moments.inserted_s - 5, moments.removed_s + after_s, apart_s)
    scans = [virtual.temperatures(t) for t in times.tolist()]
    return times, {name: np.array([s[name] for s in scans]) for name in CHANNELS}, moments


def test_a_run_that_ends_soon_after_the_removal_knows_it():
    times, columns, moments = whole_pressing(4, 5, 0.1)
    found = find_moments(Run("whole", {}, times, columns), PRESS)
    assert found.removed_s == pytest.approx(moments.removed_s, abs=3.0)


@pytest.mark.parametrize("seed", range(4, 10))
def test_a_run_that_goes_on_until_the_sensors_are_cold_knows_when_the_panel_left(seed):
    times, columns, moments = whole_pressing(seed, 12, 0.67)
    found = find_moments(Run("whole", {}, times, columns), PRESS)
    assert found.removed_s == pytest.approx(moments.removed_s, abs=2.0)
    lost = (times - moments.removed_s + 4.5) % 6.0 < 2.0  # the lower face's logger comes and goes
    columns |= {name: np.where(lost, np.nan, v) for name, v in columns.items() if name.startswith("bottom_")}
    found = find_moments(Run("gappy", {}, times, columns), PRESS)
    assert found.removed_s == pytest.approx(moments.removed_s, abs=3.0)


def test_insertion_of_a_run_that_never_closes_is_kept():
    run, truth = make_campaign(4, 1, plan=Plan(rate_hz=2.0, closed_column=False))[0]
    keep = run.time_s < truth.moments.closed_s - 1.0
    short = run.at_rows(keep)
    found = find_moments(short, PRESS)
    assert math.isnan(found.closed_s)
    assert found.inserted_s == pytest.approx(truth.moments.inserted_s, abs=1.0)
    assert truth.moments.inserted_s > short.time_s[0] + 1.5


@pytest.mark.parametrize(("upper_C", "inserted"), [(60.0, True), (70.0, False)])
def test_an_upper_face_that_warms_half_as_far_as_the_lower_one_is_no_insertion(upper_C, inserted):
    detector, found = PressEventDetector(PRESS), []
    for i in range(600):
        share = min(max(i / 10.0 - 40.0, 0.0) / 3.0, 1.0)
        lower, upper = (25.0 + share * (to_C - 25.0) for to_C in (110.0, upper_C))
        scan = {"platen_top": 200.0, "platen_bottom": 200.0}
        scan |= {f"bottom_{n}": lower for n in range(1, 8)} | {f"top_{n}": upper for n in range(1, 8)}
        found += detector.update(i / 10.0, scan)
    assert [event.kind for event in found] == ([PressEventKind.INSERTED] if inserted else [])


def test_one_sensor_far_from_the_rest_does_not_spread_a_face_of_many():
    detector = PressEventDetector(PRESS)
    for values, spread_K in (((20.0, 30.0, 31.0, 90.0), 1.0), ((20.0, 30.0, 90.0), 70.0), ((20.0,), 0.0)):
        row = FaceRow(0.0, 0.0, 0.0, 0.0, {}, {f"bottom_{i}": value for i, value in enumerate(values)})
        assert detector._spread(row) == spread_K
