"""Radiation between the hot upper plate and the panel while the press is open."""

from collections.abc import Mapping
from typing import Any

from softsensor.effects.effect import Effect, Scene, Terms
from softsensor.parameters import Parameter


def _terms(scene: Scene, values: Mapping[str, Any]) -> Terms:
    return Terms(emissivity=values["emissivity"])


EFFECT = Effect(
    name="open_radiation",
    meaning="While the press is open, the hot upper plate radiates onto the panel.",
    symptom="The upper face is warmer than simulated in the open press, before closing and after opening.",
    confirm="Hold a sheet of aluminium foil between panel and upper plate before closing.",
    parameters=(
        Parameter(
            "emissivity",
            "effective",
            0.0,
            0.4,
            0.0,
            1.0,
            "MDF 0.9 against steel 0.1 to 0.8",
            0.0,
            0.0,
            1.0,
            meaning="effective emissivity of press and panel",
            told=(1.0, ""),
        ),
    ),
    terms=_terms,
    source="grey parallel plates with one effective emissivity",
    core="Below 0.2 K.",
    nonlinear=True,
    needs="panel",
    called="radiation in the open press",
)
