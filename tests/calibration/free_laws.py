"""What a free law is worth: ``python -m tests.calibration.free_laws CAMPAIGNS [CASE ...]``.

Campaigns of eight pressings on the virtual press, on seeds from 24,200: nothing hidden, and laws of which it
computes each by its own equations. Printed for each case: in how many campaigns a law is claimed; the kind right,
alone or in a set of two; what the faces of runs left out gain, their own contacts refitted (mean); and, where the
true curve can be written down and the kind is right, the share of the curve in its 95 % band over the range
visited and how far it is off (root mean square over the true curve's range; medians).
"""

import sys
from typing import NamedTuple

import numpy as np

from daq.press.press_file import parse_press
from daq.simulated.campaign import make_campaign, press_toml
from daq.simulated.physics_kernel import STEP_K
from daq.simulated.physics_mesh import INNER_WIDTH
from softsensor.diagnosis.laws.choice import free_law
from softsensor.diagnosis.settling import settle_base
from softsensor.diagnosis.verdict import _screened
from softsensor.heat.model import ThermalModel
from tests.softsensor.test_free_law import EASED, THIN

FIRST, RUNS = 24_200, 8


def lapsed(truth, x):
    """Return the factor on the upper contact, broken off and back at once, against the lower one."""
    o, time = truth.pressing.outside, truth.pressing.closed + x
    return np.where((time >= o.lapse_from) & (time < o.lapse_to), 1.0 - o.lapse_drop, 1.0)


def grown(truth, x):
    """Return the factor on both contacts, 1 at the latest time."""
    p = truth.effects["contact_buildup"]
    factor = 1.0 - p["deficit"] * np.exp(-x / p["time_constant_s"])
    return factor / factor[-1]


def lost(truth, x):
    """Return the loss to the room, the same at every depth. [W/m³K]"""
    return np.full(len(x), truth.effects["edge_loss"]["W_m3K"])


def inside(truth, x):
    """Return the heat released about the middle. [kW/m³]"""
    return truth.effects["inner_source"]["kW_m3"] * np.exp(-0.5 * ((x - 0.5) / INNER_WIDTH) ** 2)


def levelled_off(truth, x):
    """Return the factor on both contacts by pressure, 1 at the reference."""
    share = truth.effects["contact_levelling"]["share"]
    return (1.0 - np.exp(-x / share)) / (1.0 - np.exp(-1.0 / share))


def stepped(effect):
    """Return the factor by temperature of a law that steps, and that on a contact 1 at the hottest seen."""

    def curve(truth, x):
        p = truth.effects[effect]
        factor = 1.0 - p["lost"] / (1.0 + np.exp(-(x - p["temperature_C"]) / STEP_K))
        return factor / factor[-1] if effect == "contact_break" else factor

    return curve


CASES = {
    "nothing": (None, (), None),
    "conductivity_step": ("conductivity_step", ("conductivity",), stepped("conductivity_step")),
    "contact_break": ("contact_break", ("contact_by_temperature",), stepped("contact_break")),
    "contact_levelling": ("contact_levelling", ("contact_by_load",), levelled_off),
    "contact_lapse": ("contact_lapse", ("contact_upper",), lapsed),
    "contact_buildup": ("contact_buildup", ("contact",), grown),
    "edge_loss": ("edge_loss", ("heat_exchange",), lost),
    "inner_source": ("inner_source", ("source_by_depth",), inside),
    "moisture_evaporation": ("moisture_evaporation", ("heat",), None),
}
"""What is hidden, the right kinds, and the true curve of a truth over x."""
EASED_CASES = ("contact_levelling", "nothing")
"""Cases in which the press eases off within each pressing and says when it opens."""


class Answer(NamedTuple):
    """Of one campaign."""

    set: tuple[str, ...] = ()
    inside: float = np.nan
    off: float = np.nan
    gain: float = 0.0
    """[K]"""


def settled(seed, hidden):
    """Return a campaign's plain model, fitted, and the truth of its first run."""
    eased = (hidden or "nothing") in EASED_CASES
    press = parse_press(press_toml(loaded=eased))
    campaign = make_campaign(seed, RUNS, hidden, EASED if eased else THIN)
    _, digests = _screened(press, [run for run, _ in campaign])
    return settle_base(ThermalModel(press), digests), campaign[0][1]


def answered(stage, truth, right, curve):
    """Return what a campaign's runs tell."""
    law = free_law(stage)
    if law is None:
        return Answer()
    if curve is None or law.kind not in right:
        return Answer(law.set, gain=law.gain.value_K)
    x, value, low, high = law.curve.T
    true = curve(truth, x)
    off = np.sqrt(np.mean((value - true) ** 2)) / (np.ptp(true) or np.mean(np.abs(true)))
    return Answer(law.set, float(np.mean((true >= low) & (true <= high))), float(off), law.gain.value_K)


def line_of(name, answers, right):
    """Return a case in a line."""
    claimed = [a for a in answers if a.set]
    sure = sum(len(a.set) <= 2 and not set(right).isdisjoint(a.set) for a in claimed)
    line = f"{name}: a law in {len(claimed)} of {len(answers)}"
    if not claimed:
        return line
    line += f", the right one alone or in two {sure}, gain {np.mean([a.gain for a in claimed]):.2f} K"
    known = [(a.inside, a.off) for a in claimed if np.isfinite(a.inside)]
    if not known:
        return line
    inside, off = 100.0 * np.median(known, axis=0)
    return f"{line}; {inside:.0f} % of the curve in its band, off by {off:.0f} % of its range"


def main():
    """Print a line a case, and one a campaign as it is done."""
    campaigns, names = int(sys.argv[1]), sys.argv[2:] or list(CASES)
    for name in names:
        hidden, right, curve = CASES[name]
        answers = []
        for seed in range(FIRST, FIRST + campaigns):
            answers.append(found := answered(*settled(seed, hidden), right, curve))
            figures = f"{100 * found.inside:.0f} % in its band, off by {100 * found.off:.0f} %, {found.gain:.2f} K"
            print(f"  {name} {seed}: {', '.join(found.set) or '-'}, {figures}", flush=True)
        print(line_of(name, answers, right), flush=True)


if __name__ == "__main__":
    main()
