"""One self-contained page about a campaign's coefficients: what they are, what is known, what to measure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, select_autoescape

from softsensor.campaign import CampaignFit
from softsensor.figures import (
    coefficients_figure,
    correlation_figure,
    normalised_figure,
    plain,
    roughness_figure,
    run_figure,
    svg,
)
from softsensor.fit_result import RunFit
from softsensor.paper import Reproduction

TEMPLATE = "fit_report.html"
STEPS = {"platen_temperature_C": 10.0, "pressure_N_cm2": 10.0, "press_time_s": 10.0}
"""Steps of the settings for which the page gives a change."""


def fit_report(campaign: CampaignFit) -> str:
    """Return the page as HTML text; it needs no other file."""
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
        normalised_svg=svg(normalised_figure(campaign)) if len(campaign.runs) > 1 else "",
        run_figures=[(title, svg(run_figure(f))) for title, f in shown],
        correlation_svg=svg(correlation_figure(shown[0][1])),
        dependence=list(_dependence(campaign)),
    )


def finding(campaign: CampaignFit) -> str:
    """Say in one sentence what the campaign found."""
    rmse = np.array([f.rmse_K for f in campaign.runs])
    first = np.array([f.initial_rmse_K for f in campaign.runs])
    names = list(campaign.coefficients)
    known = [n for n in names if campaign.coefficients[n].runs >= max(1, 0.9 * len(campaign.runs))]
    rest = [n for n in names if n not in known]
    runs = "one run" if len(campaign.runs) == 1 else f"{len(campaign.runs)} runs"
    text = (
        f"Fitted to {runs}, the simulation meets the sensors to {np.median(rmse):.2f} K (median; "
        f"{np.median(first):.1f} K at the press file's guesses). "
    )
    text += f"Known from these runs: {', '.join(known) or 'none of the coefficients'}."
    return text + (f" Not from every run: {', '.join(rest)}." if rest else "")


def _typical_and_worst(campaign: CampaignFit) -> list[tuple[str, RunFit]]:
    ordered = sorted(campaign.runs, key=lambda f: f.rmse_K)
    typical = ordered[len(ordered) // 2]
    shown = [("A typical run", typical)]
    if ordered[-1] is not typical:
        shown.append(("The run met worst", ordered[-1]))
    return shown


def _rows(campaign: CampaignFit) -> Iterator[dict[str, Any]]:
    for name, c in campaign.coefficients.items():
        yield {
            "name": name,
            "mean": plain(c.mean, 4),
            "sd": plain(c.sd, 2) if np.isfinite(c.sd) else "–",
            "ci": f"{plain(c.ci95[0], 4)} – {plain(c.ci95[1], 4)}",
            "bootstrap": f"{plain(c.bootstrap95[0], 4)} – {plain(c.bootstrap95[1], 4)}",
            "runs": f"{c.runs} of {len(campaign.runs)}",
            "median": plain(c.median, 4),
            "spread": f"{100 * c.spread:.0f} %",
        }


def _run_row(f: RunFit) -> dict[str, Any]:
    cells = []
    for c in f.coefficients.values():
        if c.verdict == "fixed":
            continue
        half = 50.0 * (c.ci95[1] - c.ci95[0]) / c.value if c.value else float("nan")
        text = f"{plain(c.value, 4)} ± {half:.0f} %"
        if not c.identifiable:
            text = f"{plain(c.ci95[0], 3)} – {plain(c.ci95[1], 3)}"
        cells.append({"text": text, "known": c.identifiable, "why": c.reason})
    return {
        "run": f.run,
        "cells": cells,
        "rmse": f"{f.rmse_K:.2f}",
        "first": f"{f.initial_rmse_K:.1f}",
        "converged": f.converged,
    }


def _unknown(campaign: CampaignFit) -> list[dict[str, str]]:
    """By coefficient: in how many runs it is not identifiable, and the reason given most often."""
    found = []
    for name in campaign.coefficients:
        reasons = [f.coefficients[name].reason for f in campaign.runs if not f.coefficients[name].identifiable]
        reasons = [r for r in reasons if r]
        if reasons:
            common = Counter(reasons).most_common(1)[0][0]
            found.append({"name": name, "count": f"{len(reasons)} of {len(campaign.runs)}", "reason": common})
    return found


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
