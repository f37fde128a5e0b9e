"""The press file: layers, contacts, boundaries, sensors; read from TOML and checked at once.

The classes are the checked description other code works on. Lengths stay in the file's unit
(the field name says which). Every message names file, key, value and what would be right.
"""

from __future__ import annotations

import fnmatch
import itertools
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from daq.materials import MATERIALS, find_material
from daq.records import InputError, Nonphysical, Panel, Run

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
"""No text and no ``true``."""
Positive = Annotated[Number, Field(gt=0)]
Temperature = Annotated[Number, Field(gt=-273.15, lt=5000)]
Share = Annotated[Number, Field(ge=0, le=1)]
Yes = Annotated[bool, Field(strict=True)]
Property = Positive | tuple[tuple[Temperature, Positive], ...]
"""A number, or rows of temperature [°C] and value."""


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Pressure(_Table):
    """``press.pressure``: a channel whose pressure tells whether the press is closed."""

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
            raise ValueError(f"open_below = {self.lower:g} lies above closed_above = {self.closed_above:g}")
        return self


class PressTable(_Table):
    """``[press]``."""

    name: str = "press"
    area_m2: Positive = 1.0
    limit_switch: str = Field(default="closed", min_length=1)
    """Column of a limit switch, 1 while the press is closed; it goes before pressure and temperatures."""
    pressure: Pressure | None = None


class Layer(_Table):
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
                raise ValueError("a table needs at least one row, its temperatures rising")
        return value

    @model_validator(mode="after")
    def _complete(self) -> Layer:
        given = {
            key: getattr(self, key)
            for key in ("thickness_mm", "conductivity_W_mK", "density_kg_m3", "heat_capacity_J_kgK")
        }
        if self.from_run:
            if surplus := [key for key, value in given.items() if value is not None]:
                raise ValueError(f"from_run = true takes its constants from the run; remove {', '.join(surplus)}")
        elif missing := [key for key, value in given.items() if value is None]:
            raise ValueError(f"needs {', '.join(missing)} (or from_run = true)")
        return self


class Boundary(_Table):
    """``[boundary.bottom]`` and ``[boundary.top]``."""

    kind: Literal["measured", "flux", "air", "insulated"] = "insulated"
    column: str | None = None
    incident_W_m2: Number = 0.0  # noqa: N815
    absorptivity: Share = 1.0
    emissivity: Share = 0.0
    coefficient: str | None = None
    ambient_C: Number | None = Field(default=None, gt=-273.15, lt=2000)  # noqa: N815
    """None takes the run's ``ambient.temperature_C``."""

    @model_validator(mode="after")
    def _complete(self) -> Boundary:
        if self.kind == "measured" and self.column is None:
            raise ValueError('kind = "measured" needs column, the run file column with its temperature')
        if self.kind == "air" and self.coefficient is None:
            raise ValueError('kind = "air" needs coefficient, the name of its heat transfer coefficient')
        return self


class Load(_Table):
    """A contact's pressure: the column that holds it and the law that uses it."""

    column: str
    law: Literal["power"] = "power"
    reference: Positive | None = None
    """Load at which the contact's coefficient holds, in the column's unit.

    None: the run's own median, which cannot tell runs of different steady loads apart.
    """


class Contact(_Table):
    """``[[contact]]``: names of the heat transfer coefficients between two neighbours.

    At an end with air or a flux the contact lies before the boundary's surface, in series with the boundary's
    own coefficient; at an insulated end it passes nothing.
    """

    between: tuple[str, str]
    closed: str
    open: str | tuple[str, str] | None = None
    """One name; two where the neighbours part: lower face to air, upper face to air; None as closed."""
    load: Load | None = None


class Coefficient(_Table):
    """``[coefficients.NAME]``: a heat transfer coefficient. [W/m²K]"""

    guess: Positive = 100.0
    lower: Positive = 0.1
    upper: Positive = 100000.0
    fixed: Yes = False

    @model_validator(mode="after")
    def _ordered(self) -> Coefficient:
        if not self.lower <= self.guess <= self.upper:
            raise ValueError(f"guess = {self.guess:g} lies outside lower..upper = {self.lower:g}..{self.upper:g}")
        return self


class Prior(_Table):
    """``[priors.NAME]``: what is known of a coefficient before any run is seen; log-normal."""

    median: Positive
    factor: Number = Field(gt=1.0)
    """Two in three values lie between median / factor and median x factor."""


class At(_Table):
    """A place inside a layer, measured from the layer's bottom."""

    layer: str
    depth_mm: Number = Field(ge=0)


class Sensor(_Table):
    """``[[sensor]]``: run file columns (patterns allowed) and where their thermocouples sit."""

    columns: tuple[str, ...] = Field(min_length=1)
    at: str | At
    """``layer.bottom``, ``layer.middle``, ``layer.top``, or a depth."""
    role: Literal["fit", "validation"] = "fit"
    position_mm: tuple[tuple[Number, Number], ...] | None = None

    @property
    def label(self) -> str:
        """The place as ``simulate`` names its column: ``panel.top`` or ``panel@5.7mm``."""
        return self.at if isinstance(self.at, str) else f"{self.at.layer}@{self.at.depth_mm:g}mm"


class Initial(_Table):
    """``[initial]``: the temperatures before the first row."""

    kind: Literal["steady", "sensors", "uniform"] = "steady"
    temperature_C: Number | None = Field(default=None, gt=-273.15, lt=2000)  # noqa: N815

    @model_validator(mode="after")
    def _complete(self) -> Initial:
        if self.kind == "uniform" and self.temperature_C is None:
            raise ValueError('kind = "uniform" needs temperature_C')
        return self


class Boundaries(_Table):
    """Both ends of the stack; an end without a table is insulated."""

    bottom: Boundary = Boundary()
    top: Boundary = Boundary()


class Press(_Table):
    """One press, or any rig of layers: the whole press file."""

    press: PressTable = PressTable()
    layer: tuple[Layer, ...] = Field(min_length=1)
    boundary: Boundaries = Boundaries()
    contact: tuple[Contact, ...] = ()
    coefficients: Mapping[str, Coefficient] = Field(default_factory=dict)
    priors: Mapping[str, Prior] = Field(default_factory=dict)
    sensor: tuple[Sensor, ...] = ()
    initial: Initial = Initial()

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
    def coefficient_names(self) -> tuple[str, ...]:
        """Every coefficient that contacts and boundaries use, in order of first use."""
        names: list[str] = []
        for contact in self.contact:
            opened = () if contact.open is None else contact.open
            names += [opened] if isinstance(opened, str) else list(opened)
            names.append(contact.closed)
        names += [b.coefficient for b in (self.boundary.bottom, self.boundary.top) if b.coefficient]
        return tuple(dict.fromkeys(names))

    def coefficient(self, name: str) -> Coefficient:
        """Return the table of a coefficient, or the documented default (100, 0.1 to 100000 W/m²K)."""
        return self.coefficients.get(name, Coefficient())

    @property
    def has_states(self) -> bool:
        """Whether opening and closing changes anything: some contact has an ``open`` entry."""
        return any(contact.open is not None for contact in self.contact)

    def sensors_of(self, run: Run, role: Literal["fit", "validation"] = "fit") -> dict[str, Sensor]:
        """Map the run's columns of that role to their sensor tables; the first match counts."""
        found: dict[str, Sensor] = {}
        for column in run.columns:
            for sensor in self.sensor:
                if any(fnmatch.fnmatchcase(column, pattern) for pattern in sensor.columns):
                    if sensor.role == role:
                        found[column] = sensor
                    break
        return found

    @model_validator(mode="after")
    def _consistent(self) -> Press:
        names = [layer.name for layer in self.layer]
        if doubled := {n for n in names if names.count(n) > 1}:
            raise ValueError(f"layer names must differ; {sorted(doubled)} occurs twice")
        neighbours = list(itertools.pairwise(self.chain))
        seen: set[tuple[str, str]] = set()
        for i, contact in enumerate(self.contact):
            if contact.between not in neighbours:
                raise ValueError(
                    f"contact.{i}.between = {list(contact.between)}: not neighbours, listed from bottom to top; "
                    f"possible are {[list(n) for n in neighbours]}"
                )
            if contact.between in seen:
                raise ValueError(f"contact.{i}.between = {list(contact.between)}: given twice")
            seen.add(contact.between)
            self._check_parting(i, contact)
        if unused := sorted(set(self.coefficients) - set(self.coefficient_names)):
            raise ValueError(
                f"coefficients.{unused[0]}: no contact or boundary uses it; "
                f"used are {list(self.coefficient_names)}"
            )
        for name, prior in self.priors.items():
            self._check_prior(name, prior)
        for i, sensor in enumerate(self.sensor):
            self._check_place(i, sensor)
        if said := self.misnamed_wire:
            raise ValueError(said)
        return self

    @property
    def misnamed_wire(self) -> str:
        """Why limit switch or pressure channel would be taken for something else; empty where they are not."""
        table = self.press
        pressure = table.pressure.column if table.pressure else ""
        if pressure == table.limit_switch:
            return f"press.pressure.column = {pressure!r}: is the limit switch already; name another column"
        known = [pattern for sensor in self.sensor for pattern in sensor.columns]
        known += [b.column for b in (self.boundary.bottom, self.boundary.top) if b.column]
        for key, name in (("limit_switch", table.limit_switch), ("pressure.column", pressure)):
            if taken := [x for x in known if fnmatch.fnmatchcase(name, x)]:
                return (
                    f"press.{key} = {name!r}: would be read as a temperature, by {taken[0]!r}; rename the channel"
                )
        return ""

    def _check_parting(self, i: int, contact: Contact) -> None:
        for end in ("bottom", "top"):
            kind = getattr(self.boundary, end).kind
            if (
                isinstance(contact.open, tuple)
                and f"boundary.{end}" in contact.between
                and kind in ("air", "flux")
            ):
                raise ValueError(
                    f"contact.{i}.open = {list(contact.open)}: boundary.{end} is of kind {kind!r}, from which no "
                    f"layer parts; give one name"
                )

    def _check_prior(self, name: str, prior: Prior) -> None:
        if name not in self.coefficient_names:
            raise ValueError(f"priors.{name}: no such coefficient; used are {list(self.coefficient_names)}")
        table = self.coefficient(name)
        if not table.lower <= prior.median <= table.upper:
            raise ValueError(
                f"priors.{name}.median = {prior.median:g}: outside the coefficient's limits "
                f"{table.lower:g}..{table.upper:g}"
            )

    def _check_place(self, i: int, sensor: Sensor) -> None:
        if isinstance(sensor.at, At):
            layer = next((x for x in self.layer if x.name == sensor.at.layer), None)
            if layer is None:
                raise ValueError(f"sensor.{i}.at.layer = {sensor.at.layer!r}: no such layer")
            if layer.thickness_mm is not None and sensor.at.depth_mm > layer.thickness_mm:
                raise ValueError(
                    f"sensor.{i}.at.depth_mm = {sensor.at.depth_mm:g}: outside layer {layer.name!r}, "
                    f"which is {layer.thickness_mm:g} mm thick"
                )
            return
        layer_name, _, place = sensor.at.rpartition(".")
        if layer_name not in {x.name for x in self.layer} or place not in ("bottom", "middle", "top"):
            raise ValueError(
                f"sensor.{i}.at = {sensor.at!r}: must be LAYER.bottom, LAYER.middle, LAYER.top "
                f"or {{ layer = LAYER, depth_mm = ... }}"
            )


def parse_press(text: str, source: str = "press file") -> Press:
    """Return the press a TOML text describes.

    Raises
    ------
    InputError
        Naming `source`, line or key, value and what is allowed.
    """
    try:
        return Press.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{source}: not valid TOML: {error}") from error
    except ValidationError as error:
        raise InputError(f"{source}: {explain(error)}") from error


def read_press(path: Path) -> Press:
    """Read and check a press file. Raises `InputError`."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot read the press file: {_reason(error)}") from error
    return parse_press(text, str(path))


def press_for_run(press: Press, run: Run) -> Press:
    """Apply the overrides in a run's header: dotted keys that start with a table of the press file.

    Layers are addressed by name (``layer.plate_top.thickness_mm``), contacts and sensors by number
    from 0 (``contact.2.closed``). Raises `InputError` for a key the press file does not know.
    """
    tables = set(Press.model_fields)
    overrides = {k: v for k, v in run.header.items() if k.partition(".")[0] in tables and "." in k}
    if not overrides:
        return press
    tree = press.model_dump(exclude_unset=True)
    for key, value in overrides.items():
        try:
            _set(tree, key.split("."), value)
        except (KeyError, IndexError, ValueError, TypeError) as error:
            raise InputError(
                f"{run.source or run.name}: header key {key}: the press file has no such place"
            ) from error
    try:
        used = Press.model_validate(tree | {"coefficients": {}, "priors": {}}).coefficient_names
        for table in ("coefficients", "priors"):
            # those of the press file that this run has no use for, since it names others
            given = {key.split(".")[1] for key in overrides if key.startswith(f"{table}.")}
            tree[table] = {name: x for name, x in tree.get(table, {}).items() if name in used or name in given}
        return Press.model_validate(tree)
    except ValidationError as error:
        raise InputError(f"{run.source or run.name}: header override: {explain(error)}") from error


def panel_of(run: Run) -> Panel:
    """Return the panel a run's header describes, completed from the material table.

    Raises
    ------
    InputError
        For a missing or nonphysical key.
    """
    header, where = run.header, run.source or run.name
    material = str(header.get("panel.material", ""))
    known = find_material(material) if material else None

    def number(key: str, default: float | None, lower: float, upper: float) -> float:
        value = header.get(f"panel.{key}", default)
        if value is None:
            unknown = known is None and key in ("density_kg_m3", "conductivity_W_mK", "heat_capacity_J_kgK")
            listed = f" and material {material!r} is not in the table ({', '.join(MATERIALS)})" if unknown else ""
            raise InputError(f"{where}: header key panel.{key} is missing{listed}; add '# panel.{key} = ...'")
        if isinstance(value, bool) or not isinstance(value, int | float) or not lower <= value <= upper:
            raise Nonphysical(
                f"{where}: header key panel.{key} = {value!r}: must be a number from {lower:g} to {upper:g}"
            )
        return float(value)

    moisture = header.get("panel.moisture_percent")
    return Panel(
        material=material,
        thickness=number("thickness_mm", None, 0.1, 500.0) / 1000.0,
        density=number("density_kg_m3", known.density if known else None, 5.0, 25000.0),
        conductivity=number("conductivity_W_mK", known.conductivity if known else None, 0.005, 500.0),
        heat_capacity=number("heat_capacity_J_kgK", known.heat_capacity if known else None, 50.0, 10000.0),
        initial_temperature=number("initial_temperature_C", None, -60.0, 400.0),
        moisture_percent=None if moisture is None else number("moisture_percent", None, 0.0, 200.0),
    )


def explain(error: ValidationError) -> str:
    """Say in one line what is wrong: key, value, limit."""
    lines = []
    items = error.errors()
    own = [item for item in items if item["type"] != "too_short"]
    for item in (own or items)[:3]:
        key = ".".join(
            str(p) for p in item["loc"] if not str(p).startswith(("function-", "constrained-", "tuple["))
        )
        message = item["msg"].removeprefix("Value error, ")
        if item["type"] == "extra_forbidden":
            message = "unknown key; remove it or check its spelling"
        value = item.get("input")
        shown = f" = {value!r}" if isinstance(value, str | int | float | bool) else ""
        lines.append(f"{key}{shown}: {message}" if key else message)
    return "; ".join(dict.fromkeys(lines))


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def _set(tree: Any, keys: list[str], value: Any) -> None:
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
                if i == 0 and key in ("boundary", "initial", "coefficients", "press", "priors")
                else tree[key]
            )
    if not isinstance(tree, dict):
        raise TypeError
    tree[keys[-1]] = value
