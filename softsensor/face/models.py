"""Models as they are given: files, what was read of them, or the result of a fit or a diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from softsensor.heat.model_file import ModelFile
from softsensor.jobs.model_files import read_model as read_model_file

if TYPE_CHECKING:
    from softsensor.face.kinds import AnyModel


def read_model(model: AnyModel) -> ModelFile:
    """Return a model from its file, or out of the result of a fit or a diagnosis. Raises `InputError`."""
    if isinstance(model, ModelFile):
        return model
    return read_model_file(Path(model)) if isinstance(model, Path | str) else model.model()
