"""Change the code in small ways, chosen ones and a seeded sample of each room; see whether the suite notices.

    python -m tests.mutation [--seed N | --again] [--resume] [--room NAME] [--wider] [--folder DIR]
    python -m tests.mutation --table

Cosmic Ray makes the mutants; a copy of the tree bears them, never the tree itself. A room, its tests and the
number of its mutants stand in mutation.toml; what is not meaningful is not drawn: annotations, decorators, and
more than one mutant of a function. There stand also the chosen ones, faults somebody feared, in the room
"chosen". ``--wider`` holds what a room's tests let through against every test file that imports the mutant's
module, or one that imports it.

Results go to DIR/results.toml, ``--resume`` goes on after the last. A sample whose survivors were looked at, each
with a verdict and a reason, is kept in mutation_judged.toml: ``--table`` prints it by room, ``--again`` judges the
killed ones of it once more, each by the test that killed it.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grimp
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).parents[1]
PLAN = ROOT / "tests/mutation.toml"
JUDGED = ROOT / "tests/mutation_judged.toml"
LEFT_OUT = re.compile(
    r"Decorator|Exception|NoOp|Variable|Invert|_(Is|IsNot)_|_(Is|IsNot|Not|BitAnd|BitOr|BitXor|[LR]Shift|FloorDiv|Mod|Pow)$"
)
"""Operators whose mutants say little: what running the line kills, as bits of a float do, and what is the same."""
LONGEST_S = 1800.0
KILLED, SURVIVED, GONE = "killed", "survived", "gone"
KILLED_SINCE = "killed since"
"""By a test that was written for it, or found by looking further than its room's tests."""
SAME, WITHOUT_MEANING, GAP = "equivalent", "without meaning", "gap"
VERDICTS = (KILLED, KILLED_SINCE, SAME, WITHOUT_MEANING, GAP)
"""What a judged sample says of its mutants; the last three live."""


@dataclass(frozen=True)
class Mutant:
    """One small change of one module."""

    module: str
    operator: str
    occurrence: int
    line: int
    function: str

    @property
    def name(self) -> str:
        """Where it is and what it does, for people and for `--resume`."""
        return f"{self.module}:{self.line} {self.operator.rpartition('/')[2]} #{self.occurrence}"

    @property
    def compiles(self) -> bool:
        """Whether it is Python, and another program: stars of arguments are taken for products."""
        sound = (ROOT / self.module).read_text(encoding="utf-8")
        try:
            changed = ast.parse(self.applied(sound) or "")
        except SyntaxError:
            return False
        return ast.dump(changed) != ast.dump(ast.parse(sound))

    def applied(self, text: str) -> str | None:
        """Return the module's text with the change."""
        return mutate_code(text, get_operator(self.operator)(), self.occurrence)


@dataclass(frozen=True)
class Chosen:
    """A mutant that somebody wrote down, with the tests that are to kill it."""

    name: str
    module: str
    was: str
    now: str
    tests: tuple[str, ...]

    def applied(self, text: str) -> str:
        """Return the module's text with the change; what it changes must stand there once."""
        if text.count(self.was) != 1:
            raise SystemExit(
                f"{self.name}: {self.module} holds {self.was!r} {text.count(self.was)} times, not once"
            )
        return text.replace(self.was, self.now)


def chosen(plan: dict[str, Any]) -> list[Chosen]:
    """Return the mutants that are written down."""
    return [Chosen(m["name"], m["module"], m["was"], m["now"], tuple(m.get("tests", ()))) for m in plan["mutant"]]


def snippets(sound: str, changed: str) -> tuple[str, str]:
    """Return what a mutant changes and what it becomes: lines, with so many before that the text has them once."""
    old, new = sound.splitlines(keepends=True), changed.splitlines(keepends=True)
    first = next(i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b)
    after = next(i for i, (a, b) in enumerate(zip(old[::-1], new[::-1], strict=False)) if a != b)
    while sound.count("".join(old[first : len(old) - after])) > 1:
        first -= 1
    return "".join(old[first : len(old) - after]), "".join(new[first : len(new) - after])


def functions(text: str) -> dict[int, str]:
    """Return the function in which each line of a body stands, without those of annotations and docstrings."""
    inside: dict[int, str] = {}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            for statement in node.body:
                if not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)):
                    inside |= dict.fromkeys(range(statement.lineno, (statement.end_lineno or 0) + 1), node.name)
    for node in ast.walk(ast.parse(text)):
        says = [node.annotation] if isinstance(node, ast.AnnAssign | ast.arg) else []
        says += [node.returns] if isinstance(node, ast.FunctionDef) else []
        for annotation in filter(None, says):
            for line in range(annotation.lineno, (annotation.end_lineno or 0) + 1):
                inside.pop(line, None)
    return inside


def mutants(module: str) -> Iterator[Mutant]:
    """Return all mutants of a module that mean something."""
    text = (ROOT / module).read_text(encoding="utf-8")
    tree, inside = get_ast(text), functions(text)
    for operator in operator_names():
        kind = get_operator(operator)
        if kind.arguments() or LEFT_OUT.search(operator):
            continue
        places = (start for node in ast_nodes(tree) for start, _ in kind().mutation_positions(node))
        for occurrence, (line, _) in enumerate(places):
            if line in inside:
                yield Mutant(module, operator, occurrence, line, inside[line])


def drawn(room: dict[str, Any], seed: int) -> list[Mutant]:
    """Return a room's sample: from as many functions as it has mutants, few of them in kernels to be compiled."""
    chance, found = random.Random(f"{seed} {room['name']}"), {}
    kernels = files(room.get("kernels", ()))
    plain = files(room["modules"]) - kernels
    for modules, count in ((plain, room["count"]), (kernels, room.get("of_kernels", 0))):
        everything = [mutant for module in sorted(modules) for mutant in mutants(module)]
        chance.shuffle(everything)
        full = len(found) + count
        for mutant in everything:
            if len(found) < full and (mutant.module, mutant.function) not in found and mutant.compiles:
                found[mutant.module, mutant.function] = mutant
    return list(found.values())


def files(patterns: Sequence[str]) -> set[str]:
    """Return the project's files that patterns name."""
    return {str(path.relative_to(ROOT)) for pattern in patterns for path in ROOT.glob(pattern)}


def importing(module: str) -> list[str]:
    """Return the test files that import a module, or one that imports it."""
    name = module.removesuffix("/__init__.py").removesuffix(".py").replace("/", ".")
    near = {name} | grimp.build_graph("daq", "softsensor", "api").find_modules_that_directly_import(name)
    found = []
    for file in sorted(files(["tests/**/test_*.py"])):
        imported = set()
        for node in ast.walk(ast.parse((ROOT / file).read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                imported |= {node.module, *(f"{node.module}.{one.name}" for one in node.names)}
            elif isinstance(node, ast.Import):
                imported |= {one.name for one in node.names}
        found += [file] if imported & near else []
    return found


def killer(tree: Path, tests: Sequence[str], log: Path) -> str | None:
    """Return the first of some tests that fails in a tree; None where all pass. A timeout is a failure."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--timeout", "300", *tests]
    kept = str(log.parent / "compiled")  # not the user's, where mutants would push out sound code
    environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": kept}
    with log.open("w", encoding="utf-8") as out:
        try:
            done = subprocess.run(
                command, cwd=tree, env=environment, stdout=out, stderr=subprocess.STDOUT, timeout=LONGEST_S
            )
        except subprocess.TimeoutExpired:
            return tests[0]
    failed = re.search(r"^(?:FAILED|ERROR) ([^\s\[]+)", log.read_text(encoding="utf-8"), re.MULTILINE)
    return None if done.returncode == 0 else failed[1] if failed else tests[0]


def judged(
    room: str, waiting: Sequence[tuple[Mutant | Chosen, Sequence[str]]], log: Path, *, wider: bool = False
) -> Iterator[dict[str, Any]]:
    """Yield what became of each mutant of a room, each with the tests that are to kill it."""
    with tempfile.TemporaryDirectory() as place:
        tree, sound_with = Path(place) / "kerntemp", set()
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".venv", ".git", "__pycache__", "campaigns"))
        for mutant, tests in waiting:
            file = tree / mutant.module
            sound = file.read_text(encoding="utf-8")
            if isinstance(mutant, Chosen) and sound.count(mutant.was) != 1:
                yield {"name": mutant.name, "room": room, "outcome": GONE}
                continue
            wide = [test for test in importing(mutant.module) if test not in tests] if wider else []
            for one in (tests, wide):
                if one and tuple(one) not in sound_with and (failed := killer(tree, one, log)):
                    raise SystemExit(f"{mutant.name}: {failed} fails without a mutant; see {log}")
                sound_with.add(tuple(one))
            changed = mutant.applied(sound) or ""
            file.write_text(changed, encoding="utf-8")
            examples = mutant.module  # in its docstrings
            killed_by = killer(tree, (examples, *tests), log) or (killer(tree, wide, log) if wide else None)
            file.write_text(sound, encoding="utf-8")
            was, now = snippets(sound, changed)
            own = {"name": mutant.name, "room": room, "module": mutant.module, "was": was, "now": now}
            yield own | ({"outcome": KILLED, "tests": [killed_by]} if killed_by else {"outcome": SURVIVED})


def toml(one: dict[str, Any]) -> str:
    """Return a mutant as mutation.toml and mutation_judged.toml have it."""
    return "\n[[mutant]]\n" + "".join(f"{k} = {json.dumps(v, ensure_ascii=False)}\n" for k, v in one.items())


def table(found: Sequence[dict[str, Any]]) -> str:
    """Return by room how many mutants of a judged sample mean something, and how many of these are killed."""
    lines = [f"{'room':12} {'drawn':>5} {'meaningful':>10} {'killed when drawn':>17} {'killed now':>10}"]
    for room in (*dict.fromkeys(one["room"] for one in found), "all"):
        count = Counter(one["verdict"] for one in found if room in (one["room"], "all"))
        meaningful = count[KILLED] + count[KILLED_SINCE] + count[GAP]
        first, now = count[KILLED], count[KILLED] + count[KILLED_SINCE]
        lines.append(
            f"{room:12} {count.total():5} {meaningful:10} {first:10} = {first / meaningful:4.0%}"
            f" {now:3} = {now / meaningful:4.0%}"
        )
    alive = [one for one in found if one["verdict"] not in (KILLED, KILLED_SINCE)]
    return "\n".join([*lines, *(f"{one['verdict']}: {one['name']}: {one['reason']}" for one in alive)])


def asked_for(plan: dict[str, Any], *, again: bool) -> dict[str, list[tuple[Mutant | Chosen, Sequence[str]]]]:
    """Return the mutants to be judged by room, with their tests: chosen and drawn ones, or those judged before."""
    if not again:
        rooms = {"chosen": [(mutant, mutant.tests) for mutant in chosen(plan)]}
        for room in plan["room"]:
            rooms[room["name"]] = [(mutant, room["tests"]) for mutant in drawn(room, plan["seed"])]
        return rooms
    record, rooms = read(JUDGED), {room["name"]: [] for room in plan["room"]}
    for one, mutant in zip(record, chosen({"mutant": record}), strict=True):
        if mutant.tests:  # what lives for a reason has none
            rooms[one["room"]].append((mutant, mutant.tests))
    return rooms


def read(file: Path) -> list[dict[str, Any]]:
    """Return the mutants of a file of results."""
    return tomllib.loads(file.read_text(encoding="utf-8")).get("mutant", []) if file.exists() else []


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge the sample and print what survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, help="draw another sample than that of mutation.toml")
    parser.add_argument("--again", action="store_true", help="judge the sample of mutation_judged.toml once more")
    parser.add_argument("--table", action="store_true", help="print what mutation_judged.toml holds, and end")
    parser.add_argument("--resume", action="store_true", help="go on where a run before was broken off")
    parser.add_argument("--room", action="append", help="only this room; may be given again")
    parser.add_argument("--wider", action="store_true", help="survivors meet all test files near their module")
    parser.add_argument("--folder", type=Path, default=ROOT / "campaigns" / "mutation")
    given = parser.parse_args(arguments)
    if given.table:
        sys.stdout.write(table(read(JUDGED)) + "\n")
        return 0
    given.folder.mkdir(parents=True, exist_ok=True)
    file = given.folder / "results.toml"
    if not given.resume:
        file.unlink(missing_ok=True)
    done = {one["name"]: one for one in read(file)}
    plan = tomllib.loads(PLAN.read_text(encoding="utf-8"))
    if given.seed is not None:
        plan |= {"seed": given.seed, "mutant": []}
    for room, everyone in asked_for(plan, again=given.again).items():
        if given.room and room not in given.room:
            continue
        waiting = [(mutant, tests) for mutant, tests in everyone if mutant.name not in done]
        for one in judged(room, waiting, given.folder / f"{room}.log", wider=given.wider):
            done[one["name"]] = one
            with file.open("a", encoding="utf-8") as out:
                out.write(toml(one))
            sys.stdout.write(f"{one['outcome']:8} {one['name']}\n{one.get('was', '')}->\n{one.get('now', '')}")
            sys.stdout.flush()
    there = [one["outcome"] for one in done.values() if one["outcome"] != GONE]
    sys.stdout.write(f"{there.count(KILLED)} of {len(there)} killed\n")
    return int(there.count(KILLED) < 0.9 * len(there))


if __name__ == "__main__":
    raise SystemExit(main())
