"""Compile what the live sensor runs on, or load it, before the first scan needs it.

What is compiled is kept (see `daq.compiled`): the first call after an installation or an update takes tens of
seconds, later processes load it in one or two.
"""

from __future__ import annotations

from collections.abc import Mapping

from daq.press.press_file import Press
from softsensor.live.sensor import ScanSensor

_HEADER: Mapping[str, object] = {
    "panel.material": "MDF",
    "panel.thickness_mm": 10.0,
    "panel.initial_temperature_C": 20.0,
}

# Numbers without another source were set by hand, 2026-11.

_FACES_C, _PLATENS_C = (20.0, 30.0, 120.0), 180.0
"""Faces before the insertion, in the open press and in the closed one, and platens. [°C]"""
_INSERTED_S, _CLOSED_S, _OPENED_S, _END_S = 2, 6, 12, 18
"""When the made-up press moves: long enough apart for the detector to believe it. [s]"""


def warm_up(press: Press) -> None:
    """Take a live sensor of this press through a short made-up pressing, so that no later one has to wait.

    Raises
    ------
    InputError
        For a press whose runs need more than a panel's material, thickness and temperature.
    """
    ends = (press.boundary.bottom, press.boundary.top)
    outside = [end.column for end in ends if end.column is not None]
    inside = [pattern.replace("*", "1") for sensor in press.sensor for pattern in sensor.columns]
    sensor = ScanSensor(press, _HEADER, None)
    for second in range(_END_S):
        warmth = _FACES_C[0] if second < _INSERTED_S else _FACES_C[1] if second < _CLOSED_S else _FACES_C[2]
        values = dict.fromkeys(inside, warmth) | dict.fromkeys(outside, _PLATENS_C)
        sensor.update(float(second), values | {"closed": float(_CLOSED_S <= second < _OPENED_S)})
        _ = sensor.inside  # has loops of its own
