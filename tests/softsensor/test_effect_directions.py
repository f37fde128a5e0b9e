"""Upper is upper and lower is lower, and the press closes when it closes: what a swap or a delay would change."""

from dataclasses import replace

import numpy as np
import pytest

from softsensor.effects import find_effect
from softsensor.heat.model import ThermalModel

ROOM_C = 21.0


@pytest.fixture
def solved(lab_press, make_run, coefficients, moments):
    """The faces' readings, lower and upper, and the case; equal contacts, a panel as warm as the room."""
    equal = dict.fromkeys(("h_p_o", "h_p_c"), 800.0)

    def solve(top_C=200.0, bottom_C=200.0, **values):
        effects = tuple(dict.fromkeys(name.partition(".")[0] for name in values))
        model = ThermalModel.of(lab_press, effects)
        run = make_run(top=lambda t: top_C + 0.0 * t, bottom=lambda t: bottom_C + 0.0 * t)
        case = model.prepare(run, moments)
        out = model.solve(case, coefficients | equal | values)
        return *(out.column(f"{face}_1") for face in ("bottom", "top")), case

    return solve


def closed_for(case, seconds):
    return int(np.searchsorted(case.run.time_s, case.moments.closed_s + seconds))


def test_each_platen_heats_its_own_face(solved):
    lower, upper, case = solved(top_C=200.0, bottom_C=ROOM_C)
    at = closed_for(case, 10.0)
    assert upper[at] > 100.0
    assert lower[at] < 30.0


def test_a_platen_offset_is_true_minus_reading_of_its_own_platen(solved):
    lower, upper, case = solved(**{"platen_offset.top_K": 10.0})
    warmer_lower, warmer_upper, _ = solved(top_C=210.0)
    at = closed_for(case, 10.0)
    assert upper[at] - lower[at] > 3.0
    assert (lower[at], upper[at]) == pytest.approx((warmer_lower[at], warmer_upper[at]), abs=1e-6)


def test_a_contact_ratio_above_1_heats_the_upper_face_faster(solved):
    lower, upper, case = solved(**{"contact_asymmetry.ratio": 4.0})
    at = closed_for(case, 5.0)
    assert upper[at] - lower[at] > 5.0


def test_a_footprint_mixes_in_the_press_face_that_touches_the_sensors_face(solved):
    given = {"top_C": 200.0, "bottom_C": ROOM_C}
    lower, upper, case = solved(**given)
    mixed_lower, mixed_upper, _ = solved(**given, **{"thermocouple_footprint.weight": 0.5})
    at = closed_for(case, 5.0)
    assert mixed_upper[at] - upper[at] > 10.0
    assert abs(mixed_lower[at] - lower[at]) < 2.0


def test_a_contact_grows_from_closing_on_with_its_time_constant(solved):
    """Of the factor's own law, 1 - deficit exp(-t / tau), averaged over steps: 0.4 at closing, and 1/e later."""
    *_, case = solved()
    scene = case.scene
    closed = scene.closed_s
    scene = replace(
        scene, step_start=closed + np.array([-2.0, 0.0, 7.0]), step_end=closed + np.array([0.0, 0.01, 7.01])
    )
    contact = find_effect("contact_buildup").terms(scene, {"deficit": 0.6, "time_constant_s": 7.0}).closed_contact
    assert set(contact) == set(scene.panel_contacts)
    for factor in contact.values():
        assert factor == pytest.approx([0.4, 0.4, 1.0 - 0.6 / np.e], abs=1e-3)


def test_half_of_the_closing_ramp_has_passed_at_the_moment_of_closing(solved):
    *_, case = solved()
    t, closed = case.run.time_s, case.row_clock.shares({})[0][:, 2]
    rising = t < 40.0
    assert np.interp(0.5, closed[rising], t[rising]) == pytest.approx(case.moments.closed_s, abs=0.01)


def test_faces_denser_than_the_core_leave_the_panel_its_mass_and_are_alike(solved):
    """The shape is 1 + a (z^4 - 1/5) from -1 to 1: at the faces 1 + 0.8 a, in the core 1 - 0.2 a, 1 on average."""
    *_, case = solved()
    inside = case.scene.panel_cells
    terms = find_effect("density_profile").terms(case.scene, {"amplitude": 0.5})
    factor, width = np.asarray(terms.capacity)[inside], case.mesh.dx[inside]
    assert factor @ width / width.sum() == pytest.approx(1.0, abs=0.01)
    assert factor == pytest.approx(factor[::-1], abs=0.01)
    assert (factor[0], factor[-1], factor.min()) == pytest.approx((1.4, 1.4, 0.9), abs=0.05)
    assert np.all(np.asarray(terms.capacity)[~inside] == 1.0)
    assert np.array_equal(terms.conductivity, terms.capacity)
