"""The resin file: how the resin of the impregnated paper cures, and the limits a panel must keep at opening.

TOML with one of three tables of kinetics: ``[order]``, ``[kamal]`` or ``[isoconversional]``; beside it
``[limits]``, ``[grades]`` and ``[sorption]``. ``KEY.sd`` beside a number is its standard deviation, as in a press
file. What the numbers mean in an equation stands in `softsensor.opening.kinetics`.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Annotated

from pydantic import Field, TypeAdapter, ValidationError, field_validator, model_validator

from daq.press.press_file import Number, Positive, Share, Table, Yes, with_sd
from daq.records import COLDEST_C, GAS_CONSTANT, HOTTEST_C, InputError
from daq.tables import at, explained, read_toml, reason_of, text_in
from daq.words import say, spoken

REFERENCE_C = 140.0
"""Where rates are given unless a file says otherwise: amid the temperatures of papers in a press. [°C]"""
PROBABILITY = 0.975
"""Wanted unless a file says otherwise: the contract's band of 95 %, of which one side counts."""
Energy = Annotated[Number, Field(gt=5.0, lt=1000.0)]
"""[kJ/mol] Below is no reaction (diffusion in water: 18), above no bond (C≡O: 1077)."""
Rate = Annotated[Number, Field(gt=1e-12, lt=1e6)]
"""[1/s]"""
_RATE = TypeAdapter(Rate)
_Temperature = Annotated[Number, Field(gt=COLDEST_C, lt=HOTTEST_C)]


class ResinTable(Table):
    """``[resin]``: where the numbers come from."""

    name: str = Field(min_length=1)
    source: str = Field(min_length=1)
    """Who measured them, on what, where published."""
    verified: Yes | None = None
    """Whether someone has compared the numbers with the source; where nobody has, a prediction says so."""
    example: Yes = False
    """Not of a resin anybody presses: to be replaced by its own measurements."""


class _Law(Table):
    """What the tables of kinetics have in common."""

    reference_temperature_C: _Temperature = REFERENCE_C  # noqa: N815
    """Where rates hold. Errors of rate and activation energy are taken as independent there."""

    def _check_rate(self, key: str, log_prefactor: float, energy_kJ_mol: float) -> None:  # noqa: N803
        """Refuse a law whose rate at the reference temperature no `Rate` is. Raises `ValueError`."""
        kelvin = self.reference_temperature_C - COLDEST_C
        log_rate = log_prefactor - 1e3 * energy_kJ_mol / (GAS_CONSTANT * kelvin)
        try:
            _RATE.validate_python(math.exp(log_rate))
        except (ValidationError, OverflowError):
            power, at_C = log_rate * math.log10(math.e), self.reference_temperature_C  # noqa: N806
            raise ValueError(say("resin-rate-impossible", key=key, power=power, at_C=at_C)) from None


class OrderLaw(_Law):
    """``[order]``: dα/dt = k (1 - α)^order."""

    rate_per_s: Rate | None = None
    """k at the reference temperature."""
    prefactor_per_s: Annotated[Number, Field(gt=0.0, lt=1e60)] | None = None
    """Or A of k = A exp(-E/RT)."""
    activation_energy_kJ_mol: Energy  # noqa: N815
    order: Annotated[Number, Field(gt=0.0, le=5.0)] = 1.0

    @model_validator(mode="after")
    def _one_rate(self) -> OrderLaw:
        if (self.rate_per_s is None) == (self.prefactor_per_s is None):
            raise ValueError(say("resin-one-rate"))
        _only(self, ("rate_per_s", "prefactor_per_s", "activation_energy_kJ_mol"))
        if self.prefactor_per_s is not None:
            self._check_rate("prefactor_per_s", math.log(self.prefactor_per_s), self.activation_energy_kJ_mol)
        return self


class KamalLaw(_Law):
    """``[kamal]``: dα/dt = (k₁ + k₂ α^order_m) (1 - α)^order_n."""

    rate_1_per_s: Rate
    rate_2_per_s: Rate
    activation_energy_1_kJ_mol: Energy  # noqa: N815
    activation_energy_2_kJ_mol: Energy  # noqa: N815
    order_m: Annotated[Number, Field(gt=0.0, le=5.0)] = 1.0
    order_n: Annotated[Number, Field(gt=0.0, le=5.0)] = 1.0
    relative_sd: Annotated[Number, Field(ge=0.0, lt=1.0)] = 0.0
    """Of both rates together."""
    activation_energy_relative_sd: Annotated[Number, Field(ge=0.0, lt=1.0)] = 0.0
    """Of both activation energies together."""

    @model_validator(mode="after")
    def _no_other_sd(self) -> KamalLaw:
        _only(self, ())
        return self


class IsoconversionalLaw(_Law):
    """``[isoconversional]``: dα/dt = exp(ln[A f](α) - E(α)/RT), as Friedman's analysis of DSC scans gives it."""

    table: tuple[tuple[Number, Energy, Number], ...]
    """Rows of conversion, activation energy [kJ/mol], ln(A f(α) · s)."""
    relative_sd: Annotated[Number, Field(ge=0.0, lt=1.0)] = 0.0
    """Of all rates together, at the reference temperature."""
    activation_energy_relative_sd: Annotated[Number, Field(ge=0.0, lt=1.0)] = 0.0
    """Of all activation energies together."""

    @field_validator("table")
    @classmethod
    def _rising(cls, rows: tuple[tuple[float, float, float], ...]) -> tuple[tuple[float, float, float], ...]:
        at_rows = [row[0] for row in rows]
        if len(rows) < 2 or not all(a < b for a, b in itertools.pairwise((0.0, *at_rows, 1.0))):
            raise ValueError(say("resin-table-not-rising"))
        return rows

    @model_validator(mode="after")
    def _possible(self) -> IsoconversionalLaw:
        _only(self, ())
        for i, (_, energy, log_prefactor) in enumerate(self.table):
            self._check_rate(f"table.{i}", log_prefactor, energy)
        return self


def _only(law: Table, keys: tuple[str, ...]) -> None:
    """Refuse a standard deviation that no band would hold. Raises `ValueError`."""
    if unused := next((key for key in law.spreads if key not in keys), None):
        raise ValueError(say("resin-sd-unused", key=unused))


class LimitsTable(Table):
    """``[limits]``: what must hold at opening; a limit that is left out is none."""

    cure_least: Annotated[Number, Field(gt=0.0, lt=1.0)] | None = None
    """Degree of cure at either face."""
    core_least_C: _Temperature | None = None  # noqa: N815
    core_most_C: _Temperature | None = None  # noqa: N815
    steam_most_kPa: Positive | None = None  # noqa: N815
    """Partial pressure of steam in the panel; its ``sd`` is what panels differ by, and what is not known of it."""
    steam_believed_kPa: Positive | None = None  # noqa: N815
    """What was believed of it before any panel was marked, where `steam_most_kPa` was learned from marks:
    these must not count twice when more are learned from. It limits nothing."""
    probability: Annotated[Number, Field(ge=0.5, lt=1.0)] = PROBABILITY
    """With which all of them hold together."""

    @model_validator(mode="after")
    def _no_other_sd(self) -> LimitsTable:
        _only(self, ("steam_most_kPa", "steam_believed_kPa"))
        least, most = self.core_least_C, self.core_most_C
        if least is not None and most is not None and least >= most:
            raise ValueError(say("resin-limits-exclude", least=least, most=most))
        return self

    @property
    def any(self) -> bool:
        """Whether there is a limit at all."""
        given = (self.cure_least, self.core_least_C, self.core_most_C, self.steam_most_kPa)
        return any(limit is not None for limit in given)


class GradesTable(Table):
    """``[grades]``: from which degree of cure a face is what; below both it is undercured."""

    matt_from: Share | None = None
    glossy_from: Share | None = None

    def grade(self, cure: float) -> str:
        """Return the name of a face's grade, empty where no threshold is given.

        Examples
        --------
        >>> GradesTable(matt_from=0.7, glossy_from=0.85).grade(0.8)
        'matt'
        """
        given = [(self.matt_from, "matt"), (self.glossy_from, "glossy")]
        steps = sorted((limit, name) for limit, name in given if limit is not None)
        if not steps:
            return ""
        return next((name for limit, name in reversed(steps) if cure >= limit), "undercured")


class SorptionTable(Table):
    """``[sorption]``: how much water the board holds beside solid wood at the same humidity."""

    factor: Annotated[Number, Field(gt=0.2, lt=3.0)] = 1.0
    """Its equilibrium moisture over solid wood's."""
    factor_sd: Annotated[Number, Field(ge=0.0, lt=1.0)] = 0.15
    """Standard deviation of the factor: boards of fibres and resin hold a tenth to a third less than solid wood.
    Set by hand, 2026-11."""


class Resin(Table):
    """A checked resin file."""

    resin: ResinTable
    """Its name, and where its numbers are from."""
    order: OrderLaw | None = None
    """How fast it cures, as a law of nth order; exactly one of the three laws is given."""
    kamal: KamalLaw | None = None
    """How fast it cures by Kamal's law, else None."""
    isoconversional: IsoconversionalLaw | None = None
    """How fast it cures by a table over conversion, else None."""
    limits: LimitsTable = Field(default_factory=LimitsTable)
    """What must hold at opening."""
    grades: GradesTable = Field(default_factory=GradesTable)
    """From which degree of cure a face is matt or glossy."""
    sorption: SorptionTable = Field(default_factory=SorptionTable)
    """How much water the board holds."""

    @model_validator(mode="after")
    def _one_law(self) -> Resin:
        if sum(law is not None for law in (self.order, self.kamal, self.isoconversional)) != 1:
            raise ValueError(say("resin-one-law"))
        return self


def parse_resin(text: str, source: str = "resin file") -> Resin:
    """Return the resin a TOML text describes. Raises `InputError` naming `source`, key, value and limit."""
    try:
        return Resin.model_validate(read_toml(with_sd(text)))
    except ValidationError as error:
        raise InputError(at(source, explained(error, Resin))) from error
    except InputError as error:
        raise InputError(at(source, spoken(error))) from error


def read_resin(path: Path) -> Resin:
    """Read and check a resin file. Raises `InputError`."""
    try:
        text = text_in(path)
    except (OSError, UnicodeDecodeError) as error:
        problem = say("file-cannot-read", what=say("file-of-resin"), reason=reason_of(error))
        raise InputError(at(path, problem)) from error
    return parse_resin(text, str(path))
