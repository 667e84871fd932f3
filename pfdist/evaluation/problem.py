"""The Monte Carlo estimate of the expected MSE (paper, section 2.3, equation 6).

The work is a pure function of its arguments, cut by ranges of draws; whatever the cut, a draw's
MSE is the same, and so is what is computed from all of them in the order of the draws.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import ModelError
from pfdist.evaluation.engines import COMPILED, ENGINES, KALMAN, Engine
from pfdist.evaluation.work import Estimation, Result, Work, columns
from pfdist.filters import kalman
from pfdist.filters.draws import libm_of_simulation, simulate, simulation_makes_arrays
from pfdist.filters.particle_filter import (
    check_filter,
    check_fits,
    filter_draws,
    filter_makes_arrays,
    libm_of_filter,
)
from pfdist.kernels.estimators import FILTER_VARIANCE
from pfdist.models import StateSpaceModel
from pfdist.times.measurement_times import Times

_TRAJECTORIES = ("mse", "estimate")

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
    engine : {"auto", "compiled", "numpy", "kalman"}
        "auto" is the compiled one here.

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
                raise ModelError(
                    f"filter.engine = {KALMAN.name!r} needs a filter that knows the truth"
                )
            kalman.linear_gaussian(self.model, self.horizon)

    @property
    def believed(self) -> StateSpaceModel:
        """What the filter takes for the truth."""
        return self.filter_model or self.model

    @property
    def _engine(self) -> Engine:
        return ENGINES.get(self.engine, COMPILED)

    @property
    def exact(self) -> bool:
        """Whether the expected MSE is known without draws; see `expected_mse`."""
        return self._engine.exact

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
        estimation = replace(_ANY, estimator=FILTER_VARIANCE.name)
        try:
            self.check(estimation)
        except ModelError:
            return _ANY.estimator
        return estimation.estimator

    def check(self, estimation: Estimation) -> None:
        """Raise an error if an error cannot be estimated so.

        Exact engines ignore the estimator and the number of particles.

        Raises
        ------
        ModelError
            The estimator or the resampling does not fit the model, or what the filter takes for it.
        """
        if not self.exact:
            check_filter(
                self.believed,
                self.model,
                estimation.particles,
                estimation.resampling,
                self.dtype,
                estimation.estimator,
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

    def libm_functions(self, estimation: Estimation) -> tuple[str, ...]:
        """Functions of the C library that the formulas call, compiled; they were before.

        Their last digits may differ between processors. All else that is compiled gives the same
        bytes on each.
        """
        found = set(libm_of_simulation(self.model))
        if not self.exact:
            found |= set(
                libm_of_filter(self.believed, self.model, estimation.resampling, self.dtype)
            )
        return tuple(sorted(found))

    def makes_arrays(self, estimation: Estimation) -> bool:
        """Whether formulas, compiled before, make arrays for each particle."""
        return simulation_makes_arrays(self.model) or filter_makes_arrays(
            self.believed, self.model, estimation.resampling, self.dtype
        )

    @property
    def seconds_a_step(self) -> float:
        """About how long a particle-step takes; models differ."""
        return self._engine.seconds_a_step

    def __call__(self, work: Work) -> Result:
        """Do the work: simulate the draws once and filter them with every set of times.

        Raises
        ------
        ModelError
            As of `check`, or a formula failed.
        """
        engine, estimation = self._engine, work.estimation
        self.check(estimation)
        draws = engine.simulate(self.model, self.horizon, range(*work.draws), work.draws_stream)
        if work.trajectories:
            filtered = [
                engine.filter_draws(
                    self.believed, draws, times, estimation.particles, stream,
                    estimation.resampling, trajectories=True, dtype=self.dtype,
                )
                for times, stream in zip(work.measurement_times, work.filter_streams, strict=True)
            ]  # fmt: skip
            mse, estimates = (
                [getattr(result, name) for result in filtered] for name in _TRAJECTORIES
            )
            return Result(np.stack(mse, axis=1), draws.z, draws.y, np.stack(estimates))
        values = np.empty((len(draws.index), len(work.measurement_times)))
        for stream, same_noise in columns(work.filter_streams).items():
            values[:, same_noise] = engine.filter_sets(
                self.believed, draws, [work.measurement_times[column] for column in same_noise],
                estimation.particles, stream, estimation.resampling, self.dtype,
                [work.ends[column] for column in same_noise], estimation.estimator,
            )  # fmt: skip
        return Result(values)

    def results(self, works: Iterable[Work]) -> list[Result]:
        """Do works one after another: what a task is."""
        return [self(work) for work in works]
