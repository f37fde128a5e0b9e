"""Run every campaign whole, and every benchmark, one after the other, and print one table of what came out.

    python -m tests.campaigns [--resume] [--only WORD] [--folder DIR]

Each test is a process of its own. What it printed stands in DIR/NUMBER.log, how it ended is a line of
DIR/results.jsonl, written when it has ended: broken off at any moment, ``--resume`` goes on with the first that
has no line there. Exit status 1 where one failed. It takes a day or two; CI runs the small editions
(`tests.editions`).
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from tests.editions import WHOLE

ROOT = Path(__file__).parents[1]
PYTEST = (sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:schemathesis")
PYTEST += ("-m", "campaign or benchmark")


def whole() -> dict[str, str]:
    """Return the environment in which tests take their whole edition."""
    return {**os.environ, WHOLE: "whole"}


def collect(root: Path) -> list[str]:
    """Return the names of all campaigns and benchmarks, in pytest's order."""
    command = [*PYTEST, "--collect-only", "-q", "tests"]
    done = subprocess.run(command, cwd=root, env=whole(), capture_output=True, text=True, check=False)
    if done.returncode not in (0, 5):  # 5: nothing is marked so
        raise SystemExit(f"tests could not be collected:\n{done.stdout}{done.stderr}")
    return [line for line in done.stdout.splitlines() if "::" in line]


def run(root: Path, name: str, log: Path) -> dict[str, object]:
    """Run one test and return how it ended."""
    begun = time.monotonic()
    with log.open("w", encoding="utf-8") as out:
        done = subprocess.run(
            [*PYTEST, "-v", "-s", "-rs", name], cwd=root, env=whole(), stdout=out, stderr=subprocess.STDOUT
        )
    last = log.read_text(encoding="utf-8").rstrip().rpartition("\n")[2]
    outcome = "failed" if done.returncode else "skipped" if re.search(r"\d skipped", last) else "passed"
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=root, capture_output=True, text=True)
    seconds = round(time.monotonic() - begun)
    date = datetime.now(UTC).date().isoformat()
    return {"test": name, "outcome": outcome, "seconds": seconds, "date": date, "commit": commit.stdout.strip()}


def results(file: Path) -> dict[str, dict[str, object]]:
    """Return what a run before this one found; a last line torn by the end of its process does not count."""
    found = {}
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            one = json.loads(line)
        except ValueError:
            continue
        found[one["test"]] = one
    return found


def table(found: Sequence[dict[str, object]]) -> str:
    """Return the results as one table, the failed first."""
    order = {"failed": 0, "skipped": 1, "passed": 2}
    rows = sorted(found, key=lambda one: order[str(one["outcome"])])
    lines = [
        f"{one['outcome']:8} {one['seconds']:>7} s  {one['date']} {one['commit']}  {one['test']}" for one in rows
    ]
    counts = [f"{sum(one['outcome'] == outcome for one in rows)} {outcome}" for outcome in order]
    return "\n".join([*lines, ", ".join(counts)])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is left, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resume", action="store_true", help="go on where a run before was broken off")
    parser.add_argument("--only", default="", help="only tests with this in their name")
    parser.add_argument("--folder", type=Path, default=ROOT / "campaigns")
    parser.add_argument("--root", type=Path, default=ROOT, help="the folder above the tests")
    given = parser.parse_args(arguments)
    given.folder.mkdir(parents=True, exist_ok=True)
    file = given.folder / "results.jsonl"
    if not given.resume:
        file.unlink(missing_ok=True)
    names = [name for name in collect(given.root) if given.only in name]
    found = results(file)
    for number, name in enumerate(names):
        if name in found:
            continue
        sys.stdout.write(f"{number + 1} of {len(names)}: {name}\n")
        sys.stdout.flush()
        found[name] = run(given.root, name, given.folder / f"{number + 1:03}.log")
        with file.open("a", encoding="utf-8") as out:
            out.write("\n" * (out.tell() > 0) + json.dumps(found[name]))
    done = [found[name] for name in names]
    sys.stdout.write(table(done) + "\n")
    return int(any(one["outcome"] == "failed" for one in done))


if __name__ == "__main__":
    raise SystemExit(main())
