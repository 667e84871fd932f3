"""The formulas of simulations and filters, traced and compiled for the instants at hand."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from pfdist.filters.work import FLOAT32, Estimation
from pfdist.kernels import filter as rows
from pfdist.kernels.blocks import Compiled, Source, compile_blocks
from pfdist.kernels.lowering import Precision
from pfdist.models import StateSpaceModel
from pfdist.models.base import angular_error
from pfdist.models.parameters import check_lengths
from pfdist.models.tracing import Formula, trace
from pfdist.models.twin import formula_of, traced

_LOG_OF_ROOT = math.log(2.0 * math.pi) / 2.0


def filter_blocks(
    model: StateSpaceModel, truth: StateSpaceModel, settings: Estimation, instants: range
) -> tuple[Compiled, tuple[int, ...]]:
    """The blocks of a filter, whose errors the truth defines; see `pfdist.kernels.filter`.

    The second result has the components of x that are those of z; it is empty if z is computed, or
    an angle. A `TraceError` says that a formula cannot be traced.
    """
    guided = settings.guides(model)
    result: tuple[Compiled, tuple[int, ...]]
    result, _ = model.kept(  # it holds the truth, so that no other one gets its id
        ("filter", instants, guided, id(truth), settings.dtype),
        lambda: (_filter_blocks(model, truth, guided, instants, settings.dtype), truth),
    )
    return result


def _filter_blocks(
    model: StateSpaceModel, truth: StateSpaceModel, guided: bool, instants: range, dtype: str
) -> tuple[Compiled, tuple[int, ...]]:
    check_lengths(model.parameters, instants.stop)
    check_lengths(truth.parameters, instants.stop)
    states, (own, once) = model.components[0], (_Formulas(model, truth.is_angle), instants[:1])
    quantities, angles = len(truth.is_angle), sum(truth.is_angle)
    x, u = {"x": states}, {"u": len(model.proposal_variates)}
    z, source = "quantity_of_interest", partial(_source, model)
    sources = dict[Any, Source | None](
        {
            rows.INITIAL: _own(model, "initial", instants),
            rows.TRANSITION: _own(model, "transition", instants) if instants[1:] else None,
            rows.QUANTITY: source(
                quantities + 2 * angles, z, own.quantity, {**x, "t": 0}, instants
            ),
            rows.DEVIATIONS: source(
                quantities, z, own.deviations, {**x, "y": quantities, "t": 0}, instants
            ),
            rows.ESTIMATE: source(
                quantities, "the mean", own.estimate, {"x": quantities + 2 * angles}, once
            ),
            rows.ERROR: _own(truth, "error", instants),
            rows.DISTANCE: source(1, "distance", own.distance, {"x": 3 * quantities}, once),
            rows.LOGARITHM: source(1, "logarithm", _logarithm, {"w": 1}, once),
        }
    )
    for number, part in enumerate(model.parts):
        sources[rows.SENSORS + number] = _own(part.model, "log_likelihood", instants)
    if guided:
        given = {**x, "y": model.components[1], "t": 0, **u}
        sources[rows.GUIDED] = source(states + 1, "proposal", own.guided, given, instants[:-1])
    if dtype == FLOAT32:
        sources |= {row: _of_singles(row, each) for row, each in sources.items() if each}
    blocks = compile_blocks([sources.get(row) for row in range(max(sources) + 1)], instants)
    return blocks, _components_of_state(sources[rows.QUANTITY])


def _of_singles(row: Any, source: Source) -> Source:
    """The source for particles with float32 states; estimates and errors remain float64."""
    computes = row in (rows.INITIAL, rows.TRANSITION, rows.GUIDED) or row >= rows.SENSORS
    reads = computes or row in (rows.QUANTITY, rows.DEVIATIONS)
    kinds = Precision("f4" if reads else "f8", "f4" if computes else "f8")
    return source._replace(precision=kinds)


def _components_of_state(quantity: Source | None) -> tuple[int, ...]:
    """The components of x that a formula gives as they are; empty if it computes anything."""
    programs = quantity.traced.programs if quantity else ()
    outputs = {
        tuple(program.operations[each][::2] for each in program.outputs) for program in programs
    }
    if len(outputs) != 1:
        return ()
    (results,) = outputs
    return tuple(which for _, which in results) if all(name == "x" for name, _ in results) else ()


def simulation_blocks(model: StateSpaceModel, instants: range) -> Compiled:
    """The blocks of a simulation; see `pfdist.kernels.simulation`.

    A `TraceError` says that a formula cannot be traced.
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
        *(_own(part.model, "measurement", instants) for part in model.parts),
    ]
    return compile_blocks(sources, instants)


def _own(model: StateSpaceModel, name: str, instants: range) -> Source:
    """A formula of the model itself, traced."""
    formula = formula_of(model, name)
    layout = _layout(formula)
    return Source(traced(model, name, instants), layout, model.parameters, formula.results)


def _source(
    model: StateSpaceModel,
    results: int,
    name: str,
    function: Callable[..., Any],
    arguments: dict[str, int],
    instants: range,
) -> Source | None:
    """A formula that is made from those of a model, traced; None without instants."""
    if not instants:
        return None
    given = {**arguments, "p": 0}
    formula = Formula(function, name, given, model.parameters, model.name, results)
    return Source(trace(formula, instants), _layout(formula), model.parameters, results)


def _layout(formula: Formula) -> dict[str, tuple[str, int]]:
    """Array and first row of each argument; those that are rows of slots follow one another."""
    layout, first = dict[str, tuple[str, int]](), 0
    for group, count in formula.arguments.items():
        array = {"y": "given", "w": "noise", "v": "noise", "u": "noise"}.get(group, "slots")
        layout[group] = array, first if array == "slots" else 0
        first += count if array == "slots" else 0
    return layout


class _Formulas:
    """Formulas of a filter that are made from those of a model."""

    def __init__(self, model: StateSpaceModel, is_angle: Sequence[bool]) -> None:
        self.model, self.is_angle = model, is_angle

    def quantity(self, x: Any, t: Any, p: Any) -> tuple[Any, ...]:
        """z, then cosine and sine of each component that is an angle."""
        z = self.model.quantity_of_interest(x, t, p)
        angles = [value for value, is_angle in zip(z, self.is_angle, strict=True) if is_angle]
        return (*z, *(part(angle) for angle in angles for part in (np.cos, np.sin)))

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

    def distance(self, x: Any, p: Any) -> Any:
        """The squared distance of the means of two filters; see `pfdist.filters.interface`."""
        count, total = len(self.is_angle), 0.0
        parts = x[:count], x[count : 2 * count], x[2 * count :], self.is_angle
        for mean, variance, first, is_angle in zip(*parts, strict=True):
            angular = (1.0 - variance) * angular_error(first, mean) if is_angle else 0.0
            total = total + (angular if is_angle else (first - mean) ** 2)
        return total

    def guided(self, x: Any, y: Any, t: Any, u: Any, p: Any) -> tuple[Any, ...]:
        """x(t + 1) by the proposal, and the logarithm of p(w) / q(w | x, y)."""
        formulas = self.model.formulas
        w = formulas["proposal"](x, y, t, u, p)
        by_model = log_density(self.model.process_noise, w)
        by_proposal = formulas["proposal_log_density"](w, x, y, t, p)
        return (*self.model.transition(x, t, w, p), by_model - by_proposal)


def log_density(kinds: Sequence[str], w: Sequence[Any]) -> Any:
    """Log-density of noise of these kinds."""
    total: Any = 0.0
    for kind, value in zip(kinds, w, strict=True):
        if kind == "normal":
            total = total + (-0.5 * value * value - _LOG_OF_ROOT)
        else:
            centre = 0.5 if kind == "uniform" else 0.0
            total = total + np.where(np.abs(value - centre) <= 0.5, 0.0, -math.inf)
    return total


def _direction(cosine: Any, sine: Any) -> Any:
    return np.arctan2(sine, cosine)


def _logarithm(w: Any, p: Any) -> tuple[Any, ...]:
    return (np.log(w[0]),)
