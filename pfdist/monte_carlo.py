"""The Monte Carlo estimate of the expected MSE (paper, section 2.3, equation 6).

The work is a pure function of its arguments, cut by ranges of draws; whatever the cut, a draw's
MSE is the same, and so is what is computed from all of them in the order of the draws.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfdist import kalman, plain
from pfdist.draws import Draws, simulate
from pfdist.errors import ModelError
from pfdist.measurement_times import Times
from pfdist.models import StateSpaceModel
from pfdist.particle_filter import Filtered, check_filter, filter_draws, filter_sets

SECONDS_A_STEP = 2e-9
"""About what a particle-step takes."""


class Engine(NamedTuple):
    """What simulates draws, filters them, and filters them with several sets under one noise."""

    simulate: Callable[..., Draws]
    filter_draws: Callable[..., Filtered]
    filter_sets: Callable[..., NDArray[np.float64]]


def _one_by_one(filter_draws: Callable[..., Filtered]) -> Callable[..., NDArray[np.float64]]:
    def filter_sets(
        model: StateSpaceModel, draws: Draws, sets: Sequence[Times], *settings: Any, **more: Any
    ) -> NDArray[np.float64]:
        filtered = [filter_draws(model, draws, times, *settings, **more) for times in sets]
        return np.stack([one.mse for one in filtered], axis=1)

    return filter_sets


ENGINES = {
    "compiled": Engine(simulate, filter_draws, filter_sets),
    "numpy": Engine(plain.simulate, plain.filter_draws, _one_by_one(plain.filter_draws)),
    "kalman": Engine(simulate, kalman.filter_draws, _one_by_one(kalman.filter_draws)),
}
"""The compiled kernel; NumPy, where Numba cannot compile a model; the exact filter of a
linear-Gaussian one."""

NUMPY_TIMES_SLOWER = 100

_TRAJECTORIES = ("mse", "estimate")

DEGENERATE_POLICIES = ("kill", "leave_out")
"""What one degenerate draw does to an evaluation: ``kill``, the paper's, makes its cost infinite;
``leave_out`` takes the mean over the other draws."""


@dataclass(frozen=True)
class Problem:
    """A model, a horizon and the filter that is to follow it.

    Parameters
    ----------
    model : StateSpaceModel
        The truth: it draws x, y and z, and says what an error costs.
    horizon : int
        T.
    particles : int
        P.
    resampling : {"multinomial", "stratified", "systematic", "residual"}
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
    particles: int
    resampling: str = "multinomial"
    filter_model: StateSpaceModel | None = None
    dtype: str = "float64"
    engine: str = "compiled"

    def __post_init__(self) -> None:
        believed = self.filter_model or self.model
        check_filter(believed, self.model, self.particles, self.resampling, self.dtype)
        if self.exact:
            if believed != self.model:
                raise ModelError("filter.engine = 'kalman' needs a filter that knows the truth")
            kalman.linear_gaussian(self.model, self.horizon)

    @property
    def exact(self) -> bool:
        """Whether the expected MSE is known without draws; see `expected_mse`."""
        return self.engine == "kalman"

    def expected_mse(self, sets: Sequence[Times]) -> NDArray[np.float64]:
        """Give the exact expected MSE of each set of times, (S,), where the engine knows it."""
        return kalman.expected_mse(self.model, self.horizon, sets)

    def compile(self) -> None:
        """Compile what is not yet, by a draw of two instants and one particle.

        Raises
        ------
        ModelError
            A formula cannot be compiled, or failed.
        """
        draws = simulate(self.model, 1, range(1), 0)
        if self.exact:
            return
        believed = self.filter_model or self.model
        filter_draws(believed, draws, (0,), 1, 0, self.resampling, dtype=self.dtype)

    @property
    def seconds_a_draw(self) -> float:
        """About how long it takes to filter a draw; models differ."""
        slower = NUMPY_TIMES_SLOWER if self.engine == "numpy" else 1
        return SECONDS_A_STEP * slower * self.particles * (self.horizon + 1)

    def __call__(self, work: "Work") -> "Result":
        """Do the work: simulate the draws once and filter them with every set of times."""
        engine, believed = ENGINES[self.engine], self.filter_model or self.model
        draws = engine.simulate(self.model, self.horizon, range(*work.draws), work.draws_stream)
        if work.trajectories:
            filtered = [
                engine.filter_draws(
                    believed, draws, times, self.particles, stream, self.resampling,
                    trajectories=True, dtype=self.dtype,
                )
                for times, stream in zip(work.measurement_times, work.filter_streams, strict=True)
            ]  # fmt: skip
            mse, estimates = ([getattr(one, name) for one in filtered] for name in _TRAJECTORIES)
            return Result(np.stack(mse, axis=1), draws.z, draws.y, np.stack(estimates))
        values = np.empty((len(draws.index), len(work.measurement_times)))
        for stream in dict.fromkeys(work.filter_streams):
            of = [column for column, its in enumerate(work.filter_streams) if its == stream]
            values[:, of] = engine.filter_sets(
                believed, draws, [work.measurement_times[column] for column in of],
                self.particles, stream, self.resampling, dtype=self.dtype,
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
    filter_streams : tuple of int, (S,)
        Key of each filter's noise.
    draws_stream : int
        Key of the draws.
    draws : (int, int)
        First draw, and the one after the last.
    trajectories : bool
        Whether z, y and the estimates are wanted.
    """

    measurement_times: tuple[Times, ...]
    filter_streams: tuple[int, ...]
    draws_stream: int
    draws: tuple[int, int]
    trajectories: bool = False

    @property
    def filtered(self) -> int:
        """How many draws are filtered, over all sets."""
        return (self.draws[1] - self.draws[0]) * len(self.measurement_times)


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
    """

    measurement_times: Times
    mse: NDArray[np.float64]
    degenerate_policy: str = "kill"
    exact: float | None = None

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
