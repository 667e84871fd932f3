"""The speed of plain processes that filter side by side: an upper limit for any driver.

Two busy cores may each be slower than a single busy core, because they share power and caches.
"""

import multiprocessing
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Barrier
from time import perf_counter

from pfdist import load_model
from pfdist.common.measurement_times import regular
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, FilterWork


def measure_rate(processes: int, draws: int, seconds: float) -> float:
    """Give the particle-steps in a second of several processes together.

    Parameters
    ----------
    processes : int
    draws : int
        Number of draws of the paper's problem in a task.
    seconds : float
        Duration of the measurement.

    Returns
    -------
    float
    """
    context = multiprocessing.get_context("spawn")
    barrier, rates = context.Barrier(processes), context.Queue()
    started = [
        context.Process(target=_work, args=(barrier, rates, draws, seconds))
        for _ in range(processes)
    ]
    for process in started:
        process.start()
    total = sum(rates.get(timeout=120 + seconds) for _ in started)
    for process in started:
        process.join()
    return float(total)


def _work(barrier: Barrier, rates: "Queue[float]", draws: int, seconds: float) -> None:
    evaluator = Evaluator(load_model("ungm"), horizon=60)
    task = FilterWork((regular(60, 21),), (60,), (1,), 2, (0, draws), Estimation(500))
    evaluator(task)  # compiles
    barrier.wait()
    start, done = perf_counter(), 0
    while perf_counter() - start < seconds:
        evaluator(task)
        done += draws * 61 * 500
    rates.put(done / (perf_counter() - start))
