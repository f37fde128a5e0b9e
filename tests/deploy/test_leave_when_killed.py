"""Leave to open, given by the real processes on a virtual press, and what is left of it when one is killed."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from api.answers.present import SILENT_S
from tests.browser.conftest import free_port
from tests.daq.test_recorder import plant, wait_until

pytestmark = [
    pytest.mark.campaign,
    pytest.mark.timeout(900),
    pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX"),
]
ROOT = Path(__file__).parents[2]
RESIN = """
[resin]
name = "quick"
source = "made up: it cures at once, so that leave is given in every pressing"
[order]
rate_per_s = 0.2
activation_energy_kJ_mol = 20.0
[limits]
cure_least = 0.1
"""
STATED = ', "panel.conductivity_W_mK.sd" = 0.002, "panel.heat_capacity_J_kgK.sd" = 20.0'
ANSWER_S = 3.0
"""A busy machine may take so long to answer. [s]"""


class Plant:
    """Processes of one configuration, each killed by its name."""

    def __init__(self, config):
        self.config, self.port = config, free_port()
        self.running = {}

    def start(self, name, *more):
        command = [sys.executable, "-m", "api", name, "--config", str(self.config), *more]
        with (self.config.parent / f"{name}.log").open("w") as log:
            self.running[name] = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log)

    def kill(self, name):
        self.running[name].send_signal(signal.SIGKILL)
        self.running[name].wait()
        return time.monotonic()

    def ask(self, path):
        return httpx.get(f"http://127.0.0.1:{self.port}/api/v1/{path}", timeout=60).json()["items"][0]

    def allowed(self):
        press, advice = self.ask("press"), self.ask("advice")["advice"]
        assert press["estimate"] is None or press["estimate"]["open_now"] is False or press["state"] == "closed"
        given = press["estimate"] is not None and press["estimate"]["open_now"]
        return given and advice["verdict"] == "open_now"


@contextmanager
def running(folder, speed=1.0):
    with plant(folder, speed=speed, rate_hz=5.0) as made:
        text = made.config.read_text()
        (folder / "resin.toml").write_text(RESIN)
        text = text.replace('file = "lab.toml"\n', 'file = "lab.toml"\nresin = "resin.toml"\n')
        made.config.write_text(text.replace('"panel.thickness_mm" = 16.0', '"panel.thickness_mm" = 16.0' + STATED))
        found = Plant(made.config)
        found.start("serve", "--port", str(found.port))
        found.start("sense")
        found.start("record")
        try:
            yield found
        finally:
            for process in found.running.values():
                process.kill()
                process.wait()


@pytest.mark.parametrize(("victim", "reason"), [("record", "no scans"), ("sense", "live sensor silent")])
def test_leave_given_is_taken_back_within_seconds_of_a_kill(tmp_path, victim, reason):
    with running(tmp_path) as made:

        def given():
            assert all(process.poll() is None for process in made.running.values())
            try:
                return made.allowed()
            except (httpx.TransportError, KeyError, IndexError):
                return False  # not up yet

        wait_until(given, 600)
        killed = made.kill(victim)
        wait_until(lambda: not made.allowed(), 60)
        took = time.monotonic() - killed
        print(f"\n{victim} killed: leave taken back after {took:.1f} s")
        assert took < SILENT_S + ANSWER_S
        press, advice = made.ask("press"), made.ask("advice")["advice"]
        assert press["estimate"]["reason"] == reason
        assert (press["estimate"]["valid"], press["estimate"]["core_C"]) == (False, None)
        assert press["estimate"]["age_s"] > SILENT_S
        assert advice["verdict"] == "not_known"
        assert press["state"] == ("unknown" if victim == "record" else "closed")
