"""The virtual press of the live demonstration: pressing after pressing in virtual time, all from one seed.

A whole cycle, from one panel's removal to the next one's, is solved at once, in a thread of its own and
one cycle ahead; asking for temperatures then only interpolates, so the press costs next to nothing at any
speed and never keeps a logger waiting, once the first cycle was asked for and solved. Two objects with the
same settings and seed, given the same panels, agree at all times: a summary can ask a second one for the
truth. Any thread may ask.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from daq.press.header import START, lasting_keys, panel_of
from daq.records import Array, Moments, Panel, PressState, Run
from daq.simulated.campaign_platens import Controller, draw_controller, draw_platens
from daq.simulated.campaign_sensors import CHANNELS, FACES, PLATENS, Chain, Fault, Nuisances, draw_fault, measure
from daq.simulated.effects import CHAIN_EFFECTS, draw_outside, for_run, split_names, usual_effect, with_outside
from daq.simulated.physics_pressing import BASE_COEFFICIENTS, Platen, Pressing
from daq.simulated.press_hands import Between, wander

GRID_S = 0.05
"""Between the temperatures a pressing is worked out at: twice a 10 Hz scan's pace. [s]"""
PANEL = "panel."
"""What header keys begin with that say what panel is pressed."""
PRESSURE = "setting.pressure_N_cm2"
MOISTURE = "panel.moisture_percent"
USUAL_MOISTURE_PERCENT = 8.0
"""Of panels without a stated one; at it, hidden evaporation has its usual size. [%]"""
_QUIET = replace(
    Nuisances(), quantum_K=0.0, skew_s=0.0, jitter=0.0, missing=0.0, burst_chance=0.0, loose_chance=0.0
)


@dataclass(frozen=True)
class VirtualPressSettings:
    """How the virtual press works. Pairs are ranges, drawn anew for each pressing."""

    setpoint_C: float = 200.0
    between_s: tuple[float, float] = (25.0, 45.0)
    first_panel_s: float | None = None
    """When the first panel is inserted. None: as after any other pressing."""
    open_before_s: tuple[float, float] = (5.0, 12.0)
    press_time_s: tuple[float, float] = (35.0, 75.0)
    open_after_s: tuple[float, float] = (25.0, 40.0)
    thickness_mm: float = 16.0
    coefficients: Mapping[str, float] = field(default_factory=lambda: dict(BASE_COEFFICIENTS))
    coefficient_spread: float = 0.06
    panel_spread: float = 0.05
    hide: Sequence[str] = ()
    """Effects of the contract, or faults outside it, that only the virtual press has."""
    nuisances: Nuisances = _QUIET
    """Quantisation, skew and missing values are the loggers' own."""
    keep: int = 4
    """Cycles whose temperatures stay in memory."""


@dataclass(frozen=True)
class Cycle:
    """One pressing and the idle time before it. Times in virtual seconds since the start."""

    number: int
    """Counts from 1."""
    start: float
    moments: Moments
    pressing: Pressing
    """With times of its own: add `start`."""
    header: Mapping[str, Any]
    """What people and the press's controller know of the pressing, as a run's header says it."""
    times: Array
    readings: Mapping[str, Array]
    """What the thermocouples give, before the loggers. [°C]"""
    core_C: Array
    top_C: Array
    bottom_C: Array
    """True, NaN without a panel."""
    plates: tuple[Array, Array]
    platens_end: tuple[float, float]

    @property
    def end(self) -> float:
        """The moment of removal."""
        return self.moments.removed_s


class VirtualPress:
    """The laboratory press with people around it.

    Time only needs to be asked for: `temperatures` and the truths solve what is missing. Asking for a
    time whose cycle has left memory raises ValueError.
    """

    def __init__(self, settings: VirtualPressSettings | None = None, seed: int = 0) -> None:
        self.settings = settings or VirtualPressSettings()
        self._seed = seed
        rng = np.random.default_rng([seed, 7])
        self.ambient = float(rng.uniform(20.0, 25.0))
        self._controller: Controller = draw_controller(rng)
        inside, outer = split_names(self.settings.hide)
        self.effects: Mapping[str, Mapping[str, float]] = {n: usual_effect(n) for n in inside}
        """What is hidden, at its usual size."""
        self.outside: Mapping[str, Mapping[str, float]] = {n: draw_outside(n, rng) for n in outer}
        self.faults: tuple[Fault, ...] = (draw_fault(rng, 60.0),) if "sensor_fault" in inside else ()
        self._lock = threading.Lock()
        self._worker = ThreadPoolExecutor(1, "virtual-press")
        self._cycles: deque[Cycle] = deque(maxlen=self.settings.keep)
        self._next: Future[Cycle] | None = None
        self._headers: list[tuple[int, Mapping[str, Any]]] = [(1, {})]
        """From which pressing on which header keys are stated of the panels, by rising number."""

    @property
    def panel(self) -> Panel:
        """The panels' nominal constants, as a run's header states them."""
        return Panel(
            "MDF", self.settings.thickness_mm / 1000.0, 740.0, 0.12, 1550.0, self.ambient, USUAL_MOISTURE_PERCENT
        )

    @property
    def cycles(self) -> tuple[Cycle, ...]:
        """The cycles in memory, oldest first; none before a time was asked for."""
        return tuple(self._cycles)

    def cycle(self, at_s: float) -> Cycle:
        """Return the cycle a virtual time lies in, solving cycles up to it.

        Also the first is solved by the worker: what a signal raises where the compiler runs is lost.
        """
        with self._lock:
            if self._next is None:
                self._next = self._solve(None)
            while not self._cycles or at_s >= self._cycles[-1].end:
                self._cycles.append(self._next.result())
                self._next = self._solve(self._cycles[-1])
            for cycle in reversed(self._cycles):
                if at_s >= cycle.start:
                    return cycle
        raise ValueError(f"virtual time {at_s:g} s: only {self._cycles[0].start:g} s and later is in memory")

    def coming(self, at_s: float) -> int:
        """Return the number of the first pressing whose panel is not in the press yet at a virtual time."""
        cycle = self.cycle(at_s)
        return cycle.number if at_s < cycle.moments.inserted_s else cycle.number + 1

    def set_panels(self, number: int, header: Mapping[str, Any]) -> None:
        """From a pressing on, lay in panels such as header keys say; what they do not say is the press's own.

        The start temperature is the first panel's alone, as where it is entered for the next panel.
        What a panel is, and the pressure, are obeyed; other keys stand in the cycle's header and change nothing. A
        pressing from there on that is solved already is solved anew, and comes in its place once that is done.
        """
        with self._lock:
            before = [entry for entry in self._headers if entry[0] < number]
            self._headers = [*before, (number, dict(header)), (number + 1, lasting_keys(header))]
            earlier = [cycle for cycle in self._cycles if cycle.number < number]
            ahead = self._cycles[-1].number + 1 if self._cycles else 1
            if self._next is None or number > ahead:
                return
            if number > 1 and not earlier:
                raise ValueError(f"pressing {number}: the one before it is no longer in memory")
            anew = self._solve(earlier[-1] if earlier else None)
        anew.result()  # whoever asks meanwhile sees the panel before
        with self._lock:
            shown = any(cycle.number == number for cycle in self._cycles)
            self._cycles = deque((c for c in self._cycles if c.number < number), maxlen=self.settings.keep)
            if shown:
                self._cycles.append(anew.result())
            self._next = self._solve(anew.result()) if shown else anew

    def temperatures(self, at_s: float) -> dict[str, float]:
        """Return what the 16 thermocouples give at a virtual time, with their imperfections. [°C]"""
        cycle = self.cycle(at_s)
        i, share = _place(cycle, at_s)
        return {n: float(v[i] + share * (v[i + 1] - v[i])) for n, v in cycle.readings.items()}

    def core(self, at_s: float) -> float:
        """Return the true core temperature, NaN without a panel. [°C]"""
        cycle = self.cycle(at_s)
        i, share = _place(cycle, at_s)
        if self.state(at_s) is PressState.IDLE:
            return float("nan")
        return float(np.interp(share, [0.0, 1.0], cycle.core_C[i : i + 2]))

    def state(self, at_s: float) -> PressState:
        """Return what the press is truly doing: closed between the middles of both ramps."""
        m = self.cycle(at_s).moments
        if at_s < m.inserted_s:
            return PressState.IDLE
        return PressState.CLOSED if m.closed_s <= at_s < m.opened_s else PressState.OPEN

    def closed(self, at_s: float) -> bool:
        """Return the limit switch."""
        return self.state(at_s) is PressState.CLOSED

    def _solve(self, before: Cycle | None) -> Future[Cycle]:
        number = 1 if before is None else before.number + 1
        stated = next(header for first, header in reversed(self._headers) if first <= number)
        return self._worker.submit(self._cycle, before, stated)

    def _cycle(self, before: Cycle | None, stated: Mapping[str, Any]) -> Cycle:
        from daq.simulated.campaign_places import solve_places  # compiled: not for who only asks what press it is

        number = 1 if before is None else before.number + 1
        start = 0.0 if before is None else before.end
        rng = np.random.default_rng([self._seed, 8, number])
        hidden = np.random.default_rng([self._seed, 9, number])
        pressing = self._draw(before, stated, rng)
        run_effects = {n: for_run(n, p, hidden) for n, p in self.effects.items()}
        if water := run_effects.get("moisture_evaporation"):
            water["moisture_percent"] *= (pressing.panel.moisture_percent or 0.0) / USUAL_MOISTURE_PERCENT
        physical = {n: p for n, p in run_effects.items() if n not in CHAIN_EFFECTS}
        if before is not None:
            physical.pop("initial_press_state", None)
        pressing = with_outside(replace(pressing, effects=physical), self.outside)
        plates = None if before is None else before.plates
        places = solve_places(pressing, self.outside, rim_contrast=1.0, plates=plates)
        chain = Chain.of(self.settings.nuisances, run_effects, self.faults)
        times = np.append(np.arange(0.0, pressing.end, GRID_S), pressing.end)
        curves = self._curves(pressing, places.channels, before, rng)
        readings = measure(curves, times, chain, self.ambient, rng)
        with_panel = times >= pressing.inserted
        return Cycle(
            number=number,
            start=start,
            moments=pressing.moments(start, start + pressing.end),
            pressing=pressing,
            header={"run": f"demo-{number:03d}", **self._header(stated, pressing, rng)},
            times=times,
            readings={name: readings[name] for name in CHANNELS},
            core_C=np.where(with_panel, places.core(times), np.nan),
            top_C=np.where(with_panel, places.mean.at("panel_top", times), np.nan),
            bottom_C=np.where(with_panel, places.mean.at("panel_bottom", times), np.nan),
            plates=places.mean.plates,
            platens_end=(
                float(pressing.platen_bottom.at(times[-1:])[0]),
                float(pressing.platen_top.at(times[-1:])[0]),
            ),
        )

    def _draw(self, before: Cycle | None, stated: Mapping[str, Any], rng: np.random.Generator) -> Pressing:
        s = self.settings
        inserted = float(rng.uniform(*s.between_s))
        if before is None and s.first_panel_s is not None:
            inserted = s.first_panel_s
        closed = inserted + float(rng.uniform(*s.open_before_s))
        opened = closed + float(rng.uniform(*s.press_time_s))
        end = opened + float(rng.uniform(*s.open_after_s))
        platens = draw_platens(self._controller, s.setpoint_C, (0.0, end + 1.0), ((closed, opened),), rng)
        if before is not None:
            platens = _continued(platens[0], before.platens_end[0]), _continued(platens[1], before.platens_end[1])
        k, c = np.exp(s.panel_spread * rng.standard_normal(2))
        start = self.ambient + float(rng.normal(0.0, 0.7))
        panel = panel_of(Run("", self._panel_header(stated, start), np.zeros(0), {}))
        spread = {
            n: float(h * np.exp(s.coefficient_spread * rng.standard_normal())) for n, h in s.coefficients.items()
        }
        return Pressing(
            panel=replace(panel, conductivity=panel.conductivity * k, heat_capacity=panel.heat_capacity * c),
            ambient=self.ambient,
            platen_bottom=platens[0],
            platen_top=platens[1],
            start=0.0,
            end=end,
            inserted=inserted,
            closed=closed,
            opened=opened,
            closing_ramp=float(rng.uniform(0.2, 1.0)),
            opening_ramp=float(rng.uniform(0.2, 0.5)),
            coefficients=spread,
            pressure=float(stated.get(PRESSURE, rng.choice([280.0, 320.0, 350.0, 380.0, 400.0]))),
        )

    def _panel_header(self, stated: Mapping[str, Any], start_C: float) -> dict[str, Any]:
        """Return the header keys of a panel: what is stated of it, and for the rest the press's own panels."""
        own = {
            "panel.material": "MDF",
            "panel.thickness_mm": self.settings.thickness_mm,
            MOISTURE: USUAL_MOISTURE_PERCENT,
            START: start_C,
        }
        return own | {key: value for key, value in stated.items() if key.startswith(PANEL)}

    def _header(self, stated: Mapping[str, Any], pressing: Pressing, rng: np.random.Generator) -> dict[str, Any]:
        start = pressing.panel.initial_temperature + rng.normal(0.0, self.settings.nuisances.start_error_K)
        return {
            **self._panel_header(stated, round(float(start), 2)),
            "ambient.temperature_C": round(self.ambient, 1),
            "setting.platen_temperature_C": self.settings.setpoint_C,
            "setting.pressure_N_cm2": pressing.pressure,
            "setting.press_time_s": round(pressing.opened - pressing.closed, 1),
            **stated,
        }

    def _curves(
        self,
        pressing: Pressing,
        panel: Mapping[str, Callable[[Array], Array]],
        before: Cycle | None,
        rng: np.random.Generator,
    ) -> dict[str, Callable[[Array], Array]]:
        """Return each channel's true temperature: on the hand until the insertion, then on the panel."""
        curves: dict[str, Callable[[Array], Array]] = {
            "platen_top": pressing.platen_top.at,
            "platen_bottom": pressing.platen_bottom.at,
        }
        between = Between(0.0, pressing.inserted, self.ambient, pressing.panel.initial_temperature)
        for column in (*FACES["top"], *FACES["bottom"]):
            first = self.ambient if before is None else float(before.readings[column][-1])
            curves[column] = _joined(*wander(between, first, rng), panel[column])
        return {name: curves[name] for name in (*PLATENS, *FACES["top"], *FACES["bottom"])}


def _joined(t: Array, values: Array, panel: Callable[[Array], Array]) -> Callable[[Array], Array]:
    return lambda at: np.where(at < t[-1], np.interp(at, t, values), panel(at))


def _continued(platen: Platen, last: float) -> Platen:
    """Return the platen without a jump from where the cycle before left it."""
    t = platen.step * np.arange(len(platen.values))
    return replace(platen, values=platen.values + (last - platen.values[0]) * np.exp(-t / 15.0))


def _place(cycle: Cycle, at_s: float) -> tuple[int, float]:
    x = (at_s - cycle.start) / GRID_S
    i = min(int(x), len(cycle.times) - 2)
    return i, min(x - i, 1.0)
