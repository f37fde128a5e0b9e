"""``--until``: where each run ends for a command; see `softsensor.face.ends`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from daq.press.press_file import Press
    from daq.records import Run

Until = Annotated[
    list[str] | None,
    typer.Option("--until", metavar="SECONDS|COLUMN=C|EVENT", help="help-until"),
]


def shortened(runs: Sequence[Run], press: Press, until: Sequence[str] | None) -> list[Run]:
    """Return the runs without the rows after their ends. Raises `InputError`."""
    if not until:
        return list(runs)
    from softsensor.face import ends

    return ends.shortened(runs, press, until, option="--until")
