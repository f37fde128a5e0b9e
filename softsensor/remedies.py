"""Why a run does not determine a coefficient, and the measurement that would: read from the run at hand.

The reason comes from the sensitivities and the profile: nothing moves, the resistance is too small, another
unknown moves with it, or the noise is larger. The remedy follows from the reason and from how long the run
stays in the state in which the coefficient acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.press_wires import closed_of
from daq.pressfile import Contact, Press
from softsensor.effects import find_effect
from softsensor.fit_result import RunFit
from softsensor.fit_unknowns import free_names
from softsensor.parameters import plain

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


def explain(fitted: RunFit, i: int, below: Side, above: Side, company: Company) -> str:
    """Say why a coefficient is not identifiable in this run, and which measurement would fix it."""
    u = fitted.problem.unknowns[i]
    largest = max(float(np.abs(d[:, i]).max()) for d in fitted.minimum.evaluation.derivative)
    role = role_of(fitted.problem.case.press, u.name, fitted)
    if largest < SEEN_K:
        remedy = role.beside if role.beside and role.seconds >= LONG_S else role.record
        still = f"no reading of this run moves by more than {plain(largest, 2)} K when it grows by e"
        return f"{role.words}; {still}. {remedy}."
    if role.closed and below.closed and not above.closed:
        least = u.value(below.x)
        remedy = role.beside or "Thermocouples sit on both sides already: no reading depends on it any more"
        return (
            f"{role.words}; anything above {plain(least)} fits as well: its resistance, "
            f"below {plain(1.0 / least, 1)} m²K/W, is too small to be seen. {remedy}."
        )
    text = role.words
    if below.closed and above.closed:
        text += f"; it is known to a factor of {np.exp((above.x - below.x) / 2):.1f} only"
    partner, correlation = partner_of(fitted, i)
    if abs(correlation) > TOGETHER:
        text += f"; it moves together with {partner} (correlation {correlation:+.2f})"
        return f"{text}. {apart(fitted, partner, role, company)}."
    text += f"; its effect of {plain(largest, 2)} K drowns in the slow noise of the faces"
    text += f" ({plain(fitted.problem.noise.slow_K, 2)} K). {role.record}"
    return f"{text}{_several(fitted, i, company)}."


def apart(fitted: RunFit, partner: str, role: Role, company: Company) -> str:
    """Return the measurement that tells a coefficient from the unknown it moves together with."""
    kind, _, label = partner.partition(":")
    own = role.beside or role.record
    if kind in ("skew", "closed_s", "opened_s", "ramp_s", "inserted_s"):
        return _faster(fitted, kind) or own
    known = {
        "offset": f"Check the channels at {label} against a thermometer before the run (kerntemp calibrate)",
        "gain": f"Calibrate the channels at {label} at two temperatures",
        "initial_K": own,
    }
    if kind.startswith("boundary_"):
        return "Calibrate the platen channel against the panel channels at one temperature (kerntemp calibrate)"
    if kind in known:
        return known[kind]
    if company.runs > 1 and partner not in company.shared and partner in free_names(fitted.problem.case.press):
        return f"{own}, or let all runs share {partner} (--shared {partner})"
    return own


def _faster(fitted: RunFit, kind: str) -> str:
    """Return what makes moments known better, empty where the record has it all."""
    rate = 1.0 / fitted.problem.signals.period_s
    advice = [f"log faster than the {plain(rate, 2)} Hz here"] if rate < FASTEST_HZ else []
    case = fitted.problem.case
    if kind in ("closed_s", "opened_s") and closed_of(case.run, case.press) is None:
        advice.append("log a limit switch as the column closed")
    told = ", and ".join(advice)
    return told[:1].upper() + told[1:]


def _several(fitted: RunFit, i: int, company: Company) -> str:
    """Return whether more such runs would do, as the end of a sentence."""
    repeats = repeats_for(fitted, i)
    if repeats is None:
        return ""
    if repeats <= company.runs:
        return f", or take the joint estimate of these {company.runs} runs"
    return f", or fit it from about {repeats} such runs together"


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
class Role:
    """What a coefficient does in a run."""

    words: str
    record: str
    """The longer or other record that would show it."""
    beside: str
    """The thermocouple that would show it, empty where it sits there already."""
    seconds: float
    """How long the run is in the state in which it acts. [s]"""
    closed: bool
    """Whether it couples two bodies that touch."""


def role_of(press: Press, name: str, fitted: RunFit) -> Role:
    """Return what a coefficient does in this press and this run, and which record would show it."""
    for contact in press.contact:
        opened = (contact.open,) if isinstance(contact.open, str) else contact.open or ()
        if contact.closed == name:
            return _closed_role(contact, press, fitted)
        if name in opened:
            return _open_role(contact, opened.index(name) if len(opened) == 2 else None, press, fitted)
    seconds = float(fitted.problem.rows.sum() * fitted.problem.signals.period_s)
    if "." in name:
        told = find_effect(name.partition(".")[0]).confirm.rstrip(".")
        return Role("it is a parameter of an effect", told, told, seconds, False)
    end = "bottom" if press.boundary.bottom.coefficient == name else "top"
    layer = press.layer[0 if end == "bottom" else -1].name
    beside = _thermocouple([(layer, end, f"boundary.{end}")], press, fitted)
    longer = "go on until its temperature has changed more"
    record = f"{beside}, or {longer}" if beside else longer.capitalize()
    return Role("it acts at a boundary", record, beside, seconds, False)


Face = tuple[str, str, str]
"""A layer, its side (``top`` or ``bottom``), and what is on the other side."""


def _thermocouple(faces: Sequence[Face], press: Press, fitted: RunFit) -> str:
    """Return the thermocouple to add at one of some faces, empty where all have one.

    A face whose channels the press file names and this run lacks comes first, then the first that has none.
    """
    used = {place.label for place in fitted.problem.signals.places}
    named = {sensor.label for sensor in press.sensor if sensor.role == "fit"}
    bare = [face for face in faces if f"{face[0]}.{face[1]}" not in used]
    for layer, side, _ in bare:
        if f"{layer}.{side}" in named:
            return f"Log the channels at {layer}.{side} too, which this run lacks"
    return f"Put a thermocouple on the face of {bare[0][0]} towards {bare[0][2]}" if bare else ""


def _faces(contact: Contact, press: Press) -> list[Face]:
    """Both faces of a contact, those of plates first; a boundary has none."""
    below, above = contact.between
    both = [(below, "top", above), (above, "bottom", below)]
    return sorted((f for f in both if "." not in f[0]), key=lambda f: f[0] in press.panel_layers)


def _closed_role(contact: Contact, press: Press, fitted: RunFit) -> Role:
    pair, beside = " and ".join(contact.between), _thermocouple(_faces(contact, press), press, fitted)
    share = fitted.minimum.evaluation.solution.closed_share
    seconds = float((share > 0.5).sum() * fitted.problem.signals.period_s)
    if not press.has_states:
        return Role(f"it couples {pair}", "Change the temperatures faster, or further", beside, seconds, True)
    record = f"Stay closed for longer than the {seconds:.0f} s here" if seconds else "Log a pressing that closes"
    return Role(f"it couples {pair} while closed ({seconds:.0f} s here)", record, beside, seconds, True)


def _open_role(contact: Contact, face: int | None, press: Press, fitted: RunFit) -> Role:
    t, period = fitted.problem.signals.time_s, fitted.problem.signals.period_s
    present = t[fitted.problem.rows > 0]
    closing = fitted.closed_s if np.isfinite(fitted.closed_s) else np.inf
    before = float((present < closing).sum() * period)
    after = float((present > fitted.opened_s).sum() * period) if np.isfinite(fitted.opened_s) else 0.0
    place = " and ".join(contact.between) if face is None else f"the face of {contact.between[face]}"
    words = f"it acts at {place} while open ({before:.0f} s before closing and {after:.0f} s after opening here)"
    faces = _faces(contact, press)
    if face is not None:
        faces = [f for f in faces if f[0] == contact.between[face]]
    beside = _thermocouple(faces, press, fitted)
    if after < LONG_S or (after < LONGEST_S and before >= LONGEST_S):
        record = f"Log on for a minute after opening instead of {after:.0f} s"
    elif before < LONGEST_S:
        record = f"Leave the panel in the open press for a minute before closing instead of {before:.0f} s"
    else:
        record = beside or "Repeat the run with a hotter press: the open state is long enough"
    return Role(words, record, beside, before + after, False)
