"""Control charts: a jump names its run, and chance names none."""

import numpy as np
import pytest

from softsensor.jobs.drift import RunValue, last_change


def history(logs, sd=0.03):
    return [RunValue(f"run-{i:03d}", float(np.exp(v)), float(np.exp(v)) * sd) for i, v in enumerate(logs)]


def test_a_jump_names_the_run_at_which_the_press_changed():
    logs = np.log(700.0) + 0.12 * np.random.default_rng(1).standard_normal(60)
    logs[40:] -= 0.5
    alarm = last_change("h_pp_c", history(logs))
    assert alarm is not None
    assert alarm.run in {"run-039", "run-040", "run-041"}
    assert int(alarm.noticed[-3:]) - 40 <= 6
    assert alarm.factor == pytest.approx(np.exp(-0.5), rel=0.2)
    assert "h_pp_c has changed" in str(alarm.message)


def test_a_plain_jump_names_its_very_run_nearly_always():
    rng = np.random.default_rng(3)
    named = []
    for _ in range(60):
        logs = 0.08 * rng.standard_normal(24)
        logs[15:] -= np.log(2.0)
        alarm = last_change("h", history(logs))
        named.append(alarm is not None and alarm.run == "run-015")
    assert np.mean(named) >= 0.9


def test_creeping_wear_is_noticed():
    rng = np.random.default_rng(2)
    logs = np.log(700.0) + 0.12 * rng.standard_normal(120) - 0.006 * np.arange(120)
    assert last_change("h_pp_c", history(logs)) is not None


@pytest.mark.parametrize("spread", [0.12, 0.3])
def test_ordinary_scatter_raises_hardly_an_alarm(spread):
    rng = np.random.default_rng(3)
    alarms = [last_change("h", history(np.log(700.0) + spread * rng.standard_normal(60))) for _ in range(200)]
    assert sum(a is not None for a in alarms) <= 20


def test_one_wild_fit_is_no_change():
    logs = np.log(700.0) + 0.12 * np.random.default_rng(4).standard_normal(40)
    logs[20] += 3.0
    assert last_change("h", history(logs)) is None


def test_a_press_that_came_back_raises_no_alarm():
    logs = np.log(700.0) + 0.1 * np.random.default_rng(5).standard_normal(120)
    logs[40:50] -= 0.6
    assert last_change("h", history(logs)) is None


def test_few_runs_say_nothing_and_coefficients_are_watched_apart():
    rng = np.random.default_rng(6)
    still = np.log(40.0) + 0.1 * rng.standard_normal(40)
    moved = still.copy()
    moved[20:] += 0.7
    found = [last_change(n, history(v)) for n, v in (("still", still), ("moved", moved), ("new", moved[18:24]))]
    assert [a.coefficient for a in found if a is not None] == ["moved"]
