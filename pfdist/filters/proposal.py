"""The type of a proposal of ``filter.proposal``: how particles get their noise."""

from dataclasses import dataclass
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Final

from pfdist.errors import ModelError
from pfdist.filters.engines import BATCHED

if TYPE_CHECKING:
    from pfdist.models import StateSpaceModel


@dataclass(frozen=True)
class Proposal:
    """A proposal."""

    name: str  # as job files name it
    engines: tuple[str, ...] = ()  # that know it; none: all
    # plain particle-steps in the time of one; if it is more than 1, "auto" takes it where it loses
    # less in the same time
    cost: int = 1
    # whether lines of particles move, and have a number of their own; then "auto" takes it where a
    # plain filter loses constants
    moves: bool = False
    why: str = ""  # "auto" takes it
    described: str = "a bootstrap particle filter with {}"  # with the number of particles
    # that of a filter with the truth among its particles, and how many times as many it has
    beside_truth: str = "plain"
    times_beside_truth: int = 1
    takes_weights: bool = True  # whether particles may carry weights between measurements
    # the function that gives the extension of the compiled filter, see
    # `pfdist.kernels.filter.Extension`; none if there is none
    extended_by: str = ""
    # the function that is the plain twin; none if it is that of `pfdist.filters.plain`
    twin_by: str = ""

    def check(self, engine: str, model: "StateSpaceModel", *, carries: bool = False) -> None:
        """Raise `ModelError` if an engine does not know it, or a filter wrongly carries weights."""
        if carries and not self.takes_weights:
            raise ModelError(
                f"filter.proposal = {self.name!r} needs filter.resample = 'always', got "
                "'below ...': its particles have equal weights"
            )
        if not self.engines or engine in self.engines:
            return
        needed = f"filter.proposal = {self.name!r} needs"
        if engine == BATCHED.name:
            raise ModelError(
                f"{needed} formulas that can be traced, got the batched model {model.name}: "
                f"{PLAIN.name!r} is for every model"
            )
        known = " or ".join(map(repr, self.engines))
        raise ModelError(
            f"{needed} filter.engine = {known}, got {engine!r}: {PLAIN.name!r} is for every engine"
        )

    def extension(self, model: "StateSpaceModel", draws: Any, settings: Any) -> Any:
        """The extension of the filter of some draws; None for none."""
        if not self.extended_by:
            return None
        return resolve_name(self.extended_by)(model, draws, settings)

    @property
    def twin(self) -> Any:
        """The plain twin of the filter of some draws; None for the usual one."""
        return resolve_name(self.twin_by) if self.twin_by else None


PLAIN: Final = Proposal("plain")  # noise is drawn from the model
