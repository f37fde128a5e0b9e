"""How often a press with nothing missing ever gets a name in a year of nights, and how late a cause gets its own.

    python -m tests.calibration.names_over_nights 1000 [SEED]
    python -m tests.calibration.names_over_nights late [SEED]
    python -m tests.calibration.names_over_nights nights [SEED]

The first, of so many presses, and the second draw nights: a pressing's scores are those of a run of virtual
presses, fitted for real, drawn with replacement. Two rules look on: the test of a campaign at 5 %, asked every
night of the runs that a night's diagnosis is asked of (24, without the newest 12), and the bets of
`softsensor.jobs.bets`. Where nothing is missing the scores of a run have their own signs or all the opposite ones,
so that both rules have what they assume; for the bets also with every cause at its least size, the worst they
allow. The third does without drawing: real nights, a pressing each, a cause from the eleventh on; beside what the
store holds after a night stands what the scores of all its runs, fitted at once, give.
"""

import math
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.store import open_store
from softsensor.diagnosis.run_scores import run_scores, ways
from softsensor.diagnosis.sign_flips import SCORE_LIMIT, max_t
from softsensor.heat.model import ThermalModel
from softsensor.jobs.bets import Bets
from softsensor.jobs.night import refit_press
from softsensor.jobs.night_judgement import DIAGNOSED_RUNS, JUDGES
from softsensor.jobs.night_progress import Progress
from softsensor.signals.unknown import ALPHA

PRESS, PLAN = parse_press(press_toml()), Plan(closed_column=True, thickness_mm=16.0, rate_hz=2.0)
NIGHTS, BEGINS, LATEST = 365, 100, 200
TESTED = 25
"""One press in so many is tested each night: it takes a thousand flips of signs where a bet takes one step."""
CAUSES = (
    "vapour_convection",
    "moisture_evaporation",
    "edge_loss",
    "conductivity_temperature",
    "contact_buildup",
    "platen_offset",
    "thermocouple_lag",
)
UPWARD = [True] * len(ways())
"""A way is one-sided; what can have either sign has two."""


def shown(seed: int, runs: int, cause: str | None, scale: float) -> np.ndarray:
    """Return what the runs of a virtual press show, and what the least sizes would be (2, runs, ways)."""
    campaign = [run for run, _ in make_campaign(seed, runs, cause, replace(PLAN, scale=scale))]
    found = run_scores(ThermalModel(PRESS), PRESS, campaign)
    none = np.zeros(runs)
    return np.stack(
        [
            [found[w].score if w in found else none for w in ways()],
            [found[w].least if w in found else none for w in ways()],
        ]
    ).transpose(0, 2, 1)


def bets_over(beyond: np.ndarray) -> Iterator[Bets]:
    """Yield the bets after each run (runs, ways)."""
    bets = Bets().facing("plain")
    for number, row in enumerate(np.clip(beyond, -SCORE_LIMIT, SCORE_LIMIT).tolist(), 1):
        bets = bets.after(str(number), number, dict(zip(ways(), row, strict=True)))
        yield bets


def sure_after(beyond: np.ndarray) -> int:
    """Return the run that makes it sure, one more than there are where none does."""
    return next((bets.counted for bets in bets_over(beyond) if bets.sure), len(beyond) + 1)


def tested(scores: np.ndarray, night: int, held: int) -> np.ndarray:
    """Return the p-values of the runs up to a night, but those held out (ways)."""
    asked = scores[max(night - held - DIAGNOSED_RUNS, 0) : night - held]
    return max_t(np.clip(asked, -SCORE_LIMIT, SCORE_LIMIT), UPWARD)


def tested_after(scores: np.ndarray, of: np.ndarray, nights: range, held: int) -> int:
    """Return the first of some nights at which the test names one of some ways, the end where none does."""
    return next((n for n in nights if tested(scores, n, held)[of].min() <= ALPHA), nights.stop)


def drawn(rng: np.random.Generator, pool: np.ndarray, runs: int) -> np.ndarray:
    """Return runs drawn from a pool (2, runs, ways)."""
    return pool[:, rng.integers(0, pool.shape[1], runs)]


def false_names(rng: np.random.Generator, pools: list[np.ndarray], presses: int) -> None:
    """Print the share of presses with nothing missing that are ever given a name."""
    every, nights = np.arange(len(ways())), range(DIAGNOSED_RUNS + JUDGES, NIGHTS + 1)
    ever, tests = np.zeros(3), presses // TESTED
    for press in range(presses):
        score, least = drawn(rng, pools[rng.integers(len(pools))], NIGHTS)
        score = score * rng.choice([-1.0, 1.0], (NIGHTS, 1))
        ever[0] += press < tests and tested_after(score, every, nights, JUDGES) <= NIGHTS
        ever[1] += sure_after(score - least) <= NIGHTS
        ever[2] += sure_after(score) <= NIGHTS
    print(f"nothing missing, {NIGHTS} nights: a name ever")
    print(f"  test each night                         {int(ever[0]):4d} of {tests} presses")
    print(f"  bets                                    {int(ever[1]):4d} of {presses}")
    print(f"  bets, every cause at its least size     {int(ever[2]):4d} of {presses}", flush=True)


def delays(rng: np.random.Generator, nothing: list[np.ndarray], seed: int, presses: int) -> None:
    """Print how many nights after its first a cause is named, by rule."""
    print(f"pressings until a cause that begins after {BEGINS} is named, median and 90 %:")
    print("  by the test each night, by it with no run held out, by the bets")
    for i, cause in enumerate(CAUSES):
        of = np.array([j for j, way in enumerate(ways().values()) if way.effect.name == cause])
        for scale in (1.0, 0.5):
            hidden = shown(seed + 100 + i, DIAGNOSED_RUNS, cause, scale)
            late = []
            for _ in range(presses):
                before = drawn(rng, nothing[rng.integers(len(nothing))], BEGINS)
                score, least = np.concatenate([before, drawn(rng, hidden, LATEST)], axis=1)
                nights = range(BEGINS + 1, BEGINS + LATEST + 1)
                tests = [tested_after(score, of, nights, held) for held in (JUDGES, 0)]
                late.append([*tests, max(sure_after(score - least), BEGINS)])
            late = np.array(late) - BEGINS
            text = "   ".join(f"{np.median(x):4.0f} {np.percentile(x, 90):4.0f}" for x in late.T)
            ratio = np.median(late[:, 2]) / np.median(late[:, 0])
            print(f"  {cause:26s} {'whole' if scale == 1.0 else 'half':6s} {text}   ratio {ratio:.1f}", flush=True)


def real_nights(seed: int, nights: int = 20, first: int = 10) -> None:
    """Print what the store holds after each of some real nights, and the same from all runs fitted at once."""
    short = replace(PLAN, rate_hz=1.0, press_time_s=(40.0, 90.0))
    usual, hidden = (make_campaign(seed, first + nights, cause, short) for cause in (None, "vapour_convection"))
    runs = [run for run, _ in (*usual[: first + 10], *hidden[first + 10 :])]
    scores = run_scores(ThermalModel(PRESS), PRESS, runs)
    rows = np.array([scores[w].beyond if w in scores else np.zeros(len(runs)) for w in ways()]).T
    at_once = [bets.average if not bets.sure else math.inf for bets in bets_over(rows)]
    print("night  store  all at once  verdict, named")
    with tempfile.TemporaryDirectory() as folder, open_store(str(Path(folder) / "kerntemp.sqlite")) as store:
        for number, run in enumerate(runs, 1):
            store.import_run(run, "lab", press_toml())
            if number < first:
                continue
            outcome = refit_press(store, "lab", PRESS, workers=1)
            bets = Progress.of(store, "lab").bets
            average = math.inf if bets.sure else bets.average
            text = f"{outcome.verdict} {' + '.join(outcome.named)}  {outcome.reason}"
            print(f"{number:5d} {average:8.3f} {at_once[number - 1]:8.3f}  {text}", flush=True)


def nothing_hidden(seed: int) -> list[np.ndarray]:
    """Return what the runs of some virtual presses show in which nothing is hidden."""
    return [shown(seed + i, 2 * DIAGNOSED_RUNS, None, 1.0) for i in range(4)]


if __name__ == "__main__":
    what, *numbers = sys.argv[1:]
    seed = int(numbers[-1]) if numbers else 7400
    if what == "nights":
        real_nights(seed)
    elif what == "late":
        delays(np.random.default_rng(seed), nothing_hidden(seed), seed, presses=20)
    else:
        false_names(np.random.default_rng(seed), nothing_hidden(seed), int(what))
