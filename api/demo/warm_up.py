"""Compile what the services will need before a demonstration starts its clock: ``python -m api.demo.warm_up``.

Compiled code is kept on disk, so this takes a minute once after an installation and a moment later on. With the
name of a part it compiles that one alone, so that several can be compiled side by side.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml

SHORT = Plan(
    rate_hz=2.0,
    thickness_mm=16.0,
    closed_column=False,
    press_time_s=(18.0, 20.0),
    open_before_s=(5.0, 6.0),
    open_after_s=(30.0, 31.0),
)


def follow_live() -> None:
    """Send one short pressing of the virtual press through the live sensor."""
    from softsensor.live.sensor import LiveSensor

    run, _ = make_campaign(1, 1, plan=SHORT)[0]
    sensor = LiveSensor(parse_press(press_toml()), run.header)
    for i, time_s in enumerate(run.time_s.tolist()):
        sensor.update(time_s, {name: float(values[i]) for name, values in run.columns.items()})


def fit_one() -> None:
    """Fit one short pressing of the virtual press, and simulate it."""
    from softsensor.fitting.simulated_run import simulate_run
    from softsensor.heat.model import ThermalModel
    from softsensor.jobs.campaign import fit_campaign

    press = parse_press(press_toml())
    run, _ = make_campaign(1, 1, plan=SHORT)[0]
    fit_campaign(press, [run])
    model = ThermalModel(press)
    simulate_run(run, press, model, model.guesses)


PARTS: Mapping[str, Callable[[], None]] = {"live": follow_live, "fit": fit_one}


def main(parts: Sequence[str]) -> int:
    """Compile some parts, or all."""
    for part in parts or PARTS:
        PARTS[part]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
