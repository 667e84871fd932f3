"""Print how long `pfdist explore` takes to answer, for each job: ``python docs/explore_times.py``.

The time is that from a message about moved times to the answer as text, with the reference known.
"""

import json
import time
from pathlib import Path

import numpy as np

from pfdist import load_job
from pfdist.errors import JobError
from pfdist.plugins.explorer.session import FIRST_DRAWS, ExplorerSession, reply

JOBS = Path(__file__).parent.parent / "jobs"
MOVES = 9


def main() -> None:
    """Print a row of the table of docs/benchmarks.md for each job."""
    ask("plan.toml", "filter.particles=100")
    for path in sorted(JOBS.glob("*.toml")):
        try:
            load_job(path)
        except JobError:  # a sweep
            continue
        ask(path.name)


def ask(name: str, *changes: str) -> None:
    """Print the times of the answers to moves."""
    session = ExplorerSession(load_job(JOBS / name, changes))
    first = seconds(session, session.first_draws, 0)
    whole = seconds(session, FIRST_DRAWS, 1)
    label = ", ".join([f"`{name}`", *(change.replace("filter.", "") for change in changes)])
    draws = "exact" if session.played.exact else f"{session.first_draws}"
    print(f"| {label} | {draws} | {1000 * first:.0f} | {1000 * whole:.0f} |", flush=True)  # noqa: T201


def seconds(session: ExplorerSession, draws: int, number: int) -> float:
    """Median time of an answer on so many draws, in seconds."""
    taken = []
    for move in range(MOVES + 1):
        rng = np.random.default_rng((number, move))
        times = {*session.even} - {int(rng.choice(session.even))}
        others = [m for m in range(session.job.problem.points.number) if m not in times]
        message = {"ask": "answer", "times": [*times, int(rng.choice(others))], "draws": draws}
        start = time.perf_counter()
        json.dumps(reply(session, message))
        taken.append(time.perf_counter() - start)
    return float(np.median(taken[1:]))


if __name__ == "__main__":
    main()
