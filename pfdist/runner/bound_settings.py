"""Settings of the proof of a lower bound."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pfdist.common.section import Arguments, Number, Whole
from pfdist.errors import JobError
from pfdist.filters.work import BLOCK
from pfdist.runner.block_sums import GROUPS
from pfdist.search.first_windows import WINDOW

LEAST_DRAWS, DRAWS = GROUPS * BLOCK, 1920
WITHIN_DRAWS = 30_720
"""Default of `BoundSettings.draws` if `within` is given."""
MEMORY = 1024  # MiB
_BYTES = 400  # memory of one error of a window at an instant, with all groups of draws
_BYTES_A_WINDOW = 50_000  # memory of an added window: its moves, its programmes, and its times

_Draws = Annotated[Whole, Field(ge=LEAST_DRAWS, le=100_000)]
DrawsOrNone = Literal[0] | _Draws
"""Number of draws of the bound of a run; 0 for no bound."""


class BoundSettings(Arguments):
    """Settings of a lower bound.

    Parameters
    ----------
    draws, within, particles, window, work, memory
        As for `pfdist.bound`.

    Raises
    ------
    JobError
        A value is out of its range.
    """

    error: ClassVar = JobError

    draws: _Draws | None = None
    within: Annotated[Number, Field(gt=0, lt=1)] | None = None
    particles: Annotated[Whole, Field(ge=1, le=32_000)] | None = None
    window: Annotated[Whole, Field(ge=1, le=6)] = WINDOW
    work: Annotated[Number, Field(ge=0, le=10**15)] | None = None  # particle-steps
    memory: Annotated[Whole, Field(ge=1, le=1_000_000)] = MEMORY

    @property
    def most_draws(self) -> int:
        """Largest number of draws of the proof, before it is rounded up to whole blocks."""
        return self.draws or (DRAWS if self.within is None else WITHIN_DRAWS)

    @property
    def most_cells(self) -> int:
        """Largest number of errors in the relaxation: one for each instant of each window."""
        return self.memory * 2**20 // _BYTES

    @property
    def most_windows(self) -> int:
        """Largest number of windows that may be added to the first windows."""
        return self.memory * 2**20 // _BYTES_A_WINDOW
