"""Coefficients that have left what is usual, from the control charts over the fitted runs."""

from __future__ import annotations

import threading

from api.schemas import Drift
from daq.store.store import Store

_KEPT: dict[tuple[str, str], tuple[tuple[int, str], list[Drift]]] = {}
_LOCK = threading.Lock()


def drift_of(store: Store, press: str) -> list[Drift]:
    """Return the changes that stand, one a coefficient at most; charted anew with each fit and promotion."""
    from softsensor.drift import alarms_of

    active = store.active_model(press)
    newest = (store.newest_fit_number(press), active.version if active else "")
    with _LOCK:
        known, drifts = _KEPT.get((store.label, press), ((-1, ""), []))
        if known == newest:
            return drifts
        drifts = [
            Drift(
                press=press,
                coefficient=alarm.coefficient,
                since_run=alarm.run,
                noticed_run=alarm.noticed,
                factor=round(alarm.factor, 4),
                chart="jump" if alarm.chart == "cusum" else "creep",
                sentence=alarm.sentence,
            )
            for alarm in alarms_of(store, press)
        ]
        _KEPT[store.label, press] = (newest, drifts)
        return drifts
