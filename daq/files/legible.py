"""Whether a run has numbers where its press takes them."""

from __future__ import annotations

import fnmatch

from daq.files.run_rows import check_no_words
from daq.press.press_file import Press, press_for_run
from daq.records import Run


def legible(run: Run, press: Press) -> Run:
    """Return the run. Raises `InputError` where a column of words is one that the press takes numbers from."""
    own = press_for_run(press, run)
    loads = (contact.load.column for contact in own.contact if contact.load is not None)
    wanted = (*(pattern for sensor in own.sensor for pattern in sensor.columns), *own.platens, *loads)
    for column, cells in run.texts.items():
        if any(fnmatch.fnmatchcase(column, pattern) for pattern in wanted):
            check_no_words(run.source or run.name, column, cells)
    return run
