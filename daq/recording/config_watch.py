"""A changed configuration, or a changed file that it names, is noticed while recording, and handed to the presses.

What it is on may be a network drive that hangs, or a pipe that nobody writes into: reading it has a thread of its
own, on which nothing else waits, and the presses go on with what they have.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path

from daq.process.config import Config, load_config
from daq.recording.press_line import Journal, PressLine
from daq.records import InputError
from daq.supervision import BEAT_S, Steps
from daq.words import Message, say, spoken


class ConfigWatch:
    """Notices a changed configuration or file it names; each press takes it over between its runs."""

    def __init__(self, config: Config, journal: Journal) -> None:
        self._config, self._journal = config, journal
        self._stamps = _changed(config)
        self.steps = Steps("configuration")

    def work(self, lines: Sequence[PressLine], stop: threading.Event) -> None:
        """Until stopped: look every `BEAT_S`."""
        while not stop.wait(BEAT_S):
            with self.steps.step():
                self.look(lines)

    def stalled(self) -> Message | None:
        """Return that a file does not come to its end; None while all are read."""
        return None if self.steps.stalled() is None else say("configuration-stalled", file=str(self._config.path))

    def look(self, lines: Sequence[PressLine]) -> None:
        """Hand a changed configuration to the presses; a wrong one is reported once and left."""
        if self._config.path is None or (now := _changed(self._config)) == self._stamps:
            return
        self._stamps = now
        try:
            fresh = load_config(self._config.path)
            self._refuse_what_needs_a_start(fresh)
            for line in lines:
                line.change(fresh.press_named(line.settings.name), fresh.text)
        except (InputError, OSError) as error:  # also a folder that may not be read, a share that is away
            self._journal("warning", say("configuration-refused", why=spoken(error)))
            return
        self._config = fresh
        stamps = _changed(fresh)  # of a file known before, as it was when this configuration was read
        self._stamps = stamps | {file: at for file, at in now.items() if file in stamps}
        self._journal("info", say("configuration-changed"))

    def _refuse_what_needs_a_start(self, fresh: Config) -> None:
        """Refuse what cannot change under way, before any press has taken anything over."""
        now, then = self._config, fresh
        changed = [
            Message(what)
            for what, differs in (
                ("needs-start-store", (now.store.url, now.store.buffer) != (then.store.url, then.store.buffer)),
                ("needs-start-clock", now.clock != then.clock),
                ("needs-start-presses", [p.name for p in now.press] != [p.name for p in then.press]),
            )
            if differs
        ]
        if changed:
            raise InputError(say("configuration-needs-start", file=str(fresh.path), changed=tuple(changed)))


def _files(config: Config) -> list[Path]:
    """Return the configuration's file and those that it names."""
    loggers = [logger for press in config.press for logger in press.logger]
    profiles = [Path(logger.profile) for logger in loggers if logger.profile.endswith(".toml")]
    named = [config.path, *(p.file for p in config.press), *(logger.calibration for logger in loggers)]
    return [file for file in (*named, *profiles) if file]


def _changed(config: Config) -> dict[Path, int]:
    return {file: _changed_ns(file) for file in _files(config)}


def _changed_ns(file: Path) -> int:
    """Return when a file was changed, 0 where it is not there or cannot be looked at. [ns]"""
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return 0
