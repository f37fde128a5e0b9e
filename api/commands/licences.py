"""What is shipped in the wheel or installed with it, and under which licence."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution

SHIPPED = (
    ("uPlot 1.6.32 (in the wheel, api/page/vendor)", "MIT"),
    ("@fluent/bundle 0.19.1 (in the wheel, api/page/vendor)", "Apache-2.0"),
)
"""The page's libraries, for charts and for words; their licence texts lie beside them."""
OPTIONAL = ("plant", "postgresql", "dask")
"""Extras that belong to a working system; those for tests do not."""


@dataclass(frozen=True)
class Licence:
    """One package and its licence."""

    name: str
    version: str
    licence: str


def licences(root: str = "kerntemp") -> list[Licence]:
    """Return every installed package that `root` brings along, by name."""
    found: dict[str, Licence] = {}
    waiting = _required(distribution(root), OPTIONAL)
    while waiting:
        name, extras = waiting.pop()
        if name in found:
            continue
        try:
            package = distribution(name)
        except PackageNotFoundError:
            continue  # for another system, or of an extra that is not installed
        found[name] = Licence(package.metadata["Name"], package.version, licence_of(package))
        waiting += _required(package, extras)
    return [found[name] for name in sorted(found)]


def licence_of(package: Distribution) -> str:
    """Return a package's licence in a few words, empty where it names none."""
    metadata = package.metadata
    for expression in metadata.get_all("License-Expression") or ():
        return str(expression)
    classifiers = [
        c.rpartition(" :: ")[2] for c in metadata.get_all("Classifier") or () if c.startswith("License ::")
    ]
    if classifiers := [c for c in classifiers if c != "OSI Approved"]:
        return ", ".join(classifiers)
    texts = [str(text).strip().split("\n")[0] for text in metadata.get_all("License") or ()]
    return texts[0][:80] if texts else ""


def licence_lines() -> list[str]:
    """Return the list for a terminal."""
    rows = [(f"{item.name} {item.version}", item.licence or "not stated") for item in licences()]
    own = distribution("kerntemp")
    rows = [(f"kerntemp {own.version} (this program)", licence_of(own) or "not stated"), *SHIPPED, *rows]
    width = max(len(name) for name, _ in rows)
    return [f"{name:{width}}  {licence}" for name, licence in rows]


def _required(package: Distribution, extras: tuple[str, ...]) -> list[tuple[str, tuple[str, ...]]]:
    """Return name and extras of what a package needs with these extras of its own."""
    found = []
    for text in package.requires or ():
        requirement, _, marker = text.partition(";")
        wanted = re.search(r"extra\s*==\s*['\"]([^'\"]+)", marker)
        parts = re.match(r"\s*([\w.-]+)\s*(?:\[([^\]]*)\])?", requirement)
        if parts and (wanted is None or wanted.group(1) in extras):
            extras = tuple(filter(None, re.split(r"[\s,]+", parts.group(2) or "")))
            found.append((parts.group(1).lower().replace("_", "-"), extras))
    return found
