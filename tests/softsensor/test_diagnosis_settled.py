"""What a cause is fitted as, once it is in the model: against the truth of a virtual press."""

from dataclasses import replace

import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign, press_toml
from softsensor.diagnosis.decision import ALPHA_PATTERN
from softsensor.diagnosis.settling import panels_as_usual, settle_base, with_whole_panels
from softsensor.heat.model import ThermalModel
from softsensor.signals.digest import screened_digest

PRESS = parse_press(press_toml())
SWITCHED = Plan(rate_hz=5.0, closed_column=True)


def settled(effect, runs):
    return settle_base(ThermalModel.of(PRESS, [effect]), [screened_digest(PRESS, run).digest for run in runs])


@pytest.mark.parametrize("seed", [52, 53])
def test_a_clock_that_is_far_off_is_fitted_as_far_though_it_has_moved_the_insertion_too(seed):
    stage = settled(
        "clock_offset", [run for run, _ in make_campaign(seed, 4, {"clock_offset": {"seconds": 0.7}}, SWITCHED)]
    )
    # a switch trips somewhere in a ramp of up to 1 s, and channels are scanned one after the other
    assert stage.fit.values["clock_offset.seconds"] == pytest.approx(0.7, abs=0.1)


def test_where_upper_and_lower_contact_scatter_by_themselves_panels_are_not_made_to_differ_for_it():
    ratios = (0.5, 0.6, 0.7, 0.65, 0.55)
    made = [
        make_campaign(62 + 10 * i, 1, {"contact_asymmetry": {"ratio": r}}, SWITCHED) for i, r in enumerate(ratios)
    ]
    stage = settled("contact_asymmetry", [replace(run, name=f"r{i}") for i, [(run, _)] in enumerate(made)])
    assert stage.fit.values["contact_asymmetry.ratio"] == pytest.approx(0.6, abs=0.03)
    as_given, alike = panels_as_usual(with_whole_panels(stage))
    assert min(as_given, alike) > ALPHA_PATTERN / 2
