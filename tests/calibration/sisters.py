"""What sisters are worth to a new press: ``python -m tests.calibration.sisters [SEED ...]``.

Eight virtual presses of one kind for each seed. Their contacts are log-normal about the laboratory press's with
`BETWEEN`, those of their pressings scatter as campaigns draw it, panels by 5 %. Seven have pressed `RUNS` panels.
One pressing of the eighth is followed as its first (with nothing known, with its sisters, with one of these odd:
all contacts times `ODD`) and as its fifth (with four of its own before it, without sisters and with). At last the
eighth is itself the odd one. Printed are the core's error (rms) after closing where it is valid, the mean
half-width of its band, the share of valid scans in it, and the share that is valid.
"""

import sys
from dataclasses import replace

import numpy as np

from daq.press.press_file import parse_press
from daq.simulated.campaign import make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.physics_pressing import BASE_COEFFICIENTS
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.fitter import fit_one
from softsensor.jobs.model_in_force import up_to_date
from softsensor.jobs.sisters import Sister, learned_from
from tests.calibration.live_band import PLAN, Rows, followed

PRESS = parse_press(press_toml())
BETWEEN = 0.25
"""Of the logarithm of a contact between presses; about as much as pressings of one differ."""
PRESSES, RUNS, OWN, ODD = 8, 6, 5, 3.0
NAMED = (
    "first, nothing known",
    "first, sisters",
    "first, sisters, one odd",
    "fifth",
    "fifth, sisters too",
    "odd itself, first, nothing known",
    "odd itself, first, sisters",
    "odd itself, fifth",
    "odd itself, fifth, sisters too",
)


def pressings(seed, count, factor=1.0):
    """Return the pressings of one press of the kind."""
    rng = np.random.default_rng([seed, 23])
    contacts = {n: factor * v * np.exp(BETWEEN * rng.standard_normal()) for n, v in BASE_COEFFICIENTS.items()}
    return make_campaign(seed, count, None, replace(PLAN, coefficients=contacts, thickness_mm=16.0))


def sister(seed, factor=1.0):
    """Return a press that has pressed."""
    fits = [fit_one(PRESS, run, None) for run, _ in pressings(seed, RUNS, factor)]
    return Sister(f"press-{seed}", ModelFile("", "lab", {}), fits[::-1])


def fleet(seed):
    """Return how a pressing of the eighth press is followed, in the order of `NAMED`."""
    seeds = [100 * seed + i for i in range(PRESSES)]
    sisters = [sister(s) for s in seeds[1:]]
    kind, one_odd = (learned_from(PRESS, s) for s in (sisters, [sister(seeds[1], ODD), *sisters[1:]]))
    usual, odd = (pressings(seeds[0], OWN, factor) for factor in (1.0, ODD))
    own, odd_own = ([fit_one(PRESS, run, None) for run, _ in p[:-1]][::-1] for p in (usual, odd))
    known = (None, kind, one_odd, up_to_date(PRESS, None, own), up_to_date(PRESS, kind, own))
    known += (None, kind, up_to_date(PRESS, None, odd_own), up_to_date(PRESS, kind, odd_own))
    pressed = [usual[-1]] * 5 + [odd[-1]] * 4
    return [followed(PRESS, run, t.core_C, model) for (run, t), model in zip(pressed, known, strict=True)]


def scores_of(rows):
    """Return error, half-width, share in the band and share valid."""
    good = rows.only(rows.valid > 0)
    return (np.sqrt(np.mean(good.error**2)), good.half.mean(), good.inside.mean(), rows.valid.mean())


def main(seeds):
    found = [fleet(seed) for seed in seeds]
    print(f"{'':32s} error K  half K  in band  valid   errors by seed")
    for i, name in enumerate(NAMED):
        error, half, inside, valid = scores_of(Rows.joined([one[i] for one in found]))
        each = " ".join(f"{scores_of(one[i])[0]:.2f}" for one in found)
        print(f"{name:32s} {error:7.2f} {half:7.1f} {inside:8.0%} {valid:6.0%}   {each}", flush=True)


if __name__ == "__main__":
    main([int(seed) for seed in sys.argv[1:]] or list(range(811, 819)))
