"""Several presses: one configuration, one store on PostgreSQL, one page."""

from __future__ import annotations

import json
import threading
import time
from contextlib import ExitStack
from typing import Any
from urllib.request import urlopen

import numpy as np

from api.http.server import Listening, address_of, make_server
from api.http.tokens import TokenFile
from daq.files.run_file import toml_value
from daq.process.config import load_config
from daq.recording.recorder import record
from daq.simulated.campaign import press_toml
from daq.simulated.devices import simulated, wiring
from daq.simulated.press import VirtualPress, VirtualPressSettings
from daq.store import RunStatus, Store, open_store
from tests.patience import wait_until

COLUMNS = (
    "platen_top",
    "platen_bottom",
    *(f"top_{i}" for i in range(1, 8)),
    *(f"bottom_{i}" for i in range(1, 8)),
)
SPEED = 20.0


def answer(address: str) -> dict[str, Any]:
    with urlopen(address) as reply:
        return dict(json.load(reply))


def has_run(store: Store, press: str, recorder: threading.Thread) -> bool:
    assert recorder.is_alive(), "the recorder ended"
    return bool(store.runs(press=press, status=RunStatus.CLOSED).items)


def test_two_presses_are_recorded_by_one_process_into_one_database_and_shown_on_one_page(tmp_path, postgresql_url):
    began = time.monotonic()
    presses = {
        name: VirtualPress(VirtualPressSettings(between_s=(12.0, 16.0), keep=40), seed)
        for name, seed in (("north", 3), ("south", 8))
    }
    for press in presses.values():
        press.cycle(0.0)  # solved before a logger asks

    def clock() -> float:
        return (time.monotonic() - began) * SPEED

    (tmp_path / "press.toml").write_text(press_toml())
    text = f"[store]\nurl = {toml_value(postgresql_url)}\n[clock]\nspeed = {SPEED}\n"
    with ExitStack() as stack:
        for name, press in presses.items():

            def shown(now_s: float, press: VirtualPress = press) -> list[float]:
                temperatures = press.temperatures(max(now_s, 0.0))
                return [temperatures[column] for column in COLUMNS]

            server = stack.enter_context(simulated("labjack-t7", shown, clock=clock, refresh_s=0.0))
            table = wiring("labjack-t7", server, "all", COLUMNS)
            text += f'[[press]]\nname = "{name}"\nfile = "press.toml"\nrate_hz = 1.0\n'
            text += 'header = { "panel.material" = "MDF", "panel.thickness_mm" = 16.0 }\n[[press.logger]]\n'
            text += "".join(f"{key} = {toml_value(value)}\n" for key, value in table.items())
        (tmp_path / "kerntemp.toml").write_text(text)
        store = stack.enter_context(open_store(postgresql_url))
        stop = threading.Event()
        thread = threading.Thread(
            target=record, args=(load_config(tmp_path / "kerntemp.toml"),), kwargs={"stop": stop}
        )
        thread.start()
        try:
            for name in presses:
                wait_until(lambda press=name: has_run(store, press, thread))
        finally:
            stop.set()
            thread.join(240)
        for name in presses:
            run = store.load_run(store.runs(press=name, status=RunStatus.CLOSED).items[-1].run)
            assert set(run.columns) == set(COLUMNS)
            assert all(np.isfinite(values).any() for values in run.columns.values())  # a busy machine misses scans
        listening = Listening(port=0)
        bound = listening.bind()
        server = make_server(store, TokenFile(tmp_path / "tokens.json"), listening)
        serving = threading.Thread(target=server.run, kwargs={"sockets": [bound]})
        serving.start()
        try:
            page = address_of(bound, tls=False) + "api/v1"
            assert [item["press"] for item in answer(f"{page}/press")["items"]] == ["north", "south"]
            assert {item["press"] for item in answer(f"{page}/runs")["items"]} == {"north", "south"}
        finally:
            server.should_exit = True
            serving.join(240)
