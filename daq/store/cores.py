"""The core of finished runs in three numbers each, from the live estimates: for lists, search and plots."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Connection, and_, case, func, select

from daq.store.archived import archived_cores
from daq.store.convert import nan
from daq.store.records import AT_ONCE, RunCore
from daq.store.schema import ESTIMATE, RUN

# Numbers without another source were set by hand, 2026-11.

BEFORE_S = 1.0
"""The core at opening is that of the last valid estimate so shortly before. [s]"""


def run_cores(connection: Connection, runs: Sequence[str]) -> dict[str, RunCore]:
    """Return core and band at opening and the highest core of each run that has a valid estimate."""
    found: dict[str, RunCore] = {}
    for i in range(0, len(runs), AT_ONCE):
        found |= _cores(connection, runs[i : i + AT_ONCE]) | archived_cores(connection, runs[i : i + AT_ONCE])
    return found


def _cores(connection: Connection, runs: Sequence[str]) -> dict[str, RunCore]:
    own = and_(
        ESTIMATE.c.press_id == RUN.c.press_id,
        ESTIMATE.c.number >= RUN.c.first_scan,
        ESTIMATE.c.number <= RUN.c.last_scan,
        ESTIMATE.c.valid == 1,
    )
    opened = RUN.c.zero_monotonic_s + RUN.c.opened_s
    shortly_before = ESTIMATE.c.monotonic_s.between(opened - BEFORE_S, opened)
    last = (
        select(
            RUN.c.run,
            RUN.c.press_id,
            func.max(ESTIMATE.c.core_celsius).label("highest"),
            func.max(case((shortly_before, ESTIMATE.c.number))).label("number"),
        )
        .join(ESTIMATE, own)
        .where(RUN.c.run.in_(runs))
        .group_by(RUN.c.run, RUN.c.press_id)
        .subquery()
    )
    at_opening = and_(ESTIMATE.c.press_id == last.c.press_id, ESTIMATE.c.number == last.c.number)
    query = select(
        last.c.run,
        last.c.highest,
        ESTIMATE.c.core_celsius,
        ESTIMATE.c.core_low_celsius,
        ESTIMATE.c.core_high_celsius,
    ).outerjoin(ESTIMATE, at_opening)
    return {
        r.run: RunCore(
            at_opening_celsius=nan(r.core_celsius),
            band_at_opening_kelvin=nan(r.core_high_celsius) - nan(r.core_low_celsius),
            highest_celsius=nan(r.highest),
        )
        for r in connection.execute(query).all()
    }
