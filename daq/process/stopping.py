"""Ending a service in order when the system asks for it."""

from __future__ import annotations

import signal
import threading


def stop_on_signals(stop: threading.Event) -> None:
    """Set `stop` on SIGTERM, SIGINT or Ctrl-Break, outlive SIGHUP; outside the main thread do nothing.

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
    """Go on after SIGHUP: a closed terminal, or somebody's wish to reload; changed files are noticed anyway."""
    if hasattr(signal, "SIGHUP") and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
