"""What an effect is: data, and one function from its parameters to changes of the stack.

The function returns `Terms`; the solver knows how each kind of term moves heat and differentiates it
exactly. It is called with complex numbers to get the terms' own derivatives, so it must be written
in plain algebra (no ``abs``, no comparison of parameters).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.records import Array, Panel
from softsensor.parameters import Parameter

Numbers = NDArray[Any]
"""Float or complex arrays."""


@dataclass(frozen=True)
class Scene:
    """What a term function may look at: the mesh, the press, one run."""

    dx: Array
    """Cell widths (n). [m]"""
    panel_cells: NDArray[np.bool_]
    """Cells of the panel proper (n)."""
    plate_cells: NDArray[np.bool_]
    """Cells of the layers that are not the panel's (n)."""
    z: Array
    """Height in the panel from -1 (lower face) to 1 (upper face), 0 outside it (n)."""
    face_cells: tuple[int, int] | None
    """The panel's lowest and highest cell, None without a panel."""
    panel: Panel | None
    panel_contacts: tuple[int, ...]
    """Numbers of the contacts that touch the panel, from bottom to top."""
    contacts: int
    """How many contacts there are."""
    step_start: Array
    step_end: Array
    """Of the solver's steps, in the run's time. [s]"""
    closed_s: complex | float
    """Middle of the closing ramp, NaN if the press never closes. [s]"""
    load: Mapping[int, Array]
    """Contact pressure over its reference, by contact, in each step."""
    ambient: float
    """[°C]"""


@dataclass(frozen=True)
class Conversion:
    """Heat released once, as something in the cells is used up: Q d(done)/dt."""

    heat: Numbers
    """By cell when complete; negative takes heat (n). [J/m³]"""
    kind: int
    """0: rate = a exp(-b/R (1/T - 1/c)); 1: rate = a (T - b)+, softened over c kelvin."""
    a: Any
    """[1/s] or [1/sK]"""
    b: Any
    """[J/mol] or [°C]"""
    c: Any
    """[K]"""


@dataclass(frozen=True)
class Terms:
    """Changes of the stack and of the measuring chain; what is left out stays as it was."""

    conductivity: Numbers | float = 1.0
    """Factor by cell."""
    conductivity_slope: Numbers | float = 0.0
    """Relative, by cell. [1/K]"""
    capacity: Numbers | float = 1.0
    """Factor on rho c by cell."""
    capacity_slope: Numbers | float = 0.0
    exchange: Numbers | float = 0.0
    """Heat lost to ambient per volume, by cell. [W/m³K]"""
    closed_contact: Mapping[int, Numbers] = field(default_factory=dict)
    """Factor on a closed contact's coupling, by contact: a number or one for each step."""
    emissivity: Any = 0.0
    """Between parted neighbours while open."""
    convection: Any = 0.0
    """Steam transport in the closed panel. [W/m³K]"""
    conversions: tuple[Conversion, ...] = ()
    paper: tuple[Any, Any] | None = None
    """Resistance and capacity of a layer on each panel face. [m²K/W, J/m²K]"""
    plates_offset: Any = 0.0
    """Added to the plates at the start. [K]"""
    boundary_offset: tuple[Any, Any] = (0.0, 0.0)
    """Bottom and top: true minus reading. [K]"""
    lag: Any = 0.0
    """Time constant of the panel sensors. [s]"""
    footprint: Any = 0.0
    """Share of the press face in a panel sensor's reading while closed."""
    clock: Any = 0.0
    """Panel channels later than platen channels. [s]"""


@dataclass(frozen=True)
class Effect:
    """One cause the plain model leaves out, of physics or of the measuring chain."""

    name: str
    meaning: str
    """One sentence for the operator."""
    symptom: str
    """What the residuals show when the model lacks it."""
    confirm: str
    """The measurement that would settle it."""
    parameters: tuple[Parameter, ...]
    terms: Callable[[Scene, Mapping[str, Any]], Terms]
    source: str
    measuring: bool = False
    """A fault or property of the measuring chain; settled before physics."""
    core: str = ""
    """What it means for the core temperature."""
    nonlinear: bool = False
    """Whether its terms depend on temperature."""
    closed_step_s: float = math.inf
    """Longest step that bears its terms while the press is closed. [s]"""
    layers: bool = False
    """Whether it adds layers to the mesh (``Terms.paper``)."""
    needs: str = ""
    """What a run must offer for the effect to be testable: ``closed``, ``load``, ``panel`` or empty."""
    called: str = ""
    """What it is called in the middle of a sentence; its name with spaces where empty."""

    @property
    def neutral(self) -> dict[str, float]:
        """The parameter values at which the effect is absent."""
        return {p.name: p.neutral for p in self.parameters}

    def key(self, parameter: str) -> str:
        """Return the parameter's full name, as in ``edge_loss.W_m3K``."""
        return f"{self.name}.{parameter}"


def on_panel(scene: Scene, value: Numbers | float | complex, elsewhere: float) -> Numbers:
    """Return `value` on the panel's cells and `elsewhere` on the others."""
    return np.where(scene.panel_cells, value, elsewhere)
