"""How long must a panel stay in the press? The core at opening for many thicknesses and press times at once.

A hundred pressings that differ in thickness, press time and platen temperature are solved side by side
(`softsensor.heat.batch.solve_many`), at about a third of a millisecond each once the kernels are loaded: short
enough to lay a window of press times out anew whenever a fit moves the coefficients.

Run it from the project's folder, with a model file of your press or without:

    python deploy/examples/press_window/core_at_opening.py [model.json]
"""

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from daq.press.press_file import read_press
from daq.records import Moments, Run
from softsensor.heat.batch import solve_many
from softsensor.heat.model import ThermalModel
from softsensor.jobs.model_files import read_model

PRESS = Path(__file__).parents[2] / "presses" / "lab.toml"
THICKNESSES_MM = (8.0, 10.0, 12.0, 16.0, 19.0)
PRESS_TIMES_S = (30.0, 45.0, 60.0, 90.0, 120.0, 150.0, 180.0, 240.0, 300.0, 360.0)
PLATENS_C = (180.0, 200.0)
CLOSED_S = 10.0


def pressing(thickness_mm: float, platen: float) -> Run:
    """Return a run that has not been measured: a panel at 20 °C between platens at a set temperature."""
    time_s = np.arange(0.0, CLOSED_S + PRESS_TIMES_S[-1] + 10.0, 1.0)
    columns = {name: np.full(len(time_s), platen) for name in ("platen_top", "platen_bottom")}
    header = {
        "panel.material": "MDF",
        "panel.thickness_mm": thickness_mm,
        "panel.initial_temperature_C": 20.0,
        "ambient.temperature_C": 23.0,
    }
    return Run(f"{thickness_mm:g} mm, {platen:g} °C", header, time_s, columns)


def window(model: ThermalModel, values: dict[str, float]) -> np.ndarray:
    """Return the core at opening by platen temperature, thickness and press time. [°C]"""
    cases = []
    for platen in PLATENS_C:
        for thickness in THICKNESSES_MM:
            run = pressing(thickness, platen)
            for press_time in PRESS_TIMES_S:
                moments = Moments(inserted_s=0.0, closed_s=CLOSED_S, opened_s=CLOSED_S + press_time)
                cases.append(model.prepare(run, moments))
    with ThreadPoolExecutor(2) as pool:
        found = solve_many(model, cases, values, pool.map)
    core = [
        np.interp(case.moments.opened_s, case.run.time_s, solution.core)
        for case, solution in zip(cases, found, strict=True)
    ]
    return np.reshape(core, (len(PLATENS_C), len(THICKNESSES_MM), len(PRESS_TIMES_S)))


def main() -> None:
    """Print one table for each platen temperature."""
    press = read_press(PRESS)
    if len(sys.argv) > 1:
        known = read_model(Path(sys.argv[1]))
        model, values = known.model(press), known.values
    else:
        model = ThermalModel(press)
        values = model.guesses
    for platen, table in zip(PLATENS_C, window(model, values), strict=True):
        print(f"\nplatens at {platen:g} °C: core at opening [°C]")  # noqa: T201
        print("press time s " + "".join(f"{t:6.0f}" for t in PRESS_TIMES_S))  # noqa: T201
        for thickness, row in zip(THICKNESSES_MM, table, strict=True):
            print(f"{thickness:9.0f} mm " + "".join(f"{core:6.0f}" for core in row))  # noqa: T201


if __name__ == "__main__":
    main()
