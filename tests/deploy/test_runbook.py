"""Every command of the runbook, in its order, on a press PC of simulated loggers.

`systemctl` and `sudo` stand in here: the one starts what the units name, as this machine has no running systemd.
The setup's commands run in `test_setup.py`, below a folder. Of commands in the middle of sentences, Dask's run; of
the others the units and extras they name must be there.
"""

from __future__ import annotations

import fnmatch
import os
import re
import socket
import stat
import subprocess
import sys
import textwrap
import time
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from distributed import Client

from daq.files.run_file import toml_value
from daq.simulated.campaign import press_toml
from daq.simulated.devices import simulated, wiring
from daq.simulated.press import VirtualPress, VirtualPressSettings
from daq.store import RunStatus, open_store
from tests.patience import wait_until

ROOT = Path(__file__).parents[2]
RUNBOOK = ROOT / "deploy" / "RUNBOOK.md"
SPEED = 30.0
TCP_CHANNELS = ("platen_top", "platen_bottom", *(f"top_{k}" for k in range(1, 7)))
SERIAL_CHANNELS = ("top_7", *(f"bottom_{k}" for k in range(1, 8)))
ROOM_C = 21.5
posix_only = pytest.mark.skipif(os.name == "nt", reason="the runbook's commands are for Debian")


def blocks() -> list[str]:
    return re.findall(r"^ *```sh\n(.*?)^ *```", RUNBOOK.read_text(encoding="utf-8"), flags=re.M | re.S)


def commands(setup: bool) -> list[str]:
    """Return the runbook's commands, those of the setup or all others."""
    lines = [line.strip() for block in blocks() for line in block.splitlines() if line.strip()]
    return [line for line in lines if ("kerntemp_setup.py" in line) == setup]


SYSTEMCTL = """
import os, re, signal, subprocess, sys, time
from pathlib import Path
units, pc, words = Path({units!r}), Path({pc!r}), sys.argv[1:]
verb, names = words[0], [w for w in words[1:] if not w.startswith("-")]
assert verb in ("start", "stop", "status", "enable", "restart"), verb
def members(name):
    path = units / (name if "." in name else name + ".service")
    text = path.read_text()
    if path.suffix == ".target":
        wants = re.search("^Wants=(.*)$", text, re.M).group(1).split()
        return [m for w in wants if w.endswith(".service") for m in members(w)]
    return [(path.stem, re.search("^ExecStart=(.*)$", text, re.M).group(1), "Type=oneshot" in text)]
for name, line, oneshot in [m for n in names for m in members(n)]:
    pid = pc / (name + ".pid")
    line = line.replace("/opt/kerntemp/current/bin/kerntemp", {program!r})
    line = line.replace("/etc/kerntemp", str(pc / "etc/kerntemp"))
    if verb == "status":
        os.kill(int(pid.read_text()), 0)
    elif oneshot:
        sys.exit(subprocess.run(line.split(), stdout=subprocess.DEVNULL).returncode)
    elif not pid.exists():
        log = (pc / (name + ".log")).open("w")
        quiet = dict(stdout=log, stderr=log, stdin=subprocess.DEVNULL, start_new_session=True)
        child = subprocess.Popen(line.split(), **quiet)
        pid.write_text(str(child.pid))
        time.sleep(0.5)  # who refuses at once is shown here; who does so later, at the step that needs it
        assert child.poll() is None, (pc / (name + ".log")).read_text()
if verb == "start" and "kerntemp.target" in names:
    deadline = time.monotonic() + 240
    while "serves" not in (pc / "kerntemp-serve.log").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.1)
"""


class PressPc:
    """A folder that looks like a press PC, two simulated loggers, and a shell that sees both."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder = folder
        self.program = f"{sys.executable} -m api"
        self.port = 0
        self._reads = 0
        self.warm_from: int | None = None
        self.began_s = self.stands_s = 0.0
        self.press = VirtualPress(VirtualPressSettings(between_s=(12.0, 16.0), keep=60), 3)
        self.press.cycle(0.0)  # solved before a logger asks
        upper = simulated("adam-6018+", self._upper, clock=self._clock, refresh_s=0.0)
        lower = simulated("adam-4118-ascii", self._lower, clock=self._clock, refresh_s=0.1)
        self.upper, self.lower = stack.enter_context(upper), stack.enter_context(lower)
        for name in ("etc/kerntemp/presses", "var/lib/kerntemp/backups", "bin"):
            (folder / name).mkdir(parents=True)
        (folder / "etc/kerntemp/presses/lab.toml").write_text(press_toml())
        stack.callback(self.stop)
        self._stand_in("sudo", 'exec "$@"\n', "/bin/sh")
        self._stand_in("kerntemp", f'exec {self.program} "$@"\n', "/bin/sh")
        values = {"units": str(ROOT / "deploy" / "systemd"), "pc": str(folder), "program": self.program}
        text = SYSTEMCTL
        for key, value in values.items():
            text = text.replace("{" + key + "!r}", repr(value))
        self._stand_in("systemctl", text, sys.executable)

    def _clock(self) -> float:
        if self.stands_s:
            return self.stands_s
        now_s = time.monotonic()
        return (now_s - self.began_s) * SPEED if self.began_s else now_s - 1e9

    def _temperatures(self, columns: tuple[str, ...], now_s: float) -> list[float]:
        if not self.began_s:
            return [ROOM_C + 0.1 * (k % 3) for k in range(len(columns))]
        shown = self.press.temperatures(max(now_s, 0.0))
        return [shown[name] for name in columns]

    def _upper(self, now_s: float) -> list[float]:
        self._reads += 1
        found = self._temperatures(TCP_CHANNELS, now_s)
        if self.warm_from is not None and self._reads > self.warm_from:
            found[4] += 6.0  # somebody holds top_3
        return found

    def _lower(self, now_s: float) -> list[float]:
        return self._temperatures(SERIAL_CHANNELS, now_s)

    def _stand_in(self, name: str, text: str, interpreter: str) -> None:
        path = self.folder / "bin" / name
        path.write_text(f"#!{interpreter}\n{text}")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)

    def configure(self, *, calibrated: bool) -> None:
        """What a technician has written by now."""
        data = self.folder / "var/lib/kerntemp"
        text = f'[store]\nurl = "{data}/kerntemp.sqlite"\n[clock]\nspeed = {SPEED}\n'
        text += f'[server]\nport = 0\ntokens = "{data}/tokens.json"\n[opcua]\nport = 0\n'
        text += '[[press]]\nname = "lab"\nfile = "presses/lab.toml"\nrate_hz = 1.0\n'
        text += 'header = { "panel.material" = "MDF", "panel.thickness_mm" = 16.0 }\n'
        for profile, server, columns in (
            ("adam-6018+", self.upper, TCP_CHANNELS),
            ("adam-4118-ascii", self.lower, SERIAL_CHANNELS),
        ):
            table = wiring(profile, server, profile, columns)
            if calibrated:
                table["calibration"] = str(data / f"calibration-{profile}.toml")
            text += "[[press.logger]]\n" + "".join(f"{k} = {toml_value(v)}\n" for k, v in table.items())
        (self.folder / "etc/kerntemp/kerntemp.toml").write_text(text)

    def translated(self, command: str) -> str:
        """Return a command with this PC's places, ports and haste."""
        for ours in ("/etc/kerntemp", "/var/lib/kerntemp"):
            command = command.replace(ours, f"{self.folder}{ours}")
        if self.port == 0 and (log := self.folder / "kerntemp-serve.log").exists():
            self.port = int(re.findall(r":(\d+)/", log.read_text())[-1])
        changes = {
            "--port /dev/kerntemp/bus": f"--port {self.lower.place.get('port')} --timeout 0.1",
            "--host 192.168.0.21": f"--host 127.0.0.1 --tcp-port {self.upper.place.get('tcp_port')} --timeout 0.1",
            "127.0.0.1:8765": f"127.0.0.1:{self.port}",
            "--wait 10": "--wait 0 --period 0",
            "--room 21.5": "--room 21.5 --period 0",
        }
        for old, new in changes.items():
            command = command.replace(old, new)
        return command

    def run(self, command: str) -> str:
        environment = {
            **os.environ,
            "PATH": f"{self.folder / 'bin'}:{os.environ['PATH']}",
            "KERNTEMP_CONFIG": str(self.folder / "etc/kerntemp/kerntemp.toml"),
            "PYTHONPATH": str(ROOT),
        }
        done = subprocess.run(
            ["/bin/sh", "-ec", self.translated(command)],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=240,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        return done.stdout

    def press_a_panel(self) -> None:
        """Let the loggers see a press at work until a run is over, then one that stands until it is fitted.

        A press that went on would give a slow machine ever more to refit.
        """
        with open_store(str(self.folder / "var/lib/kerntemp/kerntemp.sqlite")) as store:
            wait_until(lambda: "sense" in store.statuses(), "the live sensor is not there")
            self.began_s = time.monotonic()
            wait_until(lambda: store.runs(status=RunStatus.CLOSED).items, "no pressing was recorded")
            self.stands_s = self.press.cycle(self._clock()).start + 1.0
            closed = store.runs(status=RunStatus.CLOSED).items
            wait_until(lambda: any(store.fit(r.run) for r in closed), "no pressing was fitted")

    def stop(self) -> None:
        for pid in self.folder.glob("*.pid"):
            subprocess.run(["kill", pid.read_text()], check=False, capture_output=True)


@pytest.fixture
def pc(tmp_path: Path) -> Iterator[PressPc]:
    with ExitStack() as stack:
        yield PressPc(tmp_path, stack)


@posix_only
@pytest.mark.campaign
def test_every_command_works_in_the_order_of_the_runbook(pc):
    outputs = {}
    for line in commands(setup=False):
        command = line.removeprefix("sudo ")
        if command == "kerntemp check" or "--write" in command:
            pc.configure(calibrated="--write" in command)
        if "--warm" in command:
            pc.warm_from = pc._reads + 11
        if command == "kerntemp export":
            pc.press_a_panel()
        outputs[command] = pc.run(line)
        pc.warm_from = None if "--warm" in command else pc.warm_from
    assert "adam-4118-ascii" in outputs["kerntemp probe --port /dev/kerntemp/bus"]
    assert "adam-6018+" in outputs["kerntemp probe --host 192.168.0.21"]
    assert "top_3" in outputs["kerntemp calibrate --warm --wait 10"]
    assert "kt_" in outputs["kerntemp token create tablet --scope read"]
    assert (pc.folder / "var/lib/kerntemp/first.json").is_file()
    assert (pc.folder / "var/lib/kerntemp/restored.sqlite").is_file()
    with open_store(str(pc.folder / "var/lib/kerntemp/kerntemp.sqlite")) as store:
        wait_until(lambda: {"record", "sense", "publish"} <= set(store.statuses()))


def test_the_runbook_calls_kerntemp_as_somebody_who_may_read_its_configuration():
    for command in commands(setup=False):
        assert len(re.findall(r"\bkerntemp (?=[a-z])", command)) == command.count("sudo kerntemp "), command


def test_the_setups_commands_are_those_the_setup_knows():
    done = subprocess.run(
        [sys.executable, str(ROOT / "deploy" / "kerntemp_setup.py"), "--help"], capture_output=True, text=True
    )
    for command in commands(setup=True):
        words = command.split("kerntemp_setup.py ")[1].split()
        assert words[0] in re.search(r"\{(.*?)\}", done.stdout).group(1).split(","), command
    assert {c.split("kerntemp_setup.py ")[1].split()[0] for c in commands(setup=True)} == {
        "install",
        "update",
        "rollback",
        "uninstall",
        "complete",
    }


def test_the_configuration_the_runbook_shows_for_the_plant_is_well_formed(tmp_path):
    import tomllib

    from daq.process.config import MqttSettings, OpcuaSettings

    (text,) = re.findall(r"^```toml\n(.*?)^```", RUNBOOK.read_text(encoding="utf-8"), flags=re.M | re.S)
    tree = tomllib.loads(textwrap.dedent(text))
    MqttSettings(**tree["mqtt"])
    OpcuaSettings(**tree["opcua"])


def test_the_service_wrapper_the_runbook_shows_for_windows_is_well_formed_xml():
    from xml.etree import ElementTree

    (text,) = re.findall(r"^```xml\n(.*?)^```", RUNBOOK.read_text(encoding="utf-8"), flags=re.M | re.S)
    assert ElementTree.fromstring(text).findtext("arguments").startswith("record --config")


def inline() -> list[str]:
    """Return what stands in grey in the sentences and is a command of the shell, parted at semicolons."""
    text = re.sub(r"^ *```sh\n.*?^ *```", "", RUNBOOK.read_text(encoding="utf-8"), flags=re.M | re.S)
    found = [part.strip() for code in re.findall(r"`([^`\n]+)`", text) for part in code.split(";")]
    return [
        line for line in found if line.split()[0] in ("systemctl", "journalctl", "pip", "dask") and " " in line
    ]


@pytest.mark.parametrize("line", [line for line in inline() if line.startswith(("systemctl", "journalctl"))])
def test_units_named_in_a_sentence_are_there(line):
    units = re.findall(r"kerntemp[-\w.*]*", line)
    known = [path.name for path in (ROOT / "deploy" / "systemd").iterdir()]
    assert units
    for unit in units:
        pattern = unit.strip("'") if "." in unit or "*" in unit else f"{unit}.service"
        assert any(fnmatch.fnmatchcase(name, pattern) for name in known), unit


@pytest.mark.parametrize("line", [line for line in inline() if line.startswith("pip")])
def test_extras_named_in_a_sentence_are_there(line):
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "optional-dependencies"
    ]
    assert set(re.search(r"\[([\w,]+)\]", line).group(1).split(",")) <= set(extras)


@posix_only
@pytest.mark.campaign
def test_the_scheduler_and_workers_of_the_runbook_come_up():
    scheduler, worker = (
        next(line for line in inline() if line.startswith(f"dask {kind}")) for kind in ("sch", "work")
    )
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    program = str(Path(sys.executable).parent / "dask")
    words = [
        *scheduler.split()[1:],
        "--host",
        "127.0.0.1",
        "--port",
        str(port),
        "--dashboard-address",
        "127.0.0.1:0",
    ]
    address = f"tcp://127.0.0.1:{port}"
    with subprocess.Popen([program, *words], stderr=subprocess.DEVNULL) as first:
        line = re.sub(r"tcp://\S+", address, worker).split()[1:]
        with subprocess.Popen([program, *line, "--no-dashboard"], stderr=subprocess.DEVNULL) as second:
            try:
                with Client(address, timeout="60s") as client:
                    client.wait_for_workers(1, timeout=240)
                    assert list(client.nthreads().values()) == [1]
            finally:
                second.terminate()
                first.terminate()
