"""From the wire to the store: loggers, press events, run files, recorder.

What ``__all__`` lists is stable, typed and documented; everything else may change. Nothing is imported
before it is used.
"""

from importlib import import_module
from time import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.face import StoreTables as StoreTables
    from daq.face import find_events as find_events
    from daq.face import find_moments as find_moments
    from daq.face import open_store as open_store
    from daq.face import play as play
    from daq.files.frames import frame_of as frame_of
    from daq.files.frames import qualities_of as qualities_of
    from daq.files.frames import run_of as run_of
    from daq.given import speak as speak
    from daq.press.press_file import Press as Press
    from daq.records import EventSource as EventSource
    from daq.records import InputError as InputError
    from daq.records import Moments as Moments
    from daq.records import Nonphysical as Nonphysical
    from daq.records import NoSteadyState as NoSteadyState
    from daq.records import PressState as PressState
    from daq.records import Quality as Quality
    from daq.records import Run as Run
    from daq.shared import shared_files as shared_files
    from daq.store.records import StoreUnavailable as StoreUnavailable

IMPORTED_S = time()
"""When this process began to import the package; see `daq.compiled`. [s]"""

__all__ = [
    "EventSource",
    "InputError",
    "Moments",
    "NoSteadyState",
    "Nonphysical",
    "Press",
    "PressState",
    "Quality",
    "Run",
    "StoreTables",
    "StoreUnavailable",
    "find_events",
    "find_moments",
    "frame_of",
    "open_store",
    "play",
    "qualities_of",
    "run_of",
    "shared_files",
    "speak",
]
_HOMES = {
    "EventSource": "daq.records",
    "InputError": "daq.records",
    "Moments": "daq.records",
    "NoSteadyState": "daq.records",
    "Nonphysical": "daq.records",
    "Press": "daq.press.press_file",
    "PressState": "daq.records",
    "Quality": "daq.records",
    "Run": "daq.records",
    "StoreUnavailable": "daq.store.records",
    "frame_of": "daq.files.frames",
    "qualities_of": "daq.files.frames",
    "run_of": "daq.files.frames",
    "shared_files": "daq.shared",
    "speak": "daq.given",
}


if not TYPE_CHECKING:  # checkers read the imports above, and see a misspelt name

    def __getattr__(name: str) -> Any:
        """Load a public name on first use (PEP 562)."""
        if name not in __all__:
            raise AttributeError(f"module 'daq' has no attribute {name!r}; it has {', '.join(__all__)}")
        found = globals()[name] = getattr(import_module(_HOMES.get(name, "daq.face")), name)
        return found


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
