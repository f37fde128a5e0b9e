"""A prediction that grows without end loses against every other, and ends no diagnosis."""

import numpy as np

from softsensor.diagnosis.extension import UNBOUNDED_K, bounded


def test_what_is_finite_stays_to_the_last_bit():
    series = np.array([-40.0, 0.0, 20.1, 1999.0])
    assert bounded(series).tobytes() == series.tobytes()


def test_what_is_not_finite_is_far_from_every_reading():
    series = np.array([np.nan, np.inf, -np.inf, 1e300])
    assert bounded(series).tolist() == [UNBOUNDED_K, UNBOUNDED_K, -UNBOUNDED_K, UNBOUNDED_K]
    assert np.isfinite(np.square(bounded(series)).sum())
