"""Where the band comes from: the share of the core's variance that each kind of doubt brings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.records import Array
from softsensor.live.directions import CONSTANT, DISCREPANCY
from softsensor.live.kalman import KalmanFilter
from softsensor.live.mixture import Mixture
from softsensor.live.priors import TIMING
from softsensor.signals.doubt import MEAN_SQUARE_SIZE
from softsensor.signals.unknown import Unknown

KINDS = ("constants", "contacts", "timing", "start", "effects", "discrepancy", "suspected", "panel")
"""Constants of panel, layers and flux; contacts; moments of the press; temperatures of start and platens; effects
that the model in force holds or that only bend readings; what any model lacks; causes not diagnosed; that another
panel lies in the press than the header says."""


def band_from(one: KalmanFilter, mixture: Mixture, margin: float) -> dict[str, float]:
    """Return the share of each of `KINDS` in the mean square distance of the core from what is reported.

    A parameter counts with its covariance with the core, which adds up to the whole variance (a negative share,
    where two errors offset each other, counts as none). Suspected causes count with all that they add to the
    variance without them, other panels with all that they add to that of the header's.

    Parameters
    ----------
    one
        The filter whose cause is none.
    margin
        Variance that the model itself adds. [K²]
    """
    made, causes = one.linearised, one.hypotheses
    p = len(made.names)
    P = narrowed(one.estimate.covariance[:p, :p], causes.column, causes.width)  # as if each were absent
    readout = made.model.chain.d_level
    shares = np.maximum(readout * (P @ readout), 0.0)
    size = 1.0 + (MEAN_SQUARE_SIZE - 1.0) * made.loose
    shares[[prior.considered for prior in made.priors]] = size * one.held_K**2
    found = dict.fromkeys(KINDS, 0.0)
    for share, prior in zip(shares.tolist(), made.priors, strict=True):
        found[_kind(prior)] += share
    found["discrepancy"] += margin
    plain = sum(found.values())
    header = mixture.panels[0]
    found["suspected"] += max(header.sd_K**2 - plain, 0.0)
    found["panel"] += max(mixture.sd_K**2 - max(header.sd_K**2, plain), 0.0) if len(mixture.panels) > 1 else 0.0
    total = sum(found.values())
    return {kind: value / total for kind, value in found.items()}


def narrowed(covariance: Array, column: NDArray[np.int64], width: Array) -> Array:
    """Return the covariance (P, P), had the priors of some parameters been narrower.

    Parameters
    ----------
    column
        Of these parameters (E).
    width
        Standard deviation of each prior as a share of what it was (E); 1 changes nothing.
    """
    root = np.sqrt(1.0 / width**2 - 1.0)
    across = covariance[:, column] * root
    among = across[column] * root[:, None]
    return np.asarray(covariance - across @ np.linalg.solve(among + np.eye(len(column)), across.T))


def _kind(prior: Unknown) -> str:
    first = prior.name.partition(" ")[0]
    if prior.log or prior.name.startswith("contact_"):
        return "contacts"
    if prior.name in TIMING:
        return "timing"
    if prior.name.endswith("_K") and "." not in prior.name:
        return "start"
    return {CONSTANT: "constants", DISCREPANCY: "discrepancy"}.get(first, "effects")
