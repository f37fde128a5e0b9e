"""Type K against the NIST table and against itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq import thermocouple

NIST_TABLE_MV = {
    -270: -6.458,
    -200: -5.891,
    -100: -3.554,
    0: 0.000,
    25: 1.000,
    100: 4.096,
    200: 8.138,
    300: 12.209,
    400: 16.397,
    500: 20.644,
    1000: 41.276,
    1372: 54.886,
}


@pytest.mark.parametrize(("celsius", "millivolt"), NIST_TABLE_MV.items())
def test_voltage_agrees_with_the_nist_table(celsius, millivolt):
    assert thermocouple.voltage(celsius) == pytest.approx(millivolt, abs=0.0006)


@given(st.floats(-270, 1372))
def test_temperature_undoes_voltage_to_a_millikelvin(celsius):
    back = float(thermocouple.temperature(thermocouple.voltage(celsius)))
    slope_is_tiny = celsius < -260
    assert back == pytest.approx(celsius, abs=0.05 if slope_is_tiny else 1e-3)


def test_temperature_agrees_with_a_root_found_one_value_at_a_time():
    from scipy.optimize import brentq

    for millivolt in (-5.0, -1.0, 0.5, 4.0, 8.0, 30.0, 54.0):
        root = brentq(lambda t, e=millivolt: float(thermocouple.voltage(t)) - e, -265, 1372, xtol=1e-9)
        assert thermocouple.temperature(millivolt) == pytest.approx(root, abs=1e-4)


@given(st.floats(0, 1300), st.floats(0, 60))
def test_cold_junction_compensation_recovers_the_hot_junction(hot, cold):
    measured = thermocouple.voltage(hot) - thermocouple.voltage(cold)
    assert float(thermocouple.compensated(measured, cold)) == pytest.approx(hot, abs=1e-3)
    assert float(thermocouple.implied_cold_junction(measured, hot)) == pytest.approx(cold, abs=1e-3)


def test_adding_the_cold_junction_as_a_temperature_would_be_wrong_by_tenths_of_a_kelvin():
    measured = thermocouple.voltage(200.0) - thermocouple.voltage(40.0)
    naive = thermocouple.temperature(measured) + 40.0
    assert abs(naive - 200.0) > 0.1


def test_what_lies_outside_the_range_is_missing_not_extrapolated():
    assert np.isnan(thermocouple.voltage([-271.0, 1373.0, np.nan])).all()
    assert np.isnan(thermocouple.temperature([-7.0, 55.0, np.nan])).all()


def test_arrays_keep_their_shape():
    grid = np.linspace(0, 300, 12).reshape(3, 4)
    assert thermocouple.temperature(thermocouple.voltage(grid)).shape == (3, 4)
