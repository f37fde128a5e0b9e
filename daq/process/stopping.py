"""Ending a service in order when the system asks for it."""

from __future__ import annotations

import signal
import threading


def stop_on_signals(stop: threading.Event) -> None:
    """Set `stop` on SIGTERM, SIGINT or Ctrl-Break, outlive others; outside the main thread do nothing.

    A handler runs between two steps of the main thread, which may be inside ``stop.wait`` and hold the event's
    own lock: a handler that waits for that lock waits for ever. So a thread of its own sets the event.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    outlive_hangup()
    for name in ("SIGTERM", "SIGINT", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda *_: threading.Thread(target=stop.set).start())


def outlive_hangup() -> None:
    """Go on after SIGHUP, SIGUSR1 and SIGUSR2: a closed terminal, or somebody's wish to reload or to rotate logs.

    Changed files are noticed anyway.
    """
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGHUP", "SIGUSR1", "SIGUSR2"):
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_IGN)
