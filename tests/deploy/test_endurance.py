"""A short version of the endurance run: every kind of fault at least once, and nothing unaccounted for."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def endurance() -> ModuleType:
    spec = importlib.util.spec_from_file_location("endurance", Path(__file__).parent / "endurance.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["endurance"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.campaign
@pytest.mark.timeout(900)
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_after_every_kind_of_fault_nothing_is_unaccounted_for(endurance, tmp_path):
    plant = endurance.Endurance(tmp_path, speed=15.0, rate_hz=1.0, seed=3, pressings=16)
    balance = plant.run()
    print("\n" + "\n".join(balance.lines))
    assert {fault.kind for fault in plant.faults} == set(endurance.FAULTS)
    assert {what: count for what, count in balance.unaccounted.items() if count} == {}
    assert all(share < 0.2 for share in balance.grown_share.values()), balance.grown_share
