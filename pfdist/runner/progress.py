"""The progress of a run, and the reporter that shows it to the user."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pfdist.common.estimate import Estimate
from pfdist.errors import PfdistWarning

Say = Callable[[str], Any]


class Detail(str):
    """A line that a terminal shows only with ``--verbose``."""

    __slots__ = ()


def silent(line: str) -> None:
    """A `say` that prints nothing."""


def heard(say: Say, line: str) -> None:
    """Give the user a line about the results; without a receiver of lines, it becomes a warning."""
    if say is silent:
        warnings.warn(line, PfdistWarning, stacklevel=3)
    else:
        say(line)


@dataclass(frozen=True)
class SetGain:
    """The gain of a set of times over the reference, from the draws compared so far.

    Parameters
    ----------
    label : str
    gain_of_means : Estimate
        1 - E[mse] / E[mse of the reference].
    """

    label: str
    gain_of_means: Estimate


@dataclass(frozen=True)
class Progress:
    """The progress of a run.

    Parameters
    ----------
    phase : str
        Name of a search, ``comparison``, a step of the proof of a lower bound, or the name that a
        plugin gives its work, as ``rule``.
    done, total : float
        Particle-steps over all phases and sets of times; the total is a forecast.
    optional : float
        Particle-steps of the total that may be left out.
    evaluations : int
        Evaluations finished in this phase, including copies; where a phase evaluates no sets,
        draws. The count restarts when a phase repeats its draws.
    generation, generations : int
        Current generation and expected number of generations, which there may be more of; 0 in
        phases other than searches.
    best : float or None
        Expected MSE of the set that the search would return now.
    mean : float or None
        Mean expected MSE of the last finished generation.
    found : tuple of SetGain
        The comparison's gains of each set but the reference; empty if the answer shows other gains.
    doing : str
        In a sweep: the number of finished points, and the state of the others.
    """

    phase: str
    done: float
    total: float
    evaluations: int = 0
    generation: int = 0
    generations: int = 0
    best: float | None = None
    mean: float | None = None
    found: tuple[SetGain, ...] = ()
    doing: str = ""
    optional: float = 0.0


Show = Callable[[Progress], Any]
"""A function that receives each progress of a computation."""


class Reporter:
    """A reporter that adds up the progress of a run and reports it.

    `show` receives each `Progress`. `total` is the forecast of the run's particle-steps; `foresee`
    adds to it.
    """

    def __init__(self, show: Show, total: float = 0.0) -> None:
        self._show = show
        self._progress = Progress(phase="", done=0.0, total=total)

    @property
    def progress(self) -> Progress:
        """The current progress."""
        return self._progress

    def begin(self, phase: str, **shown: Any) -> None:
        """Report the start of a phase, with the fields that it shows; all others are reset."""
        done, total, optional = self._progress.done, self._progress.total, self._progress.optional
        self._progress = Progress(phase, done, total, optional=optional)
        self.reach(done, **shown)

    def reach(self, done: float, **shown: Any) -> None:
        """Report a number of finished particle-steps of the run, and change other fields."""
        self.note(done=done, **shown)
        self._show(self._progress)

    def advance(self, steps: float, evaluations: int = 0, **shown: Any) -> None:
        """Report more particle-steps and evaluations, as `reach`."""
        now = self._progress
        self.reach(now.done + steps, evaluations=now.evaluations + evaluations, **shown)

    def note(self, **shown: Any) -> None:
        """Change fields of the progress, which the next report shows."""
        self._progress = replace(self._progress, **shown)

    def foresee(self, steps: float, optional: float = 0.0) -> None:
        """Add particle-steps to the forecast, of which so many may be left out."""
        before = self._progress
        self.note(total=before.total + steps, optional=before.optional + optional)

    def finish(self) -> None:
        """Report the end, even if fewer particle-steps were needed."""
        if self._progress.phase:  # else nothing was begun
            self.reach(self._progress.done, total=self._progress.done)
