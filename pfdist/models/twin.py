"""Models whose formulas compute on arrays by their recorded programs.

A formula says what happens to one particle. Called with arrays, it may mix particles: ``np.sum``
over the components of x then adds up all particles, too. Its program does not.
"""

import copy
import dataclasses
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np

from pfdist.errors import TraceError
from pfdist.models.base import StateSpaceModel
from pfdist.models.checks import ARGUMENTS, ONE_NUMBER
from pfdist.models.tracing import Formula, Traced, trace

_STEPS = ("transition", "proposal", "proposal_log_density")  # from an instant to the next


def traced(model: StateSpaceModel, name: str, instants: range) -> Traced:
    """A formula of a model, traced at instants.

    Formulas of steps are not traced at the last instant, unless it is the only one, and `initial`
    is traced at 0.

    Raises
    ------
    TraceError
        The formula cannot be traced.
    ModelError
        The formula fails, also with numbers.
    """
    if name == "initial":
        instants = range(1)
    elif name in _STEPS:
        instants = instants[:-1] or instants
    result: Traced = model.kept(
        ("traced", name, instants), lambda: trace(formula_of(model, name), instants)
    )
    return result


def formula_of(model: StateSpaceModel, name: str) -> Formula:
    """A formula of a model, with the numbers of components of its arguments."""
    sizes = dict(zip("xyz", model.components, strict=True))
    sizes |= {"w": len(model.process_noise), "v": len(model.measurement_noise), "t": 0, "p": 0}
    sizes |= {"u": len(model.proposal_variates), "estimate": sizes["z"]}
    if name == "initial":
        sizes["w"] = len(model.initial_noise)
    arguments = {argument: sizes[argument] for argument in ARGUMENTS[name]}
    return Formula(model.formulas[name], name, arguments, model.parameters, model.name)


def twin_of(model: StateSpaceModel, instants: range) -> StateSpaceModel:
    """The model with formulas that compute on arrays, at instants, by their programs.

    A formula is traced when it is first called. One that cannot be traced is called itself.
    """
    result: StateSpaceModel = model.kept(("twin", instants), lambda: _twin_of(model, instants))
    return result


def _twin_of(model: StateSpaceModel, instants: range) -> StateSpaceModel:
    twin = copy.copy(model)  # without what is cached beside the fields
    twin.__dict__["components"] = model.components
    if model.sensors:
        parts = [part._replace(model=twin_of(part.model, instants)) for part in model.parts]
        twin.__dict__["parts"] = tuple(parts)
        sensors = {
            part.name: dataclasses.replace(
                model.sensors[part.name],
                measurement=part.model.measurement,
                log_likelihood=part.model.log_likelihood,
            )
            for part in parts
        }
        twin.__dict__["sensors"] = sensors
    for name in ARGUMENTS.keys() & model.formulas.keys():
        twin.__dict__[name] = _Twin(model, name, instants)
    return twin


class _Twin:
    """A formula that computes by its program."""

    def __init__(self, model: StateSpaceModel, name: str, instants: range) -> None:
        self._model, self._name, self._instants = model, name, instants
        self.__wrapped__ = model.formulas[name]

    @cached_property
    def _computed(self) -> Callable[..., Any]:
        try:
            return partial(self._by_program, traced(self._model, self._name, self._instants))
        except TraceError:
            return self._itself

    @property
    def is_traced(self) -> bool:
        """Whether there is a program."""
        return self._computed != self._itself

    def __call__(self, *arguments: Any) -> Any:
        return self._computed(*arguments)

    def _by_program(self, program: Traced, *arguments: Any) -> Any:
        groups = dict(zip(ARGUMENTS[self._name], arguments, strict=True))
        parameters = groups.pop("p")._asdict()
        values = program.values(groups, groups.pop("t", 0), parameters)
        return values[0] if self._name in ONE_NUMBER else values

    def _itself(self, *arguments: Any) -> Any:
        value = self.__wrapped__(*arguments)
        return tuple(value) if isinstance(value, np.ndarray) and value.ndim > 1 else value
