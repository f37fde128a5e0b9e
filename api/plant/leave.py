"""Leave to open over MQTT, ready for a relay: ``prefix/PRESS/open_now``.

Each press has a connection of its own, for a connection has one last will. What a relay receives, and when:

- ``{"open_now": true, "valid_until_utc": …}`` at each change and once a second, never retained, quality of service
  0: no broker hands it to anybody later than now.
- ``{"open_now": false, "known": …, "reason": …}`` likewise, where a limit does not hold or something is not known:
  the live sensor or the recorder is silent, the press's state is unknown, the store does not answer.
- The last will, retained, is false: the broker sends it at once when this process dies, some 10 s after it hangs
  or is out of reach (1.5 times `KEEPALIVE_S`; Mosquitto looks every 5 s), and to whoever subscribes before the
  next message. Nothing but false is ever retained here.

So a relay that takes each message as it comes is false some 5 s after recorder, live sensor or store stop; where
this process hangs or the broker is silent it must fall off by itself: a message a second and `valid_until_utc` let
it see that.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any

from api.answers.present import Present, age_of, is_of_now, present_of
from api.answers.records import utc_now
from api.plant.mqtt import FIRST_PAUSE_S, LONGEST_PAUSE_S, Broker, BrokerAway, Will, json_bytes
from daq.process.config import MqttSettings
from daq.store.records import StoreUnavailable
from daq.store.store import Store
from daq.supervision import SILENT_S, Steps
from daq.words import Message, spoken
from softsensor.live.validity import Invalid, InvalidReason

TOPIC = "open_now"
KEEPALIVE_S = 3
"""The broker sends the last will after one and a half times this. [s]"""
LOOK_S = 0.1
"""How often the store is asked. [s]"""
SAY_S = 1.0
"""How often it is sent again. [s]"""


def leave_body(press: str, present: Present | None, now: datetime) -> dict[str, Any]:
    """Return whether a press may open now, and what that rests on; None: the store does not answer."""
    if present is None:
        return _nothing(press, Invalid(InvalidReason.STORE_AWAY))
    estimate, utc = present.estimate, present.estimate_utc
    if estimate is None or utc is None:
        return _nothing(press, present.late or Invalid(InvalidReason.NO_ESTIMATE_YET))
    given = present.open_now and is_of_now(age_of(utc, now))
    until = utc + timedelta(seconds=SILENT_S) if estimate.valid else None
    return {
        "press": press,
        "open_now": given,
        "known": present.known and given == present.open_now,
        "state": present.state,
        "reason": estimate.reason,
        "reason_arguments": (estimate.detail or {}).get("reason_arguments", {}),
        "utc": utc.isoformat(),
        "valid_until_utc": None if until is None else until.isoformat(),
    }


def _nothing(press: str, why: Invalid) -> dict[str, Any]:
    """Return the body where nothing is known."""
    state = {"state": "unknown", "reason": why.reason.value, "reason_arguments": why.stored}
    return {"press": press, "open_now": False, "known": False, **state, "utc": None, "valid_until_utc": None}


class LeaveFeed:
    """Reads how every press stands, and says so on a line of its own for each until stopped."""

    def __init__(self, store: Store, settings: MqttSettings) -> None:
        self._store, self._settings = store, settings
        self._present: Mapping[str, Present] = {}
        self._read_s = time.monotonic()
        self._lines: dict[str, threading.Thread] = {}
        self._problems: dict[str, Message] = {}
        self._failed: list[BaseException] = []
        self._looking = Steps("leave")
        self._steps: dict[str, Steps] = {}
        """By press, of its line."""

    def stalled(self) -> Message | None:
        """Return what stands still of reading the store and the lines of all presses."""
        steps = (self._looking, *self._steps.copy().values())
        return next((why for one in steps if (why := one.stalled())), None)

    @property
    def problem(self) -> Message | None:
        """Why a line does not reach the broker."""
        return next(iter(self._problems.values()), None)

    def run(self, stop: threading.Event) -> None:
        """Read and say until stopped. Raises what ended a line that should go on."""
        ending = threading.Event()
        try:
            while not stop.is_set() and not self._failed:
                with self._looking.step():
                    self._look(ending)
                stop.wait(LOOK_S)
        finally:
            ending.set()
            for line in self._lines.values():
                line.join()
        if self._failed:
            raise self._failed[0]

    def _look(self, ending: threading.Event) -> None:
        try:
            now = utc_now()
            self._present = {press: present_of(self._store, press, now) for press in self._store.presses()}
        except StoreUnavailable:
            self._present = {}
        self._read_s = time.monotonic()
        for press in self._present.keys() - self._lines.keys():
            self._steps[press] = Steps(f"leave {press}")
            line = threading.Thread(target=self._keep, args=(press, ending), name=f"leave {press}", daemon=True)
            self._lines[press] = line
            line.start()

    def _keep(self, press: str, ending: threading.Event) -> None:
        """Hold the line of one press, again and again, until the end."""
        nobody = _nothing(press, Invalid(InvalidReason.NOT_PUBLISHED))
        will, pause_s = Will((press, TOPIC), nobody, f"/{press}/{TOPIC}", KEEPALIVE_S), FIRST_PAUSE_S
        while not ending.is_set():
            broker = Broker(self._settings, will)
            try:
                with self._steps[press].step():
                    broker.open()
                self._problems.pop(press, None)
                pause_s = FIRST_PAUSE_S
                self._say(broker, press, nobody, ending)
                broker.close()
            except BrokerAway as error:
                self._problems[press] = spoken(error)
                ending.wait(pause_s)
                pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
            except BaseException as error:  # noqa: BLE001 - raised by `run`: the will must not be called off
                self._failed.append(error)
                return
            finally:
                broker.abandon()

    def _say(self, broker: Broker, press: str, nobody: Mapping[str, Any], ending: threading.Event) -> None:
        """Say at each change and now and then how the press stands. Raises `BrokerAway`."""
        topic, steps = broker.topic(press, TOPIC), self._steps[press]
        with steps.step():
            broker.send([(topic, json_bytes(nobody))])
        sent, sent_s = nobody, time.monotonic()
        while not ending.wait(LOOK_S):
            read = time.monotonic() - self._read_s < SILENT_S
            body = leave_body(press, self._present.get(press) if read else None, utc_now())
            changed = any(body[key] != sent[key] for key in ("open_now", "known", "state", "reason"))
            if changed or time.monotonic() - sent_s >= SAY_S:
                with steps.step():
                    broker.send([(topic, json_bytes(body))], qos=0, retain=False)
                sent, sent_s = body, time.monotonic()
        broker.send([(topic, json_bytes(nobody))])
