"""Functions of a list are compiled once, whoever is at it; in the small tree of `test_compiled`."""

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.daq.test_compiled import ROOT, tree

__all__ = ["tree"]
WORK = """
import sys, time
from numba import types
from daq import compiled, compiled_ahead
from softsensor.shapes import Layer
made, keep = [], compiled._Kept.save_overload
compiled._Kept.save_overload = lambda self, *found: (made.append(self._function.__name__), keep(self, *found))[1]
number = types.float64
layer = types.BaseTuple.from_types([number, number], Layer)
functions = [
    compiled_ahead.Listed("softsensor.lower", "half", (number,), (), 1.0),
    compiled_ahead.Listed("softsensor.lower", "half", (types.int64,), (), 1.0),
    compiled_ahead.Listed("softsensor.upper", "flow", (layer,), (0,), 1.0),
]
"""


@pytest.fixture
def start(tree):
    """Return what starts a process in the tree that does some work with the list."""
    shutil.copy(ROOT / "daq/compiled_ahead.py", tree / "daq/compiled_ahead.py")
    place = os.environ | {"NUMBA_CACHE_DIR": str(tree.parent / "kept"), "PYTHONPATH": str(tree)}

    def started(work):
        command = [sys.executable, "-c", WORK + work]
        return subprocess.Popen(command, cwd=tree, env=place, stdout=subprocess.PIPE, text=True)

    return started


def made_by(*processes):
    outputs = [process.communicate(timeout=240)[0] for process in processes]
    assert not any(process.returncode for process in processes)
    return [name for line in outputs for name in line.split()]


COMPILE = "compiled_ahead.compile_ahead(functions); print(*made)"


def test_two_processes_compile_each_function_once_and_later_ones_none(start):
    assert sorted(made_by(start(COMPILE), start(COMPILE))) == ["flow", "half", "half"]
    assert made_by(start(COMPILE)) == []
    assert made_by(start("print(compiled_ahead.all_kept(functions))")) == ["True"]


def claim_of(start, text):
    """Claim the function that the others wait for, as another process would; return the file."""
    (place,) = made_by(start("print(compiled.place_of('softsensor.lower', 'half', functions[0].signature))"))
    claim = Path(place).with_name(f".{Path(place).name}.claim")
    claim.parent.mkdir(parents=True)
    claim.write_text(text, encoding="utf-8")
    return claim


@pytest.mark.skipif(os.name == "nt", reason="whether a process lives is asked on POSIX; elsewhere its age decides")
def test_what_a_killed_process_has_claimed_is_compiled_by_another(start):
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        gone.wait()
    claim = claim_of(start, f"{socket.gethostname()} {gone.pid}")
    assert sorted(made_by(start(COMPILE))) == ["flow", "half", "half"]
    assert not claim.exists()


def test_what_another_process_works_on_is_waited_for(start):
    claim = claim_of(start, f"{socket.gethostname()} {os.getpid()}")
    process = start("print('there', flush=True);" + COMPILE)
    assert process.stdout.readline() == "there\n"
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(5.0)
    claim.unlink()
    assert sorted(made_by(process)) == ["flow", "half", "half"]


def test_a_claim_that_nobody_gives_up_is_not_waited_for_without_end(start):
    claim = claim_of(start, f"{socket.gethostname()} {os.getpid()}")
    impatient = "compiled_ahead.CLAIM_S = 1.0; compiled_ahead._left_behind = lambda claim: False;"
    assert sorted(made_by(start(impatient + COMPILE))) == ["flow", "half", "half"]
    assert claim.exists()


def test_where_nothing_can_be_kept_a_process_compiles_for_itself(tree, start):
    (tree.parent / "kept").write_text("a file where the folder would be", encoding="utf-8")
    assert sorted(made_by(start(COMPILE))) == ["flow", "half", "half"]


def test_a_list_is_read_as_it_was_written(start):
    work = (
        "from pathlib import Path; file = Path('list.json'); compiled_ahead.write_list(file, functions);"
        "print(compiled_ahead.read_list(file) == functions)"
    )
    assert made_by(start(work)) == ["True"]
