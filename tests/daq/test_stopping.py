"""A service ends when it is asked to, at whatever moment."""

import subprocess
import sys

ASKED_INSIDE_THE_EVENT = """
import signal, threading
from daq.process.stopping import stop_on_signals
stop = threading.Event()
stop_on_signals(stop)
with stop._cond:
    signal.raise_signal(signal.SIGTERM)
print(stop.wait(240))
"""


def test_a_signal_that_meets_the_main_thread_inside_the_event_still_ends_it():
    asked = [sys.executable, "-c", ASKED_INSIDE_THE_EVENT]
    done = subprocess.run(asked, capture_output=True, text=True, timeout=240, check=False)
    assert done.stdout == "True\n", done.stderr
