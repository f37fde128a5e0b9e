"""All SQL lives here. `open_store` gives the `Store` in which the processes meet."""

from daq.store.records import (
    CoefficientRecord,
    DiagnosisRecord,
    JournalEntry,
    ModelRecord,
    NewRun,
    Page,
    PressKey,
    ProcessStatus,
    RunChange,
    RunEnd,
    RunRecord,
    RunStatus,
    ScanBatch,
    StoredEstimate,
    StoredPressEvent,
    StoreUnavailable,
    every,
)
from daq.store.store import Store, open_store

__all__ = [
    "CoefficientRecord",
    "DiagnosisRecord",
    "JournalEntry",
    "ModelRecord",
    "NewRun",
    "Page",
    "PressKey",
    "ProcessStatus",
    "RunChange",
    "RunEnd",
    "RunRecord",
    "RunStatus",
    "ScanBatch",
    "Store",
    "StoreUnavailable",
    "StoredEstimate",
    "StoredPressEvent",
    "every",
    "open_store",
]
