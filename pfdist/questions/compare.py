"""Named sets of times, hand-made or those of runs, compared on the same draws."""

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Unpack

from pfdist.common.arguments import sets_argument
from pfdist.common.measurement_times import EVEN, REGULAR, Times
from pfdist.errors import JobError
from pfdist.problem.added_sections import added_sections
from pfdist.problem.job import Job
from pfdist.problem.points import Points
from pfdist.problem.problem import JobSource, as_job
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.sections import LONGEST_SET_NAME, REFERENCE, RESERVED
from pfdist.questions.evaluate import OneSet, instants_evaluated
from pfdist.questions.options import Chosen, Names, Options, criteria_in, following, with_options
from pfdist.questions.run import run_built
from pfdist.questions.run_of_job import finished_run, folder_of
from pfdist.results import Run
from pfdist.results.stored_run import check_one_number, measured_of, problem_of
from pfdist.runner.build import Built, build, check_pool, say_model_files, with_design
from pfdist.runner.identity import changed_models

_STRANGE = re.compile(r"[^a-z0-9]+")
_SAME = 1e-9  # times that differ by so little are the same
_LONGEST_PREFIX = 20  # characters of a run's folder in the name of a set


class SetsToCompare:
    """Collects named sets for a job that compares them; the first set is the reference.

    Parameters
    ----------
    job : Job
        The job with the problem.

    Attributes
    ----------
    differences : list of str
        Sentences about how the problems of other runs differ from that of the job.
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        self.differences: list[str] = []
        self._points = job.problem.points
        self._regular: Times = job.problem.feasible.regular()
        self._written: dict[str, Any] = {}
        self._instants: dict[str, Times] = {}

    def add_named(self) -> None:
        """Add the sets that the job gives: a list as comparison.reference, and comparison.sets."""
        named = self._job.comparison.named
        # The sets of sensors, which a job has by default, are compared with regular times.
        references = self._job.problem.feasible.references
        by_default = named and all(
            times == (name,) and name in references for name, times in named.items()
        )
        for name, instants in self._job.given_sets.items():
            if name == REFERENCE or name in named or by_default:
                self._add(
                    REGULAR if name == EVEN and instants is None else name,
                    self._regular if instants is None else instants,
                )

    def add_run(self, run: Run) -> None:
        """Add the sets of a run, but no set twice.

        A set of the same name and times is the same set. The reference is left out if any set has
        the same times.

        Parameters
        ----------
        run : Run

        Raises
        ------
        StoreError
            The run has times of several numbers of measurements.
        JobError
            The run has another clock or a longer horizon than the problem.
        """
        check_one_number(run)
        self._check_clock(run)
        self.differences += _differences(run, self._job.problem)
        for position, (name, instants) in enumerate(measured_of(run).items()):
            is_known = self._instants.get(name) == instants
            if is_known or (position == 0 and instants in self._instants.values()):
                continue
            self._add(self._free_name(name, instants, run), instants)

    def add_times(self, times: Mapping[str, OneSet] | Names) -> None:
        """Add sets that a user names.

        Raises
        ------
        MeasurementTimesError
            Times are not those of the clock.
        JobError
            A name is used twice, for other times.
        """
        for name, written in sets_argument(times).items():
            instants = instants_evaluated(self._job, name, written)
            if self._instants.get(name) == instants:  # it is compared anyway
                continue
            if name in self._written:
                raise JobError(
                    f"names of times must differ from each other and from the sets of the runs, "
                    f"{', '.join(self._written)}, got {name!r}",
                    argument="times",
                )
            reserved = (*RESERVED, EVEN)
            if name in reserved and not (name == REGULAR and instants == self._regular):
                raise JobError(
                    f"names of times must not be {', '.join(map(repr, reserved))}, got {name!r}; "
                    f"only the regular times of the problem are called {REGULAR!r}",
                    argument="times",
                )
            self._add(name, instants)

    def job(self) -> Job:
        """The job that compares the sets, without a search.

        Raises
        ------
        JobError
            There are fewer than two sets, or a name is not allowed.
        """
        if len(self._written) < 2:
            got = ", ".join(self._written) or "none"
            raise JobError(
                f"compare needs at least two sets of times, got {got}: give sets, as mine=0,6,12 "
                "and regular, or runs; `pfdist plan JOB --against TIMES` compares one set with the "
                "best of as many",
                argument="times",
            )
        named, (reference, times) = dict(self._written), next(iter(self._written.items()))
        if reference in (REGULAR, REFERENCE):
            del named[reference]
            reference = times
        comparison = self._job.comparison.model_dump(mode="json")
        return self._job.with_changes(
            sections={
                **dict.fromkeys(added_sections()),
                "search": [],
                "comparison": comparison | {"reference": reference, "sets": named},
            }
        ).with_control()

    def _add(self, name: str, instants: Times) -> None:
        is_regular = name == REGULAR and instants == self._regular
        times = self._points.written_of(instants)
        self._written[name] = REGULAR if is_regular else times
        self._instants[name] = instants

    def _free_name(self, name: str, instants: Times, run: Run) -> str:
        """A set's name, with that of the run's folder before it if the name is in use."""
        is_reserved = name == REGULAR and instants != self._regular
        is_reserved |= name == REFERENCE and bool(self._written)
        if name not in self._written and not is_reserved:
            return name
        folder = _STRANGE.sub("_", run.path.absolute().name.lower()).strip("_")
        prefix = folder if folder[:1].isalpha() else f"run_{folder}"
        longer, ending, number = f"{prefix[:_LONGEST_PREFIX]}_{name}", "", 2
        while (free_name := longer[: LONGEST_SET_NAME - len(ending)] + ending) in self._written:
            ending, number = f"_{number}", number + 1
        return free_name

    def _check_clock(self, run: Run) -> None:
        points, described = problem_of(run).points, _counted(self._points)
        must = f"sets of all runs must have times of the first problem, which {described}"
        if described != (got := _counted(points)):
            raise JobError(f"{must}, got a run that {got} ({run.path})")
        own, first = points.clock, self._points.clock
        for t, (time, time_of_run) in enumerate(zip(first.times, own.times, strict=False)):
            if not math.isclose(time, time_of_run, rel_tol=_SAME, abs_tol=_SAME):
                raise JobError(
                    f"{must} whose instant {t} is {first.formatted(t)}, got a run whose instant "
                    f"{t} is {own.formatted(t)} ({run.path})"
                )
        if own.horizon > first.horizon:
            raise JobError(
                f"{must} and ends at {first.formatted(first.horizon)}, got a run that ends at "
                f"{own.formatted(own.horizon)} ({run.path})"
            )


def _differences(run: Run, first: ProblemSection) -> list[str]:
    """Sentences about how the problem of a run differs from the first, on the same clock."""
    own, differences = problem_of(run), []
    if own.clock.horizon != first.clock.horizon:
        ends = [each.clock.formatted(each.clock.horizon) for each in (own, first)]
        differences.append(f"its horizon is {ends[0]}, not {ends[1]}")
    if _weights(own) != _weights(first):
        differences.append("its errors have other weights of instants")
    if any(getattr(own, key) != getattr(first, key) for key in ("price", "total_price")):
        differences.append("its measurements have other prices")
    return [f"{run.path} has another problem than the first: {each}" for each in differences]


def _weights(problem: ProblemSection) -> tuple[float, ...] | None:
    """The weights of instants; None if all are equal."""
    weights = problem.weights
    return None if weights is None or len({*weights}) == 1 else weights


def _counted(points: Points) -> str:
    clock, names = points.clock, points.sensors
    text = f"has a clock in {clock.time_unit}" if clock.unit else "has a clock without a unit"
    text = "counts instants" if clock.counts else text
    return text + f" and has the sensors {', '.join(names)}" * bool(names)


# --- the comparison -------------------------------------------------------------------------------


@with_options
def compare(
    job: JobSource,
    *runs: Run | str | Path,
    times: Mapping[str, OneSet] | Names | None = None,
    results: str | Path | None = None,
    draws: int | None = None,
    changes: Iterable[str] = (),
    also: Names | None = None,
    **options: Unpack[Options],
) -> Run:
    """Compare named sets of times, and the sets of runs, on the same fresh draws.

    The comparison is a separate run without a search. Its tables ``pairs`` and ``ranks`` have the
    answers, and the same call resumes where it was stopped. All sets filter the same draws of the
    job's problem. The first set is the reference of the gains. If the filter has the true model,
    means are those of mse - control, unless the job has comparison.control = false.

    Parameters
    ----------
    job : Problem, Job, str or Path
        A job file, as ``jobs/plan.toml``, or the folder of a run. Its comparison.sets, and times as
        its comparison.reference, are compared, too.
    runs : Run, str or Path
        Folders of finished runs, whose found sets, and references if they differ, are compared,
        too. A name that is in use gets the folder's name before it.
    times : mapping of str to iterable or str, or list of str, optional
        Named sets, as ``clinic=0,6,12,24``, ``paper=0:60:3``, ``old=regular``, the regular times,
        or ``design=linearized``, the set of least linearized error;
        ``last=@last.csv`` takes the column t of a table, ``last=@last.csv:date`` another. They may
        break constraints. Give the option once for each set.
    results : str or Path, optional
        Folder of the comparison; by default ``results/NAME-compare`` of a job ``NAME.toml``.
    draws : int, optional
        Replaces comparison.draws. A larger number resumes the comparison with more draws.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    also : str or list of str, optional
        Other criteria by which the sets are judged, too, as ``worst_instant,"quantile 0.9"``.
    options
        See `Options`.

    Returns
    -------
    Run

    Raises
    ------
    JobError, MeasurementTimesError
        There are fewer than two sets, a name is used twice, or times are not those of the problem.
    PfdistError
        As `pfdist.run` raises; or the folder compares other sets.
    """
    chosen = Chosen(**options)
    comparing = {"draws": draws, "also": criteria_in(also)}
    settings = {"execution": chosen.execution, "comparison": comparing}
    job = with_design(as_job(job, changes, settings=settings))
    sets, opened = SetsToCompare(job), [finished_run(run) for run in runs]
    sets.add_named()
    for run in opened:
        sets.add_run(run)
    sets.add_times(times or {})
    compared = sets.job()
    check_pool(compared.execution)
    path = folder_of(job, results, "-compare")
    with following(chosen.progress, chosen.say) as (show, tell):
        say_model_files([compared], tell)
        built = build(compared, path)
        for sentence in [*sets.differences, *_other_models(opened, built)]:
            tell(sentence)
        return run_built(built, path, chosen, show, tell)


def _other_models(runs: Iterable[Run], built: Built) -> list[str]:
    """Sentences about runs that have other models than the job."""
    changed = ((run.path, changed_models(run.path, built)) for run in runs)
    return [
        f"{path} has another problem than the first: its model differs in {', '.join(changes)}"
        for path, changes in changed
        if changes
    ]
