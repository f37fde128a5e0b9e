import json
import os
import re
import socket
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from api.cli import main
from api.commands.inputs import find_run
from api.commands.simulating import table_text
from api.http.tokens import TokenFile
from api.outputs import write_all
from daq.files.run_file import read_run, write_run
from daq.records import Run
from daq.shared import shared_files
from daq.simulated.campaign_pressfile import press_toml
from daq.store import open_store

SHARED = shared_files()


@pytest.fixture(scope="module")
def files(tmp_path_factory, campaign):
    folder = tmp_path_factory.mktemp("runs")
    for run, _ in campaign:
        write_run(run, folder / f"{run.name}.csv")
    (folder / "press.toml").write_text(press_toml())
    return folder


@pytest.fixture
def first(files, campaign):
    return str(files / f"{campaign[0][0].name}.csv")


def config_of_lab(folder):
    """Write a configuration of one press into a folder and return where."""
    (folder / "press.toml").write_text(press_toml(), encoding="utf-8")
    path = folder / "kerntemp.toml"
    path.write_text(
        '[[press]]\nname = "lab"\nfile = "press.toml"\n[[press.logger]]\nname = "x"\nprofile = "labjack-t7"\n'
        'host = "127.0.0.1"\nchannels = ["platen_top", "platen_bottom"]\n',
        encoding="utf-8",
    )
    return path


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    lines = captured.err.splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("kerntemp: ")
    return lines[0]


def test_help_loads_nothing_that_takes_longer_than_the_help_itself():
    heavy = {"numba", "matplotlib", "scipy", "sqlalchemy", "pandas", "pydantic", "numpy"}
    script = f"import sys, api.cli; sys.exit(bool({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


def test_recorder_and_sensor_start_without_what_takes_half_of_their_start():
    script = """
import sys, daq.recording.recorder, softsensor.jobs.live_service
sys.exit(bool({'scipy.signal', 'scipy.special', 'scipy.stats', 'matplotlib', 'pandas'} & set(sys.modules)))
"""
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


def test_fit_of_a_run_loads_nothing_that_takes_long_and_that_it_can_do_without():
    script = f"""
import sys, api.cli
assert api.cli.main(["fit", "{SHARED}/samples/2026-03-04-01.csv", "--press", "{SHARED}/presses/lab.toml"]) == 0
print(set('scipy.optimize scipy.special scipy.ndimage matplotlib pandas'.split()) & set(sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"


def test_help_names_every_command_of_the_contract(capsys):
    assert main(["--help"]) == 0
    listed = capsys.readouterr().out
    for command in ("demo", "serve", "predict", "simulate", "import", "export", "check"):
        assert f"  {command} " in listed


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "no command given; kerntemp --help lists them"),
        (["nonsense"], "nonsense: no such command"),
        (["exporrt"], "exporrt: no such command; did you mean export?"),
        (["demo", "--spede", "2"], "--spede: no such option; near it are"),
        (["demo", "--speed"], "--speed: needs a value"),
        (["demo", "--speed", "900"], "--speed = '900': must be less than or equal to 200"),
        (["demo", "a", "b"], "too much in this call: a, b"),
        (["token", "make"], "create|revoke|list = 'make': must be one of create, revoke, list"),
        (["simulate"], "RUN: is missing"),
        (["simulate", "x.csv", "--press", "nope.toml", "--out", "o.csv"], "nope.toml: cannot read the press file"),
        (["serve", "--config", "nope.toml"], "nope.toml: no such configuration"),
        (["check", "--config", "nope.toml"], "nope.toml: no such configuration"),
        (["token", "create", "--config", "nope.toml"], "nope.toml: no such configuration"),
        (["demo", "--speed", "0"], "speed"),
        (["demo", "--hide", "gremlins"], "--hide: effect 'gremlins': unknown"),
        (["export", "--store", "nowhere.sqlite"], "does not exist"),
    ],
)
def test_a_wrong_call_or_input_is_one_line_and_exit_status_2(arguments, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert says in one_line(capsys)
    assert list(tmp_path.iterdir()) == []


def test_help_and_wrong_calls_speak_the_language_of_the_terminal(monkeypatch, capsys):
    monkeypatch.setenv("KERNTEMP_LANGUAGE", "de")
    assert main(["demo", "--help"]) == 0
    page = capsys.readouterr().out
    assert page.startswith("Aufruf: kerntemp demo")
    assert "Diese Seite zeigen." in page
    assert "[OPTIONEN]" in page
    assert "--data ORDNER" in page
    assert main(["demo", "--speed", "900"]) == 2
    assert one_line(capsys) == "kerntemp: --speed = '900': darf höchstens 200 sein"
    monkeypatch.setenv("KERNTEMP_LANGUAGE", "en")
    assert main(["demo", "--speed", "900"]) == 2
    assert "must be" in one_line(capsys)


@pytest.mark.skipif(os.name == "nt", reason="POSIX permissions")
def test_a_configuration_that_others_may_not_read_is_refused_with_what_to_do(capsys, tmp_path):
    config = tmp_path / "etc" / "kerntemp.toml"
    config.parent.mkdir()
    config.write_text("")
    config.parent.chmod(0)
    user = os.geteuid()
    os.seteuid(65534 if user == 0 else user)
    try:
        assert main(["check", "--config", str(config)]) == 2
    finally:
        os.seteuid(user)
        config.parent.chmod(0o700)
    assert "put sudo before the command" in one_line(capsys)


def test_simulate_writes_one_column_a_sensor_position_and_the_core(files, first, tmp_path, campaign):
    out = tmp_path / "simulated.csv"
    assert main(["simulate", first, "--press", str(files / "press.toml"), "--out", str(out)]) == 0
    lines = out.read_text().splitlines()
    assert lines[0] == "time_s,state,panel.top,panel.bottom,core_C"
    assert len(lines) == len(campaign[0][0].time_s) + 1


def test_simulate_with_the_true_coefficients_comes_close_to_the_virtual_press(files, tmp_path, campaign, first):
    _, truth = campaign[0]
    given, out = tmp_path / "true.json", tmp_path / "simulated.csv"
    given.write_text(json.dumps(dict(truth.coefficients)))
    options = ["--coefficients", str(given), "--press", str(files / "press.toml"), "--out", str(out)]
    assert main(["simulate", first, *options]) == 0
    core = np.genfromtxt(out, delimiter=",", skip_header=1, usecols=4)
    inside = np.isfinite(truth.core_C)
    assert np.sqrt(np.mean((core - truth.core_C)[inside] ** 2)) < 1.5


def test_no_cell_of_a_written_table_is_a_formula_to_a_spreadsheet():
    table = table_text({"=cmd.top": [1.0, float("nan")], "reason": ["+1, or so", "steady"]})
    assert table.splitlines() == ["'=cmd.top,reason", '1.0,"\'+1, or so"', ",steady"]


def test_a_panel_that_nothing_describes_is_one_line(files, first, tmp_path, capsys):
    text = Path(first).read_text().replace('panel.material = "MDF"', 'panel.material = "unobtainium"')
    run = tmp_path / "run.csv"
    run.write_text(re.sub(r"# panel\.(conductivity|heat).*\n", "", text))
    assert (
        main(["simulate", str(run), "--press", str(files / "press.toml"), "--out", str(tmp_path / "out.csv")]) == 2
    )
    assert "panel.conductivity_W_mK is missing and material 'unobtainium' is not in the table" in one_line(capsys)


def test_an_unknown_coefficient_is_named_and_nothing_is_written(files, first, tmp_path, capsys):
    given, out = tmp_path / "given.json", tmp_path / "out.csv"
    given.write_text('{"h_x": 5}')
    options = ["--coefficients", str(given), "--press", str(files / "press.toml"), "--out", str(out)]
    assert main(["simulate", first, *options]) == 2
    assert "h_x: press 'lab' has no such coefficient" in one_line(capsys)
    assert not out.exists()


def test_imported_runs_come_out_again_as_they_went_in(files, first, tmp_path, campaign, capsys):
    store = str(tmp_path / "kerntemp.sqlite")
    paths = [str(path) for path in sorted(files.glob("*.csv"))]
    assert main(["import", *paths, "--press", str(files / "press.toml"), "--store", store]) == 0
    assert main(["export", "--store", store]) == 0
    assert campaign[0][0].name in capsys.readouterr().out
    out = tmp_path / "out.parquet"
    assert main(["export", campaign[0][0].name, "--out", str(out), "--store", store]) == 0
    before, after = read_run(files / f"{campaign[0][0].name}.csv"), read_run(out)
    assert dict(after.header) == dict(before.header)
    for name, values in before.columns.items():
        np.testing.assert_array_equal(after.columns[name], values)


def test_several_runs_are_exported_into_a_folder_that_is_made(files, tmp_path, campaign, capsys):
    store, out = str(tmp_path / "kerntemp.sqlite"), tmp_path / "export"
    paths = [str(path) for path in sorted(files.glob("*.csv"))[:2]]
    assert main(["import", *paths, "--press", str(files / "press.toml"), "--store", store]) == 0
    names = [Path(path).stem for path in paths]
    assert main(["export", *names, "nobody", "--out", str(out), "--store", store]) == 2
    assert not out.exists()
    assert main(["export", *names, "--out", str(tmp_path / "no" / "x"), "--store", store]) == 2
    assert "several runs need a folder" in capsys.readouterr().err
    assert main(["export", *names, "--out", str(out), "--store", store]) == 0
    assert {p.name for p in out.iterdir()} == {f"{name}.csv" for name in names} | {"SHA256SUMS"}


def test_a_run_exported_anew_into_a_folder_with_sums_can_be_imported(files, first, tmp_path):
    store, out = str(tmp_path / "kerntemp.sqlite"), tmp_path / "export"
    press = ["--press", str(files / "press.toml"), "--store"]
    assert main(["import", first, *press, store]) == 0
    out.mkdir()
    name = Path(first).stem
    assert main(["export", name, "--out", str(out), "--store", store]) == 0
    with open_store(store) as opened:
        opened.annotate_run(name, {"remark": "edge chipped"}, "anna")
    assert main(["export", name, "--out", str(out / f"{name}.csv"), "--store", store]) == 0
    assert main(["import", str(out / f"{name}.csv"), *press, str(tmp_path / "other.sqlite")]) == 0
    with open_store(str(tmp_path / "other.sqlite")) as opened:
        assert opened.run_record(name).remark == "edge chipped"


def test_event_documents_of_a_stored_run_carry_units_and_how_it_ended(tmp_path):
    url, columns = str(tmp_path / "s.sqlite"), {"top_1": np.ones(3), "position_mm": np.ones(3)}
    with open_store(url) as opened:
        for name, life in (("cut", "interrupted"), ("whole", "closed"), ("live", "open")):
            opened.import_run(Run(name, {"recorded.status": life}, np.arange(3.0), columns), "lab")
        with opened.database.writing() as connection:
            connection.exec_driver_sql("UPDATE run SET status = 'open' WHERE run = 'live'")
    last = {}
    for name in ("cut", "whole", "live"):
        assert main(["export", name, "--out", str(tmp_path / f"{name}.jsonl"), "--store", url]) == 0
        documents = [json.loads(line) for line in (tmp_path / f"{name}.jsonl").read_text().splitlines()]
        last[name] = (documents[-1][0], documents[-1][1].get("exit_status"))
        assert {k: v.get("units") for k, v in documents[1][1]["data_keys"].items()} == {
            "top_1": "C",
            "position_mm": None,
        }
    assert last == {"cut": ("stop", "abort"), "whole": ("stop", "success"), "live": ("event", None)}


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("panel.thickness_mm = -16.0", "header key panel.thickness_mm = -16.0: must be a number from"),
        ('panel.density_kg_m3 = "dense"', "header key panel.density_kg_m3 = 'dense': must be a number from"),
        ("layer.nowhere.thickness_mm = 3.0", "header key layer.nowhere.thickness_mm: the press file has no such"),
        ('run = "../../run"', "header key run = '../../run': must be a name"),
    ],
)
def test_a_header_that_cannot_be_stops_the_whole_import(files, first, tmp_path, capsys, key, says):
    name = key.partition(" ")[0]
    lines = [line for line in Path(first).read_text().splitlines() if not line.startswith(f"# {name} ")]
    wrong = tmp_path / "wrong.csv"
    wrong.write_text("\n".join([f"# {key}", *lines]) + "\n")
    store = str(tmp_path / "kerntemp.sqlite")
    assert main(["import", first, str(wrong), "--press", str(files / "press.toml"), "--store", store]) == 2
    assert f"wrong.csv: {says}" in one_line(capsys)
    if Path(store).exists():
        with open_store(store) as opened:
            assert not opened.runs().items


def test_what_is_doubtful_in_the_headers_of_imported_runs_is_said_once_and_kept(files, tmp_path, capsys):
    paths = []
    for path in sorted(files.glob("*.csv"))[:2]:
        (tmp_path / path.name).write_text('# panel.supplier = "north"\n' + path.read_text())
        paths.append(str(tmp_path / path.name))
    store = str(tmp_path / "kerntemp.sqlite")
    assert main(["import", *paths, "--press", str(files / "press.toml"), "--store", store]) == 0
    assert capsys.readouterr().err.count("panel.supplier is not known; it is kept") == 1
    assert find_run(Path(paths[0]).stem, store, None).header["panel.supplier"] == "north"


@pytest.mark.parametrize(("value", "is_temperature"), [("1e308", False), ("-9999", False), ("1100", True)])
def test_a_reading_that_is_no_temperature_stops_the_import(files, first, tmp_path, capsys, value, is_temperature):
    lines = Path(first).read_text().splitlines()
    header = next(i for i, line in enumerate(lines) if line.startswith("time_s"))
    cells = lines[header + 3].split(",")
    cells[lines[header].split(",").index("top_2")] = value
    lines[header + 3] = ",".join(cells)
    wrong, store = tmp_path / "wrong.csv", str(tmp_path / "kerntemp.sqlite")
    wrong.write_text("\n".join(lines) + "\n")
    done = main(["import", str(wrong), "--press", str(files / "press.toml"), "--store", store])
    assert done == (0 if is_temperature else 2)
    if not is_temperature:
        output = one_line(capsys)
        assert (
            f"wrong.csv: line {header + 4}: column top_2: {float(value):g} is no temperature; must lie" in output
        )


def test_a_run_that_is_stored_already_stops_the_whole_import(files, first, tmp_path, capsys):
    store = str(tmp_path / "kerntemp.sqlite")
    press = ["--press", str(files / "press.toml"), "--store", store]
    assert main(["import", first, *press]) == 0
    capsys.readouterr()
    paths = [str(path) for path in sorted(files.glob("*.csv"))]
    doubtful = tmp_path / "doubtful.csv"  # nothing is said of what nothing was done with
    doubtful.write_text('# run = "another"\n# shift = 2\n' + Path(first).read_text().split("\n", 1)[1])
    assert main(["import", *paths, str(doubtful), *press]) == 2
    assert f"{first}: run " in (line := one_line(capsys))
    assert "is in the store already" in line
    assert main(["export", "--store", store]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1 + 1  # heads, and the run


def test_simulate_takes_a_run_by_its_id_in_the_store(files, first, tmp_path, campaign):
    store, out = str(tmp_path / "kerntemp.sqlite"), tmp_path / "out.csv"
    press = ["--press", str(files / "press.toml"), "--store", store]
    assert main(["import", first, *press]) == 0
    assert main(["simulate", campaign[0][0].name, *press, "--out", str(out)]) == 0
    assert out.exists()


def test_without_a_store_named_runs_go_to_the_default_one_and_come_back_from_it(
    files, first, tmp_path, campaign, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(["export"]) == 2
    assert "give --store or --config" in one_line(capsys)
    assert main(["import", first, "--press", str(files / "press.toml")]) == 0
    assert (tmp_path / "kerntemp-data" / "kerntemp.sqlite").exists()
    assert main(["export", campaign[0][0].name, "--out", "back.csv"]) == 0
    assert (tmp_path / "back.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["fit", "RUN", "--press", "PRESS", "--json", "RUN"], "is read by this command"),
        (["fit", "RUN", "--press", "PRESS", "--model", "PRESS"], "is read by this command"),
        (["fit", "RUN", "--press", "PRESS", "--json", "x", "--html", "./x"], "is given for two outputs"),
        (["fit", "RUN", "--press", "PRESS", "--html", "LINK"], "is read by this command"),
        (
            ["fit", "RUN", "--press", "PRESS", "--html", "f/coefficients.svg", "--svg", "f"],
            "lies among the figures",
        ),
        (["fit", "--reproduce-paper", "--json", "x", "--html", "x"], "is given for two outputs"),
        (["diagnose", "RUN", "--press", "PRESS", "--html", "x", "--model", "x"], "is given for two outputs"),
        (["diagnose", "RUN", "--press", "PRESS", "--json", "RUN"], "is read by this command"),
        (["simulate", "RUN", "--press", "PRESS", "--out", "RUN"], "is read by this command"),
        (["simulate", "RUN", "--press", "PRESS", "--model", "M", "--out", "M"], "is read by this command"),
        (["predict", "RUN", "--press", "PRESS", "--out", "PRESS"], "is read by this command"),
        (["predict", "RUN", "--press", "PRESS", "--model", "M", "--out", "M"], "is read by this command"),
    ],
)
def test_an_output_that_would_overwrite_an_input_or_another_output_is_refused(
    arguments, says, files, first, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "f").mkdir()
    given = {"RUN": tmp_path / "a.csv", "PRESS": tmp_path / "p.toml", "M": tmp_path / "m.json"}
    given["RUN"].write_bytes(Path(first).read_bytes())
    given["PRESS"].write_bytes((files / "press.toml").read_bytes())
    given["M"].write_text('{"coefficients": {}}')
    given["LINK"] = tmp_path / "link"
    given["LINK"].symlink_to(given["RUN"])
    before = {path: path.read_bytes() for path in given.values()}
    assert main([str(given.get(a, a)) for a in arguments]) == 2
    assert says in one_line(capsys)
    assert {path: path.read_bytes() for path in given.values()} == before
    assert {p.name for p in tmp_path.iterdir()} == {*(p.name for p in given.values()), "f"}


def test_a_run_of_which_nothing_is_left_is_not_diagnosed(files, first, capsys):
    assert main(["diagnose", first, "--press", str(files / "press.toml"), "--until", "-50"]) == 2
    assert "--until -50 leaves 0 of" in one_line(capsys)


def test_export_does_not_overwrite_the_store_it_reads(files, first, tmp_path, capsys):
    store = tmp_path / "kept.csv"
    assert main(["import", first, "--press", str(files / "press.toml"), "--store", str(store)]) == 0
    held = store.read_bytes()
    capsys.readouterr()
    assert main(["export", Path(first).stem, "--out", str(store), "--store", str(store)]) == 2
    assert "is read by this command" in one_line(capsys)
    assert store.read_bytes() == held


def test_simulate_tells_of_a_load_column_the_run_lacks(files, first, tmp_path, capsys):
    text = (files / "press.toml").read_text()
    press, out = tmp_path / "press.toml", tmp_path / "out.csv"
    press.write_text(text.replace('closed = "h_p_c"', 'closed = "h_p_c"\nload = { column = "kN" }', 1))
    assert main(["simulate", first, "--press", str(press), "--out", str(out)]) == 0
    assert "load column 'kN' is missing" in one_line(capsys)
    assert out.exists()


def _core(arguments, folder):
    out = folder / "out.csv"
    assert main(["simulate", *arguments, "--out", str(out)]) == 0
    return np.genfromtxt(out, delimiter=",", skip_header=1)[:, -1]


def _with_header(first, folder, *lines):
    own = folder / "own.csv"
    own.write_text("".join(f"# {line}\n" for line in lines) + Path(first).read_text())
    return str(own)


def test_simulate_takes_a_coefficient_from_the_runs_header(files, first, tmp_path):
    press, given = ["--press", str(files / "press.toml")], tmp_path / "given.json"
    plain = _core([first, *press], tmp_path)
    own = _core([_with_header(first, tmp_path, "coefficients.h_pp_c.guess = 100.0"), *press], tmp_path)
    assert np.abs(own - plain).max() > 1.0
    lines = 'contact.2.closed = "h_new"', "coefficients.h_new.guess = 100.0"
    new = _core([_with_header(first, tmp_path, *lines), *press], tmp_path)
    assert np.abs(new - plain).max() > 0.3
    assert np.abs(new - own).max() > 0.3
    given.write_text('{"h_new": 300.0}')
    assert (
        np.abs(_core([str(tmp_path / "own.csv"), *press, "--coefficients", str(given)], tmp_path) - new).max()
        > 0.1
    )


def test_simulate_takes_another_kind_of_end_from_the_runs_header(files, first, tmp_path):
    press = ["--press", str(files / "press.toml")]
    plain = _core([first, *press], tmp_path)
    air = 'boundary.top.kind = "air"', 'boundary.top.coefficient = "h_air"', "coefficients.h_air.guess = 15.0"
    assert np.nanmax(_core([_with_header(first, tmp_path, *air), *press], tmp_path)) < np.nanmax(plain) - 3.0


def test_the_language_of_the_terminal_is_chosen_by_its_name(capsys, monkeypatch):
    monkeypatch.setenv("KERNTEMP_LANGUAGE", "de")
    assert main(["probe"]) == 2
    assert capsys.readouterr().err == "kerntemp: probe: entweder --port oder --host angeben\n"
    monkeypatch.setenv("KERNTEMP_LANGUAGE", "tlh")
    assert main(["probe"]) == 2
    assert capsys.readouterr().err == "kerntemp: KERNTEMP_LANGUAGE = tlh is not available; choose one of en, de\n"


@pytest.mark.parametrize(("language", "why"), [("en", "runs and is reachable"), ("de", "Datenbankserver läuft")])
def test_a_server_that_does_not_answer_is_named_in_words_and_not_as_a_fault_of_the_program(
    capsys, monkeypatch, language, why
):
    monkeypatch.setenv("KERNTEMP_LANGUAGE", language)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # nobody listens there
        url = f"postgresql://somebody:secret@127.0.0.1:{taken.getsockname()[1]}/x"
        assert main(["export", "--store", url]) == 1
    output = one_line(capsys)
    assert why in output
    assert not {"StoreUnavailable", "KERNTEMP_TRACEBACK", "secret"} & set(re.split(r"\W+", output))


def test_a_command_says_which_files_it_wrote(files, first, tmp_path, capsys):
    out = tmp_path / "simulated.csv"
    assert main(["simulate", first, "--press", str(files / "press.toml"), "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"written: {out}\n"


def test_many_files_of_a_folder_are_counted(tmp_path, capsys):
    write_all({tmp_path / f"{i}.svg": "<svg/>" for i in range(9)})
    assert capsys.readouterr().out == f"written: 9 files in {tmp_path}\n"


def test_temperatures_are_written_to_a_thousandth_and_times_as_they_are():
    text = table_text(
        {"time_s": [0.123456], "core_C": [101.23456789], "panel.top": [99.99999], "cure_low": [0.12345]}
    )
    assert text == "time_s,core_C,panel.top,cure_low\n0.123456,101.235,100.0,0.12345\n"


def test_stored_runs_are_listed_under_heads_and_chosen_by_press_material_and_day(store_of_two, capsys):
    def listed(*options):
        assert main(["export", "--store", store_of_two, *options]) == 0
        heads, *rows = [line.split("\t") for line in capsys.readouterr().out.splitlines()]
        assert heads == ["run", "started", "status", "press", "material"]
        return [row[0] for row in rows]

    assert listed() == ["second", "first"]
    assert listed("--material", "MDF") == ["first"]
    assert main(["export", "--store", store_of_two, "--press", "elsewhere"]) == 2
    assert "there is no press 'elsewhere'; there are: lab" in one_line(capsys)
    assert listed("--from", "2026-03-05") == ["second"]
    assert listed("--to", "2026-03-05") == ["first"]
    assert main(["export", "first", "--out", "x.csv", "--material", "MDF", "--store", store_of_two]) == 2
    assert "choose what is listed" in capsys.readouterr().err


NO_DAYS = ["nope", "04.03.2026", "2026-13-01", "2026-02-30", "2026-03-04 25:00", "20260304", "2026", "", "-1"]
NO_DAYS += ["2026-03-04T07:00:00+01:00"]


@pytest.mark.parametrize(
    ("language", "says"),
    [
        ("en", "must be a day, year-month-day, such as 2026-03-04"),
        ("de", "muss ein Tag sein, Jahr-Monat-Tag, etwa 2026-03-04"),
    ],
)
@pytest.mark.parametrize("option", ["--from", "--to"])
@pytest.mark.parametrize("given", NO_DAYS)
def test_a_day_that_is_none_is_refused_in_our_own_words(capsys, monkeypatch, option, given, language, says):
    monkeypatch.setenv("KERNTEMP_LANGUAGE", language)
    assert main(["export", option, given]) == 2
    assert one_line(capsys) == f"kerntemp: {option} = '{given}': {says}"


def test_a_material_that_no_run_has_is_refused_with_those_there_are_the_nearest_first(store_of_two, capsys):
    assert main(["export", "--store", store_of_two, "--material", "pin"]) == 2
    says = "--material = 'pin': no run has it; the runs have pine, MDF"
    assert one_line(capsys) == f"kerntemp: {says}"
    assert main(["export", "--store", store_of_two, "--material", "pine", "--to", "2026-03-05"]) == 0


def test_a_press_that_is_not_there_is_not_rolled_back_and_that_is_said_before_long_work(tmp_path):
    """What a nightly job needs takes seconds to load."""
    config = config_of_lab(tmp_path)
    script = f"""
import sys
from api.cli import main
code = main(["refit", "--config", {str(config)!r}, "--roll-back", "nope"])
sys.exit(10 * code + bool({{"numba", "scipy", "softsensor.jobs.night"}} & set(sys.modules)))
"""
    called = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert called.returncode == 20, called.stderr
    assert "'nope'" in called.stderr


@pytest.fixture
def store_of_two(tmp_path, campaign):
    """A store with two pressings, of two materials, on two days."""
    path = str(tmp_path / "kerntemp.sqlite")
    with open_store(path) as store:
        for day, name, material in ((4, "first", "MDF"), (5, "second", "pine")):
            began = {"panel.material": material, "recorded.started_utc": datetime(2026, 3, day, 12, tzinfo=UTC)}
            run = replace(campaign[0][0], name=name)
            store.import_run(replace(run, header={**run.header, **began}), "lab", press_toml())
    return path


@pytest.fixture
def shell_asks(monkeypatch, capsys):
    """Ask as a shell does that completes, by variables; returns what it is answered."""

    def ask(asked):
        with monkeypatch.context() as shell:
            for name, value in asked.items():
                shell.setenv(name, value)
            with pytest.raises(SystemExit):
                main([])
        return capsys.readouterr().out

    return ask


def test_the_shell_completes_commands_and_options(tmp_path, shell_asks):
    def asked(words):
        return {"_KERNTEMP_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}

    def completed(words):
        return set(shell_asks(asked(words)).split())

    command = [sys.executable, "-m", "api"]
    found = subprocess.run(
        command, env=os.environ | asked("kerntemp dia"), capture_output=True, text=True, check=False
    )
    assert found.stdout.split() == ["diagnose"]
    assert completed("kerntemp dia") == {"diagnose"}
    assert {"--rehearse", "--rehearse-effect"} <= completed("kerntemp diagnose --reh")
    store = tmp_path / "some.sqlite"
    with open_store(str(store), create=True) as opened:
        at = np.arange(3.0)
        opened.import_runs(
            [Run(name, {}, at, {"top_1": at}, "", {}) for name in ("oak-1", "oak-2", "ash-1")], "lab"
        )
    for command in ("export", "fit", "diagnose", "predict"):
        assert completed(f"kerntemp {command} --store {store} oak") == {"oak-1", "oak-2"}
    assert completed(f"kerntemp fit --store {tmp_path / 'none.sqlite'} oak") == set()
    assert completed(f"kerntemp export --store {store} --press la") == {"lab"}
    config = config_of_lab(tmp_path)
    assert completed(f"kerntemp refit --config {config} --roll-back l") == {"lab"}
    for token in ("mes", "mail", "wall"):
        TokenFile(tmp_path / "kerntemp-tokens.json").create(token, "read")
    assert completed(f"kerntemp token --config {config} revoke m") == {"mes", "mail"}
    assert completed(f"kerntemp token --config {config} create m") == set()
    assert completed("kerntemp fit --method nelder_mead_") == {"nelder_mead_then_least_squares"}
    assert completed("kerntemp demo --hide paper") == {"paper_layer"}
    assert completed("kerntemp diagnose --rehearse-effect paper") == {"paper_layer"}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_what_a_shell_needs_to_complete_is_printed(shell, capsys):
    assert main(["--completion", shell]) == 0
    assert "_KERNTEMP_COMPLETE=complete_" + shell in capsys.readouterr().out


@pytest.mark.parametrize("shell", ["zsh", "fish"])
@pytest.mark.parametrize(
    ("language", "call", "expected"),
    [
        ("en", "kerntemp demo --sp", "Times real speed, 0.1 to 200."),
        ("de", "kerntemp demo --sp", "Vielfaches der wirklichen Geschwindigkeit"),
        ("en", "kerntemp pub", "Feed an MQTT broker ([mqtt])"),
        ("de", "kerntemp fit --", "Diese Seite zeigen."),
    ],
)
def test_the_shell_is_told_what_a_completion_means(shell, language, call, expected, shell_asks):
    asked = {
        "_KERNTEMP_COMPLETE": f"complete_{shell}",
        "_TYPER_COMPLETE_ARGS": call,
        "KERNTEMP_LANGUAGE": language,
    }
    output = shell_asks(asked | {"_TYPER_COMPLETE_FISH_ACTION": "get-args", "COLUMNS": "80"})
    assert expected in output
    assert "help-" not in output
    assert "broker ()" not in output


def test_an_effect_that_does_not_exist_is_refused_before_anything_is_diagnosed(files, first, capsys, monkeypatch):
    monkeypatch.setattr("softsensor.diagnosis.verdict.diagnose", lambda *_, **__: pytest.fail("diagnosed first"))
    call = ["diagnose", first, "--press", str(files / "press.toml"), "--rehearse", "--rehearse-effect", "nonsense"]
    assert main(call) == 2
    assert "effect 'nonsense' is not in the catalogue" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="no terminal pairs there")
def test_a_terminal_sees_that_many_runs_are_being_read(tmp_path):
    import pty

    time_s = np.arange(3.0)
    panel = {"panel.material": "MDF", "panel.thickness_mm": 16.0, "panel.initial_temperature_C": 20.0}
    for number in range(3):
        write_run(
            Run(f"r{number}", panel, time_s, {"top_1": time_s + number}, "", {}), tmp_path / f"r{number}.csv"
        )
    slow = f"""
import time, daq, api.commands.inputs as inputs
from daq.press.press_file import read_press
read = inputs.find_run
inputs.find_run = lambda *given: (time.sleep(0.6), read(*given))[1]
press = read_press(daq.shared_files() / "presses/lab.toml")
inputs.load_runs([f"{tmp_path}/r{{k}}.csv" for k in range(3)], press, None, None)
"""
    ours, theirs = pty.openpty()
    running = subprocess.Popen([sys.executable, "-c", slow], stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    assert running.wait(240) == 0
    assert b"Reading 3 runs" in os.read(ours, 65536)
    os.close(ours)
