"""Timing of several functions in turns, on one core."""

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
    """The times of a function, a number for each repeat.

    Wall time is the processor time and the time in which other programs had the core. The two are
    equal for a program that has a core of its own.

    Parameters
    ----------
    first : float
        Wall seconds of the call before the rounds, which compiles.
    processor, wall : tuple of float
        Seconds.
    """

    first: float
    processor: tuple[float, ...]
    wall: tuple[float, ...]

    def nanoseconds(self, steps: int) -> dict[str, float]:
        """Give the nanoseconds of a step: least, median and largest, and least wall time."""
        times = np.array(self.processor) / steps * 1e9
        return {
            "ns": float(times.min()),
            "ns_median": float(np.median(times)),
            "ns_max": float(times.max()),
            "ns_wall": min(self.wall) / steps * 1e9,
        }


def take_turns(
    functions: Mapping[Any, Callable[[], object]], repeats: int, say: Say
) -> dict[Any, Timing]:
    """Give the times of functions that are called in rounds.

    Each round calls every function once, so a disturbance affects all functions alike. Each
    function is called once before, so nothing is compiled while the clock runs.

    Parameters
    ----------
    functions : mapping to callables without arguments
    repeats : int
        Number of rounds.
    say : callable
        Receives a line about each round.

    Returns
    -------
    dict
        A `Timing` for each key.
    """
    first = {}
    for key, function in functions.items():
        start = perf_counter()
        function()
        first[key] = perf_counter() - start
    taken: dict[Any, list[tuple[float, float]]] = {key: [] for key in functions}
    for turn in range(repeats):
        for key, function in functions.items():
            wall, processor = perf_counter(), process_time()
            function()
            taken[key].append((process_time() - processor, perf_counter() - wall))
        say(f"round {turn + 1} of {repeats}")
    return {key: Timing(first[key], *zip(*pairs, strict=True)) for key, pairs in taken.items()}


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process, and threads that it starts, on one core."""
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)
