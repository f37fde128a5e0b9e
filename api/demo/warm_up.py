"""Compile what fits will need before a demonstration starts its clock: ``python -m api.demo.warm_up``.

Compiled code is kept on disk, so this takes a minute once after an installation and a moment later on. The live
sensor compiles what it needs by itself.
"""

from __future__ import annotations

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


if __name__ == "__main__":
    fit_one()
