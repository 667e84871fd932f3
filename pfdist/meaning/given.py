"""A model that a user hands over in Python: an object, or a name as in a job."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from pfdist.errors import ModelError, shown
from pfdist.meaning import differences, meaning_of
from pfdist.meaning.chosen import ChosenModel
from pfdist.meaning.model_value import value_of
from pfdist.meaning.origins import home_of
from pfdist.models import StateSpaceModel, find_model, installed_models, load_model
from pfdist.models.parameters import Parameter


@dataclass(frozen=True)
class GivenModel:
    """A model as a job names it, and the model itself if no name can say it.

    Parameters
    ----------
    name : str
        A name as in a job; "python:" and the model's name for an object that travels by value.
    parameters : mapping of str to float or sequence of float
        Parameters that replace those of the named model.
    chosen : ChosenModel or None
        The object by value; None for a model that can be found by its name.
    """

    name: str
    parameters: Mapping[str, Parameter]
    chosen: ChosenModel | None = None


def given_model(model: StateSpaceModel | str) -> GivenModel:
    """Give the name and the parameters of a model that was handed over in Python.

    The object of an installed model is known by its name, as in a job file. Any other object
    travels by value, and all its parameters are named. Its meaning does not depend on the place of
    its formulas: a notebook, a script or a file.

    Parameters
    ----------
    model : StateSpaceModel or str

    Raises
    ------
    ModelError
        The model is neither an object nor a name, or it cannot be sent to workers, or it is an
        installed model whose constants this process has changed.
    """
    if isinstance(model, str):
        return GivenModel(model, {})
    if not isinstance(model, StateSpaceModel):
        raise ModelError(
            "a model must be a StateSpaceModel or the name of a model, for instance 'ungm' or "
            f"'path/file.py:object', got {shown(model)}",
            argument="model",
        )
    parameters = {
        name: value if isinstance(value, tuple) else float(value)  # type: ignore[arg-type]
        for name, value in model.parameters.items()
    }
    if (installed := _installed(model)) is not None:
        own = installed.parameters
        changed = {name: value for name, value in parameters.items() if value != own[name]}
        return GivenModel(model.name, changed)
    chosen = chosen_value(model, str(home_of(model.transition)))
    return GivenModel(chosen.source.name, parameters, chosen)


def chosen_value(model: StateSpaceModel, main: str = "") -> ChosenModel:
    """Give an object as a chosen model: by value, with its meaning in this process.

    Parameters
    ----------
    model : StateSpaceModel
    main : str, optional
        As for `pfdist.meaning.meaning_of`.

    Raises
    ------
    ModelError
        It cannot be sent to workers, or a formula uses a value whose content cannot be read.
    """
    source = value_of(model)
    return ChosenModel(source, {}, meaning_of(model, source, main))


def _installed(model: StateSpaceModel) -> StateSpaceModel | None:
    """Give the installed model whose formulas an object has; None for a model of the user."""
    module, attribute = installed_models().get(model.name, ("", ""))
    if not module:
        return None
    known = load_model(model.name)
    imported = getattr(sys.modules.get(module), attribute, None)
    if not any(_differ_in_parameters_alone(model, each) for each in (known, imported)):
        return None
    _check_is_as_installed(model, known)
    return known


def _check_is_as_installed(model: StateSpaceModel, known: StateSpaceModel) -> None:
    """Refuse an installed model whose constants this process has changed: workers load the file."""
    _, source = find_model(model.name).record()
    here, there = (
        meaning_of(each, source, str(home_of(each.transition))) for each in (model, known)
    )
    changed = [label for label in differences(here, there) if not label.startswith("parameters.")]
    if changed:
        label = max(changed, key=lambda label: "." in label)  # a formula differs by a constant
        raise ModelError(
            f"model {model.name} must be as installed, because workers load its file, got another "
            f"{label.rpartition('.')[2]} in this process: copy the file and change the copy "
            f"({source.path})",
            argument="model",
        )


def _differ_in_parameters_alone(model: StateSpaceModel, known: Any) -> bool:
    if not isinstance(known, StateSpaceModel) or model.parameters.keys() != known.parameters.keys():
        return False
    names = [field.name for field in fields(model) if field.name != "parameters"]
    return all(getattr(model, name) == getattr(known, name) for name in names)
