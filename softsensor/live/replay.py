"""A stored run through the live sensor, scan by scan and causally: what it would have estimated."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

from daq.press.header import panel_of
from daq.press.press_file import BoundaryKind, Press, press_for_run
from daq.press.resin_file import Resin
from daq.records import InputError, Run
from daq.tables import at
from daq.words import say
from softsensor.heat.model_file import ModelFile
from softsensor.live.sensor import LEAVES, NUMBERS, Estimate, ScanSensor

OF_A_RESIN = (*LEAVES, "open_now")
COLUMNS = ("time_s", "state", *NUMBERS, "valid", "reason", *OF_A_RESIN)


@dataclass(frozen=True)
class Replay:
    """The live sensor's estimates at all scans of a run."""

    run: Run
    """What was replayed."""
    estimates: tuple[Estimate, ...]
    """One a scan, in order."""
    resin: bool = False
    """Whether cure, steam and leave to open were asked for."""

    def __repr__(self) -> str:
        """Return on a screen whose replay it is, how many of its scans have an estimate, and the last one."""
        valid = [one for one in self.estimates if one.valid]
        last = [f"at {one.time_s:g} s core {one.core_C:.1f} °C, sd {one.core_sd_K:.1f} K" for one in valid[-1:]]
        head = f"Replay of run {self.run.name}: {len(self.estimates)} scans, {len(valid)} valid"
        return "\n".join([head, *last])

    def columns(self) -> dict[str, list[float | int | str]]:
        """Return it as the columns of ``predict --out``."""
        rows = [one.row() for one in self.estimates]
        names = COLUMNS if self.resin else [name for name in COLUMNS if name not in OF_A_RESIN]
        return {name: [row[name] for row in rows] for name in names}


def replay(
    press: Press,
    run: Run,
    model: ModelFile | None = None,
    hidden: Collection[str] = (),
    progress: Callable[[int], None] = lambda scans: None,
    resin: Resin | None = None,
) -> Replay:
    """Feed a run to a live sensor, scan by scan; row i rests on nothing later than scan i.

    Parameters
    ----------
    hidden
        Columns it does not see; validation columns, a core's, it never sees.
    progress
        Is given the number of scans done.
    resin
        Adds cure, steam and leave to open; None: not asked for.

    Raises
    ------
    InputError
        Where the run lacks what this press cannot predict without: a platen's column, or the panel; where a
        resin is given for a press without one.
    """
    unseen = {*hidden, *press.sensors_of(run, "validation")}
    columns = {name: values.tolist() for name, values in run.columns.items() if name not in unseen}
    _check(press, run, columns, with_resin=resin is not None)
    sensor = ScanSensor(press, run.header, model, resin)
    estimates = []
    for i, time_s in enumerate(run.time_s.tolist()):
        estimates.append(sensor.update(time_s, {name: values[i] for name, values in columns.items()}))
        progress(i + 1)
    return Replay(run, tuple(estimates), resin is not None)


def _check(press: Press, run: Run, columns: Collection[str], *, with_resin: bool) -> None:
    """Refuse what cannot be predicted; `asked`: cure and leave to open are wanted."""
    own = press_for_run(press, run)
    for end in ("bottom", "top"):
        boundary = getattr(own.boundary, end)
        if boundary.kind is BoundaryKind.MEASURED and boundary.column not in columns:
            raise InputError(
                say(
                    "boundary-column-missing",
                    run=run.source or run.name,
                    column=str(boundary.column),
                    end=end,
                    columns=tuple(columns),
                )
            )
    if own.panel_layers:
        panel_of(run)
    elif with_resin:
        raise InputError(at(run.source or run.name, say("resin-needs-panel")))
