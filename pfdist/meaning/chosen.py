"""The model that a job names, with its meaning, as it travels to the workers."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

from pfdist.common.streams import stream_key
from pfdist.meaning import Meaning, check_is_constant, loaded_meaning, meaning_of, parameters_of
from pfdist.meaning.known_models import remember
from pfdist.meaning.model_value import ModelValue
from pfdist.models import ModelSource, StateSpaceModel, find_model
from pfdist.models.parameters import Parameter


@dataclass(frozen=True)
class ChosenModel:
    """A model's source, the parameters of the job, and the meaning that the driver found.

    Parameters
    ----------
    source : ModelSource or ModelValue
        The source with its files.
    parameters : mapping of str to float or sequence of float
        Parameters that replace those of the source.
    loaded : Meaning
        Meaning of the model in the process that chose it, with the parameters of the source.
    """

    source: ModelSource | ModelValue
    parameters: Mapping[str, Parameter]
    loaded: Meaning

    def load(self) -> StateSpaceModel:
        """Load the model.

        Raises
        ------
        ModelError
            The model cannot be loaded, its meaning here differs from that in the driver, or a
            parameter is unknown or outside its range.
        """
        model = self.source.load()
        if isinstance(self.source, ModelSource):  # a value has travelled with its meaning
            here = loaded_meaning(self.source)
            check_is_constant(self.loaded, here, self.source.path, "in each process")
        return model.with_parameters(self.parameters)

    @cached_property
    def meaning(self) -> Meaning:
        """Meaning of the model with the parameters of the job."""
        return {**self.loaded, **parameters_of(self.parameters)}

    @cached_property
    def content(self) -> str:
        """Hash of the meaning."""
        return f"{stream_key(self.meaning):016x}"


class Choose(Protocol):
    """A function that chooses the models of a job; see `choose`."""

    def __call__(
        self, part: str, name: str, folder: Path, parameters: Mapping[str, Parameter], /
    ) -> ChosenModel:
        """Give the model of a part of the job: "model" or "filter_model"."""


def choose(part: str, name: str, folder: Path, parameters: Mapping[str, Parameter]) -> ChosenModel:
    """Give the model that the user names.

    Parameters
    ----------
    part : {"model", "filter_model"}
    name : str
    folder : Path
        Folder to which a path in the name is relative.
    parameters : mapping of str to float or sequence of float

    Raises
    ------
    ModelError
        There is no such model, it cannot be loaded, or two loads give different meanings.
    """
    source, told, again = loaded_twice(name, folder)
    check_is_constant(told, again, source.path, "each time it is loaded")
    return ChosenModel(source, dict(parameters), again)


def chosen_from(source: ModelSource, parameters: Mapping[str, Parameter]) -> ChosenModel:
    """Give the model of a source that has its files. No other file is read.

    Raises
    ------
    ModelError
        The model cannot be loaded.
    """
    return ChosenModel(source, dict(parameters), loaded_meaning(source))


def loaded_twice(name: str, folder: Path) -> tuple[ModelSource, Meaning, Meaning]:
    """Load a model from its folder, and again from the files that travel to a worker.

    Returns
    -------
    ModelSource
        The source with its files.
    Meaning, Meaning
        The meanings of both loads. They are equal unless a constant is random.
    """
    recorded, source = find_model(name, folder).record()
    remember(source)
    told = meaning_of(recorded, source)  # before a formula can change a constant
    return source, told, loaded_meaning(source)
