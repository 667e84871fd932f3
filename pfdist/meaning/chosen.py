"""The model that a job names, as it travels to workers: with what it means."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

from pfdist.common.streams import stream_key
from pfdist.meaning import Meaning, check_is_constant, loaded_meaning, meaning_of, parameters_of
from pfdist.meaning.known_models import remember
from pfdist.models import ModelSource, StateSpaceModel, find_model


@dataclass(frozen=True)
class ChosenModel:
    """A model's source, the parameters that are not its own, and what the driver found it to mean.

    Parameters
    ----------
    source : ModelSource
        With its files.
    parameters : mapping of str to float
    loaded : Meaning
        Meaning of what the source gave in the process that chose it, with its own parameters.
    """

    source: ModelSource
    parameters: Mapping[str, float]
    loaded: Meaning

    def load(self) -> StateSpaceModel:
        """Load the model.

        Raises
        ------
        ModelError
            It cannot be loaded, or means something else here than in the driver; or a parameter is
            unknown.
        """
        model = self.source.load()
        here = loaded_meaning(self.source)
        check_is_constant(self.loaded, here, self.source.path, "in each process")
        return model.with_parameters(self.parameters)

    @cached_property
    def meaning(self) -> Meaning:
        """What the model means, with the parameters of the job."""
        return {**self.loaded, **parameters_of(self.parameters)}

    @cached_property
    def content(self) -> str:
        """Hash of the meaning."""
        return f"{stream_key(self.meaning):016x}"


class Choose(Protocol):
    """How the models of a job are chosen; see `choose`."""

    def __call__(
        self, part: str, name: str, folder: Path, parameters: Mapping[str, float], /
    ) -> ChosenModel:
        """Give the model of a part of the job, "model" or "filter_model"."""


def choose(part: str, name: str, folder: Path, parameters: Mapping[str, float]) -> ChosenModel:
    """Choose a model that the user names, as a job does it.

    Parameters
    ----------
    part : {"model", "filter_model"}
    name : str
    folder : Path
        What a path in the name is relative to.
    parameters : mapping of str to float

    Raises
    ------
    ModelError
        There is no such model, it cannot be loaded, or loading it twice gives two models.
    """
    source, told, again = loaded_twice(name, folder)
    check_is_constant(told, again, source.path, "each time it is loaded")
    return ChosenModel(source, dict(parameters), again)


def chosen_from(source: ModelSource, parameters: Mapping[str, float]) -> ChosenModel:
    """Choose a model whose files are at hand: no other file is read.

    Raises
    ------
    ModelError
        It cannot be loaded.
    """
    return ChosenModel(source, dict(parameters), loaded_meaning(source))


def loaded_twice(name: str, folder: Path) -> tuple[ModelSource, Meaning, Meaning]:
    """Load a model from its folder, and again from what travels to a worker.

    Returns
    -------
    ModelSource
        With its files.
    Meaning, Meaning
        The same, unless a constant is random.
    """
    recorded, source = find_model(name, folder).record()
    remember(source)
    told = meaning_of(recorded, source)  # before anything uses it
    return source, told, loaded_meaning(source)
