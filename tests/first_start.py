"""Make the lists of what a first start compiles: ``python -m tests.first_start``, after a kernel has changed.

Each list is what one kind of work compiles in a process that finds nothing kept, in the order in which it was
done, so that those called stand before those that call.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import softsensor
from daq import compiled
from daq.compiled_ahead import Listed, write_list
from daq.shared import shared_files
from softsensor.jobs import first_start
from softsensor.jobs.first_start import WorkKind, list_of
from softsensor.jobs.warm_up import warm_up

ROOT = Path(__file__).parents[1]


def do(work):
    """Do what a list is for, on what comes with the package."""
    press = softsensor.read_press(shared_files() / "presses/lab.toml")
    run = softsensor.read_run(shared_files() / "samples/2026-03-04-07.csv")
    if work is WorkKind.LIVE:
        warm_up(press)
    else:
        softsensor.fit(run, press)
        softsensor.simulate(run, press)


def recorded(work):
    """Do one kind of work and return what it compiled."""
    found, spent, kept = {}, {}, compiled._Kept
    load, save = kept.load_overload, kept.save_overload
    open_, inner = [], []

    def loading(self, signature, context):
        result = load(self, signature, context)
        if result is None:
            open_.append(time.perf_counter())
            inner.append(0.0)
        return result

    def saving(self, signature, result):
        took = time.perf_counter() - open_.pop()
        own = took - inner.pop()
        if inner:
            inner[-1] += took
        of = self._function
        called = [found[code.module, code.name, str(code.signature)] for _, code in compiled._called(result)]
        found[of.__module__, of.__qualname__, str(signature)] = len(spent)
        spent[len(spent)] = Listed(
            of.__module__, of.__qualname__, tuple(signature), tuple(sorted(set(called))), own
        )
        save(self, signature, result)

    kept.load_overload, kept.save_overload = loading, saving
    first_start.all_kept = lambda functions: True  # the list of before is not to be followed
    do(work)
    return list(spent.values())


if __name__ == "__main__":
    if len(sys.argv) > 1:
        write_list(list_of(WorkKind(sys.argv[1])), recorded(WorkKind(sys.argv[1])))
    else:
        for work in WorkKind:
            with tempfile.TemporaryDirectory() as folder:
                place, command = (
                    os.environ | {"NUMBA_CACHE_DIR": folder},
                    [sys.executable, "-m", "tests.first_start"],
                )
                subprocess.run([*command, work], env=place, check=True, cwd=ROOT)
