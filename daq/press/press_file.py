"""The press file: layers, contacts, boundaries, sensors; read from TOML and checked at once.

The classes are the checked description other code works on. Lengths stay in the file's unit
(the field name says which). Every message names file, key, value and what would be right.
"""

from __future__ import annotations

import fnmatch
import itertools
import math
import re
import textwrap
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from daq.printed import in_notebook
from daq.records import COLDEST_C, HOTTEST_C, KEYS_SHOWN, InputError, Run, matches
from daq.tables import at, explained, read_toml, reason_of, text_in
from daq.words import Message, say, spoken

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
"""No text and no ``true``."""
Positive = Annotated[Number, Field(gt=0)]
Temperature = Annotated[Number, Field(gt=COLDEST_C, lt=5000)]
Share = Annotated[Number, Field(ge=0, le=1)]
Yes = Annotated[bool, Field(strict=True)]
Property = Positive | tuple[tuple[Temperature, Positive], ...]
"""A number, or rows of temperature [°C] and value."""


SD = ".sd"
"""Ends the key of a number's standard deviation, beside the number's own."""
_SD_LINE = re.compile(r"^([ \t]*(?:[\w-]+\.)*)([\w-]+)\.sd(?=[ \t]*=)", re.MULTILINE | re.ASCII)
"""``KEY.sd = ...`` beside ``KEY = ...``: TOML has no such pair, unless the key stands in quotes."""


class Table(BaseModel):
    """A table of a file: unknown keys are refused, and ``KEY.sd`` beside a number is kept."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sd: tuple[tuple[str, Positive], ...] = Field(default=(), exclude_if=lambda given: not given)
    """Standard deviations of the table's numbers, by key."""

    @property
    def spreads(self) -> dict[str, float]:
        """Standard deviations by key."""
        return dict(self.sd)

    @model_validator(mode="before")
    @classmethod
    def _gather_sd(cls, given: Any) -> Any:
        """Take ``KEY.sd`` out of the keys. Raises `ValueError` where KEY is no number of this table."""
        if not isinstance(given, Mapping) or not any(str(key).endswith(SD) for key in given):
            return given
        table = {key: value for key, value in given.items() if not key.endswith(SD)}
        own = {key.removesuffix(SD): value for key, value in given.items() if key.endswith(SD)}
        numbers = [key for key, value in table.items() if isinstance(value, int | float) and value is not True]
        for key, value in own.items():
            if key not in numbers or key not in cls.model_fields:
                raise ValueError(say("press-sd-of-nothing", key=key))
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < math.inf:
                raise ValueError(say("header-sd-not-positive", key=f"{key}{SD}", value=repr(value)))
        return table | {"sd": (*table.get("sd", ()), *own.items())}


_PER_N_CM2 = {"N/cm2": 1.0, "kPa": 10.0, "bar": 0.1, "MPa": 0.01}
"""Of each unit of pressure in a newton per square centimetre."""


class Pressure(Table):
    """``press.pressure``: a channel whose pressure shows whether the press is closed."""

    column: str = Field(min_length=1)
    closed_above: Positive
    """The press counts as closed from this value on, in the column's unit."""
    open_below: Number | None = None
    """And as open again below this one. None: half of `closed_above`."""
    unit: str = ""

    @property
    def lower(self) -> float:
        """The threshold for opening, in the column's unit."""
        return 0.5 * self.closed_above if self.open_below is None else self.open_below

    @model_validator(mode="after")
    def _apart(self) -> Pressure:
        if self.lower > self.closed_above:
            raise ValueError(say("press-open-above-closed", open=self.lower, closed=self.closed_above))
        return self


LARGEST_AREA_M2 = 1e4
"""A hectare, by definition: no hall with a press in it is larger."""
LARGEST_SIDE_LOSS_W_M2K = 250.0
"""What forced convection of a gas takes at most (Incropera & DeWitt, 6th ed., Table 1.1)."""


class PressTable(Table):
    """``[press]``."""

    name: str = "press"
    area_m2: Annotated[Number, Field(gt=0, le=LARGEST_AREA_M2)] = 1.0
    side_loss_W_m2K: Annotated[Number, Field(ge=0, le=LARGEST_SIDE_LOSS_W_M2K)] = 0.0  # noqa: N815
    """How much heat bare sides of the stack may lose to the room; none where they are insulated, or far away."""
    limit_switch: str = Field(default="closed", min_length=1)
    """Column of a limit switch, 1 while the press is closed; it goes before pressure and temperatures."""
    pressure: Pressure | None = None


LAYER_LIMITS: Mapping[str, tuple[float, float]] = {
    "thickness_mm": (0.001, 10000.0),
    "conductivity_W_mK": (0.005, 5000.0),
    "density_kg_m3": (0.5, 25000.0),
    "heat_capacity_J_kgK": (50.0, 15000.0),
}
"""What a layer can be: from a film of 1 µm to 10 m; from silica aerogel (0.013 W/mK) to diamond (3300), from air
at 400 °C (0.52 kg/m³) to osmium (22590), from lead (129 J/kgK) to hydrogen (14300), each with room beside it (CRC
Handbook of Chemistry and Physics, 97th ed.). Panels have narrower ones (`daq.press.header`)."""


class Layer(Table):
    """``[[layer]]``, listed from bottom to top."""

    name: str = Field(min_length=1)
    from_run: Yes = False
    thickness_mm: Positive | None = None
    conductivity_W_mK: Property | None = None  # noqa: N815
    density_kg_m3: Positive | None = None
    heat_capacity_J_kgK: Property | None = None  # noqa: N815

    @field_validator("conductivity_W_mK", "heat_capacity_J_kgK")
    @classmethod
    def _rising(cls, value: Property | None) -> Property | None:
        if isinstance(value, tuple):
            temperatures = [row[0] for row in value]
            if not value or any(b <= a for a, b in itertools.pairwise(temperatures)):
                raise ValueError(say("press-table-not-rising"))
        return value

    @field_validator(*LAYER_LIMITS)
    @classmethod
    def _of_matter(cls, value: Property | None, field: ValidationInfo) -> Property | None:
        lower, upper = LAYER_LIMITS[str(field.field_name)]
        for one in [y for _, y in value] if isinstance(value, tuple) else [value]:
            if one is not None and not lower <= one <= upper:
                given = {"value": f"{one:g}", "layer": str(field.data.get("name", ""))}
                raise ValueError(say("press-layer-outside", **given, lower=lower, upper=upper))
        return value

    @model_validator(mode="after")
    def _complete(self) -> Layer:
        given = {
            key: getattr(self, key)
            for key in ("thickness_mm", "conductivity_W_mK", "density_kg_m3", "heat_capacity_J_kgK")
        }
        if self.from_run:
            if surplus := [key for key, value in given.items() if value is not None]:
                raise ValueError(say("press-layer-surplus", keys=tuple(surplus)))
        elif missing := [key for key, value in given.items() if value is None]:
            raise ValueError(say("press-layer-needs", keys=tuple(missing)))
        return self


class BoundaryKind(StrEnum):
    """What a stack's end meets."""

    MEASURED = "measured"
    FLUX = "flux"
    AIR = "air"
    INSULATED = "insulated"


class InitialKind(StrEnum):
    """What a run's temperatures begin from."""

    STEADY = "steady"
    SENSORS = "sensors"
    UNIFORM = "uniform"


class Boundary(Table):
    """``[boundary.bottom]`` and ``[boundary.top]``."""

    kind: BoundaryKind = BoundaryKind.INSULATED
    column: str | None = None
    incident_W_m2: Number = 0.0  # noqa: N815
    from_run: Yes = False
    """The heat flux differs from run to run: a header without ``boundary.END.incident_W_m2`` is refused."""
    absorptivity: Share = 1.0
    emissivity: Share = 0.0
    """Of a face before a flux or air: it radiates to its surroundings beside what `coefficient` takes."""
    coefficient: str | None = None
    ambient_C: Number | None = Field(default=None, gt=COLDEST_C, lt=HOTTEST_C)  # noqa: N815
    """None takes the run's ``ambient.temperature_C``."""

    @model_validator(mode="after")
    def _complete(self) -> Boundary:
        if self.kind is BoundaryKind.MEASURED and self.column is None:
            raise ValueError(say("press-boundary-needs-column"))
        if self.kind is BoundaryKind.AIR and self.coefficient is None:
            raise ValueError(say("press-boundary-needs-coefficient"))
        if self.from_run and self.kind is not BoundaryKind.FLUX:
            raise ValueError(say("press-boundary-no-flux-of-run", kind=self.kind))
        return self


class Load(Table):
    """A contact's pressure: the column that holds it and the law that uses it."""

    column: str
    law: Literal["power"] = "power"
    reference: Positive | None = None
    """Load at which the contact's coefficient holds, in the column's unit.

    None: the run's own median, which is blind to how the steady loads of runs differ.
    """
    unit: Literal["N/cm2", "kPa", "bar", "MPa"] | None = None
    """Of the column; needed only where a program gives the pressure instead of a run."""

    def reading(self, pressure_N_cm2: float) -> float:  # noqa: N803
        """Return what the column reads at a pressure; as that stands where no unit is given."""
        return pressure_N_cm2 * _PER_N_CM2[self.unit or "N/cm2"]


class Contact(Table):
    """``[[contact]]``: names of the heat transfer coefficients between two neighbours.

    At an end with air or a flux the contact lies before the boundary's surface, in series with the boundary's
    own coefficient; at an insulated end it passes nothing.
    """

    between: tuple[str, str]
    closed: str
    open: str | tuple[str, str] | None = None
    """One name; two where the neighbours part: lower face to air, upper face to air; None as closed."""
    load: Load | None = None


HEAT_TRANSFER = (1e-3, 1e9)
"""What a heat transfer coefficient can be: from a metre of evacuated powder (about 0.001 W/mK) to solids that
touch everywhere (1e7 to 1e9; Swartz & Pohl, Rev. Mod. Phys. 61, 605, 1989). [W/m²K]"""
HeatTransfer = Annotated[Number, Field(ge=HEAT_TRANSFER[0], le=HEAT_TRANSFER[1])]


class CoefficientTable(Table):
    """``[coefficients.NAME]``: a heat transfer coefficient. [W/m²K]"""

    guess: HeatTransfer = 100.0
    lower: HeatTransfer = 0.1
    upper: HeatTransfer = 100000.0
    fixed: Yes = False

    @model_validator(mode="after")
    def _ordered(self) -> CoefficientTable:
        if not self.lower <= self.guess <= self.upper:
            raise ValueError(say("press-guess-outside", guess=self.guess, lower=self.lower, upper=self.upper))
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Where a fit must stay. [W/m²K]"""
        return self.lower, self.upper


class Prior(Table):
    """``[priors.NAME]``: what is known of a coefficient before any run is seen; log-normal."""

    median: HeatTransfer
    factor: Number = Field(gt=1.0)
    """Two in three values lie between median / factor and median x factor."""


class At(Table):
    """A place inside a layer, measured from the layer's bottom."""

    layer: str
    depth_mm: Number = Field(ge=0)


def label_of(at: str | At) -> str:
    """Return what a place is called.

    >>> label_of("panel.top"), label_of(At(layer="panel", depth_mm=5.7))
    ('panel.top', 'panel@5.7mm')
    """
    return at if isinstance(at, str) else f"{at.layer}@{at.depth_mm:g}mm"


class Sensor(Table):
    """``[[sensor]]``: run file columns (patterns allowed) and where their thermocouples sit."""

    columns: tuple[str, ...] = Field(min_length=1)
    at: str | At
    """``layer.bottom``, ``layer.middle``, ``layer.top``, or a depth."""
    role: Literal["fit", "validation"] = "fit"
    position_mm: tuple[tuple[Number, Number], ...] | None = None

    @property
    def label(self) -> str:
        """The place as ``simulate`` names its column: ``panel.top`` or ``panel@5.7mm``."""
        return label_of(self.at)


class Core(Table):
    """``[core]``: the place whose temperature is called the core's."""

    at: str | At
    """As of a sensor."""


class Initial(Table):
    """``[initial]``: the temperatures before the first row."""

    kind: InitialKind = InitialKind.STEADY
    temperature_C: Number | None = Field(default=None, gt=COLDEST_C, lt=HOTTEST_C)  # noqa: N815
    """Of ``uniform``. None: the run's ``panel.initial_temperature_C``."""


class Boundaries(Table):
    """Both ends of the stack; an end without a table is insulated."""

    bottom: Boundary = Boundary()
    top: Boundary = Boundary()

    @property
    def ends(self) -> tuple[tuple[str, Boundary], ...]:
        """Both by name, bottom before top."""
        return ("bottom", self.bottom), ("top", self.top)


class Press(Table):
    """One press, or any rig of layers: the whole press file."""

    press: PressTable = PressTable()
    """The press's name and measures."""
    layer: tuple[Layer, ...] = Field(min_length=1)
    """What heat goes through, from bottom to top."""
    boundary: Boundaries = Boundaries()
    """What is known at either end."""
    contact: tuple[Contact, ...] = ()
    """How neighbours touch, by press state."""
    coefficients: Mapping[str, CoefficientTable] = Field(default_factory=dict)
    """Guess and limits of each heat transfer coefficient, by name. [W/m²K]"""
    priors: Mapping[str, Prior] = Field(default_factory=dict)
    """What is known of a coefficient before any run is seen, by name. [W/m²K]"""
    sensor: tuple[Sensor, ...] = ()
    """Which columns are read where."""
    initial: Initial = Initial()
    """The temperatures before the first row."""
    core: Core | None = None
    """None: the middle of the panel; without a panel where the first ``validation`` sensor sits, else the middle
    of the layer in the middle."""

    def __repr__(self) -> str:
        """Return on one screen which press it is: its chain, its coefficients, where its sensors sit."""
        guesses = [f"{name} = {c.guess:g} ({c.lower:g} .. {c.upper:g})" for name, c in self.coefficients.items()]
        places = [f"{sensor.label}: {', '.join(sensor.columns)}" for sensor in self.sensor]
        lines = [str(say("printed-press", press=self.name, chain=self.chain)), *guesses, *places]
        shown = [textwrap.shorten(line, 300, placeholder=" ...") for line in lines[:KEYS_SHOWN]]
        return "\n".join([*shown, *(["..."] if len(lines) > len(shown) else [])])

    __str__ = __repr__

    def _repr_html_(self) -> str:
        return in_notebook(self)

    @property
    def name(self) -> str:
        """What the press is called."""
        return self.press.name

    @property
    def chain(self) -> tuple[str, ...]:
        """``boundary.bottom``, the layers, ``boundary.top``."""
        return ("boundary.bottom", *(layer.name for layer in self.layer), "boundary.top")

    @property
    def panel_layers(self) -> tuple[str, ...]:
        """Names of the layers that come from the run."""
        return tuple(layer.name for layer in self.layer if layer.from_run)

    @property
    def core_at(self) -> str | At:
        """Where the core is."""
        if self.core is not None:
            return self.core.at
        if self.panel_layers:
            return f"{self.panel_layers[0]}.middle"
        buried = (sensor.at for sensor in self.sensor if sensor.role == "validation")
        return next(buried, f"{self.layer[len(self.layer) // 2].name}.middle")

    def at_core(self, run: Run) -> tuple[str, ...]:
        """Return a run's channels that read the core and that nothing else sees, in file order."""
        core = label_of(self.core_at)
        return tuple(c for c, s in self.sensors_of(run, "validation").items() if s.label == core)

    @property
    def platens(self) -> tuple[str, ...]:
        """Columns of the measured boundary temperatures, bottom before top."""
        return tuple(b.column for _, b in self.boundary.ends if b.kind is BoundaryKind.MEASURED and b.column)

    @property
    def load_references(self) -> dict[int, tuple[str, float]]:
        """By contact its load's column and reference; without a reference no single scan gives the share of it."""
        loads = {m: contact.load for m, contact in enumerate(self.contact) if contact.load is not None}
        return {m: (load.column, load.reference) for m, load in loads.items() if load.reference is not None}

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        """Every coefficient that contacts and boundaries use, in order of first use."""
        names: list[str] = []
        for contact in self.contact:
            opened = () if contact.open is None else contact.open
            names += [opened] if isinstance(opened, str) else list(opened)
            names.append(contact.closed)
        names += [b.coefficient for _, b in self.boundary.ends if b.coefficient]
        return tuple(dict.fromkeys(names))

    @property
    def free_coefficients(self) -> tuple[str, ...]:
        """Those the file does not fix."""
        return tuple(n for n in self.coefficient_names if not self.coefficient(n).fixed)

    def coefficient(self, name: str) -> CoefficientTable:
        """Return the table of a coefficient, or the documented default (100, 0.1 to 100000 W/m²K)."""
        return self.coefficients.get(name, CoefficientTable())

    @property
    def has_states(self) -> bool:
        """Whether opening and closing changes anything: some contact has an ``open`` entry."""
        return any(contact.open is not None for contact in self.contact)

    def sensors_of(self, run: Run, role: Literal["fit", "validation"] = "fit") -> dict[str, Sensor]:
        """Map the run's columns of that role to their sensor tables; the first match counts."""
        found: dict[str, Sensor] = {}
        for column in run.columns:
            for sensor in self.sensor:
                if matches(column, sensor.columns):
                    if sensor.role == role:
                        found[column] = sensor
                    break
        return found

    @model_validator(mode="after")
    def _consistent(self) -> Press:
        names = [layer.name for layer in self.layer]
        if doubled := {n for n in names if names.count(n) > 1}:
            raise ValueError(say("press-layer-twice", names=tuple(sorted(doubled))))
        self._check_contacts()
        if unused := sorted(set(self.coefficients) - set(self.coefficient_names)):
            raise ValueError(
                say("press-coefficient-unused", name=f"coefficients.{unused[0]}", used=self.coefficient_names)
            )
        for name, prior in self.priors.items():
            self._check_prior(name, prior)
        for i, sensor in enumerate(self.sensor):
            self._check_place(f"sensor.{i}.at", sensor.at)
        if self.core is not None:
            self._check_place("core.at", self.core.at)
        if mistake := self.misnamed_wire:
            raise ValueError(mistake)
        self._check_initial()
        return self

    @property
    def misnamed_wire(self) -> Message | None:
        """Why limit switch or pressure channel would be taken for something else; None where they are not."""
        table = self.press
        pressure = table.pressure.column if table.pressure else ""
        if pressure == table.limit_switch:
            return _of("press.pressure.column", pressure, say("press-wire-twice"))
        known = [pattern for sensor in self.sensor for pattern in sensor.columns]
        known += [b.column for _, b in self.boundary.ends if b.column]
        for key, name in (("limit_switch", table.limit_switch), ("pressure.column", pressure)):
            if taken := [x for x in known if fnmatch.fnmatchcase(name, x)]:
                return _of(f"press.{key}", name, say("press-wire-as-temperature", pattern=taken[0]))
        return None

    def _check_contacts(self) -> None:
        neighbours = list(itertools.pairwise(self.chain))
        pairs: set[tuple[str, str]] = set()
        for i, contact in enumerate(self.contact):
            if contact.between not in neighbours:
                possible = tuple(str(list(n)) for n in neighbours)
                found = say("press-contact-no-neighbours", possible=possible)
                raise ValueError(_of(f"contact.{i}.between", list(contact.between), found))
            if contact.between in pairs:
                raise ValueError(_of(f"contact.{i}.between", list(contact.between), say("press-contact-twice")))
            pairs.add(contact.between)
            self._check_parting(i, contact)

    def _check_parting(self, i: int, contact: Contact) -> None:
        for end in ("bottom", "top"):
            kind = getattr(self.boundary, end).kind
            if (
                isinstance(contact.open, tuple)
                and f"boundary.{end}" in contact.between
                and kind in (BoundaryKind.AIR, BoundaryKind.FLUX)
            ):
                found = say("press-contact-cannot-part", boundary=f"boundary.{end}", kind=kind)
                raise ValueError(_of(f"contact.{i}.open", list(contact.open), found))

    def _check_initial(self) -> None:
        begins = self.initial
        if begins.kind is InitialKind.UNIFORM and begins.temperature_C is None and not self.panel_layers:
            raise ValueError(_of("initial.kind", begins.kind.value, say("press-initial-needs")))

    def _check_prior(self, name: str, prior: Prior) -> None:
        if name not in self.coefficient_names:
            raise ValueError(say("press-prior-unknown", name=f"priors.{name}", used=self.coefficient_names))
        table = self.coefficient(name)
        if not table.lower <= prior.median <= table.upper:
            found = say("press-prior-outside", lower=table.lower, upper=table.upper)
            raise ValueError(_of(f"priors.{name}.median", prior.median, found))

    def _check_place(self, key: str, at: str | At) -> None:
        if isinstance(at, At):
            layer = next((x for x in self.layer if x.name == at.layer), None)
            if layer is None:
                raise ValueError(_of(f"{key}.layer", at.layer, say("press-no-such-layer")))
            if layer.thickness_mm is not None and at.depth_mm > layer.thickness_mm:
                found = say("press-depth-outside", layer=layer.name, thickness_mm=layer.thickness_mm)
                raise ValueError(_of(f"{key}.depth_mm", at.depth_mm, found))
            return
        layer_name, _, place = at.rpartition(".")
        if layer_name not in {x.name for x in self.layer} or place not in ("bottom", "middle", "top"):
            raise ValueError(_of(key, at, say("press-no-place")))


def _of(key: str, value: object, what: Message) -> Message:
    return say("at-key-value", key=key, value=repr(value), what=what)


def with_sd(text: str) -> str:
    """Return a TOML text with every ``KEY.sd`` in quotes, so that it may stand beside ``KEY``."""
    return _SD_LINE.sub(r'\1"\2.sd"', text)


def parse_press(text: str, source: str | Message = "press file") -> Press:
    """Return the press a TOML text describes.

    Raises
    ------
    InputError
        Naming `source`, line or key, value and what is allowed.
    """
    try:
        return Press.model_validate(read_toml(with_sd(text)))
    except ValidationError as error:
        raise InputError(at(source, explained(error, Press))) from error
    except InputError as error:
        raise InputError(at(source, spoken(error))) from error


def read_press(path: Path) -> Press:
    """Read and check a press file. Raises `InputError`."""
    try:
        text = text_in(path)
    except (OSError, UnicodeDecodeError) as error:
        problem = say("file-cannot-read", what=say("file-of-press"), reason=reason_of(error))
        raise InputError(at(path, problem)) from error
    return parse_press(text, str(path))


def press_for_run(press: Press, run: Run) -> Press:
    """Apply the overrides in a run's header: dotted keys that start with a table of the press file.

    Layers are addressed by name (``layer.plate_top.thickness_mm``), contacts and sensors by number
    from 0 (``contact.2.closed``). Raises `InputError` for a key the press file does not know.
    """
    for end, boundary in press.boundary.ends:
        if boundary.from_run and run.header.get(key := f"boundary.{end}.incident_W_m2") is None:
            raise InputError(at(run.source or run.name, say("header-missing", key=key)))
    return overridden(press, run.header, run.source or run.name)


def overridden(press: Press, header: Mapping[str, Any], place: object) -> Press:
    """Apply a header's overrides. Raises `InputError`, beginning with `place`, as `press_for_run` does."""
    tables = set(Press.model_fields)
    overrides = {k: v for k, v in header.items() if k.partition(".")[0] in tables and "." in k}
    if not overrides:
        return press
    tree = press.model_dump(exclude_unset=True)
    for key, value in overrides.items():
        try:
            _set(tree, key.removesuffix(SD).split("."), value, SD if key.endswith(SD) else "")
        except (KeyError, IndexError, ValueError, TypeError) as error:
            problem = say("header-no-such-place", key=key)
            raise InputError(at(place, problem)) from error
    try:
        used = Press.model_validate(tree | {"coefficients": {}, "priors": {}}).coefficient_names
        for table in ("coefficients", "priors"):
            # those of the press file that this run has no use for, since it names others
            given = {key.split(".")[1] for key in overrides if key.startswith(f"{table}.")}
            tree[table] = {name: x for name, x in tree.get(table, {}).items() if name in used or name in given}
        return Press.model_validate(tree)
    except ValidationError as error:
        problem = say("header-override", what=explained(error, Press))
        raise InputError(at(place, problem)) from error


def _set(tree: Any, keys: list[str], value: Any, ending: str = "") -> None:
    """Put `value` at a dotted place in nested tables, choosing list items by name or number."""
    for i, key in enumerate(keys[:-1]):
        if isinstance(tree, tuple | list):
            named = [item for item in tree if item.get("name") == key]
            tree = named[0] if named else tree[int(key)]
        elif i > 0:
            if not isinstance(tree.get(key), dict | tuple | list):
                tree[key] = {}  # a table in place of a value, as a sensor's depth in place of its name
            tree = tree[key]
        else:
            tree = (
                tree.setdefault(key, {})
                if i == 0 and key in ("boundary", "initial", "coefficients", "press", "priors", "core")
                else tree[key]
            )
    if not isinstance(tree, dict):
        raise TypeError
    tree[keys[-1] + ending] = value
