"""Inference reads and writes nothing: what it may import is listed, whatever else there is."""

import ast
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
(ROOMS,) = (c["source_modules"] for c in CONTRACTS if c["name"].startswith("inference does no I/O"))
PURE = {
    *("__future__", "collections", "collections.abc", "copy", "dataclasses", "enum", "functools", "itertools"),
    *("json", "math", "numbers", "re", "statistics", "types", "typing", "zlib", "pydantic"),
    *("numpy", "numpy.polynomial", "numpy.typing"),
    *("scipy.integrate", "scipy.linalg", "scipy.optimize", "scipy.special"),
}
OURS = ("daq", "softsensor")
"""What of them inference may know is import-linter's to watch."""
IN_ONE_FILE = {
    ("softsensor/diagnosis/extension.py", "concurrent.futures"),  # two threads for its runs
    ("softsensor/diagnosis/verdict.py", "time"),  # how long it took
    ("softsensor/effects/__init__.py", "importlib.metadata"),  # effects of one's own, by their entry points
    ("softsensor/heat/exact.py", "threading"),  # its lock
}
FILES = {"open", "input", "fromfile", "genfromtxt", "load", "loadtxt", "memmap", "save", "savetxt", "savez"}
"""Calls that read or write without an import that shows it: Python's own and numpy's."""


def reaching_out(root):
    """Yield each file of inference with what it imports or calls that may read or write."""
    for path in sorted(one for room in ROOMS for one in (root / room.replace(".", "/")).rglob("*.py")):
        name = path.relative_to(root).as_posix()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            for module in modules:
                if module.split(".")[0] not in OURS and module not in PURE:
                    yield name, module
            if isinstance(node, ast.Call) and ast.unparse(node.func).removeprefix("np.") in FILES:
                yield name, ast.unparse(node.func)


def test_inference_imports_and_calls_nothing_that_reads_or_writes():
    assert set(reaching_out(ROOT)) == IN_ONE_FILE


def test_a_library_nobody_thought_of_and_a_file_opened_without_import_are_seen(tmp_path):
    room = tmp_path / "softsensor" / "heat"
    room.mkdir(parents=True)
    lines = (
        "import numpy as np",
        "import httpx",
        "from glob import glob",
        "from scipy import io",
        "from . import mesh",
    )
    calls = ("open('x')", "np.load('x')", "model.load('x')", "np.max([1])")
    (room / "one.py").write_text("\n".join((*lines, *calls)), encoding="utf-8")
    seen = [what for _, what in reaching_out(tmp_path)]
    assert seen == ["httpx", "glob", "scipy", "", "open", "np.load"]


def test_every_room_but_the_jobs_the_reports_and_the_face_is_inference():
    rooms = {path.parent.name for path in (ROOT / "softsensor").glob("*/__init__.py")}
    assert rooms - {room.removeprefix("softsensor.") for room in ROOMS} == {"face", "jobs", "report"}
