"""A run boiled down to bins: averaging leaves a line a line, and the noise of the means is that of their rows."""

from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from softsensor.heat.model import ThermalModel
from softsensor.signals.digest import PLAIN_K, TIMING_S, MeanNoise, digest_run, whitener
from softsensor.signals.moments import moments_of

PRESS = parse_press(press_toml())
START_C = 20.0


@pytest.fixture(scope="module")
def pressing():
    run = make_campaign(12, 1, plan=Plan(rate_hz=1.0))[0][0]
    return replace(run, time_s=np.arange(len(run.time_s), dtype=float)), moments_of(run, PRESS)


def rising(pressing, slope, **offsets):
    """Digest of a run whose panel channels all rise along a line, each with an offset of its own. [K/s]"""
    run, moments = pressing
    line = {c: START_C + slope * run.time_s for c in run.columns if c.startswith(("top_", "bottom_"))}
    return digest_run(PRESS, replace(run, columns={**run.columns, **line, **offsets}), moments)


def test_bins_of_a_line_lie_on_it_and_the_model_is_read_where_their_rows_are(pressing):
    digest = rising(pressing, 0.3)
    assert digest.y[:, 0] == pytest.approx(START_C + 0.3 * digest.time)
    assert digest.bins(START_C + 0.3 * digest.samples[:, None]) == pytest.approx(digest.y[:, :1])
    assert digest.bins(digest.samples) == pytest.approx(digest.time)
    assert digest.slope == pytest.approx(np.full_like(digest.slope, 0.3))


def test_every_row_with_the_panel_in_the_press_is_in_one_bin(pressing):
    run, moments = pressing
    digest = digest_run(PRESS, run, replace(moments, inserted_s=np.nan, removed_s=np.nan))
    assert digest.period_s == 1.0
    assert digest.width.sum() == pytest.approx(len(run.time_s) * digest.period_s)


def test_a_slope_on_which_a_late_scan_costs_what_a_reading_is_worth_leaves_seven_tenths_of_the_trust(pressing):
    assert rising(pressing, 0.0).trust == pytest.approx(1.0)
    assert rising(pressing, PLAIN_K / (2.0 * TIMING_S)).trust == pytest.approx(0.5**0.5)


def test_the_noise_of_a_mean_falls_with_its_rows_and_grows_with_what_a_late_scan_costs(pressing):
    still, steep = rising(pressing, 0.0), rising(pressing, 3.0 / TIMING_S)
    rows = still.width / still.period_s
    white = np.diag(whitener(still, MeanNoise(0.0, 0.0, 0.5), 0))
    assert white**2 == pytest.approx(0.25 / rows, rel=1e-3)
    timed = np.diag(whitener(steep, MeanNoise(0.0, 0.0, 0.5), 0))
    assert timed**2 - white**2 == pytest.approx(9.0)


def test_the_mean_of_channels_is_as_unsure_as_their_offsets_leave_it(pressing):
    run, _ = pressing
    offsets = np.array([-0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9])
    columns = {f"top_{i}": START_C + 0.1 * run.time_s + d for i, d in enumerate(offsets, start=1)}
    digest = rising(pressing, 0.1, **columns)
    sd = dict(zip(digest.signals, digest.offset_sd, strict=True))
    assert sd["panel.top"] ** 2 - sd["panel.bottom"] ** 2 == pytest.approx(0.42 / 7)
    assert sd["panel.bottom"] < 0.2


def test_the_derivative_of_the_signals_is_that_of_their_means(pressing):
    run, moments = pressing
    digest, model = digest_run(PRESS, run, moments), ThermalModel(PRESS)
    values = dict(model.guesses)

    def observed(times):
        return digest.observed(digest.solve(model, values | {"h_pp_c": times * values["h_pp_c"]}))

    solution = digest.solve(model, values, ("h_pp_o", "h_pp_c"))
    found = digest.observed_tangents(solution, ("h_pp_c", "h_pp_o"))[..., 0]
    by_steps = (observed(1.001) - observed(0.999)) / (0.002 * values["h_pp_c"])
    assert np.abs(found).max() > 1e-3
    assert found == pytest.approx(by_steps, abs=0.01 * np.abs(by_steps).max())
