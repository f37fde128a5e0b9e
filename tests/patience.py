"""Waiting: what must happen has all the time a busy machine takes, a logger's silence is believed soon."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from daq.drivers import ReadFailure
from daq.drivers.polled import FOUND_AGAIN_S, PolledLogger
from daq.records import Reading

PATIENT = {"timeout_s": 60.0, "drain_s": 0.05}
LONGEST_S = 240.0
_TRIES = 6


def wait_until(
    done: Callable[[], object], otherwise: object = "it did not happen in time", longest_s: float = LONGEST_S
) -> None:
    """Wait for what must happen; `otherwise` is what to say if it does not, or gives it."""
    deadline = time.monotonic() + longest_s
    while not done():
        assert time.monotonic() < deadline, otherwise() if callable(otherwise) else otherwise
        time.sleep(0.02)


@contextlib.contextmanager
def briefly(*loggers: PolledLogger, timeout_s: float = 0.1) -> Iterator[None]:
    """Give replies up soon, where none is to come."""
    usual = [(logger._device, logger._device.timing) for logger in loggers]
    for device, timing in usual:
        device.timing = replace(timing, timeout_s=timeout_s)
    try:
        yield
    finally:
        for device, timing in usual:
            device.timing = timing


def until_good(logger: PolledLogger) -> Reading:
    """Read until something comes."""
    deadline = time.monotonic() + LONGEST_S
    while True:
        try:
            return logger.read()
        except ReadFailure:
            assert time.monotonic() < deadline
            time.sleep(0.005)


def found_again(logger: PolledLogger, lose: Callable[[], None], find: Callable[[], None]) -> Reading:
    """Lose a device and find it again, until once that took no longer than it may: a busy machine needs tries."""
    took = []
    for _ in range(_TRIES):
        lose()
        find()
        begun = time.monotonic()
        reading = until_good(logger)
        took.append(time.monotonic() - begun)
        if took[-1] <= FOUND_AGAIN_S:
            return reading
    raise AssertionError(f"{took} s, {FOUND_AGAIN_S} s promised")
