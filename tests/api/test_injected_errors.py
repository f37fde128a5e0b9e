"""Nobody dies unseen: an error at any call in any thread of sense, publish and serve is told, and work goes on."""

import random
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from functools import partial

import httpx
import pytest

from api.alarms import watch
from api.alarms.watch import watching
from api.answers import present
from api.http import live, news, server
from api.http.server import Listening, address_of, make_server, run_server
from api.http.tokens import TokenFile
from api.plant import following, leave, mqtt, opcua, service
from daq.process.config import MqttSettings, OpcuaSettings, load_config
from daq.store import open_store
from daq.store.waiting import ending_reported
from softsensor.jobs import guarded, live_model, live_service, press_follower, run_fits
from tests.api.test_plant_mqtt import Broker
from tests.daq.injecting import Injector, name_of
from tests.daq.test_recorder import plant, recording
from tests.editions import edition
from tests.patience import wait_until

MODULES = {
    "sense": (live_service, press_follower, guarded, live_model, run_fits),
    "publish": (service, mqtt, leave, opcua, following, present),
    "serve": (server, live, news, watch),
}
SELDOM_S = 25.0
"""A pressing of the plant begins and ends in so much time."""
TOLD_S, ON_S = 60.0, 120.0
"""Within so much time an error is told, and work goes on, on a busy machine, too."""


class Served:
    """`kerntemp serve` as the command runs it, and a listener that comes back whenever its stream ends."""

    def __init__(self, url, folder):
        self._url, self._tokens = url, TokenFile(folder / "tokens.json")
        self.events, self._server, self._address, self._stop = 0, None, "", threading.Event()
        threading.Thread(target=self._listen, daemon=True).start()

    def run(self, stop):
        listening = Listening(port=0)
        with open_store(self._url) as opened, ending_reported(opened, "serve"), watching(opened, []) as stalled:
            bound = listening.bind()
            self._server = make_server(opened, self._tokens, listening, stalled=stalled)
            self._address = address_of(bound, tls=False)
            run_server(self._server, bound)
        stop.wait(0.1)

    def stop(self):
        self._stop.set()
        if self._server:
            self._server.should_exit = True

    def _listen(self):
        while not self._stop.is_set():
            with (
                suppress(httpx.HTTPError, httpx.InvalidURL),
                httpx.Client(timeout=20) as client,
                client.stream("GET", f"{self._address}api/v1/live") as stream,
            ):
                for line in stream.iter_lines():
                    self.events += line.startswith("event: scan")
            time.sleep(0.1)


@contextmanager
def looked_after(name, process):
    """Run a process in a thread of its own, again and again as a service manager does."""

    def keep():
        while not process.stop.is_set():
            try:
                process.run()
            except Exception as error:  # noqa: BLE001 - whatever it is, it is begun again
                print(f"{name} has ended: {error}")
            process.stop.wait(0.1)

    thread = threading.Thread(target=keep, name=name)
    thread.start()
    try:
        yield
    finally:
        process.end()
        thread.join(240)
    assert not thread.is_alive()


class Process:
    """How a process is run, and what shows that it does its work: a number that rises."""

    def __init__(self, name, made, opened, folder, held):
        self._opened, config, self.stop = opened, load_config(made.config), threading.Event()
        self._served = Served(made.url, folder) if name == "serve" else None
        if name == "sense":
            self.run, self.done = partial(live_service.sense, config, stop=self.stop), self._estimated
        elif self._served is not None:
            held.callback(self._served.stop)
            self.run, self.done = partial(self._served.run, self.stop), lambda: self._served.events
        else:
            broker = Broker(folder)
            held.callback(broker.kill)
            feeds = {"mqtt": MqttSettings(host="127.0.0.1", port=broker.port, prefix="plant")}
            self._config = config.model_copy(update={**feeds, "opcua": OpcuaSettings(port=0)})
            self._tokens = TokenFile(folder / "tokens.json")
            self.run, self.done = self._publish, self._published

    def end(self):
        self.stop.set()
        if self._served is not None:
            self._served.stop()

    def _publish(self):
        ending = threading.Event()
        threading.Thread(target=lambda: (self.stop.wait(), ending.set()), daemon=True).start()
        service.publish(self._config, self._tokens, stop=ending)

    def _estimated(self):
        return self._opened.newest_estimate_number("lab")

    def _published(self):
        status = self._opened.statuses().get("publish")
        return sum(number for _, _, number in status.status["position"]) if status else -1


def stopped_or_untold(call, process, alarms):
    """Return what is wrong after an error at a call, nothing where it is told and work goes on."""
    end = time.monotonic() + TOLD_S
    while name_of(call) not in alarms():
        if time.monotonic() > end:
            return [(call, "untold")]
        time.sleep(0.05)
    done, end = process.done(), time.monotonic() + ON_S
    while process.done() <= done + 2:
        if time.monotonic() > end:
            return [(call, "stopped")]
        time.sleep(0.05)
    return []


@pytest.mark.campaign
@pytest.mark.parametrize("name", MODULES)
def test_an_error_at_any_call_in_any_thread_is_told_and_work_goes_on(tmp_path, monkeypatch, name):
    monkeypatch.setattr(guarded, "RESTART_S", 0.1)
    monkeypatch.setattr(live, "RESTART_S", 0.1)
    monkeypatch.setattr(service, "BEAT_S", 0.1)
    with ExitStack() as held:
        made = held.enter_context(plant(tmp_path, speed=20.0, rate_hz=1.0))
        opened = held.enter_context(open_store(made.url))
        injector = Injector(monkeypatch, MODULES[name])
        held.enter_context(recording(made))
        wait_until(lambda: opened.newest_scan_number("lab") > 2)
        of_others = {thread.name.split()[0] for thread in threading.enumerate()}  # the recorder's, and this test's
        process = Process(name, made, opened, tmp_path, held)
        held.enter_context(looked_after(name, process))

        def alarms():
            return " ".join(str(entry.message) for entry in opened.journal(level="alarm", limit=100).items)

        wait_until(lambda: process.done() > 50)
        every = [(thread, call) for thread in sorted(injector.seen) for call in sorted(injector.seen[thread])]
        own = [(thread, call) for thread, call in every if thread not in of_others]
        wrong, tried, seldom = [], set(), set()

        def inject(calls, longest_s):
            if call := injector.first_called(calls, longest_s):
                wrong.extend(stopped_or_untold(call, process, alarms))
                tried.add(call)
            return call

        today = random.Random(datetime.now(UTC).toordinal())  # CI takes other ones each day
        for call in today.sample(own, len(own)):
            if len(tried) == edition(4, len(own)):
                break
            if inject([call], 1.0) is None:
                seldom.add(call)
        while edition(False, True) and seldom and (call := inject(seldom, SELDOM_S)):
            seldom.discard(call)
        print(f"of {len(own)} calls in {sorted(dict(own))} {len(tried)}, not {sorted(seldom)}")
        assert not wrong
        assert len(tried) >= edition(4, 20)
