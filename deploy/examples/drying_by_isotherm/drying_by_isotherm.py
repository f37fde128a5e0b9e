"""A second law of drying: bound water leaves as the wood's sorption isotherm lets go of it.

The built-in `moisture_evaporation` lets all water boil at one temperature, as free water does. Wood holds up to a
fifth of its dry mass as bound water, though, and panels have no other. In equilibrium with steam of the pressure
that the pores bear (one atmosphere where air has been driven out and steam leaves freely), water stays up to the
moisture u at which

    p = h(u, T) p_sat(T),

h being the humidity above wood of this moisture (Hailwood and Horrobin's isotherm) and p_sat the pressure over
water (Clausius and Clapeyron's law, as tabled). Along that isobar moist wood dries from the boiling point on and
drier wood later: of 8 % the first leaves at 109 °C, of 4 % at 119 °C. So there is a bend and no plateau. What the
wood still holds at the last of `STEPS_C` leaves there, so that all water named leaves.

No water moves inwards here; what steam carries to cooler layers is `vapour_convection`.

Laws are exchanged like effects: install this one with ``pip install deploy/examples/drying_by_isotherm``, and
`kerntemp diagnose` tests both against runs left out, names the one that predicts them better, and both where the
runs cannot tell. A model file holds either by its name.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from softsensor.effects import Conversion, Live, Scene, Terms, on_panel
from softsensor.effects.moisture_evaporation import EFFECT as BOILING
from softsensor.effects.moisture_evaporation import LATENT_HEAT, RATE
from softsensor.opening.steam import equilibrium_moisture, saturation_kPa

STEPS_C = np.array([100.0, 102.0, 105.0, 108.0, 112.0, 117.0, 123.0, 130.0, 140.0, 160.0])
"""In steam of one atmosphere; between two of them at most 4.4 % of the dry mass leave. [°C]"""
SOFTNESS = 0.5
"""Width of each step's onset: the built-in law's 2 K would let water go far below what holds it. [K]"""
WETTEST = 0.97
"""Humidity up to which the isotherm is taken: beyond, water is free. [-]"""
HELD_PERCENT = equilibrium_moisture(np.minimum(saturation_kPa(100.0) / saturation_kPa(STEPS_C), WETTEST), STEPS_C)
"""What wood holds there in steam of one atmosphere. [% of dry mass]"""


def leaving(moisture_percent: Any) -> Iterator[tuple[float, Any]]:
    """Yield at which temperature how much of the water leaves. [°C, % of dry mass]"""
    held = np.where(np.real(moisture_percent) > HELD_PERCENT, HELD_PERCENT, moisture_percent)
    yield float(STEPS_C[0]), moisture_percent - held[0]
    yield from zip((0.5 * (STEPS_C[1:] + STEPS_C[:-1])).tolist(), held[:-1] - held[1:], strict=True)
    yield float(STEPS_C[-1]), held[-1]


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    if scene.panel is None:
        return Terms()
    dry = scene.panel.density / (1.0 + (scene.panel.moisture_percent or 0.0) / 100.0)
    higher = values["temperature_C"] - STEPS_C[0]
    return Terms(
        conversions=tuple(
            Conversion(on_panel(scene, -LATENT_HEAT * dry * water / 100.0, 0.0), 1, RATE, at + higher, SOFTNESS)
            for at, water in leaving(values["moisture_percent"])
        )
    )


WATER, BOILS = BOILING.parameters
EFFECT = replace(
    BOILING,
    name="drying_by_isotherm",
    parameters=(
        WATER,
        replace(BOILS, neutral=STEPS_C[0], typical=STEPS_C[0], source="boiling point of the pores' pressure"),
    ),
    terms=_terms,
    source="W. T. Simpson's isotherm (Wood Handbook, FPL-GTR-282, ch. 4) at one pressure; rate as built in",
    chance=0.0,
    live=Live(),  # that water leaves at all, the built-in law suspects already
    as_law=None,
    words={
        "en": {
            "called": "drying by the sorption isotherm",
            "meaning": "Water bound by the wood leaves bit by bit above the boiling point and takes heat along.",
            "symptom": "Above 100 °C the panel warms up more slowly than simulated, without a plateau.",
            "confirmed-by": "Weigh the panel before and after, and press one that was dried.",
            "core": "Some kelvins too low, most of all late in long pressings.",
            "parameter-moisture_percent": "water that leaves",
            "parameter-temperature_C": "boiling point at the pores' pressure",
        },
        "de": {
            "called": "Trocknen nach der Sorptionsisotherme",
            "meaning": "Im Holz gebundenes Wasser geht über dem Siedepunkt nach und nach und nimmt Wärme mit.",
            "symptom": "Über 100 °C wird die Platte langsamer warm als simuliert, ohne Plateau.",
            "confirmed-by": "Die Platte vorher und nachher wiegen, und eine getrocknete pressen.",
            "core": "Einige Kelvin zu niedrig, am meisten spät in langen Pressungen.",
            "parameter-moisture_percent": "Wasser, das geht",
            "parameter-temperature_C": "Siedepunkt beim Druck in den Poren",
        },
    },
)
