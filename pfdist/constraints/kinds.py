"""The steps of all constraints, by the names under which files and workers know them."""

from collections.abc import Callable
from typing import Final, NamedTuple

from pfdist.constraints.apart import apart_step
from pfdist.constraints.most_within import most_within_step
from pfdist.constraints.setup import setup_step
from pfdist.constraints.step import Step, Turn
from pfdist.constraints.supply import supply_step
from pfdist.constraints.together import together_step

STEPS: Final[dict[str, Callable[[Turn], None]]] = {
    "apart": apart_step, "setup": setup_step, "together": together_step,
    "most_within": most_within_step, "store": supply_step,
}  # fmt: skip


class PlainStep(NamedTuple):
    """A constraint as plain numbers, as files and compiled filters have it."""

    kind: str  # in `STEPS`
    table: tuple[int, ...]
    start: tuple[int, ...]
    fee: float = 0.0
    first: int = 0

    def is_of(self, ways: int, instants: int) -> bool:
        """Whether numbers from a file are those of sensors and instants, so that a step may run."""
        sizes = {
            "apart": (1 + instants, 1), "setup": (1 + ways * instants, 2), "together": (ways, 2),
            "most_within": (2 + instants + ways * instants, 1 + self.table[0]),
            "store": (2 + instants + ways * instants, 2),
        }  # fmt: skip
        if (len(self.table), len(self.start)) != sizes.get(self.kind) or self.first:
            return False
        if self.kind == "most_within" and self.table[0] < 1:
            return False
        return self.kind not in {"most_within", "store"} or (
            self.table[1] == instants and self.start[1] >= 0
        )

    @classmethod
    def made_from(cls, step: Step) -> "PlainStep":
        """Those of a constraint."""
        return cls(step.kind, step.table, step.start, float(step.fee), step.first)
