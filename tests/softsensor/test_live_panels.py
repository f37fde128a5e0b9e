"""A thickness no earlier run of a press had: the header is right about a new panel, or wrong about a known one."""

from dataclasses import replace

import numpy as np
import pytest

from daq.simulated.campaign import make_campaign
from daq.words.message import words
from softsensor.fitting.constants import ConstantFit, with_constants_of
from softsensor.heat.model_file import PressedPanel
from softsensor.jobs.model_in_force import combined_model, with_pressed, with_stored_fits
from softsensor.live.directions import _unknown_in
from softsensor.live.panels import (
    ENTRY_ERROR,
    LEAST_CHANCE,
    MOST_OTHERS,
    likely_panels,
    mistaken_constants,
    panel_chances,
    panel_remark,
)
from softsensor.live.sensor import ScanSensor
from softsensor.live.validity import InvalidReason
from softsensor.signals.doubt import Origin, thickness_sd
from softsensor.signals.pressed import all_products, products
from tests.softsensor.test_live_trust import HELD, MODEL, PLAN, PRESS

KEY = "panel.thickness_mm"
KNOWN = (PressedPanel(16.0, 8),)


def with_thickness(run, thickness_mm):
    return replace(run, header={**run.header, KEY: thickness_mm})


@pytest.mark.parametrize("runs", [1, 8, 40])
def test_one_product_s_successor_is_new_as_laplace_says_and_the_header_wrong_as_often_as_people_are(runs):
    new, known = 1.0 / (runs + 1.0), runs / (runs + 1.0)
    right, wrong = (1.0 - ENTRY_ERROR) * new, ENTRY_ERROR * known
    header, other = panel_chances(12.0, (PressedPanel(16.0, runs),))
    assert header.chance == pytest.approx(right / (right + wrong), rel=1e-12)
    assert (header.thickness_mm, other.thickness_mm) == (12.0, 16.0)
    assert header.chance + other.chance == pytest.approx(1.0, abs=1e-12)


def test_products_share_what_is_wrong_by_their_runs_and_new_ones_are_likelier_where_there_were_many():
    header, thin, thick = panel_chances(12.0, (PressedPanel(16.0, 9), PressedPanel(19.0, 3)))
    assert thin.chance == pytest.approx(3.0 * thick.chance)
    assert header.chance == pytest.approx(
        2.0 * (1.0 - ENTRY_ERROR) / (2.0 * (1.0 - ENTRY_ERROR) + 12 * ENTRY_ERROR)
    )


def test_a_band_of_95_percent_always_holds_nine_tenths_of_what_the_header_says():
    header, other = panel_chances(12.0, (PressedPanel(16.0, 100_000),))
    assert header.chance == LEAST_CHANCE
    assert pytest.approx(1.0 - 0.9) == 0.025 / LEAST_CHANCE
    assert other.chance == 1.0 - LEAST_CHANCE


@pytest.mark.parametrize(("header_mm", "panels"), [(12.0, ()), (16.0, KNOWN), (16.3, KNOWN), (15.7, KNOWN)])
def test_a_header_is_believed_where_nothing_is_known_or_the_product_is(header_mm, panels):
    (only,) = panel_chances(header_mm, panels)
    assert (only.chance, only.thickness_mm) == (1.0, header_mm)


def test_many_products_are_a_few_panels_with_the_same_mean_and_variance():
    pressed = [
        PressedPanel(mm, runs) for mm, runs in ((6.0, 2), (8.0, 7), (10.0, 1), (16.0, 9), (19.0, 4), (38.0, 1))
    ]
    header, *others = panel_chances(12.0, pressed)
    assert len(others) == MOST_OTHERS
    share = np.array([o.chance for o in others]) / (1.0 - header.chance)
    runs = np.array([p.runs for p in pressed]) / 24.0
    mean = runs @ [p.thickness_mm for p in pressed]
    assert share @ [o.thickness_mm for o in others] == pytest.approx(mean)
    variance = runs @ [thickness_sd(p.thickness_mm) ** 2 + (p.thickness_mm - mean) ** 2 for p in pressed]
    assert share @ [o.sd_mm**2 + (o.thickness_mm - mean) ** 2 for o in others] == pytest.approx(variance)


def test_panels_within_the_norm_s_tolerance_are_one_product():
    found = products([16.05, 19.0, 15.9, 18.9, 16.1, 16.6])
    assert [(round(p.thickness_mm, 3), p.runs) for p in found] == [(16.017, 3), (16.6, 1), (18.95, 2)]
    assert all_products(KNOWN, (PressedPanel(16.1, 3), PressedPanel(10.0, 1))) == (PressedPanel(10.0, 1), *KNOWN)


def test_every_way_to_a_model_keeps_which_panels_there_were():
    fits = [{KEY: ConstantFit(mm, 0.1, Origin.DATA_SHEET, mm, 0.1)} for mm in (16.0, 16.0, 19.0)]
    wanted = (PressedPanel(16.0, 2), PressedPanel(19.0, 1))
    assert with_constants_of(MODEL, fits).panels == wanted
    stored = [{"coefficients": {}, "constants": {KEY: fit[KEY].as_json()}} for fit in fits]
    assert combined_model(PRESS, None, stored).panels == wanted
    assert combined_model(PRESS, replace(MODEL, panels=KNOWN), stored).panels == (*KNOWN, wanted[1])
    assert with_stored_fits(MODEL, stored).panels == wanted
    headers = [{KEY: 16.0}, {KEY: 12}, {}, {KEY: "sixteen"}, {KEY: 16.0}]
    assert with_pressed(MODEL, headers).panels == (PressedPanel(12.0, 1), PressedPanel(16.0, 2))


@pytest.fixture(scope="module")
def pressing():
    return make_campaign(501, 1, None, PLAN)[0]


def followed(run, truth, panels):
    """Return by how much the truth lies beyond each valid band [K], all estimates, and the last mixture."""
    sensor = ScanSensor(PRESS, run.header, replace(HELD, panels=panels))
    estimates = [
        sensor.update(t, {name: float(values[i]) for name, values in run.columns.items()})
        for i, t in enumerate(run.time_s.tolist())
    ]
    beyond = [
        max(e.core_low_C - c, c - e.core_high_C) for e, c in zip(estimates, truth.core_C, strict=True) if e.valid
    ]
    return np.array(beyond), estimates, sensor.mixture


@pytest.mark.parametrize("factor", [0.75, 1.5])
def test_a_band_holds_the_core_of_the_panel_that_lies_there_though_the_header_says_another(pressing, factor):
    run, truth = pressing
    lie = with_thickness(run, 16.0 * factor)
    sure_and_wrong, _, _ = followed(lie, truth, ())
    assert sure_and_wrong.max() > 10.0  # as a model that does not know which panels there were has it
    beyond, estimates, mixture = followed(lie, truth, KNOWN)
    assert beyond.max() < 0.5
    assert len(beyond) > 0.5 * len(run.time_s)
    assert {e.reason for e in estimates if not e.valid} <= {InvalidReason.ANOTHER_PANEL}
    assert sum(panel.chance for panel in mixture.panels) == pytest.approx(1.0)
    assert mixture.components.weight.sum() == pytest.approx(1.0)
    assert all(panel.low_C >= mixture.low_C - 40.0 for panel in mixture.panels)


def test_a_header_that_says_a_known_product_changes_nothing(pressing):
    run, truth = pressing
    _, before, _ = followed(run, truth, ())
    _, after, mixture = followed(run, truth, KNOWN)
    rows = [[(e.core_C, e.core_low_C, e.core_high_C, e.valid) for e in estimates] for estimates in (before, after)]
    assert np.array_equal(*rows, equal_nan=True)
    assert len(mixture.panels) == 1


def test_a_thickness_that_is_new_to_a_press_is_told_in_words():
    model = replace(HELD, panels=(*KNOWN, PressedPanel(25.0, 3)))
    remark = panel_remark({KEY: 12.0}, model)
    assert str(remark).startswith(
        "panel.thickness_mm = 12: no earlier run of this press had such a panel, the nearest"
    )
    assert "16" in str(remark)
    assert "keine frühere Pressung" in words(remark, "de")
    assert panel_remark({KEY: 16.0}, model) is None
    assert panel_remark({KEY: 12.0}, None) is None


# --- constants that are odd for their material -------------------------------------------------------

DENSITY = "panel.density_kg_m3"
BOARD = {"panel.material": "MDF", KEY: 16.0, "panel.initial_temperature_C": 21.0}


@pytest.mark.parametrize(("density", "beyond"), [(740.0 * 1.45, 0.0244489), (740.0 * 1.5, 0.0124193)])
def test_an_odd_density_is_mistaken_as_often_as_people_are_beside_how_rare_such_a_board_is(density, beyond):
    """Of a normal law 2.4 and 1.2 % lie beyond 2.25 and 2.5 deviations to either side."""
    chance, listed = mistaken_constants({**BOARD, DENSITY: density})
    right = (1.0 - ENTRY_ERROR) * beyond
    assert chance == pytest.approx(ENTRY_ERROR / (ENTRY_ERROR + right), rel=1e-4)
    assert listed == {DENSITY: 740.0, f"{DENSITY}.sd": 148.0}


def test_a_header_s_odd_number_is_never_held_less_likely_than_its_least():
    assert mistaken_constants({**BOARD, DENSITY: 740.0 * 1.6})[0] == 1.0 - LEAST_CHANCE


@pytest.mark.parametrize(
    "header",
    [
        {DENSITY: 1000.0},
        {DENSITY: 1110.0, f"{DENSITY}.sd": 10.0},
        {DENSITY: 370.0},
        {DENSITY: 1110.0, "panel.material": "slate"},
        {},
        {DENSITY: 1110.0, "panel.conductivity_W_mK": 0.3},
        {DENSITY: 0.0},
    ],
    ids=["usual", "stated", "too far to be followed", "no material of the table", "not given", "several", "none"],
)
def test_no_other_panel_lies_there_where_no_constant_is_odd_or_one_is_too_far_off_to_follow(header):
    assert mistaken_constants({**BOARD, **header}) == (0.0, {})


def test_a_new_thickness_and_an_odd_density_leave_three_panels_whose_chances_add_up(pressing):
    run, _ = pressing
    lie = replace(run, header={**run.header, KEY: 12.0, DENSITY: 1110.0})
    panels = likely_panels(PRESS, lie, replace(HELD, panels=KNOWN))
    assert [(p.thickness_mm, p.setup.run.header[DENSITY]) for p in panels] == [
        (12.0, 1110.0),
        (16.0, 1110.0),
        (12.0, 740.0),
    ]
    assert sum(p.chance for p in panels) == pytest.approx(1.0)
    mistaken, _ = mistaken_constants(lie.header)
    of_thickness = panel_chances(12.0, KNOWN)[1].chance
    assert panels[1].chance / panels[2].chance == pytest.approx((1.0 - mistaken) * of_thickness / mistaken)
    assert panels[0].chance >= LEAST_CHANCE  # though both its thickness and its density are in doubt


def test_several_odd_constants_are_each_doubted_by_as_much_as_they_are_off():
    """Any of them may be the mistaken one: a panel of the table's and one of the header's would not hold that."""
    both = {**BOARD, DENSITY: 1110.0, "panel.conductivity_W_mK": 0.3}
    assert set(_unknown_in(both)) == {"density_kg_m3", "conductivity_W_mK"}
    assert _unknown_in({**BOARD, DENSITY: 1110.0}) == {}


@pytest.mark.parametrize("seed", [501, 503])
def test_a_density_half_as_high_again_leaves_the_core_within_its_band(seed):
    """Until 2026-11-25 up to 1.4 K beyond it, in four scans of ten."""
    run, truth = make_campaign(seed, 1, None, PLAN)[0]
    lie = replace(run, header={**run.header, DENSITY: 1.5 * run.header[DENSITY]})
    beyond, estimates, _ = followed(lie, truth, KNOWN)
    assert beyond.max() < 0.2
    assert len(beyond) > 0.9 * len(run.time_s)
    assert {e.reason for e in estimates if not e.valid} <= {InvalidReason.BAND_TOO_WIDE}
