"""Settings of the proof of a lower bound."""

from dataclasses import dataclass
from numbers import Integral, Real

from pfdist.bounds.first_windows import WINDOW
from pfdist.errors import JobError, shown
from pfdist.filters.work import BLOCK
from pfdist.runner.block_sums import GROUPS

LEAST_DRAWS, MOST_DRAWS, DRAWS = GROUPS * BLOCK, 100_000, 1920
WITHIN_DRAWS = 30_720
"""Largest number of draws, if a gap is demanded and no number of draws."""
MOST_WINDOW, MOST_PARTICLES = 6, 32_000
MEMORY, MOST_MEMORY = 1024, 1_000_000  # MiB
MOST_WORK = 10**15  # particle-steps
_OPTIONAL = ("draws", "particles", "work")  # None stands for a default
_BYTES = 400  # of an error, with all groups of draws
_BYTES_A_WINDOW = 50_000  # of a window that grows: its moves, its programmes, and its times


@dataclass(frozen=True)
class BoundSettings:
    """How a lower bound is proved.

    Parameters
    ----------
    draws : int, optional
        Number of draws of the bound, rounded up to a multiple of 24; by default 1,920. With more
        draws the bound is higher, because the least of many noisy costs is too low. Exact engines
        ignore it.
    within : float, optional
        Take more and more draws until the limits of the gaps of all found sets are at most this
        fraction of the expected MSE, but at most `draws`, by default 30,720.
    particles : int, optional
        Number of particles of the bound's filter; by default that of the job's filter.
    window : int
        Number of measurements of the windows that the relaxation knows at first.
    work : float, optional
        Particle-steps after which no window grows; 0 if no window is to grow. By default twice
        those that the first windows take. Windows also stop growing when no set of the relaxation
        is better than the run's sets by more than 0.1 %, on the draws that choose the windows.
    memory : int
        Memory that the relaxation may take, in MiB. A window that needs more is not added.

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
        """The number of draws at which the proof ends at the latest."""
        return self.draws or (DRAWS if self.within is None else WITHIN_DRAWS)

    @property
    def most_cells(self) -> int:
        """The largest number of errors that count in the relaxation."""
        return self.memory * 2**20 // _BYTES

    @property
    def most_windows(self) -> int:
        """The largest number of windows that grow."""
        return self.memory * 2**20 // _BYTES_A_WINDOW
