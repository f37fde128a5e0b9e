"""Numbers for Prometheus, read from the store when asked. Alarms and a dashboard: `deploy/monitoring`."""

from __future__ import annotations

from collections import Counter as Counted
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, generate_latest

from api.answers.health import WANTED, duty_of, health_of, installed_version, is_missed, refit_age_s
from api.answers.records import press_now
from api.answers.schemas import Health, PressNow
from daq.records import Quality
from daq.store.records import StoredNight, StoreUnavailable
from daq.store.store import Store
from daq.supervision import IN_USE_S

STATES = ("idle", "open", "closed", "unknown")


def metrics_text(store: Store, now: datetime) -> str:
    """Return all metrics in the text format; without a store, only that there is none."""
    registry = CollectorRegistry()
    Gauge("kerntemp_info", "Version of Kerntemp", ["version"], registry=registry).labels(installed_version()).set(
        1
    )
    up = Gauge("kerntemp_store_up", "1 while the store answers", registry=registry)
    try:
        health = health_of(store, now)
        presses = {name: press_now(store, name, text, now) for name, text in store.presses().items()}
        scans = {name: store.newest_scan_number(name) + 1 for name in presses}
        models = {name: store.active_model(name) for name in presses}
        refit_s = refit_age_s(store, store.statuses(), now)
        nights = store.newest_nights()
    except StoreUnavailable:
        up.set(0)
        return generate_latest(registry).decode()
    up.set(health.status != "down")
    _add_health(health, refit_s, registry)
    _add_presses(presses, scans, now, registry)
    _add_nights(nights, now, registry)
    known = Gauge("kerntemp_model_info", "1 for the model in force", ["press", "version"], registry=registry)
    for name, model in models.items():
        if model is not None:
            known.labels(name, model.version).set(1)
    return generate_latest(registry).decode()


def _add_health(health: Health, refit_s: float | None, registry: CollectorRegistry) -> None:
    up = Gauge("kerntemp_process_up", "1 while the process beats", ["process"], registry=registry)
    age = Gauge("kerntemp_process_age_seconds", "Since its last beat", ["process"], registry=registry)
    for process in health.processes:
        switched_off = duty_of(process.name) in WANTED and not process.alive and not is_missed(process)
        if process.state != "done" and not switched_off:  # a job that came to its end is not down
            up.labels(process.name).set(process.alive)
        if process.age_s is not None:
            age.labels(process.name).set(process.age_s)
    if refit_s is not None:
        age.labels("refit").set(refit_s)  # also before it ever came to its end
    Gauge("kerntemp_alarms", "Alarms that stand", registry=registry).set(len(health.alarms))
    if health.store.size_bytes is not None and health.store.free_bytes is not None:
        Gauge("kerntemp_store_bytes", "Size of the store", registry=registry).set(health.store.size_bytes)
        Gauge("kerntemp_store_free_bytes", "Free on its disk", registry=registry).set(health.store.free_bytes)
    if (archive := health.store.archive) is not None:
        Gauge("kerntemp_archive_bytes", "Size of the archive", registry=registry).set(archive.bytes)
        Gauge("kerntemp_archive_unsound", "Files missing or damaged", registry=registry).set(archive.unsound)
    beats = [(duty_of(process.name), process.details) for process in health.processes]
    _add_recorders([details for kind, details in beats if kind == "record"], registry)
    behind = Gauge("kerntemp_sense_behind_scans", "Scans without estimate yet", ["press"], registry=registry)
    for press in (p for kind, details in beats if kind == "sense" for p in details.get("presses", [])):
        behind.labels(press["press"]).set(press.get("behind_scans", 0))


def _add_recorders(recorders: Sequence[Mapping[str, Any]], registry: CollectorRegistry) -> None:
    """What the recorders' last signs of life say of loggers, late scans and what waits for the store."""
    waiting = Gauge("kerntemp_record_waiting", "Scans and entries that wait for the store", registry=registry)
    waiting.set(sum(recorder.get("waiting", 0) for recorder in recorders))
    missed = Counter("kerntemp_missed_scans", "Scans due and not made", ["press"], registry=registry)
    for press in (p for recorder in recorders for p in recorder.get("presses", [])):
        missed.labels(press["press"]).inc(press.get("missed_ticks", 0))
    label = ["press", "logger"]
    up = Gauge("kerntemp_logger_up", "1 while the logger answers", label, registry=registry)
    replies = Counter("kerntemp_logger_replies", "Replies by outcome", [*label, "outcome"], registry=registry)
    for logger in (x for recorder in recorders for x in recorder.get("loggers", [])):
        up.labels(logger["press"], logger["name"]).set(logger.get("state") != "lost")
        for outcome, count in logger.get("counters", {}).items():
            replies.labels(logger["press"], logger["name"], outcome).inc(count)


def _add_nights(nights: Mapping[str, StoredNight], now: datetime, registry: CollectorRegistry) -> None:
    """What the newest night did for each press."""
    label = ["press"]
    age = Gauge("kerntemp_night_age_seconds", "Since the press's last night ended", label, registry=registry)
    took = Gauge("kerntemp_night_seconds", "How long it took", label, registry=registry)
    memory = Gauge("kerntemp_night_memory_bytes", "The most memory it held", label, registry=registry)
    runs = Gauge("kerntemp_night_runs", "Runs by what became of them", ["press", "what"], registry=registry)
    named = Gauge("kerntemp_night_named", "1 for each effect named", ["press", "effect"], registry=registry)
    judged = Gauge(
        "kerntemp_night_model", "1 for a model promoted or refused", ["press", "what"], registry=registry
    )
    failed = Gauge("kerntemp_night_failed", "1 where the night did not come to its end", label, registry=registry)
    out = Gauge(
        "kerntemp_night_left_out",
        "Runs that this night could not fit, the first 50, by the reason's code",
        ["press", "why"],
        registry=registry,
    )
    for name, night in nights.items():
        content = night.night
        failed.labels(name).set(content["verdict"] == "failed")
        for why, count in Counted(_code(one["why"]) for one in content["left_out"]).items():
            out.labels(name, why).set(count)
        age.labels(name).set(max((now - night.ended_utc).total_seconds(), 0.0))
        took.labels(name).set(content["seconds"])
        if content["memory_bytes"] is not None:
            memory.labels(name).set(content["memory_bytes"])
        for what in ("runs", "new", "fitted", "not_fitted", "blind", "later"):
            runs.labels(name, "stored" if what == "runs" else what).set(content[what])
        for what in ("archived", "pressings_only", "archive_later"):
            runs.labels(name, what).set(content.get(what, 0))  # nights of older versions had no archive
        for effect in content["named"]:
            named.labels(name, effect).set(1)
        for what in ("promoted", "refused"):
            judged.labels(name, what).set(bool(content[what]))


def _code(reason: Mapping[str, Any]) -> str:
    """Return the code of the innermost reason of why a run was left out."""
    inner = reason["arguments"].get("why")
    return _code(inner) if isinstance(inner, dict) else str(reason["code"])


def _add_presses(
    presses: Mapping[str, PressNow], scans: Mapping[str, int], now: datetime, registry: CollectorRegistry
) -> None:
    label = ["press"]
    state = Gauge("kerntemp_press_state", "1 for the state the press is in", ["press", "state"], registry=registry)
    core = Gauge("kerntemp_core_celsius", "Predicted core temperature", label, registry=registry)
    core_sd = Gauge("kerntemp_core_sd_kelvin", "Its standard deviation", label, registry=registry)
    stored = Counter("kerntemp_scans", "Scans stored", label, registry=registry)
    age = Gauge("kerntemp_scan_age_seconds", "Since the newest scan", label, registry=registry)
    channel = Gauge("kerntemp_channel_celsius", "Last good reading", ["press", "channel"], registry=registry)
    good = Gauge("kerntemp_channel_good", "1 while the channel is good", ["press", "channel"], registry=registry)
    for name, press in presses.items():
        for candidate in STATES:
            state.labels(name, candidate).set(press.state == candidate)
        stored.labels(name).inc(scans[name])
        newest = max((c.utc for c in press.channels if c.utc is not None), default=None)
        age_s = 0.0 if newest is None else max((now - newest).total_seconds(), 0.0)
        if age_s > IN_USE_S:
            continue
        if newest is not None:
            age.labels(name).set(age_s)
        if press.estimate and press.estimate.valid and press.estimate.core_C is not None:
            core.labels(name).set(press.estimate.core_C)
            core_sd.labels(name).set(press.estimate.core_sd_K or 0.0)
        for item in press.channels:
            usable = Quality(item.quality).usable
            good.labels(name, item.name).set(usable)
            if usable and item.temperature_C is not None:
                channel.labels(name, item.name).set(item.temperature_C)
