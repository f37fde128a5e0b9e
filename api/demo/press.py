"""The virtual press behind its simulated loggers, as a process of its own: ``python -m api.demo.press``.

It reads one JSON line of settings and writes two: the loggers' wiring at once, for they answer, and that the
first pressing is solved, for which a first start must compile. Until a second line names the moment of the
machine's monotonic clock at which virtual time 0 is, the press is at rest: platens at their setpoint,
thermocouples in the room. From there it runs `speed` times as fast. Each further line says what the next panels
are, as header keys; it answers from which pressing on it lays in such. It ends with its standard input, so that
it never outlives whoever started it.
"""

from __future__ import annotations

import json
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.simulated.campaign_sensors import CHANNELS, PLATENS
from daq.simulated.devices import simulated, wiring
from daq.simulated.press import VirtualPress, VirtualPressSettings

FAST_MODE_S = 0.1
"""An ADAM-4118 in its fast mode converts its eight inputs in about this time. [s]"""
WAITING_S = 4.0
"""While it waits, the press goes to and fro in the first seconds before a pressing. [s]"""
FIRST_PANEL_S = 15.0
"""When the first panel is inserted: who has just started the demonstration need not watch an empty press for as
long as between two pressings. [s]"""
SOLVING_S = 0.1
"""A panel inserted so soon is not exchanged any more: solving a pressing took 0.03 to 0.06 s (2026-11). [s]"""
REST_S = 20.0
"""How long after the last panel's removal the press comes to rest, before another would be inserted. [s]"""
TCP_CHANNELS = ("platen_top", "platen_bottom", *(f"top_{i}" for i in range(1, 8)))
SERIAL_CHANNELS = tuple(f"bottom_{i}" for i in range(1, 8))
AMBIENT_INPUT = ("",)
"""The modules' unused inputs."""


def virtual_press_of(settings: dict[str, Any]) -> VirtualPress:
    """Return the virtual press of these settings; two of the same settings agree at all times."""
    return VirtualPress(
        VirtualPressSettings(hide=tuple(settings["hide"]), keep=settings["keep"], first_panel_s=FIRST_PANEL_S),
        settings["seed"],
    )


@dataclass
class PressClock:
    """The virtual press's time: it waits to be started, runs, and rests after the last pressing."""

    press: VirtualPress
    speed: float
    pressings: int | None
    started_s: float | None = None
    """Where virtual time 0 is on the machine's monotonic clock. [s]"""
    _over_s: float | None = None

    def __call__(self) -> float:
        """Return the virtual time. [s]"""
        now = time.monotonic()
        if self.started_s is None:
            return _to_and_fro(now)
        at_s = (now - self.started_s) * self.speed
        if self._over_s is None and self.pressings is not None:
            cycle = self.press.cycle(max(at_s, 0.0))
            if cycle.number > self.pressings:
                self._over_s = cycle.start
        if self._over_s is None or at_s < self._over_s + REST_S:
            return at_s
        return self._over_s + REST_S - _to_and_fro(at_s - self._over_s - REST_S)


def at_rest(press: VirtualPress, rng: np.random.Generator) -> dict[str, float]:
    """Return what the thermocouples give before the first pressing, which need not be solved for it. [°C]"""
    true = {name: press.settings.setpoint_C if name in PLATENS else press.ambient for name in CHANNELS}
    return {name: value + float(rng.normal(0.0, press.settings.nuisances.white_K)) for name, value in true.items()}


def _to_and_fro(t: float) -> float:
    """Return 0 at 0, then up to `WAITING_S` and back, again and again."""
    return WAITING_S - abs(t % (2 * WAITING_S) - WAITING_S)


def main() -> int:
    """Serve both loggers until standard input ends."""
    settings = json.loads(sys.stdin.readline())
    press = virtual_press_of(settings)
    clock = PressClock(press, float(settings["speed"]), settings["pressings"])

    rest = np.random.default_rng(settings["seed"])

    def inputs(channels: tuple[str, ...]) -> Any:
        def temperatures(at_s: float) -> list[float]:
            now = at_rest(press, rest) if clock.started_s is None else press.temperatures(max(at_s, 0.0))
            return [now[name] if name else press.ambient for name in channels]

        return temperatures

    with ExitStack() as lines:
        over_tcp = TCP_CHANNELS + AMBIENT_INPUT * (16 - len(TCP_CHANNELS))
        over_serial = SERIAL_CHANNELS + AMBIENT_INPUT * (8 - len(SERIAL_CHANNELS))
        daq = lines.enter_context(simulated("labjack-t7", inputs(over_tcp), clock=clock, refresh_s=0.0))
        adam = lines.enter_context(
            simulated("adam-4118-ascii", inputs(over_serial), clock=clock, refresh_s=FAST_MODE_S)
        )
        tables = [
            wiring("labjack-t7", daq, "platens and top", TCP_CHANNELS),
            wiring("adam-4118-ascii", adam, "bottom", SERIAL_CHANNELS),
        ]
        _send({"loggers": tables})
        press.cycle(0.0)
        _send({"ready": True})
        if line := sys.stdin.readline():
            clock.started_s = float(json.loads(line)["started_monotonic_s"])
        for line in sys.stdin:
            header = json.loads(line)["panel"]
            first = press.coming(max(clock() + SOLVING_S * clock.speed, 0.0))
            press.set_panels(first, header)
            _send({"panel": header, "from": first})
    return 0


def _send(message: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
