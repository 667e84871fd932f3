import re
import tomllib
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from pfdist.errors import JobError
from pfdist.evaluation.estimate import DEGENERATE_POLICIES
from pfdist.job.job import Job, job_toml, load_job
from pfdist.job.sections import EvaluationSection
from pfdist.search.methods import METHODS
from pfdist.times.feasible import Feasible

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


ONLINE = ", ".join(repr(name) for name in METHODS if name != "relaxation")


@pytest.fixture
def write(tmp_path):
    """Write a job file: JOB with a piece of it replaced."""

    def job_file(old="", new=""):
        assert old in JOB
        path = tmp_path / "mine.toml"
        path.write_text(JOB.replace(old, new, 1), encoding="utf-8")
        return path

    return job_file


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


COSTS = (
    "[1, 1, 1, 1, 2, 2, 2, 2, 2, 2, 3]",
    "{0-3=1, 4-9=2, 10=3}",
    "{'0:3'=1, '4:9'=2, 10=3}",
    "{'0:3'=1, '4:8:2'=2, '5:9:2'=2, '10'=3}",
)


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("forbidden", ["'4-6', 8", "'4:6', '8'", "'4:8:2', 5", "'4:6, 8'"])
def test_constraints_are_spelt_as_times_or_as_ranges(write, cost, forbidden):
    lines = [f"forbidden = [{forbidden}]", "required = [3]", f"cost = {cost}", "total_cost = 7"]
    problem = load_job(write("measurement_budget = 3", "\n".join(lines))).problem
    assert problem.feasible == Feasible(
        10, None, (4, 5, 6, 8), (3,), cost=(1, 1, 1, 1, 2, 2, 2, 2, 2, 2, 3), total_cost=7
    )


def test_what_is_not_constrained_is_no_part_of_what_a_run_is(write):
    assert load_job(write()).identity()["problem"] == {"horizon": 10, "measurement_budget": 3}


def test_a_search_is_named_after_its_method_unless_it_has_a_name(write):
    job = load_job(write('method = "random"', 'method = "genetic"\nname = "second"'))
    assert [search.name for search in job.search] == ["genetic", "second"]


# A piece of JOB, what stands there instead, and the error it must make.
MISTAKES = [
    ("seed = 1", "", r"seed must be given"),
    ("seed = 1", "seed = -1", r"seed must .* 0, got -1 "),
    ("seed = 1", "seed = 1.0", r"seed must .* integer, got 1\.0 "),
    ("seed = 1", "seed = true", r"seed must .* integer, got True "),
    ("seed = 1", "seed = 1\nsed = 2", r"unknown key 'sed', allowed: seed, model, problem"),
    ("[filter]", "[filter]\nparticle = 9", r"'particle' in \[filter\], allowed: particles, res"),
    ("[filter]", "[filter]\nparticles = 0", r"filter\.particles must .* 1, got 0 "),
    (
        "[filter]",
        "[filter]\nresampling = 'x'",
        r"resampling .* 'residual' or 'sorted_systematic', got",
    ),
    (
        'method = "genetic"',
        'method = "genetic"\nevaluation = {drawz = 5}',
        r"'drawz' in \[search\.genetic\.evaluation\], allowed: draws, noise, particles, resam",
    ),
    (
        "[model]",
        "[model]\nparameters = {sd = '1'}",
        r"model\.parameters\.sd must be .* got '1' ",
    ),
    ("horizon = 10", "horizon = 0", r"problem\.horizon must .* 1, got 0 "),
    ("budget = 3", "budget = 0", r"problem\.measurement_budget must .* 1, got 0 "),
    ("budget = 3", "budget = 12", r"measurement_budget must .* number of instants, 11, got 12 "),
    ("measurement_budget = 3", "", r"problem\.measurement_budget must be given, or cost and"),
    (
        "budget = 3",
        "budget = 3\ntotal_cost = 9",
        r"^problem\.measurement_budget must be .* without .*, got meas",
    ),
    ("budget = 3", "budget = 3\nrequired = 5", r"problem\.required must be a list .* got 5 "),
    ("budget = 3", "budget = 3\nrequired = [1.5]", r"required must name times, .* got 1\.5 "),
    (
        "budget = 3",
        "budget = 3\nforbidden = ['3:1']",
        r"problem\.forbidden must have ranges from a number to a larger one .*, got '3:1' ",
    ),
    (
        "budget = 3",
        "budget = 3\nforbidden = ['0:9:0']",
        r"problem\.forbidden must .* steps above 0, got '0:9:0' ",
    ),
    (
        "budget = 3",
        "budget = 3\nrequired = ['a']",
        r"problem\.required must name times, as 20, and ranges, as '20:30', '0:60:3' or '20-30', "
        "got 'a' ",
    ),
    ("budget = 3", "budget = 3\nrequired = ['3-1']", r"required must have ranges .* got '3-1' "),
    ("budget = 3", "budget = 3\nforbidden = ['8-11']", r"forbidden must .* 0\.\.10, got 11 "),
    (
        "budget = 3",
        "budget = 3\nminimum_spacing = 6",
        r"^problem\.measurement_budget must be at most 2, .*_spacing = 6, got 3 ",
    ),
    ("measurement_budget = 3", "cost = 2", r"problem\.cost must be a list .* got 2 "),
    ("measurement_budget = 3", "cost = ['2']", r"problem\.cost must be whole .* got '2' "),
    (
        "measurement_budget = 3",
        "cost = {'0-9' = 1}\ntotal_cost = 3",
        r"once, got none for 10",
    ),
    ("measurement_budget = 3", "cost = {'0-9' = 1, 9 = 2}\ntotal_cost = 3", r"once, got 9 twice"),
    (
        "measurement_budget = 3",
        "cost = {'0-11' = 1}\ntotal_cost = 3",
        r"^problem\.cost must .* once, got 11 for a horizon",
    ),
    ("[evaluation]", "[evaluation]\nnoise = 'new'", r"\.noise .* 'fresh' or 'common', got 'new' "),
    ("[evaluation]", "[evaluation]\ndegenerate_draws = 1", r"'kill' or 'leave_out', got 1 "),
    (
        "[evaluation]",
        "[evaluation]\nestimator = 'x'",
        r"\.estimator .* or 'own_variance', got 'x' ",
    ),
    ("[comparison]", "[comparison]\ndraws = 1", r"comparison\.draws must .* 2, got 1 "),
    (
        "[execution]",
        "[execution]\npool = 'dask'",
        r"execution\.pool must .* 'ray', 'serial' or 'threads', got",
    ),
    (
        '"genetic"',
        '"genetics"',
        r"search\.method must .*'random', .*got 'genetics'; did you mean 'genetic'\? ",
    ),
    ('method = "random"', "", r"search\.method must .* 'genetic', .*'random', .*got None "),
    ('"genetic"', '"genetic"\npop = 9', r"'pop' in \[search\.genetic\], allowed: .*, population,"),
    ('"genetic"', '"genetic"\npopulation = 7', r"\.population must .* multiple of 2, got 7 "),
    ('"genetic"', '"genetic"\nmutation_probability = 1.5', r"_probability must .* 1, got 1\.5 "),
    ('"random"', '"random"\nevaluations = 0', r"search\.random\.evaluations must .* 1, got 0 "),
    ('"random"', '"random"\nname = "My"', r"search\.random\.name must .*a-z.*, got 'My' "),
    ('"random"', '"random"\nname = "regular"', r"names must not be 'regular', .* got 'regular' "),
    ('"random"', '"random"\nname = "reference"', r"names must not be .* got 'reference' "),
    ('"random"', '"genetic"', r"search names must be unique, got 'genetic' twice"),
    ("[comparison]", "[comparison]\nreference = 3", r"reference must be 'regular' or a list .* 3 "),
    ("[comparison]", "[comparison]\nreference = 'even'", r"reference must be .* got 'even' "),
    (
        "[comparison]",
        "[comparison]\nreference = [0.5]",
        r"must be integers, got 0\.5 \(comparison\.reference\) ",
    ),
    ("[comparison]", "[comparison]\nreference = [2, 11]", r"0\.\.10, got 11 \(comparison\.ref"),
    ("[comparison]", "[comparison]\nreference = [2, 2]", r"got 2 twice \(comparison\.reference"),
    ("seed = 1", "seed = ", r"must be TOML, .* line 2"),
]


def test_what_a_search_is_given_of_its_evaluation_leaves_its_other_defaults(write):
    for method in ("annealing", "exchange", "relaxation", "survivors"):
        (search,) = load_job(
            write(), [f"search=[{{method='{method}', evaluation={{draws=50}}}}]"]
        ).search
        assert (search.evaluation.draws, search.evaluation.noise) == (50, "common")


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES)
def test_a_mistake_is_named_with_what_it_got_what_is_allowed_and_where(write, old, new, message):
    path = write(old, new)
    with pytest.raises(JobError, match=rf"{message}.*\({re.escape(str(path))}\)"):
        load_job(path)


def test_a_file_that_is_not_there_is_an_error(tmp_path):
    with pytest.raises(JobError, match=r"cannot read .*none\.toml: No such file"):
        load_job(tmp_path / "none.toml")


def test_overrides_change_the_keys_they_name(write):
    job = load_job(
        write(),
        [
            "seed=3",
            "filter.resampling=systematic",  # a bare word is a string
            "model.parameters.process_sd=2",
            "search.genetic.generations=5",
            "search.random.name=trials",
            "execution.workers=2",
        ],
    )
    assert (job.seed, job.filter.resampling, job.execution.workers) == (3, "systematic", 2)
    assert job.model.parameters == {"process_sd": 2.0}
    assert [search.settings.get("generations") for search in job.search] == [5, None]
    assert [search.name for search in job.search] == ["genetic", "trials"]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("seed", r"must be key=value, .* got 'seed'"),
        ("=3", r"must be key=value, .* got '=3'"),
        ("seed.=3", r"must be key=value, .* got 'seed\.=3'"),
        ("seed.low=3", r"seed\.low=3: seed is no section"),
        ("sed=3", r"unknown key 'sed', allowed: seed, .*mine\.toml with sed=3"),
        ("seed=x", r"seed must .* got 'x' .*mine\.toml with seed=x"),
        ("search.trials.evaluations=3", r"no search 'trials', allowed: genetic, random"),
        ("search.genetic.generation=3", r"unknown key 'generation' .* generations"),
        ("search.genetic=3", r"search\.genetic=3: .* search\.NAME\.KEY=value"),
    ],
)
def test_a_mistake_in_an_override_is_named(write, override, message):
    with pytest.raises(JobError, match=message):
        load_job(write(), [override])


def test_any_set_may_be_the_reference_in_any_order(write):
    in_file = load_job(write("[comparison]", "[comparison]\nreference = [6, 0, 3]"))
    given = load_job(write(), ["comparison.reference=[0, 3, 6]"])
    assert in_file.comparison.reference == given.comparison.reference == (0, 3, 6)
    assert in_file.identity() == given.identity() != load_job(write()).identity()
    assert load_job(write()).comparison.reference_name == "regular"
    assert given.comparison.reference_name == "reference"


def test_with_changes_leaves_the_job_as_it_was(write):
    path = write()
    job = load_job(path)
    changed = job.with_changes(["search.genetic.generations=5", "problem.horizon=20"])
    assert (changed.problem.horizon, changed.search[0].settings["generations"]) == (20, 5)
    assert (job.problem.horizon, job.search[0].settings["generations"]) == (10, 25)
    assert changed.path == job.path == path


def test_identity_is_everything_but_the_execution(write):
    path = write()
    here, there = load_job(path, ["execution.pool=serial"]), load_job(path, ["execution.workers=9"])
    assert here.identity() == there.identity()
    assert "execution" not in here.identity()
    assert load_job(path, ["filter.particles=9"]).identity() != here.identity()


@pytest.mark.parametrize("name", ["paper", "quick", "constrained"])
def test_identity_survives_being_written_as_toml(name, tmp_path):
    identity = load_job(JOBS / f"{name}.toml", ["model.parameters.process_sd=2"]).identity()
    written = tmp_path / "job.toml"
    written.write_text(job_toml(identity), encoding="utf-8")
    assert tomllib.loads(written.read_text(encoding="utf-8")) == identity
    assert load_job(written).identity() == identity


@pytest.mark.parametrize(
    ("section", "key", "names"),
    [
        (EvaluationSection, "degenerate_draws", DEGENERATE_POLICIES),
    ],
)
def test_the_job_allows_what_the_program_has(section, key, names):
    assert set(get_args(section.model_fields[key].annotation)) == set(names)


@pytest.mark.parametrize(
    ("old", "new", "override", "message"),
    [
        ("seed = 1", "search = 5", "seed=1", r"must be TOML, .* line 11"),
        ('method = "genetic"', 'method = "genetic"\npopulation = 7', "seed=1", r"got 7 \([^;]*\)$"),
        ("seed = 1", "sed = 1", "evaluation.draws=5", r"^unknown key 'sed'"),
        ("seed = 1", "seed = 1", "seed=1\nx=3", "must be key=value"),
        ("seed = 1", "seed = 1", "search.genetic=3", r"search\.NAME\.KEY=value"),
    ],
)
def test_the_most_telling_mistake_is_told(write, old, new, override, message):
    with pytest.raises(JobError, match=message):
        load_job(write(old, new), [override])


def test_one_search_written_as_a_section_is_an_error_that_names_the_double_brackets(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(JOB.partition("[[search]]")[0] + '[search]\nmethod = "genetic"\n')
    message = r"search must be one or more \[\[search\]\] sections, got \{'method': 'genetic'\}"
    with pytest.raises(JobError, match=message):
        load_job(path, ["seed=1"])


def test_searches_that_are_no_sections_are_an_error_with_an_override_too(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("search = 5\nseed = 1\n[problem]\nhorizon = 5\nmeasurement_budget = 2\n")
    with pytest.raises(
        JobError, match=r"search must be one or more \[\[search\]\] sections, got 5"
    ):
        load_job(path)
    with pytest.raises(JobError, match=r"no search 'genetic', allowed: none"):
        load_job(path, ["search.genetic.population=4"])


def test_spaces_around_a_key_and_a_value_do_not_matter(write):
    assert load_job(write(), ["seed = 3", "filter.resampling = systematic"]).seed == 3


def test_settings_are_values_and_not_text_that_is_parsed(write):
    settings = {"seed": np.int64(7), "execution": {"address": "3", "workers": np.int32(2)}}
    job = load_job(write(), settings=settings)
    assert (job.seed, job.execution.address, job.execution.workers) == (7, "3", 2)
    with pytest.raises(JobError, match=r"execution\.address must be .* string, got 3 "):
        load_job(write(), ["execution.address=3"])  # the same text is a number to TOML


def test_settings_come_after_overrides_and_leave_the_other_keys_of_a_section(write):
    overrides = ["filter.particles=9", "filter.resampling=systematic"]
    job = load_job(write(), overrides, settings={"filter": {"particles": 12}})
    assert (job.filter.particles, job.filter.resampling) == (12, "systematic")
    again = job.with_changes(settings={"filter": {"particles": 12}})
    assert again == job
    assert again.filter.resampling == "systematic"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"filter": {"particles": 0}}, r"particles .* got 0 \(.* with filter\.particles=0\)"),
        ({"filter": {"particle": 5}}, r"unknown key 'particle' in \[filter\]"),
        (
            {"execution": {"pool": "thread"}},
            r"got 'thread'; did you mean 'threads'\? \(.* with execution",
        ),
        ({"seed": 10**400}, r"seed .* got a whole number of .* bits \(.* with seed=a whole"),
        ({"seed": 1.5}, r"seed must be .* got 1\.5"),
    ],
)
def test_a_wrong_setting_is_one_line_with_the_setting(write, settings, message):
    with pytest.raises(JobError, match=message) as error:
        load_job(write(), settings=settings)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        (
            "drws = 3",
            "unknown key 'drws' in [online], allowed: draws, judging_draws, search; "
            "did you mean 'draws'?",
        ),
        ("draws = 1", "online.draws must be at least 2, got 1"),
        ("draws = 200_000", "online.draws must be at most comparison.draws = 100000, got 200000"),
        ("search = 3", "online.search must be a section, got 3"),
        ("search = { rounds = 0 }", "online.search.corridor.rounds must be at least 1, got 0"),
        ("search = { method = 'nothing' }", "'survivors', got 'nothing'"),
        (
            "search = { method = 'relaxation' }",
            f"online.search.method must be one of {ONLINE}, got 'relaxation'",
        ),
        (
            "search = { method = 'corridor', rnds = 2 }",
            "unknown key 'rnds' in [online.search.corridor], allowed: name, evaluation, ",
        ),
    ],
)
def test_mistakes_in_the_section_online_are_named(write, section, message):
    path = write("[execution]", f"[online]\n{section}\n[execution]")
    with pytest.raises(JobError, match=re.escape(message)) as error:
        load_job(path)
    assert "\n" not in str(error.value)


def test_online_search_keeps_the_defaults_of_keys_that_are_not_given(write):
    """Otherwise a job that changes one key would plan with far more work than it says."""
    given = "search = { rounds = 2, evaluation = { draws = 32 } }"
    changed = load_job(write("[execution]", f"[online]\n{given}\n[execution]")).online
    default = load_job(write("[execution]", "[online]\n[execution]")).online
    assert changed.search.model_dump() == {
        **default.search.model_dump(),
        "rounds": 2,
        "evaluation": {**default.search.evaluation.model_dump(), "draws": 32},
    }
    other = "search = { method = 'survivors' }"
    survivors = load_job(write("[execution]", f"[online]\n{other}\n[execution]")).online
    assert survivors.search == METHODS["survivors"].section()


def test_settings_of_none_leave_the_job_as_it_is(small_job: Job) -> None:
    settings = {"execution": {"pool": None, "workers": None}, "filter": {"particles": None}}
    assert small_job.with_changes(settings=settings | {"seed": None}) == small_job


@pytest.mark.parametrize("wrong", ['execution = "serial"', "execution = 3"])
def test_settings_hide_no_section_that_is_wrong(wrong: str, small_job: Job) -> None:
    path, text = small_job.path, small_job.path.read_text()
    path.write_text(f"{wrong}\n{text.partition('[execution]')[0]}")
    for settings in ({"execution": {"pool": None}}, {"execution": {"pool": "serial"}}):
        with pytest.raises(JobError, match="execution must be"):
            load_job(path, settings=settings)
