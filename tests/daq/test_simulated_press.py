"""The virtual press of the demonstration."""

from __future__ import annotations

import itertools
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from daq.press.header import panel_of
from daq.records import InputError, PressState, Run
from daq.simulated.campaign_sensors import CHANNELS, Nuisances
from daq.simulated.press import Cycle, VirtualPress, VirtualPressSettings

PERFECT = Nuisances.none()


def readings(press: VirtualPress, times: np.ndarray) -> dict[str, np.ndarray]:
    rows = [press.temperatures(t) for t in times]
    return {name: np.array([row[name] for row in rows]) for name in CHANNELS}


def test_pressings_follow_one_another_and_differ() -> None:
    press = VirtualPress(VirtualPressSettings(keep=20), seed=5)
    press.cycle(1500.0)
    cycles = press.cycles
    assert len(cycles) >= 9
    for one, two in itertools.pairwise(cycles):
        assert two.number == one.number + 1
        assert two.start == one.end
    for c in cycles:
        m = c.moments
        assert c.start < m.inserted_s < m.closed_s < m.opened_s < m.removed_s
        assert 0.2 <= m.ramp_s <= 1.0
    assert np.std([c.moments.opened_s - c.moments.closed_s for c in cycles]) > 3.0


def test_no_cycle_is_solved_in_the_thread_that_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal that comes while the compiler calls back into Python raises there, and nobody hears of it."""
    solving, solve = set(), VirtualPress._cycle

    def solved(press: VirtualPress, *known: object) -> Cycle:
        solving.add(threading.current_thread())
        return solve(press, *known)

    monkeypatch.setattr(VirtualPress, "_cycle", solved)
    press = VirtualPress(seed=3)
    press.cycle(press.cycle(0.0).end)
    press.set_panels(2, {"panel.thickness_mm": 22.0})
    assert solving
    assert threading.current_thread() not in solving


def test_two_presses_of_one_seed_agree_whatever_was_asked_before() -> None:
    one, two = VirtualPress(seed=11), VirtualPress(VirtualPressSettings(), seed=11)
    for t in np.arange(0.0, 400.0, 7.3):
        one.temperatures(float(t))
    assert one.temperatures(401.0) == two.temperatures(401.0)
    assert one.core(401.0) == pytest.approx(two.core(401.0), nan_ok=True)
    assert VirtualPress(seed=12).temperatures(401.0) != two.temperatures(401.0)


def test_states_come_in_order_and_the_limit_switch_agrees() -> None:
    press = VirtualPress(VirtualPressSettings(keep=20), seed=2)
    seen = [press.state(t) for t in np.arange(0.0, 600.0, 0.5)]
    changes = [b for a, b in itertools.pairwise(seen) if a != b]
    order = [PressState.OPEN, PressState.CLOSED, PressState.OPEN, PressState.IDLE]
    assert changes[:8] == (order * 2)[:8]
    for t in np.arange(0.0, 300.0, 3.1):
        assert press.closed(t) == (press.state(t) is PressState.CLOSED)


def test_the_core_is_known_only_while_a_panel_is_in_the_press() -> None:
    press = VirtualPress(seed=4)
    m = press.cycle(0.0).moments
    assert np.isnan(press.core(m.inserted_s - 1.0))
    assert press.core(m.inserted_s + 0.5) == pytest.approx(
        press.cycle(0.0).pressing.panel.initial_temperature, abs=0.01
    )
    assert press.core(m.removed_s - 0.1) > press.core(m.inserted_s + 0.5) + 5.0


def test_thermocouples_wander_between_hand_and_room_from_panel_to_panel() -> None:
    press = VirtualPress(VirtualPressSettings(nuisances=PERFECT, keep=9), seed=8)
    first = press.cycle(0.0)
    second = press.cycle(first.end + 1.0)
    times = np.arange(first.end, second.moments.inserted_s, 0.1)
    values = readings(press, times)
    panel_channels = [c for c in CHANNELS if not c.startswith("platen")]
    for name in panel_channels:
        v = values[name]
        assert v.min() > 15.0
        assert v[-5:] == pytest.approx(second.pressing.panel.initial_temperature, abs=1.5)
    loose = times > first.end + 0.6 * (second.moments.inserted_s - first.end)
    warmest = max(values[name][loose].max() for name in panel_channels)
    assert 26.0 < warmest < 60.0
    assert np.ptp([values[name][len(times) // 2] for name in panel_channels]) > 1.0


def test_readings_do_not_jump_from_one_cycle_to_the_next() -> None:
    press = VirtualPress(VirtualPressSettings(nuisances=PERFECT, keep=9), seed=9)
    end = 0.0
    for _ in range(3):
        end = press.cycle(end).end
        before, after = press.temperatures(end - 0.05), press.temperatures(end + 0.05)
        assert max(abs(before[n] - after[n]) for n in CHANNELS) < 2.0
        assert max(abs(before[n] - after[n]) for n in CHANNELS if n.startswith("platen")) < 0.1


def test_platens_ripple_and_dip_when_the_press_loads() -> None:
    press = VirtualPress(VirtualPressSettings(nuisances=PERFECT), seed=6)
    m = press.cycle(0.0).moments
    t = np.arange(0.0, m.opened_s, 0.5)
    upper = readings(press, t)["platen_top"]
    assert 190.0 < upper.min() < upper.max() < 206.0
    loaded = (t > m.closed_s) & (t < m.closed_s + 20.0)
    assert upper[loaded].min() < upper[t < m.closed_s].mean() - 0.5


def test_a_hidden_effect_changes_the_core_and_not_the_moments() -> None:
    plain = VirtualPress(seed=21)
    hidden = VirtualPress(VirtualPressSettings(hide=("vapour_convection",)), seed=21)
    assert hidden.effects["vapour_convection"]["W_m3K"] >= 1e4
    a, b = plain.cycle(0.0), hidden.cycle(0.0)
    assert a.moments == b.moments
    assert np.nanmax(b.core_C - a.core_C) > 1.0


def test_a_rim_loss_is_seen_most_by_the_sensors_at_the_rim() -> None:
    press = VirtualPress(VirtualPressSettings(hide=("edge_loss",), nuisances=PERFECT), seed=21)
    m = press.cycle(0.0).moments
    late = readings(press, np.arange(m.opened_s + 5.0, m.removed_s, 1.0))
    centre, rim = late["top_1"], (late["top_6"] + late["top_7"]) / 2
    assert (centre - rim).mean() > 0.5
    plain = VirtualPress(VirtualPressSettings(nuisances=PERFECT), seed=21)
    row = plain.temperatures(m.opened_s + 10.0)
    assert row["top_1"] == pytest.approx(row["top_7"], abs=1e-9)


def test_loggers_in_several_threads_read_the_same_press() -> None:
    press, alone = VirtualPress(seed=14), VirtualPress(seed=14)
    times = [float(t) for t in np.arange(0.0, 500.0, 2.7)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(press.temperatures, times))
    assert together == [alone.temperatures(t) for t in times]


def test_the_header_is_what_a_run_file_needs() -> None:
    cycle = VirtualPress(seed=3).cycle(0.0)
    panel = panel_of(Run("demo", cycle.header, cycle.times, cycle.readings))
    assert panel.thickness == 0.016
    assert panel.initial_temperature == pytest.approx(cycle.pressing.panel.initial_temperature, abs=0.5)


def test_a_panel_is_pressed_as_it_was_said_to_be_and_the_press_has_its_own_for_the_rest() -> None:
    header = {"panel.thickness_mm": 22.0, "panel.initial_temperature_C": 30.0, "setting.core_target_C": 85.0}
    usual, press = VirtualPress(seed=3), VirtualPress(seed=3)
    press.set_panels(press.coming(0.0), header)
    thin, thick = usual.cycle(0.0), press.cycle(0.0)
    assert (thick.pressing.panel.thickness, thick.pressing.panel.initial_temperature) == (0.022, 30.0)
    assert thick.header == {**thin.header, **header}
    assert thick.moments == thin.moments
    assert thick.core_C[-1] < thin.core_C[-1] + 8.0 - 5.0  # begun some 8 K warmer, heated through far less


def test_what_is_said_holds_for_the_panel_that_comes_and_for_none_that_is_in_the_press() -> None:
    press, judge = VirtualPress(seed=3), VirtualPress(seed=3)
    first = press.cycle(0.0)
    before, inside = first.moments.inserted_s - 2.0, first.moments.inserted_s + 2.0
    assert (press.coming(before), press.coming(inside)) == (1, 2)
    press.set_panels(1, {"panel.thickness_mm": 22.0})
    assert press.cycle(inside).pressing.panel.thickness == 0.022
    press.set_panels(2, {})
    assert press.cycle(inside).pressing.panel.thickness == 0.022
    second = press.cycle(press.cycle(inside).end)
    assert second.pressing.panel.thickness == 0.016
    judge.set_panels(1, {"panel.thickness_mm": 22.0})
    judge.set_panels(2, {})
    for at_s in (before, inside, second.moments.closed_s + 20.0):
        assert judge.temperatures(at_s) == press.temperatures(at_s)


def test_a_start_temperature_that_was_entered_is_that_of_one_panel_alone() -> None:
    press = VirtualPress(seed=3)
    press.set_panels(1, {"panel.thickness_mm": 22.0, "panel.initial_temperature_C": 31.0})
    first = press.cycle(0.0)
    second = press.cycle(first.end)
    assert (first.pressing.panel.thickness, second.pressing.panel.thickness) == (0.022, 0.022)
    assert first.header["panel.initial_temperature_C"] == 31.0
    assert abs(second.pressing.panel.initial_temperature - press.ambient) < 3.0
    assert second.header["panel.initial_temperature_C"] == pytest.approx(press.ambient, abs=4.0)


def test_a_wetter_panel_evaporates_more_where_evaporation_is_hidden() -> None:
    wet, dry = (VirtualPress(VirtualPressSettings(hide=("moisture_evaporation",)), seed=3) for _ in range(2))
    wet.set_panels(1, {"panel.moisture_percent": 12.0})
    more, less = (press.cycle(0.0).pressing.effects["moisture_evaporation"] for press in (wet, dry))
    assert more["moisture_percent"] == pytest.approx(1.5 * less["moisture_percent"])


def test_an_unknown_effect_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="'steam': unknown; known are moisture_evaporation"):
        VirtualPress(VirtualPressSettings(hide=("steam",)))


def test_a_time_that_left_memory_is_refused() -> None:
    press = VirtualPress(VirtualPressSettings(keep=2), seed=1)
    press.temperatures(2000.0)
    with pytest.raises(ValueError, match="in memory"):
        press.temperatures(10.0)
