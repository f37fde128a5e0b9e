"""Rehearsals of a campaign's diagnosis on all cores or on Dask, which go on where they were broken off."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from daq.records import InputError
from daq.words import say
from softsensor.diagnosis.rehearsal import (
    NOTHING,
    Campaign,
    Hidden,
    Outcome,
    Rehearsal,
    rehearsal_of,
    rehearse_one,
)
from softsensor.jobs.cluster import handed_out

# Numbers without another source were set by hand, 2026-11.

CAMPAIGNS = 10
"""Rehearsed campaigns of each cause where nobody says how many: a share of one half is then known to about 0.3."""
COSTLY = 2.0
"""Times a plain diagnosis that one of a hidden cause takes: 2 to 3
were seen on two cores (2026-11)."""


@dataclass(frozen=True)
class RehearsalTask:
    """One campaign to rehearse."""

    hidden: Hidden
    number: int


@dataclass(frozen=True)
class RehearsalPlan:
    """What is to be rehearsed, and what of it an earlier command has done."""

    campaign: Campaign
    tasks: tuple[RehearsalTask, ...]
    done: tuple[Outcome, ...]
    file: Path | None = None

    def minutes(self, seconds: float, workers: int) -> float:
        """Return about how long the rest takes where one diagnosis took so many seconds. [min]"""
        return COSTLY * seconds * len(self.tasks) / workers / 60.0


def plan_rehearsal(
    campaign: Campaign, causes: Sequence[Hidden], count: int = CAMPAIGNS, file: Path | None = None
) -> RehearsalPlan:
    """Lay out so many campaigns of each cause and of none, without those that a file holds already.

    The file keeps a line for each finished one; lines of other campaigns are left alone and do not count.
    """
    tasks = [RehearsalTask(hidden, number) for number in range(count) for hidden in (Hidden(NOTHING), *causes)]
    known = _finished(file, _mark(campaign)) if file is not None else {}
    done = [Outcome(t.hidden, t.number, *known[t.hidden.key, t.number]) for t in tasks if _key(t) in known]
    return RehearsalPlan(campaign, tuple(t for t in tasks if _key(t) not in known), tuple(done), file)


def local_workers(plan: RehearsalPlan) -> int:
    """Return how many processes of this machine a plan can use."""
    return max(1, min(os.cpu_count() or 1, len(plan.tasks)))


def rehearse(
    plan: RehearsalPlan,
    progress: Callable[[int], None] | None = None,
    dask: str = "",
    workers: int | None = None,
) -> Rehearsal:
    """Rehearse what a plan holds on local processes, or on Dask; each finished campaign is kept at once.

    One over which workers were killed is left out, and the answer says how many were.

    Parameters
    ----------
    progress
        Called with the number of campaigns done.
    dask
        Address of a scheduler.
    workers
        Local processes; as many as the machine has cores without.

    Raises
    ------
    InputError
        For a scheduler that does not answer.
    OSError
        For a file that cannot be written.
    """
    done, mark = list(plan.done), _mark(plan.campaign)
    for number, outcome in enumerate(_outcomes(plan, dask, workers), start=len(plan.done) + 1):
        if outcome is not None:
            done.append(outcome)
            if plan.file is not None:
                _keep(plan.file, mark, outcome)
        if progress is not None:
            progress(number)
    lost = len(plan.done) + len(plan.tasks) - len(done)
    return rehearsal_of(plan.campaign, done, lost)


def _outcomes(plan: RehearsalPlan, dask: str, workers: int | None) -> Iterator[Outcome | None]:
    work, local = partial(_rehearse, plan.campaign), local_workers(plan) if workers is None else workers
    return (outcome for _, outcome in handed_out(work, plan.tasks, local, dask))


def _rehearse(campaign: Campaign, task: RehearsalTask) -> Outcome:
    return rehearse_one(campaign, task.hidden, task.number)


def _key(task: RehearsalTask) -> tuple[str, int]:
    return task.hidden.key, task.number


def _mark(campaign: Campaign) -> str:
    """Return by what a campaign is known again: the same runs, press, fit and causes give the same mark."""
    inputs = [
        campaign.press.model_dump_json(),
        repr([(n, f"{v:.6g}") for n, v in sorted(campaign.levels.items())]),
        repr(campaign.testable),
    ]
    digest = hashlib.sha256("".join(inputs).encode())
    for one in campaign.runs:
        digest.update(repr((one.run.name, sorted(one.run.header.items(), key=str))).encode())
        digest.update(one.run.time_s.tobytes())
        for name in sorted(one.run.columns):
            digest.update(name.encode() + one.run.columns[name].tobytes())
    return digest.hexdigest()[:16]


_HEAD = b'{"campaign": '
"""What a line, and so a file of finished campaigns, begins with."""


def check_file(file: Path) -> None:
    """Refuse to keep finished campaigns in a file of something else. Raises `InputError`, or `OSError`."""
    if file.exists():
        with file.open("rb") as content:
            head = content.read(len(_HEAD))
        if not _HEAD.startswith(head):
            raise InputError(say("rehearsal-file-other", path=str(file)))


def _keep(file: Path, mark: str, outcome: Outcome) -> None:
    line = json.dumps({"campaign": mark, "hidden": outcome.hidden.key, **outcome.as_json()})
    with file.open("a", encoding="utf-8") as out:
        out.write("\n" * (out.tell() > 0) + line)


def _finished(file: Path, mark: str) -> dict[tuple[str, int], tuple[str, tuple[tuple[str, ...], ...]]]:
    """Return what a file says of a campaign; a last line torn by the end of its process does not count."""
    found = {}
    for line in file.read_text(encoding="utf-8", errors="replace").splitlines() if file.exists() else ():
        try:
            one = json.loads(line)
            if one["campaign"] == mark:
                sets = tuple(tuple(s) for s in one["sets"])
                found[str(one["hidden"]), int(one["number"])] = (str(one["verdict"]), sets)
        except (ValueError, KeyError, TypeError):
            continue
    return found
