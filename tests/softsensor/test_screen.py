"""The screen of channels: what departs from its face alone is left out, what a face does as a whole stays."""

from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import parse_press, read_press
from daq.records import Moments, Run
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.signals.digest import digest_run
from softsensor.signals.moments import moments_of
from softsensor.signals.places import collect_signals
from softsensor.signals.robust import nan_median, robust_sd
from softsensor.signals.screen import ChannelFault, FaultKind, recurring, screened
from tests.softsensor.conftest import LAB_PRESS

PRESS = parse_press(press_toml())


@pytest.fixture(scope="module")
def measured():
    nuisances = replace(Nuisances.real_chain(), loose_chance=0.0)
    return make_campaign(12, 1, plan=Plan(rate_hz=1.0, nuisances=nuisances))[0][0]


def spoiled(run, **columns):
    return replace(run, columns={**run.columns, **columns})


def found(run):
    return {f.column: f.kind for f in screened(PRESS, run, moments_of(run, PRESS)).faults}


def test_sound_channels_are_kept(measured):
    assert found(measured) == {}


def test_a_swapped_channel_and_a_loose_one_that_fall_alike_are_both_found(measured):
    c = measured.columns
    upper = nan_median(np.stack([c[f"top_{i}"] for i in range(1, 8)], axis=1))
    loose = c["top_7"] + 1.4 * (c["bottom_2"] - upper)
    run = spoiled(measured, top_5=c["bottom_1"], bottom_1=c["top_5"], top_7=loose)
    assert found(run) == {"bottom_1": FaultKind.SWAPPED, "top_5": FaultKind.SWAPPED, "top_7": FaultKind.LOOSE}


def test_two_channels_that_fall_behind_alike_are_a_pattern_over_the_face(measured):
    c, t = measured.columns, measured.time_s
    behind = 4.0 * np.sin(t / 30.0)
    assert found(spoiled(measured, top_6=c["top_6"] - behind, top_7=c["top_7"] - behind)) == {}
    assert found(spoiled(measured, top_6=c["top_6"] - behind)) == {"top_6": FaultKind.LOOSE}


@pytest.mark.parametrize("channels", [range(2, 8, 2), range(1, 8)])
@pytest.mark.parametrize("kelvin", [80.0, -200.0, 5.0])
def test_single_bad_cells_make_no_channel_faulty_and_hide_none_that_is(measured, channels, kelvin):
    rng, c = np.random.default_rng(3), measured.columns
    loose = spoiled(measured, top_7=c["top_7"] + 4.0 * np.sin(measured.time_s / 30.0))
    bad = [f"{face}_{i}" for face in ("top", "bottom") for i in channels]
    for run, faults in ((measured, {}), (loose, {"top_7": FaultKind.LOOSE})):
        cells = {name: rng.random(len(run.time_s)) < 0.01 for name in bad}
        spiked = spoiled(run, **{name: run.columns[name] + kelvin * cells[name] for name in bad})
        sound = screened(PRESS, spiked, moments_of(spiked, PRESS))
        assert {f.column: f.kind for f in sound.faults} == faults
        assert all(np.isnan(sound.run.columns[name][cells[name]]).all() for name in set(bad) - set(faults))


def test_rows_that_a_whole_face_reads_wrongly_are_left_out_and_its_jumps_as_the_press_moves_are_not(measured):
    moments = moments_of(measured, PRESS)
    quiet = np.flatnonzero(measured.time_s > moments.closed_s + 5.0)[[0, 7, -1]]
    wrong = np.zeros(len(measured.time_s))
    wrong[quiet] = -60.0
    run = spoiled(measured, **{f"top_{i}": measured.columns[f"top_{i}"] + wrong for i in range(1, 8)})
    sound = screened(PRESS, run, moments)
    read = [np.isfinite(measured.columns[f"top_{i}"][quiet]) for i in range(1, 8)]
    assert all(np.isnan(sound.run.columns[f"top_{i}"][quiet]).all() for i in range(1, 8))
    assert sound.dropped == np.sum(read)
    for every in (1, 2, 6):
        seldom = measured.at_rows(slice(None, None, every))
        assert screened(PRESS, seldom, moments_of(seldom, PRESS)).dropped == 0


@pytest.mark.parametrize("last", [118, 119])
def test_a_lone_channel_of_a_rig_loses_its_single_bad_cells_up_to_the_last_row(last):
    values = 20.0 + 0.5 * np.arange(120.0)
    values[[40, 41, last]] += 80.0
    run = Run("disc", {}, np.arange(120.0), {"bottom_1": values})
    sound = screened(read_press(LAB_PRESS.with_stem("pine_disc")), run, Moments(inserted_s=0.0))
    assert np.flatnonzero(np.isnan(sound.run.columns["bottom_1"])).tolist() == [40, 41, last]
    assert sound.dropped == 3


@pytest.mark.parametrize("begins_s", [30.0, 60.0])
def test_a_channel_that_leaves_its_face_along_a_line_drifts(measured, begins_s):
    drift = np.clip(measured.time_s - begins_s, 0.0, None) * 0.3
    assert found(spoiled(measured, bottom_3=measured.columns["bottom_3"] + drift)) == {
        "bottom_3": FaultKind.DRIFTING
    }


@pytest.mark.parametrize("every", [8, 40])
def test_fit_and_diagnosis_hear_the_same_channels_of_a_face_that_is_read_more_seldom(measured, every):
    read = np.arange(len(measured.time_s)) % every == 0
    seldom = {f"bottom_{i}": np.where(read, measured.columns[f"bottom_{i}"], np.nan) for i in range(1, 8)}
    run, moments = spoiled(measured, **seldom), moments_of(measured, PRESS)
    heard = {place.label: place.columns for place in collect_signals(PRESS, run, moments).places}
    assert digest_run(PRESS, run, moments).channels == heard
    assert ("panel.bottom" in heard) == (every == 8)


@pytest.mark.parametrize("fallen_K", [25.0, -40.0])
def test_of_two_channels_the_one_that_jumps_for_good_came_off(measured, fallen_K):
    names = ("platen_top", "platen_bottom", "top_1", "top_2", "bottom_1", "bottom_2")
    pair = replace(measured, columns={name: measured.columns[name].copy() for name in names})
    assert found(pair) == {}
    moments = moments_of(measured, PRESS)
    late = measured.time_s > 0.5 * (moments.closed_s + moments.opened_s)
    off = np.where(late, fallen_K, 0.0)
    assert found(spoiled(pair, top_2=pair.columns["top_2"] - off)) == {"top_2": FaultKind.LOOSE}
    once = np.where(np.arange(len(late)) == np.flatnonzero(late)[0], fallen_K, 0.0)
    assert found(spoiled(pair, top_2=pair.columns["top_2"] - once)) == {}
    assert found(spoiled(pair, top_1=pair.columns["top_1"] - off, top_2=pair.columns["top_2"] - off)) == {}


@pytest.mark.parametrize("column", ["top_2", "bottom_2"])
@pytest.mark.parametrize("every", [1, 5])
def test_a_sound_channel_that_jumps_with_its_panel_is_not_loose_beside_one_that_reads_the_room(
    measured, column, every
):
    """Which of the two is right nobody knows, and it is not the one that stays."""
    names = ("platen_top", "platen_bottom", "top_1", "top_2", "bottom_1", "bottom_2")
    noise = 0.1 * np.random.default_rng(6).normal(size=len(measured.time_s))
    off = replace(measured, columns={name: measured.columns[name] for name in names} | {column: 21.0 + noise})
    moments = moments_of(measured, PRESS)
    slow = off.at_rows(slice(0, None, every))
    assert [f.column for f in screened(PRESS, slow, moments).faults] == []
    silent = (off.time_s > moments.closed_s + 3.0) & (off.time_s < moments.closed_s + 25.0)
    assert [f.column for f in screened(PRESS, off.at_rows(~silent), moments).faults] == []


def test_normal_values_have_their_standard_deviation_by_their_median_too_and_wild_ones_do_not_count():
    values = 0.3 * np.random.default_rng(5).normal(size=(2, 20_001))
    values[:, :100], values[0, 100:200] = 1e6, np.nan
    assert robust_sd(values) == pytest.approx([0.3, 0.3], rel=0.03)
    assert np.isnan(robust_sd(np.full((1, 3), np.nan)))


def test_a_channel_faulty_in_half_of_the_runs_is_faulty_for_the_campaign_as_what_it_mostly_was():
    loose, drifting = (ChannelFault("top_1", kind, 3.0) for kind in (FaultKind.LOOSE, FaultKind.DRIFTING))
    once = ChannelFault("top_2", FaultKind.LOOSE, 3.0)
    assert recurring([(loose, once), (drifting,), (loose,), (), ()]) == {"top_1": FaultKind.LOOSE}
    assert recurring([(once,), ()]) == {"top_2": FaultKind.LOOSE}
    assert recurring([(once,), (), ()]) == {}  # once is no habit
    assert recurring([]) == {}
