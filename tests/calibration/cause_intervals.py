"""Whether a named cause's intervals hold its true parameters where a second cause is hidden beside it.

The catalogue is cut to the two hidden causes, which asks for the sizes of what is named, not for names: a campaign
is then diagnosed in a minute. "alone" are the intervals of the model with the named causes only, "told" those of
the diagnosis, which hold whether what is suspected beside them is there or not.
"""

import argparse

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign, press_toml
from softsensor.diagnosis.numbers import intervals
from softsensor.diagnosis.rehearsal import Rate
from softsensor.diagnosis.verdict import diagnose
from softsensor.effects import find_effect

RUNS = 12


def answers(pair, seed):
    """Yield of every true parameter of a named cause: its name, truth, and what is told alone and in the end."""
    campaign = make_campaign(seed, RUNS, pair, Plan(core_column=0.25))
    found = diagnose(parse_press(press_toml()), [run for run, _ in campaign], effects=pair, law=False)
    beside = "+".join(f.name for f in found.suspected)
    for finding in found.findings:
        for name, truth in campaign[0][1].effects.get(finding.name, {}).items():
            alone = intervals(found.final.fit, find_effect(finding.name))[name].ci95
            yield f"{finding.name}.{name}", truth, beside, alone, finding.parameters[name].ci95


def inside(truth, ci95):
    return ci95[0] <= truth <= ci95[1]


def rate(hits):
    found = Rate(sum(hits), len(hits))
    low, high = found.ci95
    return f"{found.count} of {found.of} ({low:.2f} to {high:.2f})"


def main():
    """Print a row for each parameter, then the shares that hold, with their binomial intervals."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("campaigns", nargs="+", metavar="CAUSE+CAUSE:SEED")
    rows = []
    for one in asked.parse_args().campaigns:
        names, _, seed = one.partition(":")
        for row in answers(names.split("+"), int(seed)):
            name, truth, beside, alone, shown = row
            print(
                f"{one:60}{name:36}{truth:10.4g}  alone {alone}  told {shown}  suspected {beside or '-'}",
                flush=True,
            )
            rows.append(row)
    for what, some in (
        ("suspected beside it", [r for r in rows if r[2]]),
        ("nothing", [r for r in rows if not r[2]]),
    ):
        for at, which in ((3, "alone"), (4, "told")):
            print(f"{what:24}{which:8}{rate([inside(r[1], r[at]) for r in some])}")


if __name__ == "__main__":
    main()
