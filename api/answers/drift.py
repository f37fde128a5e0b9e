"""Coefficients that have left what is usual, from the control charts over the fitted runs."""

from __future__ import annotations

import threading

from api.answers.schemas import Drift
from api.answers.words import said_of
from daq.store.store import Store

_KEPT: dict[tuple[str, str], tuple[tuple[int, str], list[Drift]]] = {}
_LOCK = threading.Lock()


def drift_of(store: Store, press: str) -> list[Drift]:
    """Return the changes that stand, one a coefficient at most; charted anew with each fit and promotion."""
    from softsensor.jobs.drift import alarms_of

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
                chart=alarm.chart.value,
                sentence=str(alarm.message),
                sentence_said=said_of(alarm.message),
            )
            for alarm in alarms_of(store, press)
        ]
        _KEPT[store.label, press] = (newest, drifts)
        return drifts
