"""Every command of README and guide, pasted in order from the top of the sources; every link leads somewhere."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import stat
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from daq.files.mapping import read_foreign, read_mapping
from daq.files.run_file import read_run

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
GUIDE = sorted((ROOT / "deploy" / "guide").glob("*.md"))
PAGES = (README, *GUIDE, ROOT / "deploy" / "RUNBOOK.md")
posix_only = pytest.mark.skipif(os.name == "nt", reason="the guide's commands are for a POSIX shell")


def commands(page: Path) -> list[str]:
    """Return a page's commands but those that set Kerntemp up, which CI runs."""
    blocks = re.findall(r"^```sh\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    lines = [line for block in blocks for line in block.splitlines() if line.strip()]
    return [line for line in lines if "pip install" not in line]


@pytest.fixture
def shell(tmp_path):
    """A shell at the top of the sources, with `kerntemp` on its PATH and room to write."""
    for name in ("samples", "presses", "mappings", "resins"):
        shutil.copytree(ROOT / "deploy" / name, tmp_path / "deploy" / name)
    program = tmp_path / "bin" / "kerntemp"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m api "$@"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    environment = {**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}

    def run(command: str) -> str:
        done = subprocess.run(
            ["/bin/sh", "-ec", command], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=800
        )
        assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        return done.stdout

    return run


@posix_only
@pytest.mark.campaign
@pytest.mark.parametrize("page", [README, *GUIDE], ids=lambda page: page.stem)
def test_every_command_of_the_page_can_be_pasted(page, shell, tmp_path):
    text = "\n".join(shell(command) for command in commands(page))
    if any("diagnose" in command for command in commands(page)):
        assert "moisture_evaporation" in text
    if (tmp_path / "core.csv").is_file():
        table = np.genfromtxt(tmp_path / "core.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
        assert np.isfinite(table["core_C"][table["valid"] == 1]).all()
        assert (table["valid"] == 1).mean() > 0.5


@pytest.mark.campaign
def test_the_lines_of_python_in_the_readme_run(tmp_path):
    (lines,) = re.findall(r"^```python\n(.*?)^```", README.read_text(encoding="utf-8"), flags=re.M | re.S)
    script = tmp_path / "readme.py"
    script.write_text(lines + "assert core['valid'].mean() > 0.5\nassert len(fitted.frame()) > 5\n")
    subprocess.run(
        [sys.executable, str(script)], check=True, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )


@pytest.mark.campaign
@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", GUIDE, ids=lambda page: page.stem)
def test_the_lines_of_python_in_the_guide_run(page, tmp_path):
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    assert blocks or page.stem != "runs"
    for number, lines in enumerate(blocks):
        script = tmp_path / f"{page.stem}_{number}.py"
        script.write_text(lines)
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        subprocess.run([sys.executable, str(script)], check=True, cwd=ROOT, env=environment)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_link_of_the_page_leads_to_a_file(page):
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8"))
    missing = [target for target in targets if not (page.parent / target).exists()]
    assert not missing


def test_the_readme_is_short_and_shows_its_two_commands_first():
    lines = README.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 150
    first, second = re.findall(r"^```sh\n(.*?)^```", "\n".join(lines), flags=re.M | re.S)[:2]
    assert "kerntemp demo" in first
    assert "-m pytest" in second


def test_every_figure_of_the_measured_page_names_a_benchmark_that_is_there():
    page = (ROOT / "deploy" / "guide" / "measured.md").read_text(encoding="utf-8")
    named = set(re.findall(r"tests/[\w/]+\.py", page))
    assert named
    assert not [name for name in named if not (ROOT / name).is_file()]


@pytest.mark.campaign
def test_the_samples_are_those_their_script_makes(tmp_path):
    shutil.copy(ROOT / "deploy" / "samples" / "make_samples.py", tmp_path)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, str(tmp_path / "make_samples.py")], check=True, env=environment)
    samples = ROOT / "deploy" / "samples"
    line2 = read_mapping(samples / "line2.toml")
    written = {p.name for p in tmp_path.iterdir()} - {"foreign.txt"}
    assert written == {p.name for p in samples.iterdir()} - {"foreign.txt", "foreign.toml", "line2.toml"}
    for name in written - {"make_samples.py"}:
        read = read_run if name.endswith(".csv") else partial(read_foreign, mapped=line2)
        new, old = read(tmp_path / name), read(samples / name)
        assert new.header == old.header
        for name, values in old.columns.items():
            assert new.columns[name] == pytest.approx(values, abs=0.11, nan_ok=True), (old.name, name)


@pytest.mark.campaign
def test_five_lines_lead_from_another_loggers_files_to_the_cause_that_the_virtual_press_hid(monkeypatch):
    monkeypatch.chdir(ROOT)
    section = (ROOT / "deploy" / "guide" / "runs.md").read_text(encoding="utf-8").split("## Another logger")[1]
    (lines,) = re.findall(r"^```python\n(.*?)^```", section.split("\n## ")[0], flags=re.M | re.S)
    assert len(lines.split("\n")) - lines.count("\n\n") - 1 == 5
    names = {}
    exec(lines, names)
    hidden = runpy.run_path(str(ROOT / "deploy" / "samples" / "make_samples.py"))["LINE2_HIDDEN"]
    ((cause, (parameter, size)),) = [(cause, *values.items()) for cause, values in hidden.items()]
    found = names["found"]
    assert found.verdict == "named"
    assert list(found.frame().index) == [(cause, parameter)]
    row = found.frame().iloc[0]
    assert row["named"]
    assert row["low"] < size < row["high"]
    assert row["high"] < 1.0  # the side: it is the upper contact that is the worse one
    assert row["value"] == pytest.approx(size, rel=0.05)
    assert f"{row['value']:.2f} of the lower one ({row['low']:.2f} to {row['high']:.2f};" in section
