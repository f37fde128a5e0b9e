"""Parameters of the live sensor's filters that belong to no effect: doubtful constants, and what any model lacks.

*Constants* are as far off as `signals.doubt` says: the panel's, those of all layers of one material together, the
flux onto a face, the depth of a buried sensor. *Discrepancy* is what is left when every constant is right: a
contact that wanders while the press is closed, which is an unknown slow heat flux at the faces, and a small source
inside. No hypothesis makes these certain, and faces cannot separate them from coefficients: they are considered
(`kalman_steps`).
Estimated, with 20 % of freedom for k and c, they drew the core 1 to 3 K off on panels whose constants were exact
(held: 0.1 to 0.3 K) and left most of a pressing with a hidden cause without an answer (campaign seed 78,
2026-11-22). The *start* between two first readings is a parameter like any other.

The wander is a random walk in the logarithm of the time since closing, for contacts settle fast at first and ever
more slowly; its increments are ramps of that logarithm. A contact wanders within a pressing by what it differs
from pressing to pressing, which earlier runs show. The source takes heat in proportion to what a place is above
ambient; its size is the share of the core's rise that earlier runs leave open, and what bare sides of a stack
without a panel may lose (`PressTable.side_loss_W_m2K`). (Decided 2026-11-22.)
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from daq.materials import GRAIN_SD, is_solid_wood
from daq.press.header import listed_constants
from daq.press.press_file import SD, At, BoundaryKind, Press
from daq.records import Array, Panel, Run
from softsensor.heat.assembly import layer_constants
from softsensor.heat.build import Build
from softsensor.heat.case import Case
from softsensor.heat.first_profile import gap_priors
from softsensor.heat.model_file import MissingCauses, ModelFile
from softsensor.live.priors import coefficient_priors
from softsensor.signals.doubt import PANEL_TO_PANEL, PRODUCT_SD, Doubt, Origin, constant_doubts
from softsensor.signals.instrument import SPREAD_LOG, START_K
from softsensor.signals.unknown import Unknown

RAMPS_S = (2.0, 10.0, 50.0, 250.0)
"""A contact's wander rises from one of these times since closing to the next; before, the coefficient itself and
the catalogue's contact effects say how it begins. [s]"""
UNSEEN_SHARE = 0.1
"""Of a core's rise that the model may miss where no run was held against it: k and c of wood change by 12 to 30 %
over 100 K (the catalogue's ``conductivity_temperature`` and ``heat_capacity_temperature``), of which a pressing
sees half, and offset each other in part. By hand, 2026-11."""
UNEXPLAINED_PER_K = 1.5 / 40.0
"""What earlier runs leave unexplained at the faces counts one and a half times in a core that has risen by 40 K.
By hand. [1/K]"""
CONDUCTIVITY = "panel.conductivity_W_mK"
WITHIN_CAPACITY = {"panel.density_kg_m3": 0.0}
"""What panels of one press differ by in rho c is stated for both together (issue 18; a fit joins them,
`fitting.constants`): density's scatter is in it and does not count twice."""
MOST_SHARE = 0.5
"""A constant in doubt by more is not known: answers to it are no straight lines. By hand, 2026-11."""
LEAST_SHARE = 1e-3
"""A constant whose doubt changes the stack's whole resistance or capacity by less is left out. By hand."""
CONSTANT, DISCREPANCY = "constant", "discrepancy"
"""How names of the kinds begin."""


@dataclass(frozen=True)
class Unowned:
    """A parameter that no effect owns, in relative units, a depth in m: what it changes for 1."""

    prior: Unknown
    layers: tuple[str, ...] = ()
    conductivity: float = 0.0
    capacity: float = 0.0
    exchange: float = 0.0
    """[W/m³K]"""
    flux: int = -1
    """End whose absorbed flux it is, 0 or 1."""
    contact: int = -1
    """Number of the contact that wanders."""
    ramp_s: tuple[float, float] = (0.0, 0.0)
    """From when to when since closing."""
    at: At | None = None
    """Place of the sensors whose depth it is: what they read changes, no temperature."""

    @property
    def is_constant(self) -> bool:
        """Whether it is a constant in doubt."""
        return self.prior.name.startswith(CONSTANT)

    def tangents(self, row: int, case: Case, build: Build) -> None:
        """Fill row `row` of a build's tangents."""
        for layer in self.layers:
            cells = case.mesh.cells(layer)
            build.tangents.k[row, cells] = self.conductivity * build.stack.k[cells]
            build.tangents.c[row, cells] = self.capacity * build.stack.c[cells]
            build.tangents.exchange[row, cells] = self.exchange
        if self.flux >= 0:
            build.tangents.flux[self.flux, row] = build.stack.flux[self.flux, 0]
        if self.contact >= 0:
            build.drive.d_factor[:, self.contact, row] = self._wander(0.5 * (case.edges[1:] + case.edges[:-1]))

    def _wander(self, since_s: Array) -> Array:
        """Return how far the ramp has risen at times since closing."""
        begin, end = (math.log(t) for t in self.ramp_s)
        return np.clip((np.log(np.maximum(since_s, 1e-9)) - begin) / (end - begin), 0.0, 1.0)


def directions_of(
    press: Press, run: Run, panel: Panel | None, model: ModelFile | None, *, new_product: bool = False
) -> tuple[Unowned, ...]:
    """Return the constants that are in doubt and the discrepancy of a run; `press` has the run's overrides.

    Of a new product no run has shown how far its constants are off.
    """
    panels = PANEL_TO_PANEL
    if new_product or model is None or model.missing is None or not model.missing.runs:
        doubts = constant_doubts(run.header, press, PRODUCT_SD | _across_or_along(run))
    else:
        usual = constant_doubts(run.header, press, PANEL_TO_PANEL)
        learned = _panel_spread(model.learned, usual, model.missing.nothing)
        within = {} if f"panel.heat_capacity_J_kgK{SD}" in run.header else WITHIN_CAPACITY
        doubts = constant_doubts(run.header, press, PANEL_TO_PANEL | learned | within)
        own = _panel_spread({key: s.panel for key, s in model.scatter.items()}, usual, model.missing.nothing)
        panels = {key: own.get(key, size) for key, size in PANEL_TO_PANEL.items()}
    gaps = [Unowned(Unknown(name, 0.0, sd)) for name, sd in gap_priors(press, run, panel).items() if sd > START_K]
    constants = (*_constants(press, run, panel, doubts, panels), *_fluxes(doubts), *_depths(press, run, doubts))
    return (*constants, *gaps, *_discrepancy(press, panel, model))


def _across_or_along(run: Run) -> dict[str, float]:
    """Return what the conductivity of a wood may be off while no run has shown in which direction it holds."""
    wood = is_solid_wood(str(run.header.get("panel.material", "")))
    return {CONDUCTIVITY: math.hypot(PRODUCT_SD[CONDUCTIVITY], GRAIN_SD)} if wood else {}


def _panel_spread(learned: Mapping[str, float], usual: Mapping[str, Doubt], nothing: float) -> dict[str, float]:
    """Return what panels still differ by, as shares, once runs were held against a model.

    What earlier runs saw a constant do is the constant's own doing if no cause is missing, whose chance is
    `nothing`; else a cause may have done it, and what is usual stands. The variance is the mean over both.
    """
    known = {key: share for key, share in learned.items() if key in usual}
    return {
        key: math.sqrt(nothing * share**2 + (1.0 - nothing) * usual[key].relative ** 2)
        for key, share in known.items()
    }


def _constants(
    press: Press, run: Run, panel: Panel | None, doubts: Mapping[str, Doubt], panels: Mapping[str, float]
) -> Iterator[Unowned]:
    parts = {layer.name: layer_constants(press, layer.name, panel) for layer in press.layer}
    resistance = sum(d / k for d, k, _ in parts.values())
    capacity = sum(d * c for d, _, c in parts.values())
    materials: dict[tuple[float, float], list[str]] = {}
    for layer in press.layer:
        materials.setdefault((math.nan, math.nan) if layer.from_run else parts[layer.name][1:], []).append(
            layer.name
        )
    for names in materials.values():
        own = next(layer for layer in press.layer if layer.name == names[0])
        in_doubt = _InDoubt("panel" if own.from_run else f"layer.{own.name}", doubts, panels)
        share, loose = in_doubt.share, in_doubt.loose
        odd = _unknown_in(run.header) if own.from_run else {}
        thick, k = share("thickness_mm"), max(share("conductivity_W_mK"), odd.get("conductivity_W_mK", 0.0))
        c = math.hypot(
            max(share("density_kg_m3"), odd.get("density_kg_m3", 0.0)),
            max(share("heat_capacity_J_kgK"), odd.get("heat_capacity_J_kgK", 0.0)),
        )
        resists = sum(parts[n][0] / parts[n][1] for n in names) / resistance
        stores = sum(parts[n][0] * parts[n][2] for n in names) / capacity
        layers = tuple(names)
        called = f"{CONSTANT} {names[0]}"
        if k * resists > LEAST_SHARE:
            part = loose("conductivity_W_mK", k)
            prior = Unknown(f"{called} conductivity", 0.0, k, considered=True, loose=part)
            yield Unowned(prior, layers, conductivity=1.0)
        if c * stores > LEAST_SHARE:
            part = loose("heat_capacity_J_kgK", c)
            prior = Unknown(f"{called} capacity", 0.0, c, considered=True, loose=part)
            yield Unowned(prior, layers, capacity=1.0)
        if thick * max(resists, stores) > LEAST_SHARE:  # thicker: more to heat, and a longer way
            yield Unowned(
                Unknown(f"{called} thickness", 0.0, thick, considered=True, loose=loose("thickness_mm", thick)),
                layers,
                conductivity=-1.0,
                capacity=1.0,
            )


def _fluxes(doubts: Mapping[str, Doubt]) -> Iterator[Unowned]:
    for end, side in enumerate(("bottom", "top")):
        keys = (f"boundary.{side}.{name}" for name in ("incident_W_m2", "absorptivity"))
        if both := [doubts[key].relative for key in keys if key in doubts]:
            yield Unowned(Unknown(f"{CONSTANT} flux {side}", 0.0, math.hypot(*both), considered=True), flux=end)


def _depths(press: Press, run: Run, doubts: Mapping[str, Doubt]) -> Iterator[Unowned]:
    """Yield the depths of buried sensors that the run has, one for all that share a place."""
    for sensor in {sensor.label: sensor for sensor in press.sensors_of(run).values()}.values():
        if isinstance(sensor.at, At):
            number = press.sensor.index(sensor)
            sd = doubts[f"sensor.{number}.at.depth_mm"].sd / 1000.0
            yield Unowned(Unknown(f"{CONSTANT} sensor {number} depth", 0.0, sd, considered=True), at=sensor.at)


@dataclass(frozen=True)
class _InDoubt:
    """What is in doubt about the constants of one layer, or of the panel."""

    prefix: str
    doubts: Mapping[str, Doubt]
    panels: Mapping[str, float]

    def share(self, key: str) -> float:
        """Return a constant's standard deviation, as a share; 0 where it is in no doubt."""
        found = self.doubts.get(f"{self.prefix}.{key}")
        return found.relative if found is not None and math.isfinite(found.relative) else 0.0

    def loose(self, key: str, share: float) -> float:
        """Return the share of that variance whose size is known only within a range."""
        found = self.doubts.get(key := f"{self.prefix}.{key}")
        if found is not None and found.source is Origin.STATED:
            return 0.0
        return min(1.0, self.panels.get(key, share) / share) ** 2


def odd_constants(header: Mapping[str, Any]) -> dict[str, float]:
    """Return by key the panel's constants that are odd for its material, and by how much they are off, as a share.

    Boards sold under one name differ by `daq.materials.TABLE_SD`. A number whose own standard deviation stands
    beside it is nobody's slip.
    """
    found = {}
    for key, listed in listed_constants(header).items():
        given = header.get(key)
        if not isinstance(given, int | float) or given <= 0 or f"{key}{SD}" in header:
            continue
        if off := listed.off(given):
            found[key] = off
    return found


def _unknown_in(header: Mapping[str, Any]) -> dict[str, float]:
    """Return by name the odd constants that no panel of their own stands for, and by how much they are off.

    One that is off by too much to be followed, and several, any of which may be mistaken (`panels`). As a share.
    """
    odd = {key.removeprefix("panel."): off for key, off in odd_constants(header).items()}
    return {name: off for name, off in odd.items() if off > MOST_SHARE or len(odd) > 1}


def _discrepancy(press: Press, panel: Panel | None, model: ModelFile | None) -> Iterator[Unowned]:
    spread = {p.name: p.sd for p in coefficient_priors(press, model)}
    share = _share(model.missing if model is not None else None)
    inside = press.panel_layers or tuple(layer.name for layer in press.layer)
    for number, contact in enumerate(press.contact):
        if press.panel_layers and not set(press.panel_layers) & set(contact.between):
            continue
        sd = min(spread[contact.closed], SPREAD_LOG) / math.sqrt(len(RAMPS_S) - 1)
        for i, ramp in enumerate(pairwise(RAMPS_S)):
            yield Unowned(
                Unknown(f"{DISCREPANCY} contact {number} {i}", 0.0, sd, considered=True),
                contact=number,
                ramp_s=ramp,
            )
    parts = [layer_constants(press, name, panel) for name in inside]
    half = 0.5 * sum(d for d, _, _ in parts)
    k = 2.0 * half / sum(d / k for d, k, _ in parts)
    # at rest a source q per kelvin and volume takes q half^2 / 2 k of the rise of a core between two faces, and
    # three times that where one end is insulated: all of it must flow out through the other (k T" = q T)
    ways = 3.0 if BoundaryKind.INSULATED in (press.boundary.bottom.kind, press.boundary.top.kind) else 1.0
    exchange = 2.0 * k / half**2 / ways
    rim = 2.0 * math.sqrt(math.pi / press.press.area_m2)  # of a round stack, over its area [1/m]
    share = math.hypot(share, press.press.side_loss_W_m2K * rim / exchange)
    if share > LEAST_SHARE:
        source = Unknown(f"{DISCREPANCY} source", 0.0, share, considered=True)
        yield Unowned(source, tuple(inside), exchange=exchange)


def _share(missing: MissingCauses | None) -> float:
    """Return the share of a core's rise that the model may miss."""
    if missing is None:
        return UNSEEN_SHARE
    return UNEXPLAINED_PER_K * missing.unexplained_K
