"""`kerntemp fit` as a user calls it: what it prints, writes and refuses."""

import json
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from api.cli import main
from api.commands.fitting import remark_lines
from daq.files.run_file import write_run
from daq.simulated.campaign import Plan, make_campaign
from daq.simulated.campaign_pressfile import press_toml
from daq.words import say

PROFILED = ("h_pp_c", "h_pp_o", "h_wa")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Eight short runs whose press time varies, and the press file."""
    place = tmp_path_factory.mktemp("fit")
    plan = Plan(rate_hz=1.0, thickness_mm=16.0, press_time_s=(20.0, 40.0), open_after_s=(30.0, 40.0))
    for run, _ in make_campaign(6, 8, plan=plan):
        write_run(run, place / f"{run.name}.csv")
    (place / "press.toml").write_text(press_toml())
    return place


@pytest.fixture(scope="module")
def fitted(folder):
    """Numbers and page that `fit` writes, from one call."""
    runs = [str(p) for p in sorted(folder.glob("*.csv"))]
    out = ["--json", str(folder / "fit.json"), "--html", str(folder / "fit.html")]
    assert main(["fit", *runs, "--press", str(folder / "press.toml"), "--program", "press_time_s=200", *out]) == 0
    return folder


def _error(capsys):
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_json_holds_profiles_and_correlations_of_every_run(fitted):
    content = json.loads((fitted / "fit.json").read_text())
    assert len(content["runs"]) == 8
    for run in content["runs"]:
        names = run["correlation"]["names"]
        assert len(run["correlation"]["matrix"]) == len(names)
        assert all(row[i] == pytest.approx(1.0) for i, row in enumerate(run["correlation"]["matrix"]))
        for name in PROFILED:
            shape = run["profiles"][name]
            assert min(shape["rise"]) == 0.0
            assert max(shape["rise"]) > shape["threshold"]
            assert {"value", "sd", "ci95"} <= set(run["coefficients"][name]["joint"])


def test_program_outside_those_seen_is_predicted_with_a_remark(fitted):
    written = json.loads((fitted / "fit.json").read_text())["program"]
    assert written["settings"] == {"press_time_s": 200.0}
    assert "outside the programs run so far" in written["remarks"][0]
    for name in PROFILED:
        c = written["coefficients"][name]
        assert c["ci95"][0] <= c["value"] <= c["ci95"][1]
    page = (fitted / "fit.html").read_text()
    assert "A program never run" in page
    assert "press_time_s =\u00a0200" in page


def test_page_shows_profiles_and_what_runs_borrow_and_needs_nothing_from_elsewhere(fitted):
    page = (fitted / "fit.html").read_text()
    assert page.count('aria-label="profile of h_pp_c"') == 8
    drawn = re.findall(r'points="([^"]*)"', page)
    assert len(drawn) >= 8
    assert all(re.fullmatch(r"[-0-9., ]+", points) for points in drawn)
    assert "borrows from the others" in page
    assert not re.search(r'(src|href)="https?:', page)


def test_every_figure_comes_as_svg(folder, tmp_path):
    runs = [str(p) for p in sorted(folder.glob("*.csv"))[:2]]
    assert main(["fit", *runs, "--press", str(folder / "press.toml"), "--svg", str(tmp_path)]) == 0
    names = {p.name for p in tmp_path.iterdir()}
    assert {"coefficients.svg", "coefficients_normalised.svg"} <= names
    assert sum(name.startswith("measured_") for name in names) == 2
    assert all((tmp_path / name).read_text().lstrip().startswith("<?xml") for name in names)


@pytest.mark.parametrize("command", ["fit", "diagnose", "predict", "simulate"])
@pytest.mark.parametrize("column", ["top_1", "platen_top"])
def test_words_where_the_press_takes_numbers_are_refused_by_row(command, column, folder, tmp_path, capsys):
    """A column of words alone is one that may stand beside; where the press names it, it is not left out."""
    lines = next(iter(sorted(folder.glob("*.csv")))).read_text().splitlines()
    begin = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    place = lines[begin].split(",").index(column)
    rows = [line.split(",") for line in lines[begin + 1 :]]
    lines[begin + 1 :] = [",".join([*cells[:place], "off", *cells[place + 1 :]]) for cells in rows]
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    out = ["--out", str(tmp_path / "out.csv")] if command in ("predict", "simulate") else []
    assert main([command, str(tmp_path / "run.csv"), "--press", str(folder / "press.toml"), *out]) == 2
    assert f"row 1: column {column}: 'off' is not a number" in _error(capsys)
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--program", "platen_temperature_C=nan"], "must lie between 0 and 10000 °C"),
        (["--program", "pressure_N_cm2=-3"], "must lie between 0 and 10000 N/cm²"),
        (["--program", "speed=3"], "KEY one of platen_temperature_C"),
        (["--program", "press_time_s=20", "--program", "press_time_s=30"], "press_time_s is given twice"),
        (["--program", "press_time_s=20"], "--program: one run cannot show what press_time_s does"),
        (["--svg", ""], "--svg = '': the folder's name is empty"),
        (["--shared", "h_x"], "--shared h_x: must be one of h_p_o"),
        (["--method", "annealing"], "--method annealing: must be one of default"),
        (["--averages"], "--averages goes with one of the paper's methods"),
    ],
)
def test_wrong_option_is_refused_in_one_line_before_any_work(folder, more, says, capsys):
    run = str(next(iter(sorted(folder.glob("*.csv")))))
    assert main(["fit", run, "--press", str(folder / "press.toml"), *more]) == 2
    assert says in _error(capsys)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--press", "press.toml"], "does not take --press"),
        (["run.csv", "--model", "m.json"], "does not take RUN, --model"),
        (["--method", "nelder_mead", "--program", "press_time_s=20"], "does not take --method, --program"),
    ],
)
def test_reproduction_refuses_what_it_would_ignore(more, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["fit", "--reproduce-paper", *more]) == 2
    assert says in _error(capsys)
    assert list(tmp_path.iterdir()) == []


def test_reproduction_keeps_its_table_and_the_cost_along_a_coefficient(tmp_path, monkeypatch, capsys):
    from softsensor.fitting.paper import virtual_runs as paper_campaign

    monkeypatch.setattr(paper_campaign.reproduce_paper, "__defaults__", (1,))
    out = [
        "--json",
        str(tmp_path / "p.json"),
        "--html",
        str(tmp_path / "p.html"),
        "--svg",
        str(tmp_path / "figures"),
    ]
    assert main(["fit", "--reproduce-paper", *out]) == 0
    table = capsys.readouterr().out
    assert "0 of 1" in table
    content = json.loads((tmp_path / "p.json").read_text())
    assert {(row["solver"], row["slopes"]) for row in content["table"]} == {
        (solver, slopes)
        for solver in ("adaptive", "exact")
        for slopes in ("finite differences", "exact sensitivities")
    }
    cost = content["cost_along"]
    assert len(cost["relative"]) == len(cost["adaptive"]) == len(cost["exact"])
    assert cost["slope_changes"]["adaptive"] > 10
    assert "<svg" in (tmp_path / "p.html").read_text()
    assert "<svg" in (tmp_path / "figures" / "cost.svg").read_text()


def test_folder_for_figures_that_is_a_file_is_refused(folder, capsys, tmp_path):
    wrong = tmp_path / "file"
    wrong.write_text("x")
    run = str(next(iter(sorted(folder.glob("*.csv")))))
    assert main(["fit", run, "--press", str(folder / "press.toml"), "--svg", str(wrong)]) == 2
    assert f"{wrong}: is a file" in _error(capsys)
    assert Path(wrong).read_text() == "x"


def test_what_is_remarked_on_several_runs_takes_one_line():
    def unknown(name, factor):
        return say(
            "fit-coefficient-unknown", name=name, verdict="unknown", reason=f"known to a factor of {factor}"
        )

    runs = [SimpleNamespace(run=f"r{i}", warnings=[unknown("h_ap", i), unknown("h_p_o", i)]) for i in range(1, 11)]
    runs[2].warnings.append(say("fit-not-converged"))
    first, second, third, kept = remark_lines(runs)
    assert first.startswith("10 of 10 runs, such as r1: h_ap")
    assert second.startswith("10 of 10 runs, such as r1: h_p_o")
    assert third.startswith("r3: ")
    assert "--json" in kept
    assert next(iter(remark_lines(runs[2:3]))).startswith("r3: h_ap")
