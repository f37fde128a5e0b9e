"""The steam that panels bear, learned from marks: against panels whose limits are known, being drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import softsensor
from api.cli import main
from daq.press.resin_file import LimitsTable, parse_resin
from daq.records import InputError
from softsensor.opening.blisters import LearnedLimit, believed_limit, learn_limit, limit_messages
from softsensor.opening.limits import STEAM, Normal, PanelState, broken

READ_SD = 0.12
"""Of ln steam as the live sensor has it."""


def panels(rng: np.random.Generator, count: int, bears_kPa: float, differ: float) -> tuple[Normal, np.ndarray]:
    """Return what is read of panels' steam, and whether they blistered; steam at opening from 30 to 150 kPa."""
    log_p = rng.uniform(np.log(30.0), np.log(150.0), count)
    blistered = log_p > np.log(bears_kPa) + differ * rng.standard_normal(count)
    return Normal(log_p + READ_SD * rng.standard_normal(count), np.full(count, READ_SD)), blistered


def test_the_limit_lies_in_its_interval_as_often_as_that_says() -> None:
    held, truth = [], np.random.default_rng(22)
    for _ in range(60):
        bears, differ = (
            100.0 * np.exp(0.35 * truth.standard_normal()),
            0.15 * np.exp(0.5 * truth.standard_normal()),
        )
        low, high = learn_limit(*panels(truth, 25, bears, differ)).ci95_kPa
        held.append(low <= bears <= high)
    assert 0.88 <= np.mean(held) <= 1.0  # 95 % less two and a half standard errors of 60


def test_later_panels_blister_as_often_as_is_said_once_thirty_were_marked() -> None:
    """Where panels bear 70 kPa and 100 were stated: chance against what became of 500 later ones."""
    rng = np.random.default_rng(7)
    stated, learned = learn_limit(*panels(rng, 0, 70.0, 0.15)), learn_limit(*panels(rng, 30, 70.0, 0.15))
    steam, blistered = panels(rng, 500, 70.0, 0.15)

    def brier(limit: LearnedLimit) -> float:
        return float(np.mean((limit.chance(steam) - blistered) ** 2))

    assert brier(learned) < 0.75 * brier(stated)
    bold, sure = (float(blistered[limit.chance(steam) < 0.025].mean()) for limit in (stated, learned))
    assert sure <= 0.04
    assert bold <= 0.04  # unsure of what was stated, it was careful
    assert learned.sd_kPa < 0.7 * stated.sd_kPa


def test_each_panel_is_foreseen_by_those_before_it_alone() -> None:
    """Panels bear 70 kPa, 100 were stated: the chance given to each, again from the ones marked before it."""
    steam, blistered = panels(np.random.default_rng(11), 30, 70.0, 0.15)
    given = []
    for k in range(1, 30):
        marked = Normal(steam.mean[:k], steam.sd[:k]), blistered[:k]
        chance = float(learn_limit(*marked).chance(Normal(steam.mean[k], steam.sd[k])))
        given.append(np.log(chance if blistered[k] else 1.0 - chance))
    found = learn_limit(steam, blistered)
    assert found.foreseen[0] == pytest.approx(np.exp(np.mean(given)), rel=1e-6)
    assert found.foreseen[0] > found.foreseen[1]


def test_panels_that_all_held_raise_what_is_believed_and_never_make_it_certain() -> None:
    all_good = learn_limit(Normal(np.log(np.linspace(60.0, 110.0, 30)), np.full(30, 0.1)), np.zeros(30, bool))
    assert all_good.most_kPa > 110.0
    assert all_good.ci95_kPa[1] > 180.0
    assert all_good.chance(Normal(np.log(150.0), np.array(0.1))) > 0.1


def test_what_is_not_known_of_steam_blisters_and_teaches_nothing() -> None:
    unknown = Normal(np.array([np.nan]), np.array([np.nan]))
    assert learn_limit(unknown, np.array([True])).marks == 0
    assert np.isnan(learn_limit(unknown, np.array([True])).foreseen).all()
    assert learn_limit(unknown, np.array([True])).chance(unknown) == pytest.approx(1.0)


def test_the_limits_deviation_in_the_resin_file_counts() -> None:
    """The learned limit as two numbers of the file gives the chance that the posterior gives."""
    found = learn_limit(*panels(np.random.default_rng(3), 40, 80.0, 0.15))
    written = LimitsTable.model_validate({"steam_most_kPa": found.most_kPa, "steam_most_kPa.sd": found.sd_kPa})
    unknown = Normal(np.array(np.nan), np.array(np.nan))
    for kPa in (50.0, 60.0, 80.0):
        steam = Normal(np.log(kPa), np.array(READ_SD))
        chances = broken(written, None, PanelState(unknown, unknown, unknown, steam)).chances[STEAM]
        assert float(chances) == pytest.approx(float(found.chance(steam)), abs=0.012)


SAMPLES = Path(__file__).parents[2] / "deploy"


def test_a_marked_run_teaches_from_its_file() -> None:
    """A sample panel that blistered lowers what is believed; one marked undercured says nothing of blisters."""
    press, resin = SAMPLES / "presses/lab.toml", SAMPLES / "resins/melamine_formaldehyde.toml"
    plain, blistered, undercured = (
        softsensor.read_run(SAMPLES / f"samples/2026-03-04-0{i}.csv", header={"panel.moisture_percent": 8.0} | own)
        for i, own in enumerate(({}, {"panel.verdict": "blister"}, {"panel.verdict": "undercured"}), 1)
    )
    found = softsensor.learn_steam_limit([plain, blistered, undercured], press, resin=resin)
    assert (found.marks, found.blistered) == (1, 1)
    assert found.most_kPa < 100.0
    with pytest.raises(InputError, match=r"none of 0 runs marked good or blister"):
        softsensor.learn_steam_limit([plain, undercured], press, resin=resin)


def test_what_is_learned_is_said_with_what_to_write_into_the_resin_file() -> None:
    log = np.log(np.repeat([60.0, 90.0], 10))
    found = learn_limit(Normal(log, np.full(20, 0.05)), np.repeat([False, True], 10))
    marks, bear, foreseen, write, keep = (str(line) for line in limit_messages(found))
    assert marks == "20 marked panels whose steam at opening is known, 10 blistered."
    content = found.as_json()
    low, high = content["ci95_kPa"]
    learned, stated = (100.0 * content["foreseen"][key] for key in ("learned", "stated"))
    assert f"a mean probability of {learned:.0f} %, by the stated limit {stated:.0f} %" in foreseen
    assert "steam_believed_kPa = 100, steam_believed_kPa.sd = 35" in keep
    assert f"withstand {content['steam_most_kPa']:.0f} kPa of steam (95 %: {low:.0f} to {high:.0f})" in bear
    assert (
        f"steam_most_kPa = {content['steam_most_kPa']:.0f}, steam_most_kPa.sd = {content['sd_kPa']:.0f}" in write
    )


@pytest.mark.parametrize("stated", ["", "steam_most_kPa = 60\nsteam_most_kPa.sd = 9\n"])
def test_marks_count_once_however_often_what_they_taught_was_written_into_the_resin_file(stated) -> None:
    file = (SAMPLES / "resins/melamine_formaldehyde.toml").read_text(encoding="utf-8")
    steam, blistered = panels(np.random.default_rng(5), 30, 80.0, 0.15)

    def learned(limits: str) -> LearnedLimit:
        return learn_limit(
            steam, blistered, *believed_limit(parse_resin(file.replace("[limits]\n", f"[limits]\n{limits}")))
        )

    first = learned(stated)
    write, keep = (str(line).split(": ")[1].replace(", ", "\n") for line in limit_messages(first)[-2:])
    second = learned(f"{write}\n{keep}\n")
    assert second.most_kPa == pytest.approx(first.most_kPa, rel=1e-6)
    assert second.ci95_kPa == pytest.approx(first.ci95_kPa, rel=1e-6)
    twice = learned(write + "\n")
    assert abs(twice.most_kPa - first.most_kPa) > 0.1  # so without the belief kept beside it


def test_the_command_refuses_runs_of_which_none_is_marked_and_writes_nothing(tmp_path, capsys) -> None:
    out = tmp_path / "limit.json"
    resin = ["--resin", str(SAMPLES / "resins/melamine_formaldehyde.toml"), "--json", str(out)]
    run = str(SAMPLES / "samples/2026-03-04-01.csv")
    assert main(["blisters", run, "--press", str(SAMPLES / "presses/lab.toml"), *resin]) == 2
    assert "none of 0 runs marked good or blister" in capsys.readouterr().err
    assert not out.exists()
