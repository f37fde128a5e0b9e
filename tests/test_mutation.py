"""The plan of the mutants: each that is written down still is a change of the code, with tests that are there."""

import ast
import tomllib

import pytest

pytest.importorskip("cosmic_ray", reason="mutants are made where cosmic-ray is installed")

from tests.mutation import PLAN, ROOT, chosen

MUTANTS = chosen(tomllib.loads(PLAN.read_text(encoding="utf-8")))


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_chosen_mutant_changes_the_code_and_has_its_tests(mutant):
    sound = (ROOT / mutant.module).read_text(encoding="utf-8")
    assert ast.dump(ast.parse(mutant.applied(sound))) != ast.dump(ast.parse(sound))
    assert all((ROOT / test.partition("::")[0]).exists() for test in mutant.tests)


def test_a_chosen_mutant_whose_code_is_gone_is_told():
    with pytest.raises(SystemExit, match="0 times, not once"):
        MUTANTS[0].applied("something else")
