"""One self-contained page about a campaign's coefficients: what they are, what is known, what to measure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from daq.words import Message, say
from daq.words.message import ENGLISH
from softsensor.fitting.campaign import CampaignFit
from softsensor.fitting.core import fitted_core
from softsensor.fitting.dependence import SETTINGS, Program
from softsensor.fitting.identifiability import is_verdict_on
from softsensor.fitting.paper.procedures import METHODS, SolverComparison
from softsensor.fitting.result import Identifiability, RunFit, rounded
from softsensor.report.fit_figures import (
    coefficients_figure,
    core_figure,
    fitted_run_figure,
    known_names,
    moves_with,
    normalised_figure,
    roughness_figure,
    scattered,
    svg,
)
from softsensor.report.fit_report_runs import details_of
from softsensor.report.page import page

STEPS = {"platen_temperature_C": 10.0, "pressure_N_cm2": 10.0, "press_time_s": 10.0}
"""Steps of the settings for which the page gives a change."""
RESAMPLED_RUNS = 4
"""From so many runs on a bootstrap's 95 % interval is given: of three, the lowest value drawn three times is
already 1 in 27 of all draws, more than the 2.5 % below an end, and the interval would be their range."""


def fit_report(campaign: CampaignFit, program: Program | None = None, language: str = ENGLISH) -> str:
    """Return the page as HTML text; it needs no other file.

    Parameters
    ----------
    program
        A press program never run, whose predicted coefficients the page shows too.
    language
        Of its words.
    """
    shown = _typical_and_worst(campaign)
    method = campaign.method.partition(":")[0]
    return page(
        "fit_report.html",
        language,
        press=campaign.press.name,
        finding=finding(campaign),
        coefficients=list(_rows(campaign)),
        resampled=any(c.runs >= RESAMPLED_RUNS for c in campaign.coefficients.values()),
        runs=[_run_row(f) for f in campaign.runs],
        names=list(campaign.coefficients),
        unknown=_unknown(campaign),
        warnings=[(f.run, w) for f in campaign.runs for w in f.warnings if not is_verdict_on(w, f.coefficients)],
        coefficients_svg=svg(coefficients_figure(campaign, language)),
        normalised_svg=svg(normalised_figure(campaign, language)) if scattered(campaign) else "",
        run_figures=[(title, svg(fitted_run_figure(f, language)), _core_svg(f, language)) for title, f in shown],
        together_most=moves_with(shown[0][1]),
        dependence=list(_dependence(campaign)),
        program=_program(program),
        details=[details_of(f, shapes) for f, shapes in zip(campaign.runs, campaign.profiles, strict=True)],
        joint=list(_joint(campaign)),
        shared=campaign.shared,
        priors=[
            say("report-prior", name=n, median=p.median, factor=p.factor) for n, p in campaign.press.priors.items()
        ],
        method=Message(f"report-method-{method}") if method in METHODS else None,
        averages=campaign.method.endswith(":averages"),
    )


def finding(campaign: CampaignFit) -> tuple[Message | str, ...]:
    """Say in a few sentences what the campaign found; first of all which runs the model does not describe."""
    met, total = campaign.met, len(campaign.coefficients)
    shortfall = (campaign.shortfall,) if campaign.shortfall else ()
    if not met:
        return shortfall
    fit, guesses = (float(np.median([getattr(f, key) for f in met])) for key in ("rmse_K", "initial_rmse_K"))
    names = tuple(n for n, c in campaign.coefficients.items() if c.runs >= max(1, 0.9 * len(met)))
    rest = tuple(n for n in campaign.coefficients if n not in names)
    known = say("list-of-names", names=names) if names else known_names(names, total)
    counts = [
        say("report-fitted", runs=len(met), fit=fit, guesses=guesses),
        say("report-known", runs=len(met), known=known),
    ]
    return (*shortfall, *counts, *([say("report-not-known", runs=len(met), names=rest)] if rest else []))


def _core_svg(fitted: RunFit, language: str) -> str:
    core = fitted_core(fitted)
    return "" if core is None else svg(core_figure(fitted, core, language))


def _typical_and_worst(campaign: CampaignFit) -> list[tuple[Message, RunFit]]:
    ordered = sorted(campaign.met, key=lambda f: f.rmse_still_K)
    left = sorted((f for f in campaign.runs if not f.met), key=lambda f: -f.rmse_still_K)
    shown = []
    if ordered:
        typical = ordered[len(ordered) // 2]
        shown.append((say("report-typical-run", runs=len(campaign.runs)), typical))
        if ordered[-1] is not typical:
            shown.append((say("report-worst-run"), ordered[-1]))
    if left:
        shown.append((say("report-run-not-described", runs=len(left)), left[0]))
    return shown


def _rows(campaign: CampaignFit) -> Iterator[dict[str, Any]]:
    for name, c in campaign.coefficients.items():
        yield {
            "name": name,
            "mean": _known(c.mean, c.ci95) if c.runs else "–",
            "sd": say("report-number-2", value=c.sd) if np.isfinite(c.sd) and name not in campaign.shared else "–",
            "ci": _span(c.ci95) if c.runs else "–",
            "bootstrap": _span(c.bootstrap95) if c.runs >= RESAMPLED_RUNS else "–",
            "runs": say("report-count-of", count=c.runs, total=len(campaign.runs)),
            "median": _known(c.median, c.median_ci95),
            "median_ci": _span(c.median_ci95),
            "spread": say("report-shared") if name in campaign.shared else f"{100 * c.spread:.0f} %",
        }


def _span(ends: tuple[float, float]) -> Message:
    low, high = (rounded(end, ends) for end in ends)
    return say("report-span", low=low, high=high)


def _known(value: float, ends: tuple[float, float]) -> Message:
    return say("report-number", value=rounded(value, ends))


def _joint(campaign: CampaignFit) -> Iterator[dict[str, Any]]:
    """By run: every coefficient with what it borrows, marked where it is much better known than alone."""
    for f in campaign.met:
        cells = []
        for name, (e, (low, high)) in campaign.joint(f.run).items():
            alone = f.coefficients[name]
            better = alone.ci95[1] / alone.ci95[0] > (high / low) ** 1.5
            text = say("report-known-to", value=e.value, percent=50.0 * (high - low) / e.value)
            sure = better or not alone.identifiable
            cells.append({"text": text, "sure": sure and name not in campaign.shared})
        yield {"run": f.run, "cells": cells}


def _program(program: Program | None) -> dict[str, Any] | None:
    if program is None:
        return None
    rows = [
        {"name": n, "value": say("report-number", value=e.value), "ci": _span(program.intervals[n])}
        for n, e in program.coefficients.items()
    ]
    settings = tuple(
        say("report-setting", name=k, value=v, unit=SETTINGS[k][0]) for k, v in program.settings.items()
    )
    return {"title": say("report-program-of", settings=settings), "rows": rows, "remarks": program.remarks}


def _run_row(f: RunFit) -> dict[str, Any]:
    cells = []
    for c in f.coefficients.values():
        if c.verdict is Identifiability.FIXED:
            continue
        half = 50.0 * (c.ci95[1] - c.ci95[0]) / c.value if c.value else float("nan")
        text: Message | str = say("report-known-to", value=c.value, percent=half)
        if not c.identifiable:
            text = say("report-span-3", low=c.ci95[0], high=c.ci95[1]) if f.met else "–"
        cells.append({"text": text, "known": c.identifiable, "why": c.reason or ""})
    return {
        "run": f.run,
        "cells": cells,
        "rmse": say("report-hundredths", value=f.rmse_K),
        "first": say("report-tenths", value=f.initial_rmse_K),
        "remarks": [say("report-not-described")] * (not f.met) + [say("report-not-converged")] * (not f.converged),
    }


def _unknown(campaign: CampaignFit) -> list[dict[str, Any]]:
    """By coefficient: in how many runs it is not identifiable, and the reason given most often."""
    found = []
    for name in campaign.coefficients:
        reasons = [f.coefficients[name].reason for f in campaign.met if not f.coefficients[name].identifiable]
        reasons = [r for r in reasons if r]
        if reasons:
            common = Counter(reasons).most_common(1)[0][0]
            count = say("report-count-of", count=len(reasons), total=len(campaign.met))
            found.append({"name": name, "count": count, "reason": common})
    return found


def _dependence(campaign: CampaignFit) -> Iterator[dict[str, Any]]:
    if campaign.dependence is None:
        return
    content = campaign.dependence.as_json()["coefficients"]
    for name, table in content.items():
        cells = []
        for setting, step in STEPS.items():
            if setting not in table:
                cells.append({"text": say("report-not-varied"), "sure": False})
                continue
            slope, (low, high) = table[setting]["log_slope"], table[setting]["ci95"]
            percent = [100.0 * (np.exp(step * v) - 1.0) for v in (slope, low, high)]
            sure = low * high > 0
            text = say("report-slope", percent=percent[0], low=percent[1], high=percent[2])
            cells.append({"text": text, "sure": sure})
        yield {"name": name, "cells": cells}


def paper_report(found: SolverComparison, language: str = ENGLISH) -> str:
    """Return a page with the paper's table reproduced and the cost that explains it."""
    return page(
        "paper_report.html",
        language,
        rows=[list(row.values()) for row in found.rows],
        last=found.message,
        figure=svg(roughness_figure(found, language)),
    )
