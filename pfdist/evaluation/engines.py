"""Engines: what simulates draws and filters them. A job names one by ``filter.engine``."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pfdist.filters import kalman, plain
from pfdist.filters.draws import Draws, simulate
from pfdist.filters.estimators import one_by_one
from pfdist.filters.particle_filter import Filtered, filter_draws, filter_sets

AUTO: Final = "auto"  # the compiled engine, or NumPy where Numba cannot compile the model


@dataclass(frozen=True)
class Engine:
    """What simulates draws and filters them.

    Parameters
    ----------
    name : str
        As job files name it.
    simulate : callable
        As `pfdist.filters.draws.simulate`.
    filter_draws : callable
        As `pfdist.filters.particle_filter.filter_draws`.
    filter_sets : callable
        As `pfdist.filters.particle_filter.filter_sets`.
    seconds_a_step : float
        About how long a particle takes for one instant.
    compiled : bool
        Whether Numba compiles the formulas. The figures then have the same bits on every processor.
    exact : bool
        Whether the expected MSE is known without draws.
    """

    name: str
    simulate: Callable[..., Draws]
    filter_draws: Callable[..., Filtered]
    filter_sets: Callable[..., NDArray[np.float64]]
    seconds_a_step: float = 2e-9
    compiled: bool = True
    exact: bool = False


COMPILED = Engine("compiled", simulate, filter_draws, filter_sets)
NUMPY = Engine(
    "numpy",
    plain.simulate,
    plain.filter_draws,
    one_by_one(plain.filter_draws),
    seconds_a_step=2e-7,
    compiled=False,
)
KALMAN = Engine(
    "kalman", simulate, kalman.filter_draws, one_by_one(kalman.filter_draws), exact=True
)
ENGINES = {engine.name: engine for engine in (COMPILED, NUMPY, KALMAN)}

NUMPY_TIMES_SLOWER = round(NUMPY.seconds_a_step / COMPILED.seconds_a_step)
