"""The engines that a job can name by ``filter.engine``; they are imported when they are used."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final, Literal

from pfdist.errors import MissingExtraError

AUTO: Final = "auto"  # the compiled engine, or the batched one for a batched model


@dataclass(frozen=True)
class Engine:
    """An engine: the functions that simulate and filter draws, with its properties."""

    name: str  # as job files name it
    description: str  # in one line, for help and manual
    # The module whose `simulate` has the contract of `pfdist.filters.simulation.simulate`.
    simulated_by: str
    # The module whose `filter_draws`, `filter_checked_draws` and `filter_checked_sets` have the
    # contracts of those in `pfdist.filters.particle_filter`.
    filtered_by: str
    seconds_a_step: float = 2e-9  # about how long a particle takes for one instant
    # whether all formulas are compiled, and keep no lock of Python
    compiled: bool = True
    exact: bool = False  # whether the expected MSE is known without draws
    has_particles: bool = True
    least_draws: int = 1  # of a task: so many take hardly longer than one
    libraries: tuple[str, ...] = ()  # of the extra with its name; a run notes their versions

    def check(self) -> None:
        """Raise `MissingExtraError` if a library that it needs is not installed."""
        for name in self.libraries:
            if find_spec(name) is None:
                raise MissingExtraError(f"filter.engine = {self.name!r}", self.name, name)

    @property
    def simulate(self) -> Callable[..., Any]:
        """The function that simulates draws."""
        function: Callable[..., Any] = import_module(self.simulated_by).simulate
        return function

    @property
    def filters(self) -> ModuleType:
        """The module whose functions filter draws."""
        return import_module(self.filtered_by)


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
JAX = Engine(
    "jax",
    "Formulas compiled by JAX, for a GPU.",
    simulated_by="pfdist.filters.simulation",
    filtered_by="pfdist.accelerator.filter",
    seconds_a_step=2e-8,
    least_draws=24,
    libraries=("jax", "jaxlib"),
)
ENGINES = {engine.name: engine for engine in (COMPILED, BATCHED, NUMPY, KALMAN, JAX)}
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
