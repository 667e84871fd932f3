"""Settings of the proof of a lower bound."""

from dataclasses import dataclass
from numbers import Integral, Real

from pfdist.errors import JobError, shown
from pfdist.filters.work import BLOCK
from pfdist.runner.block_sums import GROUPS
from pfdist.search.relaxation import WINDOW

LEAST_DRAWS, MOST_DRAWS, DRAWS = GROUPS * BLOCK, 100_000, 1920
WITHIN_DRAWS = 30_720
"""Default of `BoundSettings.draws` if `within` is given."""
MOST_WINDOW, MOST_PARTICLES = 6, 32_000
MEMORY, MOST_MEMORY = 1024, 1_000_000  # MiB
MOST_WORK = 10**15  # particle-steps
_OPTIONAL = ("draws", "particles", "work")  # None stands for a default
_BYTES = 400  # memory of one error of a window at an instant, with all groups of draws
_BYTES_A_WINDOW = 50_000  # memory of an added window: its moves, its programmes, and its times


@dataclass(frozen=True)
class BoundSettings:
    """How a lower bound is proved.

    Parameters
    ----------
    draws, within, particles, window, work, memory
        As for `pfdist.bound`.

    Raises
    ------
    JobError
        A value is out of its range.
    """

    draws: int | None = None
    within: float | None = None
    particles: int | None = None
    window: int = WINDOW
    work: float | None = None
    memory: int = MEMORY

    def __post_init__(self) -> None:
        for name, value, least, most in (
            ("draws", self.draws, LEAST_DRAWS, MOST_DRAWS),
            ("particles", self.particles, 1, MOST_PARTICLES),
            ("window", self.window, 1, MOST_WINDOW),
            ("memory", self.memory, 1, MOST_MEMORY),
            ("work", self.work, 0, MOST_WORK),
        ):
            if value is None and name in _OPTIONAL:
                continue
            if name != "work" and (isinstance(value, bool) or not isinstance(value, Integral)):
                raise JobError(f"{name} must be an integer, got {shown(value)}", argument=name)
            if not isinstance(value, Real) or not least <= value <= most:
                raise JobError(
                    f"{name} must be {least:,} to {most:,}, got {shown(value)}", argument=name
                )
        within = self.within
        if within is not None and not (isinstance(within, Real) and 0 < within < 1):
            raise JobError(
                f"within must be a fraction above 0 and below 1, got {shown(self.within)}",
                argument="within",
            )

    @property
    def most_draws(self) -> int:
        """Largest number of draws of the proof, before it is rounded up to whole blocks."""
        return self.draws or (DRAWS if self.within is None else WITHIN_DRAWS)

    @property
    def most_cells(self) -> int:
        """Largest number of errors in the relaxation: one for each window and instant it covers."""
        return self.memory * 2**20 // _BYTES

    @property
    def most_windows(self) -> int:
        """Largest number of windows that are added to the first windows."""
        return self.memory * 2**20 // _BYTES_A_WINDOW
