"""The band of a press's first pressing, without a model: ``python -m tests.calibration.first_pressings``.

Virtual pressings of panels that scatter by 5 %, with each cause in the panel hidden in turn at the sizes
campaigns draw, on the press that the sensor was written with and on another. Printed are the share of scans
after closing that are valid, that of valid ones whose band holds the core, their mean half-width, and the share
in the band by run.
"""

import sys
from dataclasses import replace

import numpy as np

from daq.press.press_file import parse_press
from daq.simulated.campaign import make_campaign
from daq.simulated.campaign_pressfile import press_toml
from tests.calibration.live_band import HIDDEN, OTHER_PRESS, PLAN, followed

THICKNESSES_MM = (8.0, 16.0, 19.0)


def first_pressings(plan, cause, seeds):
    """Return by run the valid scans' half-width and whether they hold the core, and the share that is valid."""
    press = parse_press(press_toml(plates=plan.plates))
    found = []
    for seed in seeds:
        ((run, truth),) = make_campaign(seed, 1, cause, plan)
        rows = followed(press, run, truth.core_C, None)
        good = rows.only(rows.valid > 0)
        found.append((good.half, good.inside, float(rows.valid.mean())))
    return found


def main(seeds):
    print(f"{'press':6s} {'hidden':26s} {'mm':>4s}  valid  in band  half K  by run")
    for name, plan in (("own", PLAN), ("other", OTHER_PRESS)):
        for cause in (None, *HIDDEN):
            for thickness in THICKNESSES_MM:
                runs = first_pressings(replace(plan, panel_spread=0.05, thickness_mm=thickness), cause, seeds)
                half, inside = (np.concatenate([run[i] for run in runs]) for i in range(2))
                shares = " ".join(f"{run[1].mean():.2f}" for run in runs if len(run[1]))
                valid = np.mean([run[2] for run in runs])
                text = f"{valid:5.0%} {inside.mean():8.0%} {half.mean():7.1f}"
                print(f"{name:6s} {cause or 'nothing':26s} {thickness:4.0f}  {text}  {shares}", flush=True)


if __name__ == "__main__":
    main([int(seed) for seed in sys.argv[1:]] or [901, 902, 903, 904])
