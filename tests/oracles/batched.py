"""A model as one whose functions take arrays of particles."""

import dataclasses

import numpy as np

from pfdist import BatchedModel, StateSpaceModel
from pfdist.common.measurement_times import CLOCK
from pfdist.models.base import squared_error
from pfdist.models.checks import ARGUMENTS, MEASURING, ONE_NUMBER, own_formulas


def on_arrays(name, formula):
    """A formula as a function from arrays (components, particles) to such an array."""
    if formula is None or formula is squared_error:
        return formula

    def function(*arguments):
        arrays = [each for each in arguments if isinstance(each, np.ndarray)]
        size = max(each.shape[1] for each in arrays)
        value = formula(*(tuple(e) if isinstance(e, np.ndarray) else e for e in arguments))
        if name in ONE_NUMBER:
            return np.array(np.broadcast_to(value, size))
        return np.stack([np.broadcast_to(each, size) for each in value])

    return function_of(name, function)


def function_of(name, function):
    """The function with the arguments that a formula of this name has."""
    names = ", ".join(ARGUMENTS[name])
    return eval(f"lambda {names}: function({names})", {"function": function})


def batched(model: StateSpaceModel, *, version="1", **others) -> BatchedModel:
    """The same model as a batched model."""
    fields = {each.name: getattr(model, each.name) for each in dataclasses.fields(model)}
    own = {name: on_arrays(name, fields[name]) for name in own_formulas(model)}
    sensors = {
        sensor: dataclasses.replace(
            each, **{key: on_arrays(key, getattr(each, key)) for key in MEASURING}
        )
        for sensor, each in model.sensors.items()
    }
    assert not {*CLOCK} & {*model.parameters}, "put the batched model on a clock"
    return BatchedModel(**(fields | own | {"sensors": sensors, "version": version} | others))
