"""Needs of capabilities: the settings of a job that go together, and why others do not.

A capability declares facts that it needs. Each refusal of a combination is made here, and the
manual prints the table of all of them (docs/limits.md).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from pfdist.common.plugins import added
from pfdist.errors import JobError
from pfdist.filters.criterion import MEAN, Criterion, OtherCriterion
from pfdist.filters.engines import NUMPY, is_exact
from pfdist.problem.methods import METHODS
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.scenarios_section import Scenarios
from pfdist.problem.sections import Comparison, FilterSection, Model, Search


class JobSections(Protocol):
    """The parts of a job on which needs depend; see `pfdist.problem.job.Job`."""

    model: Model
    problem: ProblemSection
    filter: FilterSection
    scenarios: Scenarios | None
    search: tuple[Search, ...]
    comparison: Comparison

    @property
    def amounts(self) -> Sequence[int]: ...  # noqa: D102

    def section(self, key: str) -> Any: ...  # noqa: D102

    @property
    def path(self) -> Path: ...  # noqa: D102

    @property
    def criterion(self) -> Criterion: ...  # noqa: D102

    @property
    def other_criteria(self) -> dict[str, OtherCriterion]: ...  # noqa: D102


class Fact(NamedTuple):
    """A fact about a job, or about the evaluator of its models once they are built."""

    head: str  # of its column in the manual
    needed: str | Callable[[JobSections], str]  # the end of "... needs", with what the job has
    holds: Callable[[JobSections, Any], bool]


def _got(needed: str, got: Callable[[JobSections], object]) -> Callable[[JobSections], str]:
    return lambda job: f"{needed}, got {got(job)}"


def _of_scenarios(job: JobSections, name: str) -> Any:
    return getattr(job.scenarios, name, None)


def _criterion(job: JobSections) -> str:
    return f"the {job.criterion.label} (problem.criterion, scenarios.criterion)"


def _only_adds(method: Any) -> bool:
    """Whether a method adds errors of the filter's estimates."""
    return bool(method.additive > method.takes_lag)


def _adding(job: JobSections) -> list[str]:
    """The methods of the searches that never compare whole sets."""
    return [e.method for e in job.search if METHODS[e.method].additive and not e.polish]


def _compares_sets(job: JobSections) -> str:
    names = ", ".join(name for name, each in METHODS.items() if not each.additive)
    needed = f"searches that compare whole sets ({names}), or polish = true"
    return f"{needed}, got {', '.join(_adding(job))}"


def _takes_lag(job: JobSections) -> str:
    names = ", ".join(name for name, each in METHODS.items() if not _only_adds(each))
    got = ", ".join(e.method for e in job.search if _only_adds(METHODS[e.method]))
    return f"a search of method {names}, got {got}"


ONE_NUMBER = Fact("no `[budget]`", "a job without a section budget", lambda job, _: not job.amounts)
EXPECTED_MSE = Fact(
    "the expected MSE, not another `problem.criterion`",
    _got("the expected MSE as criterion", _criterion),
    lambda job, _: job.problem.criterion in (None, MEAN.name),
)
OF_EACH_DRAW = Fact(
    "a criterion of the MSE of each draw: its mean or a quantile",
    _got("a criterion of the MSE of each draw, its mean or a quantile", _criterion),
    lambda job, _: job.criterion.of_each_draw,
)
MEAN_OF_SCENARIOS = Fact(
    "not the worst scenario", "scenarios.criterion = 'mean', got 'worst'",
    lambda job, _: _of_scenarios(job, "criterion") != "worst",
)  # fmt: skip
WHOLE_SETS = Fact(
    "searches that compare whole sets", _compares_sets,
    lambda job, _: job.criterion.additive or not _adding(job),
)  # fmt: skip
FILTERED = Fact(
    "the estimate of the filter",
    _got("problem.estimate = 'filtered'", lambda job: job.problem.estimate_written),
    lambda job, _: not job.problem.instants_of_lag,
)
ADDS_SMOOTHED = Fact(
    "a search that adds errors of smoothed estimates, or compares whole sets", _takes_lag,
    lambda job, _: not any(_only_adds(METHODS[e.method]) for e in job.search),
)  # fmt: skip
EQUAL_WEIGHTS = Fact(
    "equal weights of instants", "no problem.instant_weights",
    lambda job, _: job.problem.instant_weights is None,
)  # fmt: skip
TRUE_FILTER = Fact(
    "no `[model.filter]`", "a filter with the true model, got a section model.filter",
    lambda job, _: not (job.model.filter.name or job.model.filter.parameters),
)  # fmt: skip
NOT_NOMINAL = Fact(
    'not `scenarios.filter = "nominal"`', "scenarios.filter = 'told' or 'learned', got 'nominal'",
    lambda job, _: _of_scenarios(job, "filter") != "nominal",
)  # fmt: skip
NOT_TOLD = Fact(
    'not `scenarios.filter = "told"`', "scenarios.filter = 'nominal' or 'learned', got 'told'",
    lambda job, _: _of_scenarios(job, "filter") != "told",
)  # fmt: skip
LEARNED = Fact(
    "no scenarios, or learned ones",
    _got("no scenarios, or scenarios.filter = 'learned'",
         lambda job: repr(_of_scenarios(job, "filter"))),
    lambda job, _: _of_scenarios(job, "filter") in (None, "learned"),
)  # fmt: skip
NO_MOTION = Fact(
    "no `scenarios.motion`",
    _got("a filter without scenarios.motion", lambda job: _of_scenarios(job, "motion")),
    lambda job, _: not _of_scenarios(job, "motion"),
)
PARTICLES = Fact(
    "an engine with particles",
    _got("an engine with particles", lambda job: f"filter.engine = {job.filter.engine!r}"),
    lambda job, _: not is_exact(job.filter.engine),
)
LINEAR_SENSORS = Fact(
    "sensors without `fails`, `works` and limits",
    "sensors without fails and limits",
    lambda job, _: all(each.is_linear for each in job.problem.sensings.values()),
)
COMPILED = Fact(
    "not the engine `numpy`", f"filter.engine = 'compiled', got {NUMPY.name!r}",
    lambda job, _: job.filter.engine != NUMPY.name,
)  # fmt: skip
SQUARED_NORM = Fact(
    "the squared error, not one of the model's own",
    _got("an error that is the squared Euclidean norm",
         lambda job: f"model {job.model.name}, which has its own error"),
    lambda _, evaluator: evaluator is None or evaluator.has_squared_error,
)  # fmt: skip
A_SEARCH = Fact("a search", "a search, got search = []", lambda job, _: bool(job.search))
A_NUMBER = Fact(
    "a number of measurements, not a total price", "problem.measurement_budget, got a total price",
    lambda job, _: job.problem.measurement_budget is not None,
)  # fmt: skip
SAME_STATES = Fact(
    "a filter's model with as many components of x",
    "a filter's model with as many components of x as the true model, got another number",
    lambda _, e: e is None or e.model.components[0] == e.believed.components[0],
)


@dataclass(frozen=True)
class Capability:
    """Something that pfdist can do with some jobs.

    Parameters
    ----------
    title : str
        Its row in the manual.
    needs : mapping of Fact to str
        The facts that it needs, each with its reason; some need no words.
    asked : callable
        How a job asks for it, as text; empty if it does not.
    """

    title: str
    needs: Mapping[Fact, str]
    asked: Callable[[JobSections], str] = lambda _: ""

    def lacks(self, job: JobSections, evaluator: Any = None) -> str:
        """The first need that a job, or its evaluator, does not meet; empty if it meets all."""
        for fact, why in self.needs.items():
            if not fact.holds(job, evaluator):
                needed = fact.needed if isinstance(fact.needed, str) else fact.needed(job)
                return f"{needed}{': ' * bool(why)}{why}"
        return ""

    def check(self, what: str, job: JobSections, evaluator: Any = None) -> None:
        """Raise `JobError` if a job does not meet the needs; `what` is what has been asked for."""
        if lacking := self.lacks(job, evaluator):
            raise JobError(f"{what} needs {lacking} ({job.path})")


_WHOLE = "errors of instants only add up to the mean"
CRITERION = Capability(
    "another `problem.criterion`", {MEAN_OF_SCENARIOS: "", WHOLE_SETS: _WHOLE},
    lambda job: f"problem.criterion = {job.problem.criterion!r}" * bool(job.problem.criterion),
)  # fmt: skip
WORST_SCENARIO = Capability(
    '`scenarios.criterion = "worst"`', {WHOLE_SETS: _WHOLE},
    lambda job: "scenarios.criterion = 'worst'" * (not MEAN_OF_SCENARIOS.holds(job, None)),
)  # fmt: skip
INFORMATION = Capability(
    "the criterion `information`",
    {
        FILTERED: "what measurements tell of the path does not depend on the estimate",
        EQUAL_WEIGHTS: "every measurement counts", TRUE_FILTER: "", NOT_NOMINAL: "",
    },
    lambda job: "the criterion 'information'" * any(e.aspects for e in job.other_criteria.values()),
)  # fmt: skip
SMOOTHED = Capability(
    "a smoothed estimate, or a lag", {ADDS_SMOOTHED: "errors of prefixes do not add up"},
    lambda job: job.problem.estimate_written * bool(job.problem.instants_of_lag),
)  # fmt: skip
CONTROL = Capability(
    "`comparison.control`",
    {PARTICLES: "", TRUE_FILTER: "", NOT_NOMINAL: "", NO_MOTION: ""},
    lambda job: "comparison.control = true" * bool(job.comparison.control),
)
EXACT = Capability(
    "the engine `kalman`",
    {LINEAR_SENSORS: "these are not linear; 'compiled' takes them"},
    lambda job: f"filter.engine = {job.filter.engine!r}" * is_exact(job.filter.engine),
)
WRONG_FILTER = Capability(
    "the engine `kalman` with another filter's model, or `scenarios.filter = \"nominal\"`",
    {FILTERED: "only the filter's error is exact then"},
    lambda job: f"filter.engine = {job.filter.engine!r} with another filter's model"
    * (is_exact(job.filter.engine)
       and not (TRUE_FILTER.holds(job, None) and NOT_NOMINAL.holds(job, None))),
)  # fmt: skip
LEARNING = Capability(
    '`scenarios.filter = "learned"`', {PARTICLES: ""},
    lambda job: "scenarios.filter = 'learned'" * (_of_scenarios(job, "filter") == "learned"),
)  # fmt: skip
BOUND = Capability(
    "a lower bound of the error", {SQUARED_NORM: "0 draws of the bound leave it out"}
)
LOSS = Capability(
    'the particle loss, `filter.particles = "auto"`', {PARTICLES: "", SQUARED_NORM: ""}
)
REAL_DATA = Capability(
    "`pfdist filter`, `next`, `backtest`", {NOT_TOLD: "nobody knows the scenario of a real system"}
)
_CAPABILITIES = (
    CRITERION, WORST_SCENARIO, INFORMATION, SMOOTHED, CONTROL, EXACT,
    WRONG_FILTER, LEARNING, BOUND, LOSS, REAL_DATA,
)  # fmt: skip


def capabilities() -> tuple[Capability, ...]:
    """All capabilities: those of the core, then those of plugins."""
    return (*_CAPABILITIES, *added("capabilities"))


def fault_of(job: JobSections) -> str:
    """Why the settings of a job do not go together; empty if they do."""
    for capability in (*added("capabilities"), *_CAPABILITIES):  # sections of plugins first
        if (what := capability.asked(job)) and (lacking := capability.lacks(job)):
            return f"{what} needs {lacking}"
    return ""
