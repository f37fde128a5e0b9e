"""Compile listed functions before they are called, several processes sharing the work.

A first start compiles one function after the other, in the order in which they are called. With a list of them and
their signatures, each after those it calls, two processes begin at once: each takes what nobody else works on and
whose callees are there, the longest way to the end first. What one has compiled the other finds among what is kept
(`daq.compiled`). The list only saves time: what is not in it is compiled when it is called.
"""

from __future__ import annotations

import importlib
import json
import os
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numba
from numba import types

from daq.compiled import function_at, place_of

CLAIM_S = 120.0
"""A function that another process has worked on for so long is compiled all the same: that one has ended, perhaps
on another machine with the same folder. The longest takes 3 s on an idle machine (2026-11-24). [s]"""
POLL_S = 0.02
"""How often is looked whether another process has compiled what is waited for. [s]"""


@dataclass(frozen=True)
class Listed:
    """A function for one signature."""

    module: str
    name: str
    signature: tuple[Any, ...]
    """Numba's types of its arguments."""
    calls: tuple[int, ...]
    """Which of the list it calls."""
    seconds: float
    """How long compiling it took, without what it calls, where the list was made: only for the order."""


def all_kept(functions: Sequence[Listed]) -> bool:
    """Return whether nothing of a list is left to be compiled; so it is where Numba is set not to compile."""
    return numba.config.DISABLE_JIT or all(
        place_of(of.module, of.name, of.signature).is_file() for of in functions
    )


def compile_ahead(functions: Sequence[Listed]) -> None:
    """Compile what is not kept yet of a list, beside whoever else is at the same one; return when all of it is."""
    places = [place_of(of.module, of.name, of.signature) for of in functions]
    there = {k for k, place in enumerate(places) if place.is_file()}
    left = sorted(set(range(len(functions))) - there, key=_ways_to_the_end(functions).__getitem__, reverse=True)
    patient_until = time.monotonic() + CLAIM_S
    while left:
        ready = [k for k in left if there.issuperset(functions[k].calls)]
        for k in ready:
            with _claimed(places[k]) as claimed:
                mine = claimed or time.monotonic() > patient_until  # somebody's claim that cannot be taken away
                if mine and not places[k].is_file():
                    function_at(functions[k].module, functions[k].name).compile(functions[k].signature)
                    there.add(k)
            if mine:
                break
        else:
            time.sleep(POLL_S)
        there |= {k for k in left if places[k].is_file()}
        if not there.isdisjoint(left):
            patient_until = time.monotonic() + CLAIM_S
        left = [k for k in left if k not in there]


def _ways_to_the_end(functions: Sequence[Listed]) -> list[float]:
    """Return how long each function and, one after the other, those that wait for it take. [s]"""
    ways = [of.seconds for of in functions]
    for k in reversed(range(len(functions))):  # who calls stands behind
        for called in functions[k].calls:
            ways[called] = max(ways[called], functions[called].seconds + ways[k])
    return ways


@contextmanager
def _claimed(place: Path) -> Iterator[bool]:
    """Take a function for this process; False where another one has it."""
    claim = place.with_name(f".{place.name}.claim")
    try:
        claim.parent.mkdir(parents=True, exist_ok=True)
        with claim.open("x", encoding="utf-8") as file:
            file.write(f"{socket.gethostname()} {os.getpid()}")
    except FileExistsError:
        with suppress(OSError):
            if _left_behind(claim):
                claim.unlink()
        yield False
    except OSError:  # a full disk or a folder of somebody else's: each process for itself
        yield True
    else:
        try:
            yield True
        finally:
            claim.unlink(missing_ok=True)


def _left_behind(claim: Path) -> bool:
    """Return whether nobody is at work any more who claimed a function."""
    if time.time() - claim.stat().st_mtime > CLAIM_S:
        return True
    host, _, pid = claim.read_text(encoding="utf-8").partition(" ")
    if os.name != "posix" or host != socket.gethostname() or not pid:
        return False
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return True
    except PermissionError:  # somebody else's process
        return False
    return False


# --- the list as a file -------------------------------------------------------------------------------------


def read_list(file: Path) -> list[Listed]:
    """Read a list that `write_list` wrote."""
    content = json.loads(file.read_text(encoding="utf-8"))
    found: list[Any] = []
    for kind, *detail in content["types"]:
        found.append(_type(kind, detail, found))
    return [
        Listed(f["module"], f["name"], tuple(found[i] for i in f["types"]), tuple(f["calls"]), f["seconds"])
        for f in content["functions"]
    ]


def write_list(file: Path, functions: Sequence[Listed]) -> None:
    """Write a list as JSON, one function a line, types that occur in several signatures once."""
    table: dict[str, int] = {}
    lines = [
        {
            "module": of.module,
            "name": of.name,
            "types": [_number(kind, table) for kind in of.signature],
            "calls": of.calls,
            "seconds": round(of.seconds, 2),
        }
        for of in functions
    ]
    types = ",\n".join(table)
    content = ",\n".join(json.dumps(line) for line in lines)
    file.write_text(f'{{"types": [\n{types}\n], "functions": [\n{content}\n]}}\n', encoding="utf-8")


def _number(kind: Any, table: dict[str, int]) -> int:
    """Return a type's place in the table, to which it is added."""
    if isinstance(kind, types.Array):
        row = ["array", _number(kind.dtype, table), kind.ndim, kind.layout, kind.mutable, kind.aligned]
    elif isinstance(kind, types.BaseTuple):
        of = getattr(kind, "instance_class", tuple)
        row = ["tuple", of.__module__, of.__qualname__, *(_number(part, table) for part in kind)]
    elif isinstance(kind, types.Literal):
        row = ["literal", kind.literal_value]
    else:
        row = ["plain", str(kind)]
    return table.setdefault(json.dumps(row), len(table))


def _type(kind: str, detail: Sequence[Any], known: Sequence[Any]) -> Any:
    """Return the type that a row of the table stands for."""
    if kind == "array":
        of, ndim, layout, mutable, aligned = detail
        return types.Array(known[of], ndim, layout, readonly=not mutable, aligned=aligned)
    if kind == "tuple":
        module, name, *parts = detail
        of = attrgetter(name)(importlib.import_module(module))
        return types.BaseTuple.from_types([known[i] for i in parts], of)
    return types.literal(detail[0]) if kind == "literal" else getattr(types, detail[0])
