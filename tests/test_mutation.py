"""The plan of the mutants: each that is written down still is a change of the code, with tests that are there."""

import ast
import tomllib

import pytest

pytest.importorskip("cosmic_ray", reason="mutants are made where cosmic-ray is installed")

from tests.editions import edition
from tests.mutation import GONE, JUDGED, KILLED, KILLED_SINCE, PLAN, ROOT, VERDICTS, chosen, judged, main, read

MUTANTS = chosen(tomllib.loads(PLAN.read_text(encoding="utf-8")))
ROOMS = [room["name"] for room in tomllib.loads(PLAN.read_text(encoding="utf-8"))["room"]]


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_chosen_mutant_changes_the_code_and_has_its_tests(mutant):
    sound = (ROOT / mutant.module).read_text(encoding="utf-8")
    assert ast.dump(ast.parse(mutant.applied(sound))) != ast.dump(ast.parse(sound))
    assert all((ROOT / test.partition("::")[0]).exists() for test in mutant.tests)


def test_a_chosen_mutant_whose_code_is_gone_is_told():
    with pytest.raises(SystemExit, match="0 times, not once"):
        MUTANTS[0].applied("something else")


@pytest.mark.parametrize("one", read(JUDGED), ids=lambda one: one["name"])
def test_a_judged_mutant_was_killed_by_a_test_that_is_there_or_lives_for_a_reason(one):
    assert one["room"] in ROOMS
    assert one["verdict"] in VERDICTS
    if one["verdict"] not in (KILLED, KILLED_SINCE):
        assert len(one["reason"]) > 20
        return
    for test in one["tests"]:
        file, _, name = test.partition("::")
        assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8") or not name


def test_nine_of_ten_judged_mutants_that_mean_something_are_killed(capsys):
    assert main(["--table"]) == 0
    rows = {line[:12].strip(): line.split() for line in capsys.readouterr().out.splitlines()}
    assert set(ROOMS) <= set(rows)
    assert int(rows["all"][-1].removesuffix("%")) >= 90


@pytest.mark.campaign
def test_mutants_once_killed_are_killed_again(tmp_path):
    killed = [m for m in chosen({"mutant": read(JUDGED)}) if m.tests and m.module.startswith("daq/store")]
    waiting = [(mutant, mutant.tests) for mutant in killed[: edition(2, len(killed))]]
    assert {one["outcome"] for one in judged("store", waiting, tmp_path / "log")} <= {KILLED, GONE}
