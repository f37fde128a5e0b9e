"""A first start compiles with two processes: ``python -m softsensor.jobs.first_start KIND`` is the other one.

Without a kind, that command compiles for all of them, as the set-up does after an installation. What each kind of
work needs stands in a list beside this module, which ``python -m tests.first_start`` makes.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from contextlib import suppress
from enum import StrEnum
from functools import cache
from multiprocessing import parent_process
from pathlib import Path

from daq.compiled_ahead import all_kept, compile_ahead, read_list

LOG = logging.getLogger("kerntemp.first_start")
LISTS = Path(__file__).parent


class WorkKind(StrEnum):
    """What is compiled for."""

    LIVE = "live"
    FIT = "fit"


def list_of(work: WorkKind) -> Path:
    """Return the file of what a kind of work needs compiled."""
    return LISTS / f"first_start_{work}.json"


def kept(work: WorkKind) -> bool:
    """Return whether nothing is left to be compiled for a kind of work; not known of a list that does not fit."""
    with suppress(Exception):
        return all_kept(read_list(list_of(work)))
    return False


@cache
def compile_for(work: WorkKind, *, helped: bool = True) -> None:
    """Compile what a kind of work needs, or find that it is kept; once in a process.

    Parameters
    ----------
    helped
        Whether a second process may be started for it; a worker starts none.
    """
    other = None
    try:
        functions = read_list(list_of(work))
        if all_kept(functions):
            return
        if helped and parent_process() is None and (os.cpu_count() or 1) > 1:
            other = _other_process(work)
        compile_ahead(functions)
    except Exception:  # what is not compiled here is when it is called
        LOG.exception("%s does not fit the code: python -m tests.first_start", list_of(work))
    finally:
        if other is not None:
            other.kill()  # nothing is left to do; a file half written has a name of its own
            other.wait()


def _other_process(work: WorkKind) -> subprocess.Popen[bytes] | None:
    """Start a Python beside this one, where this one is a Python at all."""
    if not Path(sys.executable or "").stem.lower().startswith("python"):
        return None
    command = [sys.executable, "-m", "softsensor.jobs.first_start", work]
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with suppress(OSError):
        return subprocess.Popen(command, **quiet)  # type: ignore[call-overload, no-any-return]
    return None


if __name__ == "__main__":
    if len(sys.argv) > 1:
        compile_for(WorkKind(sys.argv[1]), helped=False)
    else:
        for each in WorkKind:
            compile_for(each)
