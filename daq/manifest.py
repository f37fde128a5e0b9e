"""What was exported, with SHA-256 sums: ``SHA256SUMS`` as ``sha256sum --check`` reads it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

from daq.records import InputError

NAME = "SHA256SUMS"


def manifest_text(files: Iterable[Path]) -> str:
    """Return one line a file: sum, two spaces, name."""
    return "".join(f"{_sum(path)}  {path.name}\n" for path in sorted(files))


def check_manifest(folder: Path) -> list[Path]:
    """Return the files a manifest lists, all of them whole.

    Raises
    ------
    InputError
        Naming the first file that is missing or changed.
    """
    manifest = folder / NAME
    try:
        lines = manifest.read_text(encoding="utf-8").split("\n")
    except OSError as error:
        raise InputError(f"{manifest}: cannot read: {error.strerror or error}") from error
    files = []
    for number, line in enumerate(lines, start=1):
        if not line:
            continue
        expected, mark, name = line.partition("  ")
        if not mark or len(expected) != 64:
            raise InputError(f"{manifest}: line {number}: not 'SHA-256 sum, two spaces, file name'")
        path = folder / name
        if not path.is_file():
            raise InputError(f"{path}: listed in {NAME}, but not there; export again")
        if _sum(path) != expected:
            raise InputError(f"{path}: changed since it was exported; export again, or remove it from {NAME}")
        files.append(path)
    return files


def _sum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
