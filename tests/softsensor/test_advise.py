"""Advice for a panel not pressed yet: laws it must keep, a second way to count the risk, and the command."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from math import isfinite, log
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from scipy.special import erfc

import softsensor
from api.cli import main
from daq.press.press_file import Contact, Load, Press, parse_press
from daq.press.resin_file import Resin, SorptionTable, read_resin
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign, press_toml
from softsensor.heat.model_file import FittedValue, ModelFile, model_text
from softsensor.opening.kinetics import equivalent_course, kinetics_of
from softsensor.opening.steam import FIT_PERCENT, MOISTURE, steam_pressure, steam_with_slopes
from softsensor.planning.advise import Goal, ProgrammeAdvice, Wish, _energy, advise, limits_of, quantities_of
from softsensor.planning.made_up import (
    DEPTHS,
    PLATENS,
    SHARE,
    Programme,
    Task,
    ensemble,
    heat_taken,
    made_up_run,
    steam_of,
)
from softsensor.planning.summary import advice_title
from tests.screens import flooding, text_of

ROOT = Path(__file__).parents[2]
RESIN = ROOT / "deploy" / "resins" / "melamine_formaldehyde.toml"
PANEL = MappingProxyType(
    {
        "panel.material": "MDF",
        "panel.thickness_mm": 8.0,
        "panel.density_kg_m3": 750.0,
        "panel.conductivity_W_mK": 0.12,
        "panel.heat_capacity_J_kgK": 1550.0,
        "panel.initial_temperature_C": 23.0,
        "panel.moisture_percent": 8.0,
        "ambient.temperature_C": 23.0,
    }
)


@cache
def press() -> Press:
    """The virtual press as a press file describes it."""
    return parse_press(press_toml())


@cache
def resin() -> Resin:
    return read_resin(RESIN)


@cache
def model() -> ModelFile:
    """Contacts as the press file guesses them, each known to 12 %."""
    names = press().coefficient_names
    guesses = {name: press().coefficient(name).guess for name in names}
    known = {name: FittedValue(value, 0.12 * value) for name, value in guesses.items()}
    return ModelFile("made", press().name, known, (), tuple(names), 0.12**2 * np.eye(len(names)))


def task(longest_s: float = 90.0) -> Task:
    return Task(press(), model(), PANEL, 10.0, longest_s)


@cache
def advised(
    platens: tuple[float, float] = (180.0, 180.0), probability: float = 0.975, cure: float = 0.85
) -> ProgrammeAdvice:
    """Advice on the cure of both faces alone."""
    limits = limits_of(resin(), {"cure_least": cure, "probability": probability, "steam_most_kPa": 1e5})
    ranges = {"platen_temperature_C": platens, "press_time_s": (5.0, 90.0)}
    return advise(task(), Wish(limits, resin(), ranges))


def seconds(found: ProgrammeAdvice) -> float:
    assert found.best is not None
    return found.best.opening.in_s


def test_hotter_platens_take_less_time_and_the_fastest_is_chosen() -> None:
    found = advised((170.0, 200.0))
    times = [t.opening.in_s for t in found.tried]
    assert times == sorted(times, reverse=True)
    assert times[0] > times[-1] == seconds(found)
    assert [t.programme.platen_C for t in found.tried][::6] == [170.0, 200.0]


def test_what_is_surer_or_stricter_never_takes_less_time() -> None:
    usual = seconds(advised())
    assert seconds(advised(probability=0.8)) <= usual <= seconds(advised(probability=0.99))
    assert seconds(advised(cure=0.7)) < usual < seconds(advised(cure=0.93))


def test_as_many_draws_break_a_limit_as_the_risk_says() -> None:
    found = advised(probability=0.8)
    kinetics = kinetics_of(resin())
    drawn = ensemble(task(), Programme(180.0, None))
    quantities = quantities_of(drawn, drawn.courses(Programme(180.0, None)), found.wish, kinetics)
    row = int(np.searchsorted(drawn.press_times, seconds(found)))
    least = log(kinetics.equivalent_s(0.85))
    under = np.mean((quantities.cure_bottom[:, row] < least) | (quantities.cure_top[:, row] < least))
    # 20 % at most by the sum of both faces' chances; two deviations of 96 draws are 8 %
    assert under < 0.2 + 0.08


def test_with_every_doubt_taken_out_hardly_any_is_left() -> None:
    drawn = ensemble(task(), Programme(180.0, None))
    quantities = quantities_of(drawn, drawn.courses(Programme(180.0, None)), advised().wish, kinetics_of(resin()))
    unit = drawn.draws.unit
    every = np.arange(unit.shape[1])
    rest = quantities.without(unit, np.linalg.pinv(unit), every).known()
    before = quantities.known()
    assert (rest.cure_top.sd[30:] < 0.15 * before.cure_top.sd[30:]).all()
    assert (rest.core.sd[30:] < 0.15 * before.core.sd[30:]).all()


def test_knowing_more_saves_time_and_the_largest_saving_comes_first() -> None:
    savings = advised().savings
    times = [s.press_time_s for s in savings]
    assert times
    assert times == sorted(times)
    assert max(times) < seconds(advised())


def test_a_panel_through_and_through_warm_has_taken_up_what_its_capacity_holds() -> None:
    """750 kg/m³ times 1550 J/kgK times 8 mm times 157 K on 0.25 m², beside what two open plates lose by h_ap."""
    taken_up = 750.0 * 1550.0 * 0.008 * (180.0 - 23.0) * 0.25 / 3.6e6
    lost = 2 * press().coefficient("h_ap").guess * (180.0 - 23.0) * 30.0 * 0.25 / 3.6e6
    energy = _energy(task(), np.full(len(DEPTHS), 180.0), Programme(180.0, None), 30.0)
    assert energy == pytest.approx(taken_up + lost)


def wet() -> Task:
    """A panel of 8 mm of which 5 % of its dry mass evaporates above 103 °C, as its model says."""
    water = {"moisture_percent": FittedValue(5.0, 0.0), "temperature_C": FittedValue(103.0, 0.0)}
    held = replace(model(), effects=(("moisture_evaporation", water),))
    return replace(task(), model=held, header={**PANEL, "panel.moisture_percent": 8.0})


def test_water_that_evaporates_takes_its_latent_heat_by_the_time_the_panel_is_dry() -> None:
    """2.4 MJ/kg (physics.md) of 5 % of the dry mass, 750/1.08 kg/m³ times 8 mm; none below its temperature."""
    whole = 2.4e6 * 0.05 * 750.0 / 1.08 * 0.008
    taken = [heat_taken(wet(), Programme(180.0, None), at) for at in (10.0, 30.0, 90.0, 600.0)]
    assert taken == sorted(taken)
    assert 0.0 < taken[0] < 0.5 * whole
    assert taken[-1] == pytest.approx(whole, rel=1e-3)
    assert heat_taken(wet(), Programme(85.0, None), 60.0) < 1e-3 * whole
    assert heat_taken(task(), Programme(180.0, None), 60.0) == 0.0


def test_an_advice_on_a_wet_panel_counts_the_heat_that_its_water_takes() -> None:
    limits = limits_of(None, {"core_least_C": 95.0})
    wish = Wish(limits, None, {"platen_temperature_C": (180.0, 180.0), "press_time_s": (5.0, 300.0)})
    best = advise(replace(wet(), longest_s=300.0), wish).best
    assert best is not None
    latent = heat_taken(wet(), best.programme, np.ceil(best.opening.in_s)) * 0.25 / 3.6e6
    sensible = 750.0 * 1550.0 * 0.008 * (95.0 - 23.0) * 0.25 / 3.6e6  # the core's, which is the coldest
    assert latent > 0.1 * sensible
    assert best.energy_kWh > sensible + latent


@pytest.mark.parametrize("seconds_on", [5.0, 20.0, 60.0])
def test_heat_read_through_a_panel_that_warms_from_both_faces_is_what_has_passed_them(seconds_on: float) -> None:
    """Q = 2 k ΔT √(t / (π a)) through each face of a body that has not warmed in its middle (Carslaw & Jaeger)."""
    a, rise, thickness = 0.12 / (750.0 * 1550.0), 157.0, 0.03
    away = np.stack([DEPTHS, 1.0 - DEPTHS]) * thickness / (2.0 * np.sqrt(a * seconds_on))
    layers = 23.0 + rise * erfc(away).sum(axis=0)
    passed = 2 * 2.0 * 0.12 * rise * np.sqrt(seconds_on / (np.pi * a)) * 0.25 / 3.6e6
    thick = replace(task(), header={**PANEL, "panel.thickness_mm": 1e3 * thickness})
    energy, none = (_energy(thick, t, Programme(180.0, None), 30.0) for t in (layers, np.full_like(layers, 23.0)))
    assert energy - none == pytest.approx(passed, rel=0.02)


def test_steam_read_through_a_panel_hot_at_its_faces_is_that_of_all_its_depths() -> None:
    fine = (np.arange(2000) + 0.5) / 2000.0
    read, through = (60.0 + 110.0 * np.exp(-np.minimum(z, 1.0 - z) / 0.12) for z in (DEPTHS, fine))
    found = steam_pressure(read, SHARE, 8.0)
    assert found == pytest.approx(steam_pressure(through, np.full(2000, 1 / 2000), 8.0), rel=0.03)


def test_a_limit_of_steam_is_refused_where_nobody_stated_the_moisture_as_it_never_holds_live() -> None:
    dry = replace(task(), header={k: v for k, v in PANEL.items() if k != MOISTURE})
    for none in (dry, replace(dry, header={**dry.header, MOISTURE: 0.0})):
        with pytest.raises(InputError, match=r"steam needs the panel's moisture; add panel\.moisture_percent"):
            advise(none, Wish(limits_of(resin(), {"steam_most_kPa": 100.0}), resin()))


@pytest.mark.parametrize(("factor", "moisture"), [(1.0, 8.0), (0.7, 8.0), (1.0, 4.0)])
def test_steam_of_a_program_is_as_unsure_of_board_and_fit_as_live(factor: float, moisture: float) -> None:
    """Live goes by slopes (`steam_with_slopes`): dry board and fit by theirs, here both are drawn."""
    sorption = SorptionTable(factor=factor, factor_sd=0.1)
    board = resin().model_copy(update={"sorption": sorption})
    known = replace(task(), header={**PANEL, MOISTURE: moisture, f"{MOISTURE}.sd": 1e-9})
    drawn = ensemble(known, Programme(180.0, None))
    layers = np.full((len(drawn.draws.unit), 1, len(DEPTHS)), 95.0)
    sd = float(np.log(steam_of(drawn, layers, board)).std(ddof=1))
    slopes = steam_with_slopes(layers[0], SHARE, moisture, factor)
    of_fit, of_board = FIT_PERCENT * factor * slopes.by_moisture[0], slopes.by_factor[0] * 0.1 / factor
    assert sd == pytest.approx(float(np.hypot(of_fit, of_board)), rel=0.15)  # of 96 draws 7 %, and curved


def test_less_known_of_a_board_is_never_surer() -> None:
    drawn = ensemble(task(), Programme(180.0, None))
    layers = np.full((len(drawn.draws.unit), 1, len(DEPTHS)), 95.0)
    spread = [float(np.log(steam_of(drawn, layers, known)).std()) for known in (None, resin())]
    assert spread[0] >= spread[1]


def test_two_open_plates_lose_heat_once_however_many_of_them_part_from_the_panel() -> None:
    both = press().model_copy(update={"contact": tuple(_parting(c) for c in press().contact)})
    cold = np.full(len(DEPTHS), 23.0)
    one, two = (_energy(replace(task(), press=p), cold, Programme(180.0, None), 30.0) for p in (press(), both))
    assert two == pytest.approx(one)


def _parting(contact: Contact) -> Contact:
    """Return a contact of the panel with the plate below it that parts as the one above does."""
    below = contact.between == ("plate_bottom", "panel")
    return contact.model_copy(update={"open": ("h_ap", "h_wa")}) if below else contact


def test_draws_are_centred_and_platens_scatter_as_their_class_says() -> None:
    drawn = ensemble(task(), Programme(180.0, None))
    assert drawn.draws.unit.mean(axis=0) == pytest.approx(0.0, abs=1e-12)
    assert drawn.draws.of(PLATENS).shape == (96, 2)
    platens = np.array([v["boundary_top_K"] for v in drawn.values])
    assert platens.std() == pytest.approx(np.hypot(0.25, 0.75), rel=0.2)


def test_a_program_is_the_same_solved_alone_or_moved_from_another() -> None:
    """Platens are shifted in a case that is ready; a case made for them must give the same."""
    there = ensemble(task(), Programme(180.0, None)).courses(Programme(195.0, None))
    own = ensemble(task(), Programme(195.0, None)).courses(Programme(195.0, None))
    assert there.layers_C == pytest.approx(own.layers_C, abs=1e-6)


@pytest.mark.campaign
@pytest.mark.parametrize("probability", [0.975, 0.8])
def test_the_virtual_press_breaks_the_limit_no_oftener_than_promised(probability: float) -> None:
    """80 pressings at the advised time, contacts 12 %, constants 5 %, kinetics drawn; within three deviations."""
    usual = Plan(rate_hz=2.0, thickness_mm=16.0, coefficient_spread=0.12, panel_spread=0.05)
    runs = [run for run, _ in make_campaign(91, 8, None, usual)]
    panel = {key: v for key, v in runs[0].header.items() if key.startswith(("panel.", "ambient."))}
    found = softsensor.advise(
        press(),
        softsensor.fit(runs, press()),
        resin(),
        panel=panel,
        ranges={"platen_temperature_C": (180.0, 180.0)},
        limits={"cure_least": 0.85, "probability": probability},
    ).advised
    assert flooding(found) == {}
    time_s = seconds(found)
    pressed = make_campaign(91, 80, None, replace(usual, platen_C=(180.0, 180.0), press_time_s=(time_s, time_s)))
    rng, kinetics, least = np.random.default_rng(3), kinetics_of(resin()), []
    for run, truth in pressed:
        closed = run.time_s <= truth.moments.opened_s
        faces = np.stack([truth.bottom_C[closed], truth.top_C[closed]])
        errors = np.repeat(rng.standard_normal((2, 1)), 2, axis=1)
        reached = equivalent_course(kinetics, run.time_s[closed], faces, errors)[:, -1:]
        least.append(kinetics.cure(reached).min())
    promised = 1.0 - probability
    broken = float(np.mean(np.array(least) < 0.85))
    assert broken <= promised + 3.0 * (promised * probability / len(least)) ** 0.5


def test_where_no_program_will_do_the_nearest_limit_is_named() -> None:
    limits = limits_of(None, {"core_least_C": 150.0})
    found = advise(task(), Wish(limits, None, {"press_time_s": (5.0, 60.0)}, Goal.ENERGY))
    assert found.best is None
    assert not isfinite(found.nearest.opening.in_s)
    assert found.nearest.opening.blocking == "core_least"
    assert found.nearest.programme.platen_C == 200.0


def test_the_chance_stated_where_no_program_will_do_is_that_of_any_limit_broken() -> None:
    limits = limits_of(None, {"core_least_C": 90.0, "core_most_C": 95.0})
    found = advise(task(), Wish(limits, None, {"press_time_s": (5.0, 90.0)}, Goal.TIME))
    opening = found.nearest.opening
    of_each = [float(chance.min()) for chance in found.nearest.broken.chances.values()]
    assert found.best is None
    assert opening.risk > max(of_each)
    stated = f"a limit broken with a probability of {100.0 * opening.risk:.0f} %, most likely: core too"
    assert stated in str(advice_title(found))


@pytest.mark.parametrize("limit", [{"core_least_C": 210.0}, {"core_most_C": 25.0}], ids=["least", "most"])
def test_of_programs_that_all_break_a_limit_for_certain_the_nearest_is_told_by_its_distance(limit) -> None:
    """No core is above 210 °C after 90 s, none below 25 °C after 60 s: one asks for hot platens, one for cool."""
    limits = limits_of(None, limit)
    found = advise(task(), Wish(limits, None, {"press_time_s": (60.0, 90.0)}, Goal.TIME))
    assert {t.opening.risk for t in found.tried} == {1.0}
    furthest = {t.programme.platen_C: t.opening.beyond for t in found.tried}
    assert found.nearest.opening.beyond == min(furthest.values()) < max(furthest.values())
    assert f"platens {found.nearest.programme.platen_C:.0f} °C" in str(advice_title(found))


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, "no limit is given"),
        ({"limits": {"cure_least": 0.9}}, "needs the resin's kinetics"),
        ({"limits": {"core_least_C": 60.0}, "goal": "speed"}, "must be one of time, energy, throughput"),
        ({"limits": {"core_least_C": 60.0}, "panel": {"panel.thickness_mm": -3.0}}, "thickness_mm"),
        ({"limits": {"core_least_C": 60.0}, "ranges": {"thickness_mm": (8.0, 9.0)}}, "no such setting here"),
        (
            {"limits": {"core_least_C": 60.0}, "ranges": {"pressure_N_cm2": (200.0, 400.0)}},
            "nothing in it follows",
        ),
        (
            {"limits": {"core_least_C": 60.0}, "ranges": {"press_time_s": (20.3, 20.31)}},
            "steps of 1 s, and none lies",
        ),
        ({"limits": {"core_cold": 60.0}}, "core_cold"),
        ({"limits": {"core_least_C": 80.0, "core_most_C": 60.0}}, "exclude each other"),
        (
            {"limits": {"core_least_C": 60.0}, "panel": {"panel.thicknes_mm": 19.0}},
            "panel.thicknes_mm is not known; did you mean panel.thickness_mm",
        ),
        (
            {"limits": {"core_least_C": 60.0}, "panel": {"thickness_mm": 19.0}},
            "did you mean panel.thickness_mm",
        ),
    ],
)
def test_what_cannot_be_advised_on_is_refused(given: dict[str, dict[str, float]], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        softsensor.advise(press(), model(), **given)  # type: ignore[arg-type]


def test_a_key_of_the_panel_that_nothing_knows_is_warned_of_as_in_a_runs_header():
    asked = {"press_time_s": (60.0, 70.0), "platen_temperature_C": (180.0, 180.0)}
    with pytest.warns(UserWarning, match="header key glue is not known"):
        softsensor.advise(
            press(), model(), panel={**PANEL, "glue": 1.0}, limits={"core_least_C": 60.0}, ranges=asked
        )


def test_a_press_that_never_opens_has_no_press_time() -> None:
    plate = parse_press('[[layer]]\nname = "panel"\nfrom_run = true\n')
    with pytest.raises(InputError, match="opens and closes"):
        made_up_run(Task(plate, model(), PANEL, 10.0, 60.0), Programme(180.0, None))


def test_the_command_doubts_a_panel_in_the_terminals_words_and_names_no_line_of_ours(tmp_path: Path) -> None:
    (tmp_path / "press.toml").write_text(press_toml(), encoding="utf-8")
    (tmp_path / "model.json").write_text(model_text(model()), encoding="utf-8")
    command = [sys.executable, "-m", "api", "advise", "--press", "press.toml", "--model", "model.json"]
    command += ["--core-least", "60", "--panel", "panel.material=Foo"]
    spoken = {**os.environ, "KERNTEMP_LANGUAGE": "de", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=spoken, capture_output=True, text=True, check=False)
    lines = done.stderr.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("kerntemp: Material 'Foo' steht nicht in der Tabelle")


def test_the_command_writes_answer_and_figure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "press.toml").write_text(press_toml(), encoding="utf-8")
    (tmp_path / "model.json").write_text(model_text(model()), encoding="utf-8")
    out, svg, report = (tmp_path / f"advice.{ending}" for ending in ("json", "svg", "html"))
    command = ["advise", "--press", str(tmp_path / "press.toml"), "--model", str(tmp_path / "model.json")]
    options = ["--resin", str(RESIN), "--price", "0.3", "--json", str(out), "--svg", str(svg)]
    options += ["--html", str(report)]
    options += ["--panel", "panel.thickness_mm=8", "--range", "platen_temperature_C=180:190"]
    assert main([*command, *options]) == 0
    output = capsys.readouterr().out
    shown = text_of(report)
    assert all(line in shown for line in output.splitlines() if str(tmp_path) not in line)
    written = json.loads(out.read_text(encoding="utf-8"))
    keys = {"panel", "resin", "limits", "probability", "goal", "best", "programs", "tradeoff", "measure"}
    assert set(written) == keys
    (shown_s,) = map(float, re.findall(r"Press for ([0-9.]+) s at", output))
    assert written["best"]["press_time_s"] <= shown_s < written["best"]["press_time_s"] + 0.1, (
        "a shorter one is not enough"
    )
    assert all(float(less) < shown_s for less in re.findall(r"exactly, ([0-9.]+) s would do", output))
    assert written["best"]["risk"] == pytest.approx(0.025)
    assert written["best"]["cost_eur"] == pytest.approx(0.3 * written["best"]["energy_kWh"], rel=1e-3)
    assert len(written["tradeoff"]["press_time_s"]) == len(written["tradeoff"]["risk"])
    assert svg.read_text(encoding="utf-8").startswith("<?xml")
    assert main([*command, "--panel", "thick"]) == 2
    assert "must be KEY=VALUE" in capsys.readouterr().err


@pytest.mark.parametrize(("unit", "reads"), [("N/cm2", 300.0), ("kPa", 3000.0), ("bar", 30.0), ("MPa", 3.0)])
def test_a_load_column_gets_the_pressure_in_its_own_unit(unit, reads):
    run, _ = made_up_run(replace(task(), press=loaded(unit)), Programme(180.0, 300.0))
    assert run.columns["load"][0] == pytest.approx(reads)


def test_a_load_without_a_unit_is_refused_where_the_model_follows_it():
    follows = replace(model(), effects=(("contact_load", {"exponent": FittedValue(0.5, 0.1)}),))
    with pytest.raises(InputError, match=r"column load, whose unit is not given: add unit = "):
        made_up_run(replace(task(), press=loaded(None), model=follows), Programme(180.0, 300.0))
    made_up_run(replace(task(), press=loaded(None)), Programme(180.0, 300.0))


def loaded(unit):
    """The press with a load column at the contacts of its panel."""
    load = Load(column="load", reference=300.0, unit=unit)
    contacts = tuple(c.model_copy(update={"load": load}) if "panel" in c.between else c for c in press().contact)
    return press().model_copy(update={"contact": contacts})
