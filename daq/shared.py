"""Where the files are that come with the package: sample runs, press files, mappings, guide, gallery."""

from __future__ import annotations

import sysconfig
from pathlib import Path


def shared_files() -> Path:
    """Return the folder with ``samples``, ``presses``, ``mappings``, ``guide`` and ``gallery``.

    In the sources that is ``deploy``; an installed package keeps it in ``share/kerntemp`` of its environment, or
    beside itself where it was installed into a folder of its own.

    >>> (shared_files() / "presses" / "lab.toml").is_file()
    True
    """
    beside = Path(__file__).parents[1]
    places = (beside / "deploy", beside / "share/kerntemp", Path(sysconfig.get_path("data")) / "share/kerntemp")
    return next((place for place in places if (place / "presses").is_dir()), places[-1])
