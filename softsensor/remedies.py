"""Why a run does not determine a coefficient, and the measurement that would: read from the run at hand.

The reason comes from the sensitivities and the profile: nothing moves, the resistance is too small, another
unknown moves with it, or the noise is larger. The remedy follows from the reason and from how long the run
stays in the state in which the coefficient acts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.pressfile import Contact, Press
from softsensor.fit_result import RunFit

SEEN_K = 0.05
"""A coefficient that moves no reading by this much when it grows by e goes unseen. [K]"""
TOGETHER = 0.8
"""Correlation from which on another unknown is named as the reason."""
WANTED = 0.3
"""Half interval of a logarithm worth having."""
LONG_S = 20.0
"""A state that lasts this long shows a coefficient where a thermocouple is near enough. [s]"""


@dataclass(frozen=True)
class Side:
    """One end of a profile interval."""

    x: float
    """Internal variable at the end; the limit where open."""
    closed: bool


def explain(fitted: RunFit, i: int, below: Side, above: Side) -> str:
    """Say why a coefficient is not identifiable in this run, and which measurement would fix it."""
    u = fitted.problem.unknowns[i]
    largest = max(float(np.abs(d[:, i]).max()) for d in fitted.minimum.evaluation.derivative)
    role = role_of(fitted.problem.case.press, u.name, fitted)
    if largest < SEEN_K:
        remedy = role.beside if role.seconds >= LONG_S else role.record
        still = f"no reading of this run moves by more than {largest:.2g} K when it grows by e"
        return f"{role.words}; {still}. {remedy}."
    if role.closed and below.closed and not above.closed:
        least = u.value(below.x)
        return (
            f"{role.words}; anything above {least:.3g} fits as well: its resistance, "
            f"below {1.0 / least:.1g} m²K/W, is too small to be seen. {role.beside}."
        )
    text = role.words
    if below.closed and above.closed:
        text += f"; it is known to a factor of {np.exp((above.x - below.x) / 2):.1f} only"
    partner, correlation = partner_of(fitted, i)
    if abs(correlation) > TOGETHER:
        text += f"; it moves together with {partner} (correlation {correlation:+.2f})"
        return f"{text}. {apart(fitted, partner, role)}."
    text += f"; its effect of {largest:.2g} K drowns in the slow noise of the faces"
    text += f" ({fitted.problem.noise.slow_K:.2g} K). {role.record}"
    if fitted.minimum.held[i]:
        return f"{text}."
    return f"{text}, or fit it from about {repeats_for(fitted, i)} such runs together."


def apart(fitted: RunFit, partner: str, role: Role) -> str:
    """Return the measurement that tells a coefficient from the unknown it moves together with."""
    kind, _, label = partner.partition(":")
    rate = 1.0 / fitted.problem.signals.period_s
    timing = f"Log faster than the {rate:.2g} Hz here, and a limit switch as the column closed"
    known = {
        "offset": f"Check the channels at {label} against a thermometer before the run (kerntemp calibrate)",
        "gain": f"Calibrate the channels at {label} at two temperatures",
        "skew": timing,
        "closed_s": timing,
        "opened_s": timing,
        "ramp_s": timing,
        "inserted_s": "Start the record some seconds before the panel is laid in",
        "initial_K": "Measure the panel's start temperature, and write it into the header",
    }
    if kind.startswith("boundary_"):
        return "Calibrate the platen channel against the panel channels at one temperature (kerntemp calibrate)"
    if kind in known:
        return known[kind]
    return f"{role.beside}, or let all runs share {partner} (--shared {partner})"


def repeats_for(fitted: RunFit, i: int) -> int:
    """Return how many runs like this one would know a logarithm to `WANTED`."""
    sd = float(np.sqrt(fitted.covariance[i, i]))
    return int(np.clip(np.ceil((fitted.quantile * sd / WANTED) ** 2), 2, 1000))


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
    """The thermocouple that would show it."""
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
        told = "See the measurement that confirms the effect"
        return Role("it is a parameter of an effect", told, told, seconds, False)
    beside = "Put a thermocouple next to that boundary"
    record = f"{beside}, or go on until its temperature has changed more"
    return Role("it acts at a boundary", record, beside, seconds, False)


def _beside(contact: Contact, press: Press, face: int | None) -> str:
    """Name the face whose temperature would show a contact: of the body that air cools, else of a plate."""
    own = [n for n in contact.between if n not in press.panel_layers and "." not in n]
    layer = contact.between[face] if face is not None else next(iter(own), contact.between[0])
    other = contact.between[1] if layer == contact.between[0] else contact.between[0]
    return f"Put a thermocouple on the face of {layer} towards {other}"


def _closed_role(contact: Contact, press: Press, fitted: RunFit) -> Role:
    pair, beside = " and ".join(contact.between), _beside(contact, press, None)
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
    record = f"Leave the panel in the open press for a minute before closing instead of {before:.0f} s"
    if after < LONG_S or before > 60.0:
        record = f"Log on for a minute after opening instead of {after:.0f} s"
    return Role(words, record, _beside(contact, press, face), before + after, False)
