"""Make the sample runs anew: ``python deploy/samples/make_samples.py``.

Ten pressings of a virtual press at one scan a second, with water that leaves the panel: what `kerntemp diagnose`
finds in them. Every third carries a thermocouple in the core. ``foreign.txt`` is the last of them as another
logger might have written it, for a mapping of one's own. ``line2_01_16mm.txt`` and its sisters are a campaign of
another press with another cause, as a third logger wrote it: degrees Fahrenheit, six thermocouples, a clock
without a date, thicknesses in the files' names. One seed makes them all the same on every machine.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq.files.run_file import write_run
from daq.records import Run
from daq.simulated.campaign import Plan, make_campaign

HERE = Path(__file__).parent
SEED, RUNS = 2026, 10
HIDDEN = "moisture_evaporation"
LINE2_SEED, LINE2_RUNS = 2027, 8
LINE2_HIDDEN = {"contact_asymmetry": {"ratio": 0.7}}
"""The upper face's contact while closed, in units of the lower face's: a worn upper plate."""
LINE2_COLUMNS = {
    "platen_top": "Platen up (F)",
    "platen_bottom": "Platen low (F)",
    "top_1": "Up A (F)",
    "top_2": "Up B (F)",
    "bottom_1": "Low A (F)",
    "bottom_2": "Low B (F)",
}


def short(run: Run, number: int) -> Run:
    """Return a run as the samples carry it: named by day and number, readings to 0.1 K."""
    name = f"2026-03-04-{number:02d}"
    times = np.round(run.time_s, 3)
    columns = {c: v if c == "closed" else np.round(v, 1) for c, v in run.columns.items()}
    header = {**run.header, "run": name}
    return replace(run, name=name, time_s=times, header=header, columns=columns, texts={})


def foreign(run: Run) -> str:
    """Return a run as a logger with decimal commas, semicolons and a clock of its own writes it."""
    lines = ["Messung;Laborpresse", "Zeit;HP oben;HP unten;O1;O2;U1;U2", ";°C;°C;°C;°C;°C;°C"]
    columns = ("platen_top", "platen_bottom", "top_1", "top_2", "bottom_1", "bottom_2")
    for i, time in enumerate(run.time_s):
        minutes, seconds = divmod(8 * 3600 + 30 * 60 + round(time - run.time_s[0]), 60)
        cells = (f"{run.columns[c][i]:.1f}".replace(".", ",").replace("nan", "---") for c in columns)
        lines.append(";".join((f"04.03.2026 {minutes // 60:02d}:{minutes % 60:02d}:{seconds:02d}", *cells)))
    return "\n".join(lines) + "\n"


def fahrenheit(run: Run) -> str:
    """Return a run as a logger with degrees Fahrenheit, tabs and the time of day writes it."""
    hall = f"{1.8 * float(run.header['ambient.temperature_C']) + 32.0:.1f}"  # type: ignore[arg-type]
    lines = ["Line 2, hot press", "\t".join(("Clock", *LINE2_COLUMNS.values(), "Hall (F)"))]
    for i, time in enumerate(run.time_s):
        seconds = 14 * 3600 + round(10.0 * float(time)) / 10.0
        clock = f"{int(seconds // 3600):02d}:{int(seconds // 60) % 60:02d}:{seconds % 60.0:04.1f}"
        cells = (f"{1.8 * float(run.columns[name][i]) + 32.0:.1f}".replace("nan", "") for name in LINE2_COLUMNS)
        lines.append("\t".join((clock, *cells, hall)))
    return "\n".join(lines) + "\n"


def write_line2() -> None:
    """Write the campaign of the second line, whose readings only a mapping explains."""
    plan = Plan(
        rate_hz=1.0,
        thickness_mm=(12.0, 16.0),
        press_time_s=(30.0, 60.0),
        open_before_s=(5.0, 15.0),
        open_after_s=(20.0, 35.0),
        start_before_s=8.0,
        closed_column=False,
    )
    for number, (run, _) in enumerate(make_campaign(LINE2_SEED, LINE2_RUNS, LINE2_HIDDEN, plan), start=1):
        file = HERE / f"line2_{number:02d}_{run.header['panel.thickness_mm']:.0f}mm.txt"
        file.write_text(fahrenheit(run), encoding="utf-8")


def main() -> None:
    """Write the sample files beside this script."""
    plan = Plan(rate_hz=1.0, closed_column=False, core_column=0.34, start_before_s=8.0, panel_spread=0.0)
    campaign = make_campaign(SEED, RUNS, effects=HIDDEN, plan=plan)
    for number, (run, _) in enumerate(campaign, start=1):
        made = short(run, number)
        write_run(made, HERE / f"{made.name}.csv")
    (HERE / "foreign.txt").write_text(foreign(made), encoding="utf-8")
    write_line2()
    sys.stdout.write(f"{RUNS} runs, hidden: {campaign[0][1].effects}; {LINE2_RUNS} runs, hidden: {LINE2_HIDDEN}\n")


if __name__ == "__main__":
    main()
