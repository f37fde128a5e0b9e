"""A simulated logger to try a profile on: ``python -m daq.simulated.devices_serve adam-4118``.

Prints the settings table that reads it and serves room temperature until interrupted. Input k is
0.3 K warmer than input k - 1; ``--open 3`` breaks thermocouples.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import threading
from collections.abc import Mapping, Sequence
from typing import Any

from daq.records import InputError
from daq.simulated.devices import KINDS, kind_of, simulated, wiring
from daq.simulated.devices_converter import Switches
from daq.words import say


def room(inputs: int) -> Any:
    """Return temperatures of sensors that lie in a room."""

    def temperatures(now_s: float) -> list[float]:
        return [21.0 + 0.3 * k + 0.2 * math.sin(now_s / 10 + k) for k in range(inputs)]

    return temperatures


def table_lines(table: Mapping[str, Any]) -> list[str]:
    """Return a settings table as TOML."""
    return [f"{key} = {_toml(value)}" for key, value in table.items()]


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return json.dumps(value)


def main(arguments: Sequence[str] | None = None, stop: threading.Event | None = None) -> int:
    """Serve one device until interrupted or `stop` is set."""
    parser = argparse.ArgumentParser(prog="python -m daq.simulated.devices_serve", description=__doc__)
    parser.add_argument("profile", choices=sorted(KINDS))
    parser.add_argument("--address", type=int, default=1, help="station on the bus")
    parser.add_argument("--transport", choices=("serial", "tcp", "rtu_over_tcp"))
    parser.add_argument("--open", type=int, nargs="*", default=[], help="inputs whose thermocouple is broken")
    given = parser.parse_args(arguments)
    inputs = kind_of(given.profile).inputs
    if any(not 0 <= k < inputs for k in given.open):
        problem = say("simulated-no-input", given=str(given.open), profile=given.profile, last=inputs - 1)
        raise InputError(problem)
    switches = Switches(open_inputs=set(given.open))
    with simulated(
        given.profile,
        room(inputs),
        address=given.address,
        transport=given.transport,
        switches=switches,
    ) as server:
        names = tuple(f"input_{k}" for k in range(inputs))
        table = wiring(given.profile, server, "simulated", names, address=given.address)
        if given.transport == "rtu_over_tcp" and kind_of(given.profile).transport != "rtu_over_tcp":
            table["transport"] = "rtu_over_tcp"
        sys.stdout.write("\n".join(["[[press.logger]]", *table_lines(table)]) + "\n")
        sys.stdout.flush()
        try:
            (stop or threading.Event()).wait()
        except KeyboardInterrupt:
            return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
