"""The budget curve: the expected MSE against N or a total price, and which one is enough."""

from collections.abc import Iterable, Sequence, Set
from pathlib import Path
from typing import Annotated, Any, Unpack

from pydantic import Field

from pfdist.common.measurement_times import REGULAR
from pfdist.common.parsing import MOST_NUMBERS
from pfdist.common.section import Arguments, Number, Whole, checked
from pfdist.errors import ArgumentError, JobError, shown
from pfdist.problem.added_sections import added_sections
from pfdist.problem.problem import JobSource, as_job
from pfdist.problem.sections import DEFAULT_METHOD, EVENLY_SPACED
from pfdist.questions.options import Chosen, ComparedDraws, Options, with_options
from pfdist.questions.report import try_report
from pfdist.questions.run import run
from pfdist.questions.run_of_job import folder_of
from pfdist.results import Run
from pfdist.runner.bound_settings import LEAST_DRAWS, DrawsOrNone

DRAWS = 4000


class _Numbers(Arguments):
    measurements: Annotated[
        tuple[Annotated[Whole, Field(ge=1)], ...],
        Field(strict=False, min_length=1, max_length=MOST_NUMBERS),
    ]


@with_options
@checked
def budget(
    job: JobSource,
    measurements: tuple[int, int] | range | Set[int] | list[int],
    results: str | Path | None = None,
    draws: ComparedDraws = DRAWS,
    target: Number | None = None,
    bound_draws: DrawsOrNone = LEAST_DRAWS,
    changes: Sequence[str] = (),
    reuse: str | Path | Iterable[str | Path] = (),
    **options: Unpack[Options],
) -> Run:
    """Find times for each number or price, and compare them with evenly spaced ones.

    One dynamic programme finds the times for all numbers. The found times and the evenly spaced
    times of each number then filter the same fresh draws. Another programme proves for each number
    how much lower the error of any other times can be.

    Parameters
    ----------
    job : Problem, Job, str or Path
        A job file, as ``jobs/plan.toml``, or the folder of a run. The job's searches, its
        measurement budget, its number of compared draws and its section [online] are ignored.
    measurements : (int, int), range, set or list of int
        Numbers of measurements, as ``5:41``, ``5:41:4`` or ``10,20,30``; a pair in Python is the
        least and the largest. For a job with prices these are total prices, whole numbers.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME-budget`` of a job ``NAME.toml``.
    draws : int
        Draws of the comparison. A larger number resumes a run with more draws.
    target : float, optional
        An expected MSE. The answer, the report and a figure then have the least number that reaches
        it, and the largest that is proved not to.
    bound_draws : int
        Number of draws of the lower bound for each number of measurements; 0 for no bound.
    changes : sequence of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    reuse : str, Path or iterable of these, optional
        Folders of other runs, whose evaluations are taken, not computed again; give it once for
        each.
    options
        See `Options`.

    Returns
    -------
    Run
        Its table ``sets`` has a row for each number of measurements and each kind of times, with
        the lower bound beside the found times.

    Raises
    ------
    PfdistError
        As `pfdist.run` raises.
    """
    numbers = _section(measurements)
    search = {"method": DEFAULT_METHOD, "polish": False}
    own = dict.fromkeys(added_sections()) | {"search": [search]}
    asked = as_job(job, changes, sections=own | {"search": [{"method": DEFAULT_METHOD}]})
    is_even = asked.comparison.reference != REGULAR
    comparison = {"draws": draws, "reference": EVENLY_SPACED if is_even else REGULAR}
    fixed_sections = {"budget": numbers, "comparison": comparison}
    job = as_job(job, changes, sections=own | fixed_sections)
    if job.with_changes(sections=fixed_sections) != job:
        raise JobError(
            "changes must not set [budget] or comparison.draws, which measurements and draws give, "
            f"got {' '.join(changes)}",
            argument="set",
        )
    # The run must not depend on the measurement budget that the job file names.
    key = "measurement_budget" if job.problem.total_price is None else "total_price"
    job = job.with_changes(settings={"problem": {key: numbers["most"]}})
    job = job.with_control()
    chosen = Chosen(**options)
    if target is not None:
        options["report"] = False  # it is written below, with the target
    finished = run(
        job, folder_of(job, results, "-budget"), bound_draws=bound_draws, reuse=reuse, **options
    )
    if target is not None and chosen.has_report:
        try_report(finished, chosen.say, target)
    return finished


def _section(measurements: tuple[int, int] | range | Set[int] | list[int]) -> dict[str, Any]:
    """The section [budget] of a job.

    Numbers without a gap give the same section as a pair, a range or a set, and so the same run.
    """
    is_pair = isinstance(measurements, tuple) and len(measurements) == 2
    if not is_pair and not isinstance(measurements, range | Set | list):
        raise ArgumentError(
            "measurements must be a pair (least, most), or a range, set or list of numbers, got "
            f"{shown(measurements)}",
            argument="measurements",
        )
    numbers = _Numbers(measurements=measurements).measurements  # type: ignore[arg-type]
    if is_pair:
        return {"least": numbers[0], "most": numbers[1]}
    least, most, numbers = min(numbers), max(numbers), tuple({*numbers})
    gaps = {} if len(numbers) == most - least + 1 else {"numbers": sorted(numbers)}
    return {"least": least, "most": most, **gaps}
