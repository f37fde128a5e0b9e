"""What an update of the live sensor costs, counted and not timed: the same on a busy machine."""

from dataclasses import astuple, replace

import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.physics_pressing import BASE_COEFFICIENTS
from softsensor.heat.model_file import FittedValue, ModelFile
from softsensor.live import kalman, passes, sensor

PRESS = parse_press(press_toml())
MODEL = ModelFile("counted", "lab", {n: FittedValue(v, 0.2 * v) for n, v in BASE_COEFFICIENTS.items()})
PLAN = Plan(rate_hz=2.0, thickness_mm=16.0, closed_column=False)
COUNTED = {10.0: 146.1, 2.0: 298.1}
"""By scans a second: tangents carried over a block of scans, for each scan of a pressing. Counted 2026-11-27 (seed
92, as `benchmarks/test_live_sensor.py`); 207.6 and 510.1 when all filters went through the scans together."""
SLACK = 1.1
"""What changes an answer changes how often a filter is linearised anew: single bad cells left out did by 4 %."""


def pressing(rate=2.0, seed=92, cause=None):
    ((run, _),) = make_campaign(seed, 1, cause, replace(PLAN, rate_hz=rate))
    return run


def replayed(run):
    live = sensor.ScanSensor(PRESS, run.header, MODEL)
    names = [name for name in run.columns if not name.startswith("core")]
    rows = zip(*(run.columns[name].tolist() for name in names), strict=True)
    return [
        live.update(t, dict(zip(names, row, strict=True)))
        for t, row in zip(run.time_s.tolist(), rows, strict=True)
    ]


@pytest.mark.parametrize("rate", COUNTED)
def test_an_update_carries_no_more_tangents_than_it_did(rate, monkeypatch):
    """More filters, more parameters, or more rounds over the stored scans: whoever adds them sees it here."""
    carried, run = [], pressing(rate)
    for one in (kalman.KalmanFilter, kalman.BetweenFaces):

        def take(self, blocks, whole=one.take):
            carried.append(len(blocks.quiet) * len(self.linearised.model.state.s))
            whole(self, blocks)

        monkeypatch.setattr(one, "take", take)
    replayed(run)
    assert sum(carried) / len(run.time_s) < SLACK * COUNTED[rate]


def test_a_filter_that_stays_linearised_where_it_was_answers_as_if_gone_through_again(monkeypatch):
    runs = [pressing(seed=seed, cause=cause) for seed, cause in ((92, None), (94, "vapour_convection"))]
    whole, stayed = passes.Pass.linearised_at, []

    def linearised_at(self, better):
        stayed.extend(point is None for point in better)
        return whole(self, better)

    monkeypatch.setattr(passes.Pass, "linearised_at", linearised_at)
    found = [replayed(run) for run in runs]
    assert any(stayed)
    monkeypatch.setattr(passes.Pass, "linearised_at", lambda _self, _better: None)
    for run, estimates in zip(runs, found, strict=True):
        for one, other in zip(estimates, replayed(run), strict=True):
            assert repr(astuple(one)) == repr(astuple(other))
