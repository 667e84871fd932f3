"""Models whose formulas compute on arrays by their recorded programs.

A formula describes one particle. Called with arrays, it may mix particles: ``np.sum`` over the
components of x then also sums over particles. Its program does not.
"""

import copy
import dataclasses
from functools import cached_property
from typing import Any

from pfdist.errors import ModelError
from pfdist.models.base import StateSpaceModel
from pfdist.models.checks import ARGUMENTS
from pfdist.models.programs import Declared, Programs
from pfdist.models.tracing import Formula, Traced, trace


def traced(model: StateSpaceModel, name: str, instants: range) -> Traced:
    """A formula of a model, traced at instants.

    Raises
    ------
    TraceError
        The formula cannot be traced.
    ModelError
        The formula fails, also with numbers.
    """
    instants, formula = instants_of_twin(name, instants), model.formulas[name]
    if isinstance(formula, Declared):
        raise formula.why
    if isinstance(formula, Programs):
        try:
            return formula.traced.at(instants)
        except ModelError as error:
            raise ModelError(f"model {model.name}: {name}: {error}") from error
    own = formula_of(model, name)
    first = model.kept(("traced", name), lambda: trace(own, instants))
    result: Traced = first
    if first.instants != instants:
        result = model.kept(("traced", name, instants), lambda: trace(own, instants, first))
    return result


def instants_of_twin(name: str, instants: range) -> range:
    """The instants at which a formula is traced, given instants of the system.

    `transition` leaves out the last, unless it is the only one; `initial` is traced at 0.
    """
    if name == "initial":
        return range(1)
    return (instants[:-1] or instants) if name == "transition" else instants


def formula_of(model: StateSpaceModel, name: str) -> Formula:
    """A model's formula, with the numbers of components of its arguments."""
    sizes = dict(zip("xyz", model.components, strict=True))
    sizes |= {"w": len(model.process_noise), "v": len(model.measurement_noise), "t": 0, "p": 0}
    sizes["estimate"] = sizes["z"]
    if name == "initial":
        sizes["w"] = len(model.initial_noise)
    arguments = {argument: sizes[argument] for argument in ARGUMENTS[name]}
    results = results_of(model, name)
    return Formula(model.formulas[name], name, arguments, model.parameters, model.name, results)


def results_of(model: StateSpaceModel, name: str) -> int:
    """The number of components that a formula gives; 1 for a number."""
    states, measurements, quantities = model.components
    counts = {"initial": states, "transition": states, "measurement": measurements}
    counts["quantity_of_interest"] = quantities
    return counts.get(name, 1)


def twin_of(model: StateSpaceModel, instants: range) -> StateSpaceModel:
    """The model with formulas that compute on arrays at given instants, by their programs.

    A formula is traced when it is first called; functions of a batched model are called directly.
    """
    result: StateSpaceModel = model.kept(("twin", instants), lambda: _twin_of(model, instants))
    return result


def _twin_of(model: StateSpaceModel, instants: range) -> StateSpaceModel:
    if all(isinstance(each, Programs | Declared) for each in model.formulas.values()):
        return model
    twin = copy.copy(model)  # without what is cached beside the fields
    twin.__dict__["components"] = model.components
    if model.sensors:
        ways = [way._replace(model=twin_of(way.model, instants)) for way in model.ways]
        twin.__dict__["ways"] = tuple(ways)
        sensors = {
            way.name: dataclasses.replace(
                model.sensors[way.name],
                measurement=way.model.measurement,
                log_likelihood=way.model.log_likelihood,
            )
            for way in ways
        }
        twin.__dict__["sensors"] = sensors
    for name in ARGUMENTS.keys() & model.formulas.keys():
        twin.__dict__[name] = _Twin(model, name, instants)
    return twin


class _Twin:
    """A formula that is recorded when it is first called."""

    def __init__(self, model: StateSpaceModel, name: str, instants: range) -> None:
        self._model, self._name, self._instants = model, name, instants
        self.__wrapped__ = model.formulas[name]

    @cached_property
    def _computed(self) -> Programs | Declared:
        if isinstance(self.__wrapped__, Declared):
            return self.__wrapped__
        program = traced(self._model, self._name, self._instants)
        return Programs(self._name, self._model.name, program)

    @property
    def reads_time(self) -> bool:
        return self._computed.reads_time

    @property
    def takes_instants(self) -> bool:
        return self._computed.takes_instants

    def __call__(self, *arguments: Any) -> Any:
        return self._computed(*arguments)
