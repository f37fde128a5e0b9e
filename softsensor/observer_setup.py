"""From press, header and priors to the arrays of one filter of the live sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from daq.pressfile import Press, panel_of
from daq.records import Array, Moments, Run
from softsensor import kernels
from softsensor import observer_kernels as loops
from softsensor.case import Case
from softsensor.effects import find_effect
from softsensor.model import Build, ThermalModel
from softsensor.observer_priors import FOOTPRINT_SD, LAG_SD, SKIN, TIMING, Prior

PROFILE = 11
"""Points of a temperature profile."""


@dataclass(frozen=True)
class Bench:
    """What all filters of a run share: the press with the run's overrides, mesh, places."""

    press: Press
    run: Run
    columns: tuple[str, ...]
    """Panel channels, in the order of `place`."""
    place: loops.Integers
    labels: tuple[str, ...]
    effects: tuple[str, ...]
    """Every effect any filter uses; those with layers shape the mesh."""
    cases: dict[tuple[str, ...], Case] = field(default_factory=dict, compare=False)
    """Laid out once for each set of effects."""
    profiles: dict[tuple[str, ...], Array] = field(default_factory=dict, compare=False)
    """Weights that read a profile, of these cases (`PROFILE`, n)."""

    @cached_property
    def platens(self) -> tuple[str, ...]:
        """Columns of the measured boundary temperatures."""
        ends = (self.press.boundary.bottom, self.press.boundary.top)
        return tuple(end.column for end in ends if end.kind == "measured" and end.column is not None)

    @cached_property
    def lower(self) -> int:
        """Place of the panel's lower face, -1 where no sensor of it is known."""
        lower = [f"{layer}.bottom" for layer in self.press.panel_layers]
        return next((i for i, label in enumerate(self.labels) if label in lower), -1)

    @cached_property
    def alone(self) -> tuple[Bench, tuple[int, int]] | None:
        """The panel alone between its faces, and their places; None where they are not measured."""
        return _panel_bench(self) if self.press.has_states else None


@dataclass
class Filter:
    """One linearisation of the model with its belief. Arrays change in place."""

    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    at: Array
    """Where it is linearised, in prior units (P)."""
    stack: kernels.Stack
    tangents: kernels.Tangents
    d_boundary: Array
    state: kernels.State
    nonlinear: bool
    factors: loops.Factors
    chain: loops.Chain
    places: Array
    """Weights of the chain's outputs: places, press faces opposite them, core (2 M + 1, n)."""
    moving: loops.Integers
    profile: Array
    """Weights that read the temperature at even heights from lower to upper face (PROFILE, n)."""
    start_C: float  # noqa: N815
    """The panel's initial temperature as the header says. [°C]"""

    @property
    def timing_units(self) -> tuple[float, ...]:
        """Seconds for one unit of each of `TIMING`."""
        found = {p.name: p.sd for p in self.priors}
        return tuple(found.get(name, 1.0) for name in TIMING)

    def shift(self, name: str) -> float:
        """Return where a parameter is linearised, as a difference to its prior's centre."""
        return float(self.at[self.names.index(name)] * self.priors[self.names.index(name)].sd)


def prepare_bench(press: Press, run: Run, effects: Sequence[str]) -> Bench:
    """Check a run's first scan against the press. Raises InputError."""
    sensors = press.sensors_of(run)
    labels = tuple(dict.fromkeys(s.label for s in sensors.values()))
    place = np.array([labels.index(s.label) for s in sensors.values()], dtype=np.int64)
    return Bench(press, run, tuple(sensors), place, labels, tuple(effects))


def with_platens(bench: Bench, platens: Sequence[float]) -> Bench:
    """Return the bench with boundary temperatures (bottom, top) where the first scan had none. [°C]"""
    ends = (bench.press.boundary.bottom, bench.press.boundary.top)
    known = {
        end.column: np.full(len(bench.run.time_s), t) for end, t in zip(ends, platens, strict=True) if end.column
    }
    columns = {
        name: known[name] if name in known and np.isnan(v[0]) else v for name, v in bench.run.columns.items()
    }
    return replace(bench, run=replace(bench.run, columns=columns), cases={}, profiles={})


def fresh_consensus(bench: Bench) -> loops.Consensus:
    """Return what is known of a run's channels before the first reading."""
    count = len(bench.place)
    return loops.Consensus(
        place=bench.place,
        shift=np.zeros(count),
        scatter=np.full(count, 0.04),
        seen=np.zeros(count),
        level=np.full(len(bench.labels), np.nan),
    )


_IN_PANEL = (
    "moisture_evaporation",
    "vapour_convection",
    "conductivity_temperature",
    "heat_capacity_temperature",
    "conductivity_offset",
    "heat_capacity_offset",
    "density_profile",
    "edge_loss",
)
"""Effects that act inside the panel."""


def _panel_bench(bench: Bench) -> tuple[Bench, tuple[int, int]] | None:
    layers = bench.press.panel_layers
    wanted = [f"{layer}.{side}" for layer in layers for side in ("bottom", "top")]
    if len(layers) != 1 or any(label not in bench.labels for label in wanted):
        return None
    header = {k: v for k, v in bench.run.header.items() if k.partition(".")[0] in ("panel", "ambient", "setting")}
    start = panel_of(bench.run).initial_temperature
    columns = {label: np.full(len(bench.run.time_s), start) for label in wanted}
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
    run = Run("faces", header, bench.run.time_s, columns, bench.run.source)
    inside = tuple(name for name in bench.effects if name in _IN_PANEL)
    alone = Bench(press, run, (), np.zeros(0, np.int64), (), inside)
    return alone, (bench.labels.index(wanted[0]), bench.labels.index(wanted[1]))


def make_filter(
    bench: Bench, priors: Sequence[Prior], fixed: Mapping[str, float], at: Array, effects: Sequence[str]
) -> Filter:
    """Build a filter linearised at `at` (P, prior units), with the `fixed` effect parameters beside."""
    model = ThermalModel(bench.press, tuple(find_effect(name) for name in effects))
    names = tuple(p.name for p in priors)
    values = dict(fixed)
    units = np.ones(-(-len(names) // 4) * 4)
    for i, p in enumerate(priors):
        value = p.centre + at[i] * p.sd
        values[p.name] = float(np.exp(value)) if p.logarithmic else value
        units[i] = values[p.name] * p.sd if p.logarithmic else p.sd
    key = tuple(effects)
    if key not in bench.cases:
        bench.cases[key] = model.prepare(bench.run, Moments(closed_s=0.0), max_step_s=60.0)
        bench.profiles[key] = _profile(bench, bench.cases[key])
    case = bench.cases[key]
    build = model.build(case, {k: v for k, v in values.items() if k not in TIMING}, names)
    if len(units) != build.width:
        raise AssertionError(f"tangents have {build.width} rows for {len(names)} parameters")
    if SKIN in names:
        inside = np.flatnonzero(case.layout.wet)
        for i in (inside[0], inside[-1]):
            build.tangents.c[names.index(SKIN), i] += 1.0 / case.mesh.dx[i]
    return _arrays(bench, case, build, priors, units, at, bench.profiles[key])


def _arrays(
    bench: Bench, case: Case, build: Build, priors: Sequence[Prior], units: Array, at: Array, profile: Array
) -> Filter:
    """Bring tangents to prior units and lay out the measuring chain."""
    names = tuple(p.name for p in priors)
    p, m = len(names), len(bench.labels)
    by_row = units[:, None]
    t = build.tangents
    tangents = kernels.Tangents(
        t.k * by_row, t.k_slope * by_row, t.c * by_row, t.c_slope * by_row, t.exchange * by_row,
        t.contact * units, t.emissivity * units, t.convection * units, t.flux * units,
        t.heat * by_row, t.law * units,
    )  # fmt: skip
    h, drive = case.h, build.drive
    zero = np.zeros((1, drive.factor.shape[1]))
    factors = loops.Factors(
        edges=case.edges,
        total=np.concatenate([zero, np.cumsum(drive.factor * h[:, None], axis=0)]),
        d_total=np.concatenate(
            [
                np.zeros((1, *drive.d_factor.shape[1:])),
                np.cumsum(drive.d_factor * units * h[:, None, None], axis=0),
            ]
        ),
    )
    start = build.start
    state = start._replace(s=start.s * by_row, s_before=start.s_before * by_row, s_done=start.s_done * by_row)
    rows = [case.labels.index(label) for label in bench.labels]
    places = np.concatenate([case.places[rows], case.press_face[rows], case.places[-1:]])
    chain = loops.Chain(
        opposite=np.asarray(case.press_face[rows].any(axis=1)),
        lag=float(build.terms.lag) + max(float(build.terms.clock), 0.0),
        footprint=float(build.terms.footprint),
        true=np.zeros(m),
        d_true=np.zeros((m, p + 2)),
        read=np.zeros(m),
        d_read=np.zeros((m, p + 2)),
        level=np.zeros(2),
        d_level=np.zeros(p),
    )
    loops.settle(state, chain, places)
    return Filter(
        names=names,
        priors=tuple(priors),
        at=at,
        stack=build.stack,
        tangents=tangents,
        d_boundary=drive.d_boundary * units,
        state=state,
        nonlinear=build.nonlinear,
        factors=factors,
        chain=chain,
        places=np.ascontiguousarray(places),
        moving=np.array([names.index(t) if t in names else -1 for t in TIMING], dtype=np.int64),
        profile=profile,
        start_C=case.panel.initial_temperature if case.panel is not None else float(state.t.mean()),
    )


def _profile(bench: Bench, case: Case) -> Array:
    """Return the weights of a profile through the panel, empty where there is none."""
    layers = bench.press.panel_layers
    if not layers or case.panel is None:
        return np.zeros((0, len(case.mesh.dx)))
    heights = np.linspace(0.0, case.panel.thickness, PROFILE)
    return np.stack([case.mesh.place(layers[0], float(h)) for h in heights])


CHAIN_UNITS = (LAG_SD, FOOTPRINT_SD)
"""Prior standard deviation of the two parameters of the measuring chain. [s, -]"""
