"""Two hundred pressings timed by a fixed press time and by Kerntemp: undercured, overcured, time and energy.

    python deploy/examples/when_to_open/pressings.py [--pressings 200] [--hide EFFECT] [--figure opening.png]
        [--first 7100]

The virtual press is the truth: it integrates heat and cure by its own equations on its own mesh. From pressing to
pressing its contacts scatter by 12 %, conductivity, heat capacity and the paper's rate by 5 %, its activation
energy by 3 %, platens read off by 1 K (standard deviations), and their set point is one of 180 to 210 °C. Kerntemp
is given the mean of all and how far it scatters, sees what 16 thermocouples read at 2 Hz, and must keep a cure
of 85 % at both faces with 97.5 %. What is hidden (`--hide`) nobody tells it.

The fixed press time is the shortest that leaves no more of these panels undercured than Kerntemp did: found
afterwards, from the truth, as nobody at a press could.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.stats import binomtest

from daq.press.press_file import parse_press
from daq.press.resin_file import Resin, parse_resin
from daq.records import Array, Run
from daq.simulated.campaign import Plan, Truth, make_campaign, press_toml
from daq.simulated.campaign_sensors import Nuisances
from daq.simulated.curing import Paper, cured, draw_paper
from daq.simulated.physics import SolvedPressing, solve
from daq.simulated.physics_pressing import BASE_COEFFICIENTS
from softsensor.heat.model_file import FittedValue, MissingCauses, ModelFile
from softsensor.live.replay import replay
from softsensor.live.sensor import Estimate
from softsensor.signals.unknown import BAND

SEED = 7100
CONTACT_SD, RATE_SD, ENERGY_SD, CONSTANT_SD, PLATEN_K = 0.12, 0.05, 0.03, 0.05, 1.0
"""What is drawn for every pressing: contacts, the paper's rate at 140 °C, its activation energy, conductivity and
heat capacity (relative), and what each platen reads wrong. [K]"""
PRESS = parse_press(press_toml())
COEFFICIENTS = {name: FittedValue(value, CONTACT_SD * value) for name, value in BASE_COEFFICIENTS.items()}
MODEL = ModelFile("mean", "lab", COEFFICIENTS, missing=MissingCauses(8, 0.9, 0.0, {}))
PAPER = Paper()
LEAST, OVER = 0.85, 0.95
"""A face below the first is undercured; once both faces are beyond the other, the panel is overcured."""
PLAN = Plan(
    rate_hz=2.0, thickness_mm=16.0, start_before_s=6.0, closed_column=True, panel_spread=CONSTANT_SD,
    coefficient_spread=CONTACT_SD, press_time_s=(45.0, 60.0), open_before_s=(6.0, 12.0), open_after_s=(6.0, 8.0),
    nuisances=Nuisances(platen_offset_K=PLATEN_K),
)  # fmt: skip
FINE_S = 0.05
"""How finely what really happened is read. [s]"""


def resin(rate_sd: float = RATE_SD) -> Resin:
    """Return what Kerntemp is given of the paper: the mean, and how far papers scatter."""
    return parse_resin(
        f"""
        [resin]
        name = "virtual"
        source = "daq.simulated.curing"
        [order]
        reference_temperature_C = {PAPER.reference_C}
        rate_per_s = {PAPER.rate}
        rate_per_s.sd = {PAPER.rate * rate_sd}
        activation_energy_kJ_mol = {PAPER.activation / 1e3}
        activation_energy_kJ_mol.sd = {PAPER.activation / 1e3 * ENERGY_SD}
        [limits]
        cure_least = {LEAST}
        """
    )


def headed(run: Run) -> Run:
    """Return the run with the constants' means and scatter in its header, and the moisture."""
    constants = {
        "panel.conductivity_W_mK": 0.12,
        "panel.conductivity_W_mK.sd": 0.12 * CONSTANT_SD,
        "panel.heat_capacity_J_kgK": 1550.0,
        "panel.heat_capacity_J_kgK.sd": 1550.0 * CONSTANT_SD,
        "panel.moisture_percent": 8.0,
    }
    return replace(run, header=run.header | constants)


@dataclass(frozen=True)
class Pressed:
    """One pressing, as estimated and as it was; times in s after closing."""

    opened: float
    """When Kerntemp said "open now", NaN where it never did."""
    after: Array
    """Times (t)."""
    least: Array
    """Then the cure of the face that has cured less (t)."""
    heat_kWh: Array  # noqa: N815
    """Then the heat that the panel has taken up (t)."""
    knowing: float
    """When someone would open who knows every number but this paper's, which no thermometer shows."""
    inside: float
    """Share of scans and faces whose cure the band of 95 % holds."""
    half_width: float
    error: float
    """Root mean squares; of the logarithm of the equivalent time."""
    error_of_faces: float
    """What of the error is left where this paper is known: that of the faces' temperatures."""

    def cure(self, time: float) -> float:
        """Return the cure of the face that has cured less at a time."""
        return float(np.interp(time, self.after, self.least))

    def heat(self, time: float) -> float:
        """Return the heat taken up by a time. [kWh]"""
        return float(np.interp(time, self.after, self.heat_kWh))

    @property
    def oracle(self) -> float:
        """When someone would open who knows every number."""
        return float(self.after[np.argmax(self.least >= LEAST)])


def pressed(run: Run, truth: Truth, paper: Paper, stated: Resin) -> Pressed:
    """Return one pressing; `paper` is what really is on the panel, `stated` what Kerntemp knows of it."""
    estimates = replay(PRESS, headed(run), MODEL, resin=stated).estimates
    solved, closed, panel = solve(truth.pressing), truth.moments.closed_s, truth.pressing.panel
    after = np.arange(0.0, truth.moments.opened_s - closed, FINE_S)
    warmer = solved.at("panel_mean", closed + after) - panel.initial_temperature
    per_kelvin = panel.density * panel.heat_capacity * panel.thickness * PRESS.press.area_m2
    inside, widths, errors = _band(run, truth, estimates, cured(solved, paper, run.time_s))
    of_faces = _band(run, truth, estimates, cured(solved, PAPER, run.time_s))[2]
    return Pressed(
        opened=next((e.time_s - closed for e in estimates if e.open_now), np.nan),
        after=after,
        least=np.minimum(*cured(solved, paper, closed + after)),
        heat_kWh=per_kelvin * warmer / 3.6e6,
        knowing=float(after[np.argmax(_all_but_the_paper(solved, closed + after, stated) >= 0.0)]),
        inside=float(np.mean(inside)),
        half_width=float(np.sqrt(np.mean(np.square(widths)))),
        error=float(np.sqrt(np.mean(np.square(errors)))),
        error_of_faces=float(np.sqrt(np.mean(np.square(of_faces)))),
    )


def _all_but_the_paper(solved: SolvedPressing, times: Array, stated: Resin) -> Array:
    """Return by how much the lower bound of the equivalent time's logarithm passes what the limit takes (t)."""

    def log_time(paper: Paper) -> Array:
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(-np.log1p(-np.minimum(*cured(solved, paper, times)))))

    order = stated.order
    if order is None or order.rate_per_s is None:
        raise AssertionError("the paper's law is of n-th order")
    usual, by_energy = log_time(PAPER), log_time(replace(PAPER, activation=PAPER.activation * (1.0 + ENERGY_SD)))
    with np.errstate(invalid="ignore"):
        sd = np.hypot(order.spreads["rate_per_s"] / order.rate_per_s, by_energy - usual)
        return np.asarray(usual - BAND * sd - np.log(-np.log1p(-LEAST)))


def _band(
    run: Run, truth: Truth, estimates: Sequence[Estimate], faces: tuple[Array, Array]
) -> tuple[list[bool], list[float], list[float]]:
    """Return inside, half-width and error of the band by scan and face, while a face is not yet cured."""
    inside, widths, errors = [], [], []
    for k, estimate in enumerate(estimates):
        after = run.time_s[k] - truth.moments.closed_s
        if estimate.leave is None or estimate.leave.panel is None:
            continue
        if after <= 3.0 or run.time_s[k] >= truth.moments.opened_s:
            continue
        panel = estimate.leave.panel
        for face, true in ((panel.cure_bottom, faces[0][k]), (panel.cure_top, faces[1][k])):
            if true > 0.999:
                continue  # cured: its logarithm no longer tells anything
            x = (
                -np.log1p(-true) / PAPER.rate
            )  # the time the mean paper would have needed: of one kind with the band
            inside.append(bool(face.low <= np.log(x) <= face.high))
            widths.append(BAND * float(face.sd))
            errors.append(float(np.log(x) - face.mean))
    return inside, widths, errors


def campaign(
    count: int, hidden: str | None = None, rate_sd: float = RATE_SD, first: int = SEED
) -> Iterator[Pressed]:
    """Press so many panels; each has a press, a panel and a paper of its own."""
    stated = resin(rate_sd)
    for i in range(count):
        ((run, truth),) = make_campaign(first + i, 1, hidden, PLAN)
        paper = draw_paper(np.random.default_rng([first, 9, i]), rate_sd, ENERGY_SD, PAPER)
        yield pressed(run, truth, paper, stated)


@dataclass(frozen=True)
class Summary:
    """What pressings came to; times in s after closing."""

    found: Sequence[Pressed]

    @cached_property
    def opened(self) -> list[Pressed]:
        """Those for which Kerntemp said "open now"."""
        return [p for p in self.found if np.isfinite(p.opened)]

    @cached_property
    def undercured(self) -> int:
        """Panels that it let out before they were cured."""
        return sum(p.cure(p.opened) < LEAST for p in self.opened)

    @property
    def interval(self) -> tuple[float, float]:
        """Of the share of undercured panels, 95 %."""
        bounds = binomtest(self.undercured, len(self.opened)).proportion_ci()
        return float(bounds.low), float(bounds.high)

    @cached_property
    def fixed(self) -> float:
        """Shortest fixed press time that leaves no more panels undercured than Kerntemp did."""
        needed = np.sort([p.oracle for p in self.found])[::-1]
        return float(needed[self.undercured])

    def mean(self, of: Callable[[Pressed], float]) -> float:
        """Return the mean over the panels that Kerntemp let out."""
        return float(np.mean([of(p) for p in self.opened]))

    def rms(self, of: Callable[[Pressed], float]) -> float:
        """Return the root mean square over all pressings."""
        return float(np.sqrt(np.mean([of(p) ** 2 for p in self.found])))

    def lines(self) -> Iterator[str]:
        """Say it."""
        low, high = self.interval
        time, fixed = self.mean(lambda p: p.opened), self.fixed
        oracle, knowing = self.mean(lambda p: p.oracle), self.mean(lambda p: p.knowing)
        width, error = self.rms(lambda p: p.half_width), self.rms(lambda p: p.error)
        over = [np.mean([p.cure(t) > OVER for p in self.opened]) for t in (fixed,)]
        over.append(np.mean([p.cure(p.opened) > OVER for p in self.opened]))
        heat, less = self.mean(lambda p: p.heat(fixed)), self.mean(lambda p: p.heat(p.opened))
        inside = float(np.mean([p.inside for p in self.found]))
        yield f"{len(self.found)} pressings, leave to open in {len(self.opened)}"
        of_faces = self.rms(lambda p: p.error_of_faces)
        yield f"band of the cure covers {100 * inside:.1f} %, half-width {width / error:.2f} times its error"
        yield f"error of the equivalent time's logarithm {error:.3f}, with this paper known {of_faces:.3f}"
        yield f"undercured at opening: {self.undercured} ({100 * low:.1f} to {100 * high:.1f} %)"
        yield f"press time {time:.2f} s; fixed for as few {fixed:.2f} s: {100 * (1 - time / fixed):.0f} % shorter"
        yield f"overcured, beyond {100 * OVER:.0f} %: fixed {100 * over[0]:.0f} %, {100 * over[1]:.0f} %"
        yield f"heat a panel takes up: fixed {heat:.4f} kWh, {less:.4f} kWh, {100 * (1 - less / heat):.0f} % less"
        yield f"who knows every number: {oracle:.2f} s, {100 * (time / oracle - 1):.1f} % later than that"
        yield f"who knows all but the paper: {knowing:.2f} s, {100 * (knowing / oracle - 1):.1f} % later"


def draw(found: Summary) -> Figure:
    """Draw cure at opening and press times, fixed and by Kerntemp."""
    fixed = found.fixed
    ways = (
        (f"fixed press time, {fixed:.1f} s", "#888780", [fixed] * len(found.opened)),
        ("when Kerntemp says so", "#2a6f97", [p.opened for p in found.opened]),
    )
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    saved = 100.0 * (1.0 - found.mean(lambda p: p.opened) / fixed)
    heat = 100.0 * (1.0 - found.mean(lambda p: p.heat(p.opened)) / found.mean(lambda p: p.heat(fixed)))
    figure.suptitle(
        f"{len(found.opened)} pressings opened when Kerntemp says so: {saved:.0f} % shorter, "
        f"{heat:.0f} % less heat, {found.undercured} undercured"
    )
    for name, colour, times in ways:
        cure = [100.0 * p.cure(t) for p, t in zip(found.opened, times, strict=True)]
        left.hist(cure, np.arange(80.0, 100.5, 0.5), color=colour, alpha=0.75, label=name)
    left.axvline(100.0 * LEAST, color="#b3261e", lw=1.0)
    left.axvline(100.0 * OVER, color="#b3261e", lw=1.0, ls=":")
    top = left.get_ylim()[1]
    left.text(100.0 * LEAST - 0.3, 0.97 * top, "undercured", ha="right", va="top", color="#b3261e", fontsize=9)
    left.text(100.0 * OVER + 0.3, 0.97 * top, "overcured", va="top", color="#b3261e", fontsize=9)
    left.set(xlabel="cure of the less cured face at opening [%]", ylabel="panels", xlim=(80.0, 100.0))
    bins = np.arange(0.0, np.ceil(fixed) + 1.0, 0.5)
    right.hist(
        [p.oracle for p in found.opened], bins, color="#c9a227", alpha=0.6, label="needed, as the truth has it"
    )
    right.hist([p.opened for p in found.opened], bins, histtype="step", lw=1.8, color="#2a6f97", label=ways[1][0])
    right.axvline(fixed, color="#888780", lw=2.0, label=ways[0][0])
    right.set(xlabel="press time [s]", ylabel="panels", xlim=(0.0, bins[-1]))
    for ax in (left, right):
        ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    shown = {
        name: drawn for ax in (left, right) for drawn, name in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    figure.legend(shown.values(), shown, fontsize=9, frameon=False, loc="outside lower center", ncols=len(shown))
    return figure


def main() -> None:
    """Press, print what came out, and draw it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pressings", type=int, default=200)
    parser.add_argument("--first", type=int, default=SEED, help="seed of the first pressing")
    parser.add_argument("--hide", help="an effect of the contract that only the virtual press has")
    parser.add_argument("--rate-sd", type=float, default=RATE_SD, help="relative scatter of the paper's rate")
    parser.add_argument("--figure", type=Path, help="write the figure here, as SVG or PNG by its ending")
    asked = parser.parse_args()
    found = []
    for one in campaign(asked.pressings, asked.hide, asked.rate_sd, asked.first):
        found.append(one)
        sys.stderr.write(f"\r{len(found)} of {asked.pressings}")
    sys.stderr.write("\n")
    summary = Summary(found)
    sys.stdout.write("\n".join(summary.lines()) + "\n")
    if asked.figure is not None:
        draw(summary).savefig(asked.figure, dpi=150)


if __name__ == "__main__":
    main()
