"""An evaluator as data, which travels to the workers."""

import pickle
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from pfdist.common.streams import stream_key
from pfdist.errors import ModelError
from pfdist.evaluation.compiling import compile_evaluator, libm_functions
from pfdist.evaluation.engines import NUMPY
from pfdist.evaluation.evaluator import Evaluator
from pfdist.evaluation.work import Estimation
from pfdist.filters.particle_filter import KERNEL_VERSION
from pfdist.filters.settings import check_fits
from pfdist.models import CarriedModel
from pfdist.models.mistakes import NO_CLOCK
from pfdist.models.parameters import check_lengths
from pfdist.times.measurement_times import Times


@dataclass(frozen=True)
class EvaluatorSource:
    """An evaluator as data, from which each worker makes the evaluator itself.

    Parameters
    ----------
    model, filter_model : CarriedModel
    horizon : int
    dtype, engine : str
    estimations : tuple of Estimation
        Estimations that the run uses; the comparison's first.
    clock : tuple of float, (T+1,), optional
        The time of each instant, which formulas read; None if the job has no clock.
    weights : tuple of float, (T+1,), optional
        Weight of each instant's error in the MSE, with mean 1; None if all are 1.
    """

    model: CarriedModel
    filter_model: CarriedModel
    horizon: int
    dtype: str
    engine: str
    estimations: tuple[Estimation, ...]
    clock: tuple[float, ...] | None = None
    weights: tuple[float, ...] | None = None

    @property
    def truth(self) -> "EvaluatorSource":
        """The same evaluator with a filter that knows the true model."""
        return replace(self, filter_model=self.model)

    def make(self) -> Evaluator:
        """The evaluator with every estimation checked.

        Raises
        ------
        ModelError
            A model cannot be made here, reads a clock that the job lacks, or does not fit the job.
        """
        model, filter_model = self.model.model, self.filter_model.model
        for part, each in (("model", model), ("model.filter", filter_model)):
            if self.clock is None and each.reads_clock:
                raise ModelError(
                    f"{part}: model {each.name} reads the clock: {NO_CLOCK} (a job's clock is "
                    "problem.time_step, problem.time_unit or problem.times)"
                )
        if self.clock is not None:
            model, filter_model = model.on_clock(self.clock), filter_model.on_clock(self.clock)
        for part, each in (("model", model), ("model.filter", filter_model)):
            where = f"{part}.parameters."
            check_lengths(each.parameters, self.horizon + 1, where, exactly=True)
        check_fits(filter_model, model)
        filter_model = filter_model.named_as(model)
        evaluator = Evaluator(
            model, self.horizon, filter_model, self.dtype, self.engine, weights=self.weights
        )
        for estimation in self.estimations:
            evaluator.check(estimation)
        return evaluator

    def compiled(self) -> Evaluator:
        """The evaluator with everything compiled that the estimations need."""
        evaluator = self.make()
        if self.engine != NUMPY.name:
            for estimation in self.estimations:
                compile_evaluator(evaluator, estimation)
        return evaluator

    def libm_functions(self) -> tuple[str, ...]:
        """Functions of the C library that the compiled formulas call."""
        return () if self.engine == NUMPY.name else _libm_functions(pickle.dumps(self))

    def evaluation_id(self, times: Times, end: int, stream: int, estimation: Estimation) -> str:
        """Id of an evaluation: a hash of everything on which its per-draw MSE depends."""
        return self._id(estimation, times, end, stream)

    def sums_id(
        self,
        sets: Sequence[Times],
        instants: Sequence[tuple[int, int]],
        stream: int,
        estimation: Estimation,
    ) -> str:
        """Id of sums of errors: a hash of everything on which they depend but their draws.

        Parameters
        ----------
        sets : sequence of tuples of int
        instants : sequence of pairs of int
            First and last instant at which the errors of each set count.
        stream : int
        estimation : Estimation
        """
        return self._id(estimation, sets, instants, stream, "sums")

    def _id(self, estimation: Estimation, *parts: Any) -> str:
        key = stream_key(
            KERNEL_VERSION,
            self.model.key,
            self.filter_model.key,
            self.horizon,
            self.dtype,
            self.engine,
            vars(estimation),
            *(part for part in (self.clock, self.weights) if part is not None),
            *parts,
        )
        return f"{key:016x}"


@lru_cache(maxsize=32)  # the points of a sweep often have the same formulas
def _libm_functions(content: bytes) -> tuple[str, ...]:
    source: EvaluatorSource = pickle.loads(content)  # noqa: S301  pickled in this process
    evaluator = source.compiled()
    found = (libm_functions(evaluator, estimation) for estimation in source.estimations)
    return tuple(sorted(set().union(*found)))
