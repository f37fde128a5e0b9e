"""Models as they are given: files, what was read of them, or the result of a fit or a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from daq.given import path_of, warn
from daq.press.press_file import Press, overridden
from daq.words import say
from softsensor.heat.model_file import ModelFile
from softsensor.heat.model_reading import check_model, check_press
from softsensor.jobs.model_files import read_model as read_model_file

if TYPE_CHECKING:
    from softsensor.face.kinds import AnyModel


@runtime_checkable
class _Found(Protocol):
    """The result of a fit or a diagnosis."""

    def model(self) -> ModelFile:
        """Return the model it found."""


def read_model(model: AnyModel) -> ModelFile:
    """Return a model from its file, or out of the result of a fit or a diagnosis.

    Raises
    ------
    InputError
        For a file that cannot be read, and a value that its coefficient or effect cannot have.

    Examples
    --------
    >>> from softsensor import FittedValue, ModelFile
    >>> read_model(ModelFile("mine", "lab", {"h_pp_c": FittedValue(650.0, 80.0)}))
    Model mine of press lab
    h_pp_c = 650, sd 80
    """
    if isinstance(model, ModelFile):
        check_model(model, say("place-model", version=model.version))
        return model
    return model.model() if isinstance(model, _Found) else read_model_file(path_of(model, "given-no-model"))


def model_for(model: AnyModel, press: Press, header: Mapping[str, Any]) -> ModelFile:
    """Return a model that a run with such a header is to be worked on with in a press; warn of another press's.

    Raises
    ------
    InputError
        As `read_model`; and for a coefficient that neither the press nor the run's own press has.
    """
    found = read_model(model)
    place = say("place-model", version=found.version)
    if (mismatch := check_press(found, (press, overridden(press, header, place)), place)) is not None:
        warn(mismatch)
    return found
