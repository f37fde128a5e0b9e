"""`kerntemp serve`: the web server, safe by default."""

from __future__ import annotations

import logging
import socket
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from api.app import create_app
from api.gate import is_loopback
from api.tokens import TokenFile
from daq.records import InputError
from daq.store.store import Store

GRACE_S = 3
"""Requests still running at the end get this long. [s]"""


@dataclass(frozen=True)
class Listening:
    """Where and how to listen."""

    host: str = "127.0.0.1"
    port: int = 8765
    certificate: Path | None = None
    """TLS certificate chain, PEM."""
    key: Path | None = None

    def check(self, tokens: TokenFile) -> None:
        """Refuse what would not be safe or cannot work. Raises `InputError`."""
        if not is_loopback(self.host) and not tokens.tokens():
            raise InputError(
                f"server.host = {self.host}: beyond loopback readers need tokens and there are none; "
                "make one with kerntemp token create NAME --scope read, or listen on 127.0.0.1"
            )
        if (self.certificate is None) != (self.key is None):
            raise InputError("--certificate and --key belong together; give both or neither")
        for path in (self.certificate, self.key):
            if path is not None and not path.is_file():
                raise InputError(f"{path}: no such file; give the certificate and key as PEM files")

    def bind(self) -> socket.socket:
        """Take the port now, so that a taken one is told in one line. Raises `InputError`."""
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        # Named TCP, or asyncio would leave Nagle's algorithm on and every answer would wait 40 ms.
        taken = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            taken.bind((self.host, self.port))
            taken.listen(2048)
        except OSError as error:
            taken.close()
            raise InputError(
                f"cannot listen on {self.host}:{self.port}: {error.strerror}; choose another with --port"
            ) from error
        return taken


class _Server(uvicorn.Server):
    """Ends the live streams before it waits for requests to finish."""

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self.config.app.state.hub.close()  # type: ignore[union-attr]
        await super().shutdown(sockets)


def address_of(bound: socket.socket, *, tls: bool) -> str:
    """Return the address a person can open."""
    host, port = bound.getsockname()[:2]
    shown = f"[{host}]" if ":" in host else host
    return f"{'https' if tls else 'http'}://{shown}:{port}/"


def run_server(store: Store, tokens: TokenFile, listening: Listening, bound: socket.socket) -> None:
    """Serve until interrupted or terminated."""
    logging.getLogger("uvicorn.access").disabled = True
    config = uvicorn.Config(
        create_app(store, tokens),
        host=listening.host,
        port=listening.port,
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=GRACE_S,
        timeout_keep_alive=20,
        limit_concurrency=2000,
        h11_max_incomplete_event_size=32 * 1024,
        ssl_certfile=str(listening.certificate) if listening.certificate else None,
        ssl_keyfile=str(listening.key) if listening.key else None,
    )
    _Server(config).run(sockets=[bound])
