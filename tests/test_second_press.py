"""The second virtual press against closed forms and conservation laws, before anything is judged by it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.second_press import LATENT, PANEL, SIZES, USUAL, Campaign, Layer, Program, World, campaign, course

PLATEN_C = 200.0
THICKNESS, K, C = 0.016, 0.12, 1.15e6


def world(**changed) -> World:
    steel = Layer.of(0.01, 45.0, 3.8e6, 16)
    return World((steel, Layer.of(THICKNESS, K, C, 60), steel), **changed)


def program(**changed) -> Program:
    usual = Program(5.0, 15.0, 75.0, 120.0, lambda _: PLATEN_C, lambda _: PLATEN_C)
    return replace(usual, **changed)


def test_a_panel_between_two_massive_plates_warms_as_fouriers_series_says():
    ideal = Layer.of(0.01, 1e5, 1e9, 8)
    h = 500.0
    held = World((ideal, Layer.of(THICKNESS, K, C, 60), ideal), {**USUAL, "h_p_c": 1e6, "h_p_o": 1e6, "h_pp_c": h})
    found = course(held, program(inserted=0.0, closed=-5.0, opened=300.0, end=200.0))
    half, start = 0.5 * THICKNESS, held.start
    biot = h * half / K
    roots = [brentq(lambda x: x * np.tan(x) - biot, n * np.pi + 1e-9, (n + 0.5) * np.pi - 1e-9) for n in range(60)]
    late = found.time > 10.0
    fourier = K / C * found.time[late] / half**2
    for at, values in ((0.0, found.core), (1.0, found.lower)):
        share = sum(
            4 * np.sin(x) / (2 * x + np.sin(2 * x)) * np.cos(x * at) * np.exp(-(x**2) * fourier) for x in roots
        )
        assert values[late] == pytest.approx(PLATEN_C + (start - PLATEN_C) * share, abs=0.15)


@pytest.mark.parametrize(
    "changed",
    [{}, {"exchange": 2000.0, "emissivity": 0.6, "growth": (0.7, 6.0)}, {"moisture": 0.08, "dry_density": 700.0}],
    ids=["plain", "losses", "water"],
)
def test_heat_that_came_in_is_stored_or_taken_by_water(changed):
    found = course(world(**changed), program())
    assert found.heat_stored == pytest.approx(found.heat_in - found.heat_of_water, rel=1e-6)
    assert found.heat_of_water == pytest.approx(LATENT * found.water_gone, abs=1.0)


def test_resin_gives_its_heat_and_no_more():
    cured, plain = (course(world(cure_heat=heat), program()) for heat in (20e3, 0.0))
    assert cured.heat_stored - cured.heat_in == pytest.approx(2 * 20e3, rel=0.01)
    assert plain.heat_stored == pytest.approx(plain.heat_in, rel=1e-6)


def test_steam_warms_the_core_before_conduction_does_and_holds_back_the_faces():
    wet, dry = (course(world(moisture=m, dry_density=700.0), program()) for m in (0.09, 0.0))
    pressed = (wet.time > 40.0) & (wet.time < 75.0)
    assert (wet.core - dry.core)[pressed].max() > 3.0
    assert (wet.lower - dry.lower)[pressed].max() < -1.0


@cache
def nothing_hidden() -> Campaign:
    return campaign(3, runs=1)


@pytest.mark.parametrize("hidden", sorted(SIZES))
def test_each_hidden_cause_moves_the_readings(hidden):
    plain, spoiled = nothing_hidden(), campaign(3, hidden, runs=1)
    columns = [c for c in plain.runs[0] if c != "closed"]
    assert (plain.runs[0][columns] - spoiled.runs[0][columns]).abs().to_numpy().max() > 0.3


def test_a_seed_gives_the_same_campaign():
    first, second = campaign(4, "moisture", runs=1), campaign(4, "moisture", runs=1)
    assert first.press == second.press
    assert first.runs[0].equals(second.runs[0])
    assert first.runs[0].attrs == second.runs[0].attrs
    assert first.pressings[0].world.layers[PANEL].k[0] == second.pressings[0].world.layers[PANEL].k[0]
