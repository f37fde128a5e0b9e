"""The command that runs all campaigns, on small ones of its own."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TESTS = """
import os, time
from pathlib import Path
import pytest
from tests.editions import edition

pytestmark = pytest.mark.campaign
COUNTS = Path(__file__).with_name("counts")

@pytest.mark.parametrize("n", edition([1], [1, 2]))
def test_first(n):
    with COUNTS.open("a") as out:
        out.write("first ")

def test_second():
    with COUNTS.open("a") as out:
        out.write("second ")
    while not COUNTS.with_name("go-on").exists():
        time.sleep(0.02)

def test_third():
    pytest.skip("no such part")

def test_fourth():
    assert COUNTS.read_text() == "nothing"
"""


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_broken_off_it_goes_on_where_it_was_and_prints_one_table(tmp_path):
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests/test_own.py").write_text(TESTS, encoding="utf-8")
    command = [sys.executable, "-m", "tests.campaigns", "--folder", str(tmp_path / "out"), "--root", str(tmp_path)]
    counts, own = tmp_path / "tests/counts", {**os.environ, "PYTHONPATH": str(ROOT)}
    begun = subprocess.Popen(command, cwd=ROOT, env=own, stdout=subprocess.DEVNULL, start_new_session=True)
    try:
        while not (counts.exists() and "second" in counts.read_text(encoding="utf-8")):
            assert begun.poll() is None
            time.sleep(0.05)
    finally:
        os.killpg(begun.pid, signal.SIGKILL)
        begun.wait()
    (tmp_path / "tests/go-on").touch()
    done = subprocess.run([*command, "--resume"], cwd=ROOT, env=own, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert counts.read_text(encoding="utf-8").split() == ["first", "first", "second", "second"]
    *rows, total = done.stdout.splitlines()[-6:]
    assert [row.split()[0] for row in rows] == ["failed", "skipped", "passed", "passed", "passed"]
    assert total == "1 failed, 1 skipped, 3 passed"


LEFT_OUT = {
    "tests/api/test_demo.py": "its night takes 9 min on a busy machine",
}
"""Files whose campaigns `.ci/run` leaves out whole."""


def test_no_file_with_a_campaign_is_forgotten_where_ci_runs_them():
    words = (ROOT / ".ci/run").read_text(encoding="utf-8").partition(" -m campaign ")[2].split()
    known = {"$catalogue": "tests/softsensor/test_diagnosis_catalogue.py"}
    run = [ROOT / known.get(word, word) for word in words if word.startswith(("tests/", "$"))]
    marked = [
        file
        for file in (ROOT / "tests").rglob("test_*.py")
        if file != Path(__file__) and "mark.campaign" in file.read_text(encoding="utf-8")
    ]
    assert len(marked) > 20
    forgotten = {file.relative_to(ROOT).as_posix() for file in marked if not {file, *file.parents} & {*run}}
    assert forgotten <= set(LEFT_OUT)
