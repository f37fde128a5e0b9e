"""The solver against closed forms, laws and its own order of convergence."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import erfc, erfcx

from daq.records import Moments, NoSteadyState
from softsensor.heat.mesh import build_mesh, graded_widths

K, RHO, C = 0.12, 740.0, 1550.0
ALPHA = K / (RHO * C)
METHODS = ("implicit", "exact")
NEVER = Moments()


def slab(thickness_mm: float, bottom: str, top: str = 'kind = "insulated"', contact: str = "") -> str:
    return f"""
[[layer]]
name = "slab"
thickness_mm = {thickness_mm}
conductivity_W_mK = {K}
density_kg_m3 = {RHO}
heat_capacity_J_kgK = {C}
[boundary.bottom]
{bottom}
[boundary.top]
{top}
{contact}
[initial]
kind = "uniform"
temperature_C = 20.0
"""


MEASURED = 'kind = "measured"\ncolumn = "hot"'
CONTACT_BELOW = '[[contact]]\nbetween = ["boundary.bottom", "slab"]\nclosed = "h"\n'
CONTACT_ABOVE = '[[contact]]\nbetween = ["slab", "boundary.top"]\nclosed = "h"\n'


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("h", [30.0, 700.0, 5000.0])
def test_thick_slab_heated_through_a_contact_follows_the_error_function(make_rig, method, h):
    time_s = np.arange(0.0, 60.05, 0.1)
    places = {"face": '"slab.bottom"', "deep": '{ layer = "slab", depth_mm = 4.0 }'}
    model, run = make_rig(slab(60.0, MEASURED, contact=CONTACT_BELOW), time_s, {"hot": 200.0}, places)
    solution = model.solve(model.prepare(run, NEVER), {"h": h}, method=method)
    after = time_s >= 0.2
    for column, x in (("face", 0.0), ("deep", 0.004)):
        s = np.sqrt(ALPHA * time_s[after])
        eta = x / (2 * s)
        # exp(h x / k + h² alpha t / k²) erfc(eta + h sqrt(alpha t) / k), Carslaw & Jaeger sec. 2.7
        expected = 20.0 + 180.0 * (erfc(eta) - np.exp(-(eta**2)) * erfcx(eta + h * s / K))
        error = np.abs(solution.column(column)[after] - expected)
        # at 5000 W/m²K the face rises by 400 K/s in the first tenths
        assert error.max() < (0.05 if h < 1000 else 0.4), (column, error.max())
        assert error[time_s[after] > 1.0].max() < 0.05


HOT_AIR = 'kind = "air"\ncoefficient = "h"\nambient_C = 180.0'


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("end", "contacts"), [(MEASURED, CONTACT_BELOW + CONTACT_ABOVE), (HOT_AIR, "")], ids=["contacts", "air"]
)
def test_slab_between_two_contacts_follows_the_eigenfunction_series(make_rig, method, end, contacts):
    thickness, h = 0.016, 300.0
    time_s = np.arange(0.0, 400.05, 0.2)
    toml = slab(16.0, end, end, contacts)
    places = {"face": '"slab.top"', "core": '"slab.middle"'}
    model, run = make_rig(toml, time_s, {"hot": 180.0}, places)
    solution = model.solve(model.prepare(run, NEVER), {"h": h}, method=method)
    biot = h * thickness / 2 / K
    after = time_s >= 5.0
    theta = {"face": 0.0, "core": 0.0}
    for i in range(60):
        beta = brentq(lambda b: b * np.sin(b) - biot * np.cos(b), i * np.pi + 1e-12, i * np.pi + np.pi / 2)
        weight = 4 * np.sin(beta) / (2 * beta + np.sin(2 * beta))
        decay = np.exp(-(beta**2) * ALPHA * time_s[after] / (thickness / 2) ** 2)
        theta["face"] = theta["face"] + weight * np.cos(beta) * decay
        theta["core"] = theta["core"] + weight * decay
    for column in theta:
        error = np.abs(solution.column(column)[after] - (180.0 - 160.0 * theta[column]))
        assert error.max() < 0.05, (column, error.max())


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("h", [None, 400.0])
def test_two_bodies_brought_together_share_heat_by_their_effusivities(make_rig, method, h):
    contact = '[[contact]]\nbetween = ["hot_body", "panel"]\nclosed = "h"\n' if h else ""
    toml = f"""
[[layer]]
name = "hot_body"
thickness_mm = 60.0
conductivity_W_mK = 1.0
density_kg_m3 = 2500.0
heat_capacity_J_kgK = 840.0
[[layer]]
name = "panel"
from_run = true
[boundary.bottom]
{MEASURED}
{contact}
"""
    header = {
        "panel.thickness_mm": 60.0,
        "panel.density_kg_m3": RHO,
        "panel.conductivity_W_mK": K,
        "panel.heat_capacity_J_kgK": C,
        "panel.initial_temperature_C": 20.0,
    }
    time_s = np.arange(0.0, 40.05, 0.1)
    places = {"lower": '"hot_body.top"', "upper": '"panel.bottom"'}
    model, run = make_rig(toml, time_s, {"hot": 180.0}, places, **header)
    solution = model.solve(model.prepare(run, NEVER), {"h": h} if h else {}, method=method)
    e_panel, e_hot = np.sqrt(K * RHO * C), np.sqrt(1.0 * 2500.0 * 840.0)
    after = time_s >= 0.2
    a = (h or 1e12) * (1 / e_panel + 1 / e_hot)
    grown = 1.0 - erfcx(a * np.sqrt(time_s[after]))
    upper = 20.0 + 160.0 * e_hot / (e_hot + e_panel) * grown
    lower = 180.0 - 160.0 * e_panel / (e_hot + e_panel) * grown
    # a step of 126 K at once, a fifth of a second ago
    assert np.abs(solution.column("upper")[after] - upper).max() < 0.4
    assert np.abs(solution.column("lower")[after] - lower).max() < 0.4
    late = time_s[after] > 1.0
    assert np.abs(solution.column("upper")[after] - upper)[late].max() < 0.05


@pytest.mark.parametrize("method", METHODS)
def test_ramped_face_drives_the_integrated_error_function(make_rig, method):
    time_s = np.arange(0.0, 60.05, 0.5)
    toml = slab(60.0, MEASURED)
    places = {"deep": '{ layer = "slab", depth_mm = 3.0 }'}
    model, run = make_rig(toml, time_s, {"hot": 20.0 + 2.0 * time_s}, places)
    solution = model.solve(model.prepare(run, NEVER), {}, method=method)
    t = time_s[1:]
    eta = 0.003 / (2 * np.sqrt(ALPHA * t))
    expected = 20.0 + 2.0 * t * ((1 + 2 * eta**2) * erfc(eta) - 2 / np.sqrt(np.pi) * eta * np.exp(-(eta**2)))
    assert np.abs(solution.column("deep")[1:] - expected).max() < 0.03


def test_halving_the_cells_quarters_the_error(make_rig):
    time_s = np.arange(0.0, 200.5, 1.0)
    toml = slab(16.0, MEASURED, MEASURED, CONTACT_BELOW + CONTACT_ABOVE)
    hot = 20.0 + 150.0 * np.sin(np.pi * time_s / 400.0) ** 2
    model, run = make_rig(toml, time_s, {"hot": hot}, {"face": '"slab.top"'})

    def solve(fineness):
        return model.solve(model.prepare(run, NEVER, fineness=fineness), {"h": 300.0}, method="exact").places

    finest = solve(8.0)
    errors = [np.abs(solve(f) - finest).max(axis=0) for f in (1.0, 2.0)]
    ratio = errors[0] / errors[1]
    assert (ratio > 3.6).all(), ratio
    assert (ratio < 4.8).all(), ratio


def test_halving_the_steps_quarters_the_error(make_rig):
    time_s = np.arange(0.0, 300.5, 1.0)
    toml = slab(16.0, MEASURED, MEASURED, CONTACT_BELOW + CONTACT_ABOVE)
    hot = 20.0 + 150.0 * np.sin(np.pi * time_s / 200.0) ** 2
    model, run = make_rig(toml, time_s, {"hot": hot}, {"face": '"slab.top"'})
    exact = model.solve(model.prepare(run, NEVER), {"h": 300.0}, method="exact").places
    errors = []
    for step in (8.0, 4.0, 2.0):
        case = model.prepare(run, NEVER, max_step_s=step)
        rows = np.isin(np.round(time_s, 6), np.round(case.edges, 6)) & (time_s > 60.0)
        late = (time_s > 60.0) if rows.sum() < 5 else rows
        errors.append(np.sqrt(np.mean((model.solve(case, {"h": 300.0}).places - exact)[late] ** 2)))
    assert 3.0 < errors[0] / errors[1] < 5.5, errors
    assert 3.0 < errors[1] / errors[2] < 5.5, errors


def test_insulated_slab_keeps_its_heat_to_rounding(make_rig):
    time_s = np.arange(0.0, 100.05, 0.5)
    toml = slab(16.0, 'kind = "insulated"').replace('kind = "uniform"\ntemperature_C = 20.0', 'kind = "sensors"')
    model, run = make_rig(toml, time_s, {}, {"a": '"slab.bottom"', "b": '"slab.top"'})
    run.columns["a"][0], run.columns["b"][0] = 20.0, 180.0
    case = model.prepare(run, NEVER)
    for method in METHODS:
        fields = model.solve(case, {}, method=method, fields=True).fields
        heat = fields @ case.mesh.dx * RHO * C
        assert np.ptp(fields[-1]) < 100.0, "heat moved"
        assert np.abs(heat / heat[0] - 1.0).max() < 1e-12, method


@pytest.mark.parametrize("method", METHODS)
def test_what_leaves_one_layer_through_a_contact_enters_the_next_to_rounding(make_rig, method):
    layers = {"steel": (10.0, 45.0, 7850.0, 490.0), "pad": (2.0, 0.4, 1500.0, 1000.0), "board": (16.0, K, RHO, C)}
    toml = "".join(
        f'[[layer]]\nname = "{name}"\nthickness_mm = {d}\nconductivity_W_mK = {k}\ndensity_kg_m3 = {rho}\n'
        f"heat_capacity_J_kgK = {c}\n"
        for name, (d, k, rho, c) in layers.items()
    )
    toml += '[[contact]]\nbetween = ["steel", "pad"]\nclosed = "h_1"\n'
    toml += '[[contact]]\nbetween = ["pad", "board"]\nclosed = "h_2"\n[initial]\nkind = "sensors"\n'
    model, run = make_rig(toml, np.arange(0.0, 300.05, 0.5), {}, {"a": '"steel.bottom"', "b": '"board.top"'})
    run.columns["a"][0], run.columns["b"][0] = 200.0, 20.0
    case = model.prepare(run, NEVER)
    fields = model.solve(case, {"h_1": 900.0, "h_2": 40.0}, method=method, fields=True).fields
    capacity = np.concatenate(
        [case.mesh.dx[case.mesh.cells(name)] * rho * c for name, (_, _, rho, c) in layers.items()]
    )
    board = case.mesh.cells("board")
    gained = (fields[-1] - fields[0])[board] @ capacity[board]
    assert gained > 1e5, "heat passed the contacts"
    assert np.abs(fields @ capacity / (fields[0] @ capacity) - 1.0).max() < 1e-12


def test_absorbed_flux_ends_up_in_the_slab_to_rounding(make_rig):
    time_s = np.arange(0.0, 50.05, 0.5)
    toml = slab(16.0, 'kind = "flux"\nincident_W_m2 = 5000.0\nabsorptivity = 0.9')
    model, run = make_rig(toml, time_s, {}, {"a": '"slab.bottom"'})
    case = model.prepare(run, NEVER)
    fields = model.solve(case, {}, fields=True).fields
    gained = (fields[-1] - fields[0]) @ case.mesh.dx * RHO * C
    assert gained == pytest.approx(0.9 * 5000.0 * 50.0, rel=1e-11)


def test_irradiated_face_of_a_thick_slab_rises_with_the_square_root_of_time(make_rig):
    time_s = np.arange(0.0, 20.05, 0.1)
    toml = slab(60.0, 'kind = "flux"\nincident_W_m2 = 20000.0')
    model, run = make_rig(toml, time_s, {}, {"a": '"slab.bottom"'})
    solution = model.solve(model.prepare(run, NEVER), {})
    expected = 20.0 + 2 * 20000.0 * np.sqrt(time_s / (np.pi * K * RHO * C))
    assert np.abs(solution.column("a") - expected)[time_s >= 0.5].max() < 0.3  # of 600 K


def test_face_that_radiates_settles_where_losses_equal_the_flux(make_rig):
    time_s = np.arange(0.0, 3000.5, 1.0)
    toml = slab(
        5.0, 'kind = "flux"\nincident_W_m2 = 8000.0\nemissivity = 0.8\ncoefficient = "h"\nambient_C = 25.0'
    )
    model, run = make_rig(toml, time_s, {}, {"a": '"slab.bottom"'})
    face = model.solve(model.prepare(run, NEVER), {"h": 10.0}).column("a")[-1]
    lost = 10.0 * (face - 25.0) + 0.8 * 5.670374419e-8 * ((face + 273.15) ** 4 - 298.15**4)
    assert lost == pytest.approx(8000.0, rel=1e-6)


def test_a_face_to_the_air_that_radiates_cools_as_a_lump_does(make_rig):
    """A plate of 2 mm without a gradient: rho c d dT/dt = -h (T - Ta) - eps sigma (T^4 - Ta^4)."""
    time_s = np.arange(0.0, 600.5, 1.0)
    air = 'kind = "air"\nemissivity = 0.92\ncoefficient = "h"\nambient_C = 20.0'
    toml = slab(2.0, air).replace(f"conductivity_W_mK = {K}", "conductivity_W_mK = 200.0")
    toml = toml.replace("temperature_C = 20.0", "temperature_C = 300.0")
    model, run = make_rig(toml, time_s, {}, {"a": '"slab.bottom"'})

    def rate(_, t):
        lost = 6.0 * (t - 20.0) + 0.92 * 5.670374419e-8 * ((t + 273.15) ** 4 - 293.15**4)
        return -lost / (RHO * C * 0.002)

    lump = solve_ivp(rate, (0.0, 600.0), [300.0], t_eval=time_s, rtol=1e-9, atol=1e-9).y[0]
    face = model.solve(model.prepare(run, NEVER), {"h": 6.0}).column("a")
    assert face == pytest.approx(lump, abs=0.05)
    assert lump[-1] < 150.0


def test_heat_from_both_sides_stays_symmetric(make_rig):
    time_s = np.arange(0.0, 60.05, 0.1)
    toml = slab(16.0, MEASURED, MEASURED, CONTACT_BELOW + CONTACT_ABOVE)
    model, run = make_rig(toml, time_s, {"hot": 180.0}, {"a": '"slab.bottom"', "b": '"slab.top"'})
    case = model.prepare(run, NEVER)
    for method in METHODS:
        fields = model.solve(case, {"h": 700.0}, method=method, fields=True).fields
        assert np.abs(fields - fields[:, ::-1]).max() < 1e-8, method


def test_widths_fill_the_layer_and_grow_smoothly():
    for thickness, diffusivity in ((0.003, 1e-7), (0.016, 1.05e-7), (0.038, 1.2e-7), (0.01, 1.2e-5), (0.05, 2e-6)):
        for fineness in (0.5, 1.0, 4.0):
            widths = graded_widths(thickness, diffusivity, fineness)
            assert widths.sum() == pytest.approx(thickness, rel=1e-12)
            assert np.allclose(widths, widths[::-1])
            growth = widths[1:] / widths[:-1]
            assert growth.max() < 1.3 ** (1 / fineness) + 0.01


def test_place_reads_a_parabola_exactly_anywhere_in_its_layer():
    mesh = build_mesh([("plate", 0.01, 1.2e-5), ("panel", 0.016, 1e-7)])
    x = mesh.centres("panel")
    field = np.zeros(len(mesh.dx))
    field[mesh.cells("panel")] = 3.0 + 2e3 * x - 5e4 * x**2
    for height in (0.0, 1e-5, 0.0057, 0.008, 0.016):
        assert mesh.place("panel", height) @ field == pytest.approx(3.0 + 2e3 * height - 5e4 * height**2, abs=1e-6)


STEADY = '[initial]\nkind = "steady"\n'
UNIFORM = '[initial]\nkind = "uniform"\ntemperature_C = 20.0\n'


@pytest.mark.parametrize("flux", [1e3, 2e4, 6e4, 2e5, 1e7])
def test_a_steady_start_that_radiates_begins_where_losses_equal_the_flux(make_rig, flux):
    end = f'kind = "flux"\nincident_W_m2 = {flux}\nabsorptivity = 0.9\nemissivity = 0.9\ncoefficient = "h"'
    toml = slab(10.0, 'kind = "insulated"', end + "\nambient_C = 20.0").replace(UNIFORM, STEADY)
    model, run = make_rig(toml, np.arange(0.0, 5.1, 0.5), {}, {"a": '"slab.top"'})
    solution = model.solve(model.prepare(run, NEVER), {"h": 10.0}, ("h",))

    def settled(h):
        return brentq(
            lambda t: 0.9 * flux - 0.9 * 5.670374419e-8 * (t**4 - 293.15**4) - h * (t - 293.15), 200.0, 1e4
        )

    assert solution.column("a") == pytest.approx(settled(10.0) - 273.15, abs=1e-6)
    slope = (settled(10.01) - settled(9.99)) / 0.02
    assert solution.d_sensors["h"][:, 0] == pytest.approx(slope, rel=1e-5)


def test_a_foil_that_radiates_settles_at_the_default_steps(make_rig):
    end = 'kind = "flux"\nincident_W_m2 = 60000.0\nabsorptivity = 0.9\nemissivity = 0.9\nambient_C = 20.0'
    toml = slab(0.001, end).replace(f"conductivity_W_mK = {K}", "conductivity_W_mK = 45.0")
    model, run = make_rig(toml, np.arange(0.0, 60.1, 0.5), {}, {"a": '"slab.top"'})
    foil = model.solve(model.prepare(run, NEVER), {}).column("a")
    settled = (60000.0 / 5.670374419e-8 + 293.15**4) ** 0.25 - 273.15
    assert np.abs(foil[run.time_s > 10.0] - settled).max() < 0.01
    assert foil.max() < settled + 1.0


def test_layers_tied_to_no_temperature_have_no_steady_start(make_rig):
    time_s = np.arange(0.0, 5.1, 0.5)
    model, run = make_rig(slab(10.0, 'kind = "insulated"').replace(UNIFORM, STEADY), time_s, {}, {})
    with pytest.raises(
        NoSteadyState,
        match=r"rig: layer 'slab' exchanges heat with nothing of a given temperature, .* \[initial\] kind =",
    ):
        model.solve(model.prepare(run, NEVER), {})
    absorbing = slab(10.0, 'kind = "flux"\nincident_W_m2 = 1000.0').replace(UNIFORM, STEADY)
    model, run = make_rig(absorbing, time_s, {}, {})
    with pytest.raises(NoSteadyState, match="'slab' exchanges heat with nothing of a given temperature"):
        model.solve(model.prepare(run, NEVER), {})


AIR = 'kind = "air"\ncoefficient = "h_air"\nambient_C = 180.0'


@pytest.mark.parametrize("method", METHODS)
def test_a_contact_before_air_resists_in_series_with_the_airs_own_coefficient(make_rig, method):
    time_s, places = np.arange(0.0, 60.1, 0.5), {"a": '"slab.top"'}
    both, run = make_rig(slab(16.0, MEASURED, AIR, CONTACT_ABOVE), time_s, {"hot": 60.0}, places)
    one, _ = make_rig(slab(16.0, MEASURED, AIR), time_s, {"hot": 60.0}, places)
    h, air = 40.0, 10.0
    joined = h * air / (h + air)
    found = both.solve(both.prepare(run, NEVER), {"h": h, "h_air": air}, ("h", "h_air"), method=method)
    expected = one.solve(one.prepare(run, NEVER), {"h_air": joined}, ("h_air",), method=method)
    assert np.abs(found.sensors - expected.sensors).max() < 1e-9
    for name, share in (("h", (air / (h + air)) ** 2), ("h_air", (h / (h + air)) ** 2)):
        assert np.abs(found.d_sensors[name] - share * expected.d_sensors["h_air"]).max() < 1e-9, name


@pytest.mark.parametrize("method", METHODS)
def test_a_contact_with_an_insulated_end_passes_nothing(make_rig, method):
    model, run = make_rig(
        slab(16.0, 'kind = "insulated"', contact=CONTACT_ABOVE), np.arange(0.0, 60.1, 0.5), {}, {}
    )
    warm = model.prepare(run, NEVER)
    assert model.solve(warm, {"h": 500.0}, fields=True, method=method).fields == pytest.approx(20.0, abs=1e-9)


def test_a_flux_passes_a_contact_whole(make_rig):
    toml = slab(16.0, 'kind = "insulated"', 'kind = "flux"\nincident_W_m2 = 5000.0', CONTACT_ABOVE)
    model, run = make_rig(toml, np.arange(0.0, 50.1, 0.5), {}, {})
    case = model.prepare(run, NEVER)
    fields = model.solve(case, {"h": 25.0}, fields=True).fields
    assert (fields[-1] - fields[0]) @ case.mesh.dx * RHO * C == pytest.approx(5000.0 * 50.0, rel=1e-10)


@pytest.mark.parametrize("method", METHODS)
def test_a_layer_parted_from_a_measured_end_loses_heat_to_the_air(make_rig, method):
    time_s, places = np.arange(0.0, 40.1, 0.5), {"a": '"slab.top"'}
    parted = '[[contact]]\nbetween = ["slab", "boundary.top"]\nopen = ["h_air", "h_other"]\nclosed = "h"\n'
    model, run = make_rig(slab(16.0, MEASURED, MEASURED, parted), time_s, {"hot": 150.0}, places)
    air, _ = make_rig(slab(16.0, MEASURED, AIR.replace("180", "23")), time_s, {"hot": 150.0}, places)
    values = {"h": 700.0, "h_air": 12.0, "h_other": 10.0}
    open_press = Moments(inserted_s=0.0, closed_s=100.0)
    found = model.solve(model.prepare(run, open_press), values, ("h_air",), method=method)
    expected = air.solve(air.prepare(run, NEVER), {"h_air": 12.0}, ("h_air",), method=method)
    assert np.abs(found.sensors - expected.sensors).max() < 1e-6
    assert np.abs(found.d_sensors["h_air"] - expected.d_sensors["h_air"]).max() < 1e-6


@pytest.mark.parametrize("height", [0.0, 0.3e-3, 7.9e-3, 16e-3])
def test_the_slope_of_a_parabola_in_height_is_read_exactly_up_to_the_faces(height):
    mesh = build_mesh([("plate", 0.01, 1e-5), ("panel", 0.016, 1e-7)])
    t = np.zeros(len(mesh.dx))
    z = mesh.centres("panel")
    t[mesh.cells("panel")] = 20.0 + 3000.0 * z - 4e5 * z**2
    assert mesh.slope("panel", height) @ t == pytest.approx(3000.0 - 8e5 * height, rel=1e-9)
