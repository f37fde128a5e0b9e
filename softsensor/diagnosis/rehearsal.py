"""Error rates of a campaign: the same pressings simulated with each cause in turn, and none, and diagnosed.

A p-value speaks for an ideal. A rehearsal asks what a diagnosis of these very runs is worth: their programs,
channels and gaps, their noise, the scatter of their coefficients and constants. A rehearsed run is

* driven by the run's own platens, with its moments as fitted;
* solved by the sensor's own model with the campaign's coefficients, each drawn about its level by the scatter
  that the campaign shows, and constants drawn about what the header says by how far each may be off
  (`signals.doubt`): panel and room anew for each run, layers and boundaries for each campaign. What one material
  table has wrong in all panels is a cause of the catalogue, so panels scatter as those of one product;
* read with the residuals of one of the runs, drawn with its sign: in blocks of `BLOCK_S`, all channels together,
  so that what a face's channels share stays shared; rows while the press moves are left out of the blocks. Each
  channel's level comes from the same run, cells empty in the run are empty, rows without a panel stay as read.

Named causes are left out of the simulated press, the noise is what they leave. Since the simulation is the
sensor's own model, rates are those of a press that the model describes but for the one cause: what a real press
does besides makes them worse. A fit takes a little of the noise with it, and constants may scatter less than
general knowledge says.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import betaincinv

from daq.press.press_file import BoundaryKind, Press
from daq.records import Array, InputError, Moments, Run
from daq.words import say
from softsensor.diagnosis.extension import RunState, own_constants
from softsensor.diagnosis.extension_unknowns import logarithm_of, run_values
from softsensor.diagnosis.finding import Diagnosis
from softsensor.diagnosis.search import candidates_for
from softsensor.diagnosis.verdict import diagnose
from softsensor.effects import Effect, catalogue, find_effect, sensor_fault
from softsensor.heat.model import NUISANCES, ThermalModel
from softsensor.heat.timing import OPENING_RAMP, TIMINGS
from softsensor.signals.digest import Digest
from softsensor.signals.doubt import PANEL_DENSITY, PANEL_SCATTER, Doubt, constant_doubts
from softsensor.signals.instrument import CHANNEL_K, CHANNEL_WHITE_K, FACE_SLOW_S, PLATEN_K
from softsensor.signals.screen import LEAST_CHANNELS, quiet_rows
from softsensor.signals.unknown import ALPHA

NOTHING = ""
"""The name of no cause at all."""
BLOCK_S = FACE_SLOW_S
"""Length of a block of residuals: the longest memory that a face's noise is taken to have. [s]"""
FARTHEST = 2.0
"""Standard deviations at most that a constant is drawn off. By hand."""
ONE_PRODUCT = {
    "panel.conductivity_W_mK": PANEL_SCATTER,
    "panel.heat_capacity_J_kgK": PANEL_SCATTER,
    "panel.density_kg_m3": PANEL_DENSITY,
}
"""Scatter of panels of one product, as a share, where the header states none."""
LOOSE = 0.1
"""A rehearsed faulty channel loses this share of its face's excess over the room: 13 K at 150 °C, in the middle of
the 8 to 33 K by which faulty channels of the reference campaigns depart (`signals.screen.LIMIT_K`)."""


@dataclass(frozen=True)
class Hidden:
    """What a rehearsed campaign hides."""

    name: str
    """Of an effect; empty for none."""
    parameters: tuple[tuple[str, float], ...] = ()
    """How large it is: each parameter's name and value, in its unit."""

    @property
    def key(self) -> str:
        """The name with its sizes, by which a finished rehearsal is known again."""
        return " ".join([self.name, *(f"{name}={value!r}" for name, value in self.parameters)])


@dataclass(frozen=True)
class RehearsedRun:
    """What a simulated run takes from a measured one."""

    run: Run
    """Without its faulty channels."""
    moments: Moments
    motion: Mapping[str, float]
    """Fitted shifts of its moments. [s]"""
    noise: Mapping[str, Array]
    """Residuals of each channel about their mean, quiet rows with the panel in; a cell that was empty has that of
    the nearest row, since a cell that is read may draw it (rows). [K]"""
    level: Mapping[str, float]
    """Mean residual of each channel. [K]"""
    period_s: float


@dataclass(frozen=True)
class Campaign:
    """What rehearsed campaigns are drawn from."""

    press: Press
    runs: tuple[RehearsedRun, ...]
    levels: Mapping[str, float]
    """Coefficients of the campaign. [W/m²K]"""
    spread: Mapping[str, float]
    """Of their logarithms from run to run."""
    testable: tuple[str, ...]
    """Causes these runs can say something about."""


@dataclass(frozen=True)
class Outcome:
    """What a rehearsed campaign's diagnosis named."""

    hidden: Hidden
    number: int
    verdict: str
    sets: tuple[tuple[str, ...], ...]
    """Of the named causes."""

    def as_json(self) -> dict[str, Any]:
        """Return what is kept of it."""
        return {"number": self.number, "verdict": self.verdict, "sets": [list(s) for s in self.sets]}


@dataclass(frozen=True)
class Rate:
    """How often something happened, and the binomial interval of its chance."""

    count: int
    """How often."""
    of: int
    """How many there were."""

    @property
    def share(self) -> float:
        """Count over how many there were."""
        return self.count / self.of if self.of else float("nan")

    @property
    def ci95(self) -> tuple[float, float]:
        """Interval of Clopper and Pearson, which holds the chance in at least 95 %.

        References
        ----------
        Clopper & Pearson, Biometrika 26 (1934) 404, by quantiles of the beta distribution.

        Examples
        --------
        >>> [round(end, 4) for end in Rate(0, 10).ci95]  # 1 - 0.025^(1/10)
        [0.0, 0.3085]
        """
        tail, missed = ALPHA / 2.0, self.of - self.count
        low = float(betaincinv(self.count, missed + 1, tail)) if self.count else 0.0
        high = float(betaincinv(self.count + 1, missed, 1.0 - tail)) if missed else 1.0
        return low, high

    def as_json(self) -> dict[str, Any]:
        """Return count, share and ci95."""
        return {"count": self.count, "share": round(self.share, 4), "ci95": [round(end, 4) for end in self.ci95]}


@dataclass(frozen=True)
class RehearsedCause:
    """What became of the campaigns that hide one cause."""

    hidden: Hidden
    """The cause, and how large it was."""
    found: Rate
    """The cause is named, alone or in a set."""
    alone: Rate
    """It is named with no alternative."""
    wrong: Rate
    """A cause is named whose set does not hold it."""

    def as_json(self) -> dict[str, Any]:
        """Return the row of the table."""
        return {
            "name": self.hidden.name,
            "parameters": dict(self.hidden.parameters),
            "campaigns": self.found.of,
            "power": self.found.as_json(),
            "alone": self.alone.as_json(),
            "wrong_names": self.wrong.as_json(),
        }


@dataclass(frozen=True)
class Rehearsal:
    """Power and false names of a campaign."""

    runs: int
    """Of each campaign."""
    rows: tuple[RehearsedCause, ...]
    """One a hidden cause."""
    nothing: Rate
    """Of the campaigns that hide nothing, those in which a cause is named."""
    untestable: tuple[str, ...]
    """Causes that these runs can say nothing about."""
    lost: int = 0
    """Campaigns over which workers were killed, and that count nowhere."""

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``rehearsal`` in ``diagnose --json``."""
        return {
            "runs": self.runs,
            "simulated_by": "the sensor's own model",
            "effects": [row.as_json() for row in self.rows],
            "none": {"campaigns": self.nothing.of, "false_names": self.nothing.as_json()},
            "untestable": list(self.untestable),
            "lost": self.lost,
        }


def campaign_of(found: Diagnosis) -> Campaign:
    """Return what rehearsals of a diagnosed campaign are drawn from."""
    stage = found.final
    layout = stage.fit.layout
    model, theta = layout.model, stage.fit.theta
    columns = {c for faults in found.faults.values() for c in (fault.column for fault in faults)}
    runs = tuple(
        _rehearsed(
            model, run_values(layout, r, theta, state.eta) | _own_panel(white.digest, state), white.digest, columns
        )
        for r, (state, white) in enumerate(zip(stage.fit.runs, stage.data, strict=True))
    )
    values = stage.fit.values
    levels = {n: model.press.coefficient(n).guess for n in model.press.coefficient_names}
    levels |= {n: float(np.exp(values[logarithm_of(n)])) for n in levels if logarithm_of(n) in values}
    testable = tuple(e.name for e in candidates_for(found.stages[0]))
    if _faces(runs[0], model.press):
        testable = (*testable, sensor_fault.EFFECT.name)
    return Campaign(model.press, runs, levels, dict(stage.population), testable)


def _own_panel(digest: Digest, state: RunState) -> dict[str, float]:
    return {u.name: estimate for u, estimate in own_constants(digest, state)}


def _rehearsed(
    model: ThermalModel, values: Mapping[str, float], digest: Digest, faulty: Iterable[str]
) -> RehearsedRun:
    """Return what a run gives to rehearsals: its motion, and what the fit leaves of each of its channels."""
    kept = {c: v for c, v in digest.run.columns.items() if c not in set(faulty)}
    run = replace(digest.run, columns=kept)
    solved = model.solve(model.prepare(run, digest.moments), values)
    rows = quiet_rows(run.time_s, digest.moments) & _with_panel(run, digest.moments)
    noise, level = {}, {}
    for c in model.press.sensors_of(run):
        rest = (run.columns[c] - solved.column(c))[rows]
        known = np.flatnonzero(np.isfinite(rest))
        level[c] = float(rest[known].mean()) if len(known) else 0.0
        noise[c] = rest[_nearest(known, len(rest))] - level[c] if len(known) else np.zeros(len(rest))
    motion = {n: values[n] for n in (*TIMINGS, OPENING_RAMP) if n in values}
    return RehearsedRun(run, digest.moments, motion, noise, level, digest.period_s)


def _nearest(known: np.ndarray, rows: int) -> np.ndarray:
    """Return for each row the nearest of those known, itself where it is one (rows)."""
    after = np.minimum(np.searchsorted(known, np.arange(rows)), len(known) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(known[before] - np.arange(rows)) < np.abs(known[after] - np.arange(rows))
    return np.asarray(known[np.where(nearer, before, after)])


def _with_panel(run: Run, moments: Moments) -> np.ndarray:
    begin = moments.inserted_s if np.isfinite(moments.inserted_s) else run.time_s[0]
    end = moments.removed_s if np.isfinite(moments.removed_s) else np.inf
    return np.asarray((run.time_s >= begin) & (run.time_s < end))


def hidden_of(campaign: Campaign, names: Sequence[str] = ()) -> list[Hidden]:
    """Return what is to be hidden: each cause these runs could show at its typical size, or those asked for.

    Parameters
    ----------
    names
        ``NAME``, or ``NAME=SIZE`` with the first parameter's value in its unit.

    Raises
    ------
    InputError
        For an unknown cause, a size that is no number, outside what the cause can be, at which it is absent or of
        one without a size, and for a cause that these runs cannot show.
    """
    if not names:
        return [_sized(find_effect(name), "") for name in campaign.testable]
    wanted = []
    for one in names:
        hidden = sized(one)
        if hidden.name not in campaign.testable:
            raise InputError(say("rehearsal-not-testable", name=hidden.name, known=campaign.testable))
        wanted.append(hidden)
    return list(dict.fromkeys(wanted))


def sized(text: str) -> Hidden:
    """Return a cause as asked for, ``NAME`` or ``NAME=SIZE``. Raises `InputError`, before any run is looked at."""
    name, _, size = text.partition("=")
    return _sized(find_effect(name), size)


def _sized(effect: Effect, size: str) -> Hidden:
    typical = {p.name: p.typical for p in effect.parameters}
    if size:
        first = next(iter(effect.parameters), None)
        try:
            value = float(size)
        except ValueError:
            value = float("nan")
        if first is None or not first.lower <= value <= first.upper:
            limits = (0.0, 0.0) if first is None else (first.lower, first.upper)
            raise InputError(say("rehearsal-size", name=effect.name, size=size, low=limits[0], high=limits[1]))
        if value == first.neutral:
            raise InputError(say("rehearsal-size-none", name=effect.name, size=size))
        typical[first.name] = value
    return Hidden(effect.name, tuple(typical.items()))


def rehearse_one(campaign: Campaign, hidden: Hidden, number: int) -> Outcome:
    """Simulate a campaign and diagnose it; the same arguments give the same outcome.

    A simulated campaign that cannot be diagnosed at all counts as one in which nothing is named.
    """
    try:
        found = diagnose(campaign.press, simulated_runs(campaign, hidden, number), law=False)
    except (InputError, np.linalg.LinAlgError) as error:
        return Outcome(hidden, number, f"failed: {error}", ())
    return Outcome(hidden, number, str(found.verdict), tuple(f.set for f in found.findings))


def simulated_runs(campaign: Campaign, hidden: Hidden, number: int) -> list[Run]:
    """Return the campaign's runs as they would have read with something hidden in the press."""
    rng = np.random.default_rng([zlib.crc32(hidden.key.encode()), number])
    effect = find_effect(hidden.name) if hidden.name else None
    model = ThermalModel(campaign.press, (effect,) if effect is not None and effect.parameters else ())
    of_press = _drawn(campaign.runs[0].run, campaign.press, rng, of_run=False)
    loose = _loose(campaign, rng) if hidden.name == sensor_fault.EFFECT.name else ""
    found = []
    for one in campaign.runs:
        values = _values(campaign, model, hidden, rng) | dict(one.motion)
        header = dict(one.run.header) | of_press | _drawn(one.run, campaign.press, rng, of_run=True)
        solved = model.solve(model.prepare(replace(one.run, header=header), one.moments), values)
        readings = _readings(campaign, one, rng)
        columns = dict(one.run.columns)
        inside = _with_panel(one.run, one.moments)
        validation = campaign.press.sensors_of(one.run, "validation")
        for c in (*readings, *validation):
            true = solved.column(c)
            if c == loose:
                true = true - LOOSE * (true - one.run.ambient_temperature)
            noise = readings.get(c)
            if noise is None:
                noise = CHANNEL_K * rng.normal() + CHANNEL_WHITE_K * rng.normal(size=len(true))
            read = np.isfinite(one.run.columns[c])
            columns[c] = np.where(inside & read, true + noise, one.run.columns[c])
        found.append(replace(one.run, columns=columns))
    return found


def _values(campaign: Campaign, model: ThermalModel, hidden: Hidden, rng: np.random.Generator) -> dict[str, float]:
    """Draw a run's coefficients, its platens' errors and how much of the cause it has."""
    values = {}
    for name, level in campaign.levels.items():
        table = campaign.press.coefficient(name)
        drawn = level * float(np.exp(campaign.spread.get(name, 0.0) * rng.normal()))
        values[name] = drawn if table.fixed else float(np.clip(drawn, table.lower, table.upper))
    for end in ("bottom", "top"):
        if getattr(campaign.press.boundary, end).kind is BoundaryKind.MEASURED:
            values[f"boundary_{end}_K"] = PLATEN_K * rng.normal()
    for effect in model.effects:
        for p in effect.parameters:
            size = dict(hidden.parameters)[p.name] - p.neutral
            own = p.neutral + size * max(1.0 + p.spread * rng.normal(), 0.0)
            values[effect.key(p.name)] = float(np.clip(own, p.lower, p.upper))
    return {n: v for n, v in values.items() if n in model.parameter_names or n in NUISANCES}


def _drawn(run: Run, press: Press, rng: np.random.Generator, *, of_run: bool) -> dict[str, Any]:
    """Draw what the constants of a run, or of all runs, truly are, by their keys in the header."""
    doubts = constant_doubts(run.header, press, ONE_PRODUCT)
    return {
        key: _moved(run.header.get(key), doubt, rng)
        for key, doubt in doubts.items()
        if key.startswith(("panel.", "ambient.")) == of_run
        if key.startswith(("panel.", "ambient.")) or not isinstance(_table(press, key), tuple)
    }


def _table(press: Press, key: str) -> object:
    """Return a layer's constant in the press file, a table in temperature as it is; None of any other key."""
    _, _, rest = key.partition("layer.")
    name, _, constant = rest.rpartition(".")
    return next((getattr(layer, constant) for layer in press.layer if layer.name == name), None)


def _moved(given: object, doubt: Doubt, rng: np.random.Generator) -> object:
    off = doubt.sd * float(np.clip(rng.normal(), -FARTHEST, FARTHEST))
    if isinstance(given, list | tuple):
        factor = 1.0 + off / doubt.value
        return [[temperature, value * factor] for temperature, value in given]
    return max(doubt.value + off, 0.0) if doubt.value > 0.0 else doubt.value + off


def _readings(campaign: Campaign, run: RehearsedRun, rng: np.random.Generator) -> dict[str, Array]:
    """Draw what a run's channels read beside the truth: a run's residuals in blocks, and its levels (rows). [K]"""
    donors = [one for one in campaign.runs if set(run.noise) <= set(one.noise)]
    donor = donors[int(rng.integers(len(donors)))]
    sign = float(rng.choice([-1.0, 1.0]))
    rows, held = len(run.run.time_s), len(next(iter(donor.noise.values())))
    block = max(1, round(BLOCK_S / run.period_s))
    starts = rng.integers(held, size=-(-rows // block))
    steps = np.floor(np.arange(block) * run.period_s / donor.period_s + 1e-9).astype(int)
    at = ((starts[:, None] + steps[None, :]) % held).ravel()[:rows]
    return {c: sign * (donor.level[c] + donor.noise[c][at]) for c in run.noise}


def _faces(run: RehearsedRun, press: Press) -> list[str]:
    """Return the channels of faces that have enough of them to show a faulty one."""
    label = {c: s.label for c, s in press.sensors_of(run.run).items()}
    return sorted(c for c, own in label.items() if list(label.values()).count(own) >= LEAST_CHANNELS)


def _loose(campaign: Campaign, rng: np.random.Generator) -> str:
    return str(rng.choice(_faces(campaign.runs[0], campaign.press)))


def rehearsal_of(campaign: Campaign, outcomes: Iterable[Outcome], lost: int = 0) -> Rehearsal:
    """Count what finished rehearsals found, in the order of the catalogue's causes as they were hidden.

    `lost`: how many never finished.
    """
    by: dict[Hidden, list[Outcome]] = {}
    for outcome in outcomes:
        by.setdefault(outcome.hidden, []).append(outcome)
    order = {name: i for i, name in enumerate(campaign.testable)}
    known = sorted((h for h in by if h.name), key=lambda h: (order[h.name], h.parameters))
    nothing = [bool(o.sets) for o in by.get(Hidden(NOTHING), [])]
    unseen = tuple(n for n in catalogue() if n not in campaign.testable)
    return Rehearsal(len(campaign.runs), tuple(_row(h, by[h]) for h in known), _rate(nothing), unseen, lost)


def _row(hidden: Hidden, outcomes: Sequence[Outcome]) -> RehearsedCause:
    name = hidden.name
    return RehearsedCause(
        hidden,
        found=_rate(any(name in s for s in o.sets) for o in outcomes),
        alone=_rate((name,) in o.sets for o in outcomes),
        wrong=_rate(any(name not in s for s in o.sets) for o in outcomes),
    )


def _rate(happened: Iterable[bool]) -> Rate:
    outcomes = list(happened)
    return Rate(sum(outcomes), len(outcomes))
