"""The gates that stand before every change: formatting, lint, types, and the direction of imports."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TOOLS = Path(sys.executable).parent


@pytest.mark.parametrize(
    "command",
    [("ruff", "format", "--check", "."), ("ruff", "check", "."), ("mypy",), ("lint-imports", "--no-cache")],
    ids=lambda command: command[0] + "_" + "_".join(word.strip("-.") for word in command[1:]),
)
def test_the_gate_is_open(command):
    tool = TOOLS / command[0]
    done = subprocess.run([str(tool), *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout[-4000:]}\n{done.stderr[-2000:]}"


def test_what_may_not_know_the_virtual_press_is_all_of_production():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (named,) = [set(c["source_modules"]) for c in contracts if c.get("forbidden_modules") == ["daq.simulated"]]
    there = {"softsensor"} | {
        f"{package}.{found.name.removesuffix('.py')}"
        for package in ("daq", "api")
        for found in (ROOT / package).iterdir()
        if (found.suffix == ".py" and found.stem != "__init__") or (found / "__init__.py").exists()
    }
    assert there - named == {"daq.simulated", "api.demo"}
    assert named <= there
