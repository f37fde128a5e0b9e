"""Cure of the paper at both faces of the panel, carried along with a filter's march.

The filter's states are numbers that do not change in time (coefficients, constants, moments), so what the faces'
temperatures so far mean for the cure is one number and its derivative by these states. They are carried from block
to block, and read off with the state estimate of the moment: what is learned later about a contact also shows how
the face has been. The paper's temperature is that of the model at the panel's face, no thermocouple's reading.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daq.press.press_file import Press
from daq.press.resin_file import GradesTable, LimitsTable, Resin, SorptionTable
from daq.records import Array
from daq.words import Message, say
from softsensor.heat import implicit_steps as kernels
from softsensor.opening.kinetics import Course, CureProgress, Kinetics, advance, kinetics_of
from softsensor.opening.steam import MOISTURE, stated_moisture
from softsensor.signals.doubt import constant_doubts

MARGINS = 2
"""Columns beyond the filter's parameters: one kelvin at the face, and its whole rise from the start."""


@dataclass(frozen=True)
class ResinSetup:
    """What the resin file and the header say about the resin, the limits and the water in the panel."""

    kinetics: Kinetics
    limits: LimitsTable
    grades: GradesTable
    sorption: SorptionTable
    moisture: tuple[float, float]
    """Mean and standard deviation, NaN where the header states none. [% of dry mass]"""


def resin_setup(resin: Resin, header: Mapping[str, Any], press: Press) -> ResinSetup:
    """Return what a run's filters need of a resin file; the header has been checked."""
    moisture = stated_moisture(constant_doubts(header, press))
    known = (math.nan, math.nan) if moisture is None else (moisture.value, moisture.sd)
    return ResinSetup(kinetics_of(resin), resin.limits, resin.grades, resin.sorption, known)


def resin_remarks(resin: Resin, header: Mapping[str, Any]) -> tuple[Message, ...]:
    """Return what must be known about an answer that rests on a resin file and a header."""
    found = []
    if resin.resin.example:
        found.append(say("resin-is-example", name=resin.resin.name))
    elif resin.resin.verified is False:
        found.append(say("resin-not-verified", name=resin.resin.name))
    if not resin.limits.any:
        found.append(say("resin-no-limits"))
    if resin.limits.steam_most_kPa is not None and not header.get(MOISTURE):
        found.append(say("resin-no-moisture", key=MOISTURE))
    return tuple(found)


@dataclass(frozen=True)
class Curing:
    """How far both faces have cured where a filter is linearised, and by what that would change."""

    kinetics: Kinetics
    weights: Array
    """Read the panel's lower and upper face off the cells (2, n)."""
    start_C: float  # noqa: N815
    """[°C]"""
    progress: CureProgress
    """By the filter's parameters and `MARGINS` (P + 2)."""
    face_C: Array  # noqa: N815
    """(2)"""
    d_face: Array
    """(2, P + 2) [K]"""

    @staticmethod
    def begin(kinetics: Kinetics, weights: Array, start_C: float, parameters: int, state: kernels.State) -> Curing:
        """Start with uncured paper at a state's temperatures."""
        fresh = CureProgress.begin(2, parameters + MARGINS)
        blank = Curing(kinetics, weights, start_C, fresh, np.zeros(2), np.zeros((2, parameters + MARGINS)))
        return blank.after(state, 0.0)

    def after(self, state: kernels.State, seconds: float) -> Curing:
        """Return the cure when the march has come to a state, so many seconds on."""
        face = self.weights @ state.t
        parameters = self.d_face.shape[1] - MARGINS
        own = self.weights @ state.s[:parameters].T
        slopes = np.column_stack([own, np.ones(2), face - self.start_C])
        progress = self.progress
        if seconds > 0.0:
            progress = advance(self.kinetics, progress, Course(self.face_C, face, self.d_face, slopes, seconds))
        return replace(self, progress=progress, face_C=face, d_face=slopes)
