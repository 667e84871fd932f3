"""Cut work into tasks: long ones while there is much to do, short ones at the end.

What is handed out is a share of what remains, so that all workers end together, whatever their
number and speed; but never more than a fraction of a second, which is what a kill loses, and
never so little that handing it over costs more than doing it. The speed is learnt as tasks end.

References
----------
Polychronopoulos, Kuck, "Guided self-scheduling: a practical scheduling scheme for parallel
supercomputers", IEEE Transactions on Computers 36, 1987.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from pfdist.evaluation.work import Work

MOST_SECONDS = 0.3
LEAST_SECONDS = 0.015  # ten times what handing a task over costs
MOST_ROWS = 50_000  # of per-draw errors: however fast a model is, a task's lie in memory
_SHARE = 2  # of what remains, so many tasks for each worker: two are in its hands at any time


@dataclass
class Pace:
    """How long a particle-step takes, as far as is known.

    Parameters
    ----------
    seconds : float
        The first guess.
    workers : int
    """

    seconds: float
    workers: int
    learnt: bool = False

    def learn(self, works: Iterable[Work], seconds: float) -> None:
        """Learn from a task that took so long."""
        self.seconds = (self.seconds + seconds / sum(work.steps for work in works)) / 2
        self.learnt = True

    def expected(self, works: Iterable[Work]) -> float:
        """Seconds that a task should take."""
        return self.seconds * sum(work.steps for work in works)

    def size(self, remaining: int) -> int:
        """How many particle-steps to do in the next task, of so many that remain.

        The first tasks are short: a model may be a hundred times slower than is thought.
        """
        share = remaining * self.seconds / (_SHARE * self.workers) if self.learnt else 0.0
        return max(1, round(min(MOST_SECONDS, max(LEAST_SECONDS, share)) / self.seconds))


def bundles(works: Iterable[Work], size: Callable[[int], int]) -> Iterator[tuple[Work, ...]]:
    """Cut works between their draws, and bundle them, as they are asked for.

    Parameters
    ----------
    works : iterable of Work
    size : callable
        How many particle-steps to do in the next bundle, of so many that remain.

    Yields
    ------
    tuple of Work
        About so much, but one draw at least.

    Examples
    --------
    >>> from pfdist.evaluation.work import Estimation
    >>> of = Estimation(particles=10)  # of 10 instants: 100 particle-steps a draw
    >>> works = [Work(((0, 3),), (9,), (1,), 1, (0, draws), of) for draws in (5, 2)]
    >>> [[work.draws for work in bundle] for bundle in bundles(works, lambda remaining: 400)]
    [[(0, 4)], [(4, 5), (0, 2)]]
    """
    waiting = list(works)
    remaining = sum(work.steps for work in waiting)
    bundle: list[Work] = []
    room = 0
    for work in waiting:
        (first, last), a_draw = work.draws, work.steps_a_draw
        most = MOST_ROWS // len(work.measurement_times) * a_draw
        while first < last:
            room = room if bundle else min(size(remaining), most)
            end = min(last, first + max(1, room // a_draw))
            bundle.append(replace(work, draws=(first, end)))
            steps, first = (end - first) * a_draw, end
            room, remaining = room - steps, remaining - steps
            if room < a_draw:
                yield tuple(bundle)
                bundle = []
    if bundle:
        yield tuple(bundle)
