"""The live sensor where water leaves a board on a hot plate well below boiling, which no law of the model knows.

The board is a finite-volume model of its own: water leaves by how far its vapour pressure, over wood with its
sorption, is above what it was at the start, and takes its latent heat along. It shares nothing with `softsensor`.
"""

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.records import Run
from softsensor.diagnosis.missing_causes import with_missing_causes
from softsensor.heat.model_file import FittedValue, MissingCauses, ModelFile
from softsensor.jobs.campaign import fit_campaign
from softsensor.live.priors import coefficient_priors
from softsensor.live.sensor import ScanSensor
from softsensor.live.validity import InvalidReason
from softsensor.signals.instrument import GUESS_LOG

PLATE_C, START_C, THICK_M, K, RHO, C = 220.0, 21.0, 0.016, 0.12, 450.0, 1500.0
PRESS = """
[press]
name = "plate"
area_m2 = 0.01
[initial]
kind = "uniform"
[[layer]]
name = "panel"
from_run = true
[boundary.top]
kind = "measured"
column = "hot"
[boundary.bottom]
kind = "insulated"
[[contact]]
between = ["panel", "boundary.top"]
closed = "h_c"
[coefficients.h_c]
guess = 300.0
lower = 10.0
upper = 5000.0
[[sensor]]
columns = ["bottom_*"]
at = "panel.bottom"
"""
HEADER = {
    "panel.material": "pine", "panel.thickness_mm": 1000.0 * THICK_M, "panel.density_kg_m3": RHO,
    "panel.conductivity_W_mK": K, "panel.heat_capacity_J_kgK": C, "panel.initial_temperature_C": START_C,
    "ambient.temperature_C": START_C,
}  # fmt: skip


def vapour_kPa(temperature_C, moisture):
    """Magnus' formula times an S-shaped sorption isotherm, half of saturation at 7 % moisture."""
    saturated = 0.61094 * np.exp(17.625 * temperature_C / (temperature_C + 243.04))
    return saturated * (1.0 - np.exp(-((moisture / 0.09) ** 1.3)))


def board(moisture, seconds, cells=40, step_s=0.25, conductivity=K):
    """Return each second's back and middle of a board on the plate. [°C]"""
    dx, t, x = THICK_M / cells, np.full(cells, START_C), np.full(cells, moisture)
    beside, found = vapour_kPa(START_C, moisture), []
    for n in range(int(seconds / step_s)):
        if n % round(1.0 / step_s) == 0:
            found.append((t[0], 0.5 * (t[cells // 2 - 1] + t[cells // 2])))
        flux = np.concatenate(
            [[0.0], conductivity * np.diff(t) / dx, [(PLATE_C - t[-1]) / (1.0 / 300.0 + 0.5 * dx / conductivity)]]
        )
        left = np.clip(1e-4 * (vapour_kPa(t, x) - beside), 0.0, x / step_s)
        x = x - step_s * left
        t = t + step_s * (np.diff(flux) / dx - 2.4e6 * RHO * left) / (RHO * C)
    return np.array(found)


def run_of(moisture, conductivity=K, name="r"):
    """Return a board's 600 s as a run, which may conduct otherwise than its header says, and its core."""
    truth, rng = board(moisture, 600, conductivity=conductivity), np.random.default_rng(2026)
    noise = rng.normal(0.0, 0.1, (len(truth), 2))
    columns = {"hot": PLATE_C + noise[:, 0], "bottom_1": truth[:, 0] + noise[:, 1]}
    return Run(name, HEADER, np.arange(len(truth), dtype=float), columns), truth[:, 1]


def followed(moisture):
    """Return the estimates of a board's 600 s and the true core. [°C]"""
    run, core = run_of(moisture)
    sensor = ScanSensor(parse_press(PRESS), run.header)
    return [
        sensor.update(time_s, {name: values[i] for name, values in run.columns.items()})
        for i, time_s in enumerate(run.time_s)
    ], core


def test_a_board_that_dries_below_boiling_is_not_told_sure_and_wrong():
    said, core = followed(0.08)
    beyond = [max(e.core_low_C - c, c - e.core_high_C) for e, c in zip(said, core, strict=True) if e.valid]
    assert max(beyond) < 5.0  # 34 K where the states' distance was held against the number of all of them
    far = [e for e in said[300:] if e.reason is InvalidReason.READINGS_CONTRADICT_MODEL]
    assert len(far) > 150


def test_a_dry_board_is_told_and_held():
    said, core = followed(0.0)
    held = [e.core_low_C <= c <= e.core_high_C for e, c in zip(said, core, strict=True) if e.valid]
    assert np.mean(held) == pytest.approx(1.0, abs=0.01)
    assert not [e for e in said if e.reason is InvalidReason.READINGS_CONTRADICT_MODEL]


def test_after_runs_that_no_model_describes_contacts_are_known_no_less_than_by_their_guess():
    press = parse_press(PRESS)
    runs = [run_of(0.08, K * share, f"r{i}")[0] for i, share in enumerate((0.95, 1.0, 1.05))]
    found = fit_campaign(press, runs)
    assert not found.met
    model = with_missing_causes(found.model_file(), found.runs)
    assert model.coefficients["h_c"].sd > model.coefficients["h_c"].value  # no more than the press file's limits
    (prior,) = coefficient_priors(press, model)
    assert prior.sd < GUESS_LOG
    assert prior.centre == pytest.approx(np.log(300.0))


def known_as(sd):
    """Return the prior of a contact that runs know as 30 W/m²K to a share of it, where the guess is 300."""
    model = ModelFile("m", "plate", {"h_c": FittedValue(30.0, 30.0 * sd)}, missing=MissingCauses(3, 1.0, 0.0, {}))
    return coefficient_priors(parse_press(PRESS), model)[0]


def test_what_runs_know_less_well_than_the_guess_is_joined_with_it():
    own = np.sqrt(np.log1p(3.0**2))
    both = 1.0 / GUESS_LOG**2 + 1.0 / own**2
    assert known_as(3.0).sd == pytest.approx(both**-0.5)
    assert known_as(3.0).centre == pytest.approx((np.log(300.0) / GUESS_LOG**2 + np.log(30.0) / own**2) / both)


def test_what_runs_know_well_replaces_the_guess():
    assert known_as(0.3).centre == pytest.approx(np.log(30.0))
    assert known_as(0.3).sd == pytest.approx(np.sqrt(np.log1p(0.3**2)))
