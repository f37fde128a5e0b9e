"""The page's modules: what they import is there, named and used, and their imports run one way."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "api" / "page"
IMPORT = re.compile(r'^import .*? from "(\.[^"]+)";$', re.MULTILINE)


def imports():
    return {
        file: {(file.parent / name).resolve() for name in IMPORT.findall(file.read_text("utf-8"))}
        for file in PAGE.rglob("*.js")
        if "vendor" not in file.parts
    }


@pytest.mark.parametrize(
    ("file", "line", "fault"),
    [
        ("views/loggers.js", "clock();", "'clock' is not defined"),
        ("views/loggers.js", 'import { when } from "../dom.js";', "'when' is imported but never used"),
        ("views/loggers.js", 'import { wen } from "../dom.js"; wen();', "wen"),
        ("words.js", 'import { el } from "./dom.js"; el();', "Dependency cycle"),
    ],
    ids=["not_imported", "not_used", "not_exported", "circle"],
)
def test_the_page_s_linter_sees_a_wrong_import(tmp_path, file, line, fault):
    shutil.copytree(PAGE, tmp_path, dirs_exist_ok=True, ignore=shutil.ignore_patterns("vendor"))
    assert lint(tmp_path).returncode == 0
    module = tmp_path / file
    module.write_text(f"{line}\n{module.read_text('utf-8').replace('clock, ', '')}", encoding="utf-8")
    found = lint(tmp_path)
    assert found.returncode == 1
    assert fault in found.stdout


def lint(folder):
    linter = Path(sys.executable).parent / "oxlint"
    command = [linter, "--config", ROOT / ".oxlintrc.json", folder]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_every_module_the_page_imports_is_there():
    found = imports()
    assert not [name for names in found.values() for name in names if name not in found]
    assert PAGE / "views" / "now.js" in found[PAGE / "app.js"]


def test_the_page_has_no_number_of_the_plant_or_the_charts_of_its_own():
    """What it may call seconds or kelvins is how it draws: what lies together, what is bridged, what shows."""
    named = re.compile(r"^(?:export )?const ([A-Z_]+_(?:C|K|S|RUNS)) = [0-9]", re.MULTILINE)
    own = {name for file in imports() for name in named.findall(file.read_text("utf-8"))}
    assert own == {"BRIDGE_S", "SHOWN_K", "STEP_S", "TOGETHER_S"}
