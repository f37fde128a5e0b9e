"""One self-contained page: what is wrong, why, what it costs, what is gained, what to measure next."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from daq.words import Message, say
from daq.words.message import ENGLISH
from softsensor.diagnosis.curves import curves_of
from softsensor.diagnosis.finding import Diagnosis, Finding
from softsensor.diagnosis.rehearsal import Rehearsal
from softsensor.diagnosis.summary import chance, core_messages, law_messages, sureness, verdict_messages, worth
from softsensor.diagnosis.where import temperatures
from softsensor.effects import find_effect
from softsensor.effects.vocabulary import called, parameters_shown, place_words
from softsensor.report.diagnosis_figures import diagnosis_pictures
from softsensor.report.page import kelvins, page, signed_kelvins
from softsensor.report.rehearsal_rows import HEADS, lost_messages, none_message, rehearsal_rows

SHOWN_CANDIDATES = 8
"""By hand, 2026-11: what a page of print holds."""


def diagnosis_report(found: Diagnosis, language: str = ENGLISH, rehearsal: Rehearsal | None = None) -> str:
    """Return the page as HTML text; it needs no other file."""
    law = None if found.law is None else found.law.as_json()
    return page(
        "diagnosis_report.html",
        language,
        press=found.final.fit.layout.model.press.name,
        title=Message(f"diagnosis-verdict-{found.verdict}"),
        sentence=verdict_messages(found),
        runs=len(found.stages[0].data),
        findings=[_finding(found, f) for f in found.findings],
        where=list(_where(found)),
        cost=core_messages(found),
        numbers=list(_numbers(found)),
        noise=found.noise_floor_K,
        candidates=[_candidate(c) for c in found.candidates[:SHOWN_CANDIDATES]],
        next=found.next_measurement,
        warnings=found.warnings,
        law=law_messages(found),
        **diagnosis_pictures(curves_of(found), law, language),
        rehearsal=_rehearsal(rehearsal) if rehearsal is not None else None,
    )


def _rehearsal(rehearsal: Rehearsal) -> dict[str, Any]:
    return {
        "title": say("rehearsal-title", runs=rehearsal.runs),
        "heads": [say(code) for code in HEADS],
        "rows": rehearsal_rows(rehearsal),
        "none": none_message(rehearsal),
        "lost": lost_messages(rehearsal),
    }


def _finding(found: Diagnosis, f: Finding) -> dict[str, Any]:
    effect = find_effect(f.name)
    gain = worth(found, f)
    if not f.of_channels:
        share = min(f.explained_share, 1.0)
        runs = len(found.stages[0].data)
        gain = say("report-worth", percent=100 * share, worth=gain, sureness=sureness(f, runs))
    return {
        "name": say("list-of-names", names=tuple(map(called, f.set))),
        "label": f.name,
        "meaning": effect.meaning,
        "symptom": effect.symptom,
        "core": effect.core,
        "confirm": [find_effect(name).confirm for name in f.set] if len(f.set) > 1 else [],
        "parameters": parameters_shown(f.name, {name: i.as_json() for name, i in f.parameters.items()}),
        "worth": gain,
        "against": [say("report-preferred", cause=called(name), t=t) for name, t in f.against],
    }


def _where(found: Diagnosis) -> Iterator[dict[str, Any]]:
    for row in found.where:
        yield {
            "signal": place_words(row["signal"]),
            "label": row["signal"],
            "phase": Message.from_json(row["phase_said"]),
            "time": _span(row["from_s"], row["to_s"]),
            "measured": temperatures(row),
            "residual": signed_kelvins(row["residual_K"]),
        }


def _span(begin: float, end: float | None) -> Message:
    return say("report-from-on", begin=begin) if end is None else say("report-from-to", begin=begin, end=end)


def _numbers(found: Diagnosis) -> Iterator[dict[str, Message]]:
    rows = (
        (say("report-residual-fitted"), found.base.rmse_K, found.extended.rmse_K),
        (say("report-residual-left-out"), found.base.heldout_rmse_K, found.extended.heldout_rmse_K),
        (say("report-residual-predicted"), found.base.predicted_rmse_K, found.extended.predicted_rmse_K),
        (say("report-error-core"), found.base.core_rmse_K, found.extended.core_rmse_K),
        (
            say("report-error-core-predicted"),
            found.base.predicted_core_rmse_K,
            found.extended.predicted_core_rmse_K,
        ),
    )
    for label, base, extended in rows:
        if base is None or extended is None:
            yield {"label": label, "base": say("report-no-core"), "extended": say("plain-text", text="")}
        else:
            yield {"label": label, "base": kelvins(base), "extended": kelvins(extended)}


def _candidate(row: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": called(row["name"]),
        "label": row["name"],
        "score": f"{row['score']:.0f}",
        "p": chance(row["p_value"]),
        "gain": kelvins(row["heldout_gain_K"]),
    }
