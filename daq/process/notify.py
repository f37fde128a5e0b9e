"""Inform systemd that a service is ready, alive or about to end: its notify protocol, in a few lines.

Without systemd (no ``NOTIFY_SOCKET`` in the environment) every call does nothing. Written here, because the
packages on offer are a dead one and ones that need C headers (2026-11-21).
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping


class Notifier:
    """The service's line to systemd (``Type=notify``, ``WatchdogSec=``)."""

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        given = os.environ if environment is None else environment
        self._address = given.get("NOTIFY_SOCKET", "")
        self.watchdog_s = _watchdog_s(given)
        """Without a sign of life for so long systemd starts the service anew; None: it does not watch."""

    def ready(self, status: str) -> None:
        """Say that the service has started."""
        self._send(f"READY=1\nSTATUS={status}")

    def alive(self, status: str) -> None:
        """Feed the watchdog."""
        self._send(f"WATCHDOG=1\nSTATUS={status}")

    def status(self, status: str) -> None:
        """Say how things are without feeding the watchdog."""
        self._send(f"STATUS={status}")

    def stopping(self) -> None:
        """Say that the service ends in order."""
        self._send("STOPPING=1")

    def _send(self, message: str) -> None:
        if not self._address or not hasattr(socket, "AF_UNIX"):
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
                line.settimeout(1.0)
                line.sendto(message.encode(), address)
        except OSError:
            return  # nobody listens: the service is no worse off


def _watchdog_s(given: Mapping[str, str]) -> float | None:
    """Return the watchdog's time where it is meant for this process."""
    meant = given.get("WATCHDOG_PID", "")
    if meant and meant != str(os.getpid()):
        return None
    micros = given.get("WATCHDOG_USEC", "")
    return int(micros) / 1e6 if micros.isdigit() else None
