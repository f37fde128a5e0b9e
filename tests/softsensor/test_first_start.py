"""What a first start compiles ahead: all that its work needs, and nothing else."""

import json
import subprocess
import sys
from dataclasses import replace

import pytest

from daq.compiled_ahead import read_list, write_list
from softsensor.jobs import first_start
from softsensor.jobs.first_start import WorkKind, compile_for, list_of
from tests.daq.test_compiled import ROOT

NEEDED = """
import json, sys
from daq import compiled
from softsensor.jobs.first_start import WorkKind
from tests.first_start import do
do(WorkKind(sys.argv[1]))
found = compiled._FUNCTIONS.items()
print(json.dumps([(module, name, str(tuple(s))) for (module, name), f in found for s in f.overloads]))
"""


@pytest.mark.parametrize("work", WorkKind)
def test_the_list_holds_what_the_work_compiles(work):
    """Else: ``python -m tests.first_start``."""
    command = [sys.executable, "-c", NEEDED, work]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    needed = {tuple(row) for row in json.loads(done.stdout.splitlines()[-1])}
    assert {(of.module, of.name, str(of.signature)) for of in read_list(list_of(work))} == needed


@pytest.mark.parametrize("work", WorkKind)
def test_a_list_is_written_as_it_was_read_and_callees_stand_first(work, tmp_path):
    functions = read_list(list_of(work))
    write_list(tmp_path / "list.json", functions)
    assert (tmp_path / "list.json").read_bytes() == list_of(work).read_bytes()
    assert all(called < k for k, of in enumerate(functions) for called in of.calls)


def test_a_list_that_does_not_fit_the_code_costs_time_and_nothing_else(tmp_path, monkeypatch, caplog):
    functions = read_list(list_of(WorkKind.FIT))
    write_list(tmp_path / "first_start_fit.json", [replace(functions[0], name="gone"), *functions[1:]])
    monkeypatch.setattr(first_start, "LISTS", tmp_path)
    compile_for.__wrapped__(WorkKind.FIT)
    assert "first_start_fit.json does not fit the code: python -m tests.first_start" in caplog.text
