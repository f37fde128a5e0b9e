"""1-D heat conduction on a graded grid: meshes and places.

The equation is  rho c dT/dt = d/dx (k dT/dx) + q  with T in °C, x in m from the bottom of the stack,
q in W/m³. Cells are finite volumes, so what leaves one enters the next and energy is kept to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.records import Array


@dataclass(frozen=True)
class Mesh:
    """Cells of a stack from bottom to top."""

    dx: Array
    """Cell widths (n). [m]"""
    layer: tuple[str, ...]
    """Layer names in order."""
    first: tuple[int, ...]
    """Index of each layer's first cell; one more entry holds n."""

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
        x = self.centres(layer)
        count = min(3, len(x))
        start = int(np.clip(np.searchsorted(x, height) - (count + 1) // 2, 0, len(x) - count))
        if count == 3 and start + 3 < len(x) and abs(x[start + 3] - height) < abs(x[start] - height):
            start += 1
        nodes = x[start : start + count]
        for j in range(count):
            others = np.delete(nodes, j)
            weights[self.cells(layer).start + start + j] = np.prod((height - others) / (nodes[j] - others))
        return weights


def graded_widths(thickness: float, diffusivity: float, fineness: float = 1.0) -> Array:
    """Return cell widths that grow from both faces of a layer inwards.

    The first cell is what heat crosses in 0.05 s, the widest what it crosses in 6 s, so that faces
    are resolved from the first tenth of a second after a contact closes.

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
    >>> round(float(widths.sum()), 6), len(widths) > 30
    (0.016, True)
    """
    first = min(np.sqrt(diffusivity * 0.05), thickness / 6) / fineness
    widest = min(np.sqrt(diffusivity * 6.0), thickness / 5) / fineness
    growth = 1.25 ** (1.0 / fineness)
    half = []
    width, total = first, 0.0
    while total + width < thickness / 2:
        half.append(width)
        total += width
        width = min(width * growth, widest)
    if not half or thickness / 2 - total > 0.5 * half[-1]:
        half.append(thickness / 2 - total)
    widths = np.array(half + half[::-1])
    return np.asarray(widths * (thickness / widths.sum()))


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
