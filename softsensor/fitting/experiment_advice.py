"""Why a run does not determine a coefficient, and the measurement that would: read from the run at hand.

The reason comes from the sensitivities and the profile: nothing moves, the resistance is too small, another
unknown moves with it, or the noise is larger. The remedy follows from the reason and from how long the run
stays in the state in which the coefficient acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.press.press_file import Contact, Press
from daq.press.wires import closed_of
from daq.words import Message, say
from softsensor.effects.vocabulary import layer_words, place_words
from softsensor.fitting.problem import CONSTANT, PlaceUnknown
from softsensor.fitting.result import RunFit
from softsensor.heat.timing import TIMINGS

# Numbers without another source were set by hand, 2026-11.

SEEN_K = 0.05
"""A coefficient that moves no reading by this much when it grows by e goes unseen. [K]"""
TOGETHER = 0.8
"""Correlation from which on another unknown is named as the reason."""
WANTED = 0.3
"""Half interval of a logarithm worth having."""
LONG_S, LONGEST_S = 20.0, 60.0
"""A state that lasts the first shows a coefficient where a thermocouple is near enough; beyond the second, more
time hardly helps. [s]"""
FASTEST_HZ = 9.0
"""Loggers of this pace are as fast as they come. [Hz]"""
MANY = 30
"""More runs than this are no advice."""


@dataclass(frozen=True)
class Side:
    """One end of a profile interval."""

    x: float
    """Internal variable at the end; the limit where open."""
    closed: bool


@dataclass(frozen=True)
class Company:
    """The runs a run is fitted together with, as far as advice goes."""

    runs: int = 1
    """Itself included."""
    shared: tuple[str, ...] = ()
    """Coefficients with one value in all of them."""


ALONE = Company()


def explain(fitted: RunFit, i: int, below: Side, above: Side, company: Company) -> Message:
    """Say why a coefficient is not identifiable in this run, and which measurement would fix it."""
    u = fitted.problem.unknowns[i]
    largest = max(float(np.abs(d[:, i]).max()) for d in fitted.minimum.evaluation.derivative)
    role = role_of(fitted.problem.case.press, u.name, fitted)
    if largest < SEEN_K:
        remedy = role.beside if role.beside is not None and role.seconds >= LONG_S else role.record
        return _reason(role, say("fit-why-unseen", kelvin=largest), remedy)
    if role.closed and below.closed and not above.closed:
        least = float(u.value(below.x))
        remedy = role.beside or say("fit-remedy-both-sides")
        return _reason(role, say("fit-why-resistance", least=least, resistance=1.0 / least), remedy)
    partner, correlation = partner_of(fitted, i)
    if abs(correlation) > TOGETHER:
        why = say("fit-why-together", partner=_named(partner), correlation=correlation)
        remedy = apart(fitted, partner, role, company)
    else:
        why = say("fit-why-noise", kelvin=largest, noise=fitted.problem.noise.slow_K)
        remedy = _or_several(role.record, fitted, i, company)
    if below.closed and above.closed:
        wide = say("fit-why-wide", factor=float(np.exp((above.x - below.x) / 2)))
        why = say("fit-two-sentences", first=wide, second=why)
    return _reason(role, why, remedy)


def _reason(role: CoefficientRole, why: Message, remedy: Message) -> Message:
    return say("fit-reason", role=role.words, why=why, remedy=remedy)


NUISANCE_CODES = {
    "closed_s": "fit-unknown-closing",
    "opened_s": "fit-unknown-opening",
    "ramp_s": "fit-unknown-ramp",
    "inserted_s": "fit-unknown-insertion",
    "initial_K": "fit-unknown-start",
    "boundary_top_K": "fit-unknown-platen-top",
    "boundary_bottom_K": "fit-unknown-platen-bottom",
    PlaceUnknown.OFFSET: "fit-unknown-offset",
    PlaceUnknown.GAIN: "fit-unknown-gain",
    PlaceUnknown.SKEW: "fit-unknown-skew",
    CONSTANT: "fit-unknown-constant",
}


def _named(unknown: str) -> Message | str:
    """Return an unknown in words; coefficients go by their names."""
    kind, _, place = unknown.partition(":")
    return say(NUISANCE_CODES[kind], place=place_words(place)) if kind in NUISANCE_CODES else unknown


def apart(fitted: RunFit, partner: str, role: CoefficientRole, company: Company) -> Message:
    """Return the measurement that separates a coefficient from the unknown it moves together with."""
    kind, _, place = partner.partition(":")
    own = role.beside or role.record
    if kind in (PlaceUnknown.SKEW, *TIMINGS):
        return _faster(fitted, kind) or own
    if kind == PlaceUnknown.OFFSET:
        return say("fit-remedy-check-channels", place=place_words(place))
    if kind == PlaceUnknown.GAIN:
        return say("fit-remedy-calibrate-channels", place=place_words(place))
    if kind.startswith("boundary_"):
        return say("fit-remedy-calibrate-platen")
    if kind == CONSTANT:
        return say("fit-remedy-measure-constant", key=place)
    if (
        company.runs > 1
        and partner not in company.shared
        and partner in fitted.problem.case.press.free_coefficients
    ):
        return say("fit-two-sentences", first=own, second=say("fit-or-share", name=partner))
    return own


def _faster(fitted: RunFit, kind: str) -> Message | None:
    """Return what makes moments known better, None where the record has it all."""
    rate = 1.0 / fitted.problem.signals.period_s
    case = fitted.problem.case
    switch = kind in ("closed_s", "opened_s") and closed_of(case.run, case.press) is None
    if rate < FASTEST_HZ:
        return say("fit-remedy-faster-and-switch" if switch else "fit-remedy-faster", hertz=rate)
    return say("fit-remedy-switch") if switch else None


def _or_several(remedy: Message, fitted: RunFit, i: int, company: Company) -> Message:
    """Return a remedy, with more such runs beside it where they would do."""
    repeats = repeats_for(fitted, i)
    if repeats is None:
        return remedy
    joint = repeats <= company.runs
    other = say("fit-or-joint", runs=company.runs) if joint else say("fit-or-runs", runs=repeats)
    return say("fit-two-sentences", first=remedy, second=other)


def repeats_for(fitted: RunFit, i: int) -> int | None:
    """Return how many runs like this one would know a logarithm to `WANTED`; None where more than `MANY`.

    What was known of the coefficient before comes once however many runs there are, so it is left out.
    """
    variance = float(fitted.covariance[i, i]) / fitted.spread**2
    if fitted.minimum.held[i] or variance <= 0.0:
        return None
    precision = 1.0 / variance - 1.0 / fitted.problem.unknowns[i].sd ** 2
    if precision <= 0.0:
        return None
    repeats = np.ceil((fitted.quantile * fitted.spread / WANTED) ** 2 / precision)
    return max(int(repeats), 2) if repeats <= MANY else None


def partner_of(fitted: RunFit, i: int) -> tuple[str, float]:
    """Return the unknown that correlates most with unknown `i`, and the correlation."""
    row = fitted.correlation[i].copy()
    row[i] = 0.0
    j = int(np.argmax(np.abs(row)))
    return fitted.problem.names[j], float(row[j])


@dataclass(frozen=True)
class CoefficientRole:
    """What a coefficient does in a run."""

    words: Message
    record: Message
    """The longer or other record that would show it."""
    beside: Message | None
    """The thermocouple that would show it, None where it sits there already."""
    seconds: float
    """How long the run is in the state in which it acts. [s]"""
    closed: bool
    """Whether it couples two bodies that touch."""


def role_of(press: Press, name: str, fitted: RunFit) -> CoefficientRole:
    """Return what a coefficient does in this press and this run, and which record would show it."""
    for contact in press.contact:
        opened = (contact.open,) if isinstance(contact.open, str) else contact.open or ()
        if contact.closed == name:
            return _closed_role(contact, press, fitted)
        if name in opened:
            return _open_role(contact, opened.index(name) if len(opened) == 2 else None, press, fitted)
    seconds = float(fitted.problem.rows.sum() * fitted.problem.signals.period_s)
    end = "bottom" if press.boundary.bottom.coefficient == name else "top"
    layer = press.layer[0 if end == "bottom" else -1].name
    beside = _thermocouple([(layer, end, f"boundary.{end}")], press, fitted)
    longer = say("fit-remedy-go-on", boundary=layer_words(f"boundary.{end}"))
    record = say("fit-two-sentences", first=beside, second=longer) if beside else longer
    return CoefficientRole(
        say("fit-role-boundary", boundary=say(f"coupling-surroundings-{end}")), record, beside, seconds, False
    )


FaceNames = tuple[str, str, str]
"""A layer, its side (``top`` or ``bottom``), and what is on the other side."""


def _thermocouple(faces: Sequence[FaceNames], press: Press, fitted: RunFit) -> Message | None:
    """Return the thermocouple to add at one of some faces, None where all have one.

    A face whose channels the press file names and this run lacks comes first, then the first that has none.
    """
    used = {place.label for place in fitted.problem.signals.places}
    named = {sensor.label for sensor in press.sensor if sensor.role == "fit"}
    bare = [face for face in faces if f"{face[0]}.{face[1]}" not in used]
    for layer, side, _ in bare:
        if f"{layer}.{side}" in named:
            return say("fit-remedy-channels", place=place_words(f"{layer}.{side}"))
    if not bare:
        return None
    layer, _, other = bare[0]
    ends = {f"boundary.{end}": boundary.kind for end, boundary in press.boundary.ends}
    if ends.get(other, "measured") != "measured":
        return say("fit-remedy-thermocouple-free", layer=layer_words(layer))
    return say("fit-remedy-thermocouple", layer=layer_words(layer), other=layer_words(other))


def _faces(contact: Contact, press: Press) -> list[FaceNames]:
    """Both faces of a contact, those of plates first; a boundary has none."""
    below, above = contact.between
    both = [(below, "top", above), (above, "bottom", below)]
    return sorted((f for f in both if "." not in f[0]), key=lambda f: f[0] in press.panel_layers)


def _closed_role(contact: Contact, press: Press, fitted: RunFit) -> CoefficientRole:
    (below, above), beside = contact.between, _thermocouple(_faces(contact, press), press, fitted)
    share = fitted.minimum.evaluation.solution.closed_share
    seconds = float((share > 0.5).sum() * fitted.problem.signals.period_s)
    bodies = {"below": layer_words(below), "above": layer_words(above)}
    if not press.has_states:
        words = say("fit-role-joined", **bodies)
        return CoefficientRole(words, say("fit-remedy-change"), beside, seconds, True)
    record = say("fit-remedy-stay-closed", seconds=seconds) if seconds else say("fit-remedy-pressing")
    words = say("fit-role-closed", seconds=seconds, **bodies)
    return CoefficientRole(words, record, beside, seconds, True)


def _open_role(contact: Contact, face: int | None, press: Press, fitted: RunFit) -> CoefficientRole:
    t, period = fitted.problem.signals.time_s, fitted.problem.signals.period_s
    present = t[fitted.problem.rows > 0]
    closing = fitted.closed_s if np.isfinite(fitted.closed_s) else np.inf
    before = float((present < closing).sum() * period)
    after = float((present > fitted.opened_s).sum() * period) if np.isfinite(fitted.opened_s) else 0.0
    faces, (below, above) = _faces(contact, press), contact.between
    words = say("fit-role-open", below=layer_words(below), above=layer_words(above), before=before, after=after)
    if face is not None:
        faces = [f for f in faces if f[0] == contact.between[face]]
        words = say("fit-role-open-face", layer=layer_words(contact.between[face]), before=before, after=after)
    beside = _thermocouple(faces, press, fitted)
    if after < LONG_S or (after < LONGEST_S and before >= LONGEST_S):
        record = say("fit-remedy-log-on", seconds=after)
    elif before < LONGEST_S:
        record = say("fit-remedy-leave-open", seconds=before)
    else:
        record = beside or say("fit-remedy-hotter")
    return CoefficientRole(words, record, beside, before + after, False)
