"""A contact whose load is measured: the live sensor follows it scan by scan."""

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.records import Run
from softsensor.effects.contact_load import LEAST_LOAD
from softsensor.heat.model_file import FittedValue, MissingCause, MissingCauses, ModelFile
from softsensor.live.contact_loads import HeldLoads
from softsensor.live.priors import nuisance_priors, plans_for
from softsensor.live.replay import replay
from softsensor.live.setup import linearise, set_up

HOT, COLD, REFERENCE, EXPONENT = 180.0, 30.0, 150.0, 0.9
PLATE_R, PANEL_R, H_B, H_C, H_T = 0.005 / 45.0, 0.004 / 0.12, 1000.0, 50.0, 100.0
BENCH = """
[[layer]]
name = "plate"
thickness_mm = 5.0
conductivity_W_mK = 45.0
density_kg_m3 = 7850.0
heat_capacity_J_kgK = 490.0
[[layer]]
name = "panel"
from_run = true
[boundary.bottom]
kind = "measured"
column = "hot"
[boundary.top]
kind = "measured"
column = "cold"
[[contact]]
between = ["boundary.bottom", "plate"]
closed = "h_b"
[[contact]]
between = ["plate", "panel"]
closed = "h_c"
load = { column = "load", law = "power", reference = 150.0 }
[[contact]]
between = ["panel", "boundary.top"]
closed = "h_t"
[initial]
kind = "uniform"
"""
PRESS = parse_press(BENCH)
HEADER = {
    "panel.material": "MDF",
    "panel.thickness_mm": 4.0,
    "panel.density_kg_m3": 740.0,
    "panel.conductivity_W_mK": 0.12,
    "panel.heat_capacity_J_kgK": 1500.0,
    "panel.initial_temperature_C": 30.0,
}


def bench(load, **columns):
    """A run of the bench, a second a row, whose load is given row by row."""
    n = len(load)
    measured = {"hot": np.full(n, HOT), "cold": np.full(n, COLD), "load": np.asarray(load, float)}
    return Run("bench", HEADER, np.arange(n, dtype=float), measured | columns)


def model_file(**effect):
    known = {"h_b": H_B, "h_c": H_C, "h_t": H_T}
    table = {name: FittedValue(value, 0.01 * value) for name, value in known.items()}
    exponent = (("contact_load", {"exponent": FittedValue(effect["exponent"], 0.01)}),) if effect else ()
    return ModelFile("bench", "bench", table, exponent)


def steady_core(share):
    """The panel's middle in a stack of resistances in series. [°C]"""
    contact = 1.0 / (H_C * share**EXPONENT)
    upper = 0.5 * PANEL_R + 1.0 / H_T
    return COLD + (HOT - COLD) * upper / (1.0 / H_B + PLATE_R + contact + PANEL_R + 1.0 / H_T)


def cores(run, model):
    return np.array([e.core_C for e in replay(PRESS, run, model).estimates])


def test_the_core_goes_to_where_each_load_leads_by_the_series_of_resistances():
    shares = (0.1, 2.0, 0.4)
    load = REFERENCE * np.repeat(shares, 800)
    core = cores(bench(load), model_file(exponent=EXPONENT))
    for k, share in enumerate(shares):
        assert core[800 * (k + 1) - 1] == pytest.approx(steady_core(share), abs=0.15)


def test_a_load_to_come_changes_nothing_said_before():
    load = np.full(240, 60.0)
    later = np.where(np.arange(240) < 200, load, 900.0)
    one, other = (cores(bench(x), model_file(exponent=EXPONENT)) for x in (load, later))
    assert one[:200].tolist() == other[:200].tolist()
    assert other[-1] > one[-1] + 1.0


def test_a_load_that_is_missing_is_held_and_none_presses_with_a_hundredth():
    held = HeldLoads(PRESS)
    assert held.logs == (0.0, 0.0, 0.0)
    for load, share in ((300.0, 2.0), (float("nan"), 2.0), (0.0, LEAST_LOAD), (-5.0, LEAST_LOAD), (75.0, 0.5)):
        held.note({"load": load})
        assert held.logs == pytest.approx((0.0, np.log(share), 0.0))
    held.note({})
    assert held.logs[1] == pytest.approx(np.log(0.5))


def test_without_a_reference_no_single_scan_tells_the_share_of_it():
    bare = parse_press(BENCH.replace(", reference = 150.0", ""))
    assert HeldLoads(bare).logs == ()
    assert all(p.name != "contact_load.exponent" for p in nuisance_priors(bare, set(), 0.3))


def test_what_the_load_does_is_in_doubt_until_runs_have_shown_it():
    (before,) = (p for p in nuisance_priors(PRESS, set(), 0.3) if p.name == "contact_load.exponent")
    assert before.centre == 0.0
    assert before.sd == pytest.approx(0.95 / np.sqrt(3.0), rel=0.01)

    cause = MissingCause(0.8, 0.5, {"exponent": FittedValue(0.4, 0.05)}, {"h_c": 0.3})
    seen = MissingCauses(6, 0.2, 0.0, {"contact_load": cause})
    (known,) = (p for p in nuisance_priors(PRESS, set(), 0.3, seen) if p.name == "contact_load.exponent")
    draws = np.where(np.arange(10) < 8, 0.4, 0.0)
    assert known.centre == pytest.approx(draws.mean())
    assert known.sd == pytest.approx(np.hypot(draws.std(), np.sqrt(0.8) * 0.05), rel=0.02)
    assert all(p.name != "contact_load.exponent" for p in nuisance_priors(PRESS, {"contact_load"}, 0.3))


def test_a_contact_s_factor_answers_to_load_and_exponent_as_the_power_law_says():
    """h = h_ref (p / p_ref)^n: its logarithm is n ln(p / p_ref), the derivative of that by n is ln(p / p_ref)."""
    model = model_file(exponent=EXPONENT)
    setup = set_up(PRESS, bench([60.0, 60.0]), model)
    plan = plans_for(PRESS, model, (0.0, 0.0, 0.0), unowned=[d.prior for d in setup.directions])[0]
    at = plan.start + np.linspace(-0.5, 0.5, len(plan.start))
    made = linearise(setup, plan, at)
    table, own = made.model.factors.by_load, made.names.index("contact_load.exponent")
    over = table.loads - np.log(60.0 / REFERENCE)  # the first scan's load is in the other factor
    prior = plan.priors[own]
    assert table.log[:, 1] == pytest.approx((prior.centre + prior.sd * at[own]) * over)
    assert table.d_log[:, 1, own] == pytest.approx(prior.sd * over)
    assert not table.log[:, [0, 2]].any()
    assert np.abs(np.delete(table.d_log, own, axis=2)).max() < 1e-12
