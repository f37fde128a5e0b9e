"""Constants of common panels, used where a run's header names a material but not its constants.

Conductivity and heat capacity scatter by 20 % between products (Wood Handbook, FPL-GTR-282, ch. 4),
so a value measured on the board at hand always goes first. MDF and OSB are measurements of the
UL FSRI materials database as listed in the NIST repository firemodels/exp
(FSRI_Materials/fsri_spec_file.csv); the rest are the usual middle of manufacturers' ranges.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """Room-temperature constants of one kind of board."""

    density: float
    """[kg/m³]"""
    conductivity: float
    """Through the thickness. [W/mK]"""
    heat_capacity: float
    """[J/kgK]"""
    source: str


MATERIALS = {
    "MDF": Material(740.0, 0.12, 1550.0, "k, rho: FSRI_MDF; c at 8 % moisture and 50 C, Wood Handbook rule"),
    "HDF": Material(880.0, 0.14, 1550.0, "middle of the trade's range"),
    "particleboard": Material(680.0, 0.12, 1550.0, "middle of the trade's range"),
    "OSB": Material(598.0, 0.119, 1576.0, "FSRI_OSB"),
    "plywood": Material(550.0, 0.12, 1600.0, "middle of the trade's range"),
}
"""By the name a run's header gives in ``panel.material``; case does not matter."""


def find_material(name: str) -> Material | None:
    """Return the material of that name, or None."""
    return {key.lower(): value for key, value in MATERIALS.items()}.get(name.strip().lower())
