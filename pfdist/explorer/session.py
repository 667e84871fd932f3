"""One exploration: a problem whose measurement times a user changes by hand, and the answers.

A user who moves times looks at many sets on the same draws, and keeps the best of them. So these
draws flatter the set, and no error on them is a proof. `Session.judge` compares a set with the
reference on draws that are new at each judgement, and all intervals hold together.

References
----------
Dunn, "Multiple comparisons among means", 1961 (Bonferroni's simultaneous intervals).
"""

import shlex
import threading
import time
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import CONFIDENCE
from pfdist.common.formatted_times import formatted_time, formatted_times
from pfdist.common.measurement_times import Times, validated
from pfdist.common.percent import percent
from pfdist.common.rounding import rounded, with_error
from pfdist.common.streams import stream_of
from pfdist.errors import JobError, PfdistError, StoreError, one_line
from pfdist.filters.estimate import Evaluation
from pfdist.filters.work import BLOCK, Result
from pfdist.problem.job import job_toml
from pfdist.problem.problem import JobSource, as_job
from pfdist.questions.run_of_job import run_and_job
from pfdist.questions.subject import change_of
from pfdist.results import Run, finite
from pfdist.results.moments import Pairs
from pfdist.results.sampling_windows import STRICT, windows_of
from pfdist.results.sets import typical_error
from pfdist.runner.build import Built, build
from pfdist.runner.progress import Say, silent
from pfdist.store import holds_run

FIRST_DRAWS = 480
"""Draws of the first answer, if the filter is fast enough for `FIRST_SECONDS`."""
FIRST_SECONDS = 0.08
FINER = 16  # times the draws of the first answer: on so many draws the answer is final
FINER_SECONDS = 0.3  # of further draws: an answer to a new move waits no longer
JUDGING_SECONDS = 2.0
_TIMED = 4  # times that the speed is measured; other programs may disturb some of them
MOST_BYTES = 256 * 2**20  # of errors that are kept; the sets that were used last stay
YOURS, EVEN, PLAN = "yours", "even", "plan"
ON_THESE_DRAWS = "on these draws"
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Filtered:
    """The errors of a set on the first D draws."""

    mse: Array  # (D,); with an exact engine, empty
    degenerate: NDArray[np.bool_]  # (D,)
    errors: Array  # (D, T+1, q): of each component of z; of an exact engine, (1, T+1, 1)

    def then(self, more: "Filtered") -> "Filtered":
        """The errors on these draws and those that follow them."""
        return Filtered(
            *(np.concatenate(both) for both in zip(self._arrays, more._arrays, strict=True))
        )

    def first(self, draws: int) -> "Filtered":
        """The errors on the first draws."""
        return Filtered(*(each[:draws] for each in self._arrays))

    @property
    def nbytes(self) -> int:
        """The memory of the arrays."""
        return sum(each.nbytes for each in self._arrays)

    @property
    def _arrays(self) -> tuple[Any, ...]:
        return self.mse, self.degenerate, self.errors


class Judgement(NamedTuple):
    """A set and the reference, on draws that no other judgement has."""

    name: str
    times: Times
    gain: float  # by which share of the reference's expected MSE that of the set is lower
    errors: Pairs  # of the set and the reference; empty if they give no interval
    draws: int  # 0: exact
    again: bool  # whether it was judged once more, as the best of several sets


class Session:
    """A problem and the answers about its sets of measurement times; several threads may ask.

    Parameters
    ----------
    source : Problem, Job, str, Path or Run
        A problem, a job, a job file, a run or the folder of a run. If the job has a finished run,
        its plan is shown, too.
    say : callable, optional
        Receives a line for each model file before the file is run.

    Raises
    ------
    PfdistError
        The job or a model is not possible, or the run is not finished.
    """

    def __init__(self, source: JobSource | Run, say: Say = silent) -> None:
        self.run, self.built = _opened(source, say)
        self._source = source if isinstance(source, str | Path) else None
        self.job, self.feasible = self.built.job, self.built.feasible
        self._evaluator, self._clock = self.built.evaluator, self.job.problem.clock
        self._evaluator.compile(self.built.comparing)
        self._stream = stream_of("explore", self.job.seed)
        self._lock = threading.Lock()
        self._known = OrderedDict[Times, Filtered]()
        self.judged: list[Judgement] = []
        self._judgements = 0
        self.best = self.run.best if self.run and self.job.budget is None else None
        self.even = self.feasible.regular()
        self.plan = self._clock.measurements(self.best.measurement_times) if self.best else None
        self.seconds_a_draw = self._measured_seconds()
        blocks = int(FIRST_SECONDS / self.seconds_a_draw) // BLOCK
        self.first_draws = min(FIRST_DRAWS, BLOCK * max(1, blocks))

    # --- what does not change ---------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """All that the page needs once, as JSON values; times are possible measurements."""
        clock, feasible, sets = self._clock, self.feasible, self.job.problem.feasible
        instants = replace(clock, sensors=())
        free = sets.spacing.is_free
        spaced = [None if each.spacing is None else each.spacing.successors for each in sets.limits]
        state = {
            "model": self.job.model.name,
            "run": str(self.run.path) if self.run else "",
            "times": [float(each) for each in clock.times],
            "labels": [formatted_time(instants.written(t)) for t in range(clock.horizon + 1)],
            "unit": clock.unit,
            "sensors": list(clock.sensors),
            "forbidden": sets.forbidden,
            "required": sets.required,
            "after": None if free else sets.spacing.successors,
            "sensors_after": spaced,
            "prices": None if sets.price is None else [*map(float, sets.price)],
            "budget": self._budget(),
            "components": self._components,
            "even": self.even,
            "plan": self.plan,
            "windows": self._windows(),
            "window_percent": STRICT,
            "is_exact": self._evaluator.exact,
            "start": self.plan or feasible.regular(),
        }
        return state | {"judged": self.judgements()}

    def _budget(self) -> str:
        sets = self.feasible
        if sets.counted:
            return f"{sets.total} measurements"
        return f"measurements for a total price of {sets.total_price}"

    @property
    def _components(self) -> list[dict[str, str]]:
        """The name and the unit of each curve."""
        quantities, angles = self._evaluator.model.named("z"), self._evaluator.model.is_angle
        if self._evaluator.exact and len(quantities) > 1:
            return [{"name": "all components", "unit": ""}]
        return [
            {"name": each.name or f"z{each.suffix}" * (len(quantities) > 1),
             "unit": each.unit or "rad" * is_angle}
            for each, is_angle in zip(quantities, angles, strict=True)
        ]  # fmt: skip

    def _windows(self) -> dict[str, list[int]]:
        """The instants to which each measurement of the plan may move alone, if `why` was asked."""
        if self.run is None or self.best is None or "sampling_windows" not in self.run.tables:
            return {}
        table = self.run.table("sampling_windows")
        rows = table[table["name"] == self.best.name].to_dict("records")
        windows = {}
        for each in windows_of(rows, STRICT):
            (measurement,) = self._clock.measurements([each.measurement])
            windows[str(measurement)] = [*self._clock.instants(each.inside)]
        return windows

    # --- an answer --------------------------------------------------------------------------------

    def answer(self, times: Iterable[int], draws: int = 0) -> dict[str, Any]:
        """The errors of a set as JSON values, beside those of the reference and the plan.

        Parameters
        ----------
        times : iterable of int
            Possible measurements: instants, or with S sensors ``t * S + sensor``.
        draws : int
            Number of draws; 0 for those of the first answer. All sets filter the same draws.

        Returns
        -------
        dict
            - ``curves``: the typical error at each instant by set and component of z, in its unit.
            - ``facts``: heads and texts: typical error, expected MSE, gain, gap, price.
            - ``broken``: a sentence for each broken constraint; ``warnings``: others.
            - ``mark``: how far the figures are to be trusted.
            - ``draws``; and ``finer``: the draws of the next, finer answer, or None.

        Raises
        ------
        MeasurementTimesError
            A time is no possible measurement.
        """
        chosen = validated(times, self._clock.possible - 1)
        most = FINER * self.first_draws
        draws = min(draws or self.first_draws, most)
        sets = {YOURS: chosen, EVEN: self.even} | ({PLAN: self.plan} if self.plan else {})
        found = {name: self._filtered(each, draws) for name, each in sets.items()}
        evaluations = {
            name: self._evaluation(sets[name], each.mse, each.degenerate, self._stream)
            for name, each in found.items()
        }
        more = max(BLOCK, int(FINER_SECONDS / self.seconds_a_draw) // BLOCK * BLOCK)
        is_final = self._evaluator.exact or draws >= most
        own = evaluations[YOURS]
        answer = {
            "times": chosen,
            "draws": 0 if self._evaluator.exact else draws,
            "finer": None if is_final else min(most, 2 * draws, draws + more),
            "curves": {name: self._curves(evaluations[name], each) for name, each in found.items()},
            "facts": self._facts(chosen, found[YOURS], evaluations),
            "broken": self.feasible.broken(chosen),
            "warnings": [own.degenerate_text] if own.degenerate_draws else [],
            "mark": self._mark(chosen),
        }
        json: dict[str, Any] = finite(answer)
        return json

    def _mark(self, times: Times) -> str:
        if self._evaluator.exact:
            return "exact"
        if any(each.times == times for each in self.judged):
            return "judged: see the fresh draws below"
        return ON_THESE_DRAWS

    def _facts(
        self, times: Times, own: Filtered, evaluations: Mapping[str, Evaluation]
    ) -> list[tuple[str, str]]:
        mine = evaluations[YOURS]
        facts = [
            ("typical error", self._typical(mine, own)),
            ("expected MSE", with_error(mine.expected_mse, mine.standard_error)),
            *(
                (f"against {other}", _change(mine, evaluations[name]))
                for name, other in ((EVEN, "evenly spaced"), (PLAN, "the plan"))
                if name in evaluations and times != evaluations[name].measurement_times
            ),
        ]
        bound = self.best.bound if self.best else None
        if bound and np.isfinite(bound) and not self.feasible.broken(times):
            gap = percent(max(0.0, 1.0 - bound / mine.expected_mse), 1)
            facts.append(("gap to the bound", f"{gap} (bound {rounded(bound)})"))
        facts.append(("measurements", str(len(times))))
        if self.feasible.price is not None:
            price = self.feasible.price_of(times)
            facts.append(("price", f"{price} of {self.feasible.total_price}"))
        return facts

    def _typical(self, evaluation: Evaluation, found: Filtered) -> str:
        """The typical error of each component of z over all instants, with its unit."""
        weights = self._evaluator.weights
        errors = np.average(self._mean(evaluation, found), axis=0, weights=weights)
        parts = [
            f"{each['name']} {rounded(error, 3)} {each['unit']}".strip()
            if len(errors) > 1 else f"{rounded(error, 3)} {each['unit']}".strip()
            for each, error in zip(self._components, self._roots(errors), strict=True)
        ]  # fmt: skip
        return ", ".join(parts)

    def _curves(self, evaluation: Evaluation, found: Filtered) -> list[list[float]]:
        """The typical error at each instant, (q, T+1), to four digits."""
        return [
            [float(f"{value:.4g}") for value in curve]
            for curve in self._roots(self._mean(evaluation, found)).T
        ]

    def _mean(self, evaluation: Evaluation, found: Filtered) -> Array:
        """The mean error at each instant, (T+1, q); with the worst scenario, on its draws."""
        errors = found.errors
        if evaluation.is_worst and evaluation.scenarios is not None:
            errors = errors[evaluation.scenarios == evaluation.worst_scenario]
        mean: Array = errors.mean(axis=0)
        return mean

    def _roots(self, errors: Array) -> Array:
        angles = (False,) if self._evaluator.exact else self._evaluator.model.is_angle
        by_component = zip(np.atleast_2d(errors).T, angles, strict=True)
        roots = [
            [typical_error(error, is_angle) for error in each] for each, is_angle in by_component
        ]
        return np.array(roots).T.reshape(errors.shape)

    # --- computing --------------------------------------------------------------------------------

    def _evaluation(
        self, times: Times, mse: Array, degenerate: NDArray[np.bool_], stream: int
    ) -> Evaluation:
        exact = float(self.built.exact_errors([times])[0]) if self._evaluator.exact else None
        return Evaluation(
            times,
            mse,
            exact=exact,
            purpose="explore",
            scenarios=self._evaluator.scenarios_of(stream, range(mse.size)),
            is_worst=self.built.is_worst and exact is None,
            degenerate=degenerate,
        )

    def _filtered(self, times: Times, draws: int) -> Filtered:
        """The errors of a set on the first draws; those that are known are not computed again."""
        with self._lock:
            known = self._known.get(times)
        done = 0 if known is None else known.mse.size
        if known is None or (done < draws and not self._evaluator.exact):
            more = self._computed([times], self._stream, (done, draws))[0]
            known = more if known is None else known.then(more)
        with self._lock:
            self._known[times] = known
            self._known.move_to_end(times)
            while len(self._known) > 1 and sum(e.nbytes for e in self._known.values()) > MOST_BYTES:
                self._known.popitem(last=False)
        return known.first(draws)

    def _computed(
        self, sets: Sequence[Times], stream: int, draws: tuple[int, int]
    ) -> list[Filtered]:
        """The errors of sets on a range of draws, under the same filter noise."""
        evaluator = self._evaluator
        if evaluator.exact:
            return [self._exact(times) for times in sets]
        work = evaluator.work(sets, stream, stream, draws, self.built.comparing, trajectories=True)
        result = evaluator.filtered(work)
        apart, angles = result.estimates - result.z, np.array(evaluator.model.is_angle)
        errors = np.where(angles, 1.0 - np.cos(apart), apart**2) if angles.any() else apart**2
        return [
            Filtered(result.mse[:, place], result.degenerate[:, place], of_set)
            for place, of_set in enumerate(errors)
        ]

    def _exact(self, times: Times) -> Filtered:
        """The exact error at each instant, without the instant's weight."""
        evaluators = self._evaluator.of_scenarios if self.built.is_worst else (self._evaluator,)
        errors = max((each.expected_errors([times])[0] for each in evaluators), key=np.mean)
        weights = self._evaluator.weights
        if weights is not None:
            with np.errstate(invalid="ignore", divide="ignore"):
                errors = errors / np.array(weights)
        return Filtered(np.empty(0), np.empty(0, np.bool_), errors[None, :, None])

    def _measured_seconds(self) -> float:
        """Seconds a draw; they decide how many draws an answer has, and nothing else."""
        seconds = []
        for _ in range(_TIMED):
            start = time.perf_counter()
            self._computed([self.even], self._stream, (0, BLOCK))
            seconds.append(time.perf_counter() - start)
        return min(seconds) / BLOCK

    # --- judging ----------------------------------------------------------------------------------

    def judge(self, name: str, times: Iterable[int]) -> list[dict[str, Any]]:
        """Compare a set with the evenly spaced times on fresh draws; give all judgements.

        If several sets were judged, the best of them is judged once more, because the best of
        several estimates is too good.

        Parameters
        ----------
        name : str
            Name of the set.
        times : iterable of int
            Possible measurements.

        Raises
        ------
        JobError
            The set is the reference.
        """
        chosen = validated(times, self._clock.possible - 1)
        if chosen == self.even:
            raise JobError("judge needs other times than the evenly spaced times, got these times")
        self._judge(name, chosen)
        first = [each for each in self.judged if not each.again]
        best = max(first, key=lambda each: each.gain)
        is_known = any(each.again and each.times == best.times for each in self.judged)
        if len({each.times for each in first}) > 1 and not is_known and not self._evaluator.exact:
            self._judge(best.name, best.times, again=True)
        return self.judgements()

    def _judge(self, name: str, times: Times, *, again: bool = False) -> None:
        with self._lock:
            number, self._judgements = self._judgements, self._judgements + 1
        draws, stream = self.judging_draws, stream_of("judge", self.job.seed, number, times)
        own, even = self._evaluations([times, self.even], stream, draws)
        gain, errors = _gain(own, even)
        with self._lock:
            self.judged.append(Judgement(name, times, gain, errors, own.draws, again))

    def _evaluations(self, sets: Sequence[Times], stream: int, draws: int) -> list[Evaluation]:
        """The evaluations of sets on the draws of a stream, under the same filter noise."""
        given, none = (sets, stream, stream, (0, draws)), np.empty((0, len(sets)))
        result = Result(none, degenerate=none > 0)
        if not self._evaluator.exact:
            result = self._evaluator.filtered(self._evaluator.work(*given, self.built.comparing))
        found = zip(sets, result.mse.T, result.degenerate.T, strict=True)
        return [self._evaluation(*each, stream) for each in found]

    @property
    def judging_draws(self) -> int:
        """Draws of a judgement, of about two seconds."""
        blocks = int(JUDGING_SECONDS / self.seconds_a_draw / 2) // BLOCK
        return min(self.job.comparison.draws, BLOCK * max(20, blocks))

    def judgements(self) -> list[dict[str, Any]]:
        """All judgements so far, as JSON values; their intervals hold together with 95 %."""
        with self._lock:
            judged = [*self.judged]
        confidence = 1.0 - (1.0 - CONFIDENCE) / max(1, len(judged))
        rows = []
        for each in judged:
            interval = _interval(each.gain, each.errors, each.draws, confidence)
            rows.append(
                {
                    "name": each.name,
                    "times": each.times,
                    "written": formatted_times(
                        self._clock.written_of(each.times), self._clock.unit
                    ),
                    "draws": each.draws,
                    "gain": each.gain,
                    "interval": interval,
                    "text": change_of(each.gain, interval),
                    "again": each.again,
                }
            )
        json: list[dict[str, Any]] = finite(rows)
        return json

    # --- what the user takes away -----------------------------------------------------------------

    def job_text(self, sets: Mapping[str, Iterable[int]]) -> str:
        """The job with named sets in its section comparison.sets, as TOML.

        Raises
        ------
        JobError
            A name is not allowed.
        """
        written = {name: self._clock.written_of(self._checked(each)) for name, each in sets.items()}
        named = {**self.job.comparison.named, **written}
        section = self.job.comparison.model_dump(mode="json") | {"sets": named}
        job = self.job.with_changes(sections={"comparison": section})
        return job_toml(job.identity())

    def command_line(self, sets: Mapping[str, Iterable[int]]) -> str:
        """The command that compares named sets with the evenly spaced times."""
        self.job_text(sets)  # checks the names
        written = {
            name: ",".join(map(formatted_time, self._clock.written_of(self._checked(times))))
            for name, times in sets.items()
        }
        place = self._source or (self.run.path if self.run else self.job.path)
        if self._source is None and self.run is None and not self.job.origin.is_file:
            return f"pfdist.compare(problem, times={ {'regular': 'regular'} | written })"
        words = ["pfdist", "compare", str(place)]
        for each in ("regular", *(f"{name}={times}" for name, times in written.items())):
            words += ["--times", each]
        return shlex.join(words)

    def _checked(self, times: Iterable[int]) -> Times:
        return validated(times, self._clock.possible - 1)


def _opened(source: JobSource | Run, say: Say) -> tuple[Run | None, Built]:
    """The finished run of a job, if there is one, and the job with its models."""
    is_run = isinstance(source, Run) or (isinstance(source, str | Path) and holds_run(Path(source)))
    try:
        return run_and_job(source, None, (), say)
    except StoreError:
        if isinstance(source, Run) or is_run:
            raise
    return None, build(as_job(source))


def _gain(evaluation: Evaluation, other: Evaluation) -> tuple[float, Pairs]:
    """The gain of a set over another on the same draws, and the errors that give its interval.

    If the worst scenario decides, its draws count; there are none if it is another for each set.
    """
    errors, gain = Pairs(), 1.0 - evaluation.expected_mse / other.expected_mse
    if evaluation.is_worst:
        if evaluation.worst_scenario != other.worst_scenario:
            return gain, errors
        evaluation, other = evaluation.worst, other.worst
    errors.add(evaluation.mse, other.mse)
    return gain, errors


def _interval(
    gain: float, errors: Pairs, draws: int, confidence: float = CONFIDENCE
) -> tuple[float | None, float | None]:
    """The interval of a gain; None where it is unknown. Without draws the gain is exact."""
    low, high = errors.ratio_interval(confidence)
    if not draws:
        return gain, gain
    return (1.0 - high, 1.0 - low) if np.isfinite(high - low) else (None, None)


def _change(evaluation: Evaluation, other: Evaluation) -> str:
    gain, errors = _gain(evaluation, other)
    return change_of(gain, _interval(gain, errors, evaluation.draws))


# --- messages -------------------------------------------------------------------------------------

_LONGEST_NAME = 200  # characters that are shown


def reply(session: Session, message: Any) -> dict[str, Any]:
    """The answer to a message of the page, as JSON values; an error is one line.

    Parameters
    ----------
    session : Session
    message : object
        A mapping with ``ask``, "state", "answer", "judge" or "take", and ``id``, which the answer
        repeats; ``times`` and ``draws``, ``name`` and ``times``, or ``sets``.
    """
    asked = message if isinstance(message, Mapping) else {}
    given: Any = asked.get("times", ()), asked.get("sets", {})
    answer = {"id": asked.get("id"), "ask": asked.get("ask")}
    try:
        match asked.get("ask"):
            case "state":
                return answer | session.state()
            case "answer":
                return answer | session.answer(given[0], _whole(asked.get("draws")))
            case "judge":
                name = str(asked.get("name", ""))[:_LONGEST_NAME]
                return answer | {"judged": session.judge(name, given[0])}
            case "take":
                sets = {str(name): times for name, times in given[1].items()}
                job, command = session.job_text(sets), session.command_line(sets)
                return answer | {"job": job, "command": command}
    except (PfdistError, TypeError, ValueError, AttributeError) as error:
        return answer | {"error": one_line(str(error))}
    return answer | {"error": "ask must be state, answer, judge or take"}


def _whole(draws: Any) -> int:
    return draws if isinstance(draws, int) and draws > 0 else 0
