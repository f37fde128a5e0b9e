"""What the first search of a campaign has by flips of signs, and by the likelihood of runs left out.

    python -m tests.calibration.likelihood RUNS none|half|full FIRST_SEED CAMPAIGNS

Prints a line a campaign: what is hidden, the least p-value by flips, and the candidate with the largest sum that
`sign_flips.likelihood_p` is made of; beside them both of the hidden cause. Causes are hidden in the catalogue's
order, one a campaign. Last, quantiles of the largest sums.

2026-11-27, nothing hidden: in 40 campaigns of six runs (first seed 9128000) the largest sum is 2.4, above 0 in one
only, while flips come to 0.05 or less in 2; in 15 of twelve runs (9128100) it is 0 in all, and flips never do.
Causes at half their size, 34 campaigns of six runs (9129000): of the hidden cause the sum is 28 or more in 24,
above 0.05 by flips in 5 of them, and 0 or less in the other 10; 20 candidates ask for 12.
"""

from __future__ import annotations

import sys

import numpy as np

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from softsensor.diagnosis.search import Candidate, candidates_for, search
from softsensor.diagnosis.selection import p_values
from softsensor.diagnosis.settling import settle_base
from softsensor.diagnosis.sign_flips import saved_by_most
from softsensor.diagnosis.verdict import _screened
from softsensor.effects import Need, catalogue
from softsensor.heat.model import ThermalModel

SCALES = {"none": 1.0, "half": 0.5, "full": 1.0}
PRESS = parse_press(press_toml())


def main(runs: int, kind: str, first_seed: int, campaigns: int) -> None:
    """Print the table."""
    largest = []
    causes = list(catalogue())
    for number in range(campaigns):
        hidden = None if kind == "none" else causes[number % len(causes)]
        plan = Plan(core_column=0.25, scale=SCALES[kind])
        drawn = [run for run, _ in make_campaign(first_seed + number, runs, hidden, plan)]
        base = settle_base(ThermalModel(PRESS), _screened(PRESS, drawn)[1])
        found = search(base, candidates_for(base))
        p = p_values(found, np.arange(runs))
        best = max(found, key=summed)
        largest.append(summed(best))
        line = f"{first_seed + number} {hidden or 'nothing'}: flips {min(p.values()):.3f}, "
        line += f"likeliest {best.effect.name} {summed(best):.1f}"
        true = next((c for c in found if c.effect.name == hidden), None)
        line += f"; of the cause {p[true.effect.name]:.3f}, {summed(true):.1f}" if true else ""
        print(line, flush=True)
    quantiles = np.quantile(largest, [0.5, 0.9, 0.95, 1.0])
    print("largest sums, median, 90, 95, 100 %: " + ", ".join(f"{q:.1f}" for q in quantiles))


def summed(candidate: Candidate) -> float:
    """Return what most runs save by the others' numbers, 0 for a clock."""
    return 0.0 if candidate.effect.needs == Need.SWITCH else saved_by_most(candidate.gains)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
