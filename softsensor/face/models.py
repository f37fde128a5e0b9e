"""Models as they are given: files, what was read of them, or the result of a fit or a diagnosis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

from daq.given import path_of
from softsensor.heat.model_file import ModelFile
from softsensor.jobs.model_files import read_model as read_model_file

if TYPE_CHECKING:
    from softsensor.face.kinds import AnyModel


@runtime_checkable
class _Found(Protocol):
    """The result of a fit or a diagnosis."""

    def model(self) -> ModelFile:
        """Return the model it found."""


def read_model(model: AnyModel) -> ModelFile:
    """Return a model from its file, or out of the result of a fit or a diagnosis. Raises `InputError`.

    Examples
    --------
    >>> from softsensor import FittedValue, ModelFile
    >>> read_model(ModelFile("mine", "lab", {"h_pp_c": FittedValue(650.0, 80.0)}))
    Model mine of press lab
    h_pp_c = 650, sd 80
    """
    if isinstance(model, ModelFile):
        return model
    return model.model() if isinstance(model, _Found) else read_model_file(path_of(model, "given-no-model"))
