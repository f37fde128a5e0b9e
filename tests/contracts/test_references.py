"""What docstrings, comments and pages name in backticks is there, under the name and in the module they give.

A name of one word stands somewhere in the code. One with points is a module, or what it defines (what it only
imports stands elsewhere: a reader would look for it in vain), or a field or method of a class, or of something
that the same file handles, or of a library, or a key of a run's header, or a parameter of an effect. Of tests and
pages, which name commands, files and settings too, those names count that begin with something of ours.
"""

import ast
import importlib
import re
from functools import cache
from pathlib import Path

import pytest

from softsensor.effects import BUILT_IN

ROOT = Path(__file__).parents[2]
PACKAGES = ("softsensor", "daq", "api")
REFERENCE = re.compile(r"(?<!`)`([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)(?:\(\))?`(?!`)")
HEADER = ("panel", "setting", "ambient", "boundary", "initial", "recorded")
"""Tables of a run's header, whose keys have points too."""
CONFIGURED = ("store", "press", "server")
"""Tables of ``kerntemp.toml`` and of a press file that a module has the name of."""
PLACES = [p for name in (*PACKAGES, "tests") for p in sorted((ROOT / name).rglob("*.py")) if p != Path(__file__)]
PARAMETERS = {f"{effect.name}.{parameter.name}" for effect in BUILT_IN for parameter in effect.parameters}
GONE = "changes.md"
"""The page that also names what is no longer there."""
PAGES = [ROOT / "README.md", *(page for page in sorted((ROOT / "deploy").rglob("*.md")) if page.name != GONE)]


def dotted(path):
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@cache
def code():
    """Each module's tree, by its dotted name."""
    return {dotted(path): ast.parse(path.read_text(encoding="utf-8")) for path in PLACES}


def bound(target):
    return {node.id for node in ast.walk(target) if isinstance(node, ast.Name)}


def members(body):
    """What the statements of a module or of a class define, classes with what they hold, to any depth."""
    found = {}
    for node in body:
        if isinstance(node, ast.ClassDef):
            fields = {
                n.attr: {}
                for n in ast.walk(node)
                if isinstance(n, ast.Attribute) and ast.unparse(n.value) == "self"
            }
            bases = {ast.unparse(base).split(".")[-1] for base in node.bases}
            found[node.name] = fields | members(node.body) | ({"": bases} if bases else {})
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            found[node.name] = {}
        elif isinstance(node, ast.Assign):
            found |= {name: {} for target in node.targets for name in bound(target)}
        elif isinstance(node, ast.AnnAssign):
            found |= {name: {} for name in bound(node.target)}
        elif isinstance(node, ast.If | ast.Try):
            found |= members(node.body)
    return found


@cache
def defined():
    """What each module defines; of a package's face also what its `__init__` loads on first use."""
    found = {name: members(tree.body) for name, tree in code().items()}
    for package in ("daq", "softsensor"):
        texts = (n.value for n in ast.walk(code()[package]) if isinstance(n, ast.Constant))
        found[package] |= {text: {} for text in texts if isinstance(text, str) and text.isidentifier()}
    return found


@cache
def classes():
    """What the classes of a name hold, what they inherit from ours included."""
    own = {}
    for module in defined().values():
        for name, holds in module.items():
            if holds:
                own.setdefault(name, []).append(holds)
    return own


@cache
def handled(module):
    """Names that a module binds or reads, and attributes that it reads or sets."""
    nodes = list(ast.walk(code()[module]))
    names = {n.id for n in nodes if isinstance(n, ast.Name)} | {n.arg for n in nodes if isinstance(n, ast.arg)}
    names |= {(n.asname or n.name).split(".")[-1] for n in nodes if isinstance(n, ast.alias)}
    return names, {n.attr for n in nodes if isinstance(n, ast.Attribute)}


@cache
def words():
    """All words of the code that are no words of its docstrings and comments: names, keys, short texts."""
    nodes = [n for module, tree in code().items() if module.split(".")[0] in PACKAGES for n in ast.walk(tree)]
    texts = (
        n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str) and " " not in n.value
    )
    found = {word for text in texts for word in re.findall(r"\w+", text)}
    for node in nodes:
        for field in ("id", "arg", "attr", "name", "asname"):
            if isinstance(word := getattr(node, field, None), str):
                found |= set(word.split("."))
    return found | {part for module in code() for part in module.split(".")}


def holds(there, parts):
    """Whether a class or a module holds a name, or a class that holds it, and so on; of its bases too."""
    if not parts:
        return True
    if parts[0] in there:
        return holds(there[parts[0]], parts[1:])
    return any(holds(one, parts) for base in there.get("", ()) for one in classes().get(base, ()))


def of_a_library(parts):
    for end in range(len(parts) - 1, 0, -1):
        try:
            here = importlib.import_module(".".join(parts[:end]))
        except ImportError:
            continue
        for part in parts[end:]:
            here = getattr(here, part, None)
        return here is not None
    return False


def of_the_code(parts):
    """Whether a name with points, no file, begins with something of ours or ends with a constant."""
    if len(parts) == 1 or parts[-1] in ("py", "json", "toml", "md"):
        return False
    return parts[0] in {*PACKAGES, "tests"} | rooms() or parts[0] in classes() or parts[-1].isupper()


@cache
def rooms():
    """The last words of our modules that no key of a file begins with."""
    return {m.split(".")[-1] for m in code()} - {*HEADER, *CONFIGURED}


def ours(parts):
    """Whether a name with points is a module of ours, what one defines, or what a class of ours holds."""
    for end in range(len(parts), 0, -1):
        start = ".".join(parts[:end])
        modules = [m for m in code() if m == start or m.endswith(f".{start}")]
        if any(holds(defined()[m], parts[end:]) for m in modules):
            return True
    return any(holds(one, parts[1:]) for one in classes().get(parts[0], ()))


def is_there(reference, module):
    parts = reference.split(".")
    if len(parts) == 1:
        return reference in words()
    if ours(parts) or parts[0] in HEADER or reference in PARAMETERS:
        return True
    names, attributes = handled(module)
    return (parts[0] in names and set(parts[1:]) <= attributes) or of_a_library(parts)


def named(path):
    """Yield line and name of each reference of a file."""
    for line, text in enumerate(path.read_text(encoding="utf-8").split("\n"), 1):
        yield from ((line, reference) for reference in REFERENCE.findall(text))


@pytest.mark.parametrize("package", PACKAGES)
def test_every_name_in_backticks_in_the_code_is_there(package):
    stale = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in PLACES
        if path.is_relative_to(ROOT / package)
        for line, name in named(path)
        if not is_there(name, dotted(path))
    ]
    assert stale == []


def test_every_name_of_the_code_that_tests_and_pages_give_is_there():
    stale = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in (*PAGES, *(path for path in PLACES if path.is_relative_to(ROOT / "tests")))
        for line, name in named(path)
        if of_the_code(name.split(".")) and not ours(name.split("."))
    ]
    assert stale == []


def test_a_name_that_moved_is_no_longer_there():
    assert ours(["heat", "step_terms", "BOILING_C"])
    assert ours(["Digest", "trust"])
    assert not ours(["moisture_evaporation", "BOILING_C"])
    assert not ours(["Digest", "belief"])
    assert not is_there("a_name_nobody_gave", "daq.records")
