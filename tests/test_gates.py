"""The gates that stand before every change: formatting, lint, types, and the direction of imports."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TOOLS = Path(sys.executable).parent
TOOL = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
CONTRACTS = TOOL["importlinter"]["contracts"]


@pytest.mark.parametrize(
    "command",
    [
        ("ruff", "format", "--check", "."),
        ("ruff", "check", "."),
        ("mypy",),
        ("lint-imports", "--no-cache"),
        ("oxlint", "api/page"),
    ],
    ids=lambda command: command[0] + "_" + "_".join(word.strip("-.") for word in command[1:]),
)
def test_the_gate_is_open(command):
    tool = TOOLS / command[0]
    done = subprocess.run([str(tool), *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout[-4000:]}\n{done.stderr[-2000:]}"


def test_what_may_not_know_the_virtual_press_is_all_of_production():
    (named,) = [set(c["source_modules"]) for c in CONTRACTS if c.get("forbidden_modules") == ["daq.simulated"]]
    there = {"softsensor"} | {
        f"{package}.{found.name.removesuffix('.py')}"
        for package in ("daq", "api")
        for found in (ROOT / package).iterdir()
        if (found.suffix == ".py" and found.stem != "__init__") or (found / "__init__.py").exists()
    }
    assert there - named == {"daq.simulated", "api.demo"}
    assert named <= there


def unruled(root, contracts):
    """Yield the folders of code that no contract sees whole: without `__init__.py`, or on no exhaustive floors."""
    whole = {name for c in contracts if c.get("exhaustive") for name in c["containers"]}
    files = [path.relative_to(root) for top in ("api", "daq", "softsensor") for path in (root / top).rglob("*.py")]
    folders = {folder for path in files for folder in path.parents if folder.name}
    for folder in sorted(folders):
        modules = [path for path in files if path.parent == folder and path.stem != "__init__"]
        rooms = [other for other in folders if other.parent == folder]
        alone = len(modules) + len(rooms) < 2 or ".".join(folder.parts) in whole
        if not (alone and (root / folder / "__init__.py").exists()):
            yield folder.as_posix()


def test_every_folder_of_code_is_a_package_on_floors_of_its_own():
    assert list(unruled(ROOT, CONTRACTS)) == []


def test_a_room_on_no_floors_and_a_folder_without_init_are_seen(tmp_path):
    room = tmp_path / "softsensor"
    for name in ("planning/side/__init__.py", "planning/side/a.py", "live/ns/x.py"):
        (room / name).parent.mkdir(parents=True, exist_ok=True)
        (room / name).touch()
    for folder in (room, room / "planning", room / "live"):
        (folder / "__init__.py").touch()
    assert list(unruled(tmp_path, CONTRACTS)) == ["softsensor/live/ns"]
    (room / "planning/side/b.py").touch()
    assert list(unruled(tmp_path, CONTRACTS)) == ["softsensor/live/ns", "softsensor/planning/side"]
