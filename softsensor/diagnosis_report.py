"""One self-contained page: what is wrong, why, what it costs, what is gained, what to measure next."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from jinja2 import Environment, PackageLoader, select_autoescape

from softsensor.diagnosis import Diagnosis, Finding
from softsensor.diagnosis_figures import residual_figure, run_figure, votes_figure
from softsensor.diagnosis_words import (
    chance,
    core_sentence,
    sentence,
    sureness,
    temperatures,
    unsigned_zero,
    worth,
)
from softsensor.effects import find_effect
from softsensor.figures import svg
from softsensor.vocabulary import parameters_told, place_words, readable

TEMPLATE = "diagnosis_report.html"
TITLES = {
    "named": "Cause named",
    "ambiguous": "Cause narrowed down",
    "unknown_effect": "Something unknown",
    "no_effect": "No effect found",
    "too_few_runs": "Too few runs",
}


def diagnosis_report(found: Diagnosis) -> str:
    """Return the page as HTML text; it needs no other file."""
    pages = Environment(
        loader=PackageLoader("softsensor", "templates"), autoescape=select_autoescape(), trim_blocks=True
    )
    votes, runs = votes_figure(found), len(found.stages[0].data)
    return pages.get_template(TEMPLATE).render(
        press=found.final.fit.layout.model.press.name,
        title=TITLES[found.verdict],
        verdict=found.verdict,
        sentence=sentence(found),
        runs=runs,
        findings=[_finding(found, f) for f in found.findings],
        where=list(_where(found)),
        cost=core_sentence(found),
        numbers=list(_numbers(found)),
        noise=f"{found.noise_floor_K:.2f}",
        candidates=[_candidate(c) for c in found.candidates[:8]],
        next=found.next_measurement,
        warnings=found.warnings,
        run_svg=svg(run_figure(found)),
        residual_svg=svg(residual_figure(found)),
        votes_svg="" if votes is None else svg(votes),
    )


def _finding(found: Diagnosis, f: Finding) -> dict[str, Any]:
    effect = find_effect(f.name)
    return {
        "name": readable(f.name),
        "label": f.name,
        "others": [{"name": readable(n), "confirm": find_effect(n).confirm} for n in f.set[1:]],
        "meaning": effect.meaning,
        "symptom": effect.symptom,
        "core": effect.core,
        "confirm": effect.confirm,
        "parameters": parameters_told(f.name, {name: i.as_json() for name, i in f.parameters.items()}),
        "worth": worth(found, f),
        "is_fault": f.name == "sensor_fault",
        "sureness": sureness(f, len(found.stages[0].data)),
        "share": f"{100 * min(f.explained_share, 1.0):.0f}",
        "against": [{"name": readable(n), "t": f"{t:.1f}"} for n, t in f.against],
    }


def _where(found: Diagnosis) -> Iterator[dict[str, str]]:
    for row in found.where:
        until = "to the end" if row["to_s"] is None else f"{row['to_s']:g} s"
        yield {
            "signal": place_words(row["signal"]),
            "label": row["signal"],
            "phase": row["phase"],
            "time": f"{row['from_s']:g} s – {until}",
            "measured": temperatures(row),
            "residual": f"{row['residual_K']:+.2f} K",
        }


def _numbers(found: Diagnosis) -> Iterator[dict[str, str]]:
    rows = (
        ("residual of all sensors, fitted runs", "rmse_K"),
        ("residual on runs that took no part", "heldout_rmse_K"),
        ("error of the core against core thermocouples", "core_rmse_K"),
    )
    for label, key in rows:
        a, b = getattr(found.base, key), getattr(found.extended, key)
        if a is None:
            yield {"label": label, "base": "no core thermocouple", "extended": ""}
        else:
            yield {"label": label, "base": f"{a:.2f} K", "extended": f"{b:.2f} K"}


def _candidate(row: dict[str, Any]) -> dict[str, str]:
    return {
        "name": readable(row["name"]),
        "label": row["name"],
        "score": f"{row['score']:.0f}",
        "p": chance(row["p_value"]),
        "gain": unsigned_zero(f"{row['heldout_gain_K']:.2f}"),
    }
