"""The `sense` process: follows the presses of the store and gives signs of life."""

from __future__ import annotations

import logging
import math
import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from functools import partial
from typing import Any

from daq.press.press_file import Press, read_press
from daq.process.config import Config
from daq.process.notify import Notifier
from daq.process.stopping import stop_on_signals
from daq.records import InputError
from daq.store import Store, StoreUnavailable
from daq.store.records import in_status
from daq.store.waiting import ending_reported, open_when_ready
from daq.supervision import BEAT_S
from daq.words import say, spoken
from softsensor.jobs.first_start import WorkKind, compile_for
from softsensor.jobs.fitter import Fitter
from softsensor.jobs.guarded import AGAIN_S, Guarded
from softsensor.jobs.press_follower import Follower, resin_of
from softsensor.jobs.run_fits import PROCESS, RunFits, write_journal
from softsensor.jobs.warm_up import warm_up

LOG = logging.getLogger("kerntemp.sense")

# Numbers without another source were set by hand, 2026-11.

POLL_S = 0.02
"""How often the store is asked for new scans. [s]"""


def sense(config: Config, *, stop: threading.Event | None = None) -> None:
    """Follow all presses of a configuration until stopped by `stop`, SIGTERM or SIGINT.

    Raises
    ------
    InputError
        For what is wrong in press files or the store's address.
    """
    stop = stop or threading.Event()
    stop_on_signals(stop)
    presses = [(settings, read_press(settings.file)) for settings in config.press]
    store = open_when_ready(config.store.url, stop, LOG)
    if store is None:
        return
    with store, ending_reported(store, PROCESS), Fitter() as fitter:
        followers = [
            Guarded(partial(Follower, store, own, press, RunFits(store, own.name, press, fitter), resin_of(own)))
            for own, press in presses
        ]
        notifier = Notifier()
        fitter.help_compiling()
        _compile([press for _, press in presses], lambda: _try_to_beat(store, followers, "starting"))
        fitter.warm_up_behind()
        with suppress(StoreUnavailable):  # held for the moment: no reason to end
            write_journal(store, "info", say("sense-following", presses=tuple(s.name for s, _ in presses)))
        notifier.ready("following the store")
        _follow(store, followers, stop, notifier)
        notifier.stopping()
        _try_to_beat(store, followers, "stopped")


def _compile(presses: Sequence[Press], beat: Callable[[], None]) -> None:
    """Compile what the sensors of these presses run on, or load it, with a sign of life meanwhile."""

    def warm() -> None:
        compile_for(WorkKind.LIVE, helped=False)  # the fits' worker helps
        for press in presses:
            with suppress(InputError):  # a rig whose runs must say more: compiled when the first does
                warm_up(press)

    with ThreadPoolExecutor(1, thread_name_prefix="compile") as pool:
        warming = pool.submit(warm)
        while wait([warming], BEAT_S).not_done:
            beat()
        warming.result()


def _beat(store: Store, followers: list[Guarded[Follower]], state: str) -> str:
    """Give a sign of life; return what it says."""
    status = _status(followers, state)
    store.beat(store.beats_as(PROCESS), status)
    return str(status["message"])


def _try_to_beat(store: Store, followers: list[Guarded[Follower]], state: str) -> None:
    """Give a sign of life before or after the work, if the store takes it."""
    with suppress(StoreUnavailable):
        _beat(store, followers, state)


def _follow(store: Store, followers: list[Guarded[Follower]], stop: threading.Event, notifier: Notifier) -> None:
    """Let the followers work until stopped; a store that is away is waited for."""

    def beat() -> None:
        notifier.alive(_beat(store, followers, "running"))

    trouble, beaten = "", -math.inf
    while not stop.is_set():
        worked = False
        try:
            for follower in followers:
                worked = _stepped(follower, beat) or worked
            if time.monotonic() - beaten > BEAT_S:
                beaten = time.monotonic()
                beat()
            trouble = ""
        except StoreUnavailable as error:
            if str(error) != trouble:
                LOG.warning("%s", say("store-trying-again", why=spoken(error)))
            trouble = str(error)
            notifier.alive(trouble)  # a store that is away is no reason to begin anew
            stop.wait(AGAIN_S)
        if not worked:
            stop.wait(POLL_S)


def _stepped(follower: Guarded[Follower], beat: Callable[[], None]) -> bool:
    """Let one press's follower work; what the store keeps from it alone does not hold up the others."""
    try:
        return follower.step(time.monotonic())
    except StoreUnavailable:
        beat()  # raises where the store is away for all
        follower.report_kept()
        return False


def _status(guarded: list[Guarded[Follower]], state: str) -> dict[str, Any]:
    followers = [one.follower for one in guarded]
    problems = [
        say("press-problem", press=g.follower.name, problem=g.problem) for g in guarded if g.problem is not None
    ]
    going = (
        followers[0].message
        if len(followers) == 1
        else say("list-of-names", names=tuple(f.message for f in followers))
    )
    return {
        "state": state,
        "pid": os.getpid(),
        **in_status(problems, say("sense-compiling") if state == "starting" else going),
        "presses": [
            {
                "press": f.settings.name,
                "run": f.live.record.run if f.live else None,
                "last_scan": f.last,
                "behind_scans": f.behind,
                "model_version": f.model.version,
                "update_us": round(f.update_us, 1),
            }
            for f in followers
        ],
    }
