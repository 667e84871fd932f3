"""The type of an engine of ``filter.engine``; its modules are imported when they are used."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

from pfdist.errors import MissingExtraError


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
