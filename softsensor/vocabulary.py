"""What people at a press call places, coefficients and parameters, where files and models use short names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from daq.pressfile import Contact, Press
from softsensor.effects import catalogue
from softsensor.parameters import Parameter, plain

SIDES = re.compile(r"_(top|bottom|upper|lower)$")
FACES = {"top": "top face", "bottom": "bottom face", "middle": "middle"}


@dataclass(frozen=True)
class Told:
    """A parameter as a page or a terminal shows it."""

    name: str
    """Its short name, for those who look it up."""
    words: str
    value: str
    unit: str
    between: str
    """The 95 % interval in the same unit, empty where none is known."""

    @property
    def line(self) -> str:
        """All of it in one line of text."""
        between = f" (95 %: {self.between})" if self.between else ""
        return f"{self.words} ({self.name}): {f'{self.value} {self.unit}'.strip()}{between}"


def parameters_told(effect: str, values: Mapping[str, Mapping[str, Any]]) -> list[Told]:
    """Return an effect's parameters as people are told them.

    Parameters
    ----------
    effect
        Its name; one that is in no catalogue keeps its short names.
    values
        By parameter name: ``value`` and ``ci95``, as in the JSON of a diagnosis.
    """
    known = _parameters(effect)
    found = []
    for name, entry in values.items():
        value, ci95 = entry["value"], entry.get("ci95")
        if isinstance(value, str | list | tuple):
            columns = [value] if isinstance(value, str) else value
            found.append(Told(name, name.replace("_", " "), ", ".join(columns), "", ""))
            continue
        words, factor, unit = name.replace("_", " "), 1.0, ""
        if name in known:
            words, (factor, unit) = known[name].words, known[name].scale
        between = "" if ci95 is None else " to ".join(plain(factor * end) for end in ci95)
        found.append(Told(name, words, plain(factor * value), unit, between))
    return found


def _parameters(effect: str) -> dict[str, Parameter]:
    known = catalogue().get(effect)
    return {p.name: p for p in known.parameters} if known else {}


def readable(effect: str) -> str:
    """Return what an effect is called in the middle of a sentence.

    Examples
    --------
    >>> readable("edge_loss"), readable("somebody_elses")
    ('heat lost at the rim', 'somebody elses')
    """
    known = catalogue().get(effect)
    return (known.called if known else "") or effect.replace("_", " ")


def in_words(text: str) -> str:
    """Return a text with the effects of the catalogue by what they are called.

    Examples
    --------
    >>> in_words("edge_loss: residual 0.5 K, h_pp_c as before")
    'heat lost at the rim: residual 0.5 K, h_pp_c as before'
    """
    return re.sub(r"\b[a-z]+(?:_[a-z]+)+\b", lambda m: readable(m[0]) if m[0] in catalogue() else m[0], text)


def place_words(label: str) -> str:
    """Return where a sensor sits, in words; a place without any stands for itself.

    Examples
    --------
    >>> place_words("panel.top"), place_words("panel@5.7mm")
    ('panel, top face', 'panel, 5.7 mm from its bottom')
    """
    layer, depth = label.partition("@")[::2]
    if depth:
        return f"{_body(layer)}, {depth.removesuffix('mm')} mm from its bottom"
    layer, side = label.partition(".")[::2]
    return f"{_body(layer)}, {FACES[side]}" if side in FACES else label


def coefficient_words(press: Press, name: str) -> str:
    """Return between what, and when, a heat transfer coefficient of this press acts; empty where nothing tells.

    Of ``plate_bottom`` and ``plate_top`` both are called plate, since one coefficient mostly serves both.
    """
    pairs: dict[tuple[frozenset[str], str], str] = {}
    for contact in press.contact:
        for one, other, state in _acts(contact, name):
            pairs.setdefault((frozenset((one, other)), state), f"{one} – {other}{state}")
    if not pairs:
        ends = {"bottom": press.boundary.bottom, "top": press.boundary.top}
        return " and ".join(f"{side} face – surroundings" for side, end in ends.items() if end.coefficient == name)
    return " and ".join(pairs.values())


def _acts(contact: Contact, name: str) -> Sequence[tuple[str, str, str]]:
    below, above = (_body(part) for part in contact.between)
    if isinstance(contact.open, tuple):
        parted = [
            (body, "air", ", open") for body, own in zip((below, above), contact.open, strict=True) if own == name
        ]
        return parted + ([(below, above, ", closed")] if contact.closed == name else [])
    if contact.open is None or contact.open == contact.closed:
        return [(below, above, "")] if contact.closed == name else []
    states = ((contact.open, ", open"), (contact.closed, ", closed"))
    return [(below, above, state) for own, state in states if own == name]


def _body(part: str) -> str:
    return "platen" if part.startswith("boundary.") else SIDES.sub("", part).replace("_", " ")
