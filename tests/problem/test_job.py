import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from oracles.in_turn import in_turn
from pfdist.errors import JobError
from pfdist.problem.feasible import Feasible
from pfdist.problem.job import job_toml, load_job
from pfdist.problem.methods import METHODS
from pfdist.problem.problem import as_job
from pfdist.problem.problem_section import ProblemSection

JOBS = Path(__file__).parents[2] / "jobs"
JOB = """
seed = 1
[model]
[problem]
horizon = 10
measurement_budget = 3
[filter]
[evaluation]
[comparison]
[execution]
[[search]]
method = "genetic"
[[search]]
method = "random"
"""


@pytest.fixture
def write(tmp_path):
    """Write a job file: JOB with a piece of it replaced."""

    def job_file(old="", new=""):
        assert old in JOB
        path = tmp_path / "mine.toml"
        path.write_text(JOB.replace(old, new, 1), encoding="utf-8")
        return path

    return job_file


def test_changes_that_are_made_one_by_one_change_the_job(write):
    assert as_job(write(), (f"seed={seed}" for seed in (7,))).seed == 7


@pytest.mark.parametrize(
    ("name", "searches"),
    [
        ("paper", ["genetic", "random"]),
        ("quick", ["relaxation", "genetic"]),
        ("plan", ["relaxation"]),
    ],
)
def test_the_jobs_that_ship_are_valid(name, searches):
    job = load_job(JOBS / f"{name}.toml")
    assert (job.problem.horizon, job.problem.measurement_budget) == (60, 21)
    assert [search.name for search in job.search] == searches


def test_the_papers_job_is_the_papers_experiment():  # Paper, sections 2.4 and 3.
    job = load_job(JOBS / "paper.toml")
    genetic, trials = (search.settings for search in job.search)
    assert (job.filter.particles, job.evaluation.draws, job.comparison.draws) == (500, 1000, 10**5)
    assert (genetic["population"], genetic["generations"]) == (50, 25)
    assert (genetic["crossover_probability"], genetic["mutation_probability"]) == (1.0, 0.003)
    assert (genetic["sigma_scaling"], trials["evaluations"]) == (1.0, 50 * 25)


PRICES = (
    "[1, 1, 1, 1, 2, 2, 2, 2, 2, 2, 3]",
    "{0-3=1, 4-9=2, 10=3}",
    "{'0:3'=1, '4:9'=2, 10=3}",
    "{'0:3'=1, '4:8:2'=2, '5:9:2'=2, '10'=3}",
)


@in_turn("price", PRICES)
@in_turn("forbidden", ["'4-6', 8", "'4:6', '8'", "'4:8:2', 5", "'4:6, 8'"])
def test_constraints_are_spelt_as_times_or_as_ranges(write, price, forbidden):
    lines = [f"forbidden = [{forbidden}]", "required = [3]", f"price = {price}", "total_price = 7"]
    problem = load_job(write("measurement_budget = 3", "\n".join(lines))).problem
    assert problem.feasible == Feasible(
        10, None, (4, 5, 6, 8), (3,), price=(1, 1, 1, 1, 2, 2, 2, 2, 2, 2, 3), total_price=7
    )


@in_turn("constraint", ["forbidden = {}", "allowed = {}", "required = {}",
                        "visits = {{ most = 3, allowed = {} }}"])  # fmt: skip
def test_ranges_that_name_the_same_times_again_and_again_take_no_memory(write, constraint):
    """2,000 of them once took 3 GB: a limit counts what entries become."""
    ranges = ["0:31000"] * 2000
    path = write("horizon = 10", f"horizon = 32000\n{constraint.format(ranges)}")
    with pytest.raises(
        JobError, match=r"at most 1,000,000 times, those of ranges|one after another"
    ):
        load_job(path)


def test_a_search_is_named_after_its_method_unless_it_has_a_name(write):
    job = load_job(write('method = "random"', 'method = "genetic"\nname = "second"'))
    assert [search.name for search in job.search] == ["genetic", "second"]


ONLINE = ", ".join(repr(name) for name, method in METHODS.items() if method.online)
PRICED = "problem={{horizon=10, total_price=3, price={}}}"

# Changes of JOB, and last what the error says: a row for each rule, and for each kind of value.
MISTAKES = [
    ("seed", r"must be key=value, .* got 'seed'"),
    ("seed.low=3", r"seed\.low=3: seed is not a section"),
    ("search.trials.evaluations=3", r"no search 'trials', allowed: genetic, random"),
    ("sed=3", r"key 'sed'; did you mean 'seed'\? Allowed: seed, model.*mine\.toml with sed=3\)"),
    ("filter.particle=9", r"'particle' in \[filter\]; .* 'particles'\? Allowed: particles, res"),
    ("seed=-1", r"seed must .* 0, got -1 \(.*mine\.toml with seed=-1\)"),
    ("seed=true", r"seed must .* integer, got True "),
    ("filter.particles=0", r"filter\.particles must be at least 1 or 'auto', got 0 "),
    ("filter.particles=0.5", r"filter\.particles must be an integer or 'auto', got 0\.5 "),
    ("search.genetic.population=7", r"\.population must .* multiple of 2, got 7 "),
    ("search.random.name=My", r"search\.random\.name must be lower-case .*, got 'My' "),
    (
        "execution.pool=thread",
        r"pool: got .* mean 'threads'\? Allowed: .*'ray', 'processes', 'serial' or 'threads'",
    ),
    ("search=5", r"search must be one or more \[\[search\]\] sections, got 5 "),
    ("search=[{method='genetics'}]", r"method: got 'genetics'; .* 'genetic'\? Allowed: 'corr"),
    ("search=[{pop=3}]", r"search\.method must .* 'genetic', .*'random', .*got None "),
    (
        "online.search.method=relaxation",
        rf"online\.search\.method must be one of {ONLINE}, got 'relaxation'",
    ),
    ("model.parameters.sd='1'", r"model\.parameters\.sd must be .* got '1' "),
    ("problem.measurement_budget=12", r"^problem\.measurement_budget must be .* 11, got 12 "),
    ("problem.required=5", r"problem\.required must be a list, got 5 "),
    (
        "problem.required=[true]",
        r"entry of problem\.required must be a number or a string, got True ",
    ),
    ("problem.required=['a']", r"problem\.required must name times, .* or '20-30', got 'a' "),
    ("problem.forbidden=['3:1']", r"problem\.forbidden must have ranges .* got '3:1' "),
    ("problem.forbidden=['8-11']", r"forbidden must .* 0\.\.10, got 11 "),
    (PRICED.format("['2']"), r"problem\.price must be a number, got '2' "),
    (PRICED.format("{'0-9'=1, 9=2}"), r"once, got 9 twice"),
    ("search.random.name=regular", r"names must not be 'regular', .* got 'regular' "),
    ("search.random.name=genetic", r"must differ from each other, got 'genetic' twice"),
    ("comparison.reference=even", r"reference must be .* got 'even' "),
    ("online.draws=100001", r"online\.draws of at most comparison\.draws = 100000, got 100001"),
    (
        "online={}",
        "search.random.name=online",
        "needs searches and sets of other names, got 'online'",
    ),
]


@pytest.mark.plugins("budget", "online")
@in_turn("row", MISTAKES)
def test_a_mistake_is_named_with_what_it_got_what_is_allowed_and_where(write, row):
    *changes, message = row
    with pytest.raises(JobError, match=message) as error:
        load_job(write(), changes)
    assert "\n" not in str(error.value)


@pytest.mark.plugins("online")
@pytest.mark.parametrize(
    ("old", "new", "overrides", "message"),
    [
        ("seed = 1", "", [], r"seed must be given \(FILE\)$"),
        ("seed = 1", "seed = ", [], r"must be TOML, .* line 2.* \(FILE\)$"),
        ("seed = 1", "search = 5", ["seed=1"], r"must be TOML, .* line 11"),
        ("seed = 1", "x = [\n2026-04-06T08:00]", [], "a date needs seconds, 2026-04-06T08:00:00"),
        ("seed = 1", "x = '2026-04-06T08:00' y", [], r"must be TOML, .* line 2, column \d+\) \("),
        ("seed = 1", "seed = 1", ["problem.budget=3"], "; did you mean 'measurement_budget'"),
        ("seed = 1", "seed = 1", ["budget=3"], "got 3; did you mean 'problem.measurement_budget'"),
        ("seed = 1", "sed = 1", ["evaluation.draws=5"], r"^unknown key 'sed'"),
        ("seed = 1", "seed = 1\n[new]\na = 1", [], r"; \[new\] needs a plugin that adds it \(FILE"),
        ('"genetic"', '"genetic"\npopulation = 7', [], r"must be a multiple of 2, got 7 \(FILE\)$"),
        (JOB[JOB.index("[[search]]") :], "", ["search.a.b=4"], r"no search 'a', allowed: none"),
    ],
)
def test_the_most_telling_mistake_of_a_file_is_told(write, old, new, overrides, message):
    path = write(old, new)
    with pytest.raises(JobError, match=message.replace("FILE", re.escape(str(path)))):
        load_job(path, overrides)


def test_a_file_that_is_not_there_is_an_error(tmp_path):
    with pytest.raises(JobError, match=r"cannot read .*none\.toml: No such file"):
        load_job(tmp_path / "none.toml")


@pytest.mark.parametrize("method", ["exchange", "relaxation", "survivors"])
def test_what_a_search_is_given_of_its_evaluation_leaves_its_other_defaults(write, method):
    job = load_job(write(), [f"search=[{{method='{method}', evaluation={{draws=50}}}}]"])
    (search,) = job.search
    assert (search.evaluation.draws, search.evaluation.noise) == (50, "common")


def test_overrides_change_the_keys_they_name(write):
    path = write()
    changes = [
        "seed = 3",  # spaces do not matter
        "filter.resampling=systematic",  # a bare word is a string
        "model.parameters.process_sd=2",
        "search.genetic.generations=5",
        "search.random.name=trials",
        "execution.workers=2",
    ]
    before = load_job(path)
    for job in (load_job(path, changes), before.with_changes(changes)):
        assert (job.seed, job.filter.resampling, job.execution.workers) == (3, "systematic", 2)
        assert job.model.parameters == {"process_sd": 2.0}
        assert [search.settings.get("generations") for search in job.search] == [5, None]
        assert [search.name for search in job.search] == ["genetic", "trials"]
        assert job.path == path
    assert before == load_job(path)  # as it was


def test_settings_are_values_that_come_after_overrides(write):
    settings = {"seed": np.int64(7), "execution": {"address": "3", "workers": np.int32(2)}}
    settings["filter"] = {"particles": 12}
    overrides = ["filter.particles=9", "filter.resampling=systematic"]
    job = load_job(write(), overrides, settings=settings)
    assert (job.seed, job.execution.address, job.execution.workers) == (7, "3", 2)
    assert (job.filter.particles, job.filter.resampling) == (12, "systematic")
    assert job.with_changes(settings=settings) == job
    with pytest.raises(JobError, match=r"execution\.address must be .* string, got 3 "):
        load_job(write(), ["execution.address=3"])  # the same text is a number to TOML


def test_settings_of_none_leave_the_job_as_it_is(write):
    job = load_job(write())
    settings = {"execution": {"pool": None, "workers": None}, "filter": {"particles": None}}
    assert job.with_changes(settings=settings | {"seed": None}) == job


@pytest.mark.parametrize(
    ("old", "new", "settings", "message"),
    [
        ("", "", {"filter": {"particles": 0}}, r"got 0 \(.* with filter\.particles=0\)$"),
        ("", "", {"seed": 10**400}, r"got a whole number of .* bits \(.* with seed=a whole"),
        ("[execution]", "[[execution]]", {"execution": {"pool": None}}, "execution must be"),
        ("[execution]", "[[execution]]", {"execution": {"pool": "serial"}}, "execution must be"),
    ],
)
def test_a_wrong_setting_is_one_line_and_hides_no_wrong_section(write, old, new, settings, message):
    with pytest.raises(JobError, match=message) as error:
        load_job(write(old, new), settings=settings)
    assert "\n" not in str(error.value)


def test_any_set_may_be_the_reference_in_any_order(write):
    in_file = load_job(write("[comparison]", "[comparison]\nreference = [6, 0, 3]"))
    given = load_job(write(), ["comparison.reference=[0, 3, 6]"])
    assert in_file.comparison.reference == given.comparison.reference == (0, 3, 6)
    assert in_file.identity() == given.identity() != load_job(write()).identity()
    assert load_job(write()).comparison.reference_name == "evenly_spaced"
    assert given.comparison.reference_name == "reference"


def test_identity_is_everything_but_the_execution_and_what_is_not_constrained(write):
    path = write()
    here, there = load_job(path, ["execution.pool=serial"]), load_job(path, ["execution.workers=9"])
    assert here.identity() == there.identity()
    assert "execution" not in here.identity()
    assert here.identity()["problem"] == {"horizon": 10, "measurement_budget": 3}
    assert load_job(path, ["filter.particles=9"]).identity() != here.identity()


def test_whole_times_written_as_floats_make_the_same_job(write):
    path = write()
    first, again = (
        load_job(path, [f"problem={{{problem}, measurement_budget=3}}", f"comparison.{reference}"])
        for problem, reference in [
            ("time_step=1, horizon=10, forbidden=[3]", "reference=[0, 1, 5]"),
            ("time_step=1.0, horizon=10.0, forbidden=[3.0]", "reference=[-0.0, 1.0, 5]"),
        ]
    )
    assert repr(first.identity()) == repr(again.identity())


@pytest.mark.parametrize("name", ["paper", "quick", "constrained"])
def test_identity_survives_being_written_as_toml(name, tmp_path):
    identity = load_job(JOBS / f"{name}.toml", ["model.parameters.process_sd=2"]).identity()
    written = tmp_path / "job.toml"
    written.write_text(job_toml(identity), encoding="utf-8")
    assert tomllib.loads(written.read_text(encoding="utf-8")) == identity
    assert load_job(written).identity() == identity


@pytest.mark.plugins("online")
def test_online_search_keeps_the_defaults_of_keys_that_are_not_given(write):
    """Otherwise a job that changes one key would plan with far more work than it says."""

    def search(*changes: str) -> object:
        return load_job(write(), ["online={}", *changes]).online.search

    default = search()
    assert search("online.search={rounds=2, evaluation={draws=32}}").model_dump() == {
        **default.model_dump(),
        "rounds": 2,
        "evaluation": {**default.evaluation.model_dump(), "draws": 32},
    }
    assert search("online.search.method=survivors") == METHODS["survivors"].section()


def test_the_condition_of_resampling_is_written_only_if_it_is_not_the_default(write):
    plain, always, below = (
        load_job(write("[filter]", f"[filter]\n{line}"))
        for line in ("", 'resample = "always"', 'resample = "below 0.5"')
    )
    assert job_toml(plain.identity()) == job_toml(always.identity())
    assert plain.filter.threshold == np.inf
    assert 'resample = "below 0.5"' in job_toml(below.identity())
    assert below.filter.threshold == 0.5
    with pytest.raises(JobError, match=r"filter\.resample must be 'always', or 'below'.*'half'"):
        load_job(write("[filter]", '[filter]\nresample = "half"'))


# --- which measurements an estimate uses ----------------------------------------------------------


def test_the_filtered_estimate_is_not_written_into_a_job(write):
    plain, said = load_job(write()), load_job(write(), ["problem.estimate=filtered"])
    assert job_toml(said.identity()) == job_toml(plain.identity())
    assert (plain.problem.instants_of_lag, plain.evaluation) == (0, said.evaluation)
    smoothed = load_job(write(), ["problem.estimate=smoothed"])
    assert smoothed.problem.instants_of_lag == 10
    assert smoothed.identity()["problem"]["estimate"] == "smoothed"


@in_turn(
    ("clock", "lag", "instants"),
    [
        ({}, 3, 3),
        ({}, 11, 10),
        ({"time_step": 0.1}, 0.3, 3),
        ({"time_step": 4.0, "horizon": 40}, 11, 2),
        ({"clock": {"start": "2026-04-01", "step": "1 d"}}, 2, 2),
        ({"clock": {"start": "2026-04-01", "step": "1 d"}}, "48 h", 2),
        ({"time_unit": "years"}, "3 years", 3),
        ({"time_step": 0.1, "time_unit": "h"}, "18 min", 3),
    ],
)
def test_a_lag_is_a_duration_on_the_clock(write, clock, lag, instants):
    horizon = clock.get("horizon", 1 if "time_step" in clock else 10)
    own = {"measurement_budget": 3, **clock, "horizon": horizon, "lag": lag}
    job = load_job(write(), ["search=[]", "comparison.sets={a=[0]}"], {"problem": own})
    assert job.problem.instants_of_lag == instants


@in_turn(
    ("changes", "message"),
    [
        (["lag=0"], "^problem.lag must be at least 1, got 0"),
        (["lag=1.5"], "^problem.lag must be an integer"),
        (["time_unit=h", "lag=0.5"], "^problem.lag must be at least a step, 1, got 0.5"),
        (
            ["horizon=10", "lag=3", "estimate=filtered"],
            "^problem.estimate must be left out with problem.lag, got 'filtered'",
        ),
        (["lag='3 h'"], "^problem.lag must be a number, or .*: the clock has no unit"),
        (["time_unit=h", "lag='3 years'"], "or one with a unit, as '2 h', got '3 years'"),
        (["estimate=best"], "^problem.estimate must be 'filtered' or 'smoothed', got 'best'"),
    ],
)
def test_a_lag_that_is_none_is_one_line(write, changes, message):
    with pytest.raises(JobError, match=message):
        load_job(write(), [f"problem.{change}" for change in changes])


def test_all_durations_may_have_a_unit(write):
    own = {"horizon": 8, "time_unit": "h", "minimum_spacing": "120 min", "measurement_budget": 2}
    job = load_job(write(), ["search=[]", "comparison.sets={a=[0]}"], {"problem": own})
    assert job.problem.minimum_spacing == 2
    sensors = {"a": {"delay": "2 h"}, "b": {"minimum_spacing": "0.5 d"}}
    problem = ProblemSection(horizon=24, time_unit="h", measurement_budget=3, sensors=sensors)
    assert problem.sensors["a"].delay == 2
    assert problem.sensors["b"].minimum_spacing == 12


def test_a_lag_on_uneven_steps_has_as_many_instants_as_its_duration(write):
    own = {"times": [0, 1, 3, 9], "measurement_budget": 2, "lag": 2}
    job = load_job(write(), [], {"problem": own})
    assert job.problem.instants_of_lag == (1, 1, 0, 0)
    with pytest.raises(JobError, match=r"^problem.lag must be at least a step, 1, got 0.5"):
        load_job(write(), [], {"problem": own | {"lag": 0.5}})


@pytest.mark.plugins("online")
@in_turn(
    ("change", "message"),
    [
        (
            "search=[{method='corridor'}]",
            r"a search of method exchange, .*, relaxation, got corridor: errors of prefixes do not",
        ),
        ("online={}", "online needs problem.estimate = 'filtered', got problem.estimate = 'smooth"),
    ],
)
def test_later_measurements_need_sets_or_gaps_that_are_compared(write, change, message):
    with pytest.raises(JobError, match=rf"^.*{message}"):
        load_job(write(), ["problem.estimate=smoothed", change])


def test_exact_errors_need_few_draws_unless_draws_decide_or_are_given(tmp_path: Path) -> None:
    """Shares of draws and pictures are all that draws give then."""
    path = tmp_path / "job.toml"
    path.write_text(
        'seed = 1\nmodel.name = "linear_gaussian"\nproblem = {horizon = 4, measurement_budget = 2}'
    )
    exact = "filter.engine=kalman"
    for draws, changes in {
        100_000: [],
        2000: [exact],
        500: [exact, "comparison.draws=500"],
    }.items():
        job = load_job(path, changes)
        assert job.comparison.draws == draws
        assert job.identity()["comparison"]["draws"] == draws
    for change in ('problem.criterion="quantile 0.9"', 'comparison.also=["quantile 0.9"]'):
        assert load_job(path, [exact, change]).comparison.draws == 100_000
