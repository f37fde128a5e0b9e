"""Change the code in small ways, chosen ones and a seeded sample of each room; see whether the suite notices.

    python -m tests.mutation [--resume] [--room NAME] [--folder DIR]

Cosmic Ray makes the mutants; a copy of the tree bears them, never the tree itself. A room, its tests and the
number of its mutants stand in mutation.toml; what is not meaningful is not drawn: annotations, decorators, and
more than one mutant of a function. There stand also the chosen ones, faults somebody feared, in the room
"chosen". Results are lines of DIR/results.jsonl, ``--resume`` goes on after the last.
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
import time
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).parents[1]
PLAN = ROOT / "tests/mutation.toml"
LEFT_OUT = re.compile(
    r"Decorator|Exception|NoOp|Variable|Invert|_(Is|IsNot)_|_(Is|IsNot|Not|BitAnd|BitOr|BitXor|[LR]Shift|FloorDiv|Mod|Pow)$"
)
"""Operators whose mutants say little: what running the line kills, as bits of a float do, and what is the same."""
LONGEST_S = 1800.0


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
    return [Chosen(m["name"], m["module"], m["was"], m["now"], tuple(m["tests"])) for m in plan["mutant"]]


def functions(text: str) -> dict[int, str]:
    """Return the function in which each line of a body stands, without those of annotations and docstrings."""
    inside: dict[int, str] = {}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            for statement in node.body:
                if not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)):
                    inside |= dict.fromkeys(range(statement.lineno, (statement.end_lineno or 0) + 1), node.name)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.AnnAssign):
            for line in range(node.annotation.lineno, (node.annotation.end_lineno or 0) + 1):
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


def drawn(room: dict[str, object], seed: int) -> list[Mutant]:
    """Return a room's sample: from as many functions as it has mutants."""
    chance, found = random.Random(f"{seed} {room['name']}"), {}
    modules = sorted({str(p.relative_to(ROOT)) for pattern in room["modules"] for p in ROOT.glob(pattern)})
    everything = [mutant for module in modules for mutant in mutants(module)]
    chance.shuffle(everything)
    for mutant in everything:
        if len(found) < room["count"] and (mutant.module, mutant.function) not in found and mutant.compiles:
            found[mutant.module, mutant.function] = mutant
    return list(found.values())


def passes(tree: Path, tests: Sequence[str], log: Path) -> bool:
    """Return whether a room's tests pass in a tree; a timeout is no pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--timeout", "600", *tests]
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    with log.open("w", encoding="utf-8") as out:
        try:
            done = subprocess.run(
                command, cwd=tree, env=environment, stdout=out, stderr=subprocess.STDOUT, timeout=LONGEST_S
            )
        except subprocess.TimeoutExpired:
            return False
    return done.returncode == 0


def judged(
    room: str, waiting: Sequence[tuple[Mutant | Chosen, Sequence[str]]], log: Path
) -> Iterator[dict[str, Any]]:
    """Yield what became of each mutant of a room, each with the tests that are to kill it."""
    with tempfile.TemporaryDirectory() as place:
        tree, sound_with = Path(place) / "kerntemp", set()
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".venv", ".git", "__pycache__", "campaigns"))
        for mutant, tests in waiting:
            if tuple(tests) not in sound_with and not passes(tree, tests, log):
                raise SystemExit(f"{mutant.name}: its tests fail without a mutant; see {log}")
            sound_with.add(tuple(tests))
            examples = (mutant.module,)  # in its docstrings
            file, begun = tree / mutant.module, time.monotonic()
            sound = file.read_text(encoding="utf-8")
            changed = mutant.applied(sound) or ""
            file.write_text(changed, encoding="utf-8")
            survived = passes(tree, (*examples, *tests), log)
            file.write_text(sound, encoding="utf-8")
            lines = zip(sound.splitlines(), changed.splitlines(), strict=False)
            was, now = next((a.strip(), b.strip()) for a, b in lines if a != b)
            yield {
                "room": room,
                "mutant": mutant.name,
                "outcome": "survived" if survived else "killed",
                "seconds": round(time.monotonic() - begun),
                "was": was,
                "now": now,
            }


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge the sample and print what survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resume", action="store_true", help="go on where a run before was broken off")
    parser.add_argument("--room", action="append", help="only this room; may be given again")
    parser.add_argument("--folder", type=Path, default=ROOT / "campaigns" / "mutation")
    given = parser.parse_args(arguments)
    given.folder.mkdir(parents=True, exist_ok=True)
    file = given.folder / "results.jsonl"
    if not given.resume:
        file.unlink(missing_ok=True)
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    done = {one["mutant"]: one for one in map(json.loads, lines)}
    plan = tomllib.loads(PLAN.read_text(encoding="utf-8"))
    for room in ({"name": "chosen"}, *plan["room"]):
        if given.room and room["name"] not in given.room:
            continue
        everyone = (
            [(m, room["tests"]) for m in drawn(room, plan["seed"])]
            if "tests" in room
            else [(m, m.tests) for m in chosen(plan)]
        )
        waiting = [(mutant, tests) for mutant, tests in everyone if mutant.name not in done]
        for one in judged(room["name"], waiting, given.folder / f"{room['name']}.log"):
            done[one["mutant"]] = one
            with file.open("a", encoding="utf-8") as out:
                out.write(json.dumps(one) + "\n")
            sys.stdout.write(
                f"{one['outcome']:8} {one['mutant']}\n           {one['was']}\n        -> {one['now']}\n"
            )
            sys.stdout.flush()
    killed = sum(one["outcome"] == "killed" for one in done.values())
    sys.stdout.write(f"{killed} of {len(done)} killed\n")
    return int(killed < 0.9 * len(done))


if __name__ == "__main__":
    raise SystemExit(main())
