"""What a page says about each run: the profile of every coefficient, and which unknowns move together.

Drawn by hand as small SVG and table cells: a campaign's page stays small enough for a mail.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from daq.records import Array
from daq.words import Message, say
from softsensor.fitting.identifiability import LikelihoodProfile
from softsensor.fitting.result import RunFit

WIDTH, HEIGHT = 150.0, 84.0
"""Of one profile. [px]"""
RED, BLUE = (178, 24, 43), (33, 102, 172)
"""ColorBrewer's ends of RdBu, which a colour-blind reader distinguishes too."""
CEILING = 2.5
"""Rise drawn, in thresholds."""


@dataclass(frozen=True)
class Picture:
    """One profile as coordinates of a small drawing. [px]"""

    name: str
    verdict: Message
    curve: str
    """Points of a polyline."""
    level: float
    """Height of the line that ends a 95 % interval."""
    best: float
    first: Message
    last: Message
    """Values at the ends of the axis."""


def details_of(fitted: RunFit, shapes: Mapping[str, LikelihoodProfile]) -> dict[str, Any]:
    """Return what the page folds away for a run: profiles and correlations."""
    return {
        "run": fitted.run,
        "profiles": [_picture(name, shape, fitted) for name, shape in shapes.items()],
        "names": fitted.names,
        "correlation": [[_cell(v) for v in row] for row in fitted.correlation],
    }


def _picture(name: str, shape: LikelihoodProfile, fitted: RunFit) -> Picture:
    i = fitted.names.index(name)
    best = fitted.minimum.x[i]
    x = np.log(shape.value)
    xs, heights = smooth(x, shape.rise, best)
    span = max(float(xs[-1] - xs[0]), 1e-12)
    across = WIDTH * (xs - xs[0]) / span
    down = HEIGHT * (1.0 - np.clip(heights / (CEILING * shape.threshold), 0.0, 1.0))
    return Picture(
        name,
        fitted.coefficients[name].verdict.message,
        " ".join(f"{a:.1f},{d:.1f}" for a, d in zip(across, down, strict=True)),
        HEIGHT * (1.0 - 1.0 / CEILING),
        float(WIDTH * (best - xs[0]) / span),
        say("report-number-3", value=float(shape.value[0])),
        say("report-number-3", value=float(shape.value[-1])),
    )


def smooth(x: Array, rise: Array, best: float, points: int = 41) -> tuple[Array, Array]:
    """Return a curve through a profile: its signed root is nearly straight in the internal variable.

    Examples
    --------
    >>> along, height = smooth(np.array([-2.0, 0.0, 2.0]), np.array([4.0, 0.0, 4.0]), 0.0, 5)
    >>> height.round(2).tolist()
    [4.0, 1.0, 0.0, 1.0, 4.0]
    """
    if len(x) < 2:
        return x, rise
    root = np.sign(x - best) * np.sqrt(rise)
    along = np.linspace(x[0], x[-1], points)
    return along, np.asarray(PchipInterpolator(x, root)(along)) ** 2


def _cell(value: float) -> dict[str, Message | str]:
    """Return a correlation in words, colour (red together, blue against each other) and ink that shows on it."""
    strength = min(abs(float(value)), 1.0)
    tint = [round(255 - strength * (255 - c)) for c in (RED if value > 0 else BLUE)]
    colour = ",".join(map(str, tint))
    ink = "black" if _luminance(tint) > EVEN else "white"
    size = round(abs(float(value)), 2)
    text = say("report-signed", sign="" if size == 0.0 else "−" if value < 0.0 else "+", value=size)
    return {"text": text, "colour": f"rgb({colour})", "ink": ink}


EVEN = math.sqrt(1.05 * 0.05) - 0.05
"""Relative luminance on which black and white show alike: (1.05)/(L + 0.05) = (L + 0.05)/0.05 (WCAG 2.2)."""


def _luminance(tint: Sequence[int]) -> float:
    """Return a colour's relative luminance, of red, green and blue from 0 to 255 (WCAG 2.2)."""
    shares = [c / 255.0 for c in tint]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in shares]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
