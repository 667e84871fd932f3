"""A lower bound of the expected MSE of every feasible set, and the gap of a run's sets."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pfdist.analysis import finite
from pfdist.api.finished_run import built_again, finished_run
from pfdist.bounds.gap import Gap
from pfdist.bounds.proof import Estimate
from pfdist.errors import JobError, shown
from pfdist.runner.progress import Report, Reporter
from pfdist.runner.prover import BLOCK, GROUPS, Prover

DRAWS, WINDOW = 1920, 2
LEAST_DRAWS = GROUPS * BLOCK
MOST_DRAWS, MOST_PARTICLES, MOST_WINDOW = 10_000_000, 32_000, 6


@dataclass(frozen=True)
class Bound:
    """Result of `bound`.

    Parameters
    ----------
    run : Path
    window, longest_gap : int
        Settings of the relaxation.
    particles, draws : int
        Settings of the bound's filter; 0 where the engine is exact.
    gaps : list of Gap
        One for each compared set of the run.
    """

    run: Path
    window: int
    longest_gap: int
    particles: int
    draws: int
    gaps: list[Gap]

    def as_json(self) -> dict[str, Any]:
        """The whole result as JSON values; an unknown value is None."""
        sets = {}
        for gap in self.gaps:
            row: dict[str, Any] = {}
            for key, value in vars(gap).items():
                if isinstance(value, Estimate):
                    row |= {key: value.value, f"{key}_error": value.standard_error}
                elif key != "name":
                    row[key] = list(value) if isinstance(value, tuple) else value
            sets[gap.name] = row
        own = {key: value for key, value in vars(self).items() if key not in ("run", "gaps")}
        answer: dict[str, Any] = finite({"run": str(self.run), **own, "sets": sets})
        return answer


def bound(
    run: str | Path,
    draws: int = DRAWS,
    *,
    particles: int | None = None,
    window: int = WINDOW,
    model: str = "",
    filter_model: str = "",
    report: Report = lambda progress: None,
    say: Callable[[str], Any] = lambda line: None,
) -> Bound:
    """Prove how much lower the expected MSE of any other feasible times can be.

    The function runs the model, on draws that neither chose the times nor compared them. It runs a
    model file that the run's folder names only if the file is unchanged since the run, and if the
    user has run the file on this machine before.

    Parameters
    ----------
    run : str or Path
        Folder of a finished run.
    draws : int
        Number of draws of the bound, rounded up to a multiple of 24, computed in this process. With
        more draws the bound is higher, because the least of many noisy costs is too low. Exact
        engines ignore it.
    particles : int, optional
        Number of particles of the bound's filter; by default that of the job's filter.
    window : int
        Number of last measurements that the relaxation keeps. A larger window gives a higher
        bound, and takes several times as long.
    model, filter_model : str, optional
        ``path/file.py:object``: replaces the file that the run names for the model or for the
        filter's model. It is run without question, and must mean the same as the run's model.
    report : callable, optional
        Receives the progress.
    say : callable, optional
        Receives a line for each model file before the file is run.

    Returns
    -------
    Bound

    Raises
    ------
    StoreError
        The folder holds no finished run, or the model has changed since, or the run names a model
        file that is not run without the user's word.
    JobError, ModelError
        An argument is out of its range; the measurements of the job have costs; no compared set is
        feasible; the model defines an error of its own; or the model cannot be loaded.
    """
    for name, value, least, most in (
        ("draws", draws, LEAST_DRAWS, MOST_DRAWS),
        ("particles", 1 if particles is None else particles, 1, MOST_PARTICLES),
        ("window", window, 1, MOST_WINDOW),
    ):
        if not least <= value <= most:
            raise JobError(
                f"{name} must be {least:,} to {most:,}, got {shown(value)}", argument=name
            )
    opened = finished_run(run)
    built = built_again(opened, {"model": model, "filter_model": filter_model}, say)
    prover = Prover(opened, built, draws, particles, window, Reporter(report, 1.0))
    gaps, relaxation = prover.gaps(), prover.relaxation
    return Bound(opened.path, window, relaxation.longest_gap, prover.particles, prover.draws, gaps)
