"""Press events of a long table: what `PressEventDetector` finds scan by scan, without asking it every scan.

Its faces are worked out at once, and it is asked where something may be plain (`detector.waits_for`), in the open
press, and until a moment is placed: nearly never between two pressings and while the press is closed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from daq.press.detector import HOLD_S, HOLD_SCANS, FaceRow, PressEventDetector, rows_kept, waits_for
from daq.press.faces import HIGH_C, LOW_C, columns_of
from daq.press.press_file import Press
from daq.press.table_faces import hold, levels, middles
from daq.records import Array, PressEvent, PressState


def table_events(times: Array, columns: Mapping[str, Array], press: Press) -> list[PressEvent]:
    """Return the events of a press whose wires the table does not hold, in the order in which they are noticed.

    Parameters
    ----------
    times
        Of the rows, rising. [s]
    columns
        Those that `PressEventDetector.looks_at`; missing values NaN. [°C]
    """
    patterns, names = columns_of(press), tuple(columns)
    of_face = patterns.of_face(names)
    values = [_held(times, columns, face) for face in of_face]
    top, bottom = (levels(times, face) for face in values)
    plate = middles(_held(times, columns, [name for name in names if name in patterns.platens]))
    asked, kept = waits_for(times, top, bottom), rows_kept(times).tolist()

    def row(i: int) -> FaceRow:
        sensors = (
            {name: value for name, value in zip(of, face[i].tolist(), strict=True) if LOW_C < value < HIGH_C}
            for of, face in zip(of_face, values, strict=True)
        )
        return FaceRow(float(times[i]), float(top[i]), float(bottom[i]), float(plate[i]), *sensors)

    detector, found, i = PressEventDetector(press), list[PressEvent](), 0
    while i < len(times):
        found += detector.take(row(i))
        following = _next(asked, detector, i, len(times))
        if following > i + 1:
            detector.skip(
                [row(k) for k in range(kept[following - 1], following)] if following < len(times) else []
            )
        i = following
    return found


def _next(asked: Mapping[PressState, NDArray[np.intp]], detector: PressEventDetector, row: int, rows: int) -> int:
    """Return the row at which the detector is asked next, behind the last where at none."""
    waited = asked.get(detector.state or PressState.OPEN) if detector.pending is None else None
    if waited is None:
        return row + 1
    place = int(np.searchsorted(waited, row, side="right"))
    return int(waited[place]) if place < len(waited) else rows


def _held(times: Array, columns: Mapping[str, Array], names: Sequence[str]) -> Array:
    """Return those columns beside each other, gaps bridged as the detector does (rows, columns)."""
    table = np.stack([columns[name] for name in names], axis=1) if names else np.empty((len(times), 0))
    return np.asarray(hold(times, table, HOLD_S, HOLD_SCANS))
