"""`kerntemp check` looks at the place in which scans wait while a server is away."""

import subprocess
from contextlib import suppress
from pathlib import Path

import pytest

from api.cli import main
from daq.store.buffer import Buffer
from tests.daq.test_store_outbox import small_disk  # noqa: F401

CONFIG = """
[store]
url = "{url}"
buffer = "{buffer}"
[[press]]
name = "lab"
file = "press.toml"
rate_hz = 10.0
[[press.logger]]
name = "platens"
profile = "generic"
port = "{host}"
channels = ["platen_top", "platen_bottom", "top_1", "bottom_1"]
"""
PRESS_FILE = Path(__file__).parents[2] / "deploy" / "presses" / "lab.toml"


@pytest.fixture
def check(tmp_path, postgresql_url, capsys):
    """Run the check with a buffer at a place; returns its status and what it wrote."""

    def run(buffer, url=postgresql_url):
        path = tmp_path / "kerntemp.toml"
        (tmp_path / "press.toml").write_text(PRESS_FILE.read_text())
        path.write_text(CONFIG.format(url=url, buffer=buffer, host="/dev/null"))
        status = main(["check", "--offline", "--config", str(path)])
        return status, *capsys.readouterr()

    return run


def left_in(folder):
    return sorted(one.name for one in folder.iterdir())


def test_a_place_that_takes_scans_is_told_with_its_room_and_nothing_is_left_there(check, tmp_path):
    folder = tmp_path / "local"
    folder.mkdir()
    status, out, err = check(folder / "b.sqlite")
    assert (status, err) == (0, "")
    assert f"buffer {folder / 'b.sqlite'}: can be written, room for " in out
    assert left_in(folder) == []
    Buffer(folder / "b.sqlite")
    assert check(folder / "b.sqlite")[0] == 0
    assert [name for name in left_in(folder) if "check" in name] == []


def test_a_folder_that_is_missing_or_a_place_that_is_a_folder_is_named_with_what_to_do(check, tmp_path):
    status, _, err = check(tmp_path / "gone" / "b.sqlite")
    assert status == 2
    assert err.count("\n") == 1
    assert f"store.buffer = {tmp_path / 'gone' / 'b.sqlite'}: folder {tmp_path / 'gone'} does not exist" in err
    assert "create it" in err
    assert not (tmp_path / "gone").exists()
    status, _, err = check(tmp_path)
    assert status == 2
    assert f"store.buffer = {tmp_path}: is a folder" in err


@pytest.mark.parametrize("spoilt", ["full", "read-only"])
def test_a_disk_that_takes_nothing_is_named_with_what_to_do(check, small_disk, spoilt):  # noqa: F811
    buffer = small_disk / "b.sqlite"
    if spoilt == "full":
        with (small_disk / "ballast").open("ab", buffering=0) as file, suppress(OSError):
            while file.write(b"x" * 512) == 512:
                pass
    else:
        subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    try:
        status, _, err = check(buffer)
    finally:
        subprocess.run(["mount", "-o", "remount,rw", str(small_disk)], check=True)
    assert status == 2
    assert err.count("\n") == 1
    assert f"store.buffer = {buffer}: " in err
    assert "the space on its disk, or give another file" in err
    assert [name for name in left_in(small_disk) if "b.sqlite" in name] == []


def test_a_store_in_a_file_needs_no_buffer(check, tmp_path):
    status, out, _ = check(tmp_path / "gone" / "b.sqlite", url="s.sqlite")
    assert status == 0
    assert "buffer" not in out
