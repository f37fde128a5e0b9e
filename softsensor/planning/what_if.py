"""What if: a pressing that was recorded, with other settings, in a band of all that is not known of it.

The platens follow the press's movements as they did (`softsensor.planning.program`); coefficients are those of the
run's own fit, and they, the panel's constants, the platens, kinetics and sorption are drawn as for a pressing that
is planned (`softsensor.planning.made_up`).

It is the same panel, so what the live sensor estimated counts: with y the core of the draws of the run as it was,
x any quantity of the pressing asked for, near normal together, and the live core N(m, s²),

    E x = mean(x) + b (m - mean(y)),    var x = var(x) - b² var(y) + b² s²,    b = cov(x, y) / var(y).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from numbers import Real
from types import MappingProxyType

import numpy as np

from daq.press.header import LIMITS
from daq.press.press_file import Press, press_for_run
from daq.press.resin_file import Resin
from daq.records import Array, InputError, Moments, Run
from daq.words import say
from softsensor.heat.batch import solve_many
from softsensor.heat.model_file import ModelFile
from softsensor.opening.kinetics import equivalent_course, kinetics_of
from softsensor.opening.steam import MOISTURE
from softsensor.planning.made_up import KINETICS, STEAM_ROWS, Drawn, draw, steam_of
from softsensor.planning.program import FACTORS, designed_run, settings_of
from softsensor.signals.unknown import BAND

WETTER = "moisture_percent"
"""A setting beside those of `FACTORS`, which a press operator cannot set but a supplier can."""
ROWS = 300
"""Of an answer at most: enough for a picture. By hand, 2026-11."""
LONGEST_S = 1200.0
"""A longer pressing is refused: it would keep a server busy. By hand, 2026-11. [s]"""


@dataclass(frozen=True)
class LiveCore:
    """The live sensor's last valid estimate of the core before the press opened."""

    time_s: float
    core_C: float  # noqa: N815
    sd_K: float  # noqa: N815


@dataclass(frozen=True)
class LiveAndDrawn(LiveCore):
    """The same, and what the draws of the run as it was have there (draws). [°C]"""

    drawn: Array


@dataclass(frozen=True)
class Band:
    """A quantity over the answer's rows: expected, and what bounds 95 %; NaN where it is not known."""

    middle: Array
    low: Array
    high: Array

    @classmethod
    def of(cls, draws: Array, live: LiveAndDrawn | None) -> Band:
        """Return the band of draws that are close to normal (draws, rows)."""
        middle, variance = draws.mean(axis=0), draws.var(axis=0, ddof=1)
        if live is not None:
            away = live.drawn - live.drawn.mean()
            slope = away @ (draws - middle) / (away @ away)
            middle = middle + slope * (live.core_C - live.drawn.mean())
            variance = variance + slope**2 * (live.sd_K**2 - live.drawn.var(ddof=1))
        wide = BAND * np.sqrt(np.maximum(variance, 0.0))
        return cls(middle, middle - wide, middle + wide)

    def within(self, lowest: float, highest: float) -> Band:
        """Return it without what cannot be."""
        return Band(*(np.clip(x, lowest, highest) for x in (self.middle, self.low, self.high)))


@dataclass(frozen=True)
class WhatIf:
    """The pressing asked for."""

    run: Run
    """With the changed header and platens, its sensors unread."""
    moments: Moments
    core: Band
    """[°C]"""
    cure: Band
    """Of the less cured face, 0 to 1."""
    steam: Band
    """[kPa]"""


def settings_known(run: Run, press: Press, moments: Moments) -> dict[str, tuple[float, float, float]]:
    """Return what can be asked about a run: how it was, and the least and the most it can be."""
    found = {n: (v, FACTORS[n].lower, FACTORS[n].upper) for n, v in settings_of(run, press, moments).items()}
    wet = LIMITS[MOISTURE]
    if (moisture := run.header.get(MOISTURE)) is not None:
        found[WETTER] = (float(moisture), wet.lower, wet.upper)
    return found


def changed(run: Run, press: Press, moments: Moments, settings: Mapping[str, float]) -> tuple[Run, Moments]:
    """Return the run that other settings would give, its sensors unread, and its moments. Raises `InputError`."""
    usual = settings_known(run, press, moments)
    for name, value in settings.items():
        if name not in usual:
            raise InputError(say("plan-setting-unknown", name=name, known=tuple(usual)))
        if not isinstance(value, Real):
            raise InputError(say("at-key-value", key=name, value=repr(value), what=say("key-no-number")))
        _, lower, upper = usual[name]
        if not lower <= value <= upper:
            raise InputError(say("plan-setting-wrong", name=name, value=value, lower=lower, upper=upper))
    wanted = {name: value for name, (value, *_) in usual.items()} | dict(settings)
    if WETTER in wanted:
        run = replace(run, header={**run.header, MOISTURE: wanted.pop(WETTER)})
    made, moments = designed_run(run, press, moments, wanted)
    unread = {name: np.full(len(made.time_s), np.nan) for name in press_for_run(press, made).sensors_of(made)}
    return replace(made, columns={**made.columns, **unread}), moments


@dataclass(frozen=True)
class Pressed:
    """A pressing that was recorded."""

    run: Run
    press: Press
    model: ModelFile
    """In force, with the coefficients of the run's own fit."""
    moments: Moments
    live: LiveCore | None = None
    """None: nobody followed it live."""
    resin: Resin | None = None


def what_if(pressed: Pressed, settings: Mapping[str, float] = MappingProxyType({})) -> WhatIf:
    """Return the pressing that other settings would give.

    Raises
    ------
    InputError
        As `changed`; for a pressing longer than `LONGEST_S`, and for a panel or press that cannot be solved.
    """
    made, live = _Solved.of(pressed, settings), None
    if pressed.live is not None:
        as_it_was = _Solved.of(pressed, {}) if settings else made
        row = int(np.abs(as_it_was.run.time_s - pressed.live.time_s).argmin())
        live = LiveAndDrawn(**vars(pressed.live), drawn=as_it_was.core[:, row])
    cure, steam = made.cure(pressed.resin, live), made.steam(pressed.resin, live)
    core = Band.of(made.core, live).within(float(made.layers.min()), float(made.layers.max()))
    return WhatIf(made.run, made.moments, core, cure, steam)


@dataclass(frozen=True)
class _Solved:
    """A pressing in all its draws."""

    run: Run
    moments: Moments
    drawn: Drawn
    layers: Array
    """(draws, rows, depths) [°C]"""
    core: Array
    """(draws, rows) [°C]"""

    @classmethod
    def of(cls, pressed: Pressed, settings: Mapping[str, float]) -> _Solved:
        made, moments = changed(pressed.run, pressed.press, pressed.moments, settings)
        if made.time_s[-1] - made.time_s[0] > LONGEST_S:
            raise InputError(say("what-if-too-long", most=LONGEST_S))
        made = made.at_rows(np.unique(np.linspace(0, len(made.time_s) - 1, ROWS).astype(int)))
        drawn = draw(made, pressed.press, pressed.model, moments)
        solved = solve_many(pressed.model.model(pressed.press), drawn.cases, drawn.values)
        layers, core = (np.stack([s.places[:, at] for s in solved]) for at in (slice(-1), -1))
        return cls(made, moments, drawn, layers, core)

    def cure(self, resin: Resin | None, live: LiveAndDrawn | None) -> Band:
        """Return the cure of the less cured face, near normal in ln equivalent time."""
        if resin is None:
            return Band(*np.full((3, len(self.run.time_s)), np.nan))
        kinetics, errors = kinetics_of(resin), self.drawn.draws.of(KINETICS).T
        faces = np.stack([self.layers[:, :, 0], self.layers[:, :, -1]])
        equivalent = equivalent_course(kinetics, self.run.time_s, faces, errors).min(axis=0)
        log = Band.of(np.log(np.maximum(equivalent, 1e-30)), live)
        return Band(*(kinetics.cure(np.exp(x)) for x in (log.middle, log.low, log.high)))

    def steam(self, resin: Resin | None, live: LiveAndDrawn | None) -> Band:
        """Return the steam, near normal in ln p; not known without the panel's moisture."""
        rows = self.layers.shape[1]
        thin = np.unique(np.linspace(0, rows - 1, ROWS // STEAM_ROWS).astype(int))
        pressure = steam_of(self.drawn, self.layers[:, thin], resin)
        log = Band.of(np.log(pressure), live)
        return Band(*(np.exp(np.interp(np.arange(rows), thin, x)) for x in (log.middle, log.low, log.high)))
