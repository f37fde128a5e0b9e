"""The live sensor where water leaves a board on a hot plate well below boiling, which no law of the model knows.

The board is a finite-volume model of its own: water leaves by how far its vapour pressure, over wood with its
sorption, is above what it was at the start, and takes its latent heat along. It shares nothing with `softsensor`.
"""

import numpy as np
import pytest

from daq.press.press_file import parse_press
from softsensor.live.sensor import ScanSensor
from softsensor.live.validity import InvalidReason

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


def board(moisture, seconds, cells=40, step_s=0.25):
    """Return each second's back and middle of a board on the plate. [°C]"""
    dx, t, x = THICK_M / cells, np.full(cells, START_C), np.full(cells, moisture)
    beside, found = vapour_kPa(START_C, moisture), []
    for n in range(int(seconds / step_s)):
        if n % round(1.0 / step_s) == 0:
            found.append((t[0], 0.5 * (t[cells // 2 - 1] + t[cells // 2])))
        flux = np.concatenate([[0.0], K * np.diff(t) / dx, [(PLATE_C - t[-1]) / (1.0 / 300.0 + 0.5 * dx / K)]])
        left = np.clip(1e-4 * (vapour_kPa(t, x) - beside), 0.0, x / step_s)
        x = x - step_s * left
        t = t + step_s * (np.diff(flux) / dx - 2.4e6 * RHO * left) / (RHO * C)
    return np.array(found)


def followed(moisture):
    """Return the estimates of a board's 600 s and the true core. [°C]"""
    truth, rng = board(moisture, 600), np.random.default_rng(2026)
    noise = rng.normal(0.0, 0.1, (len(truth), 2))
    sensor = ScanSensor(parse_press(PRESS), HEADER)
    said = [
        sensor.update(float(i), {"hot": PLATE_C + noise[i, 0], "bottom_1": back + noise[i, 1]})
        for i, (back, _) in enumerate(truth)
    ]
    return said, truth[:, 1]


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
