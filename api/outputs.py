"""What commands write: everything or nothing, and a sign of life while work takes long."""

from __future__ import annotations

import json
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from tempfile import gettempdir
from typing import Any
from uuid import uuid4

from daq.records import InputError
from daq.tables import reason_of
from daq.words import Message, say
from daq.words.message import ENGLISH, words

_LANGUAGE = ContextVar("language of the terminal", default=ENGLISH)
_PIPED = ContextVar("standard output belongs to a file asked for as -", default=False)
_HEARD = ContextVar("when the terminal last showed a sign of life [s]", default=-float("inf"))
STANDARD_OUTPUT = Path("-")
"""Stands for standard output where a file to write is asked for; messages go to standard error then."""
PATIENCE_S = 1.0
"""A terminal that was silent for longer than this shows progress."""
NAMED_FILES = 4
"""Files of a folder that are named one by one when written: what `fit` has options for, figures aside."""


def speak(language: str) -> None:
    """Choose the language of all that this process says at the terminal; once, where it starts."""
    _LANGUAGE.set(language)
    _PIPED.set(False)
    _HEARD.set(time.monotonic())


def spoken_language() -> str:
    """Return the terminal's language, which reports written from it have too."""
    return _LANGUAGE.get()


def in_words(*messages: Message | str) -> str:
    """Return messages in the terminal's language, one after the other; a plain text as it is."""
    return " ".join(words(one, _LANGUAGE.get()) for one in messages)


def write_line(message: Message | str) -> None:
    """Write a line to standard output, at once; to standard error where a file goes to standard output."""
    stream = sys.stderr if _PIPED.get() else sys.stdout
    stream.write(in_words(message) + "\n")
    stream.flush()


def write_table(heads: Sequence[Message], rows: Iterable[Sequence[str]]) -> None:
    """Write a list under its heads: in columns on a terminal, else parted by tabs for other programs."""
    lines = [[in_words(head) for head in heads], *(list(row) for row in rows)]
    if not sys.stdout.isatty():
        for line in lines:
            write_line("\t".join(line))
        return
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        write_line("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def warn(message: Message | str) -> None:
    """Write a line to standard error, with the program's name."""
    sys.stderr.write(f"kerntemp: {in_words(message)}\n")


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Write what is warned of from Python as `warn` does; Python itself would name a line of our code."""

    def show(message: Warning | str, *_where: object, **_more: object) -> None:
        from daq.given import DoubtWarning  # loads slowly, and most commands doubt nothing

        warn(message.doubt if isinstance(message, DoubtWarning) else str(message))

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield


class WorkFailed(Exception):
    """The input was right and the work failed all the same: one line, exit status 1."""


def check_writable(*paths: Path | None, inputs: Iterable[Path] = ()) -> None:
    """Refuse outputs that cannot be written, or would overwrite an input or one another, before any work is done.

    Parameters
    ----------
    paths
        What the command will write; None where it was not asked for.
    inputs
        Files it reads.

    Raises
    ------
    InputError
        Naming the path and what is wrong with it.
    """
    outputs = [path for path in paths if path is not None]
    if STANDARD_OUTPUT in outputs:
        _PIPED.set(True)
    for path in outputs:
        if path.is_dir():
            raise InputError(say("terminal-output-not-a-file", path=str(path)))
        if not path.absolute().parent.is_dir():
            raise InputError(say("terminal-output-no-folder", path=str(path), folder=str(path.absolute().parent)))
    read = list(inputs)
    for i, path in enumerate(outputs):
        if any(_same_file(path, other) for other in read):
            raise InputError(say("terminal-output-is-input", path=str(path)))
        if any(_same_file(path, other) for other in outputs[:i]):
            raise InputError(say("terminal-output-twice", path=str(path)))


def _same_file(one: Path, other: Path) -> bool:
    """Whether two paths lead to one file, through links too."""
    if one.exists() and other.exists():
        return one.samefile(other)
    return one.resolve() == other.resolve()


def write_all(contents: Mapping[Path, str | bytes | Callable[[Path], None]]) -> None:
    """Write every file and say so, or leave none behind: temporary files first, then renames.

    A callable writes its file itself, to the path it is given.
    """
    finished: dict[Path, Path] = {}
    piped = ""
    try:
        for path, content in contents.items():
            folder = Path(gettempdir()) if path == STANDARD_OUTPUT else path.parent
            draft = folder / f".{path.stem}.{uuid4().hex[:8]}{path.suffix}"
            finished[draft] = path
            if callable(content):
                content(draft)
            elif isinstance(content, bytes):
                draft.write_bytes(content)
            else:
                draft.write_text(content, encoding="utf-8", newline="\n")
        for draft, path in finished.items():
            if path == STANDARD_OUTPUT:
                piped = draft.read_text(encoding="utf-8")
            else:
                draft.replace(path)
    except OSError as error:
        problem = say("terminal-output-unwritable", path=str(error.filename), why=reason_of(error))
        raise WorkFailed(problem) from error
    finally:
        for draft in finished:
            draft.unlink(missing_ok=True)
    sys.stdout.write(piped)
    sys.stdout.flush()
    _name_written(path for path in contents if path != STANDARD_OUTPUT)


def _name_written(paths: Iterable[Path]) -> None:
    """Name each file, where a folder has many only that."""
    folders: dict[Path, list[Path]] = {}
    for path in paths:
        folders.setdefault(path.parent, []).append(path)
    for folder, files in folders.items():
        if len(files) > NAMED_FILES:
            write_line(say("terminal-written-several", files=len(files), folder=str(folder)))
            continue
        for path in files:
            write_line(say("terminal-written", path=str(path)))


def as_json(value: Any) -> str:
    """Return JSON text that is the same for the same value; NaN has no place in it."""
    return json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


@contextmanager
def working(what: Message, total: int | None = None) -> Iterator[Callable[[int], None]]:
    """Show `what` with elapsed time and a bar once nothing was written for 1 s, on a terminal only.

    Yields a function that takes how much is done.
    """
    if not sys.stderr.isatty():
        yield lambda _done: None
        return
    from rich.console import Console  # a quarter of what `kerntemp --help` would import
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    bar = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    task = bar.add_task(in_words(what), total=total)
    silent_s = time.monotonic() - _HEARD.get()
    timer = threading.Timer(max(PATIENCE_S - silent_s, 0.0), bar.start)
    timer.daemon = True
    timer.start()
    try:
        yield lambda done: bar.update(task, completed=done)
    finally:
        timer.cancel()
        if bar.live.is_started:
            _HEARD.set(time.monotonic())
        bar.stop()
