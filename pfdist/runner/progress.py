"""The progress of a run, and the reporter that adds it up and shows it to the user."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pfdist.common.estimate import Estimate
from pfdist.errors import PfdistWarning

Say = Callable[[str], Any]


def silent(line: str) -> None:
    """Print nothing."""


def heard(say: Say, line: str) -> None:
    """Say a line about the results; it becomes a warning if nobody receives lines."""
    if say is silent:
        warnings.warn(line, PfdistWarning, stacklevel=3)
    else:
        say(line)


@dataclass(frozen=True)
class SetGain:
    """The gain of a set of times over the reference, from the draws compared so far.

    Parameters
    ----------
    name : str
    gain_of_means : Estimate
        1 - E[mse] / E[mse of the reference].
    """

    name: str
    gain_of_means: Estimate


@dataclass(frozen=True)
class Progress:
    """How far a run is.

    Parameters
    ----------
    phase : str
        Name of a search, ``comparison``, ``online``, or a part of the proof of a lower bound.
    done, total : float
        Particle-steps over all phases and sets of times; the total is a forecast.
    optional : float
        Particle-steps of the total that may be left out.
    evaluations : int
        Evaluations finished in this phase, copies counted; in ``comparison`` and ``online``, draws.
        The count starts again where a phase goes through its draws again, as those of `why` do.
    generation, generations : int
        Current and expected last generation of the search; 0 in other phases.
    best : float or None
        Expected MSE of the set that the search would return now.
    mean : float or None
        Mean expected MSE of the last finished generation.
    found : tuple of SetGain
        The comparison's gains: for each set but the reference. Empty where the answer gives others.
    doing : str
        In a sweep: how many points are finished, and what the others do.
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
"""Receives the progress of a computation each time."""


class Reporter:
    """Adds up the progress of a run and reports it; nothing else changes the sums.

    `show` receives a `Progress` each time. `total` is the forecast of the run's particle-steps, to
    which `foresee` adds.
    """

    def __init__(self, show: Show, total: float = 0.0) -> None:
        self._show = show
        self._progress = Progress(phase="", done=0.0, total=total)

    @property
    def progress(self) -> Progress:
        """The progress now."""
        return self._progress

    def begin(self, phase: str, **shown: Any) -> None:
        """Report that a phase begins, with the fields that it shows; all others are reset."""
        done, total, optional = self._progress.done, self._progress.total, self._progress.optional
        self._progress = Progress(phase, done, total, optional=optional)
        self.reach(done, **shown)

    def reach(self, done: float, **shown: Any) -> None:
        """Report that so many particle-steps of the run are done, and change other fields."""
        self.note(done=done, **shown)
        self._show(self._progress)

    def note(self, **shown: Any) -> None:
        """Change fields of the progress, to be shown with the next report."""
        self._progress = replace(self._progress, **shown)

    def foresee(self, steps: float, optional: float = 0.0) -> None:
        """Expect more particle-steps in total, of which so many may be left out."""
        before = self._progress
        self.note(total=before.total + steps, optional=before.optional + optional)

    def finish(self) -> None:
        """Report that nothing remains, also where fewer particle-steps were enough."""
        if self._progress.phase:  # else nothing was begun
            self.reach(self._progress.done, total=self._progress.done)
