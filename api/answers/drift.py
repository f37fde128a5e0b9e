"""Coefficients that have left what is usual, from the control charts over the fitted runs."""

from __future__ import annotations

from collections.abc import Sequence

from api.answers.kept import PRESSES, Kept
from api.answers.schemas import Drift
from api.answers.words import message_answer
from daq.store.store import Store

_KEPT: Kept[tuple[object, ...], Sequence[Drift]] = Kept(PRESSES)


def drift_of(store: Store, press: str) -> Sequence[Drift]:
    """Return the changes that stand, one a coefficient at most; charted anew with each fit and promotion."""
    active = store.active_model(press)
    key = (store.label, press, store.newest_fit_number(press), active.version if active else "")
    return _KEPT.get(key, lambda: _charted(store, press))


def _charted(store: Store, press: str) -> Sequence[Drift]:
    from softsensor.jobs.drift import alarms_of

    return [
        Drift(
            press=press,
            coefficient=alarm.coefficient,
            since_run=alarm.run,
            noticed_run=alarm.noticed,
            factor=round(alarm.factor, 4),
            chart=alarm.chart.value,
            sentence=str(alarm.message),
            sentence_said=message_answer(alarm.message),
        )
        for alarm in alarms_of(store, press)
    ]
