"""Install, update, roll back and uninstall a really built wheel below a folder, and run its services by hand."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import time
import tomllib
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.request import urlopen

import pytest

from api.cli import main
from daq.files.run_file import toml_value
from daq.simulated.devices import simulated, wiring
from daq.store import open_store

ROOT = Path(__file__).parents[2]
SETUP = ROOT / "deploy" / "kerntemp_setup.py"
SYSTEMD = ROOT / "deploy" / "systemd"
SOURCES = ("api", "daq", "softsensor", "deploy", "pyproject.toml", "README.md")
COLUMNS = (
    "platen_top",
    "platen_bottom",
    *(f"top_{k}" for k in range(1, 8)),
    *(f"bottom_{k}" for k in range(1, 8)),
)
root_only = pytest.mark.skipif(
    os.name == "nt" or os.geteuid() != 0 or shutil.which("systemd-sysusers") is None,
    reason="installing needs root and systemd-sysusers: run it on Debian as root",
)


@pytest.fixture(scope="module")
def setup() -> ModuleType:
    spec = importlib.util.spec_from_file_location("kerntemp_setup", SETUP)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.in_force.update(module.find_words(module.Place(Path("/nowhere")), None))
    return module


def built(folder: Path, version: str = "", migration: str = "") -> Path:
    """Build the wheel of a copy of the sources, as another version if asked for."""
    source = folder / f"source-{version or 'own'}"
    source.mkdir()
    for name in SOURCES:
        origin = ROOT / name
        if origin.is_dir():
            shutil.copytree(origin, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copyfile(origin, source / name)
    if version:
        text = (source / "pyproject.toml").read_text(encoding="utf-8")
        changed = re.sub(r'^version = ".*"$', f'version = "{version}"', text, count=1, flags=re.M)
        (source / "pyproject.toml").write_text(changed, encoding="utf-8")
    if migration:
        steps = source / "daq" / "store" / "migrations"
        newest = max(int(step.name[:4]) for step in steps.glob("*.sql"))
        (steps / f"{newest + 1:04}_later.sql").write_text(migration)
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(folder)]
    subprocess.run([*command, str(source)], check=True, capture_output=True)
    return next(folder.glob(f"kerntemp-{version or '*'}-py3-none-any.whl"))


def set_up(root: Path, *words: str | Path) -> str:
    command = [sys.executable, str(SETUP), *map(str, words), "--root", str(root), "--no-warmup"]
    callers = {**os.environ, "PYTHONPATH": str(ROOT)}  # which the programs installed must not take over
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=callers)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def start_line(root: Path, unit: str) -> list[str]:
    """Return a unit's ExecStart with its paths below the folder."""
    text = (root / "etc/systemd/system" / unit).read_text()
    line = next(x for x in text.splitlines() if x.startswith("ExecStart=")).removeprefix("ExecStart=")
    return [word if not word.startswith("/") else f"{root}{word}" for word in line.split()]


@contextmanager
def running(root: Path, unit: str, *more: str) -> Iterator[tuple[subprocess.Popen[str], socket.socket]]:
    """Run a service as its unit says; systemd's end of the line comes with it."""
    place = str(root / f"{unit}.notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(place)
        line.settimeout(800)  # the live sensor compiles before it is ready
        values = {"NOTIFY_SOCKET": place, "NUMBA_CACHE_DIR": str(root / "var/cache/kerntemp")}
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")} | values
        log = (root / f"{unit}.log").open("w")
        service = subprocess.Popen(
            [*start_line(root, unit), *more],
            cwd=root / "var/lib/kerntemp",
            env=environment,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            start_new_session=True,
        )
        try:
            yield service, line
            service.send_signal(signal.SIGTERM)
            assert service.wait(240) in (0, -signal.SIGTERM), (root / f"{unit}.log").read_text()
        finally:
            if service.poll() is None:
                os.killpg(service.pid, signal.SIGKILL)
                service.wait()
            assert service.stdout is not None
            service.stdout.close()
            log.close()
    Path(place).unlink()


def heard(line: socket.socket, sign: str) -> str:
    while True:
        message = line.recv(4096).decode()
        if message.startswith(sign):
            return message


def wire(root: Path, stack: ExitStack) -> None:
    """Give the installed configuration simulated loggers."""
    first = stack.enter_context(simulated("exemys-rme1-tc", lambda now_s: [150.0] * 8, refresh_s=0))
    second = stack.enter_context(simulated("exemys-rme1-tc", lambda now_s: [25.0] * 8, refresh_s=0))
    path = root / "etc/kerntemp/kerntemp.toml"
    text = path.read_text(encoding="utf-8")
    head, _, rest = text.partition("[[press.logger]]")
    tail = rest[rest.index("[server]") :]
    for name, server, channels in (("one", first, COLUMNS[:8]), ("two", second, COLUMNS[8:])):
        table = wiring("exemys-rme1-tc", server, name, channels)
        head += "[[press.logger]]\n" + "".join(f"{k} = {toml_value(v)}\n" for k, v in table.items())
    path.write_text(f"{head}\n{tail}", encoding="utf-8")


def rows(store: Path) -> int:
    with closing(sqlite3.connect(store)) as connection:
        return int(connection.execute("SELECT count(*) FROM scan").fetchone()[0])


def record_for_a_moment(root: Path) -> None:
    with running(root, "kerntemp-record.service") as (_, line):
        heard(line, "READY=1")
        heard(line, "WATCHDOG=1")
        heard(line, "WATCHDOG=1")


@root_only
@pytest.mark.campaign
@pytest.mark.timeout(1200)
def test_a_wheel_is_installed_updated_rolled_back_and_removed_and_the_data_stay(tmp_path):
    root = tmp_path / "pc"
    first = built(tmp_path)
    own = first.name.split("-")[1]
    second = built(tmp_path, "7.7.7", "ALTER TABLE run ADD COLUMN later TEXT;\n")
    store = root / "var/lib/kerntemp/kerntemp.sqlite"
    command = root / "usr/local/bin/kerntemp"

    output = set_up(root, "install", first)
    assert f"Kerntemp {own} is installed" in output
    assert "kerntemp:x:" in (root / "etc/passwd").read_text()
    assert (root / "etc/udev/rules.d/60-kerntemp.rules").is_file()
    assert oct((root / "etc/kerntemp/kerntemp.toml").stat().st_mode)[-3:] == "640"
    assert subprocess.run([command, "--version"], capture_output=True, text=True).stdout == f"kerntemp {own}\n"

    with ExitStack() as stack:
        wire(root, stack)
        checked = subprocess.run([command, "check"], capture_output=True, text=True, check=False)
        assert checked.returncode == 0, checked.stderr
        record_for_a_moment(root)
        assert rows(store) > 5
        with running(root, "kerntemp-sense.service") as (_, line):
            heard(line, "READY=1")
            heard(line, "WATCHDOG=1")
        with running(root, "kerntemp-serve.service", "--port", "0") as (page, line):
            heard(line, "READY=1")
            heard(line, "WATCHDOG=1")
            assert page.stdout is not None
            address = page.stdout.readline().split()[-1]
            assert b"Kerntemp" in urlopen(address).read()
            assert urlopen(f"{address}static/vendor/uPlot.iife.min.js").status == 200
        configured = (root / "etc/kerntemp/kerntemp.toml").read_text()
        before = rows(store)

        output = set_up(root, "update", second)
        assert "the store's schema changes" in output
        assert "written and checked" in output
        assert (root / "opt/kerntemp/current").readlink() == Path("7.7.7")
        assert subprocess.run([command, "--version"], capture_output=True, text=True).stdout == "kerntemp 7.7.7\n"
        assert (root / "etc/kerntemp/kerntemp.toml").read_text() == configured
        with closing(sqlite3.connect(store)) as connection:
            assert "later" in [row[1] for row in connection.execute("PRAGMA table_info(run)")]
        record_for_a_moment(root)
        after = rows(store)
        assert after > before

        output = set_up(root, "rollback")
        assert f"Kerntemp {own} is in force again" in output
        assert rows(store) == before
        kept = next((root / "var/lib/kerntemp").glob("kerntemp-7.7.7-*.sqlite"))
        assert rows(kept) == after
        record_for_a_moment(root)
        assert rows(store) > before

    python = root / "opt/kerntemp/current/bin/python"
    scheduler = 'dask = "tcp://scheduler.plant:8786"'
    (root / "etc/kerntemp/kerntemp.toml").write_text(configured.replace("[refit]", f"[refit]\n{scheduler}\n#"))
    assert subprocess.run([python, "-c", "import distributed"], capture_output=True).returncode == 1
    assert "postgresql,dask" in set_up(root, "complete")
    asked = [python, "-c", "from dask.distributed import Client; print(Client.__name__)"]
    assert subprocess.run(asked, capture_output=True, text=True).stdout == "Client\n"
    (root / "etc/kerntemp/kerntemp.toml").write_text(configured)

    set_up(root, "uninstall")
    assert not (root / "opt/kerntemp").exists()
    assert not list((root / "etc/systemd/system").glob("kerntemp*"))
    assert not command.exists()
    assert rows(store) > before
    assert (root / "etc/kerntemp/kerntemp.toml").read_text() == configured


def test_the_setup_speaks_a_third_language_from_its_one_file(setup, tmp_path, monkeypatch):
    monkeypatch.setenv("KERNTEMP_LANGUAGE", "fr")
    wheel = tmp_path / "kerntemp-7.8.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("daq/words/fr.ftl", "setup-installed = Kerntemp { $version } est installé.\n")
    place = setup.Place(tmp_path / "pc")
    assert setup.find_words(place, None)["setup-installed"] == "Kerntemp { $version } is installed."
    monkeypatch.setattr(setup, "in_force", setup.find_words(place, wheel))
    assert setup.words("setup-installed", version="2.0") == "Kerntemp 2.0 est installé."


def test_a_setup_without_any_catalogue_says_its_codes_with_what_they_are_about(setup, tmp_path, monkeypatch):
    monkeypatch.setattr(setup, "HOME", tmp_path / "alone")
    monkeypatch.setattr(setup, "in_force", {})
    assert setup.find_words(setup.Place(tmp_path / "pc"), None) == {}
    assert setup.words("setup-nothing-before") == "setup-nothing-before"
    assert setup.words("setup-use-update", version="2.0") == "setup-use-update: version = 2.0"


@root_only
def test_what_cannot_be_done_is_refused_and_changes_nothing(tmp_path, setup, capsys):
    broken = tmp_path / "kerntemp-1.0-py3-none-any.whl"
    broken.write_bytes(b"no wheel")
    for words, message in (
        (["rollback"], "no version to go back to"),
        (["update", str(broken)], "nothing is installed; use install"),
        (["install", str(broken)], "not a wheel"),
    ):
        assert setup.main([*words, "--root", str(tmp_path / "pc")]) == 1
        assert message in capsys.readouterr().err
    assert not (tmp_path / "pc").exists()


def test_after_a_setup_that_failed_while_compiling_the_same_one_goes_through(setup, tmp_path, monkeypatch):
    wheel = tmp_path / "kerntemp-7.7.9-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("kerntemp-7.7.9.dist-info/METADATA", "Name: kerntemp\nVersion: 7.7.9\n")
    place = setup.Place(tmp_path / "pc")
    made = []

    def environment(folder):
        made.append(folder)
        (folder / "share/kerntemp/presses").mkdir(parents=True)
        (folder / "share/kerntemp/kerntemp.toml").write_text("")

    def compiling(*_):
        if len(made) == 1:
            raise setup.Refused("out of memory while compiling")

    monkeypatch.setattr(setup, "make_environment", environment)
    monkeypatch.setattr(setup, "run", lambda *_, **__: "7.7.9")
    monkeypatch.setattr(setup, "warm_up", compiling)
    for name, does in (("make_user", None), ("switch", None), ("schema_of", 3)):
        monkeypatch.setattr(setup, name, lambda *_, does=does: does)
    with pytest.raises(setup.Refused, match="out of memory"):
        setup.install(place, wheel, None)
    setup.install(place, wheel, None)
    assert [entry["version"] for entry in place.history] == ["7.7.9"]
    with pytest.raises(setup.Refused, match="installed already"):
        setup.put_version(place, wheel, None)
    assert len(made) == 2


@pytest.fixture
def updated(setup, tmp_path, monkeypatch):
    """A folder with two versions, both this one, the later with another schema; what systemd is asked."""
    place = setup.Place(tmp_path)
    for folder in (place.code / "1.0.0", place.code / "2.0.0", place.settings, place.backups):
        folder.mkdir(parents=True)
        (folder / "installed").touch()
    asked = []

    def here(place, version, program, *words):
        if program == "python":
            return setup.run(sys.executable, *words, cwd=place.data)
        with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
            status = main(list(words))
        if status:
            raise setup.Refused(err.getvalue())
        return out.getvalue()

    monkeypatch.setattr(setup, "as_service", here)
    monkeypatch.setattr(setup, "systemctl", lambda _, *words: asked.append(words))
    monkeypatch.setattr(setup, "switch", lambda *_: None)

    def update(url):
        example = (ROOT / "deploy" / "kerntemp.toml").read_text(encoding="utf-8")
        example = example.replace('file = "presses', f'file = "{ROOT}/deploy/presses')
        place.config.write_text(example.replace('url = "kerntemp.sqlite"', f'url = "{url}"'))
        store = setup.store_file(place, "1.0.0")
        with open_store(str(store)) as opened:
            opened.log("info", "test", "before the update")
        backup = setup.back_up(place, "1.0.0", "before-2.0.0")
        with open_store(str(store)) as opened:
            opened.log("info", "test", "after the update")
        first, second = ({"version": f"{n}.0.0", "schema": n, "backup": backup if n == 2 else ""} for n in (1, 2))
        place.remember([first, second])
        return store, backup

    return place, update, asked


def journalled(store: Path) -> list[str]:
    with closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True)) as connection:
        return [row[0] for row in connection.execute("SELECT message FROM event ORDER BY event_id")]


@pytest.mark.parametrize("url", ["{0}/data.sqlite", "sqlite:///{0}/data.sqlite", "data.sqlite"])
def test_a_store_is_backed_up_and_put_back_however_its_place_is_written(setup, updated, url, tmp_path):
    place, update, _ = updated
    store, backup = update(url.format(tmp_path))
    assert store == (place.settings if url == "data.sqlite" else tmp_path) / "data.sqlite"
    assert journalled(Path(backup)) == ["before the update"]
    setup.rollback(place)
    assert journalled(store) == ["before the update"]
    (kept,) = store.parent.glob("kerntemp-2.0.0-*.sqlite")
    assert journalled(kept) == ["before the update", "after the update"]
    assert [entry["version"] for entry in place.history] == ["1.0.0"]


@pytest.mark.parametrize("lost", [True, False], ids=["the copy is gone", "the disk is full"])
def test_a_rollback_that_cannot_restore_changes_nothing_and_recording_goes_on(setup, updated, monkeypatch, lost):
    place, update, asked = updated
    store, backup = update("data.sqlite")
    whole = setup.as_service

    def without_room(place, version, *words):
        if "--restore" in words:
            Path(words[-1]).touch()
            raise setup.Refused("disk is full")
        return whole(place, version, *words)

    if lost:
        Path(backup).unlink()
    else:
        monkeypatch.setattr(setup, "as_service", without_room)
    with pytest.raises(setup.Refused, match="does not exist" if lost else "disk is full"):
        setup.rollback(place)
    assert asked == ([] if lost else [("stop", "kerntemp.target"), ("start", "kerntemp.target")])
    assert [path.name for path in store.parent.glob("*.sqlite*")] == ["data.sqlite"]
    assert journalled(store) == ["before the update", "after the update"]
    assert len(place.history) == 2


def test_an_update_that_meets_a_full_disk_leaves_the_version_before_its_store_and_its_units_at_work(
    setup, updated, monkeypatch, tmp_path
):
    place, update, asked = updated
    store, _ = update("data.sqlite")
    monkeypatch.undo()
    monkeypatch.setattr(setup, "systemctl", lambda _, *words: asked.append(words))
    for version in ("1.0.0", "2.0.0"):
        for name in ("systemd/kerntemp-record.service", "udev/60-kerntemp.rules"):
            file = place.shared(version) / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(version)
    setup.switch(place, "1.0.0")
    place.remember(place.history[:1])
    asked.clear()
    copy = tmp_path / "copy.sqlite"
    copy.write_text("the store of before")
    write = Path.write_bytes

    def full(path, content):
        if "udev" in str(path):
            raise OSError(28, "No space left on device", str(path))
        return write(path, content)

    monkeypatch.setattr(setup, "put_version", lambda *_: "2.0.0")
    monkeypatch.setattr(setup, "warm_up", lambda *_: None)
    monkeypatch.setattr(setup, "schema_of", lambda *_: 2)
    monkeypatch.setattr(setup, "back_up", lambda *_: str(copy))
    monkeypatch.setattr(setup, "store_file", lambda *_: store)
    monkeypatch.setattr(
        setup, "as_service", lambda _, __, *words: shutil.copy(copy, words[-1]) if "--restore" in words else ""
    )
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        setup.update(place, tmp_path / "some.whl", None)
    assert asked == [("stop", "kerntemp.target"), ("restart", "kerntemp.target")]
    assert place.current.readlink() == Path("1.0.0")
    assert {file.read_text() for file in (place.rules, *place.units.iterdir())} == {"1.0.0"}
    assert store.read_text() == "the store of before"
    assert [entry["version"] for entry in place.history] == ["1.0.0"]
    assert not (place.code / "2.0.0").exists()


def test_services_that_do_not_come_up_are_told_with_the_version_in_force(setup, updated, monkeypatch):
    place, _, asked = updated

    def failing(_, *words):
        asked.append(words)
        if "kerntemp-sense.service" in words:
            raise setup.Refused("systemctl failed: see its log")

    monkeypatch.setattr(setup, "systemctl", failing)
    with pytest.raises(
        setup.Refused, match=r"^version 2 is in force, but.*rollback.*: systemctl failed: see its log$"
    ):
        setup.restart(place, "version 2 is in force, but not all of it runs; rollback goes back to 1")
    assert asked[0] == ("restart", "kerntemp-record.service")  # alone: it need not wait for the live sensor's end
    assert ("restart", "kerntemp-sense.service", "kerntemp-serve.service", setup.TIMER) in asked
    assert asked[-1] == ("start", "kerntemp.target")  # a restart of it would restart the recorder again


def test_no_unit_is_restarted_twice_by_an_update(setup, updated, monkeypatch):
    place, _, asked = updated
    monkeypatch.setattr(setup, "systemctl", lambda _, *words: asked.append(words))
    setup.restart(place, "")
    parts = [f.name for f in SYSTEMD.iterdir() if "PartOf=kerntemp.target" in f.read_text(encoding="utf-8")]
    restarted = [unit for verb, *units in asked if verb == "restart" for unit in units]
    if "kerntemp.target" in restarted:
        restarted += parts
    assert len(restarted) == len(set(restarted))
    assert "kerntemp-record.service" in parts


def test_a_configuration_that_the_new_version_refuses_stops_nothing(setup, updated, monkeypatch):
    place, update, asked = updated
    update("data.sqlite")
    place.remember(place.history[:1])
    for name, does in (("put_version", "2.0.0"), ("warm_up", None), ("schema_of", 2)):
        monkeypatch.setattr(setup, name, lambda *_, does=does: does)
    place.config.write_text(place.config.read_text() + "[later]\n")
    with pytest.raises(setup.Refused, match="later"):
        setup.update(place, place.data, None)
    assert asked == []


def test_uninstall_leaves_no_unit_enabled_and_the_drop_ins_of_whoever_runs_the_machine(setup, tmp_path):
    place = setup.Place(tmp_path)
    other, override = place.units / "other.service", place.units / "kerntemp-record.service.d" / "override.conf"
    enabled = (place.units / "multi-user.target.wants", place.units / "kerntemp.target.wants")
    for folder in (*enabled, override.parent):
        folder.mkdir(parents=True)
    for file in (other, override, *(place.units / unit.name for unit in SYSTEMD.iterdir())):
        file.write_text("[Service]\n")
    (enabled[0] / "kerntemp.target").symlink_to(place.units / "kerntemp.target")
    (enabled[1] / setup.PUBLISH).symlink_to(place.units / setup.PUBLISH)
    setup.uninstall(place)
    assert {path for path in place.units.rglob("*") if not path.is_dir()} == {other, override}
    assert not enabled[1].exists()


def test_the_first_configuration_keeps_data_and_tokens_where_services_may_write(setup, tmp_path):
    example = (ROOT / "deploy" / "kerntemp.toml").read_text(encoding="utf-8")
    text = setup.first_configuration(example, Path("/var/lib/kerntemp"))
    tree: dict[str, Any] = tomllib.loads(text)
    assert tree["store"] == {
        "url": "/var/lib/kerntemp/kerntemp.sqlite",
        "buffer": "/var/lib/kerntemp/kerntemp-buffer.sqlite",
    }
    assert tree["server"]["tokens"] == "/var/lib/kerntemp/kerntemp-tokens.json"
    assert tree["refit"]["reports"] == "/var/lib/kerntemp/reports"


def test_dask_is_installed_where_the_configuration_names_a_scheduler(setup, tmp_path, monkeypatch, capsys):
    place = setup.Place(tmp_path)
    assert "dask" not in place.extras, "nothing is configured yet"
    asked = []
    monkeypatch.setattr(setup, "run", lambda *words, **_: asked.append([str(w) for w in words]) or "0.1.0")
    place.settings.mkdir(parents=True)
    place.code.mkdir(parents=True)
    place.remember([{"version": "0.1.0", "schema": 1, "backup": ""}])
    example = (ROOT / "deploy" / "kerntemp.toml").read_text(encoding="utf-8")
    for text, brought in ((example, False), (example.replace("# dask =", "dask ="), True)):
        place.config.write_text(text)
        setup.complete(place, tmp_path / "wheels")
        assert ("dask" in asked[-1][-1]) == brought, asked[-1]
        assert asked[-1][:2] == [str(tmp_path / "opt/kerntemp/0.1.0/bin/python"), "-m"]
        assert asked[-1][-1].endswith("]==0.1.0")
    place.config.write_text("[refit\n")
    with pytest.raises(setup.Refused, match="correct it first"):
        setup.complete(place, None)


# --- units and rules ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The units with a program that exists, as `systemd-analyze` asks."""
    folder = tmp_path_factory.mktemp("units")
    for unit in SYSTEMD.iterdir():
        text = unit.read_text(encoding="utf-8")
        (folder / unit.name).write_text(text.replace("/opt/kerntemp/current/bin/kerntemp", "/bin/true"))
    return folder


def analyze(*words: str | Path) -> subprocess.CompletedProcess[str]:
    tool = shutil.which("systemd-analyze")
    if tool is None:
        pytest.skip("no systemd-analyze is installed: apt-get install systemd")
    return subprocess.run([tool, *map(str, words)], capture_output=True, text=True, check=False)


def test_systemd_finds_nothing_wrong_with_the_units(units):
    done = analyze("verify", *sorted(units.iterdir()))
    assert done.returncode == 0
    assert [line for line in done.stderr.splitlines() if "kerntemp" in line] == []


@pytest.mark.parametrize("unit", sorted(p.name for p in SYSTEMD.glob("*.service")))
def test_systemd_rates_each_service_as_hardened(units, unit):
    done = analyze("security", "--offline=true", "--threshold=20", units / unit)
    score = re.search(r"Overall exposure level for \S+: ([\d.]+)", done.stdout)
    assert score is not None, done.stderr
    assert done.returncode == 0, f"{unit}: {score.group(1)}, at most 2.0"


def test_each_long_running_service_is_started_anew_within_limits_and_watched():
    for unit in SYSTEMD.glob("kerntemp-*.service"):
        text = unit.read_text(encoding="utf-8")
        assert "User=kerntemp" in text
        if "refit" in unit.name:
            continue
        assert "Restart=always" in text, unit.name
        assert "StartLimitBurst=" in text, unit.name
        assert "Type=notify" in text, unit.name
        assert "WatchdogSec=" in text, unit.name


def test_every_file_the_setup_needs_travels_in_the_wheel():
    tables = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"][
        "data-files"
    ]
    shipped = {path for patterns in tables.values() for pattern in patterns for path in ROOT.glob(pattern)}
    folders = ("systemd", "udev", "sysusers", "monitoring", "presses", "mappings")
    needed = {path for folder in folders for path in (ROOT / "deploy" / folder).iterdir()}
    needed |= {ROOT / "deploy" / name for name in ("kerntemp.toml", "kerntemp_setup.py", "RUNBOOK.md")}
    assert needed <= shipped


def test_the_udev_rule_speaks_of_keys_that_exist_and_jumps_only_to_a_label_it_has():
    text = (ROOT / "deploy" / "udev" / "60-kerntemp.rules").read_text(encoding="utf-8")
    pair = re.compile(
        r"^(ACTION|SUBSYSTEM|KERNEL|DRIVERS|GROUP|MODE|GOTO|LABEL|SYMLINK|(?:ENV|ATTR|IMPORT)\{[^}]+\})"
        r'(==|!=|\+=|=)"([^"]*)"$'
    )
    keys = []
    for line in (x for x in text.splitlines() if x and not x.startswith("#")):
        for part in line.split(", "):
            found = pair.match(part)
            assert found is not None, part
            keys.append(found.groups())
    labels = {value for key, _, value in keys if key == "LABEL"}
    assert {value for key, _, value in keys if key == "GOTO"} == labels
    assert sum(key == "SYMLINK" for key, _, _ in keys) == 2


@pytest.mark.skipif(sys.platform != "linux", reason="the seal is Linux's")
def test_the_recorder_runs_where_no_memory_may_be_written_and_then_run(tmp_path):
    """What MemoryDenyWriteExecute forbids, forbidden by the kernel itself."""
    sealed = (
        "import ctypes, sys\n"
        "if ctypes.CDLL(None, use_errno=True).prctl(65, 1, 0, 0, 0) != 0: sys.exit(77)\n"
        "from api.cli import main\nsys.exit(main(sys.argv[1:]))\n"
    )
    with ExitStack() as stack:
        one = stack.enter_context(simulated("exemys-rme1-tc", lambda now_s: [25.0] * 8, refresh_s=0))
        two = stack.enter_context(simulated("adam-4118-ascii", lambda now_s: [25.0] * 8, refresh_s=0))
        text = f'[store]\nurl = "s.sqlite"\n[[press]]\nname = "lab"\nfile = "{ROOT}/deploy/presses/lab.toml"\n'
        for profile, server, columns in (
            ("exemys-rme1-tc", one, COLUMNS[:8]),
            ("adam-4118-ascii", two, COLUMNS[8:]),
        ):
            table = wiring(profile, server, profile, columns)
            text += "[[press.logger]]\n" + "".join(f"{k} = {toml_value(v)}\n" for k, v in table.items())
        (tmp_path / "kerntemp.toml").write_text(text)
        config = str(tmp_path / "kerntemp.toml")
        log = (tmp_path / "log").open("w")
        service = subprocess.Popen(
            [sys.executable, "-c", sealed, "record", "--config", config], cwd=ROOT, stderr=log
        )
        stack.callback(log.close)
        deadline = time.monotonic() + 240
        while service.poll() is None and _scans(tmp_path / "s.sqlite") < 6 and time.monotonic() < deadline:
            time.sleep(0.1)
        service.terminate()
        if service.wait(240) == 77:
            pytest.skip("this kernel has no such seal: Linux 6.3 or newer has")
    assert service.returncode == 0, (tmp_path / "log").read_text()
    assert _scans(tmp_path / "s.sqlite") > 5


def _scans(store: Path) -> int:
    try:
        return rows(store) if store.exists() else 0
    except sqlite3.Error:
        return 0
