"""One exploration: a problem whose measurement times a user changes by hand, and the answers.

A user who moves times looks at many sets on the same draws, and keeps the best of them. So these
draws flatter the set, and no error on them is a proof. `ExplorerSession.judge` compares a set with
the plan, if there is one, else with regular times, on draws that are new at each judgement, and all
intervals hold together. Without a run the best evenly spaced times are not known.

References
----------
Dunn, "Multiple comparisons among means", 1961 (Bonferroni's simultaneous intervals).
"""

import math
import shlex
import threading
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from pfdist.common.estimate import CONFIDENCE, Estimate
from pfdist.common.measurement_times import EVEN as BEST_EVEN
from pfdist.common.measurement_times import REGULAR, Times, validated
from pfdist.common.parsing import parse_json
from pfdist.common.percent import percent
from pfdist.common.rounding import unrounded, with_error
from pfdist.common.streams import stream_of
from pfdist.constraints.apart import Apart
from pfdist.errors import JobError, StoreError, reason_of
from pfdist.filters.aspects import ErrorBeside
from pfdist.filters.estimate import Evaluation
from pfdist.filters.variants import is_limit, of_error, shown_beside
from pfdist.filters.work import BLOCK
from pfdist.plugins.explorer.filtered import Change, FilteredSets
from pfdist.plugins.explorer.needs import EXPLORE
from pfdist.problem.job import job_toml
from pfdist.problem.problem import JobSource, as_job
from pfdist.questions.run_of_job import run_and_job
from pfdist.results import Run, finite
from pfdist.results.sampling_windows import STRICT, windows_of
from pfdist.results.stored_run import last_bounds, measured_of
from pfdist.runner.build import Built, build
from pfdist.runner.progress import Say, silent
from pfdist.store import holds_run

FIRST_DRAWS = 480
"""Draws of the first answer, if the filter is fast enough for `FIRST_SECONDS`."""
FIRST_SECONDS = 0.08
FINER = 16  # times the draws of the first answer: on so many draws the answer is final
FINER_SECONDS = 0.3  # of further draws: an answer to a new move waits no longer
JUDGING_SECONDS = 2.0
YOURS, PLAN, EVEN = "yours", "plan", "even"
_REGULAR_TIMES = "regular times"
ON_THESE_DRAWS = "on these draws"
_FEWER = 10  # times fewer draws for the errors beside that of the job
_SAME, _ROUNDING = "the same times", 1e-9  # relative error of exact gaps


class Judgement(NamedTuple):
    """A set against the plan or regular times, on draws that no other judgement has."""

    name: str
    times: Times
    change: Change
    again: bool  # whether it was judged once more, as the best of several sets


class ExplorerSession:
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
        EXPLORE.check("explore", self.built.job)
        self._source = source if isinstance(source, str | Path) else None
        self.job, self.feasible = self.built.job, self.built.feasible
        self._points = self.job.problem.points
        self.built.evaluator.compile(self.built.comparing)
        stream = stream_of("explore", self.job.seed)
        self.played = FilteredSets(self.built, stream)
        evaluator, own = self.built.evaluator, self.built.comparing
        self._beside = dict[ErrorBeside, FilteredSets]()
        for each in shown_beside(evaluator):
            estimation = replace(each.settings(evaluator, own), particles=own.particles)
            built = replace(self.built, evaluator=of_error(evaluator, each.named))
            self._beside[each] = FilteredSets(built, stream, estimation)
        self._lock = threading.Lock()
        self._judged, self._judgements = list[Judgement](), 0
        self.best = self.run.best if self.run and not self.job.amounts else None
        name = self.best.name if self.best else ""
        measured = measured_of(self.run) if self.run and self.best else {}
        self.plan = measured.get(name)
        self.even = measured.get(BEST_EVEN) or self.feasible.regular()
        label = self.run.labels[BEST_EVEN] if self.run and BEST_EVEN in measured else REGULAR
        self._others = {PLAN: "the plan", EVEN: _REGULAR_TIMES if label == REGULAR else label}
        self._proof = last_bounds(self.run).get(name) if self.run and self.best else None
        self.seconds_a_draw = self.played.seconds_a_draw(self.even)
        self.first_draws = min(FIRST_DRAWS, self._draws_in(FIRST_SECONDS))

    def _draws_in(self, seconds: float) -> int:
        return BLOCK * max(1, int(seconds / self.seconds_a_draw) // BLOCK)

    # --- what does not change ---------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """All that the page needs once, as JSON values.

        Times are possible measurements. The page draws each `delays` instants before its value
        arrives.
        """
        clock, sets = self._points.clock, self.feasible
        budget = f"{'At most ' * sets.smaller}{sets.total} measurements"
        if sets.total_price is not None:
            budget = f"Measurements for a total price of {sets.total_price}"
        return {
            "model": self.job.model.name,
            "run": str(self._source or self.run.path) if self.run else "",
            "times": [float(each) for each in clock.times],
            "labels": [*map(clock.text, clock.times)],
            "unit": "" if clock.has_dates else clock.unit,  # dates have none
            "sensors": self._points.sensors or ("",),
            "delays": self._points.delays or (0,) * self._points.ways,
            "forbidden": sets.forbidden,
            "required": sets.required,
            "after": None if sets.spacing.is_free else sets.spacing.successors,
            "sensors_after": {
                step.sensor: step.after for step in sets.steps if isinstance(step, Apart)
            },
            "prices": sets.price and [*map(float, sets.price)],
            "budget": budget,
            "components": [
                {"name": each.name, "unit": each.unit} for each in self.played.components
            ],
            "even": self.even,
            "even_label": self._others[EVEN],
            "plan": self.plan,
            "windows": self._windows(),
            "window_percent": STRICT,
            "judged": self.judgements(),
        }

    def _windows(self) -> dict[str, list[int]]:
        """The instants to which each measurement of the plan may move alone, if `why` was asked."""
        if self.run is None or self.best is None or "sampling_windows" not in self.run.tables:
            return {}
        table = self.run.table("sampling_windows")
        rows = table[table["name"] == self.best.name].to_dict("records")
        windows = dict[str, list[int]]()
        for each in windows_of(rows, STRICT, self._points.clock):
            (point,) = self._points.read([each.measurement])
            windows[str(point)] = [*each.inside.values()]
        return windows

    # --- an answer --------------------------------------------------------------------------------

    def answer(self, times: Iterable[int], draws: int = 0) -> dict[str, Any]:
        """The errors of a set as JSON values, beside those of the reference and the plan.

        Parameters
        ----------
        times : iterable of int
            Points of `pfdist.problem.points.Points`.
        draws : int
            Number of draws; 0 for those of the first answer. All sets filter the same draws.

        Returns
        -------
        dict
            - ``curves``: the typical error at each instant by set and component of z, in its unit.
            - ``facts``: heads and texts: paired differences, first that to the plan; the errors of
              all sets, on the same draws; gap, price.
            - ``broken``: a sentence for each broken constraint; ``warnings``: others.
            - ``mark``: how far the figures are to be trusted.
            - ``draws``; and ``finer``: the draws of the next, finer answer, or None.

        Raises
        ------
        MeasurementTimesError
            A time is no possible measurement.
        """
        chosen, most = self._checked(times), max(FIRST_DRAWS, FINER * self.first_draws)
        draws = min(draws or self.first_draws, most)
        sets = {YOURS: chosen} | ({PLAN: self.plan} if self.plan else {}) | {EVEN: self.even}
        found = {name: self.played.errors(each, draws) for name, each in sets.items()}
        known = {name: self.played.evaluation(sets[name], each) for name, each in found.items()}
        finer = min(most, 2 * draws, draws + self._draws_in(FINER_SECONDS))
        yours, fewer = known[YOURS], max(BLOCK, draws // _FEWER)
        beside = {
            error: {name: own.evaluation(e, own.errors(e, fewer)) for name, e in sets.items()}
            for error, own in self._beside.items()
        }
        typical = {name: self.played.typical(known[name], each) for name, each in found.items()}
        answer = {
            "times": chosen,
            "draws": yours.draws,
            "finer": finer if yours.draws and draws < most else None,
            "curves": {
                name: self.played.curves(known[name], each).T.tolist()
                for name, each in found.items()
            },
            "facts": self._facts(chosen, known, typical, beside),
            "broken": self.feasible.broken(chosen),
            "warnings": [text for text in (yours.degenerate_text, yours.heavy_tail) if text],
            "mark": self._mark(chosen, yours.draws),
        }
        json: dict[str, Any] = finite(answer)
        return json

    def _mark(self, times: Times, draws: int) -> str:
        if not draws:
            return "exact"
        if any(each.times == times for each in self._judged):
            return f"{ON_THESE_DRAWS} ({draws:,}); judged on fresh draws below"
        return f"{ON_THESE_DRAWS} ({draws:,}); provisional: press Judge for a fair comparison"

    def _facts(
        self,
        times: Times,
        known: Mapping[str, Evaluation],
        typical: Mapping[str, str],
        beside: Mapping[ErrorBeside, Mapping[str, Evaluation]],
    ) -> list[tuple[str, str]]:
        own, facts, shown = known[YOURS], list[tuple[str, str]](), [YOURS]
        changes = {name: Change.between(own, known[name]) for name in self._others if name in known}
        for name, change in changes.items():
            is_same = times == known[name].measurement_times
            facts.append((f"against {self._others[name]}", _SAME if is_same else change.text()))
            shown += [] if is_same else [name]
        texts_of = {"expected MSE": _with_errors(known), "typical error": typical}
        for error, found in beside.items():
            limit = ", at most" * is_limit(self.built.evaluator, error)
            texts_of[f"MSE {error.head}{limit}"] = _with_errors(found)
        for head, texts in texts_of.items():
            each = (f"{self._others.get(name, YOURS)} {texts[name]}" for name in shown)
            facts.append((head, "; ".join(each)))
        if PLAN in changes and not self.feasible.broken(times):
            gap = self._gap(changes[PLAN].ratio)
            facts += [("gap to the bound", gap)] * bool(gap)
        price = f", price {self.feasible.price_of(times)} of {self.feasible.total_price}"
        paid = price * (self.feasible.price is not None)
        return [*facts, ("measurements", f"{len(times)}{paid}")]

    def _gap(self, ratio: Estimate) -> str:
        """The gap of a set whose error is a multiple of the plan's, on common draws."""
        if not (proof := self._proof) or proof["reason"]:
            return ""
        parts, mse = ("relaxation", "estimate", "filter_model"), proof["expected_mse"]
        error = math.hypot(*(proof[f"{part}_error"] for part in parts)) / mse
        left = (1.0 - sum(proof[part] for part in parts) / mse) / ratio.value
        gap, error = 1.0 - left, math.hypot(error, left * ratio.standard_error) / ratio.value
        bound = f"(bound {with_error(proof['bound'], proof['bound_error'])})"
        if gap > max(error, _ROUNDING):
            return f"{with_error(100 * gap, 100 * error)} % {bound}"
        if math.isnan(error):  # the worst scenario is another for each set
            return ""
        return (f"not above its error, {percent(error, 1)} " if error else "none ") + bound

    # --- judging ----------------------------------------------------------------------------------

    def judge(self, name: str, times: Iterable[int]) -> list[dict[str, Any]]:
        """Compare a set with the plan on fresh draws; give all judgements.

        Without a plan, it is compared with regular times.

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
            The set is that with which sets are compared.
        """
        chosen = self._checked(times)
        if chosen == (self.plan or self.even):
            these = "the times of the plan" if self.plan else _REGULAR_TIMES
            raise JobError(f"these are {these}, with which sets are compared: move a time first")
        self._judge(name, chosen)
        first = [each for each in self._judged if not each.again]
        best = max(first, key=lambda each: each.change.gain)
        is_known = any(each.again and each.times == best.times for each in self._judged)
        if len({each.times for each in first}) > 1 and not is_known and best.change.draws:
            self._judge(best.name, best.times, again=True)
        return self.judgements()

    def _judge(self, name: str, times: Times, *, again: bool = False) -> None:
        with self._lock:
            number, self._judgements = self._judgements, self._judgements + 1
        fresh = FilteredSets(self.built, stream_of("judge", self.job.seed, number, times))
        own, other = fresh.evaluations([times, self.plan or self.even], self.judging_draws)
        with self._lock:
            self._judged.append(Judgement(name, times, Change.between(own, other), again))

    @property
    def judging_draws(self) -> int:
        """Draws of a judgement, of about two seconds."""
        return min(self.job.comparison.draws, max(FIRST_DRAWS, self._draws_in(JUDGING_SECONDS / 2)))

    def judgements(self) -> list[dict[str, Any]]:
        """All judgements so far, as JSON values; their intervals hold together with 95 %."""
        with self._lock:
            judged = [*self._judged]
        confidence, points = 1.0 - (1.0 - CONFIDENCE) / max(1, len(judged)), self._points
        rows = [
            {
                "name": each.name,
                "times": each.times,
                "written": points.clock.listed(points.written_of(each.times)),
                "draws": each.change.draws,
                "gain": each.change.gain,
                "interval": each.change.interval(confidence),
                "text": each.change.text(confidence),
                "again": each.again,
            }
            for each in judged
        ]
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
        written = {name: self._written(each) for name, each in sets.items()}
        section = self.job.comparison.model_dump(mode="json")
        section["sets"] = {**self.job.comparison.named, **written}
        job = self.job.with_changes(sections={"comparison": section})
        return job_toml(job.identity())

    def command_line(self, sets: Mapping[str, Iterable[int]]) -> str:
        """The command that compares named sets with evenly spaced or regular times and the plan."""
        self.job_text(sets)  # checks the names
        is_regular = self._others[EVEN] == _REGULAR_TIMES
        given = {} if is_regular else {EVEN: self.even}
        given |= {PLAN: self.plan} if self.plan else {}
        written = {REGULAR: REGULAR} if is_regular else {}
        for name, chosen in {**given, **sets}.items():
            written[name] = ",".join(map(unrounded, self._written(chosen)))
        place = self._source or (self.run.path if self.run else self.job.path)
        if self._source is None and self.run is None and not self.job.origin.is_file:
            return f"pfdist.compare(problem, times={written})"
        words = ["pfdist", "compare", str(place)]
        for name, times in written.items():
            words += ["--times", REGULAR if name == REGULAR else f"{name}={times}"]
        return shlex.join(words)

    def _written(self, times: Iterable[int]) -> list[Any]:
        return self._points.written_of(self._checked(times))

    def _checked(self, times: Iterable[int]) -> Times:
        return validated(times, self._points.number - 1)


def _with_errors(found: Mapping[str, Evaluation]) -> dict[str, str]:
    return {name: with_error(e.expected_mse, e.standard_error) for name, e in found.items()}


def _opened(source: JobSource | Run, say: Say) -> tuple[Run | None, Built]:
    """The finished run of a job, if there is one, and the job with its models."""
    try:
        return run_and_job(source, None, (), say)
    except StoreError:
        if isinstance(source, Run) or (isinstance(source, str | Path) and holds_run(Path(source))):
            raise
    return None, build(as_job(source))


# --- messages -------------------------------------------------------------------------------------

_LONGEST_NAME = 200  # characters that are shown


def reply(session: ExplorerSession, message: Any) -> dict[str, Any]:
    """The answer to a message of the page, as JSON values; any error is one line.

    Parameters
    ----------
    session : ExplorerSession
    message : object
        A mapping, or its JSON, with ``ask``, "state", "answer", "judge" or "take", and ``id``,
        which the answer repeats; ``times`` and ``draws``, ``name`` and ``times``, or ``sets``.
    """
    answer: dict[str, Any] = {}
    try:
        given: Any = parse_json(message) if isinstance(message, str | bytes) else message
        asked = given if isinstance(given, Mapping) else {}
        answer = {"id": asked.get("id"), "ask": asked.get("ask")}
        times, sets = asked.get("times", ()), asked.get("sets", {})
        match answer["ask"]:
            case "state":
                return answer | session.state()
            case "answer":
                return answer | session.answer(times, _whole(asked.get("draws")))
            case "judge":
                name = str(asked.get("name", ""))[:_LONGEST_NAME]
                return answer | {"judged": session.judge(name, times)}
            case "take":
                sets = {str(name): each for name, each in sets.items()}
                job, command = session.job_text(sets), session.command_line(sets)
                return answer | {"job": job, "command": command}
    except (Exception, KeyboardInterrupt) as error:  # a page without an answer waits for ever
        return answer | {"error": reason_of(error)}
    return answer | {"error": "ask must be state, answer, judge or take"}


def _whole(draws: Any) -> int:
    return draws if isinstance(draws, int) and draws > 0 else 0
