"""One run as a picture: measured against simulated above, the residual below. SVG, drawn directly.

Drawn by hand and not by matplotlib (2026-11-21): the server starts without it, any thread may draw,
and the picture is 30 kB.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from xml.sax.saxutils import escape

import numpy as np

from api.answers.decimation import decimate
from daq.records import Array
from daq.words import Message, say
from daq.words.message import ENGLISH, words
from softsensor.effects.vocabulary import place_words

WIDTH, LEFT, RIGHT = 900, 62, 14
"""Of the drawing, and of its margins: room for the numbers of the axis. [px]"""
POINTS = 700
"""Of a curve: one a pixel is all that can be seen."""
COLOURS = {"panel.top": "#e8590c", "panel.bottom": "#1c7ed6"}
OTHERS = ("#2b8a3e", "#862e9c", "#0b7285")
CORE, LIVE, PLATEN = "#c92a2a", "#6741d9", "#6b7280"
DASH = "6 4"
"""Of the simulated core, which is drawn over the live one: where they agree, both show."""
INK, FAINT, LINE = "#17202b", "#5a6675", "#dfe3e8"
CALM = 0.97
"""Share of the residuals the axis shows: the second after closing may be off by tens of kelvins."""
SHADES = {"open": "#fdf3e1", "closed": "#eef4f5"}


@dataclass(frozen=True)
class Curves:
    """What the picture shows; all on the same times. [°C]"""

    title: str
    time_s: Array
    simulated: Mapping[str, Array]
    measured: Mapping[str, Array]
    core: Array
    phases: Sequence[tuple[str, float, float]]
    """State, from, to. [s]"""
    platens: Mapping[str, Array] = field(default_factory=dict)
    """On times of their own, `platen_time_s`."""
    platen_time_s: Array = field(default_factory=lambda: np.empty(0))
    live: Mapping[str, Array] = field(default_factory=dict)
    """The live sensor's valid estimates: `core`, `low`, `high`, at `live_time_s`; empty for nothing."""
    live_time_s: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class _Panel:
    """A pair of axes: where it is on the sheet and which values it spans."""

    top: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]

    def across(self, time_s: Array) -> Array:
        """Return where times lie from the left, same shape. [s to px]"""
        return LEFT + (time_s - self.x[0]) / (self.x[1] - self.x[0]) * (WIDTH - LEFT - RIGHT)

    def down(self, values: Array) -> Array:
        """Return where values lie from the top, same shape. [unit of `y` to px]"""
        return self.top + self.height * (1.0 - (values - self.y[0]) / (self.y[1] - self.y[0]))


def run_figure(curves: Curves, language: str = ENGLISH) -> str:
    """Return the picture as SVG text, its words in a language that has a catalogue."""
    table = {f"s {k}": v for k, v in curves.simulated.items()} | {f"m {k}": v for k, v in curves.measured.items()}
    time_s, thin = decimate(curves.time_s, {**table, "core": curves.core}, POINTS)
    residual = {k: thin[f"m {k}"] - thin[f"s {k}"] for k in curves.simulated}
    platen_s, platens = decimate(curves.platen_time_s, curves.platens, POINTS)
    live_s, live = decimate(curves.live_time_s, curves.live, POINTS)
    span = (float(time_s[0]), float(max(time_s[-1], time_s[0] + 1e-3)))
    low, high = _range([*thin.values(), *platens.values(), *live.values()])
    above = _Panel(60, 300, span, (low, high + 0.06 * (high - low)))  # the states' names stand above the platens
    below = _Panel(400, 120, span, _calm_range(residual.values()))
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} 572" font-family="system-ui, sans-serif" '
        f'font-size="12" fill="{INK}"><rect width="{WIDTH}" height="572" fill="#fff"/>',
        f'<clipPath id="below"><rect x="{LEFT}" y="{below.top}" width="{WIDTH - LEFT - RIGHT}" '
        f'height="{below.height}"/></clipPath>',
        f'<text x="{LEFT}" y="22" font-size="15" font-weight="600">{escape(curves.title)}</text>',
        *_axes(above, say("figure-temperature"), curves.phases, language),
        *_axes(below, say("figure-measured-minus-model"), curves.phases, language),
        *_band(above, live_s, live),
        f'<text x="{(LEFT + WIDTH) / 2}" y="564" text-anchor="middle" fill="{FAINT}">'
        f"{_text(say('figure-time'), language)}</text>",
    ]
    for values in platens.values():
        parts += _line(above, platen_s, values, PLATEN, 1.2)
    for i, name in enumerate(curves.simulated):
        colour = COLOURS.get(name, OTHERS[i % len(OTHERS)])
        parts += _dots(above, time_s, thin[f"m {name}"], colour)
        parts += _line(above, time_s, thin[f"s {name}"], colour, 1.8)
        parts += ['<g clip-path="url(#below)">', *_line(below, time_s, residual[name], colour, 1.3), "</g>"]
    parts += _line(above, live_s, live["core"], LIVE, 2.4) if live else []
    parts += _line(above, time_s, thin["core"], CORE, 1.6, dash=DASH)
    parts += _legend(list(curves.simulated), language, platens=bool(platens), live=bool(live))
    return "\n".join([*parts, "</svg>"])


def _range(series: Iterable[Array]) -> tuple[float, float]:
    values = np.concatenate([v[np.isfinite(v)] for v in series])
    if len(values) == 0:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    space = max(0.05 * (high - low), 0.05)
    return low - space, high + space


def _calm_range(series: Iterable[Array]) -> tuple[float, float]:
    sizes = np.abs(np.concatenate([v[np.isfinite(v)] for v in series]))
    limit = 1.3 * max(float(np.quantile(sizes, CALM)), 0.5) if len(sizes) else 1.0
    return -limit, limit


def _band(panel: _Panel, time_s: Array, live: Mapping[str, Array]) -> Iterable[str]:
    """Draw the live core's bounds, a patch for each stretch without a gap."""
    if not live:
        return
    known = np.flatnonzero(np.isfinite(live["low"]) & np.isfinite(live["high"]))
    for rows in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        x = panel.across(time_s[rows])
        edge = [*zip(x, panel.down(live["low"][rows]), strict=True)]
        edge += reversed([*zip(x, panel.down(live["high"][rows]), strict=True)])
        path = "L".join(f"{a:.1f} {b:.1f}" for a, b in edge)
        if path:
            yield f'<path d="M{path}Z" fill="{LIVE}" opacity=".18"/>'


def _ticks(low: float, high: float, count: int) -> list[float]:
    """Return round numbers inside a range, about `count` of them."""
    rough = (high - low) / count
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(power * m for m in (1, 2, 5, 10) if power * m >= rough)
    first = int(np.ceil(low / step))
    return [step * i for i in range(first, int(np.floor(high / step + 1e-9)) + 1)]


def _axes(
    panel: _Panel, label: Message, phases: Sequence[tuple[str, float, float]], language: str
) -> Iterable[str]:
    bottom = panel.top + panel.height
    for state, from_s, to_s in phases:
        if state in SHADES:
            a, b = panel.across(np.clip(np.array([from_s, to_s]), *panel.x))
            size = f'width="{b - a:.1f}" height="{panel.height}"'
            yield f'<rect x="{a:.1f}" y="{panel.top}" {size} fill="{SHADES[state]}"/>'
            if b - a > 50 and panel.height > 200:
                called = _text(Message(f"page-state-{state}"), language)
                yield f'<text x="{a + 5:.1f}" y="{panel.top + 14}" fill="{FAINT}" font-size="11">{called}</text>'
    for value in _ticks(*panel.y, count=max(int(panel.height / 30), 2)):
        y = float(panel.down(np.array(value)))
        yield f'<path d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}" stroke="{LINE}"/>'
        tick = _text(say("report-number", value=value), language)
        yield f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end" fill="{FAINT}">{tick}</text>'
    for value in _ticks(*panel.x, count=10):
        x = float(panel.across(np.array(value)))
        yield f'<path d="M{x:.1f} {bottom}v4" stroke="{FAINT}"/>'
        tick = _text(say("report-number", value=value), language)
        yield f'<text x="{x:.1f}" y="{bottom + 17}" text-anchor="middle" fill="{FAINT}">{tick}</text>'
    yield f'<path d="M{LEFT} {panel.top}V{bottom}H{WIDTH - RIGHT}" stroke="{FAINT}" fill="none"/>'
    middle = panel.top + panel.height / 2
    turned = f'transform="translate(14 {middle}) rotate(-90)" text-anchor="middle"'
    yield f'<text {turned} fill="{FAINT}">{_text(label, language)}</text>'


def _text(message: Message, language: str) -> str:
    return escape(words(message, language))


def _line(
    panel: _Panel, time_s: Array, values: Array, colour: str, width: float, dash: str = "none"
) -> Iterable[str]:
    x, y = panel.across(time_s), panel.down(values)
    path, pen = [], "M"
    for i in range(len(x)):
        if np.isfinite(y[i]):
            path.append(f"{pen}{x[i]:.1f} {y[i]:.1f}")
            pen = "L"
        else:
            pen = "M"
    look = f'stroke="{colour}" stroke-width="{width}" stroke-dasharray="{dash}"'
    yield f'<path d="{"".join(path)}" fill="none" {look}/>'


def _dots(panel: _Panel, time_s: Array, values: Array, colour: str) -> Iterable[str]:
    x, y = panel.across(time_s), panel.down(values)
    marks = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(x[::3], y[::3], strict=True) if np.isfinite(b))
    yield f'<path d="{marks}" stroke="{colour}" stroke-width="3.4" stroke-linecap="round" opacity=".55"/>'


def _legend(names: Sequence[str], language: str, *, platens: bool, live: bool) -> Iterable[str]:
    x, y = float(LEFT), 36
    entries = [(place_words(n), COLOURS.get(n, OTHERS[i % len(OTHERS)])) for i, n in enumerate(names)]
    entries += [(say("page-core-simulated"), CORE)]
    entries += [(say("page-platens"), PLATEN)] if platens else []
    entries += [(say("figure-core-live"), LIVE)] if live else []
    for message, colour in entries:
        name = words(message, language)
        if x + 21 + 6.3 * len(name) > WIDTH - RIGHT:
            x, y = float(LEFT), y + 16
        dash = DASH if colour == CORE else "none"
        yield f'<path d="M{x} {y}h16" stroke="{colour}" stroke-width="3" stroke-dasharray="{dash}"/>'
        yield f'<text x="{x + 21}" y="{y + 4}" font-size="11" fill="{FAINT}">{escape(name)}</text>'
        x += 34 + 6.3 * len(name)
    marks = _text(say("figure-dots-and-lines"), language)
    yield f'<text x="{WIDTH - RIGHT}" y="22" text-anchor="end" font-size="11" fill="{FAINT}">{marks}</text>'
