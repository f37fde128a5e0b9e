"""Runs fitted together: what a badly determined run borrows, and coefficients all runs share."""

from dataclasses import replace

import numpy as np
import pytest

from api.commands.fitting import _lines
from daq.press.press_file import parse_press
from daq.records import InputError
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.simulated.campaign_sensors import Nuisances
from daq.words import say
from softsensor.fitting.joint import fit_together
from softsensor.fitting.population import information, population
from softsensor.fitting.problem import minimise
from softsensor.heat.model import ThermalModel
from softsensor.jobs.campaign import fit_campaign, fit_runs
from softsensor.report.fit_report import fit_report

PRESS = parse_press(press_toml())
NAMES = PRESS.coefficient_names
PLAN = Plan(
    rate_hz=1.0, thickness_mm=16.0, press_time_s=(20.0, 30.0), open_after_s=(30.0, 40.0), start_before_s=0.0
)


@pytest.fixture(scope="module")
def cut_short():
    """Five runs; the log of the last one ends a second after closing."""
    campaign = make_campaign(19, 5, plan=replace(PLAN, coefficient_spread=0.12, nuisances=Nuisances.real_chain()))
    runs = [run for run, _ in campaign]
    runs[-1] = runs[-1].at_rows(runs[-1].time_s <= campaign[-1][1].moments.closed_s + 1.2)
    return campaign, fit_campaign(PRESS, runs)


def test_run_that_ends_at_closing_borrows_what_it_cannot_know(cut_short):
    campaign, found = cut_short
    alone, truth = found.runs[-1].coefficients, campaign[-1][1].coefficients
    for name in ("h_p_c", "h_wa"):
        assert not alone[name].identifiable, name
        joint = found.borrowed[found.runs[-1].run][name]
        assert abs(np.log(joint.value / truth[name])) < 3.0 * joint.sd / joint.value, name
        assert joint.sd / joint.value < 0.5, name
        assert np.log(alone[name].ci95[1] / alone[name].ci95[0]) > 4.0 * joint.sd / joint.value, name


def test_runs_that_know_a_coefficient_hardly_move_when_fitted_together(cut_short):
    _, found = cut_short
    for fitted in found.runs[:-1]:
        own, joint = fitted.coefficients["h_pp_o"], found.borrowed[fitted.run]["h_pp_o"]
        assert abs(np.log(joint.value / own.value)) < own.sd / own.value


def test_every_run_stands_where_its_own_search_with_the_others_as_prior_ends(cut_short):
    _, found = cut_short
    people = found.population
    for fitted, (mean, _) in zip(found.runs, people.members, strict=True):
        unknowns = tuple(
            replace(u, centre=people.mean[i], sd=people.spread[i] / fitted.spread)
            for i, u in enumerate(fitted.problem.unknowns[: len(NAMES)])
        )
        assert fitted.problem.names[: len(NAMES)] == NAMES
        problem = replace(fitted.problem, unknowns=(*unknowns, *fitted.problem.unknowns[len(NAMES) :]))
        ended = minimise(problem, max_evaluations=60, decrease=1e-4).x[: len(NAMES)]
        assert ended == pytest.approx(mean, abs=0.1)


def test_run_without_others_is_not_searched_again(cut_short):
    fitted = cut_short[1].runs[-1]  # whose contacts are far from known
    assert not fitted.coefficients["h_p_c"].identifiable
    own = information(fitted.problem, fitted.minimum.evaluation, fitted.spread, NAMES)
    alone = fit_together([fitted], NAMES)
    assert np.array_equal(alone.mean, population(NAMES, [own]).mean)


def test_shared_coefficient_is_one_value_known_better_than_by_any_run():
    campaign = make_campaign(12, 3, plan=replace(PLAN, coefficient_spread=0.0))
    runs = [run for run, _ in campaign]
    found = fit_campaign(PRESS, runs, shared=["h_ap", "h_p_o"])
    for name in ("h_ap", "h_p_o"):
        values = [found.borrowed[run.name][name].value for run in runs]
        assert max(values) / min(values) < 1.001
        c, truth = found.coefficients[name], campaign[0][1].coefficients[name]
        assert c.median_ci95[0] < truth < c.median_ci95[1]
        half = np.log(c.median_ci95[1] / c.median_ci95[0]) / 2.0
        for fitted in found.runs:
            one = fitted.coefficients[name]
            assert half < np.log(one.ci95[1] / one.ci95[0])
    content = found.as_json()["campaign"]
    assert content["h_ap"]["shared"]
    assert not content["h_pp_c"]["shared"]


def test_shared_name_that_is_no_coefficient_is_refused():
    run, _ = make_campaign(12, 1, plan=PLAN)[0]
    with pytest.raises(InputError, match="shared coefficient 'h_x': must be one of h_p_o"):
        fit_campaign(PRESS, [run], shared=["h_x"])


def test_prior_of_the_press_file_counts_once_however_many_runs_there_are():
    """Runs that never close say nothing about the closed contact: only the prior speaks, and only once."""
    text = press_toml() + "\n[priors.h_pp_c]\nmedian = 900.0\nfactor = 1.5\n"
    press = parse_press(text)
    campaign = make_campaign(5, 3, plan=replace(PLAN, closed_column=True, open_before_s=(12.0, 15.0)))
    runs = [run.at_rows(run.time_s <= truth.moments.closed_s - 1.5) for run, truth in campaign]
    fits = fit_runs(ThermalModel(press), runs)
    assert all(f.coefficients["h_pp_c"].verdict == "not identifiable" for f in fits)
    assert all(f.coefficients["h_pp_c"].value == pytest.approx(900.0, rel=0.05) for f in fits)
    people = fit_together(fits, NAMES, known={"h_pp_c": (900.0, float(np.log(1.5)))})
    i = NAMES.index("h_pp_c")
    assert np.exp(people.mean[i]) == pytest.approx(900.0, rel=0.05)
    assert np.sqrt(people.mean_covariance[i, i]) == pytest.approx(np.log(1.5), rel=0.1)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("[priors.h_x]\nmedian = 5.0\nfactor = 2.0\n", "priors.h_x: no such coefficient"),
        ("[priors.h_wa]\nmedian = 5000.0\nfactor = 2.0\n", "outside the coefficient's limits 1..200"),
        ("[priors.h_wa]\nmedian = 14.0\nfactor = 0.9\n", "priors.h_wa.factor = 0.9"),
    ],
)
def test_wrong_prior_is_refused_by_name_value_and_limit(table, says):
    with pytest.raises(InputError, match=says):
        parse_press(f"{press_toml()}\n{table}")


@pytest.fixture(scope="module")
def alike():
    """Eight short runs of a press whose open plate-to-panel contact is the same in all."""
    plan = replace(PLAN, coefficient_spread=0.0, nuisances=Nuisances.real_chain())
    return fit_campaign(PRESS, [run for run, _ in make_campaign(12, 9, plan=plan)], shared=["h_pp_o", "h_ap"])


def test_shared_coefficient_has_one_value_and_one_interval_wherever_it_is_shown(alike):
    content = alike.as_json()
    for name in alike.shared:
        total = content["campaign"][name]
        shown = {(total["median"], *total["median_ci95"]), (total["mean"], *total["ci95"])}
        shown |= {(total["mean"], *total["bootstrap95"])}
        for run in content["runs"]:
            table = run["coefficients"][name]
            shown |= {(table["value"], *table["ci95"]), (table["joint"]["value"], *table["joint"]["ci95"])}
        assert len(shown) == 1, name
        assert not any(w.startswith(f"{name} is ") for run in content["runs"] for w in run["warnings"])
        assert content["runs"][0]["coefficients"][name]["verdict"] == "shared"


def test_shared_coefficient_reads_the_same_on_the_page_and_on_the_terminal(alike):
    page, lines = fit_report(alike).replace("\N{NO-BREAK SPACE}", " "), [line.split() for line in _lines(alike)]
    names = list(alike.coefficients)
    for name in alike.shared:
        c = alike.coefficients[name]
        half = 50.0 * (c.median_ci95[1] - c.median_ci95[0]) / c.median
        cell = f"{say('report-number', value=c.median)} ± {half:.0f} %"
        assert page.count(cell) == 2 * len(alike.runs), name
        column = 1 + names.index(name)
        cells = [line[column].rstrip("?") for line in lines[1 : 1 + len(alike.runs)]]
        assert set(cells) == {f"{c.median:.4g}"}
        assert lines[1 + len(alike.runs)][column] == f"{c.median:.4g}"


def test_program_leaves_a_shared_coefficient_and_keeps_the_others_within_the_press_file(alike):
    program = alike.program({"press_time_s": 9000.0})
    for name in alike.shared:
        c = alike.coefficients[name]
        assert program.coefficients[name].value == c.median
        assert program.intervals[name] == c.median_ci95
    for name in NAMES:
        table, (low, high) = PRESS.coefficient(name), program.intervals[name]
        assert table.lower <= low <= program.coefficients[name].value <= high <= table.upper
    assert any("beyond the press file's limit" in str(remark) for remark in program.remarks)


def test_one_run_shares_with_nobody():
    run, _ = make_campaign(12, 1, plan=PLAN)[0]
    alone, shared = fit_campaign(PRESS, [run]), fit_campaign(PRESS, [run], shared=["h_ap"])
    assert shared.shared == ()
    assert shared.coefficients["h_ap"].median_ci95 == alone.coefficients["h_ap"].median_ci95
    assert shared.runs[0].coefficients["h_ap"] == alone.runs[0].coefficients["h_ap"]
