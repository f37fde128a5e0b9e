"""Rigs with closed-form solutions, and the laboratory press with a full cycle."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from daq.press.press_file import Press, parse_press, read_press
from daq.records import Moments, Run
from softsensor.heat.model import ThermalModel

LAB_PRESS = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"
BOARD = {
    "panel.material": "MDF",
    "panel.thickness_mm": 16.0,
    "panel.density_kg_m3": 740.0,
    "panel.conductivity_W_mK": 0.12,
    "panel.heat_capacity_J_kgK": 1550.0,
    "panel.moisture_percent": 8.0,
    "panel.initial_temperature_C": 21.0,
    "ambient.temperature_C": 23.0,
    "setting.pressure_N_cm2": 320.0,
}
MOMENTS = Moments(inserted_s=5.0, closed_s=20.3, opened_s=80.2, removed_s=150.0, ramp_s=0.4)
COEFFICIENTS = {"h_p_o": 800.0, "h_p_c": 900.0, "h_pp_o": 40.0, "h_pp_c": 700.0, "h_wa": 12.0, "h_ap": 10.0}


@pytest.fixture
def lab_press() -> Press:
    return read_press(LAB_PRESS)


@pytest.fixture
def make_run() -> Callable[..., Run]:
    """A run of the laboratory press from platen temperatures as functions of time."""

    def make(
        end: float = 200.0, every: float = 0.1, noise: float = 0.0, top=None, bottom=None, **header: object
    ) -> Run:
        time_s = np.arange(0.0, end + every / 2, every)
        rng = np.random.default_rng(7)
        platens = {
            "platen_top": (top or (lambda t: 200.0 + 2.0 * np.sin(t / 15.0)))(time_s),
            "platen_bottom": (bottom or (lambda t: 198.0 + 2.0 * np.cos(t / 20.0)))(time_s),
        }
        columns = {name: x + noise * rng.normal(size=len(time_s)) for name, x in platens.items()}
        for name in ("top_1", "top_2", "bottom_1", "bottom_2", "core_1"):
            columns[name] = np.full(len(time_s), np.nan)
        return Run("cycle", BOARD | header, time_s, columns)

    return make


@pytest.fixture
def moments() -> Moments:
    return MOMENTS


@pytest.fixture
def coefficients() -> dict[str, float]:
    return dict(COEFFICIENTS)


@pytest.fixture
def make_rig() -> Callable[..., tuple[ThermalModel, Run]]:
    """A model and run of any stack: press file text, columns with readings, columns without."""

    def make(
        toml: str, time_s, measured: dict, places: dict[str, str], **header: object
    ) -> tuple[ThermalModel, Run]:
        sensors = "".join(f'[[sensor]]\ncolumns = ["{c}"]\nat = {at}\n' for c, at in places.items())
        columns = {name: np.broadcast_to(x, len(time_s)).astype(float) for name, x in measured.items()}
        columns |= {name: np.full(len(time_s), np.nan) for name in places}
        return ThermalModel(parse_press(toml + sensors)), Run(
            "rig", header, np.asarray(time_s, dtype=float), columns
        )

    return make
