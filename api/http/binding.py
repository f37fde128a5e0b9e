"""The port that the page is served on."""

from __future__ import annotations

import socket
import sys

from daq.records import InputError
from daq.tables import reason_of
from daq.words import say

UNREAD_S = 60.0
"""A client that takes nothing of what is sent to it is cut off after this time. [s]"""


def take_port(host: str, port: int, unread_s: float = UNREAD_S) -> socket.socket:
    """Return a socket that listens. Raises `InputError` for an address that is taken or not this machine's."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # Named TCP, or asyncio would leave Nagle's algorithm on and every answer would wait 40 ms.
    taken = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if sys.platform == "linux":  # connections inherit it
        taken.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * unread_s))
    try:
        taken.bind((host, port))
        taken.listen(2048)
    except OSError as error:
        taken.close()
        problem = say("api-address-taken", host=host, port=port, why=reason_of(error))
        raise InputError(problem) from error
    return taken
