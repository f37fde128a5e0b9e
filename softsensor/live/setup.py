"""From press, header and priors to the linearised model of one filter of the live sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from daq.press.header import panel_of
from daq.press.press_file import SD, InitialKind, Press, label_of
from daq.records import Array, Moments, Run
from softsensor.effects import Role, find_effect
from softsensor.heat import implicit_steps as kernels
from softsensor.heat.build import Build
from softsensor.heat.case import Case
from softsensor.heat.model import ThermalModel
from softsensor.heat.model_file import ModelFile
from softsensor.live.channel_steps import Integers
from softsensor.live.contact_loads import over_loads
from softsensor.live.curing import ResinSetup
from softsensor.live.directions import MOST_SHARE, Unowned, directions_of
from softsensor.live.march_steps import ByLoad, Factors, LinearModel, SensorChain, settle_sensors
from softsensor.live.priors import SKIN, TIMING, FilterPlan
from softsensor.signals.doubt import constant_doubts
from softsensor.signals.instrument import START_K
from softsensor.signals.unknown import Unknown

PROFILE = 11
"""Points of a temperature profile."""


@dataclass(frozen=True)
class RunSetup:
    """What all filters of a run share: the press with the run's overrides, mesh, places."""

    press: Press
    run: Run
    columns: tuple[str, ...]
    """Panel channels, in the order of `place`."""
    place: Integers
    labels: tuple[str, ...]
    effects: tuple[str, ...]
    """Every effect any filter uses; those with layers shape the mesh."""
    start_C: float  # noqa: N815
    """The panel's initial temperature as the header says, NaN without a panel. [°C]"""
    directions: tuple[Unowned, ...]
    """Parameters that no effect owns."""
    fixed: Mapping[str, float] = field(default_factory=dict)
    """What says how an effect of the model goes and is not in doubt, by full name."""
    resin: ResinSetup | None = None
    """How the paper cures and what must hold at opening, where that is asked for."""
    cases: dict[tuple[str, ...], Case] = field(default_factory=dict, compare=False)
    """Laid out once for each set of effects."""
    profiles: dict[tuple[str, ...], Array] = field(default_factory=dict, compare=False)
    """Weights that read a profile, of these cases (`PROFILE`, n)."""

    @cached_property
    def unknown_constants(self) -> bool:
        """Whether one of the constants may be off by so much that it is not known."""
        return any(d.prior.sd > MOST_SHARE for d in self.directions if d.is_constant)

    @cached_property
    def stated(self) -> frozenset[str]:
        """Keys of the header whose standard deviation stands beside them."""
        return frozenset(key.removesuffix(SD) for key in self.run.header if key.endswith(SD))

    @cached_property
    def start_sd(self) -> float:
        """How far the header's start temperature may be from the truth. [K]"""
        found = constant_doubts(self.run.header, self.press).get("panel.initial_temperature_C")
        return START_K if found is None else found.sd

    @cached_property
    def platens(self) -> tuple[str, ...]:
        """Columns of the measured boundary temperatures."""
        return self.press.platens

    @cached_property
    def lower(self) -> int:
        """Place of the panel's lower face, -1 where no sensor of it is known."""
        lower = [f"{layer}.bottom" for layer in self.press.panel_layers]
        return next((i for i, label in enumerate(self.labels) if label in lower), -1)

    @cached_property
    def alone(self) -> tuple[RunSetup, tuple[int, int]] | None:
        """The panel alone between its faces, and their places; None where they are not measured."""
        return _panel_alone(self) if self.press.has_states else None


@dataclass(frozen=True)
class Linearised:
    """The thermal model about one set of parameters; what `model` holds changes in place."""

    names: tuple[str, ...]
    priors: tuple[Unknown, ...]
    at: Array
    """Where it is linearised, in prior units (P)."""
    model: LinearModel
    profile: Array
    """Weights that read the temperature at even heights from lower to upper face (PROFILE, n)."""
    start_C: float  # noqa: N815
    """The panel's initial temperature as the header says. [°C]"""

    @cached_property
    def loose(self) -> Array:
        """Share of each considered parameter's variance whose size is known only within a range (C)."""
        return np.array([prior.loose for prior in self.priors if prior.considered])

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """Which parameters are estimated, not only considered (P)."""
        return np.array([not prior.considered for prior in self.priors])

    @property
    def timing_units(self) -> tuple[float, ...]:
        """Seconds for one unit of each of `TIMING`."""
        found = {p.name: p.sd for p in self.priors}
        return tuple(found.get(name, 1.0) for name in TIMING)

    def shift(self, name: str) -> float:
        """Return where a parameter is linearised, as a difference to its prior's centre."""
        return float(self.at[self.names.index(name)] * self.priors[self.names.index(name)].sd)


def set_up(press: Press, run: Run, model: ModelFile | None, *, new_product: bool = False) -> RunSetup:
    """Check a run's first scan against the press. Raises InputError.

    `new_product` says that no earlier run had such a panel.
    """
    effects = tuple(name for name, _ in model.effects) if model else ()
    sensors = press.sensors_of(run)
    labels = tuple(dict.fromkeys(s.label for s in sensors.values()))
    place = np.array([labels.index(s.label) for s in sensors.values()], dtype=np.int64)
    panel = panel_of(run) if press.panel_layers else None
    start = panel.initial_temperature if panel is not None else math.nan
    directions = directions_of(press, run, panel, model, new_product=new_product)
    fixed = {
        effect.key(p.name): table[p.name].value
        for effect, (_, table) in zip(map(find_effect, effects), model.effects if model else (), strict=True)
        for p in effect.parameters
        if p.fixed and p.name in table
    }
    return RunSetup(press, run, tuple(sensors), place, labels, effects, start, directions, fixed)


def with_platens(setup: RunSetup, platens: Sequence[float]) -> RunSetup:
    """Return the set-up with boundary temperatures (bottom, top) where the first scan had none. [°C]"""
    ends = (setup.press.boundary.bottom, setup.press.boundary.top)
    known = {
        end.column: np.full(len(setup.run.time_s), t) for end, t in zip(ends, platens, strict=True) if end.column
    }
    columns = {
        name: known[name] if name in known and np.isnan(v[0]) else v for name, v in setup.run.columns.items()
    }
    return replace(setup, run=replace(setup.run, columns=columns), cases={}, profiles={})


_IN_PANEL = (Role.HYPOTHESIS, Role.OWN_FILTER)
"""Roles of effects that act inside the panel."""


def _panel_alone(setup: RunSetup) -> tuple[RunSetup, tuple[int, int]] | None:
    layers = setup.press.panel_layers
    wanted = [f"{layer}.{side}" for layer in layers for side in ("bottom", "top")]
    if len(layers) != 1 or any(label not in setup.labels for label in wanted):
        return None
    header = {k: v for k, v in setup.run.header.items() if k.partition(".")[0] in ("panel", "ambient", "setting")}
    start = setup.start_C
    columns = {label: np.full(len(setup.run.time_s), start) for label in wanted}
    press = Press.model_validate(
        {
            "layer": [{"name": layers[0], "from_run": True}],
            "boundary": {
                side: {"kind": "measured", "column": label}
                for side, label in zip(("bottom", "top"), wanted, strict=True)
            },
            "initial": {"kind": "uniform", "temperature_C": start},
        }
    )
    run = Run("faces", header, setup.run.time_s, columns, setup.run.source)
    inside = tuple(name for name in setup.effects if find_effect(name).live.role in _IN_PANEL)
    own = tuple(d for d in setup.directions if d.layers and set(d.layers) <= set(layers))
    alone = RunSetup(press, run, (), np.zeros(0, np.int64), (), inside, start, own, setup.fixed)
    return alone, (setup.labels.index(wanted[0]), setup.labels.index(wanted[1]))


def linearise(setup: RunSetup, plan: FilterPlan, at: Array) -> Linearised:
    """Build the model of a plan, linearised at `at` (P, prior units)."""
    effects = tuple(dict.fromkeys([*setup.effects, *plan.effects]))
    thermal = ThermalModel(setup.press, tuple(find_effect(name) for name in effects))
    names = tuple(p.name for p in plan.priors)
    values, units = _values(plan.priors, effects, at)
    values |= {name: value for name, value in setup.fixed.items() if name in values}
    if effects not in setup.cases:
        setup.cases[effects] = thermal.prepare(setup.run, Moments(closed_s=0.0), max_step_s=60.0)
        setup.profiles[effects] = _profile(setup, setup.cases[effects])
    case = setup.cases[effects]
    known = {k: v for k, v in values.items() if k not in TIMING}
    build = thermal.build(case, known, names)
    if len(units) != build.width:
        raise AssertionError(f"tangents have {build.width} rows for {len(names)} parameters")
    by_load = _by_load(case, build, thermal, known, units)
    if SKIN in names:
        inside = np.flatnonzero(case.layout.wet)
        for i in (inside[0], inside[-1]):
            build.tangents.c[names.index(SKIN), i] += 1.0 / case.mesh.dx[i]
    for direction in setup.directions:
        direction.tangents(names.index(direction.prior.name), case, build)
    if case.press.initial.kind is InitialKind.SENSORS:
        build = build.begun_at_rest(case)
    model = _model(setup, case, build, names, units, by_load)
    start = case.panel.initial_temperature if case.panel is not None else float(model.state.t.mean())
    return Linearised(names, tuple(plan.priors), at, model, setup.profiles[effects], start)


def _values(priors: Sequence[Unknown], effects: Sequence[str], at: Array) -> tuple[dict[str, float], Array]:
    """Return the parameters' values, and what one prior unit of each is (P, rounded up to fours)."""
    values = {e.key(p.name): p.neutral for e in map(find_effect, effects) for p in e.parameters}
    units = np.ones(-(-len(priors) // 4) * 4)
    for i, p in enumerate(priors):
        estimate = p.centre + at[i] * p.sd
        values[p.name], units[i] = p.value(estimate), p.slope(estimate) * p.sd
    return values, units


def _model(
    setup: RunSetup, case: Case, build: Build, names: Sequence[str], units: Array, by_load: ByLoad
) -> LinearModel:
    """Bring tangents to prior units and lay out the measuring chain."""
    by_row = units[:, None]
    t, drive = build.tangents, build.drive
    rows = [case.labels.index(label) for label in setup.labels]
    beside, moved = case.press_face[rows], np.full(len(rows), -1, dtype=np.int64)
    for direction in setup.directions:
        if direction.at is not None:
            a, column = setup.labels.index(label_of(direction.at)), names.index(direction.prior.name)
            beside[a] = units[column] * case.mesh.slope(direction.at.layer, direction.at.depth_mm / 1000.0)
            moved[a] = column
    places = np.concatenate([case.places[rows], beside, case.places[-1:]])
    s = build.start
    state = s._replace(s=s.s * by_row, s_before=s.s_before * by_row, s_done=s.s_done * by_row)
    chain = _chain(build, np.asarray(case.press_face[rows].any(axis=1)), moved, len(names))
    settle_sensors(state, chain, places)
    return LinearModel(
        stack=build.stack,
        tangents=kernels.Tangents(
            t.k * by_row, t.k_slope * by_row, t.c * by_row, t.c_slope * by_row, t.exchange * by_row,
            t.source * by_row, t.contact * units, t.emissivity * units, t.convection * units, t.flux * units,
            t.heat * by_row, t.law * units, t.bends * by_row,
        ),
        d_boundary=drive.d_boundary * units,
        nonlinear=build.nonlinear,
        factors=Factors(
            edges=case.edges,
            total=_running(drive.factor * case.h[:, None]),
            d_total=_running(drive.d_factor * units * case.h[:, None, None]),
            by_load=by_load,
        ),
        places=np.ascontiguousarray(places),
        moving=np.array([names.index(t) if t in names else -1 for t in TIMING], dtype=np.int64),
        state=state,
        chain=chain,
    )  # fmt: skip


def _by_load(case: Case, build: Build, thermal: ThermalModel, values: Mapping[str, float], units: Array) -> ByLoad:
    """Return by what contacts' factors change from the first scan's load to others."""
    if not case.press.load_references:
        return ByLoad(np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0, 0)))
    loaded, logs = over_loads(case)
    drives = build.drive, thermal.build(loaded, values, build.request.names).drive
    contacts = len(case.layout.interface)  # factors on sources stand behind theirs
    (first, d_first), (other, d_other) = ((d.factor[:, :contacts], d.d_factor[:, :contacts]) for d in drives)
    d_log = d_other / other[:, :, None] - d_first / first[:, :, None]
    return ByLoad(logs, np.log(other / first), d_log * units)


def _running(steps: Array) -> Array:
    """Return the running sum over steps, from 0."""
    return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])


def _chain(build: Build, opposite: NDArray[np.bool_], moved: Integers, parameters: int) -> SensorChain:
    m, p = len(opposite), parameters
    return SensorChain(
        opposite=opposite,
        moved=moved,
        lag=float(build.terms.lag) + max(float(build.terms.clock), 0.0),
        footprint=float(build.terms.footprint),
        true=np.zeros(m),
        d_true=np.zeros((m, p + 2)),
        read=np.zeros(m),
        d_read=np.zeros((m, p + 2)),
        level=np.zeros(2),
        d_level=np.zeros(p),
    )


def _profile(setup: RunSetup, case: Case) -> Array:
    """Return the weights of a profile through the panel, empty where there is none."""
    layers = setup.press.panel_layers
    if not layers or case.panel is None:
        return np.zeros((0, len(case.mesh.dx)))
    heights = np.linspace(0.0, case.panel.thickness, PROFILE)
    return np.stack([case.mesh.place(layers[0], float(h)) for h in heights])
