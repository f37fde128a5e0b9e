"""Hide every effect, faults outside the catalogue and nothing at all; print what the diagnosis answers.

Sizes are those of the facts, drawn from seeds, with a quarter of the runs carrying a core thermocouple that
no fit sees. Environment: `KERNTEMP_SEEDS` campaigns an effect (1), `KERNTEMP_FIRST_SEED` the first of them
(1000), `KERNTEMP_RESULTS` a file of one JSON line a campaign, which a run broken off goes on from.

"first or in a set" is the truth in a set of at most three; "wrong name" a set without any truth in it.
Before and after are measured on six further runs of the same press that nobody has seen, simulated from
the model file: error of the core, and of the true faces, root mean square.

2026-11-21, first seed 150000, one campaign an effect, by the rules of that day, which asked no interval of a gain
and no share of what a law may be off; the rules of 2026-11-22 were made without these seeds, but not run on them:

    12 runs, one cause        named 19, no effect 1 (contact_load), wrong 0 of 20
    12 runs, nothing          no effect 20 of 20
    12 runs, outside          unknown 7 of 7, none given a name
    6 runs, half size         named or in a set 9, no effect 7, unknown 4, wrong 0 of 20
    parameters                inside their interval 21 of 22; sizes within 35 % 20 of 20 where the set is one
    core on unseen runs [K]   evaporation 0.9 -> 0.4, vapour convection 6.9 -> 1.4, conductivity with temperature
                              4.8 -> 0.8, edge loss 1.4 -> 0.25
    faces on unseen runs      nearer in 13 of 18
    pairs, 12 runs            both found 7 of 8, the first alone 1 of 8; once with a third name that was not there
    pairs, 24 runs            both found 8 of 8 (twice one of them in a set of two), no wrong name
    2 runs                    one cause found 13 of 20; wrong 0 of 20, nothing hidden 0 of 20, outside 0 of 7
    4 runs                    one cause found 16 of 20; wrong 0 of 20, nothing hidden 0 of 20, outside 0 of 7

2026-11-22, panels that scatter by 5 %, first seed 930000, one campaign an effect. That panels which differ as
panels do are no unknown effect, and that what is suspected is never "no effect", are rules made on these seeds:

    12 runs, one cause        named 15, in a set of three 1, unknown 3 (two of them suspected by their names:
                              conductivity_offset, thermocouple_footprint; heat_capacity_offset is not),
                              no effect 1 (contact_load), wrong 0 of 20
    12 runs, nothing          no effect 12 of 12; smallest p at most 0.05 in 4, without a sure gain
    12 runs, outside          unknown 4 of 4 tried, none given a name

2026-11-23, since the length of opening is free and the first 1.5 s after every insertion are left out; 12 runs,
nothing hidden, first seeds 930000 and 940000, both read while this was made:

    no effect                 23 of 24, unknown 1 (942007), as before; none given a name
    smallest p at most 0.05   6 of 24 (5 before): lag 2 (2), k or c with temperature 3 (3), moisture 1 (0); still
                              not the 5 % that a p-value promises, panels that scatter and scans are left
    lag saves 9 or more       1 of 24 (7 before), where it is among the three least p-values

2026-11-23, since a clock is tested beyond `CLOCK_ERROR_S`, read while that was made; 12 runs, nothing hidden,
first seed 950000:

    smallest p at most 0.05   3 of 12 (6 before): lag, cure, heat capacity; clock 0 (3); none given a name

2026-11-23, first seed 977000, drawn when all of this was made and read by nobody before; panels that scatter by
5 %, one campaign an effect; 16 s a campaign of 12 runs, median, on two shared cores:

    12 runs, one cause        named 15, in a set of two 1 (heat_capacity_offset), suspected by its name 1
                              (initial_press_state), no effect 3 (conductivity_offset, contact_load,
                              thermocouple_footprint), wrong 0 of 20
    12 runs, nothing          no effect 20 of 20; smallest p at most 0.05 in 1 of 20
    12 runs, outside          unknown 7 of 7, none given a name
    6 runs, half size         named or in a set 11 of 20, no effect 5, unknown 4, wrong 0 of 20
    pairs, 12 runs            both found 4 of 8, no wrong name
    parameters                inside their interval 17 of 18; sizes within 35 % 16 of 16 where the set is one
    core on unseen runs [K]   conductivity with temperature 4.1 -> 1.5; vapour convection at least halved; moisture
                              and edge loss not: panels that scatter leave 2 to 3 K whatever is named

That few runs get no name where several causes are found is a rule made on the last two rows: without it, three
faults outside were given names.
Earlier sets of one cause, by older rules: 57 of 60 (90000, three an effect; a rule was made on two of them), 19 of
20 (120000), none wrong. With each run's own contacts fitted, faces fell in 16 of 17 (70000).
"""

import json
import os
from collections import Counter
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.simulated.campaign import Plan, make_campaign, press_toml
from daq.simulated.effects import OUTSIDE, SIZES
from daq.simulated.physics_pressing import DryingLaw
from softsensor.diagnosis.extended_model import model_of
from softsensor.diagnosis.extension_unknowns import is_shape
from softsensor.diagnosis.verdict import diagnose
from softsensor.effects import find_effect
from softsensor.fitting.simulated_run import simulate_run

pytestmark = [pytest.mark.benchmark, pytest.mark.timeout(8 * 3600)]

SEEDS = int(os.environ.get("KERNTEMP_SEEDS", "1"))
FIRST = int(os.environ.get("KERNTEMP_FIRST_SEED", "1000"))
RESULTS = os.environ.get("KERNTEMP_RESULTS", "")
NOTHING = 20
LAWS = 8
"""Campaigns of moisture by each law of drying."""
FEW = (2, 4)
"""Runs with which no flip of signs can name anything, so that another rule stands in for it."""
UNSEEN = 6
PAIRS = (
    ("moisture_evaporation", "thermocouple_lag"),
    ("edge_loss", "contact_buildup"),
    ("conductivity_temperature", "contact_asymmetry"),
    ("vapour_convection", "open_radiation"),
    ("vapour_convection", "contact_buildup"),
    ("density_profile", "paper_layer"),
    ("heat_capacity_temperature", "thermocouple_footprint"),
    ("resin_cure", "initial_press_state"),
)
MUST_HALVE = ("moisture_evaporation", "vapour_convection", "conductivity_temperature", "edge_loss")
PRESS = parse_press(press_toml())


def tasks():
    """Yield (hidden names, seed, runs, scale[, law of drying]); cheap and telling ones first."""
    for k in range(SEEDS):
        yield from (((name,), FIRST + 50 * i + k, 12, 1.0) for i, name in enumerate(SIZES))
        yield from (((), FIRST + 2000 + NOTHING * k + j, 12, 1.0) for j in range(NOTHING))
        yield from (((name,), FIRST + 3000 + 50 * i + k, 12, 1.0) for i, name in enumerate(OUTSIDE))
        yield from (((name,), FIRST + 4000 + 50 * i + k, 6, 0.5) for i, name in enumerate(SIZES))
        yield from ((pair, FIRST + 6000 + 50 * i + k, 12, 1.0) for i, pair in enumerate(PAIRS))
        yield from ((pair, FIRST + 7000 + 50 * i + k, 24, 1.0) for i, pair in enumerate(PAIRS))
        for runs in FEW:
            yield from (((name,), FIRST + 8000 + 50 * i + k, runs, 1.0) for i, name in enumerate(SIZES))
            yield from (((), FIRST + 10000 + NOTHING * k + j, runs, 1.0) for j in range(NOTHING))
            yield from (((name,), FIRST + 11000 + 50 * i + k, runs, 1.0) for i, name in enumerate(OUTSIDE))
        for i, law in enumerate(get_args(DryingLaw)):
            yield from ((("moisture_evaporation",), FIRST + 13000 + 50 * i + j, 12, 1.0, law) for j in range(LAWS))


def answer(hidden, seed, runs, scale, law=None):
    """Diagnose one campaign; return what matters of the answer and of the truth."""
    campaign = make_campaign(
        seed, runs + UNSEEN, list(hidden) or None, Plan(core_column=0.25, scale=scale, drying_law=law)
    )
    found = diagnose(PRESS, [run for run, _ in campaign[:runs]])
    errors = [unseen_errors(model_of(s), campaign[runs:]) for s in (found.stages[0], found.final)]
    return {
        "hidden": list(hidden),
        "seed": seed,
        "runs": runs,
        "scale": scale,
        "law": law,
        "truth": dict(campaign[0][1].effects or campaign[0][1].outside),
        "unseen_core_K": [e[0] for e in errors],
        "unseen_faces_K": [e[1] for e in errors],
        **found.as_json(),
    }


def unseen_errors(model, runs):
    """Return core and face errors of a model file on runs that took no part. [K]"""
    core, faces = [], []
    for run, truth in runs:
        out = simulate_run(run, PRESS, model.model(PRESS), model.values)
        inside = out.time_s >= truth.moments.inserted_s
        core.append(np.mean((out.core - truth.core_C)[inside] ** 2))
        faces.append(np.mean((out.places["panel.top"] - truth.top_C)[inside] ** 2))
        faces.append(np.mean((out.places["panel.bottom"] - truth.bottom_C)[inside] ** 2))
    return float(np.sqrt(np.mean(core))), float(np.sqrt(np.mean(faces)))


def test_confusion_matrix_of_hidden_and_named_causes():
    kept = Path(RESULTS) if RESULTS else None
    known = kept.read_text(encoding="utf-8").splitlines() if kept is not None and kept.exists() else []
    answers = [json.loads(line) for line in known]
    done = {(tuple(a["hidden"]), a["seed"]) for a in answers}
    for task in tasks():
        if task[:2] in done:
            continue
        answers.append(answer(*task))
        if kept is not None:
            with kept.open("a", encoding="utf-8") as file:
                file.write(json.dumps(answers[-1]) + "\n")
    table(answers)
    assert len(answers) >= len(list(tasks()))


def table(answers):
    """Print rates, then the matrix."""
    single = [a for a in answers if of(a, SIZES) and a["runs"] == 12 and not a["law"]]
    half = [a for a in answers if of(a, SIZES) and a["runs"] == 6]
    nothing = [a for a in answers if not a["hidden"] and a["runs"] == 12]
    outside = [a for a in answers if of(a, OUTSIDE) and a["runs"] == 12]
    met = [h for a in single for h in hits(a)]
    alone = [h for h in met if h["alone"] and not h["shape"]]

    def line(what, part, whole):
        print(f"{what:48}{sum(part):4} of {len(whole):3} ({100 * sum(part) / max(len(whole), 1):.0f} %)")

    print()
    line("truth first or in a set of at most three", [right(a) for a in single], single)
    line("  contact_load left out", [right(a) for a in single if not of(a, ["contact_load"])], others(single))
    line("truth first", [any(s[0] in a["hidden"] for s in sets(a)) for a in single], single)
    line("wrong name", [wrong(a) for a in single], single)
    line("no effect hidden: a false name", [bool(sets(a)) for a in nothing], nothing)
    line("no effect hidden: no_effect", [a["verdict"] == "no_effect" for a in nothing], nothing)
    line("outside the catalogue: unknown", [a["verdict"] == "unknown_effect" for a in outside], outside)
    line("outside the catalogue: given a name", [bool(sets(a)) for a in outside], outside)
    for runs in (12, 24):
        pairs = [a for a in answers if len(a["hidden"]) == 2 and a["runs"] == runs]
        line(f"pairs, {runs} runs: both found", [both(a) for a in pairs], pairs)
        line(f"pairs, {runs} runs: a wrong name", [wrong(a) for a in pairs], pairs)
    line("half size, 6 runs: truth first or in a set", [right(a) for a in half], half)
    line("half size, 6 runs: wrong name", [wrong(a) for a in half], half)
    for runs in FEW:
        few = [a for a in answers if a["runs"] == runs]
        one = [a for a in few if of(a, SIZES)]
        line(f"{runs} runs: truth first or in a set", [right(a) for a in one], one)
        line(f"{runs} runs: a wrong cause (one, none, outside)", [wrong_cause(a) for a in few], few)
    for law in get_args(DryingLaw):
        other = [a for a in answers if a["law"] == law]
        line(f"moisture, {law}: named or in a set", [right(a) for a in other], other)
        line(f"moisture, {law}: a name that is not there", [wrong(a) for a in other], other)
    line("suspected alone: the truth", [suspected(a) and not right(a) for a in single], single)
    line("nothing hidden, smallest p at most 0.05", [least_p(a) <= 0.05 for a in nothing], nothing)
    line("parameter inside its interval", [h["inside"] for h in met], met)
    line("size within 35 %, where the set is one", [h["near"] for h in alone], alone)
    for name in MUST_HALVE:
        named = [a for a in single if a["hidden"] == [name] and right(a)]
        line(f"unseen core halved: {name}", [halved(a) for a in named], named)
    named = [a for a in single if right(a) and moved(a)]
    line(
        "unseen faces fall (named, not sensors)", [fell(a) for a in named if moved(a)], list(filter(moved, named))
    )
    print(f"{'seconds a campaign of 12 runs, median':48}{np.median([a['seconds'] for a in single]):.1f}")
    print(f"\n{'hidden':50}{'runs':5}{'verdict and sets':62}core on unseen runs")
    rows = Counter()
    for a in answers:
        named = "; ".join("/".join(s) for s in sets(a))
        core = " -> ".join(f"{x:.2f}" for x in a["unseen_core_K"])
        rows[(" + ".join(a["hidden"]) or "nothing", a["runs"], f"{a['verdict']} {named}", core)] += 1
    for (hidden, runs, names, core), count in sorted(rows.items()):
        print(f"{hidden:50}{runs:<5}{names:62}{core} K{f'  x{count}' if count > 1 else ''}")


def hits(a):
    """Return whether each true parameter of a named cause was met; sizes count from where the effect is absent."""
    found = []
    for e in a["effects"]:
        for p in find_effect(e["name"]).parameters:
            truth = a["truth"].get(e["name"], {}).get(p.name)
            if truth is None:
                continue
            parameter = e["parameters"][p.name]
            near = abs(parameter["value"] - truth) <= 0.35 * abs(truth - p.neutral)
            inside = parameter["ci95"][0] <= truth <= parameter["ci95"][1]
            found.append({"inside": inside, "near": near, "alone": len(e["set"]) == 1, "shape": is_shape(p)})
    return found


def of(a, names):
    return len(a["hidden"]) == 1 and a["hidden"][0] in names


def others(answers):
    return [a for a in answers if not of(a, ["contact_load"])]


def sets(a):
    return [e["set"] for e in a["effects"]]


def suspected(a):
    return any(set(e["set"]) & set(a["hidden"]) for e in a["suspected"])


def least_p(a):
    return min(c["p_value"] for c in a["candidates"])


def right(a):
    return any(a["hidden"][0] in s and len(s) <= 3 for s in sets(a))


def wrong(a):
    return any(not set(s) & set(a["hidden"]) for s in sets(a))


def wrong_cause(a):
    """A loose sensor in one of two runs is one in half of them, and there are such in every campaign."""
    return any(not set(s) & {*a["hidden"], "sensor_fault"} for s in sets(a))


def both(a):
    return all(any(name in s for s in sets(a)) for name in a["hidden"])


def halved(a):
    return a["unseen_core_K"][1] <= 0.5 * a["unseen_core_K"][0]


def moved(a):
    return a["unseen_faces_K"][0] != a["unseen_faces_K"][1]


def fell(a):
    return a["unseen_faces_K"][1] < a["unseen_faces_K"][0]
