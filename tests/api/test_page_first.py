"""The page is there before what its first view does not need."""

import subprocess
import sys

import pytest

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
