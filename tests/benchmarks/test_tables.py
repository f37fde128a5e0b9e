"""A million rows of a press: between tables, runs and files, beside what pandas takes for the same file."""

import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest

import daq
import softsensor
from daq.files.run_file import write_run

ROWS = 1_000_000
FACES = [f"{face}_{number}" for face in ("top", "bottom") for number in range(1, 8)]


def spent(work):
    """Processor time of one call, and what it returned. [s]"""
    began = time.process_time()
    found = work()
    return time.process_time() - began, found


@pytest.mark.benchmark
@pytest.mark.timeout(1200)
def test_time_of_a_million_rows(tmp_path):
    rng = np.random.default_rng(1)
    columns = {
        name: np.round(rng.normal(150.0, 20.0, ROWS), 2) for name in ("platen_top", "platen_bottom", *FACES)
    }
    frame = pd.DataFrame(columns, index=pd.Index(0.1 * np.arange(ROWS), name="time_s"))
    frame.attrs["panel.material"] = "MDF"
    instants = frame.set_index(pd.date_range("2026-03-04", periods=ROWS, freq="100ms", tz="UTC"))
    telling = frame.assign(quality=np.where(np.arange(ROWS) % 1000, "", "top_3=open"))
    objects = frame.astype(object)
    phases = frame.assign(phase=pd.Categorical(np.where(np.arange(ROWS) % 1000, "hot", "cold")))
    daq.frame_of(daq.run_of(frame.head()))
    run = daq.run_of(frame)
    parquet, csv = tmp_path / "run.parquet", tmp_path / "run.csv"
    write_run(run, parquet)
    write_run(run, csv)
    mapping = tmp_path / "map.toml"
    with csv.open() as lines:
        line = next(number for number, text in enumerate(lines, 1) if not text.startswith("#"))
    mapping.write_text(
        f'[file]\nheader_line = {line}\n[time]\ncolumn = "time_s"\n'
        + "".join(f'[[column]]\nfrom = "{name}"\nto = "{name}"\n' for name in columns)
    )
    seconds = {
        "table to run": spent(lambda: daq.run_of(frame))[0],
        "table of instants to run": spent(lambda: daq.run_of(instants))[0],
        "table with qualities to run": spent(lambda: daq.run_of(telling))[0],
        "table of objects to run": spent(lambda: daq.run_of(objects))[0],
        "table of categories to run": spent(lambda: daq.run_of(phases))[0],
        "run to table": spent(lambda: daq.frame_of(run))[0],
        "run to table of instants": spent(lambda: daq.frame_of(daq.run_of(instants), utc=True))[0],
        "Parquet to run": spent(lambda: softsensor.read_run(parquet))[0],
        "Parquet to table, pandas": spent(lambda: pd.read_parquet(parquet))[0],
        "CSV to run": spent(lambda: softsensor.read_run(csv))[0],
        "CSV to table, pandas": spent(lambda: pd.read_csv(csv, comment="#"))[0],
        "CSV to run, by a mapping": spent(lambda: softsensor.read_run(csv, mapping=mapping))[0],
        "find closing and opening": spent(lambda: daq.find_moments(run, daq.shared_files() / "presses/lab.toml"))[
            0
        ],
    }
    print(f"\n{ROWS} rows of {len(columns)} channels, processor time:")
    for what, took in seconds.items():
        print(f"{what:30s} {took:7.2f} s  {ROWS / took / 1e6:6.2f} million rows/s")


@pytest.mark.benchmark
def test_time_of_a_start():
    for what in ("import softsensor, daq", "import api.cli; api.cli.main(['--help'])", "import pandas", "pass"):
        code = f"import time\n{what}\nprint(time.process_time())"
        found = [
            float(
                subprocess.run(
                    [sys.executable, "-c", code], capture_output=True, text=True, check=True
                ).stdout.split()[-1]
            )
            for _ in range(5)
        ]
        print(f"{what:45s} {min(found):.2f} s of processor time")
