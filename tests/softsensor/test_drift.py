"""Control charts: a jump names its run, and chance names none."""

import numpy as np
import pytest

from softsensor.jobs.drift import Chart, RunValue, last_change, log_evidence, rank_scores


def history(logs):
    return [RunValue(f"run-{i:03d}", float(np.exp(v))) for i, v in enumerate(logs)]


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
        logs = 0.08 * rng.standard_normal(32)
        logs[20:] -= np.log(2.0)
        alarm = last_change("h", history(logs))
        named.append(alarm is not None and alarm.run == "run-020" and alarm.chart is Chart.JUMP)
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


def test_a_score_is_the_mean_of_the_normal_distributions_part_that_the_rank_takes():
    thirds = np.split(np.sort(np.random.default_rng(8).standard_normal(300_000)), 3)
    for third, newest in zip(thirds, (-1.0, 0.5, 2.0), strict=True):
        assert rank_scores(np.array([0.0, 1.0, newest]))[2] == pytest.approx(third.mean(), abs=0.01)


def test_equal_values_share_their_ranks_and_speak_for_nothing():
    assert rank_scores(np.full(50, 3.0)) == pytest.approx(np.zeros(50), abs=1e-12)
    assert last_change("h", history(np.full(200, 3.0))) is None


def test_without_a_change_evidence_grows_by_one_a_run_at_most_whatever_the_scatter():
    rng = np.random.default_rng(9)
    grown = [np.exp(log_evidence(rank_scores(rng.standard_cauchy(40)))) for _ in range(4000)]
    mean, error = np.mean(grown, axis=0), np.std(grown, axis=0) / np.sqrt(len(grown))
    assert (mean - 4.0 * error <= np.arange(1, 41) + 1e-9).all()
    assert mean[-1] > 10.0


def test_a_year_of_wild_fits_raises_no_more_alarms_than_are_promised():
    rng = np.random.default_rng(10)
    alarms = 0
    for _ in range(12):
        logs = 0.12 * rng.standard_t(2, 365)
        alarms += any(last_change("h", history(logs[:n]), watched=6) is not None for n in range(10, 366, 5))
    assert alarms <= 3  # one alarm in 6 x 1000 pressings: 0.7 in these twelve years on average at most


def test_ten_percent_less_is_noticed_within_thirty_pressings():
    rng = np.random.default_rng(11)
    late = []
    for _ in range(40):
        logs = 0.08 * rng.standard_normal(160)
        logs[100:] += np.log(0.9)
        alarm = last_change("h", history(logs), watched=6)
        late.append(60 if alarm is None else int(alarm.noticed[-3:]) - 99)
    assert np.median(late) <= 30


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
