"""What cells and steps of the heat model are worth, in kelvins: ``python -m tests.calibration.steps``.

Sample runs 1, 4 and 7 (made by seed 2026) are solved at the press file's guesses by cells and steps a quarter as
large, and printed is how far the usual ones are from that: at the faces, at most over all rows and over those a
second or more from a moment of the press, and in the core. Then each number that lays cells and steps out is taken
twice as large and half as large (of a growth its excess over 1), by itself, and printed is how much that moves the
usual answer. A diagnosis' longest step is held against a third of it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import daq
import softsensor
from softsensor.heat import case, exact, mesh, readout, timing
from softsensor.heat.model import ThermalModel
from softsensor.signals import digest
from softsensor.signals.moments import moments_of
from tests.calibration.set_by_hand import put

FINER = 4.0
PRESS = softsensor.read_press(daq.shared_files() / "presses/lab.toml")
RUNS = [softsensor.read_run(daq.shared_files() / f"samples/2026-03-04-{n:02d}.csv") for n in (1, 4, 7)]
PLACED = [(run, moments_of(run, PRESS)) for run in RUNS]
GUESSES = {name: PRESS.coefficient(name).guess for name in PRESS.coefficient_names}
TANGENT = "h_pp_c"
"""The exact solver's longer steps are those of tangents; this one is moved by 1 % for what it does. [K]"""
IMPLICIT = (
    (mesh, ("QUICK_S", "EQUAL_CELLS", "FIRST_S", "WIDEST_S", "WIDEST_SHARE", "WIDER")),
    (case, ("FINE_STEP_S", "GROWTH", "HANDLED_S", "SWITCHED_S", "LAST_STEP")),
    (readout, ("COARSE_STEP_S",)),
    (timing, ("OPENING_RAMP_S", "HANDLING_RAMP_S", "SHORTEST_RAMP_S")),
)
EXACT = ((exact, ("FIRST_STEP_S", "GROWTH", "RAMP_STEP_S", "COARSE_STEP_S", "ALL_ROWS_S", "AT_ONCE", "KEPT")),)


def _calm() -> np.ndarray:
    """Return which rows lie later than a second after each moment of the press, and before the next."""
    found = []
    for run, m in PLACED:
        moments = [t for t in (m.inserted_s, m.closed_s, m.opened_s, m.removed_s) if np.isfinite(t)]
        since = run.time_s[:, None] - np.array(moments)
        found.append(~((since > -1.0) & (since < 1.0)).any(axis=1))
    return np.concatenate(found)


CALM = _calm()


def implicit(fineness: float = 1.0, longest_s: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Return faces and core of all rows, steps laid out by what the modules hold now. [°C]"""
    model = ThermalModel(PRESS)
    found = []
    for run, moments in PLACED:
        laid = model.prepare(
            run,
            moments,
            fineness=fineness,
            max_step_s=longest_s,
            switch_step_s=case.FINE_STEP_S,
            growth=case.GROWTH,
        )
        solved = model.solve(laid, GUESSES)
        found.append((solved.places[:, :2], solved.core))
    return np.concatenate([f for f, _ in found]), np.concatenate([c for _, c in found])


def by_modes() -> tuple[np.ndarray, np.ndarray]:
    """Return faces and core by the exact solver, with what a contact larger by 1 % adds to each. [°C]"""
    model = ThermalModel(PRESS)
    found = []
    for run, moments in PLACED:
        solved = model.solve(model.prepare(run, moments), GUESSES, (TANGENT,), method="exact")
        share = 0.01 * GUESSES[TANGENT]
        change = np.asarray(solved.d_sensors[TANGENT]).mean(axis=1)
        faces = np.column_stack([solved.places[:, :2], share * change])
        found.append((faces, solved.core + share * solved.d_core[TANGENT]))
    return np.concatenate([f for f, _ in found]), np.concatenate([c for _, c in found])


def apart(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> str:
    """Say how far two answers lie apart, at the faces, there in calm rows, and in the core. [mK]"""
    faces, core = (np.abs(a - b) for a, b in zip(one, other, strict=True))
    return f"{1e3 * np.nanmax(faces):8.2f} {1e3 * np.nanmax(faces[CALM]):8.2f} {1e3 * np.nanmax(core):8.2f}"


def changed(name: str, value: float) -> Iterator[float]:
    """Yield a number twice and half as large."""
    for factor in (2.0, 0.5):
        other = 1.0 + factor * (value - 1.0) if name == "GROWTH" else factor * value
        yield int(other) if isinstance(value, int) else other


def main() -> None:
    """Print the table."""
    print("faces, faces in calm rows, core, at most [mK]")
    for solver, numbers in ((implicit, IMPLICIT), (by_modes, EXACT)):
        usual = solver()
        if solver is implicit:
            print(f"{'usual against a quarter':40s} {apart(usual, implicit(FINER))}")
            rough = implicit(longest_s=digest.STEP_S)
            print(f"{'longest step of a diagnosis':40s} {apart(rough, implicit(longest_s=digest.STEP_S / 3.0))}")
        for module, names in numbers:
            for name in names:
                value = getattr(module, name)
                for other in changed(name, value):
                    put(module.__name__, name, other)
                    try:
                        moved = apart(solver(), usual)
                    except (ValueError, ArithmeticError) as fault:
                        moved = type(fault).__name__
                    finally:
                        put(module.__name__, name, value)
                    print(f"{module.__name__[16:]}.{name:20s} {value:8g} -> {other:8g} {moved}", flush=True)


if __name__ == "__main__":
    main()
