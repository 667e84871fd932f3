"""The engines that a job can name by ``filter.engine``; plugins declare more."""

from typing import TYPE_CHECKING, Final, Literal

from pfdist.common.plugins import added
from pfdist.filters.engine import Engine

AUTO: Final = "auto"  # the compiled engine, or the batched one for a batched model

COMPILED = Engine(
    "compiled",
    "Formulas traced with symbols, and compiled for sixteen particles at a time.",
    simulated_by="pfdist.filters.simulation",
    filtered_by="pfdist.filters.particle_filter",
)
BATCHED = Engine(
    "batched",
    "The compiled engine, which calls functions of batched models on arrays of particles.",
    simulated_by="pfdist.filters.simulation",
    filtered_by="pfdist.filters.particle_filter",
    seconds_a_step=3e-8,
    compiled=False,
)
NUMPY = Engine(
    "numpy",
    "All formulas on NumPy arrays; the reference of the compiled engine.",
    simulated_by="pfdist.filters.plain",
    filtered_by="pfdist.filters.plain",
    seconds_a_step=2e-7,
    compiled=False,
)
KALMAN = Engine(
    "kalman",
    "The Kalman filter: the exact expected MSE of a linear-Gaussian model.",
    simulated_by="pfdist.filters.simulation",
    filtered_by="pfdist.filters.kalman",
    exact=True,
    has_particles=False,
    least_draws=200,
)
_OWN = COMPILED, BATCHED, NUMPY, KALMAN
ENGINES: dict[str, Engine] = {engine.name: engine for engine in (*_OWN, *added("engines"))}
if TYPE_CHECKING:
    EngineName = str
else:
    EngineName = Literal[(AUTO, *ENGINES)]


def is_exact(name: str) -> bool:
    """Whether the engine of this name in ``filter.engine`` computes the expected MSE without draws.

    >>> is_exact("kalman"), is_exact("auto")
    (True, False)
    """
    return name in ENGINES and ENGINES[name].exact


WITHOUT_FMA = (
    "this processor has no fused multiply-add (FMA), so filters take about 10 times as long"
)
