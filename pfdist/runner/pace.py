"""The sizes of tasks: long while much work remains, short at the end.

Each task gets a share of the remaining work, so that all workers end together, whatever their
number and speed (Polychronopoulos, Kuck, "Guided self-scheduling: a practical scheduling scheme for
parallel supercomputers", IEEE Transactions on Computers 36, 1987). A task takes at most a fraction
of a second, because a kill loses unfinished tasks. It takes at least ten times what its transport
costs. With hundreds of workers, tasks are longer, so that the driver can serve all workers
meanwhile. The speed is estimated from finished tasks.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

from pfdist.filters.work import BLOCK, FilterWork

MOST_SECONDS = 0.3
LEAST_SECONDS = 0.015  # ten times what the transport of a task costs
SERVING_SECONDS = 0.001  # the share of the driver and of Ray in its process, for each task
LONGEST_SECONDS = 2.0  # however many workers there are
FIRST_SECONDS = 180.0  # that a draw may take while nothing is known of a model's speed
MOST_ROWS = 50_000  # per-draw errors of a task, which lie in memory however fast a model is
_SLOWER = 4  # times the guess takes a usual model
_SHARE = 2  # so many tasks for each worker: two are queued at each worker at any time


class Pace:
    """The seconds of a particle-step, estimated from finished tasks.

    The initial seconds are a guess, unless `learnt` is true: then they were measured. `least_draws`
    are those of a task.
    """

    def __init__(
        self,
        seconds: float,
        workers: int,
        *,
        learnt: bool = False,
        least_draws: int = 1,
    ) -> None:
        self.seconds, self._usual = seconds, _SLOWER * seconds
        self._workers, self._learnt, self.least_draws = workers, learnt, least_draws

    def update(self, steps: int, seconds: float) -> None:
        """Update the speed with a task of so many particle-steps that took so many seconds."""
        before = self.seconds if self._learnt else seconds / steps
        self.seconds, self._learnt = (before + seconds / steps) / 2, True

    def expected(self, steps: int) -> float:
        """Seconds that a task of so many particle-steps takes; many before the first has ended."""
        return steps * self.seconds if self._learnt else FIRST_SECONDS

    def in_seconds(self, seconds: float) -> float:
        """Particle-steps of all workers in about so many seconds, at a usual speed.

        Speeds differ too little to change it, unless the model is many times as slow.
        """
        slower = max(0, math.floor(math.log10(self.seconds / self._usual)) - 1)
        return self._workers * seconds / self._usual / 10.0**slower

    def size(self, remaining: int) -> int:
        """Particle-steps of the next task, given the particle-steps that remain.

        The first tasks have one draw: a model may be a thousand times slower than the guess.
        """
        if not self._learnt:
            return 1
        seconds = remaining * self.seconds
        # n tasks keep the driver busy for n * SERVING_SECONDS, and each takes seconds / n of its
        # worker: more workers than make both equal would wait for the driver.
        workers = min(self._workers, math.sqrt(seconds / SERVING_SECONDS))
        least = max(LEAST_SECONDS, SERVING_SECONDS * workers)
        most = min(LONGEST_SECONDS, max(MOST_SECONDS, 3 * SERVING_SECONDS * workers))
        share = seconds / (_SHARE * max(1, workers))
        return max(1, round(min(most, max(least, share)) / self.seconds))


class Bundle(NamedTuple):
    """The works of a task, and the particle-steps of all of them."""

    works: tuple[FilterWork, ...]
    steps: int


def bundles(
    works: Iterable[FilterWork],
    size: Callable[[int], int],
    expected: Callable[[int], float] = lambda steps: 0.0,
    least_draws: int = 1,
) -> Iterator[Bundle]:
    """Bundles of works, which are cut between their draws.

    `size` gives the particle-steps of the next bundle from those that remain. A bundle has about
    this size, but at least `least_draws`. `expected` gives the seconds of particle-steps: sums over
    a block are cut into single draws if the whole block would take long.

    >>> from pfdist.filters.work import Estimation
    >>> ten = Estimation(particles=10)  # and 10 instants: 100 particle-steps a draw
    >>> works = [FilterWork(((0, 3),), (9,), (1,), 1, (0, draws), ten) for draws in (5, 2)]
    >>> for bundle in bundles(works, lambda remaining: 400):
    ...     print([work.draws for work in bundle.works], bundle.steps)
    [(0, 4)] 400
    [(4, 5), (0, 2)] 300
    """
    waiting = [(work, work.steps_a_draw) for work in works]
    remaining = sum((work.draws[1] - work.draws[0]) * a_draw for work, a_draw in waiting)
    bundle: list[FilterWork] = []
    room = total = 0
    for work, a_draw in waiting:
        first, last = work.draws
        most = MOST_ROWS // len(work.measurement_times) * a_draw
        while first < last:
            room = room if bundle else min(size(remaining), most)
            end = min(last, first + max(1, min(least_draws, most // a_draw), room // a_draw))
            if work.summed:
                is_long = expected((last - first) * a_draw) > LONGEST_SECONDS
                is_cut = last - first < BLOCK or (is_long and work.together == 1)
                end = first + 1 if is_cut else last
            bundle.append(replace(work, draws=(first, end)))
            steps, first = (end - first) * a_draw, end
            room, remaining, total = room - steps, remaining - steps, total + steps
            if room < a_draw:
                yield Bundle(tuple(bundle), total)
                bundle, total = [], 0
    if bundle:
        yield Bundle(tuple(bundle), total)
