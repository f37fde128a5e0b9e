"""`kerntemp backup` at the terminal: a copy, its check, and the way back."""

import numpy as np

from api.cli import main
from daq.records import Run
from daq.store import open_store


def test_a_copy_is_made_checked_and_restored(tmp_path, capsys):
    store, copy, again = (str(tmp_path / name) for name in ("s.sqlite", "copy.sqlite", "again.sqlite"))
    with open_store(store) as opened:
        opened.import_run(Run("one", {}, np.arange(9.0), {"top_1": np.arange(9.0)}), "lab")
    assert main(["backup", copy, "--store", store]) == 0
    assert main(["backup", copy, "--verify"]) == 0
    assert main(["backup", copy, "--restore", "--store", again]) == 0
    assert capsys.readouterr().out.count("one run, 9 scans") == 3
    with open_store(again) as opened:
        assert opened.load_run("one").columns["top_1"].tolist() == list(range(9))


def test_a_copy_is_never_overwritten_and_a_store_with_data_never_restored_into(tmp_path, capsys):
    store, copy = str(tmp_path / "s.sqlite"), str(tmp_path / "copy.sqlite")
    with open_store(store) as opened:
        opened.import_run(Run("one", {}, np.arange(9.0), {"top_1": np.arange(9.0)}), "lab")
    assert main(["backup", copy, "--store", store]) == 0
    assert main(["backup", copy, "--store", store]) == 2
    assert "exists already; give a new name" in capsys.readouterr().err
    assert main(["backup", copy, "--restore", "--store", store]) == 2
    assert "holds data; restore only into a new place" in capsys.readouterr().err
    assert main(["backup", str(tmp_path / "none.sqlite"), "--verify"]) == 2
    assert main(["backup", copy, "--verify", "--restore"]) == 2
