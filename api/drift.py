"""Coefficients that have left what is usual, from the control charts over the fitted runs."""

from __future__ import annotations

import threading

from api.schemas import Drift
from daq.store.store import Store

HISTORY_RUNS = 200
"""Runs the charts look back on. The live sensor looks back as far."""
_KEPT: dict[tuple[str, str], tuple[int, list[Drift]]] = {}
_LOCK = threading.Lock()


def drift_of(store: Store, press: str) -> list[Drift]:
    """Return the changes that stand, one a coefficient at most; charted anew when a fit is added."""
    from softsensor.drift import RunValue, watch_all

    records = store.coefficient_history(press=press, limit=HISTORY_RUNS).items
    newest = records[0].fit_number if records else 0
    with _LOCK:
        known, drifts = _KEPT.get((store.label, press), (-1, []))
        if known == newest:
            return drifts
        history: dict[str, list[RunValue]] = {}
        for record in reversed(records):
            if record.identifiable:
                history.setdefault(record.name, []).append(RunValue(record.run, record.value, record.sd))
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
            for alarm in watch_all(history)
        ]
        _KEPT[store.label, press] = (newest, drifts)
        return drifts
