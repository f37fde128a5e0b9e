"""What people at a press call places, coefficients and parameters, where files and models use short names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import reduce
from typing import Any

from daq.press.press_file import Contact, Press
from daq.words import Message, say
from softsensor.effects import known_effect

SIDES = re.compile(r"_(top|bottom|upper|lower)$")
SIDED = ("body-plate", "body-platen")
"""Bodies that a press has two of."""


class SensorPlace(StrEnum):
    """Where in a layer a sensor sits."""

    TOP = "top"
    BOTTOM = "bottom"
    MIDDLE = "middle"


class Body(StrEnum):
    """Layers that have words in every language."""

    PANEL = "panel"
    PLATE = "plate"
    PLATEN = "platen"


@dataclass(frozen=True)
class ShownParameter:
    """A parameter as a page or a terminal shows it."""

    name: str
    """Its short name, for those who look it up."""
    words: Message
    value: Message
    unit: Message
    between: Message | None
    """The 95 % interval in the same unit, where one is known."""

    @property
    def line(self) -> Message:
        """All of it in one line of text."""
        amount = say("parameter-amount", value=self.value, unit=self.unit) if str(self.unit) else self.value
        line = say("parameter-line", words=self.words, name=self.name, amount=amount)
        return line if self.between is None else say("parameter-line-within", line=line, between=self.between)


def parameters_shown(effect: str, values: Mapping[str, Mapping[str, Any]]) -> list[ShownParameter]:
    """Return an effect's parameters as they are shown to people.

    Parameters
    ----------
    effect
        Its name; one that is in no catalogue keeps its short names.
    values
        By parameter name: ``value`` and ``ci95``, as in the JSON of a diagnosis.
    """
    own = known_effect(effect)
    known = {p.name: p for p in own.parameters} if own is not None else {}
    found = []
    for name, entry in values.items():
        value, ci95 = entry["value"], entry.get("ci95")
        plain_name, no_unit = _plain(name.replace("_", " ")), _plain("")
        if isinstance(value, str | list | tuple):
            columns = [value] if isinstance(value, str) else value
            found.append(
                ShownParameter(name, plain_name, say("list-of-names", names=tuple(columns)), no_unit, None)
            )
            continue
        factor, words, unit = 1.0, plain_name, no_unit
        if own is not None and name in known:
            factor, unit = known[name].factor, known[name].shown_unit
            words = own.parameter_called(name)
        ends = None if ci95 is None else [factor * float(end) for end in ci95]
        between = None if ends is None else say("parameter-interval", low=ends[0], high=ends[1])
        found.append(ShownParameter(name, words, say("report-number-3", value=factor * value), unit, between))
    return found


def called(effect: str) -> Message:
    """Return what an effect is called in the middle of a sentence; one in no catalogue keeps its name.

    Examples
    --------
    >>> str(called("edge_loss")), str(called("somebody_elses"))
    ('heat lost at the rim', 'somebody elses')
    """
    known = known_effect(effect)
    return known.called if known else _plain(effect.replace("_", " "))


def place_words(label: str) -> Message:
    """Return where a sensor sits, in words; a place without any stands for itself.

    Examples
    --------
    >>> str(place_words("panel.top")), str(place_words("panel@5.7mm"))
    ('panel, top face', 'panel, 5.7 mm from its bottom')
    """
    layer, depth = label.partition("@")[::2]
    if depth:
        return say("place-depth", body=_body(layer), depth_mm=float(depth.removesuffix("mm")))
    layer, side = label.partition(".")[::2]
    return say(f"place-{SensorPlace(side)}", body=_body(layer)) if side in set(SensorPlace) else _plain(label)


def layer_words(part: str) -> Message:
    """Return what a layer or boundary of a press file is called, with whether it is the upper or the lower one.

    Examples
    --------
    >>> str(layer_words("plate_top")), str(layer_words("boundary.bottom")), str(layer_words("panel"))
    ('upper plate', 'lower platen', 'panel')
    """
    side = "lower" if part.endswith(("bottom", "lower")) else "upper" if part.endswith(("top", "upper")) else ""
    body = _body(part)
    return Message(f"{body.code}-{side}") if side and body.code in SIDED else body


def coefficient_words(press: Press, name: str) -> Message:
    """Return between what, and when, a heat transfer coefficient of this press acts; no text if unknown.

    Of ``plate_bottom`` and ``plate_top`` both are called plate, since one coefficient mostly serves both.
    """
    pairs: dict[tuple[frozenset[Message], str], Message] = {}
    for contact in press.contact:
        for one, other, state in _acts(contact, name):
            pairs.setdefault((frozenset((one, other)), state), say(f"coupling-{state}", one=one, other=other))
    found: list[Message] = []
    if not pairs:
        ends = {SensorPlace.BOTTOM: press.boundary.bottom, SensorPlace.TOP: press.boundary.top}
        found = [say(f"coupling-surroundings-{side}") for side, end in ends.items() if end.coefficient == name]
    return reduce(
        lambda a, b: say("coupling-and", first=a, second=b), list(pairs.values()) or found or [_plain("")]
    )


def _acts(contact: Contact, name: str) -> Sequence[tuple[Message, Message, str]]:
    below, above = (_body(part) for part in contact.between)
    if isinstance(contact.open, tuple):
        air = say("body-air")
        parted = [
            (body, air, "open") for body, own in zip((below, above), contact.open, strict=True) if own == name
        ]
        return parted + ([(below, above, "closed")] if contact.closed == name else [])
    if contact.open is None or contact.open == contact.closed:
        return [(below, above, "always")] if contact.closed == name else []
    states = ((contact.open, "open"), (contact.closed, "closed"))
    return [(below, above, state) for own, state in states if own == name]


def _body(part: str) -> Message:
    """Return what a layer is called: those of the laboratory press in words, others by their names."""
    name = "platen" if part.startswith("boundary.") else SIDES.sub("", part).replace("_", " ")
    return say(f"body-{Body(name)}") if name in set(Body) else _plain(name)


def _plain(text: str) -> Message:
    return say("plain-text", text=text)
