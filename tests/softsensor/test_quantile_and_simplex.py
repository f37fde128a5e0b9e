"""What a fit does itself for the sake of its start, against the libraries that do it too."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import stdtrit

from softsensor.fitting.simplex import lowest_point
from softsensor.signals.student import student


@pytest.mark.parametrize("probability", [0.6, 0.95, 0.975, 0.995])
@pytest.mark.parametrize("freedom", [1, 2, 5, 9.99, 30, 100, 1000])
def test_student_reaches_as_far_as_scipys(freedom, probability):
    assert student(freedom, probability) == pytest.approx(stdtrit(freedom, probability), rel=1e-11)


def test_student_of_many_is_normal():
    assert student(1e7) == pytest.approx(1.959963984540054, rel=1e-6)


def test_student_has_no_quantile_without_freedom():
    with pytest.raises(ValueError, match="domain"):
        student(0)


def banana(x):
    """Rosenbrock's valley, lowest at (1, 1)."""
    return 100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2


@pytest.mark.parametrize("most", [7, 20, 50, 500])
def test_simplex_goes_where_scipys_goes(most):
    rng = np.random.default_rng(3)
    for start in rng.uniform(-3.0, 3.0, (20, 2)):
        other = minimize(
            banana, start, method="Nelder-Mead", options={"xatol": 0.01, "fatol": 0.01, "maxfev": most}
        )
        assert lowest_point(banana, start, 0.01, most) == pytest.approx(other.x, abs=1e-9)


def test_simplex_finds_the_bottom_of_a_valley():
    assert lowest_point(banana, (-1.2, 1.0), 1e-8, 1000) == pytest.approx([1.0, 1.0], abs=1e-6)
