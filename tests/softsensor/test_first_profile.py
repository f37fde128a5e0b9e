"""The start of a stack that lay at rest between its first readings."""

import numpy as np
import pytest

from daq.records import Moments
from softsensor.heat.first_profile import gap_priors
from softsensor.signals.digest import digest_run

NEVER = Moments(closed_s=0.0)
HOT, COLD = 120.0, 40.0
LENGTH, K, H = 0.010, 12.0, 900.0
BARS = """
[[layer]]
name = "hot"
thickness_mm = 10.0
conductivity_W_mK = 12.0
density_kg_m3 = 8000.0
heat_capacity_J_kgK = 400.0
[[layer]]
name = "cool"
thickness_mm = 10.0
conductivity_W_mK = 12.0
density_kg_m3 = 8000.0
heat_capacity_J_kgK = 400.0
[[contact]]
between = ["hot", "cool"]
closed = "h"
[coefficients.h]
guess = 900.0
lower = 10.0
upper = 50000.0
[initial]
kind = "sensors"
"""
ENDS = '[boundary.bottom]\nkind = "measured"\ncolumn = "a"\n[boundary.top]\nkind = "measured"\ncolumn = "b"\n'
PLACES = {"low": '"hot.top"', "high": '"cool.bottom"', "deep": '{ layer = "cool", depth_mm = 4.0 }'}


def bars(make_rig, toml=BARS + ENDS, first=None):
    """Two bars with a contact between their measured ends; `first` holds further first readings."""
    model, run = make_rig(toml, np.arange(0.0, 10.0, 1.0), {"a": HOT, "b": COLD}, PLACES)
    for column, value in (first or {}).items():
        run.columns[column][0] = value
    return model, model.prepare(run, NEVER)


def at_rest(model, case, values, names=()):
    """Return the start at rest."""
    return model.build(case, values, names).begun_at_rest(case).start


def read(case, start, column):
    return float(case.places[case.place_of[column]] @ start.t)


def test_two_bars_at_rest_have_the_steady_profile_and_its_jump_at_the_contact(make_rig):
    model, case = bars(make_rig)
    flux = (HOT - COLD) / (2 * LENGTH / K + 1 / H)
    start = at_rest(model, case, {"h": H}, ["h"])
    wanted = {"low": HOT - flux * LENGTH / K, "high": COLD + flux * LENGTH / K, "deep": COLD + flux * 0.006 / K}
    d_flux = flux**2 / (HOT - COLD) / H**2
    by_h = {"low": -d_flux * LENGTH / K, "high": d_flux * LENGTH / K, "deep": d_flux * 0.006 / K}
    for column, value in wanted.items():
        assert read(case, start, column) == pytest.approx(value, abs=1e-9)
        derivative = case.places[case.place_of[column]] @ start.s[0]
        assert derivative == pytest.approx(by_h[column], rel=1e-9)


def test_the_start_of_a_fit_says_nothing_about_contacts(make_rig):
    model, case = bars(make_rig)
    solution = model.solve(case, {"h": H}, ["h"])
    assert not solution.d_sensors["h"][0].any()
    assert solution.column("deep")[0] == pytest.approx(COLD + (HOT - COLD) * 0.3)


def test_a_reading_inside_holds_and_the_rest_follows_the_resistance_on_either_side(make_rig):
    model, case = bars(make_rig, first={"deep": 50.0})
    start = at_rest(model, case, {"h": H})
    below = (HOT - 50.0) / (LENGTH / K + 1 / H + 0.004 / K)
    assert read(case, start, "low") == pytest.approx(HOT - below * LENGTH / K, abs=1e-9)
    assert read(case, start, "high") == pytest.approx(50.0 + below * 0.004 / K, abs=1e-9)
    assert read(case, start, "deep") == pytest.approx(50.0, abs=0.05), "a kink, read off by a parabola"


def test_a_start_at_rest_knows_tables_in_temperature_and_its_derivatives_equal_differences(make_rig):
    table = "[[0.0, 8.0], [200.0, 20.0]]"
    model, case = bars(make_rig, (BARS + ENDS).replace("= 12.0", f"= {table}"))
    steps = {"h": 0.1, "boundary_top_K": 1e-3, "start_0_K": 1e-3}
    at = {"h": H, "boundary_top_K": 0.4, "start_0_K": -3.0}
    start = at_rest(model, case, at, tuple(steps))
    for i, (name, step) in enumerate(steps.items()):
        up, down = (at_rest(model, case, at | {name: at[name] + x}).t for x in (step, -step))
        rise = (up - down) / (2 * step)
        assert np.abs(rise).max() > 1e-3
        assert np.abs(start.s[i] - rise).max() < 1e-6
    kirchhoff = (
        8.0 * (t := at_rest(model, case, {"h": H}).t) + 0.03 * t**2
    )  # the integral of k, straight in height
    x, inner = case.mesh.centres("hot"), case.mesh.cells("hot")
    straight = np.polyval(np.polyfit(x, kirchhoff[inner], 1), x)
    assert np.abs(kirchhoff[inner] - straight).max() < 1e-3 * np.ptp(kirchhoff[inner])


def test_the_start_may_be_off_in_every_gap_even_where_both_ends_alone_are_read(make_rig):
    _, case = bars(make_rig)
    assert gap_priors(case.press, case.run, None) == pytest.approx({"start_0_K": (HOT - COLD) / np.sqrt(12.0)})
    _, case = bars(make_rig, first={"deep": 50.0})
    wanted = {"start_0_K": (HOT - 50.0) / np.sqrt(12.0), "start_1_K": (50.0 - COLD) / np.sqrt(12.0)}
    assert gap_priors(case.press, case.run, None) == pytest.approx(wanted)


def test_bodies_whose_contact_is_open_start_as_their_own_readings_say(make_rig):
    toml = BARS.replace('closed = "h"', 'open = ["h_air", "h_air"]\nclosed = "h"') + ENDS
    model, run = make_rig(toml, np.arange(0.0, 10.0, 1.0), {"a": HOT, "b": COLD}, PLACES)
    case = model.prepare(run, Moments(inserted_s=-5.0, closed_s=5.0))
    start = at_rest(model, case, {"h": H, "h_air": 10.0}).t
    assert start[case.mesh.cells("hot")] == pytest.approx(HOT, abs=1e-3)
    assert start[case.mesh.cells("cool")] == pytest.approx(COLD, abs=1e-3)


def test_a_reading_for_validation_alone_does_not_shape_the_start(make_rig):
    toml = BARS + ENDS + '[[sensor]]\ncolumns = ["core_1"]\nat = "hot.middle"\nrole = "validation"\n'
    model, run = make_rig(toml, np.arange(0.0, 10.0, 1.0), {"a": HOT, "b": COLD}, PLACES)
    plain = model.build(model.prepare(run, NEVER), {"h": H}).start.t
    run.columns["core_1"] = np.full(10, 300.0)
    assert np.array_equal(model.build(model.prepare(run, NEVER), {"h": H}).start.t, plain)


def test_a_digest_starts_as_its_run_does(make_rig):
    model, run = make_rig(BARS + ENDS, np.arange(0.0, 40.0, 1.0), {"a": HOT, "b": COLD}, {"deep": PLACES["deep"]})
    run.columns["deep"][:] = 70.0
    case, digest = model.prepare(run, NEVER), digest_run(model.press, run, NEVER)
    own = model.build(digest.cases[False], {"h": H}).start.t
    assert read(case, model.build(case, {"h": H}).start, "deep") == pytest.approx(70.0, abs=0.5)
    assert own == pytest.approx(model.build(case, {"h": H}).start.t, abs=1e-9)
