"""Cure, steam and leave to open from the live sensor, against what the virtual press integrates by itself."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import binomtest

from daq.press.press_file import parse_press
from daq.press.resin_file import LimitsTable, parse_resin
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.curing import Paper, cured, draw_paper
from daq.simulated.physics import solve
from daq.simulated.physics_pressing import BASE_COEFFICIENTS
from softsensor.heat.model_file import FittedValue, MissingCauses, ModelFile
from softsensor.live.replay import replay
from softsensor.live.sensor import LiveSensor
from softsensor.signals.unknown import BAND
from tests.editions import edition

PRESS = parse_press(press_toml())
CONTACT_SD, RATE_SD, ENERGY_SD, CONSTANT_SD = 0.12, 0.10, 0.03, 0.05
"""What issue 22 draws, and the rate at the reference temperature."""
COEFFICIENTS = {name: FittedValue(value, CONTACT_SD * value) for name, value in BASE_COEFFICIENTS.items()}
MODEL = ModelFile("test", "lab", COEFFICIENTS, missing=MissingCauses(8, 0.9, 0.0, {}))
PAPER = Paper()
LEAST = 0.85
RESIN = parse_resin(
    f"""
    [resin]
    name = "virtual"
    source = "daq.simulated.curing"
    [order]
    reference_temperature_C = {PAPER.reference_C}
    rate_per_s = {PAPER.rate}
    rate_per_s.sd = {PAPER.rate * RATE_SD}
    activation_energy_kJ_mol = {PAPER.activation / 1e3}
    activation_energy_kJ_mol.sd = {PAPER.activation / 1e3 * ENERGY_SD}
    [limits]
    cure_least = {LEAST}
    """
)
PLAN = Plan(
    rate_hz=2.0, thickness_mm=16.0, start_before_s=6.0, closed_column=True, panel_spread=CONSTANT_SD,
    coefficient_spread=CONTACT_SD, press_time_s=(45.0, 60.0), open_before_s=(6.0, 12.0), open_after_s=(6.0, 8.0),
)  # fmt: skip
PLATENS_K = {"platen_offset": {"top_K": 1.0, "bottom_K": -1.0}}


def headed(run):
    """The header states the constants' scatter, and the moisture."""
    constants = {
        "panel.conductivity_W_mK": 0.12,
        "panel.conductivity_W_mK.sd": 0.12 * CONSTANT_SD,
        "panel.heat_capacity_J_kgK": 1550.0,
        "panel.heat_capacity_J_kgK.sd": 1550.0 * CONSTANT_SD,
        "panel.moisture_percent": 8.0,
    }
    return replace(run, header=run.header | constants)


@dataclass(frozen=True)
class Pressed:
    """One pressing, as said and as it was; times in s after closing."""

    opened: float
    oracle: float
    cure_at_opening: float
    inside: float
    half_width: float
    error: float
    curves: tuple


def pressed(run, truth, paper):
    said = replay(PRESS, headed(run), MODEL, resin=RESIN).estimates
    bottom, top = cured(solve(truth.pressing), paper, run.time_s)
    after = run.time_s - truth.moments.closed_s
    rows = [k for k, e in enumerate(said) if e.leave is not None and after[k] > 3.0]
    rows = [k for k in rows if run.time_s[k] < truth.moments.opened_s]
    least = np.minimum(bottom, top)
    leave = next((k for k in rows if said[k].open_now), None)
    inside, widths, errors = [], [], []
    for k in rows:
        for face, true in ((said[k].leave.panel.cure_bottom, bottom[k]), (said[k].leave.panel.cure_top, top[k])):
            if true > 0.999:
                continue  # cured: its logarithm no longer tells anything
            # the truth's equivalent time under the nominal law, so that band and error are of one kind
            x = -np.log1p(-true) / PAPER.rate
            inside.append(bool(face.low <= np.log(x) <= face.high))
            widths.append(BAND * float(face.sd))
            errors.append(float(np.log(x) - face.mean))
    return Pressed(
        opened=np.nan if leave is None else float(after[leave]),
        oracle=float(after[np.argmax(least >= LEAST)]),
        cure_at_opening=np.nan if leave is None else float(least[leave]),
        inside=float(np.mean(inside)),
        half_width=float(np.sqrt(np.mean(np.square(widths)))),
        error=float(np.sqrt(np.mean(np.square(errors)))),
        curves=(run.time_s, said, bottom, top),
    )


def campaign(seed, count, hidden=None):
    papers = np.random.default_rng([seed, 9])
    return [
        pressed(run, truth, draw_paper(papers, RATE_SD, ENERGY_SD, PAPER))
        for run, truth in make_campaign(seed, count, hidden, PLAN)
    ]


@pytest.fixture(scope="module")
def one():
    ((run, truth),) = make_campaign(501, 1, None, PLAN)
    return run, truth, pressed(run, truth, PAPER)


def test_with_the_resin_known_both_faces_are_followed_and_the_press_opens_in_time(one):
    _, _, found = one
    assert found.inside > 0.95
    assert found.error < 0.15  # of ln time; the band's half-width is about twice as wide
    assert found.oracle <= found.opened < 2.0 * found.oracle
    assert found.cure_at_opening >= LEAST


def test_nothing_may_leave_before_it_is_cured_nor_once_the_press_is_open(one):
    _, truth, found = one
    time_s, said, bottom, top = found.curves
    for t, estimate, cure in zip(time_s, said, np.minimum(bottom, top), strict=True):
        if estimate.open_now:
            assert cure >= LEAST
            assert estimate.state == "closed"
            assert truth.moments.closed_s < t < truth.moments.opened_s + 2.0


def test_a_lost_platen_takes_the_leave_back(one):
    run, truth, _ = one
    lost = run.time_s > truth.moments.closed_s + 20.0
    columns = {n: np.where(lost, np.nan, v) if n.startswith("platen") else v for n, v in run.columns.items()}
    said = replay(PRESS, headed(replace(run, columns=columns)), MODEL, resin=RESIN).estimates
    assert any(e.open_now for e in said)
    assert not any(e.open_now for e in said if not e.valid)
    late = run.time_s > truth.moments.closed_s + 32.0  # a platen is bridged for some seconds
    assert not any(e.open_now for e, gone in zip(said, late, strict=True) if gone)


def test_the_band_without_readings_of_the_faces_is_wider_and_holds(one):
    run, truth, seen = one
    blind = replace(run, columns={n: v for n, v in run.columns.items() if not n.startswith(("top_", "bottom_"))})
    found = pressed(blind, truth, PAPER)
    assert found.half_width > seen.half_width
    assert found.inside > 0.9


def test_steam_of_a_panel_without_moisture_is_not_known_and_nothing_may_leave(one):
    run, _, _ = one
    limits = RESIN.limits.model_copy(update={"steam_most_kPa": 1000.0})
    header = {k: v for k, v in headed(run).header.items() if not k.startswith("panel.moisture")}
    resin = RESIN.model_copy(update={"limits": limits})
    columns = replay(PRESS, replace(run, header=header), MODEL, resin=resin).columns()
    assert np.isnan(columns["steam_kPa"]).all()
    assert not any(columns["open_now"])
    columns = replay(PRESS, headed(run), MODEL, resin=resin).columns()
    steam, high = np.array(columns["steam_kPa"]), np.array(columns["steam_high_kPa"])
    known = np.isfinite(steam)
    assert known.any()
    assert (high[known] > steam[known]).all()
    assert any(columns["open_now"])


def test_a_resin_changes_nothing_that_is_said_of_the_core(one):
    run, _, _ = one
    plain, with_resin = (replay(PRESS, headed(run), MODEL, resin=r).columns() for r in (None, RESIN))
    for name, column in plain.items():
        assert column == pytest.approx(with_resin[name], nan_ok=True) if name.startswith("core") else True
        assert column == with_resin[name] or name.startswith("core")


def test_a_resin_for_a_press_without_a_panel_is_refused():
    slab = parse_press(
        """
        [[layer]]
        name = "slab"
        thickness_mm = 10.0
        conductivity_W_mK = 1.0
        density_kg_m3 = 1000.0
        heat_capacity_J_kgK = 1000.0
        [boundary.bottom]
        kind = "measured"
        column = "platen_bottom"
        """
    )
    ((run, _),) = make_campaign(501, 1, None, PLAN)
    with pytest.raises(InputError, match="no panel"):
        replay(slab, run, None, resin=RESIN)


@pytest.mark.campaign
@pytest.mark.timeout(14400)
@pytest.mark.parametrize("hidden", [None, PLATENS_K, "contact_buildup"], ids=["plain", "platens", "buildup"])
def test_limits_hold_at_opening_with_the_promised_share(hidden):
    """Prints what issue 22 asks for; asserts what must hold of any edition, by the binomial intervals."""
    found = campaign(7100, edition(6, 200), hidden)
    opened = [p for p in found if np.isfinite(p.opened)]
    broken = sum(p.cure_at_opening < LEAST for p in opened)
    interval = binomtest(broken, len(opened)).proportion_ci()
    oracle, times = np.array([p.oracle for p in found]), np.array([p.opened for p in opened])
    fixed = float(np.quantile(oracle, 1.0 - broken / len(opened)))
    inside, width = np.mean([p.inside for p in found]), np.sqrt(np.mean([p.half_width**2 for p in found]))
    error = np.sqrt(np.mean([p.error**2 for p in found]))
    print(
        f"\n{len(found)} pressings, {len(opened)} opened: band covers {100 * inside:.1f} %, half-width "
        f"{width:.3f} = {width / error:.2f} x its error (ln time); limit broken at opening in {broken} "
        f"({100 * interval.low:.1f} to {100 * interval.high:.1f} %); press time {times.mean():.1f} s, fixed for "
        f"the same share {fixed:.1f} s ({100 * (1 - times.mean() / fixed):.0f} % shorter), "
        f"oracle {oracle.mean():.1f} s"
    )
    assert len(opened) >= 0.9 * len(found)
    assert interval.low <= 0.025
    # a pressing's rows share its paper's error, so a pressing counts once: its band is right or wrong
    right = sum(p.inside > 0.5 for p in found)
    assert binomtest(right, len(found)).proportion_ci().high >= 0.93


def test_the_moment_foreseen_is_the_moment_at_which_leave_is_given(one):
    run, truth, found = one
    sensor, told, given = LiveSensor(PRESS, headed(run).header, MODEL, RESIN), [], None
    for i, t in enumerate(run.time_s.tolist()):
        said = sensor.update(t, {name: float(values[i]) for name, values in run.columns.items()})
        sensor.look_ahead()
        if said.state == "closed":
            told.append((t, sensor.forecast))
        given = t if given is None and said.open_now else given
    assert given - truth.moments.closed_s == pytest.approx(found.opened)
    before = [(t, o) for t, o in told if truth.moments.closed_s + 3.0 < t < given - 1.0]
    assert before
    assert all(o.limits_blocking == "" for _, o in before)
    assert max(abs(t + o.limits_in_s - given) for t, o in before) < 4.0
    assert all(o.limits_likely_in_s <= o.limits_in_s for _, o in before)
    after = [o for t, o in told if given + 4.0 < t < truth.moments.opened_s - 1.0]
    assert all(o.limits_in_s == 0.0 for o in after)


def test_a_limit_that_cannot_be_met_is_named(one):
    run, truth, _ = one
    cold = RESIN.model_copy(update={"limits": LimitsTable(cure_least=0.85, core_most_C=30.0, core_least_C=100.0)})
    sensor = LiveSensor(PRESS, headed(run).header, MODEL, cold)
    for i, t in enumerate(run.time_s[run.time_s < truth.moments.closed_s + 20.0].tolist()):
        sensor.update(t, {name: float(values[i]) for name, values in run.columns.items()})
    sensor.look_ahead()
    assert np.isnan(sensor.forecast.limits_in_s)
    assert sensor.forecast.limits_blocking in ("core_most", "core_least")
