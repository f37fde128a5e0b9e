"""Measured runs from the virtual press: a seed decides press, panels, programs, chain, and what is hidden.

The name of what is hidden stays in the `Truth`; a run file never carries it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from daq.files.run_file import write_run
from daq.records import Array, Moments, Panel, Run
from daq.simulated.campaign_places import solve_places
from daq.simulated.campaign_platens import Controller, draw_controller, draw_platens
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import (
    FACES,
    Chain,
    Fault,
    Nuisances,
    draw_fault,
    measure,
)
from daq.simulated.effects import CHAIN_EFFECTS, draw_effect, draw_outside, for_run, split_names, with_outside
from daq.simulated.physics_mesh import Accuracy
from daq.simulated.physics_pressing import BASE_COEFFICIENTS, DryingLaw, Plates, Pressing

Effects = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Plan:
    """What a campaign is like; None is drawn from the seed."""

    rate_hz: float | None = None
    """None: one of 1, 2, 5, 10."""
    thickness_mm: float | Sequence[float] | None = None
    """One, several to draw from run by run, or None: 16, or 8, 16 and 19."""
    press_time_s: tuple[float, float] = (18.0, 120.0)
    open_before_s: tuple[float, float] = (5.0, 30.0)
    open_after_s: tuple[float, float] = (30.0, 120.0)
    platen_C: tuple[float, float] = (180.0, 210.0)
    pressure_N_cm2: Sequence[float] = (280.0, 300.0, 320.0, 340.0, 360.0, 380.0, 400.0)
    """To draw from, run by run."""
    start_before_s: float | None = None
    """First row this long before the insertion; 0 is at the insertion."""
    closed_column: bool | None = None
    """None: half of the campaigns; a hidden clock offset always brings it."""
    core_column: float = 0.0
    """Share of runs with a thermocouple in the core."""
    coefficients: Mapping[str, float] = field(default_factory=lambda: dict(BASE_COEFFICIENTS))
    """Of the press; a run differs from them by `coefficient_spread`. [W/m²K]"""
    coefficient_spread: float | None = None
    """Log-normal, from run to run. None: 0.12 to 0.30."""
    trends_per_K: Mapping[str, float] = field(default_factory=dict)
    """Coefficients that grow with the platens' set point: relative change per kelvin from 195 °C."""
    plates: Plates = field(default_factory=Plates)
    panel_spread: float = 0.05
    """Relative scatter of conductivity and heat capacity from panel to panel, 3 to 8 % as a rule, in no header."""
    effect_spread: float = 0.25
    """Between runs, where the cause lies in the panel."""
    scale: float = 1.0
    """Size of drawn effects: 0.5 halves them."""
    eased: tuple[float, float] | None = None
    """From where to where the share of pressure is drawn that is left from the middle of a pressing on, as presses
    ease off before they open; the column ``load`` shows it. None: the pressure stays, and no column shows it."""
    rim_contrast: float = 0.0
    """1: rim sensors see the full difference of a rim loss; 0: none."""
    nuisances: Nuisances = field(default_factory=Nuisances)
    drying_law: DryingLaw | None = None
    """None: by `other_laws`."""
    other_laws: bool = False
    """Second forms of steam transport and drying, which no test should be able to lean on."""
    accuracy: Accuracy = "fast"


@dataclass(frozen=True)
class Truth:
    """What really happened in a run."""

    coefficients: Mapping[str, float]
    """Of this run. [W/m²K]"""
    effects: Effects
    """Of the campaign."""
    run_effects: Effects
    """Of this run: causes in the panel scatter."""
    outside: Effects
    moments: Moments
    panel: Panel
    """With the true constants and start temperature."""
    core_C: Array
    top_C: Array
    bottom_C: Array
    """Mean over the face."""
    faults: tuple[Fault, ...]
    ambient: float
    pressing: Pressing


@dataclass(frozen=True)
class _CampaignPress:
    """What a campaign's runs have in common."""

    plan: Plan
    name: str
    rate_hz: float
    thicknesses: tuple[float, ...]
    start_before_s: float
    closed_column: bool
    spread: float
    controller: Controller
    density: float
    explicit: bool
    effects: Effects
    outside: Effects
    faults: tuple[Fault, ...]


def make_campaign(
    seed: int,
    n_runs: int = 12,
    effects: Effects | Sequence[str] | str | None = None,
    plan: Plan | None = None,
) -> list[tuple[Run, Truth]]:
    """Return runs with their truths; the same arguments give the same runs.

    Hiding something changes neither programs nor noise: two campaigns of one seed differ by it alone.

    Parameters
    ----------
    seed
        Decides everything that is drawn.
    n_runs
        Pressings.
    effects
        Names (one, several; from the contract's catalogue or from `OUTSIDE`) drawn at their size
        range, or a mapping of names to parameters.
    plan
        Rates, thicknesses, programs, nuisances; by default those of issue 5.

    Raises
    ------
    InputError
        For an unknown effect.
    """
    plan = plan or Plan()
    press = _draw_press(np.random.default_rng([seed, 0]), seed, effects, plan)
    return [_make_run(press, seed, i) for i in range(n_runs)]


def write_campaign(folder: Path, campaign: Sequence[tuple[Run, Truth]], positions: bool = False) -> list[Path]:
    """Write run files and ``press.toml`` into a folder; return the run files. Truths stay out."""
    folder.mkdir(parents=True, exist_ok=True)
    plates = campaign[0][1].pressing.plates if campaign else None
    (folder / "press.toml").write_text(press_toml(positions, plates), encoding="utf-8")
    paths = []
    for run, _ in campaign:
        paths.append(folder / f"{run.name}.csv")
        write_run(run, paths[-1])
    return paths


def _draw_press(
    rng: np.random.Generator, seed: int, effects: Effects | Sequence[str] | str | None, plan: Plan
) -> _CampaignPress:
    given = {} if effects is None else effects
    names = [given] if isinstance(given, str) else list(given)
    inside, outer = split_names(names)
    sizes = given if isinstance(given, Mapping) else {}
    thickness: tuple[float, ...]
    mixed, rate = rng.random() < 0.5, float(rng.choice([1.0, 2.0, 5.0, 10.0]))
    if plan.thickness_mm is None:
        thickness = (8.0, 16.0, 19.0) if mixed else (16.0,)
    elif isinstance(plan.thickness_mm, Sequence):
        thickness = tuple(plan.thickness_mm)
    else:
        thickness = (float(plan.thickness_mm),)
    lead = 0.0 if rng.random() < 0.5 else float(rng.uniform(5.0, 20.0))
    switch, spread = bool(rng.random() < 0.5), float(rng.uniform(0.12, 0.30))
    controller, density, explicit = draw_controller(rng), float(rng.uniform(715, 765)), bool(rng.random() < 0.5)
    return _CampaignPress(
        plan=plan,
        name=f"v{seed}",
        rate_hz=plan.rate_hz or rate,
        thicknesses=thickness,
        start_before_s=lead if plan.start_before_s is None else plan.start_before_s,
        closed_column="clock_offset" in inside or (switch if plan.closed_column is None else plan.closed_column),
        spread=spread if plan.coefficient_spread is None else plan.coefficient_spread,
        controller=controller,
        density=round(density),
        explicit=explicit,
        effects={n: sizes.get(n) or draw_effect(n, rng, plan.scale) for n in inside},
        outside={n: sizes.get(n) or draw_outside(n, rng, plan.scale) for n in outer},
        faults=(draw_fault(rng, 60.0),) if "sensor_fault" in inside else (),
    )


def _make_run(press: _CampaignPress, seed: int, number: int) -> tuple[Run, Truth]:
    rng, hidden = np.random.default_rng([seed, 1, number]), np.random.default_rng([seed, 2, number])
    pressing, setpoint = _draw_pressing(press, rng)
    run_effects = {n: for_run(n, p, hidden, press.plan.effect_spread) for n, p in press.effects.items()}
    physical = {n: p for n, p in run_effects.items() if n not in CHAIN_EFFECTS}
    if press.plan.eased is not None:
        own = np.random.default_rng([seed, 3, number])
        share, begins = own.uniform(*press.plan.eased), own.uniform(0.3, 0.6)
        begins = pressing.closed + begins * (pressing.opened - pressing.closed)
        pressing = replace(pressing, eased=float(share), eased_from=float(begins))
    pressing = with_outside(replace(pressing, effects=physical), press.outside)
    places = solve_places(pressing, press.outside, press.plan.rim_contrast, press.plan.accuracy)
    core, faces = places.core, places.channels
    times = _scan_times(press, pressing, rng, hidden)
    faults = press.faults
    if rng.random() < press.plan.nuisances.loose_chance:
        faults += (draw_fault(rng, pressing.end, "loose"),)
    chain = Chain.of(press.plan.nuisances, run_effects, faults)
    truth: dict[str, Callable[[Array], Array]] = {
        "platen_top": pressing.platen_top.at,
        "platen_bottom": pressing.platen_bottom.at,
        **faces,
    }
    if rng.random() < press.plan.core_column:
        truth["core_1"] = core
    columns = measure(truth, times, chain, pressing.ambient, rng)
    if press.closed_column:
        columns["closed"] = ((times >= pressing.closed) & (times < pressing.opened)).astype(np.float64)
    if press.plan.eased is not None:
        columns["load"] = pressing.pressure_at(times)
    name = f"{press.name}-{number + 1:02d}"
    run = Run(name, _header(press, pressing, name, setpoint, rng), times, columns, "virtual press")
    return run, Truth(
        coefficients=pressing.coefficients,
        effects=press.effects,
        run_effects=run_effects,
        outside=press.outside,
        moments=pressing.moments(),
        panel=pressing.panel,
        core_C=core(times),
        top_C=np.mean([faces[c](times) for c in FACES["top"]], axis=0),
        bottom_C=np.mean([faces[c](times) for c in FACES["bottom"]], axis=0),
        faults=faults,
        ambient=pressing.ambient,
        pressing=pressing,
    )


def _scan_times(
    press: _CampaignPress, pressing: Pressing, rng: np.random.Generator, hidden: np.random.Generator
) -> Array:
    """Return when the logger scans, from 0 on, with its jitter and perhaps a gap (rows). [s]"""
    period = 1.0 / press.rate_hz
    n = int((pressing.end - pressing.start) / period)
    jitter = np.clip(rng.standard_normal(n) * press.plan.nuisances.jitter, -0.2, 0.2)
    times = np.round(pressing.start + period * (np.arange(n) + jitter), 4)
    times -= times[0]
    if hidden.random() < press.plan.nuisances.gap_chance:
        begin = hidden.uniform(1.0, times[-1] - 11.0)
        times = times[(times < begin) | (times > begin + hidden.uniform(1.0, 10.0))]
    return np.asarray(times)


def _draw_pressing(press: _CampaignPress, rng: np.random.Generator) -> tuple[Pressing, float]:
    """Return one pressing without effects, and its platens' set point."""
    plan = press.plan
    inserted = press.start_before_s
    closed = inserted + rng.uniform(*plan.open_before_s)
    opened = closed + rng.uniform(*plan.press_time_s)
    end = opened + rng.uniform(*plan.open_after_s)
    setpoint = 5.0 * round(rng.uniform(*plan.platen_C) / 5.0)
    low, high = draw_platens(press.controller, setpoint, (0.0, end + 1.0), ((closed, opened),), rng)
    k, c = np.exp(plan.panel_spread * rng.standard_normal(2))
    panel = Panel(
        "MDF",
        float(rng.choice(press.thicknesses)) / 1000.0,
        press.density,
        0.12 * k,
        1550.0 * c,
        float(rng.uniform(19.0, 26.0)),
        8.0,
    )
    values = {n: float(v * np.exp(press.spread * rng.standard_normal())) for n, v in plan.coefficients.items()}
    for name, trend in plan.trends_per_K.items():
        values[name] *= float(np.exp(trend * (setpoint - 195.0)))
    pressing = Pressing(
        panel=panel,
        plates=plan.plates,
        ambient=float(rng.uniform(18.0, 28.0)),
        platen_bottom=low,
        platen_top=high,
        start=0.0,
        end=float(end),
        inserted=inserted,
        closed=float(closed),
        opened=float(opened),
        closing_ramp=float(rng.uniform(0.2, 1.0)),
        opening_ramp=float(rng.uniform(0.2, 0.5)),
        coefficients=values,
        pressure=float(rng.choice(plan.pressure_N_cm2)),
        vapour_law="uniform" if plan.other_laws else "proportional",
        drying_law=plan.drying_law or ("kinetic" if plan.other_laws else "equilibrium"),
    )
    return pressing, setpoint


def _header(
    press: _CampaignPress, pressing: Pressing, name: str, setpoint: float, rng: np.random.Generator
) -> dict[str, object]:
    nuisances = press.plan.nuisances
    start = pressing.panel.initial_temperature + rng.normal(0.0, nuisances.start_error_K)
    ambient = pressing.ambient + rng.normal(0.0, nuisances.ambient_error_K)
    header: dict[str, object] = {
        "run": name,
        "panel.material": "MDF",
        "panel.thickness_mm": round(pressing.panel.thickness * 1000.0, 3),
        "panel.density_kg_m3": pressing.panel.density,
    }
    if press.explicit:
        header["panel.conductivity_W_mK"] = 0.12
        header["panel.heat_capacity_J_kgK"] = 1550.0
        header["panel.moisture_percent"] = 8.0
    return header | {
        "panel.initial_temperature_C": round(float(start), 2),
        "ambient.temperature_C": round(float(ambient), 2),
        "setting.platen_temperature_C": setpoint,
        "setting.pressure_N_cm2": pressing.pressure,
        "setting.press_time_s": round(pressing.opened - pressing.closed, 1),
    }
