"""The wheel holds everything: built, listed, installed where the sources are not, and tried."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from urllib.request import urlopen

import pytest
from mypy.modulefinder import FindModuleCache, ModuleNotFoundReason, SearchPaths
from mypy.options import Options
from packaging.requirements import Requirement

from api.commands.licences import licences

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of a copy of the sources, so that the build leaves nothing in them."""
    import shutil

    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    for name in ("api", "daq", "softsensor", "deploy"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md"):
        shutil.copyfile(ROOT / name, source / name)
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(folder)]
    subprocess.run([*command, str(source)], check=True, capture_output=True)
    return next(folder.glob("*.whl"))


def test_the_wheel_holds_every_module_and_data_file_of_the_packages(wheel):
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    kinds = {".py", ".toml", ".html", ".css", ".js", ".svg", ".json", ".sql", ".txt"}
    needed = {
        path.relative_to(ROOT).as_posix()
        for package in ("daq", "softsensor", "api")
        for path in (ROOT / package).rglob("*")
        if path.suffix in kinds and "__pycache__" not in path.parts
    }
    assert needed - held == set()
    assert "api/page/vendor/uPlot.iife.min.js" in held
    assert "api/page/vendor/LICENSE.uPlot.txt" in held
    assert "api/page/vendor/fluent-bundle.js" in held
    assert "api/page/vendor/LICENSE.fluent-bundle.txt" in held
    assert any(name.endswith("share/kerntemp/kerntemp_setup.py") for name in held)
    assert not [name for name in held if name.startswith(("tests/", "build/"))]


def test_an_installed_copy_brings_its_types(wheel, tmp_path):
    """As `mypy` looks for a package in site-packages: what has no py.typed it takes for untyped."""

    def found(package):
        return FindModuleCache(SearchPaths((), (), (str(tmp_path),), ()), None, Options()).find_module(package)

    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    for package in ("daq", "softsensor", "api"):
        assert found(package) == str(tmp_path / package / "__init__.py")
        (tmp_path / package / "py.typed").unlink()
        assert found(package) is ModuleNotFoundReason.FOUND_WITHOUT_TYPE_HINTS


def test_the_version_stands_in_one_place(wheel):
    version = PROJECT["version"]
    assert wheel.name == f"kerntemp-{version}-py3-none-any.whl"
    pattern = re.compile(rf"['\"]{re.escape(version)}['\"]")
    others = [
        path
        for package in ("daq", "softsensor", "api")
        for path in (ROOT / package).rglob("*.py")
        if pattern.search(path.read_text(encoding="utf-8"))
    ]
    assert others == []
    changes = (ROOT / "deploy" / "guide" / "changes.md").read_text(encoding="utf-8")
    assert f"\n## {version}\n" in changes, "the change list does not know this version"


def test_each_thing_that_is_shipped_names_its_licence():
    found = {item.name.lower(): item for item in licences()}
    wanted = [Requirement(text) for text in PROJECT["dependencies"]]
    direct = {one.name.lower() for one in wanted if one.marker is None or one.marker.evaluate()}
    assert direct <= {name.replace("_", "-") for name in found}
    assert [item.name for item in found.values() if not item.licence] == []
    done = subprocess.run([sys.executable, "-m", "api", "--licences"], cwd=ROOT, capture_output=True, text=True)
    assert "uPlot" in done.stdout
    assert "@fluent/bundle" in done.stdout
    own = next(line for line in done.stdout.splitlines() if line.startswith("kerntemp "))
    assert own.endswith("not stated") == ("license" not in PROJECT)
    assert all(item.licence in done.stdout for item in found.values())


@pytest.mark.campaign
def test_installed_alone_it_says_its_version_and_serves_its_page(wheel, tmp_path, monkeypatch):
    monkeypatch.delenv("PYTHONPATH", raising=False)
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "venv")], check=True)
    python = tmp_path / "venv" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    subprocess.run([python, "-m", "pip", "install", "-q", str(wheel)], check=True)
    done = subprocess.run([python, "-m", "api", "--version"], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == f"kerntemp {PROJECT['version']}\n"
    where = subprocess.run(
        [python, "-c", "import api; print(api.__file__)"], cwd=tmp_path, capture_output=True, text=True
    )
    assert str(tmp_path) in where.stdout
    make = "from daq.store import open_store; open_store('s.sqlite').close()"
    subprocess.run([python, "-c", make], cwd=tmp_path, check=True)
    command = [python, "-m", "api", "serve", "--port", "0", "--store", str(tmp_path / "s.sqlite")]
    server = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        address = server.stdout.readline().split()[-1]
        page = urlopen(address).read().decode()
        for name in re.findall(r'(?:src|href)="(/?static/[^"]+)"', page):
            assert urlopen(address + name.lstrip("/")).status == 200
        assert urlopen(f"{address}docs").status == 200
        assert urlopen(f"{address}api/v1/health").status == 200
    finally:
        server.terminate()
        server.wait(240)
        server.stdout.close()
