"""The page is there before what its first view does not need."""

import asyncio
import subprocess
import sys
from types import SimpleNamespace

import pytest

from api.http import app
from daq.store.store import open_store

SERVED = """
import asyncio, sys
from pathlib import Path
from api.http import app
from api.http.tokens import TokenFile
from daq.store.store import open_store
app.BEHIND_S = float(sys.argv[2])

async def served(page):
    async with page.router.lifespan_context(page):
        while not app.BEHIND_S and "softsensor.jobs.model_in_force" not in sys.modules:
            await asyncio.sleep(0.02)

folder = Path(sys.argv[1])
with open_store(str(folder / "kerntemp.sqlite")) as store:
    asyncio.run(served(app.create_app(store, TokenFile(folder / "tokens.json"))))
print("numba" in sys.modules)
"""


@pytest.mark.parametrize(("behind_s", "loaded"), [("3600", "False"), ("0", "True")])
def test_what_solves_the_heat_is_loaded_behind_the_page_and_not_waited_for_at_its_end(tmp_path, behind_s, loaded):
    command = [sys.executable, "-c", SERVED, str(tmp_path), behind_s]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.stdout.split() == [loaded], done.stderr


def test_what_cannot_be_loaded_behind_the_page_is_logged_and_the_server_ends_in_order(
    tmp_path, monkeypatch, caplog
):
    def broken(name):
        raise ImportError(f"{name} is gone")

    monkeypatch.setattr(app, "BEHIND_S", 0.0)
    monkeypatch.setattr(app, "import_module", broken)
    closed = []

    async def serve(store):
        async with app._serving(store, SimpleNamespace(close=lambda: closed.append(True))):
            while not caplog.records:
                await asyncio.sleep(0.01)

    with open_store(str(tmp_path / "kerntemp.sqlite")) as store:
        asyncio.run(serve(store))
    assert "softsensor.jobs.drift is gone" in caplog.text
    assert closed == [True]
