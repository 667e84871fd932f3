"""The proposals that a job can name by ``filter.proposal``: how particles get their noise."""

from dataclasses import dataclass
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Final, Literal

from pfdist.errors import ModelError
from pfdist.filters.engines import BATCHED, COMPILED, NUMPY

if TYPE_CHECKING:
    from pfdist.models import StateSpaceModel

AUTO: Final = "auto"  # the one that loses least in the same time


@dataclass(frozen=True)
class Proposal:
    """A proposal."""

    name: str  # as job files name it
    engines: tuple[str, ...] = ()  # that know it; none: all
    cost: int = 1  # plain particle-steps in the time of one; see docs/benchmarks.md
    why: str = ""  # "auto" takes it
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


PLAIN = Proposal("plain")  # noise is drawn from the model
GUIDED = Proposal(
    "guided",  # noise since the last measurement is drawn again when the next one is known
    engines=(COMPILED.name,), cost=8, beside_truth="guided",
    extended_by="pfdist.guided.arrays:guided_extension",
    why="which loses less in the same time; a step takes about 8 times as long",
)  # fmt: skip
MOVING = Proposal(
    "moving",  # whole lines of particles take Metropolis steps at each measurement
    engines=(COMPILED.name, NUMPY.name), cost=100, times_beside_truth=5, takes_weights=False,
    extended_by="pfdist.moving.arrays:moved_extension",
    twin_by="pfdist.moving.plain:filter_block",
    why="because a plain filter loses the constants among the components of x",
)  # fmt: skip
FEW_VALUES: Final = 20
"""Fewer different values of a component that does not move are too few for an estimate."""
MOST_INSTANTS: Final = 2000
"""The largest horizon for which a choice takes particles that move: their work grows with it."""
PROPOSALS = {each.name: each for each in (PLAIN, GUIDED, MOVING)}
if TYPE_CHECKING:
    ProposalName = str
else:
    ProposalName = Literal[(AUTO, *PROPOSALS)]
