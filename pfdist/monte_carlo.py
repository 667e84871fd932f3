"""The Monte Carlo estimate of the expected MSE (paper, section 2.3, equation 6).

The work is a pure function of its arguments, cut by ranges of draws; whatever the cut, a draw's
MSE is the same, and so is what is computed from all of them in the order of the draws.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfdist import kalman, plain
from pfdist.draws import Draws, simulate
from pfdist.errors import ModelError
from pfdist.estimators import one_by_one
from pfdist.kernels.noise import stream_key
from pfdist.kernels.prefixes import plan
from pfdist.measurement_times import Times
from pfdist.models import StateSpaceModel
from pfdist.particle_filter import (
    Filtered,
    check_filter,
    check_fits,
    filter_draws,
    filter_sets,
    filter_streams,
)

SECONDS_A_STEP = 2e-9
"""About what a particle-step takes."""


class Engine(NamedTuple):
    """What simulates draws, filters them, and filters them with several sets under one noise."""

    simulate: Callable[..., Draws]
    filter_draws: Callable[..., Filtered]
    filter_sets: Callable[..., NDArray[np.float64]]


ENGINES = {
    "compiled": Engine(simulate, filter_draws, filter_sets),
    "numpy": Engine(plain.simulate, plain.filter_draws, one_by_one(plain.filter_draws)),
    "kalman": Engine(simulate, kalman.filter_draws, one_by_one(kalman.filter_draws)),
}
"""The compiled kernel; NumPy, where Numba cannot compile a model; the exact filter of a
linear-Gaussian one."""

NUMPY_TIMES_SLOWER = 100

_TRAJECTORIES = ("mse", "estimate")

DEGENERATE_POLICIES = ("kill", "leave_out")
"""What one degenerate draw does to an evaluation: ``kill``, the paper's, makes its cost infinite;
``leave_out`` takes the mean over the other draws."""


@dataclass(frozen=True)
class Estimation:
    """How the error of one draw is estimated.

    Parameters
    ----------
    particles : int
        P.
    resampling : {"multinomial", "stratified", "systematic", "residual", "sorted_systematic"}
    estimator : {"squared_error", "filter_variance", "two_filters"}
        See `pfdist.estimators`.
    """

    particles: int
    resampling: str = "multinomial"
    estimator: str = "squared_error"

    @property
    def steps_an_instant(self) -> int:
        """Particle-steps of one instant, of all filters."""
        return self.particles * len(filter_streams(0, self.estimator))


_ANY = Estimation(particles=1)


@dataclass(frozen=True)
class Problem:
    """A model and a horizon, and what the filter takes for the truth.

    Parameters
    ----------
    model : StateSpaceModel
        The truth: it draws x, y and z, and says what an error costs.
    horizon : int
        T.
    filter_model : StateSpaceModel, optional
        What the filter takes for the truth; by default it is right.
    dtype : {"float64", "float32"}
        What the particles' states are kept in.
    engine : {"compiled", "numpy", "kalman"}

    Raises
    ------
    ModelError
        The filter's model measures, or is asked for, something of another size; or the engine is
        "kalman" and the model not linear-Gaussian, or not the filter's.
    """

    model: StateSpaceModel
    horizon: int
    filter_model: StateSpaceModel | None = None
    dtype: str = "float64"
    engine: str = "compiled"

    def __post_init__(self) -> None:
        check_fits(self.believed, self.model)
        if self.exact:
            if self.believed != self.model:
                raise ModelError("filter.engine = 'kalman' needs a filter that knows the truth")
            kalman.linear_gaussian(self.model, self.horizon)

    @property
    def believed(self) -> StateSpaceModel:
        """What the filter takes for the truth."""
        return self.filter_model or self.model

    @property
    def exact(self) -> bool:
        """Whether the expected MSE is known without draws; see `expected_mse`."""
        return self.engine == "kalman"

    def expected_mse(
        self, sets: Sequence[Times], ends: Sequence[int] | None = None
    ) -> NDArray[np.float64]:
        """Give the exact expected MSE of each set of times, (S,), where the engine knows it.

        `ends` are the last instants whose errors count, T for all unless given.
        """
        return kalman.expected_mse(self.model, self.horizon, sets, ends)

    @property
    def cheapest_estimator(self) -> str:
        """The estimator whose draws differ least, of those that this problem allows."""
        by = replace(_ANY, estimator="filter_variance")
        try:
            self.check(by)
        except ModelError:
            return _ANY.estimator
        return by.estimator

    def check(self, estimation: Estimation) -> None:
        """Raise an error if an error cannot be estimated so.

        Of an exact engine any estimate is exact: what it is made of changes nothing.

        Raises
        ------
        ModelError
            The estimator or the resampling does not fit the model, or what the filter takes for it.
        """
        by = estimation
        if not self.exact:
            check_filter(
                self.believed, self.model, by.particles, by.resampling, self.dtype, by.estimator
            )

    def compile(self, estimation: Estimation) -> None:
        """Compile what is not yet, by a draw of two instants and one particle.

        Raises
        ------
        ModelError
            A formula cannot be compiled, or failed.
        """
        draws = simulate(self.model, 1, range(1), 0)
        if not self.exact:
            filter_draws(self.believed, draws, (0,), 1, 0, estimation.resampling, dtype=self.dtype)

    @property
    def seconds_a_step(self) -> float:
        """About how long a particle-step takes; models differ."""
        return SECONDS_A_STEP * (NUMPY_TIMES_SLOWER if self.engine == "numpy" else 1)

    def __call__(self, work: "Work") -> "Result":
        """Do the work: simulate the draws once and filter them with every set of times.

        Raises
        ------
        ModelError
            As of `check`, or a formula failed.
        """
        engine, by = ENGINES[self.engine], work.estimation
        self.check(by)
        draws = engine.simulate(self.model, self.horizon, range(*work.draws), work.draws_stream)
        if work.trajectories:
            filtered = [
                engine.filter_draws(
                    self.believed, draws, times, by.particles, stream, by.resampling,
                    trajectories=True, dtype=self.dtype,
                )
                for times, stream in zip(work.measurement_times, work.filter_streams, strict=True)
            ]  # fmt: skip
            mse, estimates = ([getattr(one, name) for one in filtered] for name in _TRAJECTORIES)
            return Result(np.stack(mse, axis=1), draws.z, draws.y, np.stack(estimates))
        values = np.empty((len(draws.index), len(work.measurement_times)))
        for stream, of in _columns(work.filter_streams).items():
            values[:, of] = engine.filter_sets(
                self.believed, draws, [work.measurement_times[column] for column in of],
                by.particles, stream, by.resampling, self.dtype,
                [work.ends[column] for column in of], by.estimator,
            )  # fmt: skip
        return Result(values)

    def results(self, works: Iterable["Work"]) -> list["Result"]:
        """Do works one after another: what a task is."""
        return [self(work) for work in works]


@dataclass(frozen=True)
class Work:
    """Sets of measurement times to be tried on the same draws.

    Parameters
    ----------
    measurement_times : tuple of tuples of int
        S sets.
    ends : tuple of int, (S,)
        Last instant of each set whose error counts.
    filter_streams : tuple of int, (S,)
        Key of each filter's noise.
    draws_stream : int
        Key of the draws.
    draws : (int, int)
        First draw, and the one after the last.
    estimation : Estimation
    trajectories : bool
        Whether z, y and the estimates are wanted.
    """

    measurement_times: tuple[Times, ...]
    ends: tuple[int, ...]
    filter_streams: tuple[int, ...]
    draws_stream: int
    draws: tuple[int, int]
    estimation: Estimation
    trajectories: bool = False

    @property
    def filtered(self) -> int:
        """How many draws are filtered, over all sets."""
        return (self.draws[1] - self.draws[0]) * len(self.measurement_times)

    @property
    def steps_a_draw(self) -> int:
        """Particle-steps of one draw: what sets share is done once."""
        instants = _instants(self.measurement_times, self.ends, self.filter_streams)
        return instants * self.estimation.steps_an_instant

    @property
    def steps(self) -> int:
        """Particle-steps."""
        return (self.draws[1] - self.draws[0]) * self.steps_a_draw


def _columns(streams: Sequence[int]) -> dict[int, list[int]]:
    """Sets that have each stream."""
    return {
        stream: [column for column, its in enumerate(streams) if its == stream]
        for stream in dict.fromkeys(streams)
    }


@lru_cache(maxsize=64)
def _instants(sets: tuple[Times, ...], ends: tuple[int, ...], streams: tuple[int, ...]) -> int:
    """Instants that are filtered in all."""
    total = 0
    for of in _columns(streams).values():
        stops = tuple(ends[column] + 1 for column in of)
        planned, _ = plan(tuple(sets[column] for column in of), max(stops), stops)
        total += int(np.sum(planned.ends - planned.begins))
    return total


@dataclass(frozen=True)
class Result:
    """What became of a `Work` of D draws and S sets.

    Parameters
    ----------
    mse : array of float64, (D, S)
        NaN for a degenerate draw.
    z, y : array of float64, (D, T+1, q) and (D, T+1, m)
    estimates : array of float64, (S, D, T+1, q)
        These three are empty unless trajectories are wanted.
    """

    mse: NDArray[np.float64]
    z: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    y: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    estimates: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class Evaluation:
    """One estimate of the expected MSE for one set of measurement times.

    Parameters
    ----------
    measurement_times : tuple of int
    mse : array of float64, (D,)
        Per-draw MSE; NaN for a degenerate draw.
    degenerate_policy : {"kill", "leave_out"}
    exact : float, optional
        The expected MSE where it is known without draws.
    end : int, optional
        Last instant whose errors count, if it is not T.
    """

    measurement_times: Times
    mse: NDArray[np.float64]
    degenerate_policy: str = "kill"
    exact: float | None = None
    end: int | None = None

    @property
    def draws(self) -> int:
        """D, the degenerate draws included."""
        return self.mse.size

    @cached_property
    def degenerate_draws(self) -> int:
        """How many draws are degenerate."""
        return int(np.isnan(self.mse).sum())

    @cached_property
    def expected_mse(self) -> float:
        """Mean of the per-draw MSE; what a degenerate draw makes of it is the policy's."""
        if self.exact is not None:
            return self.exact
        usable = self._usable
        return float(np.mean(usable)) if usable.size else math.inf

    @cached_property
    def standard_error(self) -> float:
        """Standard error of `expected_mse`, infinite where that is or with fewer than 2 draws."""
        if self.exact is not None:
            return 0.0
        usable = self._usable
        if usable.size < 2 or not np.isfinite(usable).all():
            return math.inf
        return float(np.std(usable, ddof=1) / math.sqrt(usable.size))

    @property
    def cost(self) -> float:
        """What a search minimises: `expected_mse`."""
        return self.expected_mse

    @property
    def _usable(self) -> NDArray[np.float64]:
        if self.degenerate_draws and self.degenerate_policy == "kill":
            return np.empty(0)
        return self.mse[~np.isnan(self.mse)]


class SearchEvaluation(Evaluation):
    """On draws that a search chooses by: its cost is never reported as a set's own."""


class ShortlistEvaluation(Evaluation):
    """On the draws that decide between what searches have found, and on no other."""


E = TypeVar("E", bound=Evaluation)


@dataclass(frozen=True)
class Purpose(Generic[E]):
    """What draws are for. Different purposes have different keys, so they share no draw.

    Parameters
    ----------
    name : str
    evaluation : type
        Of what is estimated from them: what one purpose needs is not taken for another's.
    """

    name: str
    evaluation: type[E]

    def stream(self, seed: int, *what: Any) -> int:
        """Key of the noise for something under this purpose."""
        return stream_key(seed, self.name, *what)


SEARCH = Purpose("search", SearchEvaluation)
SHORTLIST = Purpose("shortlist", ShortlistEvaluation)
REPORT = Purpose("comparison", Evaluation)


def cut(draws: ArrayLike, block: int) -> list[tuple[int, int]]:
    """Cut draws that are still to be done into ranges.

    Parameters
    ----------
    draws : array-like of int
        Sorted, without repetition.
    block : int
        A range lies between two multiples of this.

    Returns
    -------
    list of (int, int)
        First draw, and the one after the last.

    Examples
    --------
    >>> cut([0, 1, 2, 3, 4, 7, 8], block=3)
    [(0, 3), (3, 5), (7, 9)]
    """
    index = np.asarray(draws)
    if not index.size:
        return []
    starts = np.flatnonzero((np.diff(index) > 1) | (index[1:] % block == 0)) + 1
    return [(int(piece[0]), int(piece[-1]) + 1) for piece in np.split(index, starts)]
