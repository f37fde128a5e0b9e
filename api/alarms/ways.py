"""The ways an alarm takes to people: e-mail over SMTP, and JSON to a webhook.

Both carry the alarm's number where a receiver that gets it twice, after a kill between its word and our note, can
know it: `Message-ID` of the e-mail, `Idempotency-Key` of the request.
"""

from __future__ import annotations

import smtplib
import ssl
from base64 import b64encode
from dataclasses import dataclass, field
from email.message import EmailMessage
from hashlib import sha256
from http.client import HTTPException, responses
from pathlib import Path
from typing import Protocol
from urllib.error import HTTPError, URLError
from urllib.request import HTTPRedirectHandler, Request, build_opener

from api.answers.alarms import alarm_of
from daq.process.config import EmailSettings, WebhookSettings
from daq.records import InputError
from daq.store.alarms import IN_HAND_S
from daq.store.records import StoredAlarm
from daq.tables import reason_of, text_in
from daq.words import say
from daq.words.message import languages, words

TRY_S = IN_HAND_S / 9.0
"""Longest wait for each answer of a receiver: a try, nine answers at most, stays within `IN_HAND_S`. [s]"""

GO_ON = 334
"""What a mail server answers to a user's name, when it asks for the password (RFC 4954, section 4)."""
TAKEN = 235
"""What a mail server answers to a login it takes (RFC 4954, section 6)."""


class NotDelivered(RuntimeError):
    """A receiver has not taken an alarm; the text says why, without addresses that hold secrets."""


class Way(Protocol):
    """One way to people."""

    @property
    def name(self) -> str:
        """As the outbox knows it."""

    def deliver(self, alarm: StoredAlarm) -> None:
        """Hand an alarm over. Raises `NotDelivered`."""


@dataclass(frozen=True)
class Email:
    """A message to one address."""

    settings: EmailSettings
    to: str
    store: str
    """Which store the alarm's number counts in."""

    @property
    def name(self) -> str:
        """Whoever shares a store and mails to this address shares this way."""
        return f"email {self.to.casefold()}"

    def deliver(self, alarm: StoredAlarm) -> None:
        """Send one message."""
        s = self.settings
        try:
            context = ssl.create_default_context() if s.security != "none" else None
            kind = smtplib.SMTP_SSL if s.security == "tls" else smtplib.SMTP
            given = {"context": context} if s.security == "tls" else {}
            with kind(s.host, s.port, timeout=TRY_S, **given) as server:  # type: ignore[arg-type]
                if s.security == "starttls":
                    server.starttls(context=context)
                if s.user:
                    _login(server, s.user, _first_line(s.password_file))
                server.send_message(self.message(alarm))
        except (smtplib.SMTPException, OSError, ValueError) as error:
            answer = f"{s.host}:{s.port}: {error or type(error).__name__}"
            raise NotDelivered(self._without_password(answer)) from error

    def _without_password(self, answer: str) -> str:
        """Return what a mail server answers without the password, which it may repeat as it was sent."""
        user = self.settings.user
        try:
            password = _first_line(self.settings.password_file) if user else ""
        except (OSError, UnicodeDecodeError):  # nothing was sent then
            return answer
        sent = (f"\0{user}\0{password}", password)
        forms = [form for one in sent for form in (_coded(one), _coded(one).rstrip("="), repr(one)[1:-1], one)]
        for form in forms if password else ():
            answer = answer.replace(form, "***")
        return answer

    def message(self, alarm: StoredAlarm) -> EmailMessage:
        """Return the message, in the language configured."""
        s = self.settings
        text = words(alarm.message, s.language)
        mail = EmailMessage()
        mail["Subject"] = words(say("alarm-subject", what=alarm.message), s.language)[:200].replace("\n", " ")
        mail["From"], mail["To"] = s.sender, self.to
        mail["Date"] = alarm.raised_utc
        place = _digest(f"{self.store} {self.name}")
        mail["Message-ID"] = f"<alarm-{alarm.number}.{place}@{s.sender.partition('@')[2]}>"
        raised = f"{alarm.raised_utc:%Y-%m-%d %H:%M:%S} UTC"
        mail.set_content(words(say("alarm-body", what=text, raised=raised, number=alarm.number), s.language))
        return mail


def _login(server: smtplib.SMTP, user: str, password: str) -> None:
    """Say who we are; what smtplib, which knows ASCII alone, cannot say goes in UTF-8.

    As PLAIN (RFC 4616), or as LOGIN where the server offers no PLAIN.
    """
    if (user + password).isascii():
        server.login(user, password)
        return
    server.ehlo_or_helo_if_needed()
    offered = server.esmtp_features.get("auth", "").upper().split()
    if "LOGIN" in offered and "PLAIN" not in offered:
        code, answer = server.docmd("AUTH", f"LOGIN {_coded(user)}")
        if code == GO_ON:
            code, answer = server.docmd(_coded(password))
    else:
        code, answer = server.docmd("AUTH", f"PLAIN {_coded(chr(0) + user + chr(0) + password)}")
    if code != TAKEN:
        raise smtplib.SMTPAuthenticationError(code, answer)


def _coded(text: str) -> str:
    return b64encode(text.encode()).decode()


class _NoRedirect(HTTPRedirectHandler):
    def redirect_request(self, *_: object) -> None:
        """Follow no redirection: a body with an alarm goes to the address given and nowhere else."""


@dataclass(frozen=True)
class Webhook:
    """The alarm as `/alarms` lists it, by POST."""

    settings: WebhookSettings
    address: str = field(repr=False)
    """As it was read when the way was made: by it the outbox knows this receiver from another."""

    @property
    def name(self) -> str:
        """Without the address, which holds secrets."""
        return f"webhook {_digest(self.address)}"

    def deliver(self, alarm: StoredAlarm) -> None:
        """Post it once; taken where the answer is a success."""
        try:
            address = _first_line(self.settings.address_file)
            body = alarm_of(alarm).model_dump_json().encode()
            head = {"Content-Type": "application/json", "Idempotency-Key": f"alarm-{alarm.number}"}
            request = Request(address, body, head, method="POST")
            with build_opener(_NoRedirect).open(request, timeout=TRY_S):
                return
        except HTTPError as error:  # in its own words the receiver may repeat the address
            with error:  # its connection is left open else
                raise NotDelivered(f"{error.code} {responses.get(error.code, '')}".strip()) from error
        except (URLError, HTTPException, OSError, ValueError) as error:
            raise NotDelivered(str(getattr(error, "reason", "")) or type(error).__name__) from error


def ways_of(email: EmailSettings | None, webhook: WebhookSettings | None, store: str) -> list[Way]:
    """Return the ways configured. Raises InputError for a file that cannot be read, an address, a language."""
    ways: list[Way] = []
    if email is not None:
        if email.language not in languages():
            raise InputError(say("alarm-language", language=email.language, known=languages()))
        if email.user:
            _readable(email.password_file)
        ways += [Email(email, to, store) for to in dict.fromkeys(email.to)]
    if webhook is not None:
        address = _readable(webhook.address_file)
        if not address.startswith(("http://", "https://")):
            raise InputError(say("alarm-webhook-address", path=str(webhook.address_file)))
        ways.append(Webhook(webhook, address))
    return ways


def _digest(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:12]


def _readable(path: Path | None) -> str:
    try:
        return _first_line(path)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(say("alarm-file", path=str(path), why=reason_of(error))) from error


def _first_line(path: Path | None) -> str:
    return text_in(path).removeprefix("\ufeff").split("\n")[0].strip() if path is not None else ""
