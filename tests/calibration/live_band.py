"""How right the live sensor's band is: virtual panels that scatter, and every measured set with a hidden sensor.

    python -m tests.calibration.live_band [--pictures DIR] [--campaigns N] [exact scatter rig_one pine_depth ...]

Prints by phase how often the central 50, 80 and 95 % of what the sensor said held the core, the mean half-width of
the 95 % band, the error (rms) and the continuous ranked probability score (CRPS: the mean distance between what
was said and what was, in K; less is better; Gneiting & Raftery 2007, J. Am. Stat. Assoc. 102, 359). Scans before
closing are left out. A measured set's truth is the thermocouple that was hidden, with its own offset in it.
Scans of a pressing err together, so a share of few pressings says little: 48 tell 50 % to 7 points, 200 to 4.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr

from daq.files.mapping import read_foreign, read_mapping
from daq.press.press_file import At, Core, Press, parse_press, read_press
from daq.records import Array, PressState, Run
from daq.simulated.campaign import Plan, Truth, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.physics_pressing import Plates
from softsensor.diagnosis.missing_causes import with_missing_causes
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.campaign import fit_campaign
from softsensor.live.sensor import ScanSensor
from tests.calibration.alternatives import NOISES, Rates, filtered, open_loop
from tests.measured import DATA, PINE_DEPTH, PRESS_RIG, ROOT

LEVELS = (0.5, 0.8, 0.95)
FITTED, PREDICTED, TUNED = 8, 3, 2
PHASES = ("first 10 s", "closed", "after opening")
PLAN = Plan(rate_hz=2.0, closed_column=True)
OTHER_PRESS = replace(PLAN, plates=Plates(0.014, 40.0, 7800.0, 470.0), other_laws=True)
"""A press that nothing was set on: other plates, other laws of steam and drying."""


@dataclass(frozen=True)
class Rows:
    """Scans of a run: time, phase, truth, whether valid, error, half-width, probability below the truth, score."""

    time: Array
    phase: Array
    truth: Array
    valid: Array
    error: Array
    half: Array
    below: Array
    inside: Array
    crps: Array
    open_loop: Array
    """Score of an open loop, NaN for measured sets. [K]"""
    kalman: Array
    """Score of a Kalman filter on a fine grid, NaN for measured sets. [K]"""

    @staticmethod
    def joined(parts: Sequence[Rows]) -> Rows:
        """Return several runs' scans as one."""
        return Rows(*(np.concatenate([getattr(p, name) for p in parts]) for name in Rows.__dataclass_fields__))

    def only(self, chosen: Array) -> Rows:
        """Return some of the scans."""
        return Rows(*(getattr(self, name)[chosen] for name in Rows.__dataclass_fields__))


def followed(press: Press, run: Run, truth: Array, model: ModelFile | None, hidden: Sequence[str] = ()) -> Rows:
    """Replay a run and hold what was said against the truth (N)."""
    sensor = ScanSensor(press, run.header, model)
    unseen = {*hidden, *press.sensors_of(run, "validation")}
    seen = {name: values.tolist() for name, values in run.columns.items() if name not in unseen}
    rows, closed, opened = [], np.inf, np.inf
    for i, time_s in enumerate(run.time_s.tolist()):
        estimate = sensor.update(time_s, {name: values[i] for name, values in seen.items()})
        closed = min(closed, time_s) if estimate.state is PressState.CLOSED else closed
        opened = min(opened, time_s) if estimate.state is PressState.OPEN and closed < np.inf else opened
        phase = -1 if time_s < closed else 2 if time_s >= opened else 0 if time_s < closed + 10.0 else 1
        mixture, core = sensor.mixture, float(truth[i])
        if phase < 0 or not np.isfinite(core) or estimate.state is PressState.IDLE:
            continue
        if not estimate.valid or mixture is None:
            rows.append((time_s, phase, core, 0.0, *[np.nan] * 7))
            continue
        w, mean, sd = mixture.components.weight, mixture.components.mean, np.sqrt(mixture.components.variance)
        mean = mean + estimate.core_C - mixture.core_C
        inside = float(estimate.core_low_C <= core <= estimate.core_high_C)
        half, error = (estimate.core_high_C - estimate.core_low_C) / 2, estimate.core_C - core
        rows.append(
            (
                time_s,
                phase,
                core,
                1.0,
                error,
                half,
                float(w @ ndtr((core - mean) / sd)),
                inside,
                score(w, mean, sd, core),
                np.nan,
                np.nan,
            )
        )
    return Rows(*np.array(rows).T)


def score(w: Array, mean: Array, sd: Array, core: float) -> float:
    """Return the continuous ranked probability score of a mixture of normals (Grimit et al. 2006, eq. 5). [K]"""

    def distance(m: Array, s: Array) -> Array:
        z = m / s
        return np.asarray(2.0 * s * np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) + m * (2.0 * ndtr(z) - 1.0))

    keep = w > 1e-4
    w, mean, sd = w[keep] / w[keep].sum(), mean[keep], sd[keep]
    both = np.sqrt(sd[:, None] ** 2 + sd[None, :] ** 2)
    return float(w @ distance(core - mean, sd) - 0.5 * w @ distance(mean[:, None] - mean[None, :], both) @ w)


def beside(rows: Rows, press: Press, run: Run, model: ModelFile, noise: float, hidden: Sequence[str] = ()) -> Rows:
    """Return the rows with what an open loop and a Kalman filter score at the same scans."""
    seen = replace(run, columns={n: np.full_like(v, np.nan) if n in hidden else v for n, v in run.columns.items()})
    at = np.searchsorted(run.time_s, rows.time)
    alone = np.abs(open_loop(press, run, model)[at] - rows.truth)
    return replace(rows, open_loop=alone, kalman=kalman_score(press, seen, rows.truth, at, model, noise))


def kalman_score(press: Press, run: Run, truth: Array, at: Array, model: ModelFile, noise: float) -> Array:
    """Return the score of a Kalman filter on a fine grid at some scans. [K]"""
    mean, sd = (v[at] for v in filtered(Rates.of(press, run, model), press, run, noise))
    one = np.ones(1)
    return np.array([score(one, one * m, one * s, c) for m, s, c in zip(mean, sd, truth, strict=True)])


def best_noise(press: Press, earlier: Sequence[tuple[Run, Truth]], model: ModelFile) -> float:
    """Return the noise with which a Kalman filter scores best in runs whose core is known. [K²/s]"""

    def scored(noise: float) -> float:
        return sum(
            float(kalman_score(press, run, truth.core_C[at], at, model, noise).sum())
            for run, truth in earlier
            for at in (np.flatnonzero(run.time_s > truth.moments.closed_s)[::4],)
        )

    return min(NOISES.tolist(), key=scored)


def print_table(name: str, rows: Rows) -> None:
    """Print a campaign's table."""
    for number, phase in ((-1, "pooled"), *enumerate(PHASES)):
        part = rows if number < 0 else rows.only(rows.phase == number)
        good = part.only(part.valid > 0)
        if not len(good.error) or (number >= 0 and len(part.error) == len(rows.error)):
            continue
        central = 2.0 * np.abs(good.below - 0.5)
        shares = " ".join(f"{(central <= level).mean():5.2f}" for level in LEVELS)
        print(
            f"{name if number < 0 else '':22s} {phase:14s} {len(part.error):6d} {part.valid.mean():5.2f}  {shares}"
            f"  {good.inside.mean():5.2f} {good.half.mean():7.2f} {np.sqrt(np.mean(good.error**2)):6.2f}"
            f" {good.crps.mean():6.3f} {good.open_loop.mean():6.3f} {good.kalman.mean():6.3f}",
            flush=True,
        )


def virtual(
    seed: int,
    cause: str | None,
    plan: Plan,
    *,
    platens_alone: bool = False,
    stated: Mapping[str, float] | None = None,
) -> Rows:
    """Fit eight pressings of a campaign and follow three more; `stated` stands in every header besides."""
    campaign = [
        (replace(run, header={**run.header, **(stated or {})}), truth)
        for run, truth in make_campaign(seed, FITTED + PREDICTED, cause, plan)
    ]
    press = parse_press(press_toml(plates=plan.plates))
    fits = fit_campaign(press, [run for run, _ in campaign[:FITTED]])
    model = with_missing_causes(fits.model_file(), fits.runs)
    hidden = [c for c in campaign[0][0].columns if platens_alone and c.startswith(("top_", "bottom_"))]
    noise = best_noise(press, campaign[:TUNED], model)
    found = [(run, followed(press, run, truth.core_C, model, hidden)) for run, truth in campaign[FITTED:]]
    return Rows.joined([beside(rows, press, run, model, noise, hidden) for run, rows in found])


def campaigns(first: int, causes: Sequence[str | None], plans: Sequence[Plan], **how: Any) -> Iterator[Rows]:
    """Follow campaigns of consecutive seeds."""
    for i, (cause, plan) in enumerate(zip(causes, plans, strict=True)):
        yield virtual(first + i, cause, plan, **how)


def scattering(plan: Plan, count: int) -> list[Plan]:
    """Return campaigns whose panels scatter by 3, 5 and 8 % in turn."""
    return [replace(plan, panel_spread=(0.03, 0.05, 0.08)[i % 3]) for i in range(count)]


HIDDEN = ("moisture_evaporation", "vapour_convection", "conductivity_temperature", "edge_loss", "density_profile")


EXACT = 0.01
"""What is stated of k and of c in `exact`, as a share, and what the true ones differ from the header by."""
MEASURED_WELL = {
    "panel.conductivity_W_mK": 0.12, "panel.conductivity_W_mK.sd": 0.12 * EXACT,
    "panel.heat_capacity_J_kgK": 1550.0, "panel.heat_capacity_J_kgK.sd": 1550.0 * EXACT,
    "panel.thickness_mm.sd": 0.02, "panel.density_kg_m3.sd": 2.0,
}  # fmt: skip


def exact(count: int) -> Rows:
    """Constants measured to 1 % on each panel, and the header says so."""
    plans = [replace(PLAN, panel_spread=EXACT)] * count
    return Rows.joined(list(campaigns(52000, [None] * count, plans, stated=MEASURED_WELL)))


def unstated(count: int) -> Rows:
    """Panels all alike and as the header says, which does not say how well that is known."""
    return Rows.joined(list(campaigns(52000, [None] * count, [replace(PLAN, panel_spread=0.0)] * count)))


def scatter(count: int) -> Rows:
    """Panels that scatter."""
    return Rows.joined(list(campaigns(52100, [None] * count, scattering(PLAN, count))))


def other(count: int) -> Rows:
    """A press nothing was set on, panels that scatter."""
    return Rows.joined(list(campaigns(52200, [None] * count, scattering(OTHER_PRESS, count))))


def cause(count: int) -> Rows:
    """A cause that nobody diagnosed, panels that scatter."""
    hidden = [HIDDEN[i % len(HIDDEN)] for i in range(max(count, len(HIDDEN)))]
    return Rows.joined(list(campaigns(52300, hidden, [replace(OTHER_PRESS, panel_spread=0.05)] * len(hidden))))


def platens(count: int) -> Rows:
    """No sensor on the panel."""
    return Rows.joined(list(campaigns(52400, [None] * count, scattering(PLAN, count), platens_alone=True)))


RIG_CORE = {
    "T_Inco1": At(layer="inconel_hot", depth_mm=6.5),
    "T_Inco2": At(layer="inconel_cool", depth_mm=1.5),
}


def _rig(core: str, hidden: Sequence[str]) -> Rows:
    mapped, plain = (
        read_mapping(ROOT / "deploy/mappings/press_rig.toml"),
        read_press(ROOT / "deploy/presses/rig.toml"),
    )
    runs = [read_foreign(DATA / path, mapped) for path in PRESS_RIG]
    press, found = plain.model_copy(update={"core": Core(at=RIG_CORE[core])}), []
    for i, run in enumerate(runs):
        fits = fit_campaign(plain, [*runs[:i], *runs[i + 1 :]])
        model = with_missing_causes(fits.model_file(), fits.runs)
        found.append(followed(press, run, run.columns[core], model, hidden))
        print_table(f"  {run.name[:20]}", found[-1])
    return Rows.joined(found)


def rig_one() -> Rows:
    """Press rig, the first inner thermocouple hidden, the second live."""
    return _rig("T_Inco1", ["T_Inco1"])


def rig_other() -> Rows:
    """Press rig, the second inner thermocouple hidden, the first live."""
    return _rig("T_Inco2", ["T_Inco2"])


def rig_both() -> Rows:
    """Press rig, both inner thermocouples hidden."""
    return _rig("T_Inco1", ["T_Inco1", "T_Inco2"])


PINE = """
[press]
name = "pine_depth"
area_m2 = 0.01
[[layer]]
name = "panel"
from_run = true
[boundary.top]
kind = "measured"
column = "hot"
[boundary.bottom]
kind = "insulated"
[[sensor]]
columns = ["core_1"]
at = "panel.middle"
role = "validation"
"""


def _pine(name: str, constants: tuple[float, float]) -> Rows:
    """The slice of a pine slab from 8.6 mm below the flame to its insulated back."""
    path = DATA / "pine_depth" / name
    with path.open(encoding="utf-8-sig") as file:
        table = list(csv.DictReader(file))
    time_s, hot, core = (
        np.array([float(row[c] or "nan") for row in table]) for c in ("Time (s)", "TC 8.6mm (K)", "TC 17.2mm (K)")
    )
    hot, core = hot - 273.15, core - 273.15
    keep = time_s <= time_s[int(np.argmax(hot > 300.0))] if (hot > 300.0).any() else time_s >= 0.0
    header = {
        "panel.material": "pine", "panel.thickness_mm": 17.0, "panel.density_kg_m3": 99.37e-3 / (0.01 * 0.0256),
        "panel.conductivity_W_mK": constants[0], "panel.heat_capacity_J_kgK": constants[1],
        "panel.initial_temperature_C": float(hot[0]), "ambient.temperature_C": 20.0,
    }  # fmt: skip
    run = Run(path.stem, header, time_s[keep], {"hot": hot[keep], "core_1": core[keep]}, str(path))
    return followed(parse_press(PINE), run, core[keep], None)


def pine_depth() -> Rows:
    """Moist pine with an inner thermocouple as the core, constants as a hot disk says, no earlier run."""
    found = [_pine(f"FPL_Wood_Cone_50kW_hor_R{n}.csv", (0.20, 1800.0)) for n in (4, 5)]
    return Rows.joined(found)


def pine_depth_handbook() -> Rows:
    """The same with constants nearer to what the readings want."""
    return Rows.joined([_pine(f"FPL_Wood_Cone_50kW_hor_R{n}.csv", (0.11, 1500.0)) for n in (4, 5)])


def _pine_after(constants: tuple[float, float]) -> Rows:
    """Each of the two runs followed with what the other, its core thermocouple read, says of the model."""
    mapped, press = (
        read_mapping(ROOT / "deploy/mappings/pine_depth.toml"),
        read_press(ROOT / "deploy/presses/pine_depth.toml"),
    )
    given = {"panel.conductivity_W_mK": constants[0], "panel.heat_capacity_J_kgK": constants[1]}
    runs = []
    for path in PINE_DEPTH:
        run = read_foreign(DATA / path, mapped)
        keep = run.time_s <= run.time_s[int(np.argmax(run.columns["hot_8_6mm"] > 300.0))]
        columns = {name: values[keep] for name, values in run.columns.items()}
        runs.append(replace(run, header=run.header | given, time_s=run.time_s[keep], columns=columns))
    found = []
    for before, run in (runs, runs[::-1]):
        fits = fit_campaign(press, [before])
        model = with_missing_causes(fits.model_file(), fits.runs)
        found.append(followed(press, run, run.columns["core_1"], model, ["depth_17_2mm"]))
        print_table(f"  {run.name[-20:]}", found[-1])
    return Rows.joined(found)


def pine_depth_after() -> Rows:
    """Moist pine after one earlier run whose inner thermocouple was read, constants as a hot disk says."""
    return _pine_after((0.20, 1800.0))


def pine_depth_handbook_after() -> Rows:
    """The same with constants nearer to what the readings want."""
    return _pine_after((0.11, 1500.0))


BOARD_CORE = {"depth_5_72mm": 22.88, "depth_11_44mm": 17.16}


def inert_board() -> Rows:
    """Inert board: one of the two hotter thermocouples hidden, no earlier run."""
    mapped = read_mapping(ROOT / "deploy/mappings/inert_board.toml")
    plain = read_press(ROOT / "deploy/presses/inert_board.toml")
    run = read_foreign(DATA / "inert_board/Black-Insulation_q50_Temp.csv", mapped)
    found = []
    for core, depth in BOARD_CORE.items():
        press = plain.model_copy(update={"core": Core(at=At(layer="board", depth_mm=depth))})
        found.append(followed(press, run, run.columns[core], None, [core]))
        print_table(f"  {core} hidden", found[-1])
    return Rows.joined(found)


VIRTUAL = (exact, unstated, scatter, other, cause, platens)
MEASURED = (
    rig_one, rig_other, rig_both, pine_depth, pine_depth_handbook, pine_depth_after, pine_depth_handbook_after,
    inert_board,
)  # fmt: skip


def pictured(folder: Path, name: str, rows: Rows) -> None:
    """Draw measured core and prediction with its band, run beside run."""
    from matplotlib.figure import Figure

    starts = [0, *(np.flatnonzero(np.diff(rows.time) < 0.0) + 1).tolist(), len(rows.time)]
    figure = Figure(figsize=(8.0, 2.6), layout="constrained")
    axes = figure.subplots(1, len(starts) - 1, sharey=True, squeeze=False)[0]
    for own, begin, end in zip(axes, starts[:-1], starts[1:], strict=True):
        part = rows.only(np.arange(begin, end)[:: max(1, (end - begin) // 250)])
        estimated_C = part.truth + part.error
        own.fill_between(
            part.time, estimated_C - part.half, estimated_C + part.half, color="#a9cbe6", linewidth=0.0
        )
        own.plot(part.time, estimated_C, color="#1f6fb2", linewidth=1.0, label="predicted, 95 % band")
        own.plot(part.time, part.truth, ".", color="#222222", markersize=1.5, label="measured")
        own.set_xlabel("s")
    axes[0].set_ylabel("core, °C")
    lines = axes[0].get_legend_handles_labels()
    figure.legend(*lines, loc="outside upper left", ncols=2, fontsize=7, frameon=False)
    figure.savefig(folder / f"{name}.png", dpi=110)


def main(chosen: list[str]) -> None:
    """Print the tables of the sets chosen, all if none is; draw them where a folder is given."""
    folder = Path(chosen.pop(chosen.index("--pictures") + 1)) if "--pictures" in chosen else None
    count = int(chosen.pop(chosen.index("--campaigns") + 1)) if "--campaigns" in chosen else 3
    chosen = [name for name in chosen if not name.startswith("--")]
    sets = {f.__name__: partial(f, count) for f in VIRTUAL} | {f.__name__: f for f in MEASURED}
    print(
        f"{'':22s} {'phase':14s} {'scans':>6s} valid     50    80    95   band  half K  rms K  CRPS   open kalman"
    )
    for name, one in sets.items():
        if name in chosen or not chosen:
            rows = one()
            print_table(name, rows)
            if folder is not None:
                pictured(folder, f"band_{name}", rows)


if __name__ == "__main__":
    main(sys.argv[1:])
