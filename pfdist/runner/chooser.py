"""Chooses the models of a job: objects that were given with it, and models that it names."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from pfdist.errors import ModelError
from pfdist.job.job import Job
from pfdist.meaning.chosen import Choose, ChosenModel, choose
from pfdist.models.parameters import Parameter


@dataclass(frozen=True)
class GivenOrNamed:
    """Chooses the object that was given with a job under a name, or else the model of this name.

    Parameters
    ----------
    given : mapping of str to ChosenModel
        The objects, for the parts "model" and "filter_model".
    named : callable
        Chooses a model by its name.
    """

    given: Mapping[str, ChosenModel]
    named: Choose

    def __call__(
        self, part: str, name: str, folder: Path, parameters: Mapping[str, Parameter]
    ) -> ChosenModel:
        """Choose the model of a part; parameters and errors as of `pfdist.meaning.chosen`."""
        given = self.given.get(part)
        if given is not None and given.source.name == name:
            return replace(given, parameters=dict(parameters))
        return self.named(part, name, folder, parameters)


def chooser_of(job: Job) -> GivenOrNamed:
    """Give what chooses a job's models; it is careful with the job of a run's folder."""
    if not (job.path.parent / "run.json").exists():
        return GivenOrNamed(job.models, choose)
    # Imported here, so that workers, which choose no model, need no pyarrow.
    from pfdist.runner.named_by_a_run import of_a_runs_job  # noqa: PLC0415

    return GivenOrNamed(job.models, of_a_runs_job(job))


def models_of(job: Job, choose: Choose) -> tuple[ChosenModel, ChosenModel]:
    """Give the model of a job, and the model that its filter uses.

    Raises
    ------
    ModelError
        A model cannot be loaded.
    """
    try:
        model = choose("model", job.model.name, job.path.parent, job.model.parameters)
    except ModelError as error:
        raise ModelError(f"model.name: {error}") from error
    section = job.model.filter
    if not section.name:
        return model, replace(model, parameters={**model.parameters, **section.parameters})
    try:
        return model, choose("filter_model", section.name, job.path.parent, section.parameters)
    except ModelError as error:
        raise ModelError(f"model.filter.name: {error}") from error
