"""Campaigns of run files from the virtual press."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.files.run_file import read_run
from daq.press.header import panel_of
from daq.press.press_file import parse_press, read_press
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign, write_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import CHANNELS, FACES, Nuisances
from daq.simulated.effects import OUTSIDE, SIZES, draw_effect, draw_outside
from daq.simulated.physics_pressing import Plates

LAB = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"
SEEDS = range(20, 26)


def test_the_same_seed_gives_the_same_runs() -> None:
    one, two = make_campaign(7, 2, "edge_loss"), make_campaign(7, 2, "edge_loss")
    for (run, truth), (same, same_truth) in zip(one, two, strict=True):
        assert run.header == same.header
        assert run.time_s.tobytes() == same.time_s.tobytes()
        assert all(run.columns[c].tobytes() == same.columns[c].tobytes() for c in run.columns)
        assert truth.run_effects == same_truth.run_effects
    other = make_campaign(8, 1)[0][0]
    assert other.header != one[0][0].header


def test_a_campaign_is_the_same_whether_made_longer_or_not() -> None:
    short, long = make_campaign(7, 1), make_campaign(7, 3)
    assert short[0][0].columns["top_3"].tobytes() == long[0][0].columns["top_3"].tobytes()


@pytest.mark.parametrize("name", [*SIZES, *OUTSIDE])
def test_what_is_hidden_stays_out_of_the_run_and_changes_it(name: str) -> None:
    plan = Plan(closed_column=True, press_time_s=(60.0, 90.0), nuisances=Nuisances.none(), start_before_s=5.0)
    (run, truth), (plain, _) = make_campaign(5, 1, name, plan)[0], make_campaign(5, 1, None, plan)[0]
    assert name in {**truth.effects, **truth.outside}
    text = " ".join([run.name, run.source, *map(str, run.header), *map(str, run.header.values()), *run.columns])
    assert name not in text
    assert run.header == plain.header
    assert run.time_s.tobytes() == plain.time_s.tobytes()
    change = max(float(np.abs(run.columns[c] - plain.columns[c]).max()) for c in CHANNELS)
    assert change > 0.5, "nothing to find"


@pytest.mark.parametrize("seed", SEEDS)
def test_runs_stay_in_the_ranges_of_the_laboratory(seed: int) -> None:
    for run, truth in make_campaign(seed, 3):
        m, t = truth.moments, run.time_s
        assert t[0] == 0.0
        assert np.all(np.diff(t) > 0)
        assert 18.0 <= m.opened_s - m.closed_s <= 120.0
        assert 5.0 <= m.closed_s - m.inserted_s <= 30.0
        assert 29.0 <= t[-1] - m.opened_s <= 120.5
        assert 0.2 <= m.ramp_s <= 1.0
        assert 0.0 <= m.inserted_s <= 20.0
        assert 280.0 <= run.header["setting.pressure_N_cm2"] <= 400.0
        assert 180.0 <= run.header["setting.platen_temperature_C"] <= 210.0
        assert run.header["panel.thickness_mm"] in (8.0, 16.0, 19.0)
        panel = panel_of(run)
        assert panel.initial_temperature == pytest.approx(truth.panel.initial_temperature, abs=0.5)
        for nominal, own in zip(
            (panel.conductivity, panel.heat_capacity),
            (truth.panel.conductivity, truth.panel.heat_capacity),
            strict=True,
        ):  # panels scatter, and headers do not tell
            assert 0.0 < abs(np.log(own / nominal)) < 4.0 * Plan().panel_spread
        for name in CHANNELS:
            good = run.columns[name][np.isfinite(run.columns[name])]
            assert 15.0 < good.min() <= good.max() < 216.0
            assert good.size > 0.9 * t.size
            assert np.abs(good * 10 - np.round(good * 10)).max() < 1e-6
        assert len(truth.core_C) == len(t)
        assert set(run.columns) <= {*CHANNELS, "closed"}


def test_readings_are_the_truth_plus_offset_and_noise_of_the_stated_size() -> None:
    plan = Plan(nuisances=Nuisances(loose_chance=0.0, burst_chance=0.0), rate_hz=5.0)
    offsets, residuals = [], []
    for run, truth in make_campaign(3, 8, None, plan):
        for face, names in FACES.items():
            true = truth.top_C if face == "top" else truth.bottom_C
            calm = run.time_s > truth.moments.opened_s + 20.0
            for name in names:
                difference = (run.columns[name] - true)[calm]
                offsets.append(np.nanmean(difference))
                residuals.append(np.nanstd(difference))
    assert 0.2 < np.std(offsets) < 0.45
    assert 0.1 < np.median(residuals) < 0.35


def test_coefficients_scatter_from_run_to_run_as_planned() -> None:
    plan = Plan(coefficient_spread=0.2, rate_hz=1.0)
    logs = np.array(
        [[np.log(v) for v in truth.coefficients.values()] for _, truth in make_campaign(1, 40, None, plan)]
    )
    assert logs.std(axis=0) == pytest.approx(np.full(6, 0.2), abs=0.08)
    assert np.exp(logs.mean(axis=0)) == pytest.approx(list(plan.coefficients.values()), rel=0.15)


def test_causes_in_the_panel_differ_from_run_to_run_and_others_do_not() -> None:
    plan = Plan(rate_hz=1.0)
    steam = [
        t.run_effects["vapour_convection"]["W_m3K"] for _, t in make_campaign(4, 30, "vapour_convection", plan)
    ]
    assert 0.15 < np.std(steam) / np.mean(steam) < 0.35
    edge = [t.run_effects["edge_loss"]["W_m3K"] for _, t in make_campaign(4, 3, "edge_loss", plan)]
    assert len(set(edge)) == 1


def test_sizes_can_be_given_and_mixed_with_faults_outside_the_catalogue() -> None:
    given = {"thermocouple_lag": {"time_constant_s": 0.7}, "draught": {"factor": 3.0, "after_s": 6.0}}
    _, truth = make_campaign(2, 1, given)[0]
    assert truth.effects == {"thermocouple_lag": {"time_constant_s": 0.7}}
    assert truth.outside == {"draught": {"factor": 3.0, "after_s": 6.0}}
    _, truth = make_campaign(2, 1, ("resin_cure", "edge_loss"))[0]
    assert set(truth.effects) == {"resin_cure", "edge_loss"}


def test_an_unknown_effect_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(InputError, match="'ghost': unknown; known are moisture_evaporation"):
        make_campaign(1, 1, "ghost")


def test_sizes_are_those_at_which_a_cause_must_be_named_and_half_of_them_on_request() -> None:
    rng = np.random.default_rng(0)
    for name, limits in SIZES.items():
        for _ in range(20):
            drawn, half = draw_effect(name, rng), draw_effect(name, rng, 0.5)
            assert set(drawn) == set(half) == set(limits)
            if name.endswith("_offset") and "ratio" in drawn:
                assert 0.1 <= abs(drawn["ratio"] - 1.0) <= 0.2
                assert abs(half["ratio"] - 1.0) <= 0.1
            elif name not in ("contact_asymmetry", "platen_offset"):
                for key, (low, high) in limits.items():
                    assert low <= drawn[key] <= high
    for name in OUTSIDE:
        assert draw_outside(name, rng)


def test_a_hidden_clock_offset_shows_the_panel_late_and_brings_the_limit_switch() -> None:
    plan = Plan(nuisances=Nuisances.none(), rate_hz=10.0, closed_column=False)
    run, truth = make_campaign(9, 1, {"clock_offset": {"seconds": 0.4}}, plan)[0]
    plain, _ = make_campaign(9, 1, None, plan)[0]
    t = plain.time_s
    later = np.interp(t - 0.4, t, plain.columns["top_1"])
    after = (t > truth.moments.closed_s + 3.0) & (t < truth.moments.opened_s - 1.0)
    assert np.abs(run.columns["top_1"] - later)[after].max() < 0.05
    closed = run.columns["closed"]
    first = t[np.argmax(closed > 0)]
    assert 0.0 <= first - truth.moments.closed_s <= 0.12
    assert "closed" not in plain.columns


def test_a_platen_offset_is_true_minus_reading() -> None:
    plan = Plan(nuisances=Nuisances.none())
    run, truth = make_campaign(9, 1, {"platen_offset": {"top_K": 3.0, "bottom_K": -2.0}}, plan)[0]
    assert truth.pressing.platen_top.at(run.time_s) - run.columns["platen_top"] == pytest.approx(3.0)
    assert truth.pressing.platen_bottom.at(run.time_s) - run.columns["platen_bottom"] == pytest.approx(-2.0)


def test_a_hidden_sensor_fault_hits_the_same_channel_in_every_run() -> None:
    for seed in range(12):
        campaign = make_campaign(seed, 2, "sensor_fault", Plan(nuisances=Nuisances.none(), rate_hz=1.0))
        plain = make_campaign(seed, 2, None, Plan(nuisances=Nuisances.none(), rate_hz=1.0))
        for (run, truth), (good, _) in zip(campaign, plain, strict=True):
            fault = truth.faults[0]
            assert truth.faults == campaign[0][1].faults
            wrong = {c for c in CHANNELS if np.abs(run.columns[c] - good.columns[c]).max() > 0.5}
            assert wrong == {fault.column, *filter(None, [fault.partner])}


def test_rim_sensors_differ_from_the_centre_only_where_asked_for() -> None:
    size = {"edge_loss": {"W_m3K": 1500.0}}
    base = Plan(nuisances=Nuisances.none(), press_time_s=(80.0, 100.0))
    even, _ = make_campaign(6, 1, size, base)[0]
    rim = Plan(nuisances=Nuisances.none(), press_time_s=(80.0, 100.0), rim_contrast=1.0)
    uneven, _ = make_campaign(6, 1, size, rim)[0]
    assert np.abs(even.columns["top_1"] - even.columns["top_7"]).max() < 1e-9
    assert (uneven.columns["top_1"] - uneven.columns["top_7"])[-1] > 1.0


def test_second_laws_of_steam_and_drying_differ_but_not_wildly() -> None:
    for name in ("vapour_convection", "moisture_evaporation"):
        size = {name: draw_effect(name, np.random.default_rng(1))}
        quiet = Nuisances.none()
        one = make_campaign(6, 1, size, Plan(nuisances=quiet, press_time_s=(60.0, 90.0)))[0][1]
        two = make_campaign(6, 1, size, Plan(nuisances=quiet, press_time_s=(60.0, 90.0), other_laws=True))[0][1]
        plain = make_campaign(6, 1, None, Plan(nuisances=quiet, press_time_s=(60.0, 90.0)))[0][1]
        effect = np.abs(one.core_C - plain.core_C).max()
        assert 0.01 < np.abs(one.core_C - two.core_C).max() < 0.7 * effect


def test_the_press_file_is_the_laboratorys() -> None:
    assert parse_press(press_toml()) == read_press(LAB)
    places = parse_press(press_toml(positions=True)).sensor[0].position_mm
    assert places is not None
    assert len(places) == 7


def test_another_press_has_its_own_plates_in_file_and_physics(tmp_path: Path) -> None:
    plates = Plates(thickness=0.015, conductivity=160.0, density=2700.0, heat_capacity=900.0)
    quiet = Plan(nuisances=Nuisances.none(), plates=plates, start_before_s=0.0)
    campaign = make_campaign(3, 1, None, quiet)
    write_campaign(tmp_path, campaign)
    layers = {layer.name: layer for layer in read_press(tmp_path / "press.toml").layer}
    assert layers["plate_top"].thickness_mm == 15.0
    assert layers["plate_bottom"].conductivity_W_mK == 160.0
    usual = make_campaign(3, 1, None, Plan(nuisances=Nuisances.none(), start_before_s=0.0))[0][0]
    assert np.abs(campaign[0][0].columns["top_1"] - usual.columns["top_1"]).max() > 1.0


def test_coefficients_may_follow_the_platens_set_point() -> None:
    plan = Plan(coefficient_spread=0.0, trends_per_K={"h_pp_c": 0.01}, rate_hz=1.0)
    for run, truth in make_campaign(12, 5, None, plan):
        expected = 700.0 * np.exp(0.01 * (run.header["setting.platen_temperature_C"] - 195.0))
        assert truth.coefficients["h_pp_c"] == pytest.approx(expected)


def test_rows_may_be_missing_altogether() -> None:
    plan = Plan(nuisances=replace(Nuisances(), gap_chance=1.0), rate_hz=10.0)
    run, truth = make_campaign(12, 1, None, plan)[0]
    assert 1.0 <= np.diff(run.time_s).max() <= 10.2
    assert len(truth.core_C) == len(run.time_s)


def test_written_campaigns_are_read_back_as_they_were(tmp_path: Path) -> None:
    campaign = make_campaign(3, 2, "draught", Plan(core_column=1.0, rate_hz=1.0))
    paths = write_campaign(tmp_path, campaign)
    read_press(tmp_path / "press.toml")
    for path, (run, _) in zip(paths, campaign, strict=True):
        back = read_run(path)
        assert back.header == run.header
        assert back.name == run.name
        for name, values in run.columns.items():
            assert np.array_equal(back.columns[name], values, equal_nan=True)
        assert "draught" not in path.read_text(encoding="utf-8")
