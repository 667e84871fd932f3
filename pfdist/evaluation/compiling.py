"""The compiled code of a problem: compile it, and tell what it calls."""

from pfdist.evaluation.problem import Problem
from pfdist.evaluation.work import Estimation
from pfdist.filters.draws import libm_of_simulation, simulate, simulation_makes_arrays
from pfdist.filters.particle_filter import filter_draws, filter_makes_arrays, libm_of_filter


def compile_problem(problem: Problem, estimation: Estimation) -> None:
    """Compile the simulation and the filter, by a draw of two instants and one particle.

    Raises
    ------
    ModelError
        A formula cannot be compiled, or failed.
    """
    draws = simulate(problem.model, 1, range(1), 0)
    if not problem.exact:
        filter_draws(
            problem.believed, draws, (0,), 1, 0, estimation.resampling, dtype=problem.dtype
        )


def libm_functions(problem: Problem, estimation: Estimation) -> tuple[str, ...]:
    """Functions of the C library that the compiled formulas call; call `compile_problem` first.

    The last digits of these functions may differ between processors. All other compiled code
    gives the same bytes on every processor.
    """
    found = set(libm_of_simulation(problem.model))
    if not problem.exact:
        found |= set(
            libm_of_filter(problem.believed, problem.model, estimation.resampling, problem.dtype)
        )
    return tuple(sorted(found))


def makes_arrays(problem: Problem, estimation: Estimation) -> bool:
    """Whether compiled formulas make arrays for each particle; call `compile_problem` first."""
    return simulation_makes_arrays(problem.model) or filter_makes_arrays(
        problem.believed, problem.model, estimation.resampling, problem.dtype
    )
