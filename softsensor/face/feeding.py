"""A live sensor fed by hand."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.files.legible import of_numbers
from daq.files.qualities import QUALITY, faults_of, is_usable
from daq.files.run_rows import CLOSED, at_column
from daq.given import keys_of, reading_of, refused, warn
from daq.press.header import check_header, doubts, flat_header
from daq.press.resin_file import Resin
from daq.printed import in_notebook, in_short, on_screen
from daq.records import InputError, matches
from daq.words import say
from softsensor.face.inputs import read_press, resin_of
from softsensor.face.models import model_for
from softsensor.jobs.first_start import WorkKind, compile_for
from softsensor.live.sensor import Estimate, ScanSensor

if TYPE_CHECKING:
    from softsensor.face.kinds import AnyModel, AnyPress, AnyScan


class LiveSensor(ScanSensor):
    """A live sensor fed by hand: takes scans and says what the core is doing.

    Parameters
    ----------
    press
        Where sensors lie and which columns are platens.
    header
        The run's header: panel, ambient, settings; of a table, its ``attrs``.
    model
        Coefficients and effects from earlier runs; without, the press file's guesses.
    resin
        How the paper cures and what must hold at opening; without, nobody asks.

    Raises
    ------
    InputError
        For a header that cannot be, or what is wrong in a file.

    Examples
    --------
    >>> import daq
    >>> from daq import shared_files
    >>> from softsensor import read_run
    >>> run, press = shared_files() / "samples" / "2026-03-04-07.csv", shared_files() / "presses" / "lab.toml"
    >>> table = daq.frame_of(read_run(run))
    >>> live = LiveSensor(press, table.attrs)
    >>> for time_s, row in table.loc[:60.0].iterrows():
    ...     newest = live.update(time_s, row)
    >>> str(newest.state), newest.core_low_C < newest.core_C < newest.core_high_C
    ('closed', True)
    """

    def __init__(
        self,
        press: AnyPress,
        header: Mapping[str, Any],
        model: AnyModel | None = None,
        resin: Resin | Path | str | None = None,
    ) -> None:
        if header is None:
            raise refused(header, "given-no-header")
        header = flat_header(keys_of(header, "given-no-header"))
        check_header(header, "LiveSensor")
        for doubt in doubts(header):
            warn(doubt)
        compile_for(WorkKind.LIVE)
        described = read_press(press)
        known = None if model is None else model_for(model, described, header)
        super().__init__(described, header, known, resin_of(resin))
        self._named = described.press.name
        self._platens = described.platens
        self._of_numbers = of_numbers(described)
        self._newest: Estimate | None = None

    def update(self, time_s: Hashable, values: AnyScan) -> Estimate:
        """Take a scan and return what is known then.

        Parameters
        ----------
        time_s
            A number later than that of any scan before. [s]
        values
            By column, a row of a table for instance; missing ones None, NaN or left out. What a text ``quality``
            calls unusable is missing too, any other text is left out. [°C, or the column's own]

        Raises
        ------
        InputError
            For a time that is no number or does not rise, values without names, one that is no number, and at the
            first scan for what press or panel lacks in the header. A platen that no column names is one without a
            reading.
        """
        at = None if isinstance(time_s, bool | np.bool_) else reading_of(time_s)
        if at is None or (at != at and not isinstance(time_s, float)):
            raise InputError(say("live-time-no-number", time=repr(time_s)))
        if not hasattr(values, "items"):
            raise refused(values, "given-no-scan")
        newest_s = -math.inf if self._newest is None else self._newest.time_s
        if not newest_s < at < math.inf:
            raise InputError(say("live-time-not-rising", time_s=at, newest_s=newest_s))
        self._newest = super().update(at, self._readings(values))
        return self._newest

    def _readings(self, values: AnyScan) -> dict[str, float]:
        """Return a scan's usable numbers; a platen that is not there is one without a reading."""
        quality = values.get(QUALITY)
        faults = (faults_of(quality) if isinstance(quality, str) else None) or {}
        read = dict.fromkeys(self._platens, math.nan)
        for label, value in values.items():
            name = str(label)  # as a table's labels become texts in a run
            if not isinstance(value, str) or matches(name, self._of_numbers):
                read[name] = _reading(name, value) if is_usable(faults, name) else math.nan
        return read

    def __repr__(self) -> str:
        """Say which press it follows, and its newest estimate."""
        newest = [] if self._newest is None else [on_screen(self._newest)]
        return "\n".join([str(say("live-sensor-of-press", press=self._named)), *newest])

    _repr_html_ = in_notebook


def _reading(column: str, given: object) -> float:
    """Return a channel's value, NaN where there is none. Raises `InputError` for what no channel has."""
    value = reading_of(given)
    if value is None:
        raise InputError(say("live-value-no-number", column=column, value=in_short(given)))
    if math.isinf(value):
        raise InputError(at_column(column, say("run-value-infinite")))
    if column == CLOSED and value == value and value not in (0.0, 1.0):
        raise InputError(at_column(column, say("run-closed-value", value=value)))
    return value
