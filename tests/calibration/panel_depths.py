"""At how many depths a panel that is planned is read (`softsensor.planning.made_up.READ`).

    python -m tests.calibration.panel_depths

Heat taken up and steam as they come out of so many nodes, beside what all cells of the mesh have: largest error,
as a share and of ln p, over panels of 3 to 38 mm, the first eight draws of `made_up.SEED`, platens of 200 °C, and
press times of 5 to 400 s. Of 2026-11-30.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq.press.press_file import parse_press
from daq.records import Array
from daq.simulated.campaign import press_toml
from softsensor.heat.batch import solve_many
from softsensor.heat.case import Case
from softsensor.heat.model_file import FittedValue, ModelFile
from softsensor.opening.steam import steam_pressure
from softsensor.planning.made_up import Programme, Task, ensemble, nodes

DRAWS, MOISTURE_PERCENT, WAITING_S, LONGEST_S = 8, 8.0, 10.0, 400.0
THICKNESSES_MM, NODES = (3.0, 8.0, 16.0, 38.0), (9, 13, 17, 21)
STEP_S = 5


def read_at(case: Case, depths: Array) -> Case:
    """Return the case read at depths of its panel, and in all its cells behind them."""
    layer = case.press.panel_layers[0]
    cells = case.mesh.cells(layer)
    width = float(case.mesh.dx[cells].sum())
    at = [case.mesh.place(layer, z * width) for z in depths]
    places = np.concatenate([np.stack(at), np.eye(len(case.mesh.dx))[cells]])
    labels = tuple(str(i) for i in range(len(places)))
    return replace(case, places=places, labels=labels, columns=(), place_of={}, press_face=np.zeros_like(places))


def errors(thickness_mm: float, count: int) -> tuple[float, float]:
    """Return the largest error of the heat, as a share, and of ln steam."""
    press = parse_press(press_toml())
    known = {n: FittedValue(press.coefficient(n).guess, 0.0) for n in press.coefficient_names}
    header = {"panel.material": "MDF", "panel.thickness_mm": thickness_mm, "panel.initial_temperature_C": 23.0}
    task = Task(press, ModelFile("calibration", press.press.name, known), header, WAITING_S, LONGEST_S)
    drawn, (depths, share) = ensemble(task, Programme(200.0, None)), nodes(count)
    cases = [read_at(case, depths) for case in drawn.cases[:DRAWS]]
    worst = np.zeros(2)
    for case, found in zip(cases, solve_many(drawn.model, cases, list(drawn.values[:DRAWS])), strict=True):
        dx = case.mesh.dx[case.mesh.cells(case.press.panel_layers[0])]
        layers = found.places[int(WAITING_S) + STEP_S :: STEP_S]
        read, cells, whole = layers[:, :count], layers[:, count:], dx / dx.sum()
        start = float(found.places[0, 0])
        heat = (read - start) @ share / ((cells - start) @ whole) - 1.0
        steam = np.log(
            steam_pressure(read, share, MOISTURE_PERCENT) / steam_pressure(cells, whole, MOISTURE_PERCENT)
        )
        worst = np.maximum(worst, [np.abs(heat).max(), np.abs(steam).max()])
    return float(worst[0]), float(worst[1])


if __name__ == "__main__":
    for count in NODES:
        found = np.max([errors(mm, count) for mm in THICKNESSES_MM], axis=0)
        print(f"{count} depths: heat {100 * found[0]:.2f} %, ln steam {found[1]:.3f}")
