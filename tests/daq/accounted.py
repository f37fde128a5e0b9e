"""A recorder that writes down all that is put into its way to the store, and what was acknowledged.

``python -m tests.daq.accounted CONFIG NOTES`` sets its wall clock by as many seconds as each line of standard
input says. That clock is time-machine's: Python's own, as all of the recorder reads it, and no other program's.
"""

import json
import logging
import os
import sys
import threading
from datetime import UTC, datetime
from pathlib import Path

import time_machine

from daq.process.config import load_config
from daq.recording.recorder import record
from daq.store import RunStatus
from daq.store.outbox import Outbox
from daq.store.write_batch import WriteBatch


def note(place, kind, batch):
    """Write down what a batch holds, by the press's own clock: in one write, which a SIGKILL cannot tear."""
    held = [("scan", one.monotonic_s) for one in batch.scans]
    held += [(event.kind.value, event.monotonic_s) for event in batch.events]
    held += [("begin", batch.begin.zero_monotonic_s)] if batch.begin else []
    closed = batch.end is not None and batch.end.status is RunStatus.CLOSED
    held += [("end", batch.end.ended_utc.timestamp())] if closed else []
    os.write(place, "".join(f"{json.dumps([kind, *one])}\n" for one in held).encode())


def noted(file):
    """Return the lines that are written; of the one that is being written, nothing."""
    written = file.read_text().rpartition("\n")[0] if file.exists() else ""
    return [json.loads(line) for line in written.splitlines()]


def main():
    config, notes = (Path(x) for x in sys.argv[1:])
    logging.basicConfig(level=logging.ERROR)
    place = os.open(notes, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
    put = Outbox.put

    def noting(outbox, item):
        if isinstance(item, WriteBatch):
            note(place, "put", item)
        put(outbox, item)

    Outbox.put = noting
    with time_machine.travel(datetime.now(UTC), tick=True) as clock:

        def set_clock():
            for line in sys.stdin:
                clock.shift(float(line))

        threading.Thread(target=set_clock, daemon=True).start()
        record(load_config(config), acknowledged=lambda batch: note(place, "kept", batch))


if __name__ == "__main__":
    main()
