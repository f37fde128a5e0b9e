"""A short version of the endurance run: every kind of fault at least once, and nothing unaccounted for."""

from __future__ import annotations

import os

import pytest

from tests.deploy.endurance import FAULTS, Endurance


@pytest.mark.campaign
@pytest.mark.timeout(900)
@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_after_every_kind_of_fault_nothing_is_unaccounted_for(tmp_path):
    plant = Endurance(tmp_path, speed=15.0, rate_hz=1.0, seed=3, pressings=16)
    balance = plant.run()
    told = "\n".join(balance.lines)
    print("\n" + told)
    assert {fault.kind for fault in plant.faults} == set(FAULTS)
    assert {what: count for what, count in balance.unaccounted.items() if count} == {}, told
    assert all(share < 0.2 for share in balance.grown_share.values()), told
