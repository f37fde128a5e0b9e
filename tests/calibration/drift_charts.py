"""How often the control charts of a press raise a false alarm, and how soon they notice a change.

    python -m tests.calibration.drift_charts [PRESSES] [SEED]

A press has six coefficients and a pressing a night. Ranks do not know what values scatter like, so one law of
scatter would do; two are drawn all the same.
"""

import math
import sys
from collections.abc import Callable

import numpy as np

from softsensor.jobs.drift import CHARTED_RUNS, FALSE_ALARM_RUNS, log_evidence, rank_scores

COEFFICIENTS, NIGHTS, CHANGED, LATEST = 6, 365, 100, 120
SCATTER = {
    "normal": lambda rng, n: rng.standard_normal(n),
    "t, 2 degrees of freedom": lambda rng, n: rng.standard_t(2, n),
}


def alarms(logs: np.ndarray, nights: range) -> list[bool]:
    """Return whether an alarm stands after each night, of a press that has so many coefficients.

    Of the newest runs only, as at night; up to there one look tells what each night before it would have told.
    """
    level = math.log(FALSE_ALARM_RUNS * COEFFICIENTS)
    early = log_evidence(rank_scores(logs[:CHARTED_RUNS])) > level
    late = (log_evidence(rank_scores(logs[n - CHARTED_RUNS : n]))[-1] > level for n in nights if n > CHARTED_RUNS)
    return [*(bool(early[n - 1]) for n in nights if n <= CHARTED_RUNS), *map(bool, late)]


def false_alarms(rng: np.random.Generator, presses: int, draw: Callable) -> tuple[float, float]:
    """Return the share of presses with an alarm ever in a year, and alarms that begin in 1000 pressings."""
    ever, begun = 0, 0
    for _ in range(presses):
        stand = np.array([alarms(draw(rng, NIGHTS), range(3, NIGHTS + 1)) for _ in range(COEFFICIENTS)])
        ever += stand.any()
        begun += int((stand[:, 1:] & ~stand[:, :-1]).sum())
    return ever / presses, 1000.0 * begun / (presses * NIGHTS)


def noticed(rng: np.random.Generator, presses: int, spread: float, change: float, over: int) -> np.ndarray:
    """Return how many pressings after its beginning a change is noticed, `LATEST` where it is not (presses)."""
    late = []
    for _ in range(presses):
        logs = spread * rng.standard_normal(CHANGED + LATEST)
        logs[CHANGED:] += np.log1p(change) * np.minimum(np.arange(1, LATEST + 1) / over, 1.0)
        stand = alarms(logs, range(CHANGED + 1, CHANGED + LATEST + 1))
        late.append(stand.index(True) + 1 if any(stand) else LATEST)
    return np.array(late)


def main(presses: int, seed: int) -> None:
    """Print both tables."""
    rng = np.random.default_rng(seed)
    print(f"{presses} presses of {COEFFICIENTS} coefficients, {NIGHTS} pressings, nothing changes; seed {seed}")
    for name, draw in SCATTER.items():
        ever, begun = false_alarms(rng, presses, draw)
        print(f"  {name:24s} an alarm ever in {ever:6.1%} of presses, {begun:.2f} in 1000 pressings")
    print("pressings until a change after 100 is noticed: median, mean, 90 %")
    for spread in (0.05, 0.08, 0.12, 0.2, 0.3):
        for change, over in ((-0.1, 1), (-0.1, 30), (-0.3, 1)):
            late = noticed(rng, presses, spread, change, over)
            kind = "at once" if over == 1 else f"over {over}"
            text = f"{np.median(late):4.0f} {late.mean():6.1f} {np.percentile(late, 90):4.0f}"
            print(f"  scatter {spread:.0%}, {change:+.0%} {kind:8s} {text}")


if __name__ == "__main__":
    main(*(int(a) for a in (sys.argv[1:] + ["20", "24"][len(sys.argv) - 1 :])))
