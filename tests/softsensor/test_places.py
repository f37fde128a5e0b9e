"""Channels of one place: their mean without steps, and noise that is told apart and taken out as what it is."""

import numpy as np
import pytest

from daq.press.press_file import parse_press
from daq.records import EventSource, Moments, Run
from daq.simulated.campaign_pressfile import press_toml
from softsensor.signals.faces import rim_falls
from softsensor.signals.places import Noise, Place, Signals, _whiten, channel_noise


def test_a_channel_that_drops_out_makes_no_step_in_the_mean():
    level = 20.0 + 0.5 * np.arange(40.0)
    values = level[:, None] + np.array([-2.0, 0.5, 1.5])
    values[25:, 0] = np.nan
    place = Place.of("panel.top", ["top_1", "top_2", "top_3"], values)
    assert place.offsets - place.offsets[1] == pytest.approx([-2.5, 0.0, 1.0])
    assert np.diff(place.mean) == pytest.approx(0.5)
    assert place.count.tolist() == 25 * [3.0] + 15 * [2.0]


def test_whitened_noise_has_no_covariance_left():
    """The filter is linear: what it makes of the unit columns is the factor that turns the covariance into one."""
    time = np.array([0.0, 0.5, 1.0, 1.5, 2.7, 3.0, 6.0, 6.4])
    slow, slow_s, fast, fast_s, white = 0.3, 20.0, 0.2, 1.5, np.linspace(0.05, 0.2, len(time))
    gap = np.abs(time[:, None] - time[None, :])
    covariance = slow * np.exp(-gap / slow_s) + fast * np.exp(-gap / fast_s) + np.diag(white)
    ok = np.ones(len(time), bool)
    factor, log_det = _whiten(time, np.eye(len(time)), white, ok, (slow, slow_s, fast, fast_s))
    assert factor @ covariance @ factor.T == pytest.approx(np.eye(len(time)), abs=1e-9)
    assert log_det == pytest.approx(np.linalg.slogdet(covariance)[1])


def test_a_row_that_is_not_there_leaves_the_noise_of_the_others_as_it_is():
    time, white = np.arange(6.0), np.full(6, 0.1)
    ok = np.array([True, True, False, True, False, True])
    full, log_det = _whiten(time, np.eye(6), white, ok, (0.3, 20.0, 0.2, 1.5))
    alone, of_these = _whiten(time[ok], np.eye(4), white[ok], np.ones(4, bool), (0.3, 20.0, 0.2, 1.5))
    assert full[np.ix_(ok, ok)] == pytest.approx(alone)
    assert log_det == pytest.approx(of_these)


def test_white_and_slower_noise_of_channels_are_told_apart():
    chance, rows, period, tau = np.random.default_rng(7), 4000, 0.5, 5.0
    fast, white = 0.30, 0.20
    keep = np.exp(-period / tau)
    slow = np.zeros((rows, 7))
    slow[0] = fast * chance.normal(size=7)
    for k in range(1, rows):
        slow[k] = keep * slow[k - 1] + fast * np.sqrt(1.0 - keep**2) * chance.normal(size=7)
    values = 60.0 + slow + white * chance.normal(size=slow.shape)
    names = [f"top_{i}" for i in range(1, 8)]
    cells = dict(zip(names, values.T, strict=True))
    time = period * np.arange(rows)
    signals = Signals(time, (Place.of("panel.top", names, values),), cells, (), 0)
    moments = Moments(inserted_s=0.0, closed_s=10.0, opened_s=float(time[-1]), source=EventSource.TEMPERATURES)
    found = channel_noise(signals, moments, Noise(0.1, 60.0, 0.0, 1.0, 0.01))
    assert found.fast_K == pytest.approx(fast, rel=0.1)
    assert found.white_K == pytest.approx(white, rel=0.1)
    assert found.fast_s == pytest.approx(tau, rel=0.25)


PLACES_MM = [[-200, -200], [200, 200], [0, 0], [50, -50], [200, -200], [-50, 50], [-200, 200]]
"""Of seven channels: four in the corners of the face, three about its middle."""


def falling_rim(channels):
    """Run of upper channels, 5 K apart, of which those in the corners fall 2 K behind in its second half."""
    time = np.arange(100.0)
    late = 2.0 * (time > 50.0)
    corner = {1, 2, 5, 7}
    columns = {f"top_{i}": 20.0 + time + 5.0 * i - late * (i in corner) for i in range(1, channels + 1)}
    return Run("r", {}, time, columns)


def test_a_rim_that_falls_behind_the_middle_is_told_in_kelvins_whatever_the_channels_offsets():
    text = press_toml().replace('at = "panel.top"', f'at = "panel.top"\nposition_mm = {PLACES_MM}')
    press, moments = parse_press(text), Moments(inserted_s=0.0, removed_s=99.0)
    assert rim_falls(press, falling_rim(7), moments, frozenset()) == pytest.approx(-2.0)
    assert rim_falls(press, falling_rim(7), moments, frozenset({"top_2"})) == pytest.approx(-2.0)
    assert np.isnan(rim_falls(press, falling_rim(8), moments, frozenset()))  # nobody says where the eighth lies
    assert np.isnan(rim_falls(press, falling_rim(6), moments, frozenset()))
