"""Model files on the disk."""

from __future__ import annotations

import json
from pathlib import Path

from daq.records import InputError
from daq.tables import reason_of
from daq.words import say
from softsensor.heat.model_file import ModelFile, parse_model


def read_model(path: Path) -> ModelFile:
    """Read a model file. Raises InputError."""
    try:
        return parse_model(json.loads(path.read_text(encoding="utf-8")), str(path))
    except OSError as error:
        raise InputError(say("model-file-unreadable", file=str(path), error=reason_of(error))) from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(say("model-file-no-json", file=str(path), error=reason_of(error))) from error
