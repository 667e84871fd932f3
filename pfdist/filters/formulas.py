"""The formulas of simulations and filters, traced and compiled for given instants."""

from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from pfdist.filters.work import Estimation
from pfdist.kernels import batch as rows
from pfdist.kernels.blocks import Compiled, Source, compile_blocks
from pfdist.kernels.callbacks import Callback
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.models import StateSpaceModel
from pfdist.models.base import angular_error, squared_error
from pfdist.models.parameters import check_lengths
from pfdist.models.program import Array
from pfdist.models.programs import Declared
from pfdist.models.tracing import Formula, trace
from pfdist.models.twin import formula_of, traced

_OF_NOISE = 25  # operations of a normal random number, about


def filter_blocks(
    model: StateSpaceModel,
    truth: StateSpaceModel,
    settings: Estimation,
    instants: range,
    further: Mapping[int, Source],
) -> tuple[Compiled, tuple[int, ...]]:
    """The blocks of a filter, whose error is that of the true model; see `pfdist.kernels.batch`.

    Those of a proposal are `further`: they come after those of all sensors.

    The second result has the components of x that are equal to those of z; it is empty if z is
    computed, or an angle. Raises `TraceError` if a formula cannot be traced.
    """
    name = settings.proposal if further else ""
    by_error = ESTIMATORS[settings.estimator].by_error and truth.error is not squared_error
    result: tuple[Compiled, tuple[int, ...]]
    result, _ = model.kept(  # it holds the truth, so that no other one gets its id
        ("filter", instants, name, by_error, id(truth)),
        lambda: (_filter_blocks(model, truth, by_error, instants, further), truth),
    )
    return result


def _filter_blocks(
    model: StateSpaceModel,
    truth: StateSpaceModel,
    by_error: bool,
    instants: range,
    further: Mapping[int, Source],
) -> tuple[Compiled, tuple[int, ...]]:
    """The blocks; `by_error` says whether DEVIATIONS are the truth's own error."""
    check_lengths(model.parameters, instants.stop)
    check_lengths(truth.parameters, instants.stop)
    states, (own, once) = model.components[0], (_Formulas(model, truth), instants[:1])
    quantities, angles = len(truth.is_angle), sum(truth.is_angle)
    x = {"x": states}
    z, source = "quantity_of_interest", partial(_source, model)
    name, deviations = ("errors", own.errors) if by_error else (z, own.deviations)
    sources = dict[Any, Source | Callback | None](
        {
            rows.INITIAL: _own(model, "initial", instants),
            rows.TRANSITION: _own(model, "transition", instants) if instants[1:] else None,
            rows.QUANTITY: source(
                quantities + 2 * angles, z, own.quantity, {**x, "t": 0}, instants
            ),
            rows.DEVIATIONS: source(
                quantities, name, deviations, {**x, "y": quantities, "t": 0}, instants
            ),
            rows.ESTIMATE: source(
                quantities, "the mean", own.estimate, {"x": quantities + 2 * angles}, once
            ),
            rows.ERROR: _own(truth, "error", instants),
            rows.DISTANCE: source(1, "distance", own.distance, {"x": 3 * quantities}, once),
            rows.LOGARITHM: source(1, "logarithm", _logarithm, {"w": 1}, once),
        }
    )
    for number, way in enumerate(model.ways):
        sources[rows.SENSORS + number] = _own(way.model, "log_likelihood", instants)
    behind = rows.SENSORS + len(model.ways)
    sources |= {behind + place: each for place, each in further.items()}
    blocks = compile_blocks([sources.get(row) for row in range(max(sources) + 1)], instants)
    return blocks, _components_of_state(sources[rows.QUANTITY])


def _components_of_state(quantity: Source | Callback | None) -> tuple[int, ...]:
    """The components of x that a formula gives as they are; empty if it computes anything."""
    programs = quantity.traced.programs if isinstance(quantity, Source) else ()
    outputs = {
        tuple(program.operations[each][::2] for each in program.outputs) for program in programs
    }
    if len(outputs) != 1:
        return ()
    (results,) = outputs
    return tuple(which for _, which in results) if all(name == "x" for name, _ in results) else ()


def simulation_blocks(model: StateSpaceModel, instants: range) -> Compiled:
    """The blocks of a simulation; see `pfdist.kernels.simulation`.

    Raises `TraceError` if a formula cannot be traced.
    """
    compiled: Compiled = model.kept(
        ("simulation", instants), lambda: _simulation_blocks(model, instants)
    )
    return compiled


def _simulation_blocks(model: StateSpaceModel, instants: range) -> Compiled:
    check_lengths(model.parameters, instants.stop)
    sources = [
        _own(model, "initial", instants),
        _own(model, "transition", instants) if instants[1:] else None,
        _own(model, "quantity_of_interest", instants),
        *(_own(way.model, "measurement", instants) for way in model.ways),
    ]
    return compile_blocks(sources, instants)


def operations_of(model: StateSpaceModel, instants: range) -> int:
    """About how many operations a particle-step has, those of its random numbers included."""
    parts = ((way.model, "log_likelihood") for way in model.ways)
    sources = [_own(each, name, instants) for each, name in ((model, "transition"), *parts)]
    programs = [each.traced.programs for each in sources if isinstance(each, Source)]
    of_formulas = sum(max(len(each.operations) for each in some) for some in programs)
    return of_formulas + _OF_NOISE * len(model.process_noise)


def _own(model: StateSpaceModel, name: str, instants: range) -> Source | Callback:
    """A formula of the model itself, traced, or called back if the model is batched."""
    formula = formula_of(model, name)
    if isinstance(model.formulas[name], Declared):
        return _called(model, formula)
    layout = layout_of(formula)
    return Source(traced(model, name, instants), layout, model.parameters, formula.results)


def _source(
    model: StateSpaceModel,
    results: int,
    name: str,
    function: Callable[..., Any],
    arguments: dict[str, int],
    instants: range,
) -> Source | Callback | None:
    """A formula that is made from those of a model, traced; None without instants.

    It is called back if it needs functions of a batched model.
    """
    if not instants:
        return None
    given = {**arguments, "p": 0}
    formula = Formula(function, name, given, model.parameters, model.name, results)
    needed = ("quantity_of_interest", "error") if name == "errors" else (name,)
    if any(isinstance(model.formulas.get(each), Declared) for each in needed):
        return _called(model, formula)
    return Source(trace(formula, instants), layout_of(formula), model.parameters, results)


def _called(model: StateSpaceModel, formula: Formula) -> Callback:
    """A formula that machine code calls back with arrays of particles."""
    p = model.p

    def function(groups: dict[str, Array], t: int) -> Any:
        given: dict[str, Any] = {"t": t, "p": p, **groups}
        value = formula.function(*(given[name] for name in formula.arguments))
        return value if isinstance(value, tuple) else (value,)

    rows = {
        name: (*place, formula.arguments[name])
        for name, place in layout_of(formula).items()
        if name not in "tp"
    }
    declared = (each for each in model.formulas.values() if isinstance(each, Declared))
    return Callback(function, rows, formula.results, max(each.together for each in declared))


def layout_of(formula: Formula) -> dict[str, tuple[str, int]]:
    """Array and first row of each argument; those that are rows of slots follow one another."""
    layout, rows_of = dict[str, tuple[str, int]](), Counter[str]()
    for group, count in formula.arguments.items():
        array = {"y": "given", "w": "noise", "v": "noise", "u": "noise"}.get(group, "slots")
        layout[group] = array, rows_of[array]
        rows_of[array] += count
    return layout


class _Formulas:
    """Formulas of a filter that are made from those of a model."""

    def __init__(self, model: StateSpaceModel, truth: StateSpaceModel) -> None:
        self.model, self.is_angle, self.error = model, truth.is_angle, truth.formulas["error"]

    def quantity(self, x: Any, t: Any, p: Any) -> tuple[Any, ...]:
        """z, then cosine and sine of each component that is an angle."""
        z = self.model.quantity_of_interest(x, t, p)
        angles = [value for value, is_angle in zip(z, self.is_angle, strict=True) if is_angle]
        return (*z, *(each(angle) for angle in angles for each in (np.cos, np.sin)))

    def estimate(self, x: Any, p: Any) -> tuple[Any, ...]:
        """The mean of z from the weighted means of `quantity`."""
        means, directions = x[: len(self.is_angle)], iter(x[len(self.is_angle) :])
        return tuple(
            _direction(next(directions), next(directions)) if is_angle else mean
            for mean, is_angle in zip(means, self.is_angle, strict=True)
        )

    def deviations(self, x: Any, y: Any, t: Any, p: Any) -> tuple[Any, ...]:
        """The squared deviation of each component of z from its mean; 1 - cos of an angle's."""
        z = self.model.quantity_of_interest(x, t, p)
        return tuple(
            angular_error(value, mean) if is_angle else (value - mean) ** 2
            for value, mean, is_angle in zip(z, y, self.is_angle, strict=True)
        )

    def errors(self, x: Any, y: Any, t: Any, p: Any) -> tuple[Any, ...]:
        """The truth's error of the mean if z is that of a particle; then a 0 for each other z."""
        z = self.model.quantity_of_interest(x, t, p)
        return (self.error(z, y, t, p), *[0.0] * (len(z) - 1))

    def distance(self, x: Any, p: Any) -> Any:
        """The squared distance of the means of two filters; see `pfdist.filters.interface`."""
        count, total = len(self.is_angle), 0.0
        for mean, variance, first, is_angle in zip(
            x[:count], x[count : 2 * count], x[2 * count :], self.is_angle, strict=True
        ):
            angular = (1.0 - variance) * angular_error(first, mean) if is_angle else 0.0
            total = total + (angular if is_angle else (first - mean) ** 2)
        return total


def _direction(cosine: Any, sine: Any) -> Any:
    return np.arctan2(sine, cosine)


def _logarithm(w: Any, p: Any) -> tuple[Any, ...]:
    return (np.log(w[0]),)
