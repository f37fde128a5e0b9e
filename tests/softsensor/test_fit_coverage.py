"""Whether intervals hold what they promise: many virtual runs, every imperfection of a real chain."""

from dataclasses import replace

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from softsensor.fitting.problem import minimise
from softsensor.heat.model import ThermalModel
from softsensor.jobs.campaign import fit_runs
from tests.editions import edition
from tests.panels import panel_stated

PRESS = parse_press(press_toml())
MODEL = ThermalModel(PRESS)
MAIN = ("h_pp_c", "h_pp_o", "h_wa")
DEAD = ("top_2", "top_7", "bottom_1", "bottom_5")


def _fitted(seeds, runs, rate_hz, *, dead=(), stated=False, **nuisances):
    """Panels differ as they do, or all are alike and `stated` as measured to 1 %."""
    chain = replace(Nuisances.real_chain(), **nuisances)
    plan = Plan(rate_hz=rate_hz, nuisances=chain)
    plan = replace(plan, panel_spread=0.0) if stated else plan
    measured = [pair for seed in seeds for pair in make_campaign(seed, runs, plan=plan)]
    given = [replace(run, columns={n: c for n, c in run.columns.items() if n not in dead}) for run, _ in measured]
    given = [panel_stated(run, 0.01) for run in given] if stated else given
    return list(zip(fit_runs(MODEL, given), [t for _, t in measured], strict=True))


def _hits(pairs, names, *, identifiable=True):
    hits = []
    for fitted, truth in pairs:
        for name in names:
            c = fitted.coefficients[name]
            if c.identifiable == identifiable:
                hits.append(c.ci95[0] <= truth.coefficients[name] <= c.ci95[1])
    return hits


def _half_width(c):
    return np.log(c.ci95[1] / c.ci95[0]) / 2.0


@pytest.mark.campaign
@pytest.mark.parametrize(("rate_hz", "stated", "reach"), [(10.0, True, 0.3), (1.0, False, 0.5)])
def test_intervals_of_a_dozen_runs_cover_the_truth(rate_hz, stated, reach):
    pairs = _fitted(range(40, 44), 3, rate_hz, stated=stated)
    assert all(fitted.converged for fitted, _ in pairs)
    assert np.mean(_hits(pairs, PRESS.coefficient_names)) >= 0.88
    for fitted, _ in pairs:
        for name in MAIN:
            c = fitted.coefficients[name]
            assert c.identifiable
            assert c.ci95[1] / c.value < 1.0 + reach
            assert c.ci95[0] / c.value > 1.0 - reach


@pytest.mark.campaign
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    ("rate_hz", "chain"),
    edition(
        [(1.0, {}), (1.0, {"missing": 0.05, "dead": DEAD})],
        [
            (10.0, {}),
            (1.0, {}),
            (2.0, {}),
            (0.5, {}),
            (1.0, {"skew_s": 0.5}),
            (10.0, {"missing": 0.05, "dead": DEAD}),
            (1.0, {"missing": 0.05, "dead": DEAD}),
        ],
    ),
)
def test_intervals_cover_the_truth_in_ninety_to_ninety_nine_percent(rate_hz, chain):
    """240 runs each; one coefficient's share is known to 1.4 %, that of all to 0.6 %.

    In the small edition, 95 % intervals leave out 5 of 24 runs once in 170 times (binomial).
    """
    pairs = _fitted(range(800, edition(804, 840)), 6, rate_hz, **chain)
    print(f"\n{rate_hz:g} Hz {chain}: {len(pairs)} runs")
    for name in PRESS.coefficient_names:
        known = [f.coefficients[name] for f, _ in pairs if f.coefficients[name].identifiable]
        print(
            f"  {name:8s} covered {np.mean(_hits(pairs, [name])):.3f}, "
            f"identifiable in {len(known) / len(pairs):.2f}, "
            f"half interval {100 * np.median([_half_width(c) for c in known]):.1f} % (median), "
            f"{100 * max(_half_width(c) for c in known):.0f} % (widest)"
        )
    everything = np.mean(_hits(pairs, PRESS.coefficient_names))
    print(f"  all      covered {everything:.3f}; of the not identifiable {np.mean(_open_hits(pairs)):.3f}")
    assert np.mean([f.converged for f, _ in pairs]) >= 0.97
    assert 0.90 <= everything <= edition(1.0, 0.99)
    assert np.mean(_open_hits(pairs)) >= 0.90
    for name in PRESS.coefficient_names:
        assert np.mean(_hits(pairs, [name])) >= edition(20 / 24, 0.90), name
    for name in MAIN:
        assert np.mean([f.coefficients[name].identifiable for f, _ in pairs]) >= edition(23 / 24, 0.97)
        narrow = [_half_width(f.coefficients[name]) < np.log(1.3) for f, _ in pairs]
        assert np.mean(narrow) >= edition(23 / 24, 0.97), name


def _open_hits(pairs):
    return _hits(pairs, PRESS.coefficient_names, identifiable=False) or [True]


def _rise_at_limit(fitted, name, end):
    """The slow way: everything else fitted to the end with the coefficient held at a limit of the press file."""
    problem = fitted.problem
    i = problem.names.index(name)
    u = problem.unknowns[i]
    limit = u.lower if end == 0 else u.upper
    held = replace(u, lower=limit, upper=limit)
    other = replace(problem, unknowns=(*problem.unknowns[:i], held, *problem.unknowns[i + 1 :]))
    best = min(
        minimise(other, start, max_evaluations=80, decrease=1e-4).evaluation.loss
        for start in (fitted.minimum.x, problem.start)
    )
    return (best - fitted.minimum.evaluation.loss) / fitted.spread**2


@pytest.mark.campaign
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("rate_hz", edition([1.0], [10.0, 1.0]))
def test_profile_open_at_a_limit_is_called_so(rate_hz):
    """Runs whose record ends anywhere between insertion and a while after opening."""
    rng = np.random.default_rng(17)
    plan = Plan(rate_hz=rate_hz, nuisances=Nuisances.real_chain())
    measured = [pair for seed in range(900, edition(903, 910)) for pair in make_campaign(seed, 4, plan=plan)]
    runs = []
    for run, truth in measured:
        m = truth.moments
        keep = run.time_s <= rng.uniform(m.inserted_s + 5.0, m.opened_s + 5.0)
        runs.append(run.at_rows(keep))
    called, kept, covered = [], [], []
    for fitted, (_, truth) in zip(fit_runs(MODEL, runs), measured, strict=True):
        for name, c in fitted.coefficients.items():
            threshold = 0.5 * fitted.quantile**2
            if min(_rise_at_limit(fitted, name, end) for end in (0, 1)) < threshold:
                called.append(not c.identifiable)
                covered.append(c.ci95[0] <= truth.coefficients[name] <= c.ci95[1])
            else:
                kept.append(c.identifiable or c.ci95[1] / c.ci95[0] > 4.0)
    print(
        f"\n{rate_hz:g} Hz: {len(called)} open profiles, called so {np.mean(called):.3f}, truth inside "
        f"{np.mean(covered):.3f}; {len(kept)} closed ones, called so {np.mean(kept):.3f}"
    )
    assert len(called) > edition(15, 60)
    assert np.mean(called) >= 0.90
    assert np.mean(covered) >= 0.90
    assert np.mean(kept) >= 0.90
