"""What a diagnosis answers on the second virtual press: one campaign of twelve runs a cause, and empty ones.

    python -m tests.calibration.second_press FIRST_SEED [NAME ...]

Prints a line a campaign as it is done: what is hidden and its size, the verdict, names with their sets, suspects.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import softsensor
from tests.second_press import SIZES, campaign

EMPTY = 4


def main(first_seed: int, names: list[str]) -> None:
    """Print the table."""
    for number, hidden in enumerate(names or [*SIZES, *[""] * EMPTY]):
        drawn = campaign(first_seed + number, hidden)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "press.toml"
            file.write_text(drawn.press, encoding="utf-8")
            press = softsensor.read_press(file)
        found = softsensor.diagnose([softsensor.read_run(run) for run in drawn.runs], press).content
        named = [" or ".join(effect["set"]) for effect in found["effects"]]
        suspected = [effect["name"] for effect in found["suspected"]]
        left = f"{found['base']['rmse_K']:.2f} -> {found['extended']['rmse_K']:.2f} K"
        print(f"{first_seed + number} {hidden or 'nothing'} {drawn.hidden.size:.3g}: {found['verdict']}", end=" ")
        print(f"{named}, suspected {suspected}, {left} over {found['noise_floor_K']:.2f} K", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
