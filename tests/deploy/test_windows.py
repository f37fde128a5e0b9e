"""The processes of a press PC use nothing that only POSIX has: read from the source, and started without it."""

from __future__ import annotations

import ast
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from daq.files.run_file import toml_value
from daq.simulated.devices import simulated, wiring
from daq.store import StoreUnavailable, open_store

ROOT = Path(__file__).parents[2]
POSIX_MODULES = {"fcntl", "termios", "pty", "tty", "pwd", "grp", "resource", "syslog", "posix", "crypt", "spwd"}
POSIX_NAMES = {
    "os": {
        "fork",
        "forkpty",
        "geteuid",
        "getuid",
        "getgid",
        "setsid",
        "killpg",
        "openpty",
        "mkfifo",
        "chown",
        "uname",
    },
    "signal": {"SIGHUP", "SIGKILL", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGQUIT", "alarm", "setitimer", "pause"},
    "socket": {"AF_UNIX", "socketpair"},
}
SIMULATORS = ROOT / "daq" / "simulated"
"""Simulated serial lines need POSIX terminals; they are tools of development."""
SOURCES = sorted(
    path
    for package in ("daq", "softsensor", "api")
    for path in (ROOT / package).rglob("*.py")
    if SIMULATORS not in path.parents
)


class _Finder(ast.NodeVisitor):
    """Collects what only POSIX has, unless an `if` or a `try` around it asks first."""

    def __init__(self) -> None:
        self.found: list[str] = []
        self._guarded = 0

    def visit_If(self, node: ast.If) -> None:
        asks = (
            "hasattr" in ast.dump(node.test)
            or "platform" in ast.dump(node.test)
            or "'name'" in ast.dump(node.test)
        )
        self._within(node, asks)

    def visit_Try(self, node: ast.Try) -> None:
        names = {ast.unparse(handler.type) for handler in node.handlers if handler.type is not None}
        self._within(node, bool(names & {"ImportError", "ModuleNotFoundError", "AttributeError"}))

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """A function that begins by leaving where the system lacks something is guarded as a whole."""
        leaves = any(
            isinstance(step, ast.If)
            and any(word in ast.dump(step.test) for word in ("hasattr", "platform"))
            and isinstance(step.body[0], ast.Return)
            for step in node.body
        )
        self._within(node, leaves)

    def _within(self, node: ast.AST, guarded: bool) -> None:
        self._guarded += guarded
        self.generic_visit(node)
        self._guarded -= guarded

    def _note(self, what: str) -> None:
        if not self._guarded:
            self.found.append(what)

    def visit_Import(self, node: ast.Import) -> None:
        for name in node.names:
            if name.name.partition(".")[0] in POSIX_MODULES:
                self._note(f"line {node.lineno}: import {name.name}")

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        if node.level == 0 and (node.module or "").partition(".")[0] in POSIX_MODULES:
            self._note(f"line {node.lineno}: from {node.module}")

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if isinstance(node.value, ast.Name) and node.attr in POSIX_NAMES.get(node.value.id, ()):
            self._note(f"line {node.lineno}: {node.value.id}.{node.attr}")
        self.generic_visit(node)


def posix_only(source: str) -> list[str]:
    finder = _Finder()
    finder.visit(ast.parse(source))
    return finder.found


def test_the_search_finds_what_it_is_for():
    assert posix_only("import fcntl") == ["line 1: import fcntl"]
    assert posix_only("import os\nos.fork()") == ["line 2: os.fork"]
    assert posix_only("import signal\nif hasattr(signal, 'SIGHUP'):\n    signal.SIGHUP") == []
    assert posix_only("try:\n    import termios\nexcept ImportError:\n    pass") == []


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_module_needs_what_only_posix_has(path):
    assert posix_only(path.read_text(encoding="utf-8")) == []


BLOCKED = POSIX_MODULES - {"resource", "fcntl"}
"""These two are asked for behind a look at the platform, which this process cannot change."""
WITHOUT_POSIX = f"""
import builtins, os, signal, sys
real = builtins.__import__
def import_(name, globals=None, locals=None, fromlist=(), level=0):
    asker = (globals or {{}}).get("__name__", "").partition(".")[0]
    if level == 0 and asker in ("api", "daq", "softsensor") and name.partition(".")[0] in {BLOCKED!r}:
        raise ModuleNotFoundError(f"No module named {{name!r}} on Windows")
    return real(name, globals, locals, fromlist, level)
builtins.__import__ = import_
from api.cli import main
for name in ("SIGHUP", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGQUIT", "alarm", "setitimer"):
    delattr(signal, name)
for name in ("fork", "forkpty", "geteuid", "getuid", "setsid", "openpty", "mkfifo"):
    delattr(os, name)
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.campaign
def test_record_sense_and_serve_start_and_work_without_them(tmp_path):
    top = ["platen_top", "platen_bottom", *(f"top_{k}" for k in range(1, 7))]
    with ExitStack() as stack:
        server = stack.enter_context(simulated("exemys-rme1-tc", lambda now_s: [25.0] * 8, refresh_s=0))
        table = wiring("exemys-rme1-tc", server, "x", tuple(top))
        config = tmp_path / "kerntemp.toml"
        press = (ROOT / "deploy" / "presses" / "lab.toml").as_posix()
        config.write_text(
            f'[store]\nurl = "s.sqlite"\n[[press]]\nname = "lab"\nfile = "{press}"\n'
            "[[press.logger]]\n" + "".join(f"{k} = {toml_value(v)}\n" for k, v in table.items())
        )
        children = {}
        for name in ("record", "sense", "serve"):
            log = stack.enter_context((tmp_path / f"{name}.log").open("w"))
            words = [name, "--config", str(config), *(["--port", "0"] if name == "serve" else [])]
            child = subprocess.Popen(
                [sys.executable, "-c", WITHOUT_POSIX, *words],
                cwd=ROOT,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
            stack.callback(child.stdout.close)
            stack.callback(child.wait)
            stack.callback(child.kill)
            children[name] = child
        assert "kerntemp serves" in children["serve"].stdout.readline(), (tmp_path / "serve.log").read_text()
        deadline = (
            time.monotonic() + 400
        )  # the first live sensor of a fresh clone compiles, on a busy machine for minutes
        while not _works(tmp_path / "s.sqlite"):
            for name, child in children.items():
                assert child.poll() is None, (tmp_path / f"{name}.log").read_text()
            assert time.monotonic() < deadline
            time.sleep(0.1)
        for name, child in children.items():
            child.send_signal(signal.SIGTERM)
            assert child.wait(240) in (0, -signal.SIGTERM), (tmp_path / f"{name}.log").read_text()


def _works(path: Path) -> bool:
    if not path.exists():
        return False
    try:
        with open_store(str(path)) as store:
            return store.newest_estimate_number("lab") >= 0 and {"record", "sense"} <= set(store.statuses())
    except StoreUnavailable:
        return False
