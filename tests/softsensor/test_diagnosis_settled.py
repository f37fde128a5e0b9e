"""What a cause is fitted as, once it is in the model: against the truth of a virtual press."""

from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign, press_toml
from softsensor.diagnosis.decision import ALPHA_PATTERN, beyond_noise
from softsensor.diagnosis.numbers import noise_floor, place_noise
from softsensor.diagnosis.settling import panels_as_usual, settle_base, with_whole_panels
from softsensor.diagnosis.unseen import stage_errors
from softsensor.heat.model import ThermalModel
from softsensor.signals.digest import screened_digest
from softsensor.signals.moments import moments_seen

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


def test_a_run_with_a_scan_within_the_ramp_of_closing_is_louder_than_the_others_and_no_worse_described():
    runs = [run for run, _ in make_campaign(41, 4, None, Plan(rate_hz=1.0))]
    shut = int(np.searchsorted(runs[2].time_s, moments_seen(runs[2], PRESS).closed_s))
    apart = np.linspace(-30.0, 30.0, 7)  # scanned one after the other while the face rises
    late = {f"{face}_{i + 1}": apart[i] for face in ("top", "bottom") for i in range(7)}
    row = np.arange(len(runs[2].time_s)) == shut
    runs[2] = replace(runs[2], columns={c: v + late.get(c, 0.0) * row for c, v in runs[2].columns.items()})
    stage = settle_base(ThermalModel(PRESS), [screened_digest(PRESS, run).digest for run in runs])
    scatter = np.array([place_noise(d.digest) for d in stage.data])
    assert scatter[2] > 2.0 * np.delete(scatter, 2).max()
    weighed = stage_errors([stage], [])[0].weighed
    assert beyond_noise(weighed / noise_floor([stage])) == ()
    assert weighed[2] < 1.1 * np.median(weighed)
