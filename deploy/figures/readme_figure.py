"""Draw README's first figure from the virtual press: ``python deploy/figures/readme_figure.py``.

Six pressings with a thermocouple buried in the core; five are fitted, the sixth is predicted scan by
scan from its platens and faces alone, and compared with what the buried thermocouple read.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np

from api.cli import main
from daq.records import Run
from daq.simulated.campaign import Plan, make_campaign, write_campaign
from daq.simulated.campaign_pressfile import press_toml

mpl.use("svg")
mpl.rcParams.update({"svg.hashsalt": "kerntemp", "svg.fonttype": "path", "font.size": 9.5})
from matplotlib import pyplot as plt  # noqa: E402

OUT = Path(__file__).parents[1] / "pictures" / "core.svg"
SEED, RUNS = 11, 6
MEASURED, CORE, TOP, BOTTOM = "#17202b", "#c92a2a", "#e8590c", "#1c7ed6"


def predicted(folder: Path) -> tuple[Run, np.ndarray, np.ndarray]:
    """Return the last run, the live estimates of it, and the virtual press's true core."""
    plan = Plan(rate_hz=5.0, thickness_mm=16.0, closed_column=False, core_column=1.0, press_time_s=(60.0, 110.0))
    campaign = make_campaign(SEED, RUNS, plan=plan)
    files = [str(path) for path in write_campaign(folder, campaign)]
    (folder / "press.toml").write_text(press_toml(), encoding="utf-8")
    press = ["--press", str(folder / "press.toml")]
    model, out = str(folder / "model.json"), folder / "core.csv"
    for command in (
        ["fit", *files[:-1], *press, "--model", model],
        ["predict", files[-1], *press, "--model", model, "--out", str(out)],
    ):
        if main(command) != 0:
            sys.exit(1)
    table = np.genfromtxt(out, delimiter=",", names=True, dtype=None, encoding="utf-8")
    return campaign[-1][0], table, campaign[-1][1].core_C


def draw(run: Run, table: np.ndarray, truth: np.ndarray) -> None:
    """Draw temperatures above, the error of the prediction below."""
    from daq.press.events import find_moments
    from daq.press.press_file import parse_press

    moments = find_moments(run, parse_press(press_toml()))
    time, core = run.time_s - moments.closed_s, run.columns["core_1"]
    error = table["core_C"] - core
    inside = [100 * np.mean((table["core_low_C"] <= c) & (c <= table["core_high_C"])) for c in (truth, core)]
    rms = float(np.sqrt(np.nanmean(error**2)))
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(8.6, 4.6), sharex=True, height_ratios=(3, 1), layout="constrained"
    )
    for axis in (above, below):
        axis.axvspan(0, moments.opened_s - moments.closed_s, color=CORE, alpha=0.06, lw=0)
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(color="#dfe3e8", lw=0.6)
    for pattern, colour, name in (("top_*", TOP, "upper face"), ("bottom_*", BOTTOM, "lower face")):
        for i, column in enumerate(run.matching([pattern])):
            above.plot(
                time[::3],
                run.columns[column][::3],
                color=colour,
                lw=0.7,
                alpha=0.7,
                label=name if i == 0 else None,
            )
    above.fill_between(time, table["core_low_C"], table["core_high_C"], color=CORE, alpha=0.22, lw=0)
    above.plot(time, table["core_C"], color=CORE, lw=2, label="core, predicted live, with 95 % band")
    above.plot(
        time[::15], core[::15], ".", color=MEASURED, ms=3.5, label="core, measured by a buried thermocouple"
    )
    for at, text in ((0.0, "press closes"), (moments.opened_s - moments.closed_s, "opens")):
        above.axvline(at, color="#5a6675", lw=0.8, ls=":")
        above.annotate(
            text,
            (at, 0.11),
            xycoords=("data", "axes fraction"),
            xytext=(3, 0),
            textcoords="offset points",
            color="#5a6675",
            fontsize=8.5,
        )
    above.set_ylabel("temperature [°C]")
    above.set_title(
        f"The core, known to {rms:.1f} K from sensors on the faces alone",
        loc="left",
        fontsize=10.5,
        fontweight="bold",
    )
    above.legend(frameon=False, fontsize=8.5, loc="center", bbox_to_anchor=(0.34, 0.5))
    below.fill_between(
        time,
        table["core_low_C"] - table["core_C"],
        table["core_high_C"] - table["core_C"],
        color=CORE,
        alpha=0.22,
        lw=0,
    )
    below.plot(time, -error, ".", color=MEASURED, ms=1.5)
    below.set_title(
        f"the band holds the true core {inside[0]:.0f} %, the thermocouple in it {inside[1]:.0f} % of the time",
        loc="right",
        fontsize=8.5,
    )
    below.set_ylabel("measured −\npredicted [K]")
    below.set_xlabel("time since the press closed [s]")
    OUT.parent.mkdir(exist_ok=True)
    figure.savefig(OUT, metadata={"Date": None})


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        draw(*predicted(Path(place)))
