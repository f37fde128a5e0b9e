"""However pytest ends, nothing that its tests started goes on; in CI a missing part is no reason to skip."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.guarding import _zombie

ROOT = Path(__file__).parents[1]
TESTS = """
import multiprocessing, os, subprocess, sys, threading, time
from pathlib import Path
from tests.guarding import guard

guard()
PLACE = Path(__file__).parent
FOREVER = "import os, sys, time; open(sys.argv[1], 'w').write(str(os.getpid())); time.sleep(600)"
BETWEEN = "import subprocess, sys; subprocess.Popen([sys.executable, '-c', sys.argv[1], sys.argv[2]])"

def forked():
    (PLACE / "forked.pid").write_text(str(os.getpid()))
    time.sleep(600)

def test_that_starts_processes_of_every_kind():
    one = [sys.executable, "-c", FOREVER]
    subprocess.Popen([*one, PLACE / "session.pid"], start_new_session=True)
    subprocess.run([sys.executable, "-c", BETWEEN, FOREVER, PLACE / "orphan.pid"], check=True)
    multiprocessing.get_context("fork").Process(target=forked).start()
    (PLACE / "pytest.pid").write_text(str(os.getpid()))
    while not (PLACE / "end").exists():
        time.sleep(0.02)
    os._exit(3)
"""
STARTED = ("session", "orphan", "forked")


def wait_until(happened):
    while not happened():  # the test's own time limit ends it
        time.sleep(0.02)


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="reads Linux's /proc")
@pytest.mark.parametrize("way", ["killed", "by itself"])
def test_what_a_test_started_ends_with_pytest(tmp_path, way):
    (tmp_path / "test_own.py").write_text(TESTS, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    own = {**os.environ, "PYTHONPATH": str(ROOT)}
    tests = subprocess.Popen(command, cwd=tmp_path, env=own, stdout=subprocess.DEVNULL)
    files = [tmp_path / f"{name}.pid" for name in (*STARTED, "pytest")]
    wait_until(lambda: all(file.exists() and file.read_text() for file in files) or tests.poll() is not None)
    numbers = [int(file.read_text()) for file in files]
    assert not any(_zombie(number) for number in numbers)
    if way == "killed":
        os.kill(numbers[-1], signal.SIGKILL)
    else:
        (tmp_path / "end").touch()
    assert tests.wait() == (-signal.SIGKILL if way == "killed" else 3)
    wait_until(lambda: all(_zombie(number) for number in numbers))


@pytest.mark.parametrize(("strict", "outcome"), [("", "2 skipped"), ("1", "2 failed")])
def test_a_missing_part_is_a_skip_at_home_and_a_failure_in_ci(tmp_path, strict, outcome):
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/deploy/test_monitoring.py"]
    done = subprocess.run(
        [*command, "-k", "prometheus_own_tool"],
        cwd=ROOT,
        env={**os.environ, "PATH": str(tmp_path), "KERNTEMP_ALL_PARTS": strict},
        capture_output=True,
        text=True,
        check=False,
    )
    assert outcome in done.stdout.splitlines()[-1], done.stdout
    assert ("no promtool is installed" in done.stdout) == bool(strict)
