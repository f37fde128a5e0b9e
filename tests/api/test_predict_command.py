"""`kerntemp predict`: causal, whatever comes later in the file."""

import json

import pytest

import softsensor
from api.cli import main
from daq.simulated.campaign import Plan, make_campaign, write_campaign

PLAN = Plan(
    rate_hz=1.0, thickness_mm=16.0, closed_column=False, press_time_s=(30.0, 40.0), open_after_s=(20.0, 25.0)
)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    campaign = make_campaign(81, 1, "vapour_convection", PLAN)
    (path,) = write_campaign(folder, campaign)
    return folder, path


def predicted(folder, path):
    out = folder / f"{path.stem}.out.csv"
    assert main(["predict", str(path), "--press", str(folder / "press.toml"), "--out", str(out)]) == 0
    return out.read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_a_run_file_cut_off_at_a_scan_gives_the_same_rows_up_to_it(files, share):
    folder, path = files
    whole = predicted(folder, path)
    lines = path.read_text(encoding="utf-8").splitlines()
    first = next(i for i, line in enumerate(lines) if not line.startswith("#")) + 1
    rows = round(share * (len(lines) - first))
    cut = folder / f"cut-{rows}.csv"
    cut.write_text("\n".join(lines[: first + rows]) + "\n", encoding="utf-8")
    assert predicted(folder, cut) == whole[: rows + 1]
    assert len(whole) == len(lines) - first + 1


def test_a_model_with_a_coefficient_the_press_does_not_have_is_refused(files, capsys):
    folder, path = files
    model, out = folder / "model.json", folder / "never.csv"
    model.write_text(json.dumps({"coefficients": {"h_zz": {"value": 100.0, "sd": 10.0}}}), encoding="utf-8")
    words = ["predict", str(path), "--press", str(folder / "press.toml"), "--model", str(model), "--out", str(out)]
    assert main(words) == 2
    assert "model.json: h_zz: press 'lab' has no such coefficient" in capsys.readouterr().err
    assert not out.exists()


def test_a_model_of_another_press_is_warned_of(files, capsys):
    folder, path = files
    model, out = folder / "other.json", folder / "other.csv"
    for press, warned in (("lab", False), ("", False), ("hall-2", True)):
        content = {"press": press, "coefficients": {"h_p_c": {"value": 1200.0, "sd": 100.0}}}
        model.write_text(json.dumps(content), encoding="utf-8")
        words = ["predict", str(path), "--press", str(folder / "press.toml"), "--model", str(model)]
        assert main([*words, "--out", str(out)]) == 0
        assert ("is of press 'hall-2', the press file is of 'lab'" in capsys.readouterr().err) is warned


RESIN = """
[resin]
name = "own"
source = "own DSC"
[order]
rate_per_s = 0.05
rate_per_s.sd = 0.005
activation_energy_kJ_mol = 85.0
[limits]
cure_least = 0.5
"""


def test_a_resin_adds_cure_steam_and_leave_to_open(files, capsys):
    folder, path = files
    resin, out = folder / "resin.toml", folder / "cured.csv"
    words = ["predict", str(path), "--press", str(folder / "press.toml"), "--resin", str(resin), "--out", str(out)]
    resin.write_text(RESIN, encoding="utf-8")
    assert main(words) == 0
    first, *rows = out.read_text(encoding="utf-8").splitlines()
    names = first.split(",")
    assert names[8:] == ["cure_top", "cure_bottom", "cure_low", "steam_kPa", "steam_high_kPa", "open_now"]
    assert [row.rsplit(",", 6)[0] for row in rows] == predicted(folder, path)[1:]
    table = [dict(zip(names, row.split(","), strict=True)) for row in rows]
    leave = [row["open_now"] for row in table]
    assert set(leave) == {"0", "1"}
    for row in table:
        assert row["open_now"] == "0" or (row["state"], row["valid"]) == ("closed", "1")
        assert row["open_now"] == "0" or float(row["cure_low"]) >= 0.5
    capsys.readouterr()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("cure_least = 0.5", "cure_least = 50"), "resin.toml: limits.cure_least = 50"),
        (("cure_least = 0.5", "cure_lest = 0.5"), "did you mean cure_least?"),
        (("rate_per_s = 0.05", "rate_per_s = -1"), "order.rate_per_s = -1"),
    ],
)
def test_a_resin_that_cannot_be_is_refused_and_nothing_is_written(files, capsys, change, expected):
    folder, path = files
    resin, out = folder / "resin.toml", folder / "never.csv"
    resin.write_text(RESIN.replace(*change), encoding="utf-8")
    words = ["predict", str(path), "--press", str(folder / "press.toml"), "--resin", str(resin), "--out", str(out)]
    assert main(words) == 2
    assert expected in capsys.readouterr().err
    assert not out.exists()


def test_an_example_resin_and_missing_limits_are_told(files, capsys):
    folder, path = files
    resin, out = folder / "example.toml", folder / "example.csv"
    text = RESIN.replace('source = "own DSC"', 'source = "own DSC"\nexample = true').partition("[limits]")[0]
    resin.write_text(text, encoding="utf-8")
    words = ["predict", str(path), "--press", str(folder / "press.toml"), "--resin", str(resin), "--out", str(out)]
    assert main(words) == 0
    output = capsys.readouterr().err
    assert "is an example" in output
    assert "has no limit" in output
    assert all(row.endswith(",0") for row in out.read_text(encoding="utf-8").splitlines()[1:])


def test_a_model_file_with_some_coefficients_takes_the_others_from_the_press_file(files):
    folder, path = files
    some, model = folder / "some.json", folder / "some-model.json"
    some.write_text('{"h_pp_c": 300.0}', encoding="utf-8")
    content = {"version": "1", "press": "", "coefficients": {"h_pp_c": {"value": 300.0, "sd": 30.0}}}
    model.write_text(json.dumps(content | {"effects": [], "covariance": None}), encoding="utf-8")
    written = []
    for option, given in (("--coefficients", some), ("--model", model)):
        out = folder / f"simulated{option}.csv"
        call = [
            "simulate",
            str(path),
            "--press",
            str(folder / "press.toml"),
            option,
            str(given),
            "--out",
            str(out),
        ]
        assert main(call) == 0
        written.append(out.read_text(encoding="utf-8"))
    assert written[0] == written[1]
    assert (
        softsensor.simulate(path, folder / "press.toml", model)
        .frame()
        .equals(softsensor.simulate(path, folder / "press.toml", {"h_pp_c": 300.0}).frame())
    )


def test_a_dash_sends_the_file_to_standard_output_and_nothing_else(files, capsys, monkeypatch, tmp_path):
    folder, path = files
    monkeypatch.chdir(tmp_path)
    press = str(folder / "press.toml")
    table = "\n".join(predicted(folder, path)) + "\n"
    capsys.readouterr()
    assert main(["predict", str(path), "--press", press, "--out", "-"]) == 0
    assert capsys.readouterr().out == table
    assert main(["fit", str(path), "--press", press, "--json", "-"]) == 0
    output = capsys.readouterr()
    assert json.loads(output.out)["runs"][0]["run"] == path.stem
    assert "h_pp_c" in output.err
    assert list(tmp_path.iterdir()) == []
