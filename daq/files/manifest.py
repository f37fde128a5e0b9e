"""What was exported or backed up, with SHA-256 sums: ``SHA256SUMS`` beside it, for ``sha256sum --check``."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

from daq.records import InputError
from daq.tables import at, text_in
from daq.words import say

NAME = "SHA256SUMS"


def update_manifest(folder: Path, files: Iterable[Path]) -> None:
    """Write the sums of files into their folder's manifest; lines of other files stay."""
    sums = {**_listed(folder), **{path.name: _sum(path) for path in files}}
    text = "".join(f"{value}  {name}\n" for name, value in sorted(sums.items()))
    draft = folder / f".{NAME}"
    draft.write_text(text, encoding="utf-8", newline="\n")
    draft.replace(folder / NAME)


def check_listed(path: Path) -> None:
    """Refuse a file that its folder's manifest lists with another sum.

    Raises
    ------
    InputError
        For a file changed since it was written, or a manifest that cannot be read.
    """
    if not path.is_file():
        return
    expected = _listed(path.parent).get(path.name)
    if expected is not None and expected != _sum(path):
        raise InputError(at(path, say("file-changed", manifest=str(path.parent / NAME))))


def _listed(folder: Path) -> dict[str, str]:
    manifest = folder / NAME
    if not manifest.is_file():
        return {}
    sums = {}
    for number, line in enumerate(text_in(manifest).split("\n"), start=1):
        value, mark, name = line.partition("  ")
        if line and (not mark or len(value) != 64):
            raise InputError(at(manifest, say("manifest-line"), line=number))
        if line:
            sums[name] = value
    return sums


def _sum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
