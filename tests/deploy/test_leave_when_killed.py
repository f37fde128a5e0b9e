"""Leave to open, given by the real processes on a virtual press, and what is left of it when one is killed."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx
import pytest

from daq.supervision import SILENT_S
from tests.api.test_live import Stream
from tests.api.test_plant_mqtt import MOSQUITTO, Broker, Listener
from tests.daq.test_recorder import plant
from tests.patience import wait_until

pytestmark = [
    pytest.mark.campaign,
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
        self.config, self.running = config, {}

    def start(self, name, *more):
        command = [sys.executable, "-m", "api", name, "--config", str(self.config), *more]
        with (self.config.parent / f"{name}.log").open("w") as log:
            self.running[name] = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log)

    @property
    def port(self):
        """Where the page's server listens, as it says; None before."""
        ways = re.search(r"serves http://127\.0\.0\.1:(\d+)/", (self.config.parent / "serve.log").read_text())
        return ways and int(ways[1])

    def kill(self, name):
        self.running[name].send_signal(signal.SIGKILL)
        self.running[name].wait()
        return time.monotonic()

    def end(self):
        for process in self.running.values():
            process.kill()
            process.wait()

    def ask(self, path):
        return httpx.get(f"http://127.0.0.1:{self.port}/api/v1/{path}", timeout=240).json()["items"][0]

    def allowed_by_rest(self):
        press, advice = self.ask("press"), self.ask("advice")["advice"]
        assert press["estimate"] is None or press["estimate"]["open_now"] is False or press["state"] == "closed"
        given = press["estimate"] is not None and press["estimate"]["open_now"]
        return given and advice["verdict"] == "open_now"

    def allowed(self):
        """Who says that the panel may leave."""
        ways = {"REST"} if self.allowed_by_rest() else set()
        heard = [e["data"] for e in self.stream.events if e["event"] == "estimate"]
        ways |= {"live events"} if heard and heard[-1]["open_now"] else set()
        bodies = self.listener.got.get("plant/lab/open_now", [])
        return ways | ({"MQTT"} if bodies and bodies[-1]["open_now"] else set())


WAYS = {"REST", "live events", "MQTT"}


@contextmanager
def running(folder, broker, speed=1.0):
    with plant(folder, speed=speed, rate_hz=5.0) as made:
        text = made.config.read_text()
        (folder / "resin.toml").write_text(RESIN)
        text = text.replace('file = "lab.toml"\n', 'file = "lab.toml"\nresin = "resin.toml"\n')
        text = text.replace(
            "[[press]]", f'[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\nprefix = "plant"\n[[press]]', 1
        )
        made.config.write_text(text.replace('"panel.thickness_mm" = 16.0', '"panel.thickness_mm" = 16.0' + STATED))
        found = Plant(made.config)
        with ExitStack() as ending:
            ending.callback(found.end)
            for name in ("serve", "sense", "publish", "record"):
                found.start(name, *(("--port", "0") if name == "serve" else ()))
            found.listener = Listener(broker.port)
            ending.callback(found.listener.close)
            wait_until(lambda: answers(found.port))
            found.stream = Stream(f"http://127.0.0.1:{found.port}")
            ending.callback(found.stream.close)
            yield found


def answers(port):
    if port is None:
        return False
    try:
        return bool(httpx.get(f"http://127.0.0.1:{port}/api/v1/press", timeout=240).json()["items"])
    except (httpx.TransportError, KeyError):
        return False


@pytest.mark.skipif(MOSQUITTO is None, reason="no mosquitto is installed: apt-get install mosquitto")
@pytest.mark.parametrize(("victim", "reason"), [("record", "no scans"), ("sense", "live sensor silent")])
def test_leave_given_is_taken_back_within_seconds_of_a_kill(tmp_path, victim, reason):
    broker = Broker(tmp_path)
    try:
        with running(tmp_path, broker) as made:
            wait_until(lambda: made.allowed() == WAYS, 600)
            assert all(process.poll() is None for process in made.running.values())
            killed, took = made.kill(victim), {}
            while len(took) < len(WAYS):
                for way in WAYS - made.allowed() - took.keys():
                    took[way] = time.monotonic() - killed
                assert time.monotonic() - killed < SILENT_S + ANSWER_S, took
                time.sleep(0.05)
            print(f"\n{victim} killed: taken back after", {way: round(s, 1) for way, s in sorted(took.items())})
            press, advice = made.ask("press"), made.ask("advice")["advice"]
            assert press["estimate"]["reason"] == made.listener.got["plant/lab/open_now"][-1]["reason"] == reason
            assert (press["estimate"]["valid"], press["estimate"]["core_C"]) == (False, None)
            assert press["estimate"]["age_s"] > SILENT_S
            assert advice["verdict"] == "not_known"
            assert press["state"] == ("unknown" if victim == "record" else "closed")
    finally:
        broker.kill()
