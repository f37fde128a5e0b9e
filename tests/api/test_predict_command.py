"""`kerntemp predict`: causal, whatever comes later in the file."""

import json

import pytest

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
