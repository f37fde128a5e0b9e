"""Compile what the services will need before a demonstration starts its clock: ``python -m api.demo.warm_up``.

Compiled code is kept on disk, so this takes a minute once after an installation and a moment later on.
"""

from __future__ import annotations

import sys

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


def main() -> int:
    """Send one short pressing of the virtual press through live sensor, fit and simulation."""
    from softsensor.fitting.simulated_run import simulate_run
    from softsensor.heat.model import ThermalModel
    from softsensor.jobs.campaign import fit_campaign
    from softsensor.live.sensor import LiveSensor

    press = parse_press(press_toml())
    run, _ = make_campaign(1, 1, plan=SHORT)[0]
    fitted = fit_campaign(press, [run])
    model = ThermalModel(press)
    simulate_run(run, press, model, model.guesses)
    for known in (None, fitted.model_file()):
        sensor = LiveSensor(press, run.header, known)
        for i, time_s in enumerate(run.time_s.tolist()):
            sensor.update(time_s, {name: float(values[i]) for name, values in run.columns.items()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
