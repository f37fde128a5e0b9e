"""1-D heat conduction on a graded grid: meshes and places.

The equation is  rho c dT/dt = d/dx (k dT/dx) + q  with T in °C, x in m from the bottom of the stack,
q in W/m³ (see `model` for how the paper prints it). Cells are finite volumes, so what leaves one enters
the next and energy is kept to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.printed import on_screen
from daq.records import Array

# What each number does was measured (`tests.calibration.steps`: three sample runs, seed 2026, 2026-11-29). Beside
# cells and steps a quarter as large the core is 45 mK off at most, a face 40, or 270 within a second of a switch.

QUICK_S = 20.0
"""A layer whose thickness² / diffusivity is shorter gets equal cells: a steel plate of 10 mm has 9 s, a panel of
8 mm some 600. Twice and half as long move nothing. [s]"""
EQUAL_CELLS = 3.0
"""Half as many as it gets, at a fineness of 1; twice as many move core and faces by 1 and 26 mK."""
FIRST_S, WIDEST_S, WIDEST_SHARE, WIDER = 0.02, 6.0, 24.0, 0.12
"""Other layers: the cell at a face is what heat crosses in the first; widths grow by the last of the depth, up to
what heat crosses in the second, or so many a layer. [s, s, -, -]

Finer by a factor of two each moves the core by 3, 17, 30 and 24 mK, a face by 109, 8, 21 and 56."""


@dataclass(frozen=True)
class Mesh:
    """Cells of a stack from bottom to top."""

    dx: Array
    """Cell widths (n). [m]"""
    layer: tuple[str, ...]
    """Layer names in order."""
    first: tuple[int, ...]
    """Index of each layer's first cell; one more entry holds n."""

    __repr__ = on_screen

    def cells(self, layer: str) -> slice:
        """Return the cells of a layer."""
        i = self.layer.index(layer)
        return slice(self.first[i], self.first[i + 1])

    def centres(self, layer: str) -> Array:
        """Return cell centres above the layer's bottom. [m]"""
        dx = self.dx[self.cells(layer)]
        return np.asarray(np.cumsum(dx) - dx / 2)

    def place(self, layer: str, height: float) -> Array:
        """Return the weights (n) that read the temperature at a height above a layer's bottom. [m]

        Quadratic in the three nearest cells of the layer, so second order up to its faces.
        """
        weights = np.zeros(len(self.dx))
        cells, nodes = self._nearest(layer, height)
        for j, cell in enumerate(cells):
            others = np.delete(nodes, j)
            weights[cell] = np.prod((height - others) / (nodes[j] - others))
        return weights

    def slope(self, layer: str, height: float) -> Array:
        """Return the weights (n) that read how the temperature at a place changes with its height. [1/m]

        The derivative of `place` by the height, of the same cells.
        """
        weights = np.zeros(len(self.dx))
        cells, nodes = self._nearest(layer, height)
        for j, cell in enumerate(cells):
            others = np.delete(nodes, j)
            weights[cell] = np.polyval(np.polyder(np.poly(others)), height) / np.prod(nodes[j] - others)
        return weights

    def _nearest(self, layer: str, height: float) -> tuple[range, Array]:
        """Return the cells of a layer, three at most, nearest to a height, and their centres. [m]"""
        x = self.centres(layer)
        count = min(3, len(x))
        start = int(np.clip(np.searchsorted(x, height) - (count + 1) // 2, 0, len(x) - count))
        if count == 3 and start + 3 < len(x) and abs(x[start + 3] - height) < abs(x[start] - height):
            start += 1
        first = self.cells(layer).start + start
        return range(first, first + count), x[start : start + count]


def graded_widths(thickness: float, diffusivity: float, fineness: float = 1.0) -> Array:
    """Return cell widths that grow smoothly from both faces of a layer inwards.

    The first cell is what heat crosses in 0.02 s, so that faces are resolved from the first tenth of a
    second after a contact closes; widths grow by 0.12 of the depth, up to what heat crosses in 6 s or
    1/24 of the layer. A layer that equalises within seconds (a steel plate) gets about 6 equal cells.
    Smooth growth matters: a jump in the widths costs more than wider cells do.

    Parameters
    ----------
    thickness
        Of the layer. [m]
    diffusivity
        k / (rho c). [m²/s]
    fineness
        2 halves every cell; the error then falls by four.

    Examples
    --------
    >>> widths = graded_widths(0.016, 1.0e-7)
    >>> round(float(widths.sum()), 6), len(widths)
    (0.016, 76)
    """
    if thickness**2 / diffusivity < QUICK_S:
        equal = max(4, 2 * round(EQUAL_CELLS * fineness))
        return np.full(equal, thickness / equal)
    widest = min(np.sqrt(diffusivity * WIDEST_S), thickness / WIDEST_SHARE)
    first = min(np.sqrt(diffusivity * FIRST_S), widest)
    x = np.linspace(0.0, thickness / 2, 2001)
    density = 1.0 / (first + WIDER * x) + 1.0 / widest
    count = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(x))])
    half = max(2, round(float(count[-1]) * fineness))
    edges = np.interp(np.linspace(0.0, count[-1], half + 1), count, x)
    widths = np.diff(edges)
    return np.concatenate([widths, widths[::-1]])


def build_mesh(layers: list[tuple[str, float, float]], fineness: float = 1.0) -> Mesh:
    """Return the mesh of layers given as name, thickness [m] and diffusivity [m²/s]; a diffusivity of
    0 asks for a single cell.
    """  # noqa: D205
    widths = [
        np.array([thickness]) if diffusivity <= 0 else graded_widths(thickness, diffusivity, fineness)
        for _, thickness, diffusivity in layers
    ]
    first = np.concatenate([[0], np.cumsum([len(w) for w in widths])])
    return Mesh(np.concatenate(widths), tuple(name for name, _, _ in layers), tuple(int(i) for i in first))
