"""A parent that has everything imported and forks recorder and sensor, so that a thousand kills take minutes.

``python forking.py CONFIG NOTES`` reads ``record`` or ``sense`` from standard input, forks that process and
answers with its number. What a child has had acknowledged by the store it appends to NOTES/record or
NOTES/sense, one write a commit: that survives a SIGKILL, as a promise to somebody else would.
"""

import json
import logging
import os
import signal
import sys
from concurrent.futures import Future
from pathlib import Path

from daq.press.press_file import read_press
from daq.process.config import load_config
from daq.recording.recorder import record
from daq.store import Store
from softsensor.jobs import live_service as service
from softsensor.jobs.warm_up import warm_up


def note(place, rows):
    os.write(place, "".join(json.dumps(row) + "\n" for row in rows).encode())


def run_record(config, place):
    def acknowledged(batch):
        note(place, [(s.monotonic_s, s.values[0] if s.values[0] == s.values[0] else None) for s in batch.scans])

    record(load_config(config), acknowledged=acknowledged)


class NoFits:
    """Stands in for the fitting process: a killed parent would leave a thousand of them."""

    replaced: frozenset[str] = frozenset()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def help_compiling(self):
        pass

    def warm_up_behind(self):
        pass

    def submit(self, *_):
        return Future()


def run_sense(config, place):
    write = Store.append_estimates

    def append_estimates(store, press, estimates):
        write(store, press, estimates)
        note(place, [(e.number, e.monotonic_s) for e in estimates])

    Store.append_estimates = append_estimates
    service.Fitter = NoFits
    service.sense(load_config(config))


def main():
    config, notes = (Path(x) for x in sys.argv[1:])
    logging.basicConfig(level=logging.ERROR)
    for press in load_config(config).press:  # or every sensor compiles anew, for longer than it lives
        warm_up(read_press(press.file))
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    for line in sys.stdin:
        role = line.strip()
        child = os.fork()
        if child == 0:
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            place = os.open(notes / role, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
            try:
                {"record": run_record, "sense": run_sense}[role](config, place)
            finally:
                os._exit(0)
        sys.stdout.write(f"{child}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
