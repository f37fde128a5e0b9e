"""Whether intervals hold what they promise: many virtual runs, every imperfection of a real chain."""

from dataclasses import replace

import numpy as np
import pytest

from daq.pressfile import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.campaign import fit_runs
from softsensor.model import ThermalModel

PRESS = parse_press(press_toml())
MODEL = ThermalModel(PRESS)
MAIN = ("h_pp_c", "h_pp_o", "h_wa")


def _fitted(seeds, runs, rate_hz, **nuisances):
    chain = replace(Nuisances.real_chain(), **nuisances)
    plan = Plan(rate_hz=rate_hz, nuisances=chain)
    measured = [pair for seed in seeds for pair in make_campaign(seed, runs, plan=plan)]
    return list(zip(fit_runs(MODEL, [run for run, _ in measured]), [t for _, t in measured], strict=True))


def _covered(pairs, names):
    hits = []
    for fitted, truth in pairs:
        for name in names:
            c = fitted.coefficients[name]
            if c.identifiable:
                hits.append(c.ci95[0] <= truth.coefficients[name] <= c.ci95[1])
    return np.mean(hits)


@pytest.mark.parametrize("rate_hz", [10.0, 1.0])
def test_intervals_of_a_dozen_runs_cover_the_truth(rate_hz):
    pairs = _fitted(range(40, 44), 3, rate_hz)
    assert all(fitted.converged for fitted, _ in pairs)
    assert _covered(pairs, PRESS.coefficient_names) >= 0.88
    for fitted, _ in pairs:
        for name in MAIN:
            c = fitted.coefficients[name]
            assert c.identifiable
            assert c.ci95[1] / c.value < 1.3
            assert c.ci95[0] / c.value > 0.7


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("rate_hz", "nuisances"),
    [(10.0, {}), (2.0, {}), (1.0, {}), (0.5, {}), (1.0, {"skew_s": 0.5}), (2.0, {"missing": 0.05})],
)
def test_intervals_cover_the_truth_in_ninety_to_ninety_nine_percent(rate_hz, nuisances):
    pairs = _fitted(range(300, 320), 6, rate_hz, **nuisances)
    print(f"\n{rate_hz:g} Hz {nuisances}: {len(pairs)} runs")
    for name in PRESS.coefficient_names:
        known = np.mean([f.coefficients[name].identifiable for f, _ in pairs])
        print(f"  {name:8s} covered {_covered(pairs, [name]):.3f}, identifiable in {known:.2f}")
    assert np.mean([f.converged for f, _ in pairs]) >= 0.97
    assert 0.90 <= _covered(pairs, PRESS.coefficient_names) <= 0.995
    for name in MAIN:
        assert _covered(pairs, [name]) >= 0.88
        assert np.mean([f.coefficients[name].identifiable for f, _ in pairs]) >= 0.97
