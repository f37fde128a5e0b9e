"""Real runs of other laboratories: moisture in moist pine and not in dry, the load in a press rig."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from daq.files.mapping import read_foreign, read_mapping
from daq.press.press_file import read_press
from daq.words.message import sentences
from softsensor.diagnosis.curves import curves_of
from softsensor.diagnosis.settling import settle_base
from softsensor.diagnosis.summary import core_messages, sureness, where_message
from softsensor.diagnosis.verdict import _where, diagnose
from softsensor.diagnosis.where import temperatures
from softsensor.heat.model import ThermalModel
from softsensor.report.diagnosis_figures import worst_run_figure
from softsensor.report.diagnosis_report import diagnosis_report
from softsensor.signals.digest import digest_run
from softsensor.signals.moments import moments_seen
from tests.measured import DRY_DISCS, MOIST_DISCS, MOIST_DISCS_40_KW, PRESS_RIG, ROOT, measured

PYROLYSIS_C = 140.0
"""When the back face is this hot, the heated one chars, which is not in the model."""


def _runs(names, mapping):
    mapped = read_mapping(ROOT / f"deploy/mappings/{mapping}.toml")
    return [read_foreign(path, mapped) for path in measured(names)]


def _before_charring(run):
    hot = np.flatnonzero(run.columns["bottom_1"] > PYROLYSIS_C)
    return run.at_rows(slice(hot[0] if len(hot) else None))


def pine_disc():
    return read_press(ROOT / "deploy/presses/pine_disc.toml")


def moist_runs():
    return _runs(MOIST_DISCS, "pine")


@cache
def moist(sought=("moisture_evaporation",)):
    """The four moist discs; sought among all causes they are named the same, for twice the time."""
    return diagnose(pine_disc(), [_before_charring(r) for r in moist_runs()], effects=sought)


@pytest.mark.campaign
def test_moist_pine_is_named_moist():
    found = moist(None)
    assert [f.set[0] for f in found.findings] == ["moisture_evaporation"]
    assert found.findings[0].gain.ci95[0] > 0.0
    assert found.findings[0].parameters["moisture_percent"].ci95[0] > 0.0
    assert 85.0 < found.findings[0].parameters["temperature_C"].value < 115.0


@pytest.mark.parametrize(
    "sought", [(), pytest.param((None,), marks=pytest.mark.campaign)], ids=["by its name", "among all"]
)
def test_moisture_halves_the_error_of_a_typical_pine_run_left_out(sought):
    found = moist(*sought)
    assert found.findings[0].gain.value_K > 0.5 * found.base.heldout_rmse_K
    assert (found.extended.heldout < 0.6 * found.base.heldout).all()


@cache
def pair():
    """Two discs at one heat flux, which two runs do not name."""
    return diagnose(pine_disc(), [_before_charring(r) for r in _runs(MOIST_DISCS_40_KW, "pine")])


def test_two_moist_discs_alone_are_suspected_to_be_moist_and_not_named():
    found = pair()
    assert found.findings == ()
    assert "moisture_evaporation" in [name for f in found.suspected for name in f.set]
    assert found.verdict == "not_described"


@pytest.mark.campaign
def test_moist_and_dry_discs_together_get_no_common_name():
    runs = [_before_charring(r) for r in _runs((*MOIST_DISCS, *DRY_DISCS), "pine")]
    found = diagnose(pine_disc(), runs)
    assert found.findings == ()
    assert found.verdict == "unknown_effect"


def test_residual_of_moist_pine_sits_where_water_boils():
    """There alone the plain model is too warm; panels of their own let it be too cold elsewhere."""
    found = pair()
    for white, run in zip(found.stages[0].data, found.stages[0].fit.runs, strict=True):
        back, residual = white.digest.y[:, 0], run.misfit[:, 0]
        boiling = (back > 85.0) & (back < 115.0)
        assert np.nanmean(residual[boiling]) < -4.0
        for low, high in ((20.0, 40.0), (40.0, 75.0), (75.0, 85.0), (115.0, 300.0)):
            assert np.nanmean(residual[(back > low) & (back < high)]) > -1.0


def far_too_warm(where):
    """Of the stretches reported, those in which the plain model is far too warm."""
    return [row for row in where if row["residual_K"] < -5.0]


def test_stretches_told_of_moist_pine_lie_where_water_boils():
    rows = far_too_warm(pair().where)
    assert rows
    assert all(85.0 < row["low_C"] < row["high_C"] < 115.0 for row in rows)
    low, high = (f"{rows[0][key]:.0f}" for key in ("low_C", "high_C"))
    assert f"where it measured {low} to {high} °C" in sentences(where_message(pair()))
    assert f"{temperatures(rows[0])}</td>" in diagnosis_report(pair()).replace("\N{NO-BREAK SPACE}", " ")


def test_stretch_where_water_boils_is_told_first_though_runs_go_on_to_charring():
    plain = settle_base(
        ThermalModel(pine_disc()),
        [digest_run(pine_disc(), r, moments_seen(r, pine_disc())) for r in _runs(MOIST_DISCS_40_KW, "pine")],
    )
    first = _where(plain)[0]
    assert first["residual_K"] < -15.0
    assert 85.0 < first["low_C"] < 115.0
    assert first["to_s"] - first["from_s"] < 100.0


def test_four_named_runs_are_told_with_what_four_can_show():
    assert moist().findings[0].p_value >= 0.125
    assert "4 runs cannot show less than 0.12; named because" in str(sureness(moist().findings[0], 4))
    assert "4 runs cannot show less than 0.12; named because" in diagnosis_report(moist())


@pytest.mark.campaign
def test_dry_pine_gets_no_moisture_verdict():
    runs = [_before_charring(r) for r in _runs(DRY_DISCS, "pine")]
    found = diagnose(pine_disc(), runs)
    assert found.findings == ()
    assert "moisture_evaporation" not in [f.name for f in found.suspected]


@cache
def rig():
    return diagnose(read_press(ROOT / "deploy/presses/rig.toml"), _runs(PRESS_RIG, "press_rig"))


def test_press_rig_shows_the_load_and_no_sensor_offset():
    found = rig()
    assert [f.set for f in found.findings] == [("contact_load",)]
    assert found.findings[0].parameters["exponent"].ci95[0] > 0.0
    assert found.extended.heldout_rmse_K < 0.75 * found.base.heldout_rmse_K


@pytest.mark.parametrize(
    ("runs", "verdict"), [(4, "too_few_runs"), pytest.param(6, "ambiguous", marks=pytest.mark.campaign)]
)
def test_an_inner_thermocouple_that_is_off_is_no_platen_that_is_for_certain(runs, verdict):
    """Nothing lies beside it that would show which of the two is."""
    read = _runs(PRESS_RIG, "press_rig")[:runs]
    off = [replace(r, columns=r.columns | {"T_Inco2": r.columns["T_Inco2"] + 5.0}) for r in read]
    found = diagnose(read_press(ROOT / "deploy/presses/rig.toml"), off, law=False)
    assert next(f.set for f in (*found.findings, *found.suspected)) == ("platen_offset", "sensor_fault")
    assert len(found.findings) == (verdict == "ambiguous")
    assert found.verdict == verdict


def test_a_rig_without_a_panel_is_told_nothing_about_a_core_and_a_disc_how_its_core_ends():
    assert "no panel in this rig" in str(core_messages(rig())[0])
    assert "sacrificial" not in str(rig().next_measurement)
    assert str(core_messages(moist())[0]).startswith("At the end of a run, the core is ")


def test_a_rig_that_never_closes_is_not_told_about_its_closing():
    assert {row["phase"] for row in moist().where} == {"since the run began"}


@pytest.mark.parametrize("found", [moist, rig])
def test_figure_of_a_measured_run_shows_readings_both_models_and_both_residuals(found):
    axes = worst_run_figure(curves_of(found())).get_axes()
    labels = {label for ax in axes for label in ax.get_legend_handles_labels()[1]}
    assert {"measured (mean)", "plain model", "extended model", "plain", "extended"} <= labels
    residuals = {line.get_label(): line.get_ydata() for ax in axes for line in ax.get_lines()}
    assert np.nanstd(residuals["extended"]) < 0.75 * np.nanstd(residuals["plain"])


@pytest.mark.campaign
def test_moist_pine_whose_runs_go_on_to_charring_is_moist_or_like_it():
    """No model has charring; that water leaves too stays in the set."""
    found = diagnose(pine_disc(), moist_runs())
    assert [f.set[0] for f in found.findings] == ["moisture_evaporation"]
    assert found.verdict == "ambiguous"
    assert found.findings[0].parameters["moisture_percent"].ci95[0] > 0.0


@pytest.mark.campaign
def test_dry_pine_that_goes_on_to_charring_is_called_unknown_and_not_moist():
    found = diagnose(pine_disc(), _runs(DRY_DISCS, "pine"))
    assert found.verdict == "unknown_effect"
    assert found.findings == ()
