"""The compiled code of an evaluator: compile it, and tell what it calls."""

from dataclasses import replace

from pfdist.evaluation.evaluator import Evaluator
from pfdist.evaluation.work import Estimation
from pfdist.filters.particle_filter import (
    filter_checked_draws,
    filter_makes_arrays,
    libm_of_filter,
)
from pfdist.filters.simulation import libm_of_simulation, simulate, simulation_makes_arrays


def compile_evaluator(evaluator: Evaluator, estimation: Estimation) -> None:
    """Compile the simulation and the filter, by a draw of two instants and one particle.

    Raises
    ------
    ModelError
        A formula cannot be compiled, or failed.
    """
    draws = simulate(evaluator.model, 1, range(1), 0)
    if not evaluator.exact:
        settings = evaluator.settings(replace(estimation, particles=1))
        filter_checked_draws(evaluator.believed, draws, (0,), 0, settings)


def libm_functions(evaluator: Evaluator, estimation: Estimation) -> tuple[str, ...]:
    """Functions of the C library that the compiled formulas call; call `compile_evaluator` first.

    The last digits of these functions may differ between processors. All other compiled code
    gives the same bytes on every processor.
    """
    found = set(libm_of_simulation(evaluator.model))
    if not evaluator.exact:
        found |= set(
            libm_of_filter(
                evaluator.believed, evaluator.model, estimation.resampling, evaluator.dtype
            )
        )
    return tuple(sorted(found))


def makes_arrays(evaluator: Evaluator, estimation: Estimation) -> bool:
    """Whether compiled formulas make arrays for each particle; call `compile_evaluator` first."""
    return simulation_makes_arrays(evaluator.model) or filter_makes_arrays(
        evaluator.believed, evaluator.model, estimation.resampling, evaluator.dtype
    )
