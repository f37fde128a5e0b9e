"""Compiled code that is kept: never that of another text, in a small tree of its own."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from daq.compiled import _below

ROOT = Path(__file__).parents[2]
MODULES = {
    "daq/__init__.py": "from time import time\n\nIMPORTED_S = time()\n",
    "softsensor/__init__.py": "from time import time\n\nIMPORTED_S = time()\n",
    "softsensor/constants.py": "SHARE = 0.5\n",
    "softsensor/shapes.py": (
        "from typing import NamedTuple\n\n\nclass Layer(NamedTuple):\n    thickness: float\n    other: float\n"
    ),
    "softsensor/lower.py": (
        "from daq.compiled import compiled\nfrom softsensor import constants\n\nSHARE = constants.SHARE\n\n\n"
        "@compiled()\ndef half(x):\n    return SHARE * x\n"
    ),
    "softsensor/upper.py": (
        "from daq.compiled import compiled\nfrom softsensor import lower\nfrom softsensor.shapes import Layer\n\n"
        "half = lower.half\n\n\n@compiled()\ndef flow(layer):\n    return half(layer.thickness) + 1.0\n"
    ),
}
CALL = (
    "from softsensor.upper import flow\nfrom softsensor.shapes import Layer\n"
    "print(flow(Layer(thickness=8.0, **{name: 3.0 for name in Layer._fields if name != 'thickness'})), "
    "sum(flow.stats.cache_misses.values()))"
)
DEFINED = (
    "sum(line.startswith('define') and 'lower4half' in line and 'cpython' not in line and 'cfunc' not in line "
    "for text in flow.inspect_llvm().values() for line in text.splitlines())"
)
"""How often machine code of a function's own holds the lower function."""


@pytest.fixture
def tree(tmp_path):
    """A package of two compiled functions, with the project's own decorator."""
    for name, text in MODULES.items():
        place = tmp_path / "tree" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text, encoding="utf-8")
    shutil.copy(ROOT / "daq/compiled.py", tmp_path / "tree/daq/compiled.py")
    return tmp_path / "tree"


def answer(tree, kept=None, call=CALL):
    """Return what the upper function says in a process of its own, and how many signatures it had to compile."""
    line = [sys.executable, "-c", call]
    place = {"NUMBA_CACHE_DIR": str(kept or tree.parent / "kept"), "PYTHONPATH": str(tree)}
    done = subprocess.run(line, cwd=tree, env=os.environ | place, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    value, compiled = done.stdout.split()
    return float(value), int(compiled)


def change(tree, name, old, new):
    text = (tree / name).read_text(encoding="utf-8")
    assert old in text
    (tree / name).write_text(text.replace(old, new), encoding="utf-8")


def test_a_changed_constant_two_imports_below_is_seen_and_the_text_of_before_finds_its_code_again(tree):
    assert answer(tree) == (5.0, 1)
    assert answer(tree) == (5.0, 0)
    change(tree, "softsensor/constants.py", "0.5", "0.25")
    assert answer(tree) == (3.0, 1)
    moved = tree.rename(tree.with_name("installed-elsewhere"))
    change(moved, "softsensor/constants.py", "0.25", "0.5")
    assert answer(moved) == (5.0, 0)


@pytest.mark.parametrize("changed", ["lower.SHARE = 5.0", "constants.SHARE = 5.0", "upper.half = lower.all_of"])
def test_what_a_process_changed_around_a_function_is_kept_for_nobody_else(tree, changed):
    change(tree, "softsensor/lower.py", "return SHARE", "return constants.SHARE / 0.5 * SHARE")
    with (tree / "softsensor/lower.py").open("a", encoding="utf-8") as text:
        text.write("\n\n@compiled()\ndef all_of(x):\n    return x\n")
    changing = f"from softsensor import constants, lower, upper\n{changed}\n"
    other, _ = answer(tree, call=changing + CALL)
    assert other in (9.0, 41.0)
    assert answer(tree)[0] == 5.0
    assert answer(tree) == (5.0, 0)
    assert answer(tree, call=changing + CALL) == (other, 0)


def test_a_process_that_outlives_an_update_keeps_nothing_of_a_mixture_of_texts(tree):
    update = (
        "import softsensor.constants, pathlib\npath = pathlib.Path('softsensor/constants.py')\n"
        "path.write_text(path.read_text().replace('0.5', '0.75'))\n"
    )
    assert answer(tree, call=update + CALL) == (5.0, 1), "it has imported the text of before"
    assert answer(tree) == (7.0, 1)
    assert answer(tree) == (7.0, 0)


def test_a_changed_kernel_and_a_bundle_with_its_fields_exchanged_are_seen_in_the_module_above(tree):
    assert answer(tree) == (5.0, 1)
    change(tree, "softsensor/lower.py", "SHARE * x", "SHARE * x * x")
    assert answer(tree) == (33.0, 1)
    change(tree, "softsensor/shapes.py", "    thickness: float\n    other", "    other: float\n    thickness")
    assert answer(tree) == (33.0, 1)


def test_damaged_code_is_compiled_anew(tree):
    assert answer(tree) == (5.0, 1)
    files = [path for path in (tree.parent / "kept").rglob("*") if path.is_file()]
    assert len(files) == 2  # flow, and half that it calls
    for path in files:
        path.write_bytes(path.read_bytes()[:-100])
    assert answer(tree) == (5.0, 1)
    assert answer(tree) == (5.0, 0)


def test_a_caller_whose_code_is_kept_finds_that_of_what_it_calls_compiled_anew_under_another_symbol(tree):
    assert answer(tree) == (5.0, 1)
    (lower,) = (tree.parent / "kept/compiled/softsensor.lower").glob("*/*")
    lower.write_bytes(lower.read_bytes()[:-100])
    counted = "import numba\nnumba.njit(lambda: 0)()\n"  # Numba counts functions, and symbols bear the number
    assert answer(tree, call=counted + CALL) == (5.0, 0)
    assert answer(tree) == (5.0, 0)


def test_what_is_kept_is_loaded_without_what_compiles(tree):
    assert answer(tree) == (5.0, 1)
    loaded = "import sys\nprint((0.0 if 'numba.np.linalg' in sys.modules else 1.0) * flow"
    assert answer(tree, call=CALL.replace("print(flow", loaded)) == (5.0, 0)


def test_kept_code_that_needs_a_symbol_of_the_compilers_finds_it(tree):
    change(tree, "softsensor/lower.py", "SHARE * x", "SHARE * x + 0.0 * hash(str(x > 0.0))")
    assert answer(tree) == (5.0, 1)
    assert answer(tree) == (5.0, 0)


def test_kept_code_that_needs_a_symbol_nobody_has_is_compiled_anew(tree):
    assert answer(tree) == (5.0, 1)
    gone = "from daq.compiled import _Symbols\n_Symbols.all_known = lambda symbols, context: False\n"
    assert answer(tree, call=gone + CALL) == (5.0, 1)


def test_a_function_is_not_built_into_those_that_call_it(tree):
    assert answer(tree, call=CALL.replace("sum(flow.stats.cache_misses.values())", DEFINED)) == (5.0, 0)
    own = f"from softsensor.lower import half as flow\nprint(flow(8.0), {DEFINED})"
    assert answer(tree, kept=tree / "none", call=own) == (4.0, 1)


def test_a_function_that_only_compiled_ones_call_refuses_python_compiled_anew_and_kept(tree):
    change(tree, "softsensor/lower.py", "@compiled()", "@compiled(inner=True)")
    assert answer(tree) == (5.0, 1)
    refused = (
        "import numba\nfrom softsensor.lower import half\nhalf.compile((numba.float64,))\n"
        "try:\n    half(8.0)\nexcept TypeError as error:\n"
        "    told = 'softsensor.lower.half is compiled for' in str(error)\n"
        "    print(float(told), sum(half.stats.cache_misses.values()))"
    )
    assert answer(tree, call=refused) == (1.0, 0)
    assert answer(tree, call=CALL) == (5.0, 0)


def test_where_nothing_can_be_kept_each_process_compiles_for_itself(tree):
    (tree / "no-folder").touch()
    for _ in range(2):
        assert answer(tree, kept=tree / "no-folder") == (5.0, 1)


def test_the_oldest_of_many_versions_go_and_the_one_in_use_stays(tree):
    answer(tree)
    kept = tree.parent / "kept/compiled/softsensor.upper"
    (first,) = kept.iterdir()
    for number in range(9):
        (kept / f"version-{number}").mkdir()
        os.utime(kept / f"version-{number}", (number, number))
    os.utime(first, (0, 0))
    assert answer(tree) == (5.0, 0)
    change(tree, "softsensor/constants.py", "0.5", "0.25")
    assert answer(tree) == (3.0, 1)
    left = {folder.name for folder in kept.iterdir()}
    assert first.name in left
    assert left >= {f"version-{number}" for number in range(3, 9)}
    assert not left & {"version-0", "version-1", "version-2"}


def named_in(module):
    """Return the project's modules in the import statements of a module's text, by parsing it."""
    path = ROOT.joinpath(*module.split("."))
    text = (path / "__init__.py" if path.is_dir() else path.with_suffix(".py")).read_text(encoding="utf-8")
    names = set()
    for node in ast.parse(text).body:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in names if name.startswith(("daq", "softsensor")) and importable(name)}


def importable(name):
    path = ROOT.joinpath(*name.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


def kernels():
    for package in ("daq", "softsensor"):
        for path in (ROOT / package).rglob("*.py"):
            if "import compiled\n" in path.read_text(encoding="utf-8"):
                yield ".".join(path.relative_to(ROOT).with_suffix("").parts)


@pytest.mark.parametrize("module", sorted(kernels()))
def test_the_hash_covers_every_module_that_a_parser_finds_below_a_compiled_one(module):
    found, waiting = {module}, [module]
    while waiting:
        new = named_in(waiting.pop()) - found
        found |= new
        waiting += new
    assert found <= _below(module)
