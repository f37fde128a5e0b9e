"""Every channel as it stands: last value, last good one, gaps, and what its logger reports."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from statistics import median
from typing import Any, Literal

from api.answers.decimation import number_or_none
from api.answers.kept import PRESSES, Kept
from api.answers.schemas import ChannelNow, Faces
from daq.records import Channel, Quality, Scan
from daq.store.records import SCANS_AT_ONCE, ProcessStatus
from daq.store.store import Store

LOOK_BACK_SCANS = 36_000
"""Where nobody asked for long, gaps and last good values are sought in this many scans: 1 h at 10 Hz."""
GAPS_OVER = timedelta(hours=1)
Role = Literal["platen", "top", "bottom", "core", "other"]
_ROLES: tuple[Role, ...] = ("platen", "top", "bottom", "core")


def channel_role(channel: str) -> Role:
    """Distinguish platen, face and core channels by the contract's column names."""
    return next((role for role in _ROLES if channel.startswith(role)), "other")


def faces_now(channels: Sequence[ChannelNow]) -> Faces:
    """Return the median of the good sensors at platens and faces."""

    def middle(start: str) -> float | None:
        good = [
            c.temperature_C
            for c in channels
            if c.name.startswith(start)
            and c.temperature_C is not None
            and c.left_out_K is None
            and Quality(c.quality).usable
        ]
        return round(median(good), 3) if good else None

    return Faces(
        platen_top_C=middle("platen_top"),
        platen_bottom_C=middle("platen_bottom"),
        top_C=middle("top"),
        bottom_C=middle("bottom"),
    )


@dataclass
class _Watch:
    """One press's channels, followed scan by scan."""

    newest: int = -1
    last_good: dict[str, datetime] = field(default_factory=dict)
    gaps: deque[tuple[datetime, Counter[str]]] = field(default_factory=deque)
    """Minute by minute, scans in which a channel had no usable value."""
    lock: threading.Lock = field(default_factory=threading.Lock)

    def look(self, store: Store, press: str, newest: int) -> None:
        """Take in what was stored since the last look."""
        with self.lock:
            self.newest = max(self.newest, newest - LOOK_BACK_SCANS)
            while self.newest < newest:
                batch = store.scans_after(press, self.newest, SCANS_AT_ONCE)
                if not batch.scans:
                    return
                names = [channel.name for channel in batch.channels]
                for scan in batch.scans:
                    self._take(names, scan)
                self.newest = batch.scans[-1].number

    def _take(self, names: Sequence[str], scan: Scan) -> None:
        minute = scan.utc.replace(second=0, microsecond=0)
        for name, quality in zip(names, scan.qualities, strict=True):
            if quality.usable:
                self.last_good[name] = scan.utc
            else:
                if not self.gaps or self.gaps[-1][0] != minute:
                    self.gaps.append((minute, Counter()))
                self.gaps[-1][1][name] += 1
        while self.gaps and self.gaps[0][0] < scan.utc - GAPS_OVER:
            self.gaps.popleft()

    def gap_count(self, name: str) -> int:
        """Return how many scans of the last hour lack this channel."""
        with self.lock:
            return sum(count[name] for _, count in self.gaps)


_WATCHES: Kept[tuple[str, str], _Watch] = Kept(PRESSES)


def _watch_of(store: Store, press: str, newest: int) -> _Watch:
    def same_store(known: _Watch | None) -> _Watch:
        return _Watch() if known is None or newest < known.newest else known  # a new store at the same place

    watch = _WATCHES.renew((store.label, press), same_store)
    watch.look(store, press, newest)
    return watch


def channels_now(
    store: Store,
    press: str,
    channels: Sequence[Channel],
    scan: Scan | None,
    now: datetime,
    left_out: Mapping[str, float],
) -> list[ChannelNow]:
    """Return each channel's last value, what the recorder says about its logger, and whether it is used.

    Parameters
    ----------
    left_out
        Channels the live sensor does not use, and how far they read above their neighbours. [K]
    """
    reported = channel_reports(store.statuses(), press)
    known = channels or store.channels(press)
    names = [channel.name for channel in known]
    values = dict(zip(names, scan.values, strict=True)) if scan else {}
    qualities = dict(zip(names, scan.qualities, strict=True)) if scan else {}
    watch = _watch_of(store, press, scan.number) if scan else _Watch()
    items = []
    for name, unit in ((channel.name, channel.unit) for channel in known):
        report, value = reported.get(name, {}), number_or_none(values.get(name))
        counters = {k: int(v) for k, v in report.get("counters", {}).items() if isinstance(v, int | float)}
        items.append(
            ChannelNow(
                press=press,
                name=name,
                logger=str(report.get("logger", "")),
                role=channel_role(name),
                unit="°C" if unit == "C" else unit,
                value=value,
                temperature_C=value if unit == "C" else None,
                quality=str(qualities.get(name, Quality.MISSING)),
                left_out_K=left_out.get(name),
                utc=scan.utc if scan else None,
                last_good_utc=watch.last_good.get(name),
                age_s=round((now - scan.utc).total_seconds(), 3) if scan else None,
                gaps_last_hour=watch.gap_count(name),
                counters=counters,
            )
        )
    return items


def channel_reports(statuses: Mapping[str, ProcessStatus], press: str) -> dict[str, Mapping[str, Any]]:
    """Return what the recorder's heartbeat says about each channel of a press."""
    reports: dict[str, Mapping[str, Any]] = {}
    for status in statuses.values():
        for logger in status.status.get("loggers", []):
            if isinstance(logger, Mapping) and logger.get("press", press) == press:
                for channel in logger.get("channels", []):
                    reports[str(channel)] = {**logger, "logger": logger.get("name", "")}
    return reports
