"""One self-contained page about a campaign's coefficients: what they are, what is known, what to measure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, select_autoescape

from softsensor.campaign import CampaignFit
from softsensor.dependence import Program
from softsensor.figures import (
    coefficients_figure,
    normalised_figure,
    roughness_figure,
    run_figure,
    strongest,
    svg,
)
from softsensor.fit_result import RunFit
from softsensor.paper import Reproduction
from softsensor.parameters import plain
from softsensor.report_runs import details_of

TEMPLATE = "fit_report.html"
METHOD_WORDS = {
    "least_squares": "gradient least squares",
    "nelder_mead": "Nelder-Mead",
    "nelder_mead_then_least_squares": "Nelder-Mead followed by weighted least squares",
}
"""The paper's procedures as a page names them."""
STEPS = {"platen_temperature_C": 10.0, "pressure_N_cm2": 10.0, "press_time_s": 10.0}
"""Steps of the settings for which the page gives a change."""


def fit_report(campaign: CampaignFit, program: Program | None = None) -> str:
    """Return the page as HTML text; it needs no other file.

    Parameters
    ----------
    program
        A press program never run, whose predicted coefficients the page shows too.
    """
    pages = Environment(
        loader=PackageLoader("softsensor", "templates"), autoescape=select_autoescape(), trim_blocks=True
    )
    shown = _typical_and_worst(campaign)
    return pages.get_template(TEMPLATE).render(
        press=campaign.press.name,
        finding=finding(campaign),
        coefficients=list(_rows(campaign)),
        runs=[_run_row(f) for f in campaign.runs],
        names=list(campaign.coefficients),
        unknown=_unknown(campaign),
        warnings=[(f.run, w) for f in campaign.runs for w in f.warnings if not _is_verdict(f, w)],
        coefficients_svg=svg(coefficients_figure(campaign)),
        normalised_svg=svg(normalised_figure(campaign)) if len(campaign.met) > 1 else "",
        run_figures=[(title, svg(run_figure(f))) for title, f in shown],
        together=together(shown[0][1]),
        dependence=list(_dependence(campaign)),
        program=_program(program),
        details=[details_of(f, shapes) for f, shapes in zip(campaign.runs, campaign.profiles, strict=True)],
        joint=list(_joint(campaign)),
        shared=", ".join(campaign.shared),
        priors=[f"{n}: {p.median:g} W/m²K, times or over {p.factor:g}" for n, p in campaign.press.priors.items()],
        method=METHOD_WORDS.get(campaign.method.partition(":")[0], ""),
        averages=campaign.method.endswith(":averages"),
    )


def finding(campaign: CampaignFit) -> str:
    """Say in a few words what the campaign found; first of all which runs the model does not describe."""
    met = campaign.met
    if not met:
        return campaign.shortfall
    rmse = np.array([f.rmse_K for f in met])
    first = np.array([f.initial_rmse_K for f in met])
    names = list(campaign.coefficients)
    known = [n for n in names if campaign.coefficients[n].runs >= max(1, 0.9 * len(met))]
    rest = [n for n in names if n not in known]
    runs = "one run" if len(met) == 1 else f"{len(met)} runs"
    text = f"{campaign.shortfall} " if campaign.shortfall else ""
    text += (
        f"Fitted to {runs}, the simulation meets the sensors to {np.median(rmse):.2f} K "
        f"({'' if len(rmse) == 1 else 'median; '}{np.median(first):.1f} K at the press file's guesses). "
    )
    if len(rmse) == 1:
        text += f"Known from it: {', '.join(known) or 'none of the coefficients'}."
        return text + (f" Not known: {', '.join(rest)}." if rest else "")
    text += f"Known from these runs: {', '.join(known) or 'none of the coefficients'}."
    return text + (f" Not from every run: {', '.join(rest)}." if rest else "")


def _typical_and_worst(campaign: CampaignFit) -> list[tuple[str, RunFit]]:
    ordered = sorted(campaign.met, key=lambda f: f.rmse_K)
    left = sorted((f for f in campaign.runs if not f.met), key=lambda f: -f.rmse_K)
    shown = []
    if ordered:
        typical = ordered[len(ordered) // 2]
        shown.append(("A typical run" if len(campaign.runs) > 1 else "The run", typical))
        if ordered[-1] is not typical:
            shown.append(("The run met worst", ordered[-1]))
    if left:
        told = "The run that the model does not describe"
        shown.append(
            (told if len(left) == 1 else "The worst of the runs that the model does not describe", left[0])
        )
    return shown


def _rows(campaign: CampaignFit) -> Iterator[dict[str, Any]]:
    for name, c in campaign.coefficients.items():
        yield {
            "name": name,
            "mean": plain(c.mean, 4) if c.runs else "–",
            "sd": plain(c.sd, 2) if np.isfinite(c.sd) and name not in campaign.shared else "–",
            "ci": _span(c.ci95) if c.runs else "–",
            "bootstrap": _span(c.bootstrap95) if c.runs else "–",
            "runs": f"{c.runs} of {len(campaign.runs)}",
            "median": plain(c.median, 4),
            "median_ci": _span(c.median_ci95),
            "spread": "shared" if name in campaign.shared else f"{100 * c.spread:.0f} %",
        }


def _span(ends: tuple[float, float]) -> str:
    return f"{plain(ends[0], 4)} – {plain(ends[1], 4)}"


def _joint(campaign: CampaignFit) -> Iterator[dict[str, Any]]:
    """By run: every coefficient with what it borrows, marked where it is much better known than alone."""
    for f in campaign.met:
        cells = []
        for name, (e, (low, high)) in campaign.joint(f.run).items():
            alone = f.coefficients[name]
            better = alone.ci95[1] / alone.ci95[0] > (high / low) ** 1.5
            text = f"{plain(e.value, 4)} ± {50.0 * (high - low) / e.value:.0f} %"
            sure = better or not alone.identifiable
            cells.append({"text": text, "sure": sure and name not in campaign.shared})
        yield {"run": f.run, "cells": cells}


def _program(program: Program | None) -> dict[str, Any] | None:
    if program is None:
        return None
    rows = [
        {"name": n, "value": plain(e.value, 4), "ci": _span(program.interval(n))}
        for n, e in program.coefficients.items()
    ]
    return {"title": program.lines[0].removesuffix(":"), "rows": rows, "remarks": program.remarks}


def _run_row(f: RunFit) -> dict[str, Any]:
    cells = []
    for c in f.coefficients.values():
        if c.verdict == "fixed":
            continue
        half = 50.0 * (c.ci95[1] - c.ci95[0]) / c.value if c.value else float("nan")
        text = f"{plain(c.value, 4)} ± {half:.0f} %"
        if not c.identifiable:
            text = f"{plain(c.ci95[0], 3)} – {plain(c.ci95[1], 3)}" if f.met else "–"
        cells.append({"text": text, "known": c.identifiable, "why": c.reason})
    return {
        "run": f.run,
        "cells": cells,
        "rmse": f"{f.rmse_K:.2f}",
        "first": f"{f.initial_rmse_K:.1f}",
        "remark": ", ".join(["not described"] * (not f.met) + ["not converged"] * (not f.converged)),
    }


def _unknown(campaign: CampaignFit) -> list[dict[str, str]]:
    """By coefficient: in how many runs it is not identifiable, and the reason given most often."""
    found = []
    for name in campaign.coefficients:
        reasons = [f.coefficients[name].reason for f in campaign.met if not f.coefficients[name].identifiable]
        reasons = [r for r in reasons if r]
        if reasons:
            common = Counter(reasons).most_common(1)[0][0]
            found.append({"name": name, "count": f"{len(reasons)} of {len(campaign.met)}", "reason": common})
    return found


def together(fitted: RunFit) -> str:
    """Say which coefficient moves most with another unknown in a run."""
    i, j, value = strongest(fitted)
    return f"In {fitted.run} {fitted.names[i]} moves most with {fitted.names[j]} (correlation {value:+.2f})."


def _is_verdict(fitted: RunFit, warning: str) -> bool:
    return any(warning.startswith(f"{name} is ") for name in fitted.coefficients)


def _dependence(campaign: CampaignFit) -> Iterator[dict[str, Any]]:
    if campaign.dependence is None:
        return
    content = campaign.dependence.as_json()["coefficients"]
    for name, table in content.items():
        cells = []
        for setting, step in STEPS.items():
            if setting not in table:
                cells.append({"text": "not varied", "sure": False})
                continue
            slope, (low, high) = table[setting]["log_slope"], table[setting]["ci95"]
            percent = [100.0 * (np.exp(step * v) - 1.0) for v in (slope, low, high)]
            sure = low * high > 0
            text = f"{percent[0]:+.1f} % ({percent[1]:+.1f} … {percent[2]:+.1f})"
            cells.append({"text": text, "sure": sure})
        yield {"name": name, "cells": cells}


def paper_report(found: Reproduction) -> str:
    """Return a page with the paper's table reproduced and the cost that explains it."""
    pages = Environment(loader=PackageLoader("softsensor", "templates"), autoescape=select_autoescape())
    return pages.get_template("paper_report.html").render(
        rows=[
            {
                "solver": c.solver,
                "slopes": c.slopes,
                "converged": f"{c.converged} of {c.runs}",
                "seconds": f"{c.seconds:.2f}",
                "solves": f"{c.evaluations:.0f}",
                "error": f"{100 * (np.exp(c.error) - 1):.1f} %",
            }
            for c in found.table
        ],
        last=found.lines[-1],
        figure=svg(roughness_figure(found)),
    )
