"""The work of a plan before it is made: the dry run of `pfdist plan`."""

import contextlib
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from pfdist.common.formatted_sizes import formatted_size
from pfdist.common.measurement_times import Times
from pfdist.common.parts import Cell, Page, Section, Table, Text
from pfdist.common.shown import Shown
from pfdist.errors import JobError, ModelError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import BLOCK, Estimation
from pfdist.problem.problem import JobSource, as_job
from pfdist.questions.plan import draws_of_bound, of_as_many
from pfdist.questions.run import PATIENCE, minutes_of_bound
from pfdist.questions.run_of_job import folder_of, searched_by
from pfdist.results.columns import records_of
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import Built, build
from pfdist.runner.comparison_phase import TRAJECTORIES
from pfdist.runner.driver import foreseen_by_part, prover_of
from pfdist.runner.parts import PARTS

_DRAWS, _MOST_STEPS = 1000, 1_000_000  # behind a speed; a tenth for particles of a draw
_BYTES, _A_NUMBER = 1.5e6, 8  # of report, figures and other tables; of a number in a table


@dataclass(frozen=True, repr=False)
class Foreseen(Shown):
    """The particle-steps of a plan by what they are for, with minutes of a core of this machine.

    Parameters
    ----------
    work : DataFrame
        A row for each part, with `steps` and `minutes`.
    bytes : int
        About how much the run takes on disk.
    """

    work: pd.DataFrame
    bytes: int

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values."""
        return {"bytes": self.bytes, "rows": records_of(self.work)}

    def _page(self) -> Page:
        all_parts = {"part": "all", **self.work.sum(numeric_only=True)}
        rows = [
            [Cell(PARTS.get(row["part"], row["part"])), Cell(f"{row['steps']:.3g}", row["steps"]),
             Cell(f"{row['minutes']:.2g}", row["minutes"])]
            for row in [*self.work.to_dict("records"), all_parts]
        ]  # fmt: skip
        table = Table("", ("work for", "particle-steps", "minutes of a core"), rows)
        size = f"The run takes about {formatted_size(self.bytes)} on disk, with its report."
        usual = (
            "The search usually takes between half and twice as much: exchanges go on while they "
            "improve the plan. Where many sets are almost as good, it was six times as much."
        )
        return Page("", "", [Section("", [table, Text(usual), Text(size)])])


def foreseen_work(
    job: JobSource,
    search: str,
    changes: Iterable[str],
    bound_draws: int | None,
    against: Any = None,
) -> Foreseen:
    """The work of a plan; the arguments are those of `pfdist.plan`, and the errors, too."""
    wanted = as_job(job, changes, sections=searched_by(search))
    wanted = wanted if against is None else of_as_many(wanted, against)
    built, prover = build(wanted, folder_of(wanted, None)), None
    with contextlib.suppress(JobError, ModelError):  # no bound is known
        if draws := draws_of_bound(wanted, bound_draws):
            prover = prover_of(built, BoundSettings(draws=draws))
            prover = prover if minutes_of_bound(built, prover) <= PATIENCE else None
    minutes = seconds_of_step(built) / 60
    work = foreseen_by_part(built, prover).items()
    rows = [{"part": part, "steps": steps, "minutes": steps * minutes} for part, steps in work]
    frame = pd.DataFrame(rows)
    return Foreseen(frame, _bytes(built, frame.set_index("part")["steps"]))


def _bytes(built: Built, steps: "pd.Series[float]") -> int:
    """About how many bytes a run has; seven plans had 0.6 to 1.2 times as many."""
    each = built.comparing  # a sum of errors at an instant is stored for each block of draws
    sums = (
        steps.get("search", 0.0) / each.steps_an_instant + steps.get("proof", 0.0) / each.particles
    )
    draws, instants = built.job.comparison.draws, built.evaluator.horizon + 1
    return int(_BYTES + _A_NUMBER * (sums / BLOCK + 2 * draws + 5 * TRAJECTORIES * instants))


@np.errstate(over="ignore", invalid="ignore")  # only the time counts
def seconds_a_step(evaluator: Evaluator, times: Times, estimation: Estimation) -> float:
    """The seconds of a particle-step, from as many draws as take long enough.

    First draws, whose code may still be loaded, do not count.
    """
    particles = max(50, min(500, _MOST_STEPS // 10 // (evaluator.horizon + 1)))
    # Processor time, which other processes do not lengthen; a black box may compute elsewhere.
    clock = time.process_time if evaluator.computed_by.compiled else time.perf_counter
    least = max(1, len(evaluator.scenarios))  # each has an evaluator of its own
    work = evaluator.work((times,), 3, 3, (0, least), replace(estimation, particles=particles))
    evaluator(work)
    for draws in (least, 10 * least, 100 * least, _DRAWS * least):
        start = clock()
        evaluator(replace(work, draws=(0, draws)))
        seconds = clock() - start
        if seconds > 0.1:  # is long enough
            break
    return seconds / draws / work.steps_a_draw


def seconds_of_step(built: Built) -> float:
    """Seconds of a particle-step, measured on a few draws; a guess if there are no particles."""
    if not built.evaluator.has_particles:
        return built.evaluator.seconds_a_step
    return seconds_a_step(built.evaluator, built.feasible.regular(), built.comparing)
