"""What a fit adjusts: coefficients, effect parameters, and a real measuring chain's nuisances with priors."""

from __future__ import annotations

import numpy as np

from daq.records import InputError
from softsensor.case import Case
from softsensor.effects import find_effect
from softsensor.fit_problem import EVERYWHERE, Unknown
from softsensor.model import NUISANCES, ThermalModel
from softsensor.parameters import Parameter
from softsensor.residuals import Signals

RAMP_S = (0.55, 0.25, 1.2)
"""Closing ramp: a press takes 0.2 to 1 s to close. Mean, standard deviation and limit. [s]"""
START_K = 0.3
"""Of the panel's initial temperature. [K]"""
PLATEN_K, PLATEN_GAIN = 0.1, 0.0005
"""Of a platen channel: offset and gain. [K, -]"""
CHANNEL_K, CHANNEL_GAIN = 0.3, 0.0015
"""Of a panel channel: offset and gain. [K, -]"""
LATE_S, LATE_ROWS, APART_ROWS = 0.02, 0.03, 0.12
"""How late panel channels are read: at least, and per row all of them, and one face after the other. [s, rows]

Where all moments are free, a delay common to all channels shows only against the platens and is held tightly."""


def neutral_values(model: ThermalModel) -> dict[str, float]:
    """Return every parameter's value where nothing is known: guesses, and effects at their typical size."""
    effects = {e.key(p.name): p.typical for e in model.effects for p in e.parameters}
    return {n: model.press.coefficient(n).guess for n in model.press.coefficient_names} | effects


def parameter_unknown(model: ThermalModel, name: str, start: float, prior: tuple[float, float] | None) -> Unknown:
    """Return a coefficient or effect parameter as an unknown; see `fit.fit_run` for the prior."""
    if "." not in name:
        table = model.press.coefficient(name)
        mean, sd = (0.0, float("inf")) if prior is None else (float(np.log(prior[0])), prior[1])
        begin = float(np.clip(start, table.lower, table.upper))
        return Unknown(name, begin, table.lower, table.upper, "log", mean=mean, sd=sd)
    parameter = effect_parameter(name)
    size = abs(parameter.typical - parameter.neutral) or abs(parameter.typical) or 1.0
    mean, sd = (0.0, float("inf")) if prior is None else (prior[0] / size, prior[1] / size)
    begin = float(np.clip(start, parameter.lower, parameter.upper))
    return Unknown(name, begin, parameter.lower, parameter.upper, "linear", size, mean, sd)


def effect_parameter(name: str) -> Parameter:
    """Return the parameter of a full name such as ``edge_loss.W_m3K``. Raises InputError."""
    effect, _, key = name.partition(".")
    for parameter in find_effect(effect).parameters:
        if parameter.name == key:
            return parameter
    raise InputError(f"parameter {name!r}: effect {effect} has no {key!r}")


def chain_priors(case: Case, signals: Signals) -> list[Unknown]:
    """Return the nuisances of a run with the priors a real measuring chain deserves."""
    unknowns: list[Unknown] = []
    period = signals.period_s
    moments, press = case.moments, case.press
    if press.has_states:
        first, last = float(case.run.time_s[0]), float(case.run.time_s[-1])
        sd = min(0.1 + 0.4 * period, 1.0)
        late = -0.5 * period if moments.source == "limit switch" else 0.0
        if first < moments.inserted_s < last:
            unknowns.append(nuisance("inserted_s", sd, 4 * sd, lower=max(-4 * sd, first - moments.inserted_s)))
        if first < moments.closed_s < last:
            unknowns.append(nuisance("closed_s", sd, 4 * sd, late))
            ramp = moments.ramp_s
            unknowns.append(nuisance("ramp_s", RAMP_S[1], RAMP_S[2] - RAMP_S[0], RAMP_S[0] - ramp, 0.1 - ramp))
        if first < moments.opened_s < last:
            unknowns.append(nuisance("opened_s", sd, 4 * sd, late))
    if press.panel_layers or press.initial.kind != "steady":
        unknowns.append(nuisance("initial_K", START_K, 10 * START_K))
    for end, boundary in (("bottom", press.boundary.bottom), ("top", press.boundary.top)):
        if boundary.kind == "measured":
            level = float(np.nanmedian(case.run.columns[boundary.column or ""]))
            sd = float(np.hypot(PLATEN_K, PLATEN_GAIN * (level - case.ambient)))
            unknowns.append(nuisance(f"boundary_{end}_K", sd, 10 * sd))
    for place in signals.places:
        n = len(place.columns)
        unknowns.append(nuisance(f"offset:{place.label}", CHANNEL_K / np.sqrt(n), 10 * CHANNEL_K))
        unknowns.append(nuisance(f"gain:{place.label}", CHANNEL_GAIN / np.sqrt(n), 10 * CHANNEL_GAIN))
    if press.has_states:
        free = any(u.name == "inserted_s" for u in unknowns)
        unknowns.append(nuisance(f"skew:{EVERYWHERE}", LATE_S + (LATE_ROWS if free else APART_ROWS) * period, 1.0))
        for place in signals.places[1:]:
            unknowns.append(nuisance(f"skew:{place.label}", LATE_S + APART_ROWS * period, 1.0))
    return unknowns


def nuisance(name: str, sd: float, reach: float, mean: float = 0.0, lower: float | None = None) -> Unknown:
    """Return a nuisance with a normal prior; its internal variable counts in standard deviations."""
    return Unknown(
        name, mean, mean - reach if lower is None else lower, mean + reach, "linear", sd, mean / sd, 1.0
    )


def is_parameter(name: str) -> bool:
    """Whether an unknown is a coefficient or an effect parameter, no nuisance."""
    return ":" not in name and name not in NUISANCES
