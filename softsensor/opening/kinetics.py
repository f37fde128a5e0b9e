"""Degree of cure along a temperature course, with the uncertainty of course and kinetics. Pure functions.

Every law is brought to one form: the *equivalent time* x, the seconds at the reference temperature that cure as
far as the course has. It grows at a pace that is 1 at the reference temperature T₀ (in K),

    dx/dt = e^δ Σⱼ wⱼ(x) exp(-Eⱼ(x) (1 + ε)/R · (1/T - 1/T₀)),     α = α₀(x),

with α₀ the law's own isotherm at T₀, wⱼ the share of each rate constant in the rate there, δ the error of the
rates at T₀ and ε the relative error of the activation energies. For one rate constant (n-th order,
isoconversional) this is exact, with E of the conversion reached; so it is for Kamal's two, whose shares are those
at T₀.

ln x is close to linear in what is uncertain, and so near a normal distribution: a band is one of ln x, and α₀ is
monotonous. A Monte Carlo holds against it in `tests/softsensor/test_opening.py`. Vyazovkin's J(E, T(t)) exp(E/RT₀)
is the same quantity (S. Vyazovkin et al., ICTAC recommendations, Thermochim. Acta 520 (2011) 1; Kamal's law:
M. R. Kamal, S. Sourour, Polym. Eng. Sci. 13 (1973) 59).

What it does not know: diffusion that stops a reaction as the resin vitrifies, and water in the paper. Both slow
the last tenths of cure; a law measured on the impregnated paper under pressure holds them, one of liquid resin
does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from daq.press.resin_file import IsoconversionalLaw, KamalLaw, OrderLaw, Resin
from daq.records import COLDEST_C, GAS_CONSTANT, Array

OUTERMOST, CELLS = 14.0, 1400
"""The isotherm is laid out evenly in ln(α / (1 - α)) from -14 to 14: conversions of 8e-7 to 1 - 8e-7."""
STEP_K = 10.0
"""A step in which the temperature changes by more is cut: Simpson's rule then errs by less than 1e-4."""
_SIMPSON = ((0.0, 1 / 6), (0.5, 2 / 3), (1.0, 1 / 6))
"""Places in a step and their weights, by Simpson's rule."""
_NUDGE = 1e-3
"""Of ln x, for the slope of the pace by it."""


@dataclass(frozen=True)
class Kinetics:
    """A law of cure at its reference temperature, and how its pace changes with temperature."""

    reference_K: float  # noqa: N815
    log_time: Array
    """ln of the equivalent time (n), rising. [ln s]"""
    logit: Array
    """ln(α / (1 - α)) there (n), rising."""
    share: Array
    """Share of each rate constant in the rate there (n, J)."""
    energy: Array
    """Activation energy of each (n, J). [J/mol]"""
    log_rate_sd: float
    """Standard deviation of δ, the error of ln rate at the reference temperature."""
    energy_sd: float
    """Standard deviation of ε, the relative error of the activation energies."""

    def cure(self, equivalent_s: Array | float) -> Array:
        """Return the degree of cure after equivalent times (any shape), each at least 0. [s]

        Examples
        --------
        >>> first_order = kinetics_of(OrderLaw(rate_per_s=0.05, activation_energy_kJ_mol=80.0))
        >>> float(first_order.cure(20.0).round(5)), round(1 - math.exp(-1), 5)
        (0.63212, 0.63212)
        """
        x = np.asarray(equivalent_s, dtype=float)
        log_x = np.log(np.maximum(x, 1e-300))
        inside = 1.0 / (1.0 + np.exp(-np.interp(log_x, self.log_time, self.logit)))
        return np.asarray(np.where(log_x < self.log_time[0], inside * np.exp(log_x - self.log_time[0]), inside))

    def equivalent_s(self, cure: float) -> float:
        """Return the time at the reference temperature that cures so far, 0 < `cure` < 1. [s]

        Infinite beyond what is laid out: nobody knows when so much is cured, and no shorter time will do.
        """
        return float(np.exp(np.interp(math.log(cure / (1.0 - cure)), self.logit, self.log_time, right=math.inf)))

    def pace(self, equivalent_s: Array, temperature_C: Array, errors: Array | None = None) -> Array:
        """Return dx/dt (any shape). [s/s]

        Parameters
        ----------
        equivalent_s
            Equivalent time so far. [s]
        temperature_C
            Of the resin, of the same shape. [°C]
        errors
            δ and ε in their standard deviations (2, ...); None: none.
        """
        terms, _ = self.summands(equivalent_s, temperature_C, errors)
        return np.asarray(terms.sum(axis=-1))

    def summands(self, x: Array, temperature_C: Array, errors: Array | None) -> tuple[Array, Array]:
        """Return the summands of the pace [s/s], and the exponent of each (..., J); arguments as of `pace`."""
        log_x = np.log(np.maximum(x, 1e-300))
        away = 1.0 / (np.asarray(temperature_C) - COLDEST_C) - 1.0 / self.reference_K
        delta, epsilon = (
            (0.0, 0.0) if errors is None else (errors[0] * self.log_rate_sd, errors[1] * self.energy_sd)
        )
        columns = range(self.share.shape[1])
        share = np.stack([np.interp(log_x, self.log_time, self.share[:, j]) for j in columns], axis=-1)
        energy = np.stack([np.interp(log_x, self.log_time, self.energy[:, j]) for j in columns], axis=-1)
        exponent = -energy * (np.asarray(away * (1.0 + epsilon)) / GAS_CONSTANT)[..., None]
        return share * np.exp(exponent + np.asarray(delta)[..., None]), exponent


class CureProgress(NamedTuple):
    """How far faces have cured (F), and how that depends on what is uncertain (P)."""

    equivalent_s: Array
    """Equivalent time (F). [s]"""
    by_parameter: Array
    """Its derivative by the parameters of the temperature course (F, P). [s]"""
    by_error: Array
    """Its derivative by δ and ε in their standard deviations (F, 2). [s]"""

    @staticmethod
    def begin(faces: int, parameters: int) -> CureProgress:
        """Return uncured faces."""
        return CureProgress(np.zeros(faces), np.zeros((faces, parameters)), np.zeros((faces, 2)))


class Course(NamedTuple):
    """Faces over one step, straight in time."""

    before_C: Array  # noqa: N815
    """(F)"""
    after_C: Array  # noqa: N815
    """(F)"""
    d_before: Array
    """Derivative by the course's parameters (F, P). [K]"""
    d_after: Array
    """(F, P)"""
    seconds: float


def advance(kinetics: Kinetics, progress: CureProgress, course: Course) -> CureProgress:
    """Return the progress after a step.

    Simpson's rule over pieces of `STEP_K`, the dependence of the pace on x taken at each piece's middle: second
    order in the piece, exact in x where the law has one constant activation energy.
    """
    change = float(np.abs(course.after_C - course.before_C).max(initial=0.0))
    pieces = max(1, math.ceil(change / STEP_K))
    h = course.seconds / pieces
    for k in range(pieces):
        progress = _piece(kinetics, progress, course, (k / pieces, 1.0 / pieces, h))
    return progress


def _piece(
    kinetics: Kinetics, now: CureProgress, course: Course, piece: tuple[float, float, float]
) -> CureProgress:
    """Advance over a share of a step: its begin and length as shares, and its length. [-, -, s]"""
    begin, length, h = piece
    middle = course.before_C + (begin + 0.5 * length) * (course.after_C - course.before_C)
    x = now.equivalent_s + 0.5 * h * kinetics.pace(now.equivalent_s, middle)
    gained = np.zeros_like(x)
    d_parameter, d_error = now.by_parameter.copy(), now.by_error.copy()
    for node, weight in _SIMPSON:
        u = begin + node * length
        temperature = course.before_C + u * (course.after_C - course.before_C)
        terms, exponent = kinetics.summands(x, temperature, None)
        pace = terms.sum(axis=-1)
        kelvin = temperature - COLDEST_C
        # d exponent/dT = E/(R T²), written with the exponent so that it needs no second table look-up
        away = 1.0 / kelvin - 1.0 / kinetics.reference_K
        safe = np.where(np.abs(away) < 1e-12, 1e-12, away)
        by_T = (terms * -exponent).sum(axis=-1) / (safe * kelvin**2)
        by_log_x = (kinetics.pace(x * math.exp(_NUDGE), temperature) - pace) / _NUDGE
        stretch = (h * weight) * by_log_x / np.maximum(x, 1e-300)
        gained += h * weight * pace
        slope = course.d_before + u * (course.d_after - course.d_before)
        d_parameter += (h * weight * by_T)[:, None] * slope + stretch[:, None] * now.by_parameter
        by_energy = (terms * exponent).sum(axis=-1) * kinetics.energy_sd
        d_error[:, 0] += h * weight * pace * kinetics.log_rate_sd
        d_error[:, 1] += h * weight * by_energy
        d_error += stretch[:, None] * now.by_error
    return CureProgress(now.equivalent_s + gained, d_parameter, d_error)


def equivalent_course(kinetics: Kinetics, time_s: Array, face_C: Array, errors: Array | None = None) -> Array:
    """Return the equivalent time along courses, for a table of times, many courses at once. [s]

    For planning and for tests: no derivatives, but every course may have errors of its own.

    Parameters
    ----------
    time_s
        Rising (t). [s]
    face_C
        Temperature of the resin at these times, straight in between (..., t). [°C]
    errors
        δ and ε of each course in their standard deviations (2, ...); None: none.

    Examples
    --------
    >>> law = kinetics_of(OrderLaw(rate_per_s=0.05, activation_energy_kJ_mol=80.0))
    >>> t = np.linspace(0.0, 20.0, 5)
    >>> equivalent_course(law, t, np.full(5, 140.0)).round(6).tolist()
    [0.0, 5.0, 10.0, 15.0, 20.0]
    """
    out = np.zeros(face_C.shape)
    x = np.zeros(face_C.shape[:-1])
    for k in range(1, len(time_s)):
        before, after = face_C[..., k - 1], face_C[..., k]
        change = float(np.abs(after - before).max(initial=0.0))
        pieces = max(1, math.ceil(change / STEP_K)) if math.isfinite(change) else 1
        h = float(time_s[k] - time_s[k - 1]) / pieces
        for i in range(pieces):
            at = [before + (i + node) / pieces * (after - before) for node, _ in _SIMPSON]
            middle = x + 0.5 * h * kinetics.pace(x, at[1], errors)
            weights = [weight for _, weight in _SIMPSON]
            x = x + h * sum(w * kinetics.pace(middle, t, errors) for w, t in zip(weights, at, strict=True))
        out[..., k] = x
    return out


def kinetics_of(law: Resin | OrderLaw | KamalLaw | IsoconversionalLaw) -> Kinetics:
    """Return the kinetics of a resin file, or of one of its tables."""
    if isinstance(law, Resin):
        found = law.order or law.kamal or law.isoconversional
        if found is None:
            raise AssertionError("a checked resin file has a law")
        return kinetics_of(found)
    kelvin = law.reference_temperature_C - COLDEST_C
    if isinstance(law, OrderLaw):
        return _of_order(law, kelvin)
    if isinstance(law, KamalLaw):
        return _of_kamal(law, kelvin)
    return _of_table(law, kelvin)


def _of_order(law: OrderLaw, kelvin: float) -> Kinetics:
    energy = law.activation_energy_kJ_mol * 1e3
    if law.rate_per_s is not None:
        rate, own = law.rate_per_s, "rate_per_s"
    else:
        rate = float(law.prefactor_per_s or 0.0) * math.exp(-energy / (GAS_CONSTANT * kelvin))
        own = "prefactor_per_s"
    given = float(getattr(law, own))
    spreads = law.spreads
    sd = (spreads.get(own, 0.0) / given, spreads.get("activation_energy_kJ_mol", 0.0) * 1e3 / energy)

    def rates(cure: Array) -> tuple[Array, Array]:
        one = rate * (1.0 - cure) ** law.order
        return one[:, None], np.full((len(cure), 1), energy)

    return _laid_out(kelvin, rates, sd)


def _of_kamal(law: KamalLaw, kelvin: float) -> Kinetics:
    energies = np.array([law.activation_energy_1_kJ_mol, law.activation_energy_2_kJ_mol]) * 1e3

    def rates(cure: Array) -> tuple[Array, Array]:
        left = (1.0 - cure) ** law.order_n
        both = np.stack([law.rate_1_per_s * left, law.rate_2_per_s * cure**law.order_m * left], axis=1)
        return both, np.tile(energies, (len(cure), 1))

    return _laid_out(kelvin, rates, (law.relative_sd, law.activation_energy_relative_sd))


def _of_table(law: IsoconversionalLaw, kelvin: float) -> Kinetics:
    """Rows between which activation energy and logarithm are straight.

    Below the first row both stay as they are; above the last the rate falls in proportion to what is left.
    """
    rows = np.array(law.table)
    at, energies, logs = rows[:, 0], rows[:, 1] * 1e3, rows[:, 2]

    def rates(cure: Array) -> tuple[Array, Array]:
        energy = np.interp(cure, at, energies)
        rate = np.exp(np.interp(cure, at, logs) - energy / (GAS_CONSTANT * kelvin))
        rate *= np.minimum((1.0 - cure) / (1.0 - at[-1]), 1.0)
        return rate[:, None], energy[:, None]

    return _laid_out(kelvin, rates, (law.relative_sd, law.activation_energy_relative_sd))


def _laid_out(kelvin: float, rates: Callable[[Array], tuple[Array, Array]], sd: tuple[float, float]) -> Kinetics:
    """Integrate dx = dα / rate over the grid; with dα = α (1 - α) dl, l the logit, by Simpson's rule.

    Parameters
    ----------
    rates
        Gives for conversions (n) the summands of the rate at the reference temperature and the activation energy
        of each (n, J). [1/s, J/mol]
    sd
        Of δ and of ε.
    """
    logit = np.linspace(-OUTERMOST, OUTERMOST, 2 * CELLS + 1)
    cure = 1.0 / (1.0 + np.exp(-logit))
    summands, energy = rates(cure)
    total = summands.sum(axis=1)
    integrand = cure * (1.0 - cure) / total
    step = logit[1] - logit[0]
    pairs = (integrand[:-2:2] + 4.0 * integrand[1::2] + integrand[2::2]) * (step / 3.0)  # Simpson
    first = cure[0] / total[0]  # up to here the rate is that of uncured resin
    time = first + np.concatenate([[0.0], np.cumsum(pairs)])
    return Kinetics(
        reference_K=kelvin,
        log_time=np.log(time),
        logit=logit[::2],
        share=(summands / total[:, None])[::2],
        energy=energy[::2],
        log_rate_sd=sd[0],
        energy_sd=sd[1],
    )
