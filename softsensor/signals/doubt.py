"""How far each constant of a run may be from the truth: one answer for fit, diagnosis and live sensor.

A number of the header or the press file has a standard deviation of its own where ``KEY.sd`` states one. Else its
source decides: a reading of this panel, a data sheet, the material table, a guess; or what earlier runs of the
press have shown to scatter from panel to panel. Keys are the dotted ones of the header, by which a run may
override any of them. A table in temperature is doubted as a whole: one factor on all its values.

Numbers called unverified are general knowledge and no measurement; a press that has runs learns its own
(`learned`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from daq.materials import TABLE_SD, Constant, find_material
from daq.press.press_file import SD, At, Boundary, BoundaryKind, Layer, Press
from daq.records import ROOM_C
from softsensor.signals.instrument import START_TOTAL_K


class Origin(StrEnum):
    """Where a constant, and with it the doubt of it, comes from."""

    STATED = "stated"
    """The standard deviation stands beside the number, in header or press file."""
    MEASURED = "measured"
    """Read on this panel or in this room, by an instrument of a known class."""
    DATA_SHEET = "data_sheet"
    """A product's number: panels of the product scatter about it."""
    MATERIAL_TABLE = "material_table"
    """A number for all products of a name (`daq.materials`)."""
    GUESS = "guess"
    """Nobody gave it."""
    LEARNED = "learned"
    """Scatter from panel to panel, as earlier runs of this press show it."""


@dataclass(frozen=True)
class Doubt:
    """A constant and how far it may be off, in the unit of its key."""

    value: float
    """Of a table in temperature: its first row's."""
    sd: float
    source: Origin

    @property
    def relative(self) -> float:
        """The standard deviation as a share of the value; infinite where that is 0."""
        return self.sd / abs(self.value) if self.value else float("inf")


PANEL_SCATTER_LEAST, PANEL_SCATTER_MOST = 0.03, 0.08
"""Of k and of c from panel to panel of one product, as a share: between these (issue 18). Unverified."""
PANEL_SCATTER = 0.5 * (PANEL_SCATTER_LEAST + PANEL_SCATTER_MOST)
"""The middle of them."""
_NODES, _SHARES = np.polynomial.legendre.leggauss(3)
DOUBT_SIZES = tuple(
    zip(
        (1.0 + (PANEL_SCATTER_MOST / PANEL_SCATTER - 1.0) * _NODES).tolist(), (0.5 * _SHARES).tolist(), strict=True
    )
)
"""A doubt's true size in units of the one that is taken for usual, and the chance of it: evenly between the least
and the most that panels scatter by, in three Gauss points. How much the next panel differs, nobody knows better;
one size for all makes the middle of a band too wide and its ends too short. So it is with what is by hand or
unverified; what is stated has one size, and so has what all panels of a product are off together."""
MEAN_SQUARE_SIZE = sum(chance * size**2 for size, chance in DOUBT_SIZES)
"""By which such a variance is larger than at its usual size, in the mean."""
PANEL_DENSITY = 0.035
"""Of density: EN 622-5 and EN 312 allow 7 and 10 % about the mean within a board (method: EN 323); the lower one,
taken as two deviations. Unverified."""
PANEL_TO_PANEL = {
    "panel.density_kg_m3": PANEL_DENSITY,
    "panel.conductivity_W_mK": PANEL_SCATTER,
    "panel.heat_capacity_J_kgK": PANEL_SCATTER,
}
"""What panels of one press differ by, as shares, once what they share is known: how the product differs from the
material table, earlier runs' coefficients hold, or a hypothesis (``conductivity_offset``) does."""
PRODUCT_SD = {"panel.conductivity_W_mK": TABLE_SD, "panel.heat_capacity_J_kgK": TABLE_SD}
"""What all panels of a product may be off a header's constants together, as a share, before runs were held against
them. Data sheets of wood-based panels repeat design values by density (EN 13986, EN ISO 10456) and measure
neither: a name's worth. Unverified."""
PANEL_THICKNESS_MM = ((19.0, 0.1), (float("inf"), 0.15))
"""Up to a thickness, its deviation: EN 622-1 allows ±0.2 mm up to 19 mm and ±0.3 mm beyond (method: EN 324-1),
taken as two deviations. Unverified. [mm]"""
ALLOWED = 2.0
"""So many deviations to either side a norm allows a panel (`PANEL_THICKNESS_MM`)."""
MOISTURE_PERCENT = 1.0
"""Of a moisture in the header: a meter's reading, or a delivery's. Unverified. [%]"""
MOISTURE_GUESS = (7.5, 2.0)
"""Of a wood-based panel of which nothing is stated: EN 622-1 and EN 312 have it delivered with 4 to 11 %; middle,
and width/√12. Unverified. [%]"""
AMBIENT_K, AMBIENT_GUESS_K = 1.0, 4.0
"""Of a room's temperature in the header, by where in the room it was taken; and of 23 °C where none is given, in
halls of 16 to 30 °C (width/√12). Unverified. [K]"""
INCIDENT_SHARE = 0.02
"""Of a heat flux: a Schmidt-Boelter gauge, 3.2 % at two deviations (NIST, doi 10.18434/mds2-2940), and its
setting."""
ABSORPTIVITY = 0.03
"""Of absorptivity and emissivity of a coated or charred face. Unverified."""
LAYER_THICKNESS, LAYER_DENSITY, LAYER_K, LAYER_C = 0.01, 0.01, 0.05, 0.03
"""Of a layer in the press file, as shares: machined plates to 0.1 in 10 mm; density, conductivity and heat
capacity of an alloy from melt to melt. Unverified."""
DEPTH_MM = 0.25
"""Of a buried sensor's place: where in a bead or a drilled hole of 0.5 to 1 mm the junction lies. Unverified.
[mm]"""


def constant_doubts(
    header: Mapping[str, Any], press: Press, learned: Mapping[str, float] | None = None
) -> dict[str, Doubt]:
    """Return by key of the header what is uncertain about a run's constants.

    Parameters
    ----------
    header
        The run's, checked (`daq.press.header.check_header`).
    press
        Its press, with or without the run's overrides.
    learned
        Scatter from panel to panel by key, as a share of the value (`heat.model_file.ModelFile.scatter`). It goes
        before data sheet, material table and guess, never before what is stated or measured.
    """
    found = {key: _stated(header, key, doubt) for key, doubt in _all(header, press)}
    general = (Origin.DATA_SHEET, Origin.MATERIAL_TABLE, Origin.GUESS)
    for key, share in (learned or {}).items():
        if key in found and found[key].source in general and f"{key}{SD}" not in header:
            found[key] = Doubt(found[key].value, share * abs(found[key].value), Origin.LEARNED)
    return found


def _all(header: Mapping[str, Any], press: Press) -> Iterator[tuple[str, Doubt]]:
    """Yield what is uncertain by where it comes from, nothing learned."""
    if press.panel_layers:
        yield from _panel(header)
    room = _given(header, "ambient.temperature_C", AMBIENT_K, Origin.MEASURED)
    yield "ambient.temperature_C", room or Doubt(ROOM_C, AMBIENT_GUESS_K, Origin.GUESS)
    for layer in press.layer:
        if not layer.from_run:
            yield from _layer(header, layer)
    for end, boundary in press.boundary.ends:
        yield from _boundary(header, end, boundary)
    for number, sensor in enumerate(press.sensor):
        if sensor.role == "fit" and isinstance(sensor.at, At):
            yield f"sensor.{number}.at.depth_mm", depth_doubt(header, number, sensor.at)


def _panel(header: Mapping[str, Any]) -> Iterator[tuple[str, Doubt]]:
    material = find_material(str(header.get("panel.material", "")))

    def doubt(key: str, share: float, name: str) -> Doubt | None:
        given = _given(header, key, share, Origin.DATA_SHEET, relative=True)
        if given is None and material is not None:
            listed: Constant = getattr(material, name)
            return Doubt(listed.value, listed.relative_sd * listed.value, Origin.MATERIAL_TABLE)
        return given

    thickness = _given(header, "panel.thickness_mm", 1.0, Origin.DATA_SHEET)
    if thickness is not None:
        thickness = Doubt(thickness.value, thickness_sd(thickness.value), Origin.DATA_SHEET)
    rows = {
        "panel.thickness_mm": thickness,
        "panel.density_kg_m3": doubt("panel.density_kg_m3", PANEL_DENSITY, "density"),
        "panel.conductivity_W_mK": doubt("panel.conductivity_W_mK", PANEL_SCATTER, "conductivity"),
        "panel.heat_capacity_J_kgK": doubt("panel.heat_capacity_J_kgK", PANEL_SCATTER, "heat_capacity"),
        "panel.initial_temperature_C": _given(
            header, "panel.initial_temperature_C", START_TOTAL_K, Origin.MEASURED
        ),
        "panel.moisture_percent": _given(header, "panel.moisture_percent", MOISTURE_PERCENT, Origin.MEASURED),
    }
    if rows["panel.moisture_percent"] is None and material is not None:
        rows["panel.moisture_percent"] = Doubt(*MOISTURE_GUESS, Origin.GUESS)
    yield from ((key, doubt) for key, doubt in rows.items() if doubt is not None)


def _layer(header: Mapping[str, Any], layer: Layer) -> Iterator[tuple[str, Doubt]]:
    for name, share in (
        ("thickness_mm", LAYER_THICKNESS),
        ("density_kg_m3", LAYER_DENSITY),
        ("conductivity_W_mK", LAYER_K),
        ("heat_capacity_J_kgK", LAYER_C),
    ):
        key = f"layer.{layer.name}.{name}"
        value = _number(getattr(layer, name))
        if value is not None:
            yield key, _of_press(header, key, value, dict(layer.sd), share * abs(value))


def _boundary(header: Mapping[str, Any], end: str, boundary: Boundary) -> Iterator[tuple[str, Doubt]]:
    own = dict(boundary.sd)
    names: dict[str, float] = {}
    if boundary.kind is BoundaryKind.FLUX:
        value = _number(header.get(f"boundary.{end}.incident_W_m2", boundary.incident_W_m2)) or 0.0
        names = {"incident_W_m2": INCIDENT_SHARE * abs(value), "absorptivity": ABSORPTIVITY}
    if boundary.kind in (BoundaryKind.FLUX, BoundaryKind.AIR):
        names["emissivity"] = ABSORPTIVITY
    for name, sd in names.items():
        if (number := getattr(boundary, name)) > 0.0:
            key = f"boundary.{end}.{name}"
            yield key, _of_press(header, key, number, own, sd)
    if boundary.kind in (BoundaryKind.FLUX, BoundaryKind.AIR) and boundary.ambient_C is not None:
        key = f"boundary.{end}.ambient_C"
        yield key, _of_press(header, key, boundary.ambient_C, own, AMBIENT_K)


def depth_doubt(header: Mapping[str, Any], number: int, at: At) -> Doubt:
    """Return how far a buried sensor may lie from its depth; `number` is its table's in the press file. [mm]"""
    return _of_press(header, f"sensor.{number}.at.depth_mm", at.depth_mm, dict(at.sd), DEPTH_MM)


def _of_press(header: Mapping[str, Any], key: str, value: float, own: Mapping[str, float], sd: float) -> Doubt:
    """Return a constant of the press file, which may state its deviation and which the header may override."""
    if (given := _given(header, key, sd, Origin.DATA_SHEET)) is not None:
        return given
    stated = own.get(key.rpartition(".")[2])
    return Doubt(value, sd, Origin.DATA_SHEET) if stated is None else Doubt(value, float(stated), Origin.STATED)


def _given(
    header: Mapping[str, Any], key: str, sd: float, source: Origin, *, relative: bool = False
) -> Doubt | None:
    """Return a number of the header; None where it has none."""
    value = _number(header.get(key))
    if value is None:
        return None
    return Doubt(value, sd * abs(value) if relative else sd, source)


def _stated(header: Mapping[str, Any], key: str, doubt: Doubt) -> Doubt:
    """Return a doubt as the header states it, whoever gave the number; one that nobody gave stays a guess."""
    stated = header.get(f"{key}{SD}")
    source = Origin.GUESS if doubt.source is Origin.GUESS else Origin.STATED
    return doubt if stated is None else Doubt(doubt.value, float(stated), source)


def _number(value: object) -> float | None:
    """Return a number, or the first of a table in temperature; None for anything else."""
    if isinstance(value, list | tuple) and value and isinstance(value[0], list | tuple):
        value = value[0][1]
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def thickness_sd(nominal_mm: float) -> float:
    """Return by how much panels of one nominal thickness differ. [mm]"""
    return next(sd for upper, sd in PANEL_THICKNESS_MM if nominal_mm <= upper)


def one_product(one_mm: float, other_mm: float) -> bool:
    """Return whether both may be panels of one nominal thickness."""
    return abs(one_mm - other_mm) <= 2.0 * ALLOWED * thickness_sd(max(one_mm, other_mm))


def nearest_of(thicknesses_mm: Sequence[float]) -> dict[str, float]:
    """Return the first thickness, the header's, and the nearest of the others, as words take them. [mm]"""
    header, *others = thicknesses_mm
    nearest = header + min((mm - header for mm in others), key=abs)
    return {"header_mm": header, "nearest_mm": round(nearest, 1)}
