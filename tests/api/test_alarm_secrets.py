"""What a mail server or webhook answers may repeat what it was sent: no secret of it is kept."""

from __future__ import annotations

import socket
import threading
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

import pytest

from api.alarms.ways import Email, NotDelivered, Webhook
from daq.process.config import EmailSettings, WebhookSettings
from daq.store.records import StoredAlarm
from daq.words import say

PASSWORD, TOKEN = "sMtp p%w 77x", "tokA9%2Fz81hook"
FORMS = (PASSWORD, b64encode(PASSWORD.encode()).decode(), b64encode(f"\0eva\0{PASSWORD}".encode()).decode(), TOKEN)


@contextmanager
def answering(greeting: bytes, answer: Callable[[bytes], bytes]) -> Iterator[int]:
    """Serve one connection after the other, line by line; gives the port."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with suppress(OSError):
            while True:
                line, _ = listener.accept()
                with suppress(OSError), line, line.makefile("rwb") as file:
                    file.write(greeting)
                    file.flush()
                    while asked := file.readline():
                        file.write(answer(asked))
                        file.flush()

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield listener.getsockname()[1]
    finally:
        listener.close()


def alarm() -> StoredAlarm:
    now = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
    return StoredAlarm(1, "lab", say("plain-text", text="x"), now, None, None, None, "x", now)


@pytest.mark.parametrize("mechanism", ["PLAIN", "LOGIN"])
def test_a_mail_server_that_repeats_the_password_puts_it_nowhere(tmp_path: Path, mechanism: str) -> None:
    (tmp_path / "password").write_text(PASSWORD + "\n")

    def answer(asked: bytes) -> bytes:
        if asked.upper().startswith(b"EHLO"):
            return f"250-mail\r\n250 AUTH {mechanism}\r\n".encode()
        if asked.upper().startswith(b"AUTH LOGIN"):
            return b"334 UGFzc3dvcmQ6\r\n"
        return b"535 no: " + asked.strip() + b" " + PASSWORD.encode() + b"\r\n"

    with answering(b"220 mail\r\n", answer) as port:
        settings = EmailSettings(
            host="127.0.0.1",
            port=port,
            sender="k@plant.example",
            to=("eva@plant.example",),
            user="eva",
            password_file=tmp_path / "password",
        )
        with pytest.raises(NotDelivered, match="535") as refused:
            Email(settings, "eva@plant.example", "store").deliver(alarm())
    assert not [form for form in FORMS if form in str(refused.value)]
    assert "***" in str(refused.value)


@pytest.mark.parametrize("status", ["HTTP/1.1 403 no: ", "HTTP/1.1 799 ", "garbage "])
def test_a_webhook_that_repeats_its_address_puts_it_nowhere(tmp_path: Path, status: str) -> None:
    def answer(asked: bytes) -> bytes:
        if not asked.startswith(b"POST"):
            return b""
        return status.encode() + asked.split()[1] + b"\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"

    with answering(b"", answer) as port:
        (tmp_path / "address").write_text(f"http://127.0.0.1:{port}/hook/{TOKEN}?token={TOKEN}\n")
        webhook = Webhook(WebhookSettings(address_file=tmp_path / "address"), "x")
        with pytest.raises(NotDelivered) as refused:
            webhook.deliver(alarm())
    assert TOKEN not in str(refused.value)
    assert str(refused.value)
