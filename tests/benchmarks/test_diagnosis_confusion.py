"""Hide every effect, faults outside the catalogue and nothing at all; print what the diagnosis answers.

Twelve runs a campaign at the sizes of the facts, drawn from seeds; set KERNTEMP_SEEDS for more than one
campaign an effect. "right" is the truth first or in a set of at most three, "honest" is no name given.
"""

import os
from collections import Counter

import numpy as np
import pytest

from daq.pressfile import parse_press
from daq.simulated.campaign import Plan, make_campaign, press_toml
from daq.simulated.effects import OUTSIDE, SIZES
from softsensor.diagnosis import diagnose

pytestmark = [pytest.mark.benchmark, pytest.mark.timeout(4 * 3600)]

SEEDS = int(os.environ.get("KERNTEMP_SEEDS", "1"))
NOTHING = 6
PAIRS = (
    ("moisture_evaporation", "thermocouple_lag"),
    ("edge_loss", "contact_buildup"),
    ("conductivity_temperature", "contact_asymmetry"),
    ("vapour_convection", "open_radiation"),
)


def answer(task):
    """Diagnose one campaign; return what matters of the answer and of the truth."""
    hidden, seed, plan = task
    campaign = make_campaign(seed, 12, list(hidden) or None, plan)
    found = diagnose(parse_press(press_toml()), [run for run, _ in campaign])
    truth = campaign[0][1].effects
    hits = []
    for f in found.findings:
        for name, value in truth.get(f.name, {}).items():
            low, high = f.parameters[name].ci95
            near = abs(f.parameters[name].value - value) <= 0.35 * abs(value)
            hits.append((low <= value <= high, near or len(f.set) > 1))
    cores = (found.base.core_rmse_K, found.extended.core_rmse_K)
    return hidden, found.verdict, [f.set for f in found.findings], hits, cores, found.seconds


def test_confusion_matrix_of_hidden_and_named_causes():
    plan = Plan(core_column=0.25)
    tasks = [((name,), 1000 + 50 * i + k, plan) for i, name in enumerate(SIZES) for k in range(SEEDS)]
    tasks += [((), 3000 + k, plan) for k in range(NOTHING * SEEDS)]
    tasks += [((name,), 4000 + 50 * i + k, plan) for i, name in enumerate(OUTSIDE) for k in range(SEEDS)]
    tasks += [(pair, 5000 + 50 * i + k, plan) for i, pair in enumerate(PAIRS) for k in range(SEEDS)]
    answers = [answer(task) for task in tasks]
    table(answers)
    assert len(answers) == len(tasks)


def table(answers):
    """Print rates, then the matrix."""
    single = [a for a in answers if len(a[0]) == 1 and a[0][0] in SIZES]
    nothing = [a for a in answers if not a[0]]
    outside = [a for a in answers if len(a[0]) == 1 and a[0][0] in OUTSIDE]
    pairs = [a for a in answers if len(a[0]) == 2]
    hits = [h for a in single for h in a[3]]

    def share(part, of):
        return f"{part} of {of} ({100 * part / max(of, 1):.0f} %)"

    print()
    print("truth first or in a set of at most three", share(sum(right(a) for a in single), len(single)))
    print("wrong name                              ", share(sum(wrong(a) for a in single), len(single)))
    print("false name without effect               ", share(sum(bool(a[2]) for a in nothing), len(nothing)))
    print(
        "no_effect without effect                ", share(sum(a[1] == "no_effect" for a in nothing), len(nothing))
    )
    unknown = sum(a[1] == "unknown_effect" for a in outside)
    print("outside the catalogue called unknown    ", share(unknown, len(outside)))
    print("outside the catalogue given a name      ", share(sum(bool(a[2]) for a in outside), len(outside)))
    print("both of a pair found                    ", share(sum(both(a) for a in pairs), len(pairs)))
    print("parameter inside its interval           ", share(sum(h[0] for h in hits), len(hits)))
    print("parameter within 35 % (or in a set)     ", share(sum(h[1] for h in hits), len(hits)))
    print("seconds a campaign, median              ", f"{np.median([a[5] for a in answers]):.1f}")
    print(f"\n{'hidden':44}{'verdict and sets':60}core error before -> after")
    rows = Counter()
    for hidden, verdict, sets, _, cores, _ in answers:
        named = "; ".join("/".join(s) for s in sets)
        before, after = cores
        core = "" if before is None else f"{before:.2f} -> {after:.2f} K"
        rows[(" + ".join(hidden) or "nothing", f"{verdict} {named}", core)] += 1
    for (hidden, said, core), count in rows.items():
        print(f"{hidden:44}{said:60}{core}{f'  x{count}' if count > 1 else ''}")


def right(a):
    return any(a[0][0] in s and len(s) <= 3 for s in a[2])


def wrong(a):
    return bool(a[2]) and any(a[0][0] not in s for s in a[2])


def both(a):
    return all(any(name in s for s in a[2]) for name in a[0])
