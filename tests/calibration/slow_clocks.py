"""Whether faces show that the clock runs at 0.8: ``python -m tests.calibration.slow_clocks [SEED ...]``.

With all times times a rate, the equations are those of plates and panel that hold so much of their heat. A face
that meets a plate at a contact h rises by a function of h^2 t / (k rho c) alone (Carslaw & Jaeger 1959, ch. 2.7):
a clock of 0.8 reads like a contact 12 % better, and contacts differ by 12 to 30 % from pressing to pressing.

Each pressing of the virtual press is followed twice, with its times right and times 0.8, by filters that believe
them beside filters that know the rate. Printed is by how many nats those that know it are ahead, at the opening
and at the end, and how many of the slow clocks a test finds that calls no more than one of twenty right ones slow.

2026-11-25, seeds 501 to 512, a model that eight runs were held against: at the opening 25 % (pressed for 40 to
60 s) and 8 % (90 to 110 s) are found, of long pressings 92 % once they have been open for 35 to 45 s.
"""

import sys
from dataclasses import replace

import numpy as np

from daq.press.header import panel_of
from daq.press.press_file import press_for_run
from daq.simulated.campaign import make_campaign
from softsensor.live.panels import LikelyPanel
from softsensor.live.sensor import ScanSensor
from softsensor.live.setup import set_up
from tests.calibration.wrong_headers import MODEL, PRESS_TIMES_S
from tests.softsensor.test_live_trust import PLAN, PRESS

RATE = 0.8
CAPACITY = "heat_capacity_J_kgK"
FALSE_ALARMS = 0.05


def by_a_slow_clock(press, run):
    """Return press and run as a clock of `RATE` makes them look: all of it holds so much less heat."""
    layers = tuple(
        own if own.from_run else own.model_copy(update={CAPACITY: RATE * getattr(own, CAPACITY)})
        for own in press.layer
    )
    header = {**run.header, f"panel.{CAPACITY}": RATE * panel_of(run).heat_capacity}
    return press.model_copy(update={"layer": layers}), replace(run, header=header)


class KnowsTheRate(ScanSensor):
    """Follows what the header says and, as likely beforehand, the same by a slow clock."""

    def _begin(self, values):
        followed = super()._begin(values)
        (own,) = followed.panels
        slow = set_up(*by_a_slow_clock(press_for_run(PRESS, own.setup.run), own.setup.run), MODEL)
        followed.panels = (replace(own, chance=0.5), LikelyPanel(0.5, slow))
        return followed


def ahead(run, opened_s):
    """Return by how much the best filter that knows the rate is likelier, at the opening and at the end. [nats]"""
    sensor, found = KnowsTheRate(PRESS, run.header, MODEL), [np.nan, np.nan]
    for i, time_s in enumerate(run.time_s.tolist()):
        sensor.update(time_s, {name: float(values[i]) for name, values in run.columns.items()})
        if (current := sensor._run.passes.current) is not None:
            plain, slow = (max(f.fit for f in current.filters if f.panel == panel) for panel in (0, 1))
            found = [slow - plain if time_s < opened_s else found[0], slow - plain]
    return found


def main(seeds):
    for label, press_time_s in PRESS_TIMES_S.items():
        pressings = [make_campaign(seed, 1, None, replace(PLAN, press_time_s=press_time_s))[0] for seed in seeds]
        right, slow = (
            np.array(
                [
                    ahead(replace(run, time_s=rate * run.time_s), rate * truth.moments.opened_s)
                    for run, truth in pressings
                ]
            )
            for rate in (1.0, RATE)
        )
        for when, honest, wrong in zip(("opening", "end"), right.T, slow.T, strict=True):
            found = np.mean(wrong > np.quantile(honest, 1.0 - FALSE_ALARMS))
            shown = "  ".join(
                f"{name} {v.min():6.1f} to {v.max():5.1f}, mean {v.mean():5.1f}"
                for name, v in (("right", honest), ("slow", wrong))
            )
            print(f"pressed for {label:12s} {when:8s} nats: {shown}  slow ones found {found:4.0%}", flush=True)


if __name__ == "__main__":
    main([int(seed) for seed in sys.argv[1:]] or list(range(501, 513)))
