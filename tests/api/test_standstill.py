"""Threads that stand still beside the one that gives signs of life: it is told, and the watchdog starves."""

import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import pytest

import daq.supervision
from api.alarms import watch
from api.alarms.watch import watching
from api.alarms.ways import Webhook, ways_of
from api.commands import publishing, services
from api.http import live
from api.http import server as http_server
from api.http.live import Hub
from api.http.server import Listening, _Server, address_of, make_server
from api.http.tokens import TokenFile
from api.plant import service
from api.plant.leave import LeaveFeed
from api.plant.mqtt import Broker, Publisher
from api.plant.opcua import PressServer
from daq.process.config import Config, MqttSettings, OpcuaSettings, StoreSettings
from daq.process.notify import Notifier
from daq.records import Channel, Quality, Scan
from daq.store import Store, StoreUnavailable, open_store, waiting
from daq.supervision import unexpected
from daq.words import say
from softsensor.jobs import live_service
from tests.api.test_alarms import HOT, free_port, hook
from tests.api.test_live import Stream
from tests.api.test_plant_mqtt import Broker as Mosquitto
from tests.api.test_server import running
from tests.patience import wait_until

LAB_FILE = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"


@pytest.fixture
def stored(tmp_path):
    with open_store(str(tmp_path / "plant.sqlite")) as opened:
        yield opened


@pytest.fixture
def broker(tmp_path):
    started = Mosquitto(tmp_path)
    yield started
    started.kill()


@pytest.fixture
def beats(monkeypatch):
    """What systemd hears: the watchdog fed, or why it is not."""
    heard = []
    monkeypatch.setattr(Notifier, "alive", lambda self, status: heard.append("fed"))
    monkeypatch.setattr(Notifier, "status", lambda self, status: heard.append(status))
    monkeypatch.setattr(daq.supervision, "STALLED_S", 0.5)
    monkeypatch.setattr(watch, "STALLED_S", 0.5)
    monkeypatch.setattr(watch, "IN_HAND_S", 0.0)
    monkeypatch.setattr(http_server, "ALIVE_TICKS", 2)
    monkeypatch.setattr(service, "BEAT_S", 0.1)
    return heard


@contextmanager
def standing(monkeypatch, owner, name, thread=""):
    """Let a method stand still in threads whose name begins so; yields what says that one does, what ends it."""
    stands, free, work = threading.Event(), threading.Event(), getattr(owner, name)

    def still(*arguments, **given):
        if threading.current_thread().name.startswith(thread) and not free.is_set():
            stands.set()
            free.wait()
        return work(*arguments, **given)

    monkeypatch.setattr(owner, name, still)
    try:
        yield stands, free
    finally:
        free.set()


def starved_and_fed_again(beats, thread, free):
    """The watchdog starves while a thread stands still, and is fed once it goes on."""
    since = len(beats)  # a slow machine's threads may have been late before, and one such beat still be on its way
    wait_until(lambda: len(beats) > since + 2 and all(thread in beat for beat in beats[-3:]))
    starved = len(beats)
    wait_until(lambda: len(beats) > starved + 2)
    assert "fed" not in beats[starved : starved + 3]
    free.set()
    wait_until(lambda: "fed" in beats[starved + 3 :])


HANGS = [
    (Store, "watch_alarms", "alarms"),
    (Store, "take_delivery", "deliveries"),
    (Webhook, "deliver", "deliveries"),
]


@pytest.mark.parametrize(("owner", "name", "thread"), HANGS, ids=[name for _, name, _ in HANGS])
def test_alarms_not_looked_for_or_not_sent_are_an_alarm_and_starve_the_watchdog(
    stored, tmp_path, monkeypatch, beats, owner, name, thread
):
    (way,) = ways_of(None, hook(tmp_path, free_port()), "store")
    stored.watch_alarms([HOT], [way.name], datetime.now(UTC))
    listening = Listening(port=0)
    with standing(monkeypatch, owner, name) as (stands, free), watching(stored, [way]) as stalled:
        server = make_server(stored, TokenFile(tmp_path / "tokens.json"), listening, stalled=stalled)
        with running(server, [listening.bind()]):
            wait_until(stands.is_set)
            starved_and_fed_again(beats, thread, free)
    messages = [e.message for e in stored.journal(level="alarm").items if e.message.code == "thread-stalled"]
    assert [m.arguments["thread"] for m in messages] == [thread]


def test_a_fault_that_comes_back_after_all_went_well_is_an_alarm_again(stored, monkeypatch):
    monkeypatch.setattr(daq.supervision, "CALM_S", 0.0)
    monkeypatch.setattr(watch, "LOOK_S", 0.01)
    monkeypatch.setattr(daq.supervision, "RESTART_S", 0.01)
    looked, broken, work = [], threading.Event(), Store.watch_alarms

    def watched(*arguments):
        looked.append(broken.is_set())
        if broken.is_set():
            raise KeyError("top_1")
        return work(*arguments)

    monkeypatch.setattr(Store, "watch_alarms", watched)

    def faults():
        return sum(e.message.code == "thread-failed" for e in stored.journal(level="alarm").items)

    with watching(stored, []):
        for times in (1, 2):
            broken.set()
            wait_until(lambda: faults() == times and len(looked) > 5 and all(looked[-3:]))  # noqa: B023
            broken.clear()
            wait_until(lambda: not any(looked[-3:]))
    assert faults() == 2


def test_a_store_that_stays_away_is_logged_once(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(watch, "LOOK_S", 0.01)
    monkeypatch.setattr(watch, "SEND_S", 0.01)
    path, looked = tmp_path / "s.sqlite", []
    path.write_text("no store " * 500)

    def clock():
        looked.append(True)
        return datetime.now(UTC)

    with open_store(str(path), later=True) as away, watching(away, [], clock):
        wait_until(lambda: len(looked) > 20)
    assert caplog.text.count("trying again") == 1


FEEDS = [
    (Publisher, "_send_waiting", "mqtt", ""),
    (LeaveFeed, "_look", "leave", ""),
    (Broker, "send", "leave lab", "leave lab"),
    (PressServer, "_read", "opcua", ""),
]


@pytest.mark.parametrize(("owner", "name", "feed", "thread"), FEEDS, ids=[feed for _, _, feed, _ in FEEDS])
def test_a_feed_of_the_plant_that_stands_still_is_told_and_starves_the_watchdog(
    stored, broker, tmp_path, monkeypatch, beats, owner, name, feed, thread
):
    stored.register_press("lab", (Channel("platen_top"), Channel("platen_bottom")))
    mqtt = MqttSettings(host="127.0.0.1", port=broker.port, prefix="plant")
    plant = StoreSettings(url=str(tmp_path / "plant.sqlite"))
    config = Config.model_construct(store=plant, mqtt=mqtt, opcua=OpcuaSettings(port=0), press=())
    stop, tokens = threading.Event(), TokenFile(tmp_path / "tokens.json")
    feeds = threading.Thread(target=service.publish, args=(config, tokens), kwargs={"stop": stop})
    with standing(monkeypatch, owner, name, thread) as (stands, free):
        feeds.start()
        try:
            wait_until(stands.is_set)
            wait_until(lambda: f"{feed}: no progress" in str(stored.statuses().get("publish")))
            starved_and_fed_again(beats, f"{feed}: no progress", free)
        finally:
            free.set()
            stop.set()
            feeds.join(240)


class Reading:
    """The hub's look into the store, which raises what is asked for."""

    def __init__(self, monkeypatch, stored, folder):
        self.raises, self.done, read = None, 0, Hub._read

        def reading(hub):
            self.done += 1
            if error := self.raises and self.raises(self.done):
                raise error
            return read(hub)

        monkeypatch.setattr(live, "RESTART_S", 0.02)
        monkeypatch.setattr(Hub, "_read", reading)
        self._key = stored.register_press("lab", (Channel("platen_top"),))
        self._stored, self._folder = stored, folder

    def scan(self, number):
        now = datetime.now(UTC)
        self._stored.append_scans(self._key, [Scan(number, now, float(number), (20.0,), (Quality.GOOD,))])

    @contextmanager
    def served(self):
        listening = Listening(port=0)
        bound = listening.bind()
        with running(make_server(self._stored, TokenFile(self._folder / "tokens.json"), listening), [bound]):
            yield address_of(bound, tls=False)


@pytest.fixture
def reading(stored, tmp_path, monkeypatch, beats):
    return Reading(monkeypatch, stored, tmp_path)


def starved(beats):
    """Wait until the watchdog starves for the live events; return since when it is certain."""
    since = len(beats)
    wait_until(lambda: len(beats) > since + 4 and all("live events" in beat for beat in beats[-3:]))
    return len(beats)


def test_while_live_events_fail_it_is_an_alarm_and_the_watchdog_starves_until_they_come_again(
    stored, monkeypatch, beats, reading
):
    monkeypatch.setattr(daq.supervision, "CALM_S", 0.0)
    with reading.served() as address:
        stream = Stream(address)
        for number, times in ((0, 1), (1, 2)):
            reading.raises = lambda _: KeyError("top_1")
            starved(beats)
            reading.scan(number)
            reading.raises = None
            stream.wait("scan", times)
            wait_until(lambda: beats[-1] == "fed")
        stream.close()
    messages = [e.message for e in stored.journal(level="alarm").items]
    assert [(m.code, m.arguments["thread"]) for m in messages] == [("thread-failed", "live events")] * 2


def test_a_fault_of_live_events_that_comes_and_goes_is_one_alarm(stored, reading):
    reading.raises = lambda done: KeyError("top_1") if done % 2 else None
    with reading.served() as address:
        stream = Stream(address)
        wait_until(lambda: reading.done > 10)
        stream.close()
    assert [e.message.code for e in stored.journal(level="alarm").items] == ["thread-failed"]


def test_a_fault_of_live_events_starves_no_watchdog_once_nobody_listens(beats, reading):
    reading.raises = lambda _: KeyError("top_1")
    with reading.served() as address:
        stream = Stream(address)
        since = starved(beats)
        stream.close()
        wait_until(lambda: "fed" in beats[since:])


def test_a_fault_of_live_events_starves_no_watchdog_once_it_is_the_store_that_is_away(beats, reading):
    reading.raises = lambda _: KeyError("top_1")
    with reading.served() as address:
        stream = Stream(address)
        since = starved(beats)
        reading.raises = lambda _: StoreUnavailable("away")
        wait_until(lambda: "fed" in beats[since:])
        stream.close()


def test_a_fault_in_the_midst_of_a_look_costs_no_listener_an_event(monkeypatch, reading):
    broken, looked, fits_after = threading.Event(), [], Store.fits_after

    def fits(*arguments):
        if broken.is_set():
            looked.append(None)
            raise KeyError("top_1")
        return fits_after(*arguments)

    monkeypatch.setattr(Store, "fits_after", fits)
    with reading.served() as address:
        stream = Stream(address)
        broken.set()
        for number in range(3):
            reading.scan(number)
            seen = len(looked)
            wait_until(lambda: len(looked) > seen + 1)  # noqa: B023
        broken.clear()
        numbers = [event["data"]["number"] for event in stream.wait("scan", 3)]
        stream.close()
    assert numbers == [0, 1, 2]


@pytest.mark.parametrize(("name", "last_event_id"), [("_read", ""), ("_begin", ""), ("_missed", "0/0//")])
def test_live_events_that_stand_still_are_an_alarm_and_starve_the_watchdog(
    stored, monkeypatch, beats, reading, name, last_event_id
):
    with (
        standing(monkeypatch, Hub, name) as (stands, free),
        reading.served() as address,
        ThreadPoolExecutor(1) as one,
    ):
        stream = one.submit(Stream, address, last_event_id)  # who comes while it stands gets no answer yet
        wait_until(stands.is_set)
        starved_and_fed_again(beats, "live events", free)
        stream.result().close()
    (message,) = [e.message for e in stored.journal(level="alarm").items]
    assert (message.code, message.arguments["thread"]) == ("thread-stalled", "live events")


def test_two_that_stand_still_at_once_are_two_alarms(stored, tmp_path, monkeypatch, beats):
    stored.register_press("lab", (Channel("platen_top"),))
    listening = Listening(port=0)
    bound = listening.bind()

    def stalled():
        messages = [e.message for e in stored.journal(level="alarm").items]
        return {m.arguments["thread"] for m in messages if m.code == "thread-stalled"}

    with (
        standing(monkeypatch, Store, "watch_alarms") as (_, free),
        standing(monkeypatch, Hub, "_read") as (stands, free_too),
        watching(stored, []) as beside,
        running(make_server(stored, TokenFile(tmp_path / "tokens.json"), listening, stalled=beside), [bound]),
    ):
        stream = Stream(address_of(bound, tls=False))
        wait_until(stands.is_set)
        wait_until(lambda: stalled() == {"alarms", "live events"}, stalled)
        free.set()
        free_too.set()
        stream.close()


@pytest.mark.usefixtures("beats")
def test_alarms_neither_looked_for_nor_sent_are_an_alarm_each(stored, tmp_path, monkeypatch):
    (way,) = ways_of(None, hook(tmp_path, free_port()), "store")

    def journalled():
        messages = [e.message for e in stored.journal(level="alarm").items]
        return [m.arguments["thread"] for m in messages if m.code == "thread-stalled"]

    with (
        standing(monkeypatch, Store, "watch_alarms") as (_, free),
        standing(monkeypatch, Store, "take_delivery") as (_, free_too),
        watching(stored, [way]) as stalled,
    ):
        wait_until(lambda: stalled() and set(journalled()) == {"alarms", "deliveries"}, journalled)
        free.set()
        free_too.set()
        wait_until(lambda: stalled() is None)
    assert len(journalled()) == 2


def config_of(folder, stored):
    """Write a configuration of every process over a store."""
    shutil.copy(LAB_FILE, folder / "lab.toml")
    path = folder / "kerntemp.toml"
    logger = "name = 'platens'\nprofile = 'labjack-t7'\nhost = '127.0.0.1'\n"
    channels = "channels = ['platen_bottom', 'platen_top']\n"
    plant = f"[store]\nurl = '{stored.database.path}'\n[opcua]\nport = 0\n[server]\nport = 0\n"
    path.write_text(f"{plant}[[press]]\nname = 'lab'\nfile = 'lab.toml'\n[[press.logger]]\n{logger}{channels}")
    return path


ENDS = [
    (live_service, "_follow", services.sense, "sense"),
    (service._Feeds, "_beat", publishing.publish, "publish"),
    (PressServer, "_read", publishing.publish, "publish"),
    (_Server, "on_tick", services.serve, "serve"),
    (services, "_report", services.refit, "refit"),
]


@pytest.mark.parametrize(("owner", "name", "command", "process"), ENDS, ids=[f"{e[3]} {e[1]}" for e in ENDS])
def test_a_process_that_ends_by_what_nobody_foresaw_leaves_an_alarm(
    stored, tmp_path, monkeypatch, owner, name, command, process
):
    """Only a silence of 10 s was one: whoever is begun anew within that ended for ever unseen."""

    def failing(*_words, **_options):
        raise KeyError("top_1")

    monkeypatch.setattr(owner, name, failing)
    monkeypatch.setattr(services, "log_to_stderr", lambda: None)
    with pytest.raises(KeyError, match="top_1"):
        command(config_of(tmp_path, stored))
    messages = [e.message for e in stored.journal(level="alarm").items]
    why = unexpected(KeyError("top_1"))
    assert messages == [say("process-failed", process=process, why=why)]


def test_a_process_that_ends_in_the_same_way_again_and_again_gives_an_alarm_an_hour(stored, monkeypatch):
    def ends(error):
        with pytest.raises(type(error)), waiting.ending_reported(stored, "sense"):
            raise error

    def alarms():
        return [str(e.message.arguments["why"]) for e in reversed(stored.journal(level="alarm").items)]

    first, second = str(unexpected(KeyError("top_1"))), str(unexpected(ValueError("none")))
    for error in (KeyError("top_1"), ValueError("none"), KeyError("top_1"), ValueError("none")):
        ends(error)
    assert alarms() == [first, second]
    monkeypatch.setattr(waiting, "REPEATED_S", 0.0)
    ends(KeyError("top_1"))
    assert alarms() == [first, second, first]


def test_whose_reader_has_gone_leaves_no_alarm(stored, tmp_path):
    """As of ``kerntemp refit | head``: it is none of its own faults."""
    with pytest.raises(BrokenPipeError), waiting.ending_reported(stored, "refit"):
        raise BrokenPipeError
    assert not stored.journal(level="alarm").items
