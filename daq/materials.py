"""Constants of common panels, used where a run's header names a material but not its constants.

Conductivity and heat capacity scatter by 20 % between products (Wood Handbook, FPL-GTR-282, ch. 4),
so a value measured on the board at hand always goes first. MDF and OSB are measurements of the
UL FSRI materials database as listed in the NIST repository firemodels/exp
(FSRI_Materials/fsri_spec_file.csv); the rest are the usual middle of manufacturers' ranges.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

TABLE_SD = 0.2
"""Standard deviation between boards sold under one name, as a share. (Wood Handbook, ch. 4: +-20 %)"""

GRAIN_SD = 1.0 - 1.8**-0.5
"""How far a solid wood's conductivity may be off besides where nobody says in which direction it was measured,
as a share. Along the grain it is some 1.8 times that across (Wood Handbook, ch. 4: 1.5 to 2.8), and a hot disk
that takes the wood for isotropic reads the root of their product (ISO 22007-2)."""
ODD = 2.0
"""A number so many standard deviations from the table's is doubted; of sound boards one in twenty is. (Normal)"""
_ENGLISH_WOODS = ("ash", "beech", "birch", "fir", "larch", "maple", "oak", "pine", "poplar", "spruce")
_GERMAN_WOODS = ("esche", "buche", "birke", "tanne", "lärche", "ahorn", "eiche", "kiefer", "pappel", "fichte")
SOLID_WOODS = frozenset((*_ENGLISH_WOODS, *_GERMAN_WOODS))
"""Words by which a header's ``panel.material`` names a solid wood (``Scots pine``, ``Kiefer, feucht``)."""
JUST_WOOD = ({"wood"}, {"solid", "wood"}, {"holz"}, {"massivholz"})
"""The same where no kind is named."""

_FSRI_MDF, _FSRI_OSB = "measured: FSRI_MDF", "measured: FSRI_OSB"
_TRADE = "middle of the trade's range"
_WOOD_HANDBOOK = "at 8 % moisture and 50 °C, Wood Handbook, ch. 4"


@dataclass(frozen=True)
class Constant:
    """One property of a material."""

    value: float
    source: str
    relative_sd: float = TABLE_SD

    def off(self, given: float) -> float:
        """Return by how much a number differs from the table's where that is odd for its material, else 0. [-]

        The difference is that of the logarithms, half as much as odd as twice as much; odd is one beyond `ODD`
        standard deviations of boards sold under one name.
        """
        off = abs(math.log(given / self.value))
        return off if off > math.log1p(ODD * self.relative_sd) else 0.0


@dataclass(frozen=True)
class Material:
    """Room-temperature constants of one kind of board."""

    density: Constant
    """[kg/m³]"""
    conductivity: Constant
    """Through the thickness. [W/mK]"""
    heat_capacity: Constant
    """[J/kgK]"""

    @property
    def effusivity(self) -> float:
        """√(k ρ c), by which a face of a half-space takes up heat: 2/√π q √t / e. [W√s/m²K]"""
        return math.sqrt(self.conductivity.value * self.density.value * self.heat_capacity.value)


MATERIALS = {
    "MDF": Material(Constant(740.0, _FSRI_MDF), Constant(0.12, _FSRI_MDF), Constant(1550.0, _WOOD_HANDBOOK)),
    "HDF": Material(Constant(880.0, _TRADE), Constant(0.14, _TRADE), Constant(1550.0, _TRADE)),
    "particleboard": Material(Constant(680.0, _TRADE), Constant(0.12, _TRADE), Constant(1550.0, _TRADE)),
    "OSB": Material(Constant(598.0, _FSRI_OSB), Constant(0.119, _FSRI_OSB), Constant(1576.0, _FSRI_OSB)),
    "plywood": Material(Constant(550.0, _TRADE), Constant(0.12, _TRADE), Constant(1600.0, _TRADE)),
}
"""By the name a run's header gives in ``panel.material``; case does not matter."""


def is_solid_wood(name: str) -> bool:
    """Return whether a header's material is wood with its grain, and no board made of it.

    Examples
    --------
    >>> is_solid_wood("Scots pine"), is_solid_wood("Kiefer, 12 %"), is_solid_wood("Wood")
    (True, True, True)
    >>> is_solid_wood("plywood"), is_solid_wood("engineered wood")
    (False, False)
    """
    words = set(re.findall(r"[^\W\d_]+", name.lower()))
    return bool(words & SOLID_WOODS) or words in JUST_WOOD


def find_material(name: str) -> Material | None:
    """Return the material of that name, or None."""
    return {key.lower(): value for key, value in MATERIALS.items()}.get(name.strip().lower())
