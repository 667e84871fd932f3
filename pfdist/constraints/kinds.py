"""All constraints by the names under which files and workers know them."""

from typing import Final, NamedTuple

from pfdist.constraints.apart import Apart
from pfdist.constraints.most_within import MostWithin
from pfdist.constraints.setup import Setup
from pfdist.constraints.step import Step
from pfdist.constraints.supply import Supply
from pfdist.constraints.together import Together

KINDS: Final[dict[str, type[Step]]] = {
    each.kind: each for each in (Apart, Setup, Together, MostWithin, Supply)
}


class PlainStep(NamedTuple):
    """A constraint as plain numbers, as files and compiled filters have it."""

    kind: str  # in `KINDS`
    table: tuple[int, ...]
    start: tuple[int, ...]
    fee: float = 0.0
    first: int = 0

    def is_of(self, ways: int, instants: int) -> bool:
        """Whether numbers from a file are those of sensors and instants, so that a step may run."""
        step = None if self.first else KINDS.get(self.kind)
        return step is not None and step.is_whole(self.table, self.start, ways, instants)

    @classmethod
    def made_from(cls, step: Step) -> "PlainStep":
        """Those of a constraint."""
        return cls(step.kind, step.table, step.start, float(step.fee), step.first)
