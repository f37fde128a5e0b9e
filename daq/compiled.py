"""Compiled functions, and what is kept of them between processes: never code of another text.

Numba's own cache decides by the text of the file a function stands in, but the machine code also holds what that
file imports: constants, NamedTuples, other compiled functions. Here the folder of what is kept bears the hash of
a module's text and that of every module of this project it imports, directly or through others. So a change
anywhere below is another folder, two versions side by side do not meet, and an older text finds its own code
again, wherever it is installed. It lies under ``NUMBA_CACHE_DIR`` or the user's cache folder; where neither can be
written, each process compiles for itself. A file is one signature on one kind of processor, with its checksum:
what is damaged is compiled anew. A process that outlives an update, a notebook say, may hold modules of the text
of before beside new ones: where a text below has changed since it began to import, nothing is kept or taken. And
one that has set a module's number to another value than its text gives it keeps code of its own: what a function
takes from around it is part of its file's name.

Each function is machine code of its own, which those that call it only refer to. Numba would build the code of all
that is called, directly or through others, into every caller and optimise it there once more: of a first start of
the live sensor a third of the time, for no gain in speed. (2026-11-23; numba 0.68;
``pytest -m benchmark tests/benchmarks/test_first_start.py tests/benchmarks/test_live_sensor.py``)
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import os
import pickle
import secrets
import shutil
import sys
from collections.abc import Callable
from functools import cache
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NamedTuple, NoReturn

import llvmlite
import llvmlite.binding
import numba
import numpy as np
from numba import njit
from numba.core.compiler import CompileResult
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

_ROOT = Path(__file__).parents[1]
_PACKAGES = ("daq", "softsensor")
_KEPT = 8
"""Versions of a module's compiled code that are kept, by last use: enough to go to and fro between a few releases
or branches; all modules together took 13 MB a version on 2026-11-22."""


def compiled(*, inner: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function with Numba's `njit` and keeps the machine code.

    Parameters
    ----------
    inner
        Only compiled functions call it. What takes Python's objects apart for a call is not made then, which for
        bundles of arrays takes as long as all the rest; called from Python it raises TypeError.
    options
        Of `numba.njit`, without ``cache``.
    """

    def compile_and_keep(function: Callable[..., Any]) -> Any:
        made = njit(no_cfunc_wrapper=True, no_cpython_wrapper=inner, **options)(function)
        if made is not function:  # NUMBA_DISABLE_JIT leaves it as it is
            if inner:
                made.__class__ = _Inner
            made._cache = _Kept(function)  # noqa: SLF001 - where Numba's own cache=True puts its own
            _FUNCTIONS[function.__module__, function.__qualname__] = made
        return made

    return compile_and_keep


class _Inner(CPUDispatcher):  # type: ignore[misc]
    """A compiled function whose machine code Python has no way into."""

    def __call__(self, *_given: Any, **_by_name: Any) -> NoReturn:
        """Refuse: the code that would be called is not there."""
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
        raise TypeError(f"{name} is compiled for compiled functions only; drop inner=True to call it from Python")


class _Kept:
    """A function's machine code on disk, in the form in which Numba asks for it and hands it over."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.cache_path = str(_folder(function.__module__))
        self._function = function
        self._name = f"{function.__name__}-{function.__code__.co_firstlineno}"

    def _path(self, key: object) -> Path:
        text = repr((key, _around(self._function), numba.config.BOUNDSCHECK))
        return Path(self.cache_path, f"{self._name}-{hashlib.sha256(text.encode()).hexdigest()[:16]}")

    def place_of(self, signature: Any, context: Any) -> Path:
        """Return the file of a signature on this processor."""
        return self._path((signature, context.codegen().magic_tuple()))

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the machine code for a signature, None where none is kept."""
        key = (signature, context.codegen().magic_tuple())
        try:
            kept = self._path(key).read_bytes()
        except OSError:
            return None
        if hashlib.sha256(kept[32:]).digest() != kept[:32]:
            return None
        of, called, symbols, reduced = pickle.loads(kept[32:])
        if of != key or not symbols.all_known(context):
            return None
        for symbol, code in called:
            llvmlite.binding.add_symbol(symbol, code.address())
        context.codegen()._engine._defined_symbols |= symbols.defined  # noqa: SLF001 - Numba takes them from bitcode
        result = CompileResult._rebuild(context, *reduced)  # noqa: SLF001 - as Numba does
        self._stand_apart(signature, result)
        return result

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep the machine code for a signature, unless it holds addresses of this process."""
        key = (signature, result.codegen.magic_tuple())
        kept = not (result.lifted or result.library.has_dynamic_globals)
        self._stand_apart(signature, result)
        if not kept:
            return
        text = dumps((key, _called(result), _Symbols.of(result), result._reduce()))  # noqa: SLF001 - as Numba does
        try:
            _write(self._path(key), hashlib.sha256(text).digest() + text)
        except OSError:  # a full disk or a folder of somebody else's: compiled again next time
            return

    def flush(self) -> None:
        """Nothing waits to be written."""

    def _stand_apart(self, signature: Any, result: CompileResult) -> None:
        """Let callers of a function refer to its machine code in place of building it into their own.

        So nothing but machine code need be kept; reading the rest took a tenth of the time of loading (2026-11).
        """
        of = self._function
        _CODE[result.fndesc.llvm_func_name] = _Code(of.__module__, of.__qualname__, signature)
        # what Numba would link into a caller: nothing, since the caller declares what it calls by itself
        result.library._shared_module = llvmlite.binding.parse_assembly("")  # noqa: SLF001


def _around(function: Callable[..., Any]) -> list[tuple[str, str]]:
    """Return what a function takes from its module and others of this project, as Numba would build it in now."""
    names = sorted(_names_in(function.__code__))
    found = {name: function.__globals__[name] for name in names if name in function.__globals__}
    modules = [one for one in found.values() if isinstance(one, ModuleType)]
    ours = [one for one in modules if one.__name__.partition(".")[0] in _PACKAGES]
    found |= {f"{one.__name__}.{name}": getattr(one, name) for one in ours for name in names if hasattr(one, name)}
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    found |= {f"{name} around": cell.cell_contents for name, cell in cells}
    return [(name, _mark(value)) for name, value in found.items()]


def _names_in(code: CodeType) -> set[str]:
    """Return the names in bytecode, that of what is written within it too."""
    inner = (one for one in code.co_consts if isinstance(one, CodeType))
    return set(code.co_names).union(*map(_names_in, inner))


def _mark(value: Any) -> str:
    """Return by what a value is known again: a number by itself, a function or a class by where it stands."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, tuple):
        return f"{type(value).__qualname__} {[_mark(one) for one in value]}"
    named = getattr(value, "py_func", value)
    if hasattr(named, "__qualname__"):
        return f"{named.__module__} {named.__qualname__}"
    return value.__name__ if isinstance(value, ModuleType) else repr(value)


class _Code(NamedTuple):
    """Where a compiled function stands, and for which signature."""

    module: str
    name: str
    signature: Any

    def address(self) -> int:
        """Return where the machine code lies in this process, loaded or compiled if it does not yet."""
        function = function_at(self.module, self.name)
        function.compile(self.signature)
        result = function.overloads[self.signature]
        return int(result.library.get_pointer_to_function(result.fndesc.llvm_func_name))


class _Symbols(NamedTuple):
    """The names in a function's machine code: of what it is, and of what it needs that is not this project's."""

    defined: frozenset[str]
    needed: frozenset[str]

    @classmethod
    def of(cls, result: CompileResult) -> _Symbols:
        """Return the names in the code of a compiled function."""
        module = result.library._final_module  # noqa: SLF001
        defined, needed = set[str](), set[str]()
        for one in (*module.functions, *module.global_variables):
            (needed if one.is_declaration else defined).add(one.name)
        foreign = (name for name in needed - _CODE.keys() if not name.startswith("llvm."))
        return cls(frozenset(defined), frozenset(foreign))

    def all_known(self, context: Any) -> bool:
        """Return whether all that is needed is in this process, for which as little as does it is loaded.

        Numba makes ready to compile before it loads what is compiled: that imports SciPy's linear algebra and all
        by which code can be typed, and took 0.3 of a live sensor's 0.9 s (2026-11).
        """
        ways: tuple[Callable[[Any], Any], ...] = (lambda _: None, rtsys.initialize, type(context).refresh)
        for load in ways:
            load(context)
            if all(llvmlite.binding.address_of_symbol(name) is not None for name in self.needed):
                return True
        return False


def function_at(module: str, name: str) -> Any:
    """Return a compiled function, whose module is imported for it."""
    importlib.import_module(module)
    return _FUNCTIONS[module, name]


def place_of(module: str, name: str, signature: Any) -> Path:
    """Return the file in which a function's machine code for a signature is kept, here and on this processor."""
    function = function_at(module, name)
    return Path(function._cache.place_of(signature, function.targetctx))  # noqa: SLF001 - put there above


_FUNCTIONS: dict[tuple[str, str], Any] = {}
"""The compiled functions of this process by module and name."""
_CODE: dict[str, _Code] = {}
"""What the symbols of compiled functions in this process stand for."""


def _called(result: CompileResult) -> list[tuple[str, _Code]]:
    """Return the compiled functions of this project that the machine code of one refers to, by their symbols."""
    functions = result.library._final_module.functions  # noqa: SLF001
    return [(of.name, _CODE[of.name]) for of in functions if of.is_declaration and of.name in _CODE]


def _write(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; with a module's first file its oldest versions go."""
    if not path.parent.is_dir():
        path.parent.mkdir(parents=True, exist_ok=True)
        versions = path.parent.parent.iterdir()
        for old in sorted(versions, key=lambda folder: folder.stat().st_mtime, reverse=True)[_KEPT:]:
            shutil.rmtree(old, ignore_errors=True)
    new = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
    new.write_bytes(content)
    new.replace(path)


@cache
def _folder(module: str) -> Path:
    """Return the folder of what is kept of a module as it reads now, and note that it is in use."""
    below = sorted(_below(module))
    if any(_changed_since_import(name) for name in below):
        return Path(os.devnull, module)  # where nothing can be read or written
    text = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__} {sys.implementation.cache_tag}".encode())
    for name in below:
        text.update(f"\0{name}\0".encode() + _source(name).read_bytes())
    base = Path(numba.config.CACHE_DIR or AppDirs("kerntemp", appauthor=False).user_cache_dir)
    folder = base / "compiled" / module / text.hexdigest()[:24]
    with contextlib.suppress(OSError):  # none yet, or one that may only be read
        os.utime(folder)
    return folder


def _changed_since_import(module: str) -> bool:
    """Whether a module's text may be another one than this process has imported."""
    state, package = _source(module).stat(), sys.modules[module.partition(".")[0]]
    return bool(max(state.st_mtime, state.st_ctime) > package.IMPORTED_S)


def _below(module: str) -> set[str]:
    """Return a module and all of this project's that it imports, directly or through others."""
    found, waiting = {module}, [module]
    while waiting:
        new = _imported(waiting.pop()) - found
        found |= new
        waiting += new
    return found


@cache
def _imported(module: str) -> frozenset[str]:
    """Return the modules of this project that a module's import statements name, from its bytecode: no parsing."""
    code = SourceFileLoader(module, str(_source(module))).get_code(module)
    names = () if code is None else code.co_names
    dotted = {name for name in names if name.partition(".")[0] in _PACKAGES}
    packages = [name for name in dotted if _source(name).name == "__init__.py"]
    inside = {f"{package}.{name}" for package in packages for name in names}
    return frozenset(name for name in dotted | inside if _source(name).is_file())


@cache
def _source(module: str) -> Path:
    """Return where a module's text stands: the package's own file if it is one."""
    path = _ROOT.joinpath(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
