"""Whether recording begins with a panel that is hot already: the rest of that pressing makes no run.

Without a wire the machine of `detector` knows a closed press by its closing alone, and a run needs that moment. A
recorder that is started later stores the scans and cuts no run of them, which must not go by in silence. What the
sensors show then looks alike for a panel being pressed and one just pressed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from daq.press.detector import HAND_C, HOT_SHARE
from daq.press.faces import BLIND_S, HIGH_C, LOW_C, columns_of, middle
from daq.press.press_file import Press
from daq.records import ROOM_C


class LateBeginning:
    """Looks at the first scans of a recording, until they are decided on."""

    def __init__(self, press: Press) -> None:
        self._columns = columns_of(press)
        self._over = not press.has_states
        self._first_s, self._first_hot = math.nan, False

    def look(self, time_s: float, values: Mapping[str, float], *, known: bool) -> bool:
        """Return, once, that a panel was hot from the first scan on that shows one.

        Parameters
        ----------
        values
            Of a scan, NaN where they are not usable.
        known
            A wire or an event has shown by now what the press does.
        """
        if self._over or known:
            self._over = True
            return False
        hot = self._hot(values)
        if hot is None:
            return False
        if self._first_s != self._first_s:
            self._first_s, self._first_hot = time_s, hot
        self._over = not self._first_hot or time_s - self._first_s >= BLIND_S  # a wire may answer late
        return self._over and self._first_hot and hot

    def _hot(self, values: Mapping[str, float]) -> bool | None:
        """Whether the upper face (the lower one, where no upper is read) was in the press; None: not read."""
        faces = self._columns.of_face(tuple(values))
        read = [[v for n in face if LOW_C < (v := values[n]) < HIGH_C] for face in faces]
        face = next((face for face in read if face), None)
        if face is None:
            return None
        platens = [v for n in self._columns.platens if (v := values.get(n, math.nan)) == v]
        share = ROOM_C + HOT_SHARE * (middle(platens) - ROOM_C) if platens else HAND_C
        return middle(face) > max(HAND_C, share)
