"""What if: what is known of the run as it was stays; a later opening changes nothing before; water makes steam."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import softsensor
from daq.press.press_file import read_press
from daq.records import InputError
from softsensor.heat.model_file import FittedValue, ModelFile
from softsensor.planning.what_if import LiveCore, Pressed, what_if
from softsensor.signals.moments import moments_of
from softsensor.signals.unknown import BAND

DEPLOY = Path(__file__).parents[2] / "deploy"
LAB = read_press(DEPLOY / "presses" / "lab.toml")
MODEL = ModelFile("1", "lab", {"h_pp_c": FittedValue(700.0, 70.0)}, (), ("h_pp_c",), np.array([[0.01]]))


@pytest.fixture(scope="module")
def pressed() -> Pressed:
    run = softsensor.read_run(DEPLOY / "samples" / "2026-03-04-10.csv")
    run = replace(run, header={**run.header, "panel.moisture_percent": 8.0})
    return Pressed(run, LAB, MODEL, moments_of(run, LAB))


def test_as_it_was_the_core_is_what_the_live_sensor_told(pressed):
    at_s = pressed.moments.opened_s
    found = what_if(replace(pressed, live=LiveCore(at_s, 61.0, 1.5)))
    row = int(np.abs(found.run.time_s - at_s).argmin())
    middle_and_half = found.core.middle[row], found.core.high[row] - found.core.middle[row]
    assert middle_and_half == pytest.approx((61.0, BAND * 1.5), rel=1e-9)


def test_what_the_live_sensor_told_narrows_what_a_later_opening_would_have_brought(pressed):
    alone = what_if(pressed, {"press_time_s": 120.0})
    with_live = what_if(
        replace(pressed, live=LiveCore(pressed.moments.opened_s, 61.0, 1.5)), {"press_time_s": 120.0}
    )
    assert np.all(with_live.core.high - with_live.core.low < alone.core.high - alone.core.low + 1e-9)
    assert with_live.core.high[-1] - with_live.core.low[-1] < 0.7 * (alone.core.high[-1] - alone.core.low[-1])


def test_a_later_opening_changes_nothing_before_it_and_makes_the_core_hotter(pressed):
    was, later = what_if(pressed), what_if(pressed, {"press_time_s": 120.0})
    before = was.run.time_s[was.run.time_s < pressed.moments.opened_s - 2.0]
    at = np.interp(before, later.run.time_s, later.core.middle)
    assert np.abs(at - was.core.middle[: len(before)]).max() < 0.3  # a row is read half a second off
    assert later.core.middle[-1] > was.core.middle[-1] + 10.0


def test_more_water_makes_more_steam_and_no_other_core_where_the_model_knows_of_no_water(pressed):
    was, wetter = what_if(pressed), what_if(pressed, {"moisture_percent": 12.0})
    row = int(np.abs(was.run.time_s - pressed.moments.opened_s).argmin())
    assert wetter.steam.middle[row] > 1.2 * was.steam.middle[row]
    assert wetter.core.middle == pytest.approx(was.core.middle, abs=1e-9)
    assert np.isnan(was.cure.middle).all()  # nobody named a resin


def test_steam_of_a_run_whose_moisture_nobody_stated_is_not_known_as_it_was_not_live(pressed):
    header = {k: v for k, v in pressed.run.header.items() if k != "panel.moisture_percent"}
    found = what_if(replace(pressed, run=replace(pressed.run, header=header)))
    assert all(np.isnan(one).all() for one in (found.steam.middle, found.steam.low, found.steam.high))
    assert np.isfinite(found.core.middle).all()


@pytest.mark.parametrize("moisture", [0.0, 0.5, 200.0])
def test_what_may_be_asked_at_its_very_limit_is_answered(pressed, moisture):
    """Draws about it went beyond what a header may hold, and were refused in the user's name."""
    found = what_if(pressed, {"moisture_percent": moisture})
    assert np.isfinite(found.core.middle).all()
    assert np.isfinite(found.steam.high).all() == (moisture > 0.0)


def test_what_cannot_be_asked_is_refused_with_what_can(pressed):
    with pytest.raises(InputError, match=r"this run has no such setting; it has .*press_time_s.*moisture_percent"):
        what_if(pressed, {"colour": 1.0})
    with pytest.raises(InputError, match=r"press_time_s = 2 must lie between 5 and 3600"):
        what_if(pressed, {"press_time_s": 2.0})
    with pytest.raises(InputError, match=r"more than 1,?200 s is not simulated"):
        what_if(pressed, {"press_time_s": 2000.0})
