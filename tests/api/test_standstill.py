"""Threads that stand still beside the one that gives signs of life: it is told, and the watchdog starves."""

import shutil
import threading
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
from daq.store import Store, open_store
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


def test_while_live_events_fail_it_is_an_alarm_and_the_watchdog_starves_until_they_come_again(
    stored, tmp_path, monkeypatch, beats
):
    monkeypatch.setattr(live, "AGAIN_S", 0.02)
    key = stored.register_press("lab", (Channel("platen_top"),))
    broken, read = threading.Event(), Hub._read

    def reading(self):
        if broken.is_set():
            raise KeyError("top_1")
        return read(self)

    monkeypatch.setattr(Hub, "_read", reading)
    listening = Listening(port=0)
    bound = listening.bind()
    with running(make_server(stored, TokenFile(tmp_path / "tokens.json"), listening), [bound]):
        stream = Stream(address_of(bound, tls=False))
        for number, times in ((0, 1), (1, 2)):
            broken.set()
            starved = len(beats)
            wait_until(lambda: len(beats) > starved + 4 and all("live events" in b for b in beats[-3:]))  # noqa: B023
            stored.append_scans(key, [Scan(number, datetime.now(UTC), float(number), (20.0,), (Quality.GOOD,))])
            broken.clear()
            stream.wait("scan", times)
            wait_until(lambda: beats[-1] == "fed")
        stream.close()
    messages = [e.message for e in stored.journal(level="alarm").items]
    assert [(m.code, m.arguments["thread"]) for m in messages] == [("thread-failed", "live events")] * 2


def test_live_events_that_stand_still_are_an_alarm_and_starve_the_watchdog(stored, tmp_path, monkeypatch, beats):
    stored.register_press("lab", (Channel("platen_top"),))
    listening = Listening(port=0)
    bound = listening.bind()
    with (
        standing(monkeypatch, Hub, "_read") as (stands, free),
        running(make_server(stored, TokenFile(tmp_path / "tokens.json"), listening), [bound]),
    ):
        stream = Stream(address_of(bound, tls=False))
        wait_until(stands.is_set)
        starved_and_fed_again(beats, "live events", free)
        stream.close()
    (message,) = [e.message for e in stored.journal(level="alarm").items]
    assert (message.code, message.arguments["thread"]) == ("thread-stalled", "live events")


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
