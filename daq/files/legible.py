"""Whether runs can be worked on: numbers where their press takes them, and each but once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from hashlib import sha256

import numpy as np

from daq.files.run_rows import check_no_words
from daq.press.press_file import Press, press_for_run
from daq.records import COLDEST_C, InputError, Run, matches
from daq.words import Message, say


def legible(run: Run, press: Press) -> Run:
    """Return the run. Raises `InputError` where a column of words is one that the press takes numbers from."""
    own = press_for_run(press, run)
    wanted = of_numbers(own)
    for column, cells in run.texts.items():
        if matches(column, wanted):
            check_no_words(run.source or run.name, column, cells)
    return run


def of_numbers(press: Press) -> tuple[str, ...]:
    """Return the patterns of the columns that a press takes numbers from."""
    loads = (contact.load.column for contact in press.contact if contact.load is not None)
    return (*(pattern for sensor in press.sensor for pattern in sensor.columns), *press.platens, *loads)


def kelvin_doubt(run: Run, press: Press) -> Message | None:
    """Ask whether a run's readings are in kelvin: the coldest of its panel is nearer to that than to its start."""
    start = run.header.get("panel.initial_temperature_C")
    inside = tuple(f"{layer}{sign}" for layer in press.panel_layers for sign in ".@")
    places = [sensor for sensor in press.sensor if sensor.role == "fit" and sensor.label.startswith(inside)]
    columns = [run.columns[name] for name in run.matching(c for place in places for c in place.columns)]
    read = [values[np.isfinite(values)] for values in columns]
    if not isinstance(start, int | float) or not any(map(len, read)):
        return None
    coldest = float(min(values.min() for values in read if len(values)))
    if abs(coldest - start + COLDEST_C) >= abs(coldest - start):
        return None
    return say("run-in-kelvin", run=run.source or run.name, start=float(start), coldest=coldest)


def check_each_once(runs: Iterable[Run]) -> None:
    """Raise `InputError` where a run is given twice, by its name or by its readings: it would count as two."""
    names: dict[bytes, str] = {}
    for run in runs:
        if run.name in names.values():
            raise InputError(say("run-twice", run=run.name))
        names[new_readings(run, names)] = run.name


def new_readings(run: Run, names: Mapping[bytes, str]) -> bytes:
    """Return the digest of a run's times and readings. Raises `InputError` where a run of these names has it."""
    digest = readings_digest(run)
    if (other := names.get(digest)) is not None:
        raise InputError(say("run-twice-by-readings", run=run.name, other=other))
    return digest


def readings_digest(run: Run) -> bytes:
    """Return what a run's times and readings are known by, whatever it is called."""
    readings = sha256(run.time_s.tobytes())
    for name in sorted(run.columns):
        readings.update(run.columns[name].tobytes())
    return readings.digest()
