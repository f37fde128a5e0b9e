"""Runs, presses and resins as they are given: files, tables or what was read of them."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.files.instants import from_json
from daq.files.legible import check_each_once, kelvin_doubt, legible
from daq.files.run_file import read_run as read_run_file
from daq.given import keys_of, path_of, refused, warn
from daq.press.header import check_header, flat_attrs, flat_header, new_doubts
from daq.press.press_file import Press
from daq.press.press_file import read_press as read_press_file
from daq.press.resin_file import Resin, read_resin
from daq.records import UNNAMED, FrozenDict, Run, with_frozen_fields
from softsensor.face.ends import shortened

if TYPE_CHECKING:
    from softsensor.face.kinds import AnyPress, AnyRun, Until


def read_run(source: AnyRun, *, mapping: Path | str | None = None, header: Mapping[str, Any] | None = None) -> Run:
    """Return a run from a CSV or Parquet file, a pandas table, or another logger's file.

    Parameters
    ----------
    mapping
        The TOML file that explains another logger's columns, units and times: of a file alone, which it reads as
        that logger wrote it.
    header
        Keys beside those that the table or file has: panel, ambient, settings. The ones given here count. ISO text
        under a key ``recorded.*`` is an instant.

    Raises
    ------
    InputError
        Naming file, line or column, value, limit and what to do; and for a mapping beside a table or a `Run`.

    Examples
    --------
    Another logger's file, with German names and decimal commas, by what a mapping says of it:

    >>> from daq import shared_files
    >>> samples = shared_files() / "samples"
    >>> keys = {"panel.density_kg_m3": 700.0}
    >>> run = read_run(samples / "foreign.txt", mapping=samples / "foreign.toml", header=keys)
    >>> sorted(run.columns)[-3:], run.header["panel.density_kg_m3"]
    (['platen_top', 'top_1', 'top_2'], 700.0)
    """
    if mapping is not None and (_is_table(source) or isinstance(source, Run)):
        raise refused(source, "given-mapping-without-file")
    if _is_table(source):
        from daq.files.frames import run_of

        return run_of(source, keys_of(header, "given-no-header"))
    if isinstance(source, Run):
        nested = any(isinstance(value, Mapping) for value in source.header.values())
        found = replace(source, header=flat_attrs(source.header)) if nested else source
    elif mapping is not None:
        from daq.files.mapping import read_foreign, read_mapping

        found = read_foreign(path_of(source, "given-no-run"), read_mapping(path_of(mapping, "given-no-mapping")))
    else:
        found = read_run_file(path_of(source, "given-no-run"))
    before = source.header if isinstance(source, Run) else {}
    if header is not None:
        given = from_json(flat_header(keys_of(header, "given-no-header")))
        keys = {**found.header, **given}
        check_header(given, "read_run")
        check_header(keys, found.source or found.name)
        found = replace(found, header=keys, name=str(keys.get("run", found.name)))
    for doubt in new_doubts(found.header, before):  # of a run that was read before, all others are known
        warn(doubt)
    return _frozen_run(found)


def _is_table(given: Any) -> bool:
    """Return whether it is a pandas table; where there is one, pandas is loaded, and is not loaded to ask."""
    return isinstance(given, getattr(sys.modules.get("pandas"), "DataFrame", ()))


def _frozen_run(run: Run) -> Run:
    """Return a run that cannot be changed: itself where it is one."""
    if isinstance(run.header, FrozenDict) and isinstance(run.columns, FrozenDict):
        return run
    made: Run = with_frozen_fields(run)
    return made


def read_press(path: AnyPress) -> Press:
    """Return the press that a press file describes. Raises `InputError`.

    Examples
    --------
    >>> from daq import shared_files
    >>> read_press(shared_files() / "presses" / "lab.toml").chain
    ('boundary.bottom', 'plate_bottom', 'panel', 'plate_top', 'boundary.top')
    """
    return path if isinstance(path, Press) else read_press_file(path_of(path, "given-no-press"))


def resin_of(resin: Resin | Path | str | None) -> Resin | None:
    """Return a resin from its file, None where none is given. Raises `InputError`."""
    return resin if resin is None or isinstance(resin, Resin) else read_resin(path_of(resin, "given-no-resin"))


def run_for(run: AnyRun, press: Press) -> Run:
    """Return a run as read, for a press to be worked on; warn of what is doubtful.

    Raises
    ------
    InputError
        For what cannot be read, and words in a column that the press takes numbers from.
    """
    found = legible(read_run(run), press)
    if (doubt := kelvin_doubt(found, press)) is not None:
        warn(doubt)
    return found


def runs_of(runs: AnyRun | Sequence[AnyRun], press: Press, until: Until | None = None) -> list[Run]:
    """Return one run or several as read, without the rows after their ends; tables without a name are numbered.

    Raises
    ------
    InputError
        For what cannot be read, words in a column that the press takes numbers from, a run given twice, or an end
        that cannot be.
    """
    one = isinstance(runs, Run | Path | str | Mapping) or _is_table(runs) or not isinstance(runs, Iterable)
    given: Any = [runs] if one else runs
    read = [run_for(run, press) for run in given]
    if sum(run.name == UNNAMED for run in read) > 1:
        number = itertools.count(1)
        read = [replace(r, name=f"{UNNAMED}-{next(number)}") if r.name == UNNAMED else r for r in read]
    check_each_once(read)
    return shortened(read, press, until)
