"""Time functions that take turns, on one core."""

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Any

import numpy as np

Say = Callable[[str], None]


@dataclass(frozen=True)
class Timing:
    """What one function took, a number a repeat.

    Processor time is what a program pays; wall time is that and what others had of the core
    meanwhile. Of a program that computes on a core of its own the two are equal.

    Parameters
    ----------
    processor, wall : tuple of float
        Seconds.
    """

    processor: tuple[float, ...]
    wall: tuple[float, ...]

    def nanoseconds(self, steps: int) -> dict[str, float]:
        """Nanoseconds a step: least, median and largest of the repeats, and least wall time."""
        each = np.array(self.processor) / steps * 1e9
        return {
            "ns": float(each.min()),
            "ns_median": float(np.median(each)),
            "ns_max": float(each.max()),
            "ns_wall": min(self.wall) / steps * 1e9,
        }


def take_turns(
    functions: Mapping[Any, Callable[[], object]], repeats: int, say: Say
) -> dict[Any, Timing]:
    """Time functions in rounds, each once a round, so that a disturbance strikes all alike.

    Parameters
    ----------
    functions : mapping to callables without arguments
        Called once before, so that nothing is compiled while the clock runs.
    repeats : int
        Rounds.
    say : callable
        Is told of every round.

    Returns
    -------
    dict
        A `Timing` for each key.
    """
    for function in functions.values():
        function()
    taken: dict[Any, list[tuple[float, float]]] = {key: [] for key in functions}
    for turn in range(repeats):
        for key, function in functions.items():
            wall, processor = perf_counter(), process_time()
            function()
            taken[key].append((process_time() - processor, perf_counter() - wall))
        say(f"round {turn + 1} of {repeats}")
    return {key: Timing(*zip(*pairs, strict=True)) for key, pairs in taken.items()}


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process, and the threads it starts, on one core."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)
