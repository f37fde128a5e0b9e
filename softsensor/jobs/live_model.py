"""The model a press's live sensor starts from: the promoted one, brought up to date by the newest fits."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

from daq.press.press_file import Press
from daq.process.config import PressSettings
from daq.records import InputError
from daq.store import Store, StoreUnavailable
from daq.supervision import unexpected
from daq.words import Message, say, spoken
from softsensor.heat.model_file import ModelFile
from softsensor.heat.model_reading import parse_model
from softsensor.jobs.model_in_force import PRESS_FILE, PRESSED_RUNS, brought_up_to_date, with_pressed
from softsensor.jobs.run_fits import PROCESS, write_journal
from softsensor.jobs.sisters import begin_with_sisters

LOG = logging.getLogger("kerntemp.sense")
LOOK_S = 1.0
"""How often for a promoted model. By hand, 2026-11. [s]"""


@dataclass
class LiveModel:
    """What the store says a press's sensor starts from, looked at again and again."""

    store: Store
    settings: PressSettings
    press: Press
    alarm: Callable[[Message], None]
    """Takes why a model in force is not taken."""
    file: ModelFile | None = None
    base: str = ""
    """The promoted version behind it, `PRESS_FILE` where there is none; empty before the first look."""
    problem: Message | None = None
    """Why the model in force is not the one that is used."""
    _rests_on: tuple[str | None, int] = (None, 0)
    """Promoted model and newest fit, of any press, behind `file`; no text before the first look."""
    _looked: float = -math.inf

    @property
    def version(self) -> str:
        """Of the model in use; empty without one."""
        return self.file.version if self.file else ""

    def look_again(self) -> None:
        """Have the next look be now."""
        self._looked = -math.inf

    def look(self, now: float, busy: str) -> None:
        """Take the model in force; one that nobody can take leaves the one before, and is reported."""
        if now - self._looked <= LOOK_S:
            return
        self._looked = now
        try:
            self.refresh(busy)
        except StoreUnavailable:
            raise
        except Exception as error:
            self.base = self.base or PRESS_FILE
            why = spoken(error) if isinstance(error, InputError) else unexpected(error)
            problem = say("sense-model-not-taken", version=self.base, why=why)
            if problem != self.problem:
                LOG.exception("%s", problem)
                self.alarm(problem)
            self.problem = problem
        else:
            self.problem = None

    def refresh(self, busy: str = "") -> None:
        """Take the promoted model and the newest fits made with it, without those of a run being pressed."""
        name = self.settings.name
        active = self.store.active_model(name)
        rests_on = (active.version if active else "", self.store.newest_fit_number())
        promoted, fit = self._rests_on
        if promoted == rests_on[0] and self.store.newest_fit_number(name, after=fit) == 0:
            self._rests_on = rests_on
            return
        base: ModelFile | None = None
        if active is not None:
            base = parse_model(active.model, f"model {active.version}")
        elif self.settings.sisters:
            base = begin_with_sisters(self.store, name, self.press, PROCESS)
        runs = [r for r in self.store.runs(press=name, limit=PRESSED_RUNS).items if r.run != busy]
        version = base.version if base is not None else PRESS_FILE
        if self.base not in ("", version):
            write_journal(self.store, "info", say("sense-takes-model", version=version), name)
        self.base = version
        file = brought_up_to_date(self.store, self.press, base, [r.run for r in runs])
        self.file = None if file is None else with_pressed(file, (r.header for r in runs))
        self._rests_on = rests_on
