"""A real store with recorded, imported and fitted pressings, and a real server over it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import uvicorn

from api.http.app import create_app
from api.http.tokens import TokenFile
from daq.records import Channel, PressEvent, PressEventKind, Quality, Run, Scan
from daq.simulated.campaign import Plan, Truth, make_campaign
from daq.store.records import NewRun, RunEnd, StoredEstimate, StoredNight
from daq.store.store import Store, open_store
from daq.words import say
from tests.curves import CURVES
from tests.patience import wait_until

LAB = (Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml").read_text(encoding="utf-8")
STARTED = datetime(2026, 3, 4, 7, 0, tzinfo=UTC)
COEFFICIENTS = ("h_p_o", "h_p_c", "h_pp_o", "h_pp_c", "h_wa", "h_ap")


NIGHT = {
    "runs": 2,
    "new": 2,
    "fitted": 1,
    "not_fitted": 1,
    "blind": 0,
    "later": 0,
    "left_out": [{"run": "lab-2026-03-04-02", "why": say("run-fit-killed", run="lab-2026-03-04-02").to_json()}],
    "seconds": 51.5,
    "memory_bytes": None,
    "verdict": "named",
    "named": ["edge_loss"],
    "promoted": "",
    "refused": "2",
    "version": "1",
    "reason": say("night-too-few-to-judge").to_json(),
}


@pytest.fixture(scope="session")
def campaign() -> list[tuple[Run, Truth]]:
    return make_campaign(7, 3, plan=Plan(rate_hz=5.0, closed_column=False, thickness_mm=16.0))


def record(store: Store, run: Run, truth: Truth, name: str, start: datetime, *, finish: bool = True) -> None:
    """Write a run as recorder and live sensor do: scans, events, estimates."""
    channels = tuple(Channel(c) for c in run.columns)
    key = store.register_press("lab", channels, LAB)
    table = np.stack(list(run.columns.values()), axis=1)
    zero = 1000.0 * key.next_number
    scans = [
        Scan(
            key.next_number + i,
            start + timedelta(seconds=float(t)),
            zero + float(t),
            tuple(table[i].tolist()),
            tuple(Quality.GOOD if np.isfinite(v) else Quality.OPEN for v in table[i]),
        )
        for i, t in enumerate(run.time_s)
    ]
    moments = truth.moments
    store.append_scans(key, scans[:1], begin=NewRun(name, key.next_number, start, zero, run.header))
    kinds = {
        PressEventKind.INSERTED: moments.inserted_s,
        PressEventKind.CLOSED: moments.closed_s,
        PressEventKind.OPENED: moments.opened_s,
    }
    events = [PressEvent(kind, zero + t, zero + t + 0.4) for kind, t in kinds.items() if np.isfinite(t)]
    store.append_scans(key, scans[1:], events)
    store.append_estimates("lab", [estimate(scan, float(c)) for scan, c in zip(scans, truth.core_C, strict=True)])
    if finish:
        store.append_scans(key, [], end=RunEnd(name, scans[-1].number, scans[-1].utc))


def estimate(scan: Scan, core: float) -> StoredEstimate:
    return StoredEstimate(
        scan.number, scan.monotonic_s, "closed", core, 0.8, core - 1.6, core + 1.6, True, "", "test"
    )


def fit_of(run: str, seed: int) -> dict[str, object]:
    rng = np.random.default_rng(seed)
    values = dict(zip(COEFFICIENTS, rng.uniform(10, 900, 6).round(2).tolist(), strict=True))
    return {
        "run": run,
        "converged": True,
        "coefficients": {
            name: {"value": v, "sd": v / 20, "ci95": [v * 0.9, v * 1.1], "identifiable": name != "h_wa"}
            for name, v in values.items()
        },
        "rmse_K": 0.31,
        "rmse_closed_K": 0.35,
        "initial_rmse_K": 4.2,
        "seconds": 0.2,
        "closed_s": 12.0,
        "opened_s": 70.0,
        "warnings": [],
    }


@pytest.fixture
def make_estimate() -> Callable[[Scan, float], StoredEstimate]:
    return estimate


@pytest.fixture
def make_fit() -> Callable[[str, int], dict[str, object]]:
    return fit_of


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, campaign: list[tuple[Run, Truth]]) -> Iterator[Store]:
    """Two finished pressings with fits, one running, a model, a diagnosis, an alarm."""
    with open_store(str(tmp_path_factory.mktemp("store") / "kerntemp.sqlite")) as opened:
        for i, (run, truth) in enumerate(campaign):
            name = f"lab-2026-03-04-0{i + 1}"
            record(opened, run, truth, name, STARTED + timedelta(minutes=10 * i), finish=i < 2)
            if i < 2:
                opened.put_fit(name, fit_of(name, i), "1")
        model = {
            "version": "1",
            "press": "lab",
            "coefficients": {name: {"value": 100.0, "sd": 5.0} for name in COEFFICIENTS},
            "effects": [],
            "covariance": [],
        }
        opened.put_model("lab", "1", model, status="promoted", reason="first")
        opened.put_model("lab", "2", {**model, "version": "2"}, status="candidate", reason="extended")
        opened.put_diagnosis("lab", {"verdict": "no_effect", "effects": [], "candidates": [], "curves": CURVES})
        ended = datetime.now(UTC)
        opened.put_night(StoredNight("lab", ended - timedelta(seconds=52), ended, NIGHT, {}))
        opened.log("alarm", "record", "logger platens: no reply in 2 s", "lab")
        opened.beat("record", {"state": "running"})
        yield opened


class Server(uvicorn.Server):
    """Uvicorn in a thread, on a port of its own choice."""

    url = ""

    def run_in_thread(self) -> threading.Thread:
        thread = threading.Thread(target=self.run, daemon=True)
        thread.start()
        wait_until(lambda: self.started)
        port = self.servers[0].sockets[0].getsockname()[1]
        self.url = f"http://127.0.0.1:{port}"
        return thread


@pytest.fixture(scope="module")
def tokens(tmp_path_factory: pytest.TempPathFactory) -> TokenFile:
    return TokenFile(tmp_path_factory.mktemp("tokens") / "tokens.json")


@pytest.fixture(scope="module")
def serve_any(tokens: TokenFile) -> Iterator[Callable[..., str]]:
    """Start servers over any store; returns their addresses."""
    running: list[tuple[Server, threading.Thread]] = []

    def start(store: Store, **options: Any) -> str:
        app = create_app(store, tokens, **options)
        server = Server(uvicorn.Config(app, port=0, log_level="warning", timeout_graceful_shutdown=1))
        running.append((server, server.run_in_thread()))
        return server.url

    yield start
    for server, thread in running:
        server.should_exit = True
        thread.join(10)


@pytest.fixture(scope="module")
def serve(store: Store, serve_any: Callable[..., str]) -> Callable[..., str]:
    """Start servers over the store; returns their addresses."""
    return partial(serve_any, store)


@pytest.fixture(scope="module")
def client(serve: Callable[..., str]) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=serve(), timeout=240) as opened:
        yield opened
