"""What an effect is: data, and one function from its parameters to changes of the stack.

The function returns `Terms`; the solver knows how each kind of term moves heat and differentiates it
exactly. It is called with complex numbers to get the terms' own derivatives, so it must be written
in plain algebra (no ``abs``, no comparison of parameters).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.printed import on_screen
from daq.records import Array, Panel
from daq.words import Message, say
from softsensor.effects.parameters import Parameter

Numbers = NDArray[Any]
"""Float or complex arrays."""


@dataclass(frozen=True)
class Scene:
    """What a term function may look at: the mesh, the press, one run."""

    dx: Array
    """Cell widths (n). [m]"""
    panel_cells: NDArray[np.bool_]
    """Cells of the panel proper (n)."""
    z: Array
    """Height in the panel from -1 (lower face) to 1 (upper face), 0 outside it (n)."""
    face_cells: tuple[int, int] | None
    """The panel's lowest and highest cell, None without a panel."""
    panel: Panel | None
    """The panel's measures and constants, None without one."""
    panel_contacts: tuple[int, ...]
    """Numbers of the contacts that touch the panel, from bottom to top."""
    contacts: int
    """How many contacts there are."""
    step_start: Array
    """Starts of the solver's steps, in the run's time (steps). [s]"""
    step_end: Array
    """Ends of them (steps). [s]"""
    closed_s: complex | float
    """Middle of the closing ramp, NaN if the press never closes. [s]"""
    load: Mapping[int, Array]
    """Contact pressure over its reference, by contact, in each step."""
    ambient: float
    """[°C]"""

    __repr__ = on_screen


@dataclass(frozen=True)
class Conversion:
    r"""Heat released once, as something in the cells is used up.

    With Z from 0 to 1 what is used up, and T in kelvin for the first kind, in °C for the second:

    $$q = Q \frac{dZ}{dt}, \quad
    \frac{dZ}{dt} = (1 - Z) (1 - u + u Z) a e^{-\frac{b}{R} \left(\frac{1}{T} - \frac{1}{c}\right)}$$
    """

    heat: Numbers
    """Q, by cell when complete; negative takes heat (n). [J/m³]"""
    kind: int
    """0: rate = a exp(-b/R (1/T - 1/c)); 1: rate = a (T - b)+, softened over c kelvin."""
    a: Any
    """[1/s] or [1/sK]"""
    b: Any
    """[J/mol] or [°C]"""
    c: Any
    """[K]"""
    own: Any = 0.0
    """u, the share of the rate that needs what has already reacted; below 1, or nothing would begin."""


@dataclass(frozen=True)
class Source:
    """Heat that the panel releases by itself while the press is closed: q = heat x course."""

    heat: Numbers
    """By cell; negative takes heat (n). [W/m³]"""
    course: Numbers | float = 1.0
    """A number, or one for each step."""


REFERENCE_C = 20.0
"""Temperature at which conductivity and heat capacity are given; their slopes count from here. [°C]"""


BENDS_C = np.linspace(0.0, 300.0, 61)
"""Where a free function of temperature is given, straight in between and constant beyond: from cold panels to the
hottest platens; 5 K, so that a function that bends within 20 K is off by (5/20)²/8, less than 1 %. [°C]"""


@dataclass(frozen=True)
class Terms:
    r"""Changes of the stack and of the measuring chain; what is left out stays as it was.

    A factor f and a slope s make of a property p at 20 °C:

    $$p(T) = f p \left(1 + s (T - 20)\right)$$
    """

    conductivity: Numbers | float = 1.0
    """Factor by cell."""
    conductivity_slope: Numbers | float = 0.0
    """Relative, by cell. [1/K]"""
    conductivity_bend: Numbers | float = 0.0
    """Logarithm of a factor on the panel's conductivity, at `BENDS_C` (61)."""
    capacity: Numbers | float = 1.0
    """Factor on rho c by cell."""
    capacity_slope: Numbers | float = 0.0
    """Of rho c, relative, by cell. [1/K]"""
    exchange: Numbers | float = 0.0
    """Heat lost to ambient per volume, by cell. [W/m³K]"""
    closed_contact: Mapping[int, Numbers] = field(default_factory=dict)
    """Factor on a closed contact's coupling, by contact: a number or one for each step."""
    contact_bend: Numbers | float = 0.0
    """Logarithm of a factor on the panel's closed contacts by the temperature of its face, at `BENDS_C` (61)."""
    emissivity: Any = 0.0
    """Between parted neighbours while open."""
    convection: Any = 0.0
    """Steam transport in the closed panel. [W/m³K]"""
    conversions: tuple[Conversion, ...] = ()
    """Heat released or taken once, one for each thing that is used up."""
    sources: tuple[Source, ...] = ()
    """Heat released while the press is closed; an effect with any is `nonlinear`, for only steps follow it."""
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


FACTORS = ("conductivity", "capacity")
"""Terms that several effects multiply."""
SUMMANDS = (
    *("conductivity_slope", "conductivity_bend", "capacity_slope", "exchange", "contact_bend"),
    *("emissivity", "convection"),
    *("plates_offset", "lag", "footprint", "clock"),
)
"""Terms that they add up."""


class LawOf(StrEnum):
    """What a free law is of (`effects.free_law`)."""

    CONTACT = "contact"
    CONTACT_LOWER = "contact_lower"
    CONTACT_UPPER = "contact_upper"
    CONTACT_BY_LOAD = "contact_by_load"
    CONTACT_BY_TEMPERATURE = "contact_by_temperature"
    CONDUCTIVITY = "conductivity"
    HEAT = "heat"
    EXCHANGE = "heat_exchange"
    SOURCE_BY_DEPTH = "source_by_depth"
    SOURCE_BY_TIME = "source_by_time"


class Need(StrEnum):
    """What a run must offer for an effect to be testable."""

    NOTHING = ""
    """Any run will do."""
    PANEL = "panel"
    """A press with a panel."""
    SWITCH = "closed"
    """A ``closed`` column: a wire that shows when the press is closed."""
    LOAD = "load"
    """Pressings at several pressures, or a load that changes within one."""


class Role(StrEnum):
    """How the live sensor carries an effect that the model in force leaves out."""

    NONE = "none"
    """Not at all."""
    HYPOTHESIS = "hypothesis"
    """It acts inside the panel and moves the core by kelvins: hypotheses with and without it, in one filter."""
    OWN_FILTER = "own-filter"
    """The same with a filter of its own: where the effect is absent, its terms have no slope to follow."""
    SCATTER = "scatter"
    """It bends the faces' readings and hardly moves the core: a Gaussian about its absence."""
    OF_THE_RUN = "of-the-run"
    """Every run has unknowns of its own in its place (platens' offsets, moments, channels left out)."""


@dataclass(frozen=True)
class Live:
    """An effect in the live sensor."""

    role: Role = Role.NONE
    """In which way the filter holds it."""
    absent: float = 0.01
    """What is left of a hypothesis where it is absent, as a share of its typical size."""
    with_states: bool = False
    """Carried only where the press opens and closes."""
    straight: bool = False
    """Whether readings follow it in a straight line, so that its filter need not be linearised anew."""


@dataclass(frozen=True)
class Effect:
    """One cause the plain model leaves out, of physics or of the measuring chain.

    All that is known of it stands here. Its words stand in the catalogues of `daq.words`, under
    ``effect-NAME-called``, ``-meaning``, ``-symptom``, ``-confirmed-by``, ``-core`` and
    ``parameter-NAME-PARAMETER``; an effect of one's own brings them in `words`.
    """

    name: str
    """Which it is, in files, answers and keys."""
    parameters: tuple[Parameter, ...]
    """Its size first; then what says how it goes."""
    terms: Callable[[Scene, Mapping[str, Any]], Terms]
    """Its share of the equations: what it changes in a scene, for the values of its parameters by name."""
    source: str
    """Where its equation and sizes are from."""
    chance: float = 0.0
    """That a pressing has it at its typical size, before anything is known of the press. Set by hand, 2026-11, so
    that the live sensor's band holds what it promises on virtual campaigns."""
    live: Live = Live()
    """How the live sensor carries it."""
    words: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """By language: ``called``, ``meaning``, ``symptom``, ``confirmed-by``, ``core`` and ``parameter-NAME``."""
    measuring: bool = False
    """A fault or property of the measuring chain; settled before physics."""
    nonlinear: bool = False
    """Whether its terms depend on temperature."""
    layers: bool = False
    """Whether it adds layers to the mesh (``Terms.paper``)."""
    needs: Need = Need.NOTHING
    """What a run must offer for it to be testable."""
    confirmed_in_core: bool = False
    """Whether the measurement that would settle it is a thermocouple in the core."""
    most_heat_J_m2: float = 0.0  # noqa: N815
    """The most heat it can release inside a panel, beyond what flows in through the faces: no core is hotter than
    that allows. [J/m²]"""
    as_law: Callable[[LawOf, Any, float], Iterable[Any]] | None = None
    """Return what it looks like as a free law (`effects.free_law`), at its various shapes: by what the law is of,
    over its variable (n), where neighbouring values blur over a distance. Empty where it is none of these; a
    factor's curve comes with its size, any other's up to one."""
    of_constant: str = ""
    """Key of the header whose number it says is off: where that has a standard deviation beside it, the number is
    as doubtful as that says, and the live sensor does not suspect it besides."""
    made_up_by: tuple[str, ...] = ()
    """What a fit leaves free in each run that can do the same: held where runs left out are to show a gain."""
    at_the_rim: bool = False
    """Whether sensors at the rim show it before those in the middle."""

    @property
    def called(self) -> Message:
        """What it is called in the middle of a sentence."""
        return say(f"effect-{self.name}-called")

    @property
    def meaning(self) -> Message:
        """One sentence for the operator."""
        return say(f"effect-{self.name}-meaning")

    @property
    def symptom(self) -> Message:
        """What the residuals show when the model lacks it."""
        return say(f"effect-{self.name}-symptom")

    @property
    def confirm(self) -> Message:
        """The measurement that would settle it."""
        return say(f"effect-{self.name}-confirmed-by")

    @property
    def core(self) -> Message:
        """What it means for the core temperature."""
        return say(f"effect-{self.name}-core")

    def wrong_together(self, values: Mapping[str, float]) -> Message | None:
        """Return what is wrong with values that are each within their limits; None: nothing, or too few to say."""
        return None

    def parameter_called(self, parameter: str) -> Message:
        """Return what a parameter is, in words an operator knows."""
        return say(f"parameter-{self.name}-{parameter}")

    @property
    def one_sided(self) -> bool:
        """Whether it can only be on one side of its absence; what says how it goes has no side."""
        return any(p.one_sided for p in self.parameters if p.size)

    @property
    def neutral(self) -> dict[str, float]:
        """The parameter values at which the effect is absent."""
        return {p.name: p.neutral for p in self.parameters}

    @property
    def scatter_sd(self) -> float:
        """Standard deviation of its size over all pressings, those without it included."""
        return math.sqrt(self.chance) * self.parameters[0].size

    def key(self, parameter: str) -> str:
        """Return the parameter's full name, as in ``edge_loss.W_m3K``."""
        return f"{self.name}.{parameter}"


def on_panel(scene: Scene, value: Numbers | float | complex, elsewhere: float) -> Numbers:
    """Return `value` on the panel's cells and `elsewhere` on the others.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> on_panel(SimpleNamespace(panel_cells=np.array([False, True, True, False])), 1.2, 1.0).tolist()
    [1.0, 1.2, 1.2, 1.0]
    """
    return np.where(scene.panel_cells, value, elsewhere)
