"""What the paper's printed table of heat transfer coefficients would do to a panel.

The table gives, in W/m²K: h_pp,c 2.27, h_p,c 62.19, h_pp,o 9.58, h_p,o 360.89, h_wa 58.99, h_ap 24.12
(c closed, o open; p couples platen and press plate, pp couples press plate and panel, as in the paper's
figure of the layers). Taken literally, closing the press would weaken both contacts, and a pressed
joint would insulate like 14 mm of still air: no panel face gets warm enough to cure resin (above some
130 °C within half a minute). The paper's table of transitions also swaps the two labels for the open
press. This script solves one pressing under each reading and prints the face temperature. Only closed
values in kW/m²K laminate at all; whether a unit was lost in print cannot be told from here.

Run it from the project's folder:  python deploy/examples/paper_table/face_temperature.py [figure.svg]
"""

import sys
from pathlib import Path

import numpy as np

from daq.press.press_file import read_press
from daq.records import Moments, Run
from softsensor.heat.model import ThermalModel

AIR = {"h_wa": 58.99, "h_ap": 24.12}
READINGS = {
    "as printed": {"h_pp_c": 2.27, "h_p_c": 62.19, "h_pp_o": 9.58, "h_p_o": 360.89},
    "p and pp swapped": {"h_pp_c": 62.19, "h_p_c": 2.27, "h_pp_o": 360.89, "h_p_o": 9.58},
    "swapped for the open press only": {"h_pp_c": 2.27, "h_p_c": 62.19, "h_pp_o": 360.89, "h_p_o": 9.58},
    "swapped for the closed press only": {"h_pp_c": 62.19, "h_p_c": 2.27, "h_pp_o": 9.58, "h_p_o": 360.89},
    "open and closed exchanged": {"h_pp_c": 9.58, "h_p_c": 360.89, "h_pp_o": 2.27, "h_p_o": 62.19},
    "closed values in kW/m²K": {"h_pp_c": 2270.0, "h_p_c": 62190.0, "h_pp_o": 9.58, "h_p_o": 360.89},
}
INSERTED, CLOSED, OPENED, END = 0.0, 10.0, 70.0, 90.0
CURES = 130.0
"""Below this no resin cures within a pressing. [°C]"""


def faces() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the times and, by reading, the mean face temperature. [s, °C]"""
    press = read_press(Path(__file__).parent / "press.toml")
    time_s = np.arange(0.0, END + 0.05, 0.1)
    columns = {name: np.full(len(time_s), 180.0) for name in ("platen_top", "platen_bottom")}
    columns |= {name: np.full(len(time_s), np.nan) for name in ("top_1", "bottom_1")}
    header = {
        "panel.material": "MDF",
        "panel.thickness_mm": 18.0,
        "panel.initial_temperature_C": 20.0,
        "ambient.temperature_C": 23.0,
    }
    run = Run("paper table", header, time_s, columns)
    model = ThermalModel.of(press)
    case = model.prepare(run, Moments(inserted_s=INSERTED, closed_s=CLOSED, opened_s=OPENED, ramp_s=0.5))
    return time_s, {
        name: model.solve(case, values | AIR).sensors.mean(axis=1) for name, values in READINGS.items()
    }


def table(time_s: np.ndarray, found: dict[str, np.ndarray]) -> str:
    """Return the table as text."""
    lines = [f"{'reading':36s} {'15 s':>6s} {'30 s':>6s} {'60 s':>6s}   °C at the panel's faces after closing"]
    for name, face in found.items():
        at = [float(np.interp(CLOSED + t, time_s, face)) for t in (15.0, 30.0, 59.0)]
        verdict = "laminates" if at[1] >= CURES else "no lamination possible"
        lines.append(f"{name:36s} {at[0]:6.0f} {at[1]:6.0f} {at[2]:6.0f}   {verdict}")
    return "\n".join(lines)


def draw(time_s: np.ndarray, found: dict[str, np.ndarray], path: Path) -> None:
    """Write the figure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.subplots()
    for name, face in found.items():
        axes.plot(time_s - CLOSED, face, label=name)
    axes.axhline(CURES, color="0.6", linestyle=":", label="resin cures above")
    axes.axvspan(0.0, OPENED - CLOSED, color="0.95")
    axes.set(xlabel="time since closing [s]", ylabel="face of the panel [°C]")
    axes.set_title("Only closed values in kW/m²K heat the face enough to laminate")
    axes.legend(fontsize="small")
    figure.savefig(path)


if __name__ == "__main__":
    times, temperatures = faces()
    print(table(times, temperatures))  # noqa: T201
    if len(sys.argv) > 1:
        draw(times, temperatures, Path(sys.argv[1]))
