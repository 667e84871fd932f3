"""Unknown parameters as components of the state, which a filter learns.

These components never move, so resampling only removes values, and many particles are needed. In
all other respects it is a model like any other: truth and filter have the same prior.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pfdist.common.scenario import Scenario
from pfdist.elementwise import where
from pfdist.models.base import StateSpaceModel
from pfdist.models.checks import ARGUMENTS
from pfdist.models.mistakes import is_interrupt
from pfdist.models.parameters import Parameter
from pfdist.models.symbols import take
from pfdist.models.tracing import recording_of

Distributions = Mapping[str, Mapping[str, tuple[float, float]]]
"""For each parameter the kind of its distribution, with two numbers.

They are the mean and sd of "normal", the median and the sd of the logarithm of "lognormal", and the
ends of "uniform".
"""


def learned(
    model: StateSpaceModel, prior: Distributions | Sequence[Scenario], motion: float = 0.0
) -> StateSpaceModel:
    """The model with its unknown parameters added to the state.

    Parameters
    ----------
    model : StateSpaceModel
    prior : mapping or sequence of Scenario
        A distribution for each unknown parameter, whose values are components of the state. Or
        scenarios: then the scenario's number is a component.
    motion : float
        The random step of a parameter at each instant, in units of its prior standard deviation. It
        keeps the values in a filter diverse; the truth does not move.

    Returns
    -------
    StateSpaceModel
        `initial` takes further noise and gives further components. A formula that needs an unknown
        parameter as a number can be traced only for scenarios; all of them are then computed.
    """
    known = _Scenarios(tuple(prior)) if isinstance(prior, Sequence) else _Parameters(prior)
    for values in known.examples:
        model.with_parameters(values)  # it refuses unknown names, and values outside their range
    n = model.components[0]

    def initial(w: Any, p: Any) -> Any:
        own = len(model.initial_noise)
        parts = known.begun(w[own:])
        return (*known.call(model.initial, (w[:own],), p, parts), *parts)

    def transition(x: Any, t: Any, w: Any, p: Any) -> Any:
        own = len(model.process_noise)
        values = known.call(model.transition, (x[:n], t, w[:own]), p, x[n:])
        if isinstance(known, _Scenarios) or not motion:
            return (*values, *x[n:])
        return (*values, *known.moved(x[n:], w[own:], motion))

    def with_parts(owner: Any, name: str) -> Callable[..., Any]:
        formula, place = getattr(owner, name), ARGUMENTS[name].index("x")

        def function(*arguments: Any) -> Any:
            *given, p = arguments
            x = given[place]
            given[place] = x[:n]
            return known.call(formula, given, p, x[n:])

        return function

    return model.with_formulas(
        with_parts,
        initial=initial,
        transition=transition,
        error=model.error,
        initial_noise=(*model.initial_noise, *known.noise),
        process_noise=(*model.process_noise, *(["normal"] * len(known.names) if motion else ())),
        x_names=(*model.x_names, *known.names) if model.x_names else (),
        linear_gaussian=False,
    )


class _Known:
    """Parameters of which some are values of a particle."""

    def __init__(self, p: Any, values: Mapping[str, Any]) -> None:
        self._p, self._values = p, values

    def __getattr__(self, name: str) -> Any:
        return self._values[name] if name in self._values else getattr(self._p, name)

    def _asdict(self) -> dict[str, Any]:
        return {**self._p._asdict(), **self._values}


@dataclass(frozen=True)
class _Parameters:
    distributions: Distributions

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components."""
        return (*self.distributions,)

    @property
    def _pairs(self) -> list[tuple[str, tuple[float, float]]]:
        return [pair for each in self.distributions.values() for pair in each.items()]

    @property
    def noise(self) -> tuple[str, ...]:
        """The noise from which each component begins."""
        return tuple("uniform" if kind == "uniform" else "normal" for kind, _ in self._pairs)

    @property
    def examples(self) -> Sequence[Mapping[str, Parameter]]:
        """Values that the parameters may have: the ends of a distribution, or 3 deviations away."""
        ends = {"uniform": (0.0, 1.0)}
        return [
            {
                name: _quantile(kind, *numbers, ends.get(kind, (-3.0, 3.0))[side])
                for name, (kind, numbers) in zip(self.names, self._pairs, strict=True)
            }
            for side in (0, 1)
        ]

    def begun(self, w: Sequence[Any]) -> tuple[Any, ...]:
        """The components of x(0)."""
        return tuple(
            _quantile(kind, *numbers, variate)
            for (kind, numbers), variate in zip(self._pairs, w, strict=True)
        )

    def moved(self, parts: Sequence[Any], w: Sequence[Any], motion: float) -> tuple[Any, ...]:
        """The components after a small step, on the scale on which their noise is."""
        return tuple(
            part * np.exp(motion * second * step)
            if kind == "lognormal"
            else part + motion * (second if kind == "normal" else (second - first) / 12**0.5) * step
            for (kind, (first, second)), part, step in zip(self._pairs, parts, w, strict=True)
        )

    def call(
        self, formula: Callable[..., Any], given: Sequence[Any], p: Any, parts: Sequence[Any]
    ) -> Any:
        """The value of a formula."""
        return formula(*given, _Known(p, dict(zip(self.names, parts, strict=True))))


def _quantile(kind: str, first: float, second: float, variate: Any) -> Any:
    if kind == "uniform":
        return first + (second - first) * variate
    return first * np.exp(second * variate) if kind == "lognormal" else first + second * variate


@dataclass(frozen=True)
class _Scenarios:
    scenarios: tuple[Scenario, ...]

    names, noise = ("scenario",), ("uniform",)

    @property
    def examples(self) -> Sequence[Mapping[str, Parameter]]:
        """Values that the parameters may have."""
        return [each.parameters for each in self.scenarios]

    def begun(self, w: Sequence[Any]) -> tuple[Any, ...]:
        """The number of the scenario."""
        ends = np.cumsum([each.share for each in self.scenarios])[:-1].tolist()
        number = 0.0 * w[0]
        for end in ends:
            number = number + where(w[0] >= end, 1.0, 0.0)
        return (number,)

    def call(
        self, formula: Callable[..., Any], given: Sequence[Any], p: Any, parts: Sequence[Any]
    ) -> Any:
        """The value of a formula, which looks parameters up by the number of the scenario.

        If it needs them as numbers, it is computed for each scenario, and one value is chosen.
        """
        number = parts[0].astype(int) if hasattr(parts[0], "astype") else int(parts[0])
        numbers = [each.parameters for each in self.scenarios]
        looked_up = {
            name: _looked_up([each[name] for each in numbers], number) for name in numbers[0]
        }
        try:
            return formula(*given, _Known(p, looked_up))
        except BaseException as error:  # a formula may raise any exception
            if is_interrupt(error) or recording_of(p) is not None:
                raise
        values = [formula(*given, _Known(p, each)) for each in numbers]
        return _chosen(values, number)


def _looked_up(values: Sequence[Parameter], number: Any) -> Any:
    if any(isinstance(each, tuple) for each in values):
        return _Varying(values, number)
    return take(values, number)


class _Varying:
    """A parameter with a value for each instant, of the scenario with a number."""

    def __init__(self, values: Sequence[Any], number: Any) -> None:
        size = max(len(each) for each in values if isinstance(each, tuple))
        self._table = np.array([np.broadcast_to(each, size) for each in values])
        self._number = number

    def __getitem__(self, t: Any) -> Any:
        return take(self._table.ravel(), self._number * self._table.shape[1] + t)


def _chosen(values: Sequence[Any], number: Any) -> Any:
    """The value of the scenario with a number: a number, or components."""
    if isinstance(values[0], tuple):
        return tuple(_chosen(each, number) for each in zip(*values, strict=True))
    chosen: Any = math.nan
    for k, value in enumerate(values):
        chosen = where(number == k, value, chosen)
    return chosen
