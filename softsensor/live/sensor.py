"""The live sensor: core temperature with a band one can trust, scan by scan.

Method (decided 2026-11, see also `live.priors`). The thermal model marches with the platens; forward tangents
say how faces and core answer to every uncertain parameter. A Kalman filter over these parameters (coefficients,
start temperature, platen offsets, moments, biases of the readings, and causes the model in force leaves out) is
corrected by one robust mean a face; constants in doubt are considered, not estimated (`live.directions`). The
state estimate is a joint Gaussian; "no cause is missing" and "this cause is missing" are hypotheses it is
conditioned on (`live.mixture_steps.condition`), so that the band is a Gaussian mixture: narrow while the faces
agree with the plain model, wide or moved when they do not. Evaporation and steam, whose tangents at zero say
little about their real size, have filters of their own.

When the estimate moves far from where the model was linearised, or a moment of the press becomes known
(always a little late), the stored scans are gone through again from the start, some blocks with each new
scan, while the pass before goes on answering: no scan waits for it. A filter that has not moved goes on as it is.
Everything is a function of the scans so far: replay and live agree, and a run cut short gives the same rows.

What is reported as the core, and as profile and heat, is what all hypotheses expect together, each by its
probability. Until 2026-11-23 it was what the model in force says: with a cause that nobody had diagnosed yet, the
number was 7.4 K off where it is 2.0 K now, in the same band (nine virtual runs; moist pine with a measured core
after one earlier run 5.6 and 3.2 K; without a cause to be found no worse than 0.1 K;
``python -m tests.calibration.live_band``).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.press.press_file import Press
from daq.press.resin_file import Resin
from daq.printed import in_notebook, on_screen
from daq.records import PressState, Run, StartNotRead
from softsensor.heat.model_file import ModelFile
from softsensor.live.blocks import ScanArrays
from softsensor.live.consistency import Stillness
from softsensor.live.contact_loads import HeldLoads
from softsensor.live.curing import resin_setup
from softsensor.live.following import PressFollower
from softsensor.live.forecast import Forecast, look_ahead, wishes_of
from softsensor.live.inside import Inside
from softsensor.live.leaving import Leave
from softsensor.live.mixture import Mixture
from softsensor.live.panels import LikelyPanel, likely_panels
from softsensor.live.passes import Pass, Passes
from softsensor.live.platens import HeldPlatens
from softsensor.live.possible import Possible
from softsensor.live.setup import RunSetup, with_platens
from softsensor.live.validity import Invalid, InvalidReason
from softsensor.signals.doubt import nearest_of

# Numbers without another source were set by hand, 2026-11.

MISFIT_LIMIT = 9.0
"""Mean squared normalised innovation over 10 s beyond which the model is not valid: three deviations, for 10 s."""
HOLE_LIMIT = MISFIT_LIMIT
"""Mean squared normalised innovation of two faces after a hole in the scans, beyond which the clock has jumped or
something has happened meanwhile: by chance once in 8,000 holes (chi squared of two beyond 18). Six virtual
pressings: 0.1 to 0.4 after 25 s without scans, 10 and more after a clock that jumps by 25 s."""
FALSE_ALARM = math.exp(-HOLE_LIMIT)
"""Chance of a right model's states to be drawn beyond what is allowed: that of `HOLE_LIMIT`."""
WIDEST_K = 25.0
"""Half-width of a band beyond which the core is not observable. Set by hand, 2026-11. [K]"""
OF_THE_CORE_ALONE = (InvalidReason.BAND_TOO_WIDE, InvalidReason.ANOTHER_PANEL)
"""Reasons that leave the faces known."""
NUMBERS = ("core_C", "core_sd_K", "core_low_C", "core_high_C")
LEAVES = ("cure_top", "cure_bottom", "cure_low", "steam_kPa", "steam_high_kPa")
"""Of an estimate, and of its leave: numbers that a table of estimates has."""
FORECAST_S = 2.0
"""How often the sensor looks ahead. [s]"""


@dataclass(frozen=True, repr=False)
class Estimate:
    """What the live sensor says at one scan."""

    time_s: float
    """When the scan was taken, on the run's clock. [s]"""
    state: PressState | None
    """None: unknown."""
    core_C: float = math.nan  # noqa: N815
    """The core's temperature as far as is known; NaN where nothing is. [°C]"""
    core_sd_K: float = math.nan  # noqa: N815
    """Its standard deviation. [K]"""
    core_low_C: float = math.nan  # noqa: N815
    """Lower bound of 95 %. [°C]"""
    core_high_C: float = math.nan  # noqa: N815
    """Upper bound of 95 %. [°C]"""
    invalid: Invalid | None = None
    """Why it is not to be believed; None: it is valid."""
    suspected: str = ""
    """The cause the readings point to, where one is likelier than none."""
    leave: Leave | None = None
    """Cure, steam and limits; None without a resin, and while this is not to be believed for another reason than
    that the core's band is wide."""
    open_now: bool = False
    """Whether the press is closed and every limit holds with the wanted probability; else, and where anything is
    not known, false."""

    @property
    def valid(self) -> bool:
        """Whether the core is to be believed."""
        return self.invalid is None

    @property
    def reason(self) -> InvalidReason | None:
        """Why it is not valid, without the arguments."""
        return None if self.invalid is None else self.invalid.reason

    def row(self) -> dict[str, float | int | str]:
        """Return it as a row of ``predict --out`` with a resin; NaN where something is not known."""
        leave = self.leave or Leave()
        return {
            "time_s": self.time_s,
            "state": "unknown" if self.state is None else str(self.state),
            **{name: float(getattr(self, name)) for name in NUMBERS},
            "valid": int(self.valid),
            "reason": "" if self.invalid is None else self.invalid.line,
            **{name: float(getattr(leave, name)) for name in LEAVES},
            "open_now": int(self.open_now),
        }

    def to_json(self) -> str:
        """Return its row of ``predict --out`` as JSON; null where something is not known."""
        return json.dumps({name: None if value != value else value for name, value in self.row().items()})

    __repr__ = on_screen
    _repr_html_ = in_notebook


@dataclass
class _Followed:
    """What follows a run from its first scan on."""

    panels: tuple[LikelyPanel, ...]
    """That may lie in the press, the header's first."""
    scans: ScanArrays
    press: PressFollower
    passes: Passes
    platens: HeldPlatens
    loads: HeldLoads
    still: Stillness
    possible: Possible

    @property
    def setup(self) -> RunSetup:
        """Press, mesh and places as the header says."""
        return self.panels[0].setup

    @property
    def outside(self) -> tuple[float, ...]:
        """Temperatures of the boundaries, bottom and top, and logarithms of the contacts' loads. [°C, -]"""
        return (*self.platens.values, *self.loads.logs)


class ScanSensor:
    """Takes scans and says what the core is doing.

    Parameters
    ----------
    press
        The press file.
    header
        The run's header: panel, ambient, settings.
    model
        Coefficients and effects from earlier runs; None starts from the press file's guesses.
    resin
        How the paper cures and what must hold at opening; None: nobody asks.
    """

    def __init__(
        self, press: Press, header: Mapping[str, Any], model: ModelFile | None = None, resin: Resin | None = None
    ) -> None:
        self._press, self._header, self._model = press, dict(header), model
        self._resin = None if resin is None else resin_setup(resin, header, press)
        self._run: _Followed | None = None
        self._wishes = wishes_of(header)
        self._forecast, self._forecast_s = Forecast(), -math.inf

    def update(self, time_s: float, values: Mapping[str, float]) -> Estimate:
        """Take a scan (missing values NaN or left out) and say what the core is doing now."""
        run = self._run = self._run or self._begin(values)
        measured = (*run.setup.platens, *run.setup.columns)
        readings = np.array([values.get(c, math.nan) for c in measured])
        frozen = run.still.frozen(time_s, readings)
        unread = run.still.unread(frozen=frozen)
        if unread is not None:
            values = dict(values) | dict.fromkeys(np.array(measured)[unread].tolist(), math.nan)
            readings[unread] = math.nan
        moments = run.press.detect(time_s, values)
        run.passes.forget(moments)
        run.loads.note(values)
        if not run.platens.note(time_s, values):
            return Estimate(time_s, run.press.state, invalid=Invalid(InvalidReason.PLATEN_READING_MISSING))
        run.possible.note(run.platens.measured)
        if not len(run.scans):
            known = [with_platens(panel.setup, run.platens.values) for panel in run.panels]
            run.panels = tuple(replace(p, setup=setup) for p, setup in zip(run.panels, known, strict=True))
            run.press.note_first_platens(time_s)
        run.scans.append(time_s, run.outside, readings[len(run.setup.platens) :])
        silenced = run.still.silence(run.scans, frozen=frozen)
        disagrees = run.press.check_start()
        current = run.passes.current
        run.press.receive(time_s, None if current is None else current.chain.read)
        try:
            run.passes.advance(run.panels, run.scans, run.press, stale=bool(moments) or silenced or disagrees)
        except StartNotRead:  # of this scan; the run begins with the next
            self._run = None
            return Estimate(time_s, run.press.state, invalid=Invalid(InvalidReason.START_NOT_READ))
        except (ArithmeticError, np.linalg.LinAlgError):
            run.passes.drop()
            return Estimate(time_s, run.press.state, invalid=Invalid(InvalidReason.CALCULATION_FAILED))
        return self._estimate(run, time_s)

    @property
    def inside(self) -> Inside | None:
        """Profile and heat of the panel at the newest scan; None without a panel or before it is known."""
        current = self._run.passes.current if self._run is not None else None
        if self._run is None or current is None or self._run.press.state is PressState.IDLE:
            return None
        return current.inside

    @property
    def left_out(self) -> dict[str, float]:
        """Channels that read something else than their neighbours and lost their vote, and by how much. [K]

        Without a panel in the press there are none: what hangs in air shares no face, and no fit looks at it.
        """
        run = self._run
        if run is None or run.press.state is PressState.IDLE:
            return {}
        return {run.setup.columns[k]: away for k, away in run.scans.left_out().items()}

    @property
    def departing(self) -> dict[str, float]:
        """Channels that read something else than their neighbours at this scan, and by how much. [K]

        None once the press has opened again: as the panel leaves, its sensors come off one after another.
        """
        run = self._run
        if run is None or run.press.state is PressState.IDLE or math.isfinite(run.press.known.moments.opened_s):
            return {}
        return {run.setup.columns[k]: away for k, away in run.scans.departing().items()}

    @property
    def band_from(self) -> dict[str, float]:
        """Share of the band's variance by where it comes from (`live.budget.KINDS`), empty before there is one."""
        current = self._run.passes.current if self._run is not None else None
        return {} if current is None else current.band_from

    @property
    def mixture(self) -> Mixture | None:
        """The core at the newest block of scans, hypothesis by hypothesis; None before that."""
        current = self._run.passes.current if self._run is not None else None
        return None if current is None else current.mixture

    @property
    def limited(self) -> bool | None:
        """Whether the resin file has a limit that decides when to open; None without one."""
        return None if self._resin is None else self._resin.limits.any

    @property
    def forecast(self) -> Forecast:
        """What lies ahead for what the header wants of the core, as `look_ahead` last found it."""
        if self._run is None or not len(self._run.scans):
            return self._forecast
        return self._forecast.later(self._run.scans.now - self._forecast_s)

    def look_ahead(self) -> None:
        """Work out what lies ahead, where that matters, every `FORECAST_S`. Takes 30 to 100 ms."""
        run = self._run
        current = run.passes.current if run is not None else None
        if run is None or current is None or not (self._wishes.any or self._resin is not None):
            return
        if run.passes.overtaken:  # it would march on in the state that the press has left
            return
        if not math.isfinite(run.press.known.moments.closed_s) or run.scans.now - self._forecast_s < FORECAST_S:
            return
        now, state = run.scans.now, run.press.state
        self._forecast_s, self._forecast = now, Forecast()
        if state is PressState.CLOSED or state is PressState.OPEN:
            done = float(run.scans.time[current.done - 1])
            found = look_ahead(current, self._wishes, state, done, np.array(run.outside), run.possible)
            self._forecast = found.later(now - done)

    def _begin(self, values: Mapping[str, float]) -> _Followed:
        """Lay out what follows a run whose first scan has these columns. Raises InputError."""
        times = np.linspace(-2.0, 900.0, 24)  # close enough that no gap needs bridging
        columns = {name: np.full(len(times), v) for name, v in values.items()}
        run = Run("live", self._header, times, columns, "live")
        likely = likely_panels(self._press, run, self._model)
        panels = tuple(replace(p, setup=replace(p.setup, resin=self._resin)) for p in likely)
        setup = panels[0].setup
        loads = HeldLoads(setup.press)
        scans = ScanArrays(setup.place, len(setup.labels), len(loads.logs))
        still = Stillness(setup.place, len(setup.labels), len(setup.platens))
        platens = HeldPlatens(setup.press)
        press, possible = PressFollower(setup, scans), Possible(setup)
        return _Followed(panels, scans, press, Passes(self._model), platens, loads, still, possible)

    def _estimate(self, run: _Followed, time_s: float) -> Estimate:
        state, current = run.press.state, run.passes.current
        if state is None:
            return Estimate(time_s, None, invalid=Invalid(InvalidReason.PRESS_STATE_UNKNOWN))
        if current is None or current.mixture is None or run.platens.lost(time_s):
            return Estimate(time_s, state, invalid=Invalid(InvalidReason.PLATEN_READING_MISSING))
        mixture = current.mixture
        since_s = time_s - float(run.scans.time[current.done - 1])
        ahead = float(current.chain.level[1]) * since_s
        core, can_be = mixture.core_C + ahead, run.possible
        low, high = (can_be.within(t + ahead) for t in (mixture.low_C, mixture.high_C))
        invalid = can_be.contradicted(core) or _why_invalid(run, current, mixture, time_s)
        known = invalid is None or invalid.reason in OF_THE_CORE_ALONE
        leave = None
        if known and self._resin is not None and current.known_panel is not None:
            leave = current.known_panel.leave(self._resin, since_s, ahead)
        return Estimate(
            time_s=time_s,
            state=state,
            core_C=core,
            core_sd_K=mixture.sd_K,
            core_low_C=min(low, core),
            core_high_C=max(high, core),
            invalid=invalid,
            suspected=mixture.leading,
            leave=leave,
            open_now=invalid is None and state is PressState.CLOSED and self._holds(leave),
        )

    def _holds(self, leave: Leave | None) -> bool:
        return leave is not None and self._resin is not None and leave.holds(self._resin.limits.probability)


def _why_invalid(run: _Followed, current: Pass, mixture: Mixture, time_s: float) -> Invalid | None:
    """Return why the core is not to be believed, None where it is: the first that applies."""
    if (invalid := run.press.contradicted(current.missed_K)) is not None:
        return invalid
    if run.setup.unknown_constants:
        return Invalid(InvalidReason.CONSTANTS_UNKNOWN)
    far = current.misfit > MISFIT_LIMIT or current.far_fetched(FALSE_ALARM)
    if (far and not mixture.by_faces) or current.across > HOLE_LIMIT:
        return Invalid(InvalidReason.READINGS_CONTRADICT_MODEL)
    if (invalid := run.press.unseen(time_s, overtaken=run.passes.overtaken)) is not None:
        return invalid
    if mixture.high_C - mixture.low_C <= 2.0 * WIDEST_K:
        return None
    thicknesses = [panel.thickness_mm for panel in run.panels]
    if len(set(thicknesses)) > 1:
        nearest = nearest_of([mm for i, mm in enumerate(thicknesses) if i == 0 or mm != thicknesses[0]])
        return Invalid(InvalidReason.ANOTHER_PANEL, {**nearest, "limit_K": WIDEST_K})
    return Invalid(InvalidReason.BAND_TOO_WIDE, {"limit_K": WIDEST_K})
