"""What `EXPLAINED_FURTHER` does to further names: how many that are there, and how many that are not, it keeps.

    python -m tests.calibration.further_causes CASE ...

A case is ``first:SEED:CAUSE[+CAUSE][:LAW OF DRYING]`` or ``second:SEED:CAUSE``, twelve runs of the first or second
virtual press. Prints what the model leaves, over noise, without and with the further cause that a search takes;
then the shares of that beyond noise at which names that are there and names that are not would be kept, with their
binomial intervals.
"""

from __future__ import annotations

import sys

import softsensor
from daq.press.press_file import Press, parse_press
from daq.records import Run
from daq.simulated.campaign import Plan, make_campaign, press_toml
from softsensor.diagnosis.rehearsal import Rate
from softsensor.diagnosis.search import extend
from softsensor.diagnosis.selection import cool_rim, left_beside, search_all
from softsensor.diagnosis.settling import settle_base
from softsensor.diagnosis.verdict import _screened
from softsensor.heat.model import ThermalModel
from tests import second_press

RUNS = 12
SHARES = (0.4, 0.5, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)


def campaign(case: str) -> tuple[Press, list[Run], set[str]]:
    """Return press, runs, and the names of what is hidden."""
    which, seed, hidden, *law = case.split(":")
    names = hidden.split("+") if hidden else []
    if which == "second":
        drawn = second_press.campaign(int(seed), hidden, RUNS)
        there = {"moisture_evaporation", "vapour_convection"} if hidden == "moisture" else set(names)
        return parse_press(drawn.press), [softsensor.read_run(run) for run in drawn.runs], there
    plan = Plan(core_column=0.25, drying_law=law[0] if law else None)  # type: ignore[arg-type]
    return parse_press(press_toml()), [run for run, _ in make_campaign(int(seed), RUNS, names, plan)], set(names)


def further(case: str) -> tuple[str, bool, float, float] | None:
    """Return the second cause a search would take, whether it is there, what is left without and with it."""
    press, runs, there = campaign(case)
    readings, digests = _screened(press, runs)
    stages, rounds = search_all(
        settle_base(ThermalModel(press), digests), None, lambda *_: None, cool_rim(readings.rim)
    )
    if len(stages) > 2:
        model, name = stages[2], stages[2].effects[1]
    elif rounds[-1].let_go and (cause := rounds[-1].suspected) is not None:
        model, name = extend(stages[-1], cause), cause.effect.name
    else:
        return None
    return name, name in there, *left_beside(stages[:2], model)


def main(cases: list[str]) -> None:
    """Print a row a case, then the table."""
    kept: dict[bool, list[float]] = {True: [], False: []}
    for case in cases:
        found = further(case)
        if found is None:
            print(f"{case:60} no further cause", flush=True)
            continue
        name, right, before, after = found
        share = (before**2 - after**2) / max(before**2 - 1.0, 1e-9)
        kept[right].append(share)
        print(
            f"{case:60} {name:28} {'there' if right else 'not there':10} {before:.2f} -> {after:.2f}", flush=True
        )
    print(table(kept))


def table(kept: dict[bool, list[float]]) -> str:
    """Return how many names a bound on the share explained keeps, and what chance of it that allows. [%]"""
    lines = ["share explained    " + "".join(f"{share:>8.2f}" for share in SHARES)]
    for right, what in ((True, "there, kept"), (False, "not there, kept")):
        rates = [Rate(sum(x >= share for x in kept[right]), len(kept[right])) for share in SHARES]
        lines.append(f"{what:19}" + "".join(f"{rate.count:>8}" for rate in rates) + f"  of {len(kept[right])}")
        if kept[right]:
            ends = (f"{100 * low:.0f}-{100 * high:.0f}" for low, high in (rate.ci95 for rate in rates))
            lines.append(f"{'  95 % interval, %':19}" + "".join(f"{one:>8}" for one in ends))
    return "\n".join(lines)


if __name__ == "__main__":
    main(sys.argv[1:])
