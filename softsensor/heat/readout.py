"""From the solver's steps to the rows of a run: interpolation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from daq.printed import on_screen
from daq.records import Array
from softsensor.heat import implicit_steps

COARSE_STEP_S = 0.06
"""Steps longer than this are read by cubics, shorter ones (around a switch) by straight lines. [s]

Twice as long moves a face by 6 mK, half as long by 15 in a ramp, neither the core (`tests.calibration.steps`:
three sample runs, seed 2026, 2026-11-29)."""


@dataclass(frozen=True)
class Reader:
    """Reads series given at step edges off at other times: straight in fine steps, cubic in coarse ones."""

    first: implicit_steps.Integers
    weights: Array

    __repr__ = on_screen

    @staticmethod
    def at(edges: Array, times: Array, *, slope: bool = False) -> Reader:
        """Prepare to read values at edges of steps, or their slopes in time, at `times`. [s]"""
        times = np.clip(times, edges[0], edges[-1])
        last = len(edges) - 1
        i = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, last - 1)
        first = np.clip(i - 1, 0, last - 3)
        weights = np.zeros((len(times), 4))
        rows = np.arange(len(times))
        h = edges[i + 1] - edges[i]
        u = (times - edges[i]) / h
        coarse = (h > COARSE_STEP_S) & (i > 0) & (i < last - 1)
        straight = ~coarse
        low, high = (-1.0 / h, 1.0 / h) if slope else (1.0 - u, u)
        weights[rows[straight], (i - first)[straight]] = low[straight]
        weights[rows[straight], (i - first + 1)[straight]] = high[straight]
        nodes = [edges[i[coarse] + k] for k in (-1, 0, 1, 2)]
        for a in range(4):
            weights[coarse, a] = _cubic(nodes, a, times[coarse], slope=slope)
        return Reader(first.astype(np.int64), weights)

    def __call__(self, y: Array) -> Array:
        """Return the rows of `y` (..., steps + 1, c) read off, (..., rows, c)."""
        flat = np.ascontiguousarray(y).reshape(-1, *y.shape[-2:])
        out = np.empty((len(flat), len(self.first), y.shape[-1]))
        implicit_steps.weighted_rows(self.first, self.weights, flat, out)
        return out.reshape(*y.shape[:-2], *out.shape[1:])


def _cubic(nodes: list[Array], a: int, x: Array, *, slope: bool) -> Array:
    """Return the weight, or its slope, of node `a` in the cubic through four nodes."""
    others = [nodes[b] for b in range(4) if b != a]
    scale = (nodes[a] - others[0]) * (nodes[a] - others[1]) * (nodes[a] - others[2])
    p, q, r = (x - node for node in others)
    return np.asarray((q * r + p * r + p * q if slope else p * q * r) / scale)


@dataclass(frozen=True)
class Derivatives(Mapping[str, Array]):
    """Derivatives of the sensors' columns by parameter, spread from places to columns when asked for."""

    names: tuple[str, ...]
    places: Array
    """(P, rows, m)"""
    place_of_column: tuple[int, ...]
    _spread: dict[str, Array] = field(default_factory=dict, repr=False)

    __repr__ = on_screen

    def __getitem__(self, name: str) -> Array:
        if name not in self._spread:
            try:
                index = self.names.index(name)
            except ValueError:
                raise KeyError(name) from None
            self._spread[name] = self.places[index][:, self.place_of_column]
        return self._spread[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)
