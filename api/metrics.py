"""Numbers for Prometheus, read from the store when asked."""

from __future__ import annotations

from datetime import datetime

from prometheus_client import CollectorRegistry, Counter, Gauge, generate_latest

from api.answers import press_now
from api.health import health_of
from daq.records import Quality
from daq.store.store import Store

STATES = ("idle", "open", "closed", "unknown")


def metrics_text(store: Store, now: datetime) -> str:
    """Return all metrics in the text format."""
    registry = CollectorRegistry()
    health = health_of(store, now)
    up = Gauge("kerntemp_process_up", "1 while the process beats", ["process"], registry=registry)
    age = Gauge("kerntemp_process_age_seconds", "Since its last beat", ["process"], registry=registry)
    for process in health.processes:
        up.labels(process.name).set(process.alive)
        if process.age_s is not None:
            age.labels(process.name).set(process.age_s)
    Gauge("kerntemp_alarms", "Alarms that stand", registry=registry).set(len(health.alarms))
    if health.store.size_bytes is not None and health.store.free_bytes is not None:
        Gauge("kerntemp_store_bytes", "Size of the store", registry=registry).set(health.store.size_bytes)
        Gauge("kerntemp_store_free_bytes", "Free on its disk", registry=registry).set(health.store.free_bytes)
    _add_presses(store, now, registry)
    return generate_latest(registry).decode()


def _add_presses(store: Store, now: datetime, registry: CollectorRegistry) -> None:
    label = ["press"]
    state = Gauge("kerntemp_press_state", "1 for the state the press is in", ["press", "state"], registry=registry)
    core = Gauge("kerntemp_core_celsius", "Predicted core temperature", label, registry=registry)
    core_sd = Gauge("kerntemp_core_sd_kelvin", "Its standard deviation", label, registry=registry)
    scans = Counter("kerntemp_scans", "Scans stored", label, registry=registry)
    channel = Gauge("kerntemp_channel_celsius", "Last good reading", ["press", "channel"], registry=registry)
    good = Gauge("kerntemp_channel_good", "1 while the channel is good", ["press", "channel"], registry=registry)
    for name, press_file in store.presses().items():
        press = press_now(store, name, press_file, now)
        for candidate in STATES:
            state.labels(name, candidate).set(press.state == candidate)
        scans.labels(name).inc(store.newest_scan_number(name) + 1)
        if press.estimate and press.estimate.valid and press.estimate.core_C is not None:
            core.labels(name).set(press.estimate.core_C)
            core_sd.labels(name).set(press.estimate.core_sd_K or 0.0)
        for item in press.channels:
            usable = Quality(item.quality).usable
            good.labels(name, item.name).set(usable)
            if usable and item.temperature_C is not None:
                channel.labels(name, item.name).set(item.temperature_C)
