"""Named sets compared on common draws: exact differences, the same bytes again, what is refused."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.in_turn import in_turn
from oracles.results_of import results_of
from pfdist import Job, load_job
from pfdist.cli.main import main
from pfdist.common.parts import Table, Text
from pfdist.errors import JobError, PfdistError, PfdistWarning, RunMismatchError, StoreError
from pfdist.pages.figure import FIGURES
from pfdist.pages.terminal import lines_of
from pfdist.problem.job import Origin, job_toml
from pfdist.questions.compared_page import compared as compared_section
from pfdist.questions.run_page import answer_of, page_of
from pfdist.questions.subject import Subject
from pfdist.results import Run
from pfdist.results.stored_run import found_sets, named_sets

WALK = """
seed = 4
[model]
name = "random_walk"
[problem]
horizon = 12
measurement_budget = 4
[filter]
particles = 100
[comparison]
draws = 500
[execution]
pool = "serial"
"""
SETS = {"clinic": [0, 3, 6, 12], "late": "6:12:2", "few": [4, 9]}
WORDS = ["--times", "clinic=0,3,6,12", "--times", "late=6:12:2", "--times", "few=4 9"]


KALMAN = ["filter.engine=kalman", "comparison.draws=40"]
compare: Any = partial(pfdist.compare, figures=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compare")
    (folder / "walk.toml").write_text(WALK)
    return folder


@pytest.fixture(scope="module")
def job(folder: Path) -> Job:
    return pfdist.load_job(folder / "walk.toml")


@pytest.fixture(scope="module")
def few(job: Job) -> Job:
    return job.with_changes(["comparison.draws=2"])


@pytest.fixture(scope="module")
def compared(job: Job, folder: Path) -> Run:
    run: Run = compare(job, times=SETS, results=folder / "compared")
    return run


@pytest.fixture(scope="module")
def exact(job: Job, folder: Path) -> Run:
    run: Run = compare(job.with_changes(KALMAN), times=SETS, results=folder / "exact")
    return run


def _bytes(run: Path) -> dict[str, bytes]:
    files = [run / "job.toml", *(run / "tables").glob("*/*.parquet")]
    own = [file for file in files if "timings" not in str(file)]
    return {str(file.relative_to(run)): file.read_bytes() for file in own}


def test_an_exact_engine_gives_the_exact_differences_and_ranks(job: Job, exact: Run) -> None:
    kalman = job.with_changes(["filter.engine=kalman"])
    known = {name: each.expected_mse for name, each in pfdist.evaluate(kalman, SETS).items()}
    for pair in exact.table("pairs").to_dict("records"):
        difference = known[pair["first"]] - known[pair["second"]]
        assert pair["difference"] == pair["low"] == pair["high"] == pytest.approx(difference)
        assert pair["clear"]
    ranks = exact.table("ranks")
    assert ranks["name"].to_list() == sorted(known, key=lambda name: known[name])
    assert ranks["best_rank"].to_list() == ranks["worst_rank"].to_list() == [1, 2, 3]
    assert (ranks["standard_error"] == 0.0).all()


def test_one_command_gives_the_numbers_of_three_lines_of_python(
    compared: Run, folder: Path, said: Callable[..., str]
) -> None:
    words = ["compare", str(folder / "walk.toml"), *WORDS, "--results", str(folder / "command")]
    answer = json.loads(said(*words, "--no-report", "--json"))
    assert answer["pairs"] == compared.table("pairs").to_dict("records")
    assert answer["ranks"] == compared.table("ranks").to_dict("records")
    assert _bytes(folder / "command") == _bytes(compared.path)
    sets = {row["name"]: row for row in answer["sets"]}
    assert sets["few"]["broken_constraints"] == []  # fewer measurements are no fault
    assert sets["clinic"]["broken_constraints"] == []


@pytest.mark.parametrize("kind", ["compared", "exact"])
def test_the_answer_names_the_best_set_and_how_far_it_is_below_the_others(
    kind: str, request: pytest.FixtureRequest
) -> None:
    run: Run = request.getfixturevalue(kind)
    section = compared_section(Subject(run))
    assert section is not None
    sentence, table, *_ = section.blocks
    best, *others = run.table("ranks").to_dict("records")
    share = 100 * (1 - best["expected_mse"] / others[0]["expected_mse"])  # as `plan` has it
    assert isinstance(sentence, Text)
    assert re.match(rf"Best of 3 sets \(.*?\): the set {best['name']}, t = \d", sentence.text)
    told = re.search(r"is ([\d.]+) % lower (.*) than with the set (\w+), the second", sentence.text)
    assert told is not None
    assert told[3] == others[0]["name"]
    assert float(told[1]) == pytest.approx(share, abs=0.01 if kind == "exact" else 0.1)
    assert told[2].startswith("(exact)") is (kind == "exact")
    assert isinstance(table, Table)
    place = table.head.index("the best is lower by, %")
    for row, cells in zip(others, table.rows[1:], strict=True):
        assert cells[place].value == pytest.approx(1 - best["expected_mse"] / row["expected_mse"])
        assert ("(" in cells[place].text) is (kind != "exact")


def test_last_years_samples_are_compared_from_their_table(few: Job, tmp_path: Path) -> None:
    """Times between instants count at the nearest; the job then holds the times, not the file."""
    table = tmp_path / "last.csv"
    table.write_text("when;y0\n0;1,5\n5.2;0,1\n4.8;\n12;0,2\n")
    with pytest.warns(PfdistWarning, match="last.csv count at the nearest instants, at most 0.2 a"):
        run = compare(few, times=[f"last=@{table}:when", "regular"], results=tmp_path / "run")
    assert run.sets["last"] == (0, 5, 12)
    (tmp_path / "job.toml").write_text(job_toml(few.identity()))
    change = "comparison.sets={last='@last.csv:when'}"
    with pytest.warns(PfdistWarning, match="at the nearest instants"):
        job = load_job(tmp_path / "job.toml", [change])
    table.unlink()
    assert job.with_changes(["seed=2"]).identity()["comparison"]["sets"] == {"last": [0, 5, 12]}
    with pytest.raises(JobError, match=r"^comparison.sets.last: cannot read .*last.csv: No such"):
        load_job(tmp_path / "job.toml", [change])


def test_sensors_and_dates_of_a_table_become_those_of_a_set(tmp_path: Path) -> None:
    (tmp_path / "last.csv").write_text("t,sensor\n13.04.2026,ct\n15.04.2026,x-ray\n")
    sensors = {"x-ray": {}, "ct": {}}
    problem = {"horizon": 9, "measurement_budget": 2, "sensors": sensors,
               "clock": {"start": "2026-04-10", "step": "1 d"}}  # fmt: skip
    sets = {"sets": {"last": "@last.csv"}}
    with pytest.warns(PfdistWarning, match=r"t of the table is read as day\.month\.year"):
        job = Job(Origin(tmp_path / "job.toml"), seed=1, problem=problem, comparison=sets)
    assert job.comparison.sets == {"last": ("2026-04-13 ct", "2026-04-15 x-ray")}
    (tmp_path / "last.csv").write_text("t,sensor\n2024-04-13,ct\n2024-04-15,x-ray\n")
    with pytest.warns(PfdistWarning, match="same days of another year: '2024-04-13' is 2026-04-13"):
        earlier = Job(Origin(tmp_path / "job.toml"), seed=1, problem=problem, comparison=sets)
    assert earlier.comparison.sets == job.comparison.sets
    (tmp_path / "last.csv").write_text("t,sensor\n13.04.2024,ct\n15.04.2024,x-ray\n")
    with pytest.warns(
        PfdistWarning, match=r"read as day\.month\.year, of the same days of another"
    ):
        german = Job(Origin(tmp_path / "job.toml"), seed=1, problem=problem, comparison=sets)
    assert german.comparison.sets == job.comparison.sets
    (tmp_path / "last.csv").write_text("t,sensor\n368,ct\n")  # days since the start have no year
    with pytest.raises(JobError, match=r"in 2026-04-10\.\.2026-04-19, got 2027-04-13"):
        Job(Origin(tmp_path / "job.toml"), seed=1, problem=problem, comparison=sets)
    (tmp_path / "last.csv").write_text("t,sensor\n2027-05-01,ct\n")
    with pytest.raises(JobError, match=r"^comparison.sets.last: t must lie in 2026-04-10..2026-04"):
        Job(Origin(tmp_path / "job.toml"), seed=1, problem=problem, comparison=sets)


def test_sets_with_the_same_times_are_one_row(few: Job, tmp_path: Path) -> None:
    run = compare(few, times={"one": [0, 4, 8, 12], "two": "0:12:4"}, results=tmp_path / "run")
    (sentence, *_) = lines_of(answer_of(run))[1:]
    assert sentence == "All sets have the same times: one = two."


def test_sets_that_do_not_differ_clearly_are_all_named(few: Job, tmp_path: Path) -> None:
    times = {"one": [0, 3, 6, 12], "two": [0, 3, 7, 12]}
    (sentence, *_) = lines_of(answer_of(compare(few, times=times, results=tmp_path / "run")))[1:]
    assert sentence.startswith("The best of 2 sets do not differ clearly (95 % confidence): ")


def test_the_summary_fits_80_columns_and_with_the_report_names_what_is_broken(
    compared: Run, said: Callable[..., str]
) -> None:
    whole, _, done = said("status", compared.path).partition("particle-steps: ")
    *lines, place = whole.splitlines()
    *parts, files = done.splitlines()
    assert place.startswith(f"{compared.path}: finished, ")
    assert max(map(len, parts)) <= 80
    assert files.startswith("tables: ")
    assert [line for line in lines if len(line) > 80] == []
    text = " ".join(" ".join(lines).split())
    assert text.startswith("Best of 3 sets (95 % confidence, all pairs together): ")
    assert "has 2 of 4 measurements. `pfdist plan JOB --against few=TIMES` finds the best 2" in text
    assert "Best first, on 500 draws" in text
    assert "Pairs of sets" not in text
    assert "Pairs of sets first second" in " ".join(
        said("status", compared.path, "--verbose").split()
    )
    page = str(page_of(compared))
    assert "How the sets compare" in page
    assert "has 2 of 4 measurements" in page.replace("\N{NO-BREAK SPACE}", " ")
    for words in ("took no part in the search", "found times", "The answer", "How the times were"):
        assert words not in page


def test_an_interrupted_comparison_takes_more_draws_and_ends_with_the_same_bytes(
    job: Job, compared: Run, tmp_path: Path
) -> None:
    def stop(progress: Any) -> None:
        if progress.evaluations:
            raise KeyboardInterrupt

    results = tmp_path / "stopped"
    with pytest.raises(KeyboardInterrupt):
        compare(job, times=SETS, results=results, draws=200, progress=stop)
    with pytest.raises(StoreError, match="is not finished"):
        compare(job, results)
    compare(job, times=SETS, results=results, draws=200)
    compare(job, times=SETS, results=results)
    assert _bytes(results) == _bytes(compared.path)
    with pytest.raises(RunMismatchError, match=r"comparison\.sets\.few: \[4, 9\] -> \[4, 8\]"):
        compare(job, times=SETS | {"few": [4, 8]}, results=results)


def test_the_sets_of_runs_are_compared_on_the_problem_of_the_job(
    job: Job, tmp_path: Path, exact: Run
) -> None:
    changes = [*KALMAN, "search=[{method='random'}]", "search.random.evaluations=5"]
    first = pfdist.run(job.with_changes(changes), tmp_path / "first", figures=False)
    other = job.with_changes([*changes, "seed=8", "comparison.reference=[1, 2]"])
    second = pfdist.run(other, tmp_path / "second", figures=False)
    kalman = job.with_changes(KALMAN)
    both = compare(kalman, first, second.path, exact, results=tmp_path / "both")
    named = [
        "evenly_spaced",
        "random",
        "second_reference",
        "second_random",
        "clinic",
        "late",
        "few",
    ]
    assert [*both.sets] == named
    assert both.sets["second_random"] == second.sets["random"]
    assert both.job["search"] == []
    more = {"mine": [0, 12]}
    again = compare(kalman, first.path, first, times=more, results=tmp_path / "again")
    assert [*again.sets] == ["evenly_spaced", "random", "mine"]


@pytest.mark.plugins("why")
def test_a_comparison_of_the_sets_of_a_run_of_an_object_knows_the_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Questions about the comparison need no model either: this process made the run."""
    monkeypatch.chdir(tmp_path)
    model = replace(pfdist.load_model("random_walk"), name="my_walk")
    problem = pfdist.Problem(model, horizon=12, measurement_budget=4, engine="kalman")
    search = [{"method": "random", "evaluations": 3}]
    job = problem.job(search=search, comparison={"draws": 40})
    run = pfdist.run(job, tmp_path / "object", pool="serial", figures=False)
    found = compare(problem, run, times={"late": "6:12:2"}, draws=40, pool="serial")
    assert found.path == Path("results/my_walk-compare").absolute()
    assert pfdist.why(found, draws=2, figures=False).sets["name"].tolist() == found.names


def test_the_model_of_a_run_whose_sets_are_compared_is_not_run(job: Job, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("from pfdist.models.library.random_walk import model\n")
    (tmp_path / "mine.toml").write_text(WALK.replace('"random_walk"', '"mine.py:model"'))
    first = compare(tmp_path / "mine.toml", times=SETS, results=tmp_path / "a", draws=20)
    (tmp_path / "mine.py").write_text("raise SystemExit\n")
    found = compare(job, first.path, times={"more": [1]}, results=tmp_path / "b", draws=20)
    assert [*found.sets] == [*SETS, "more"]


@pytest.mark.parametrize(
    ("own", "of_run", "message"),
    [
        ({}, {"horizon": 20}, "and ends at 12, got a run that ends at 20"),
        ({}, {"time_unit": "h"}, "first problem, which counts instants, got .* clock in h"),
        ({"time_unit": "h"}, {"time_unit": "h", "time_step": 0.5},
         r"instant 1 is 1 h, got .* instant 1 is 0\.5 h"),
    ],
)  # fmt: skip
def test_a_run_on_another_clock_is_refused_by_its_name(
    own: dict[str, Any], of_run: dict[str, Any], message: str, few: Job, tmp_path: Path
) -> None:
    job, other = (few.with_changes(KALMAN[:1], settings={"problem": e}) for e in (own, of_run))
    run = compare(other, times={"a": [0], "b": [1]}, results=tmp_path / "other")
    with pytest.raises(JobError, match=rf"{message}.* \(.*other\)"):
        compare(job, run)


def test_each_difference_of_the_problem_of_a_run_is_said(few: Job, tmp_path: Path) -> None:
    weights = {"problem": {"instant_weights": [1, 1, 1, 1, 1, 1, 2]}}
    changes = ["problem.horizon=6", "model.parameters.step_sd=2"]
    other, times = few.with_changes(changes, settings=weights), {"a": [0], "b": [1]}
    same = compare(few, times=times, results=tmp_path / "same")
    run = compare(other, times=times, results=tmp_path / "other")
    lines = list[str]()
    compare(few, same, run, say=lines.append, results=tmp_path / "all")
    differs = f"{run.path} has another problem than the first: "
    assert [line.removeprefix(differs) for line in lines if "another problem" in line] == [
        "its horizon is 6, not 12",
        "its errors have other weights of instants",
        "its model differs in model.parameters.step_sd",
    ]


def test_the_name_of_a_set_fits_a_column_however_long_its_parts_are(
    few: Job, tmp_path: Path
) -> None:
    runs = [
        compare(few, times={"s" * 64: [t], "b": [1]}, results=tmp_path / f"{'a_long_name' * 3}{t}")
        for t in (2, 3, 4)
    ]
    names = [*compare(few, *runs, results=tmp_path / "cut").sets]
    assert len({*names}) == len(names) == 4
    assert max(map(len, names)) == 64


def test_a_job_may_have_searches_and_given_sets(small_job: Job, tmp_path: Path) -> None:
    changes = ["comparison.draws=30", "search=[{method='random', evaluations=3}]"]
    changes += ["comparison.sets.mine=[0, 1, 2]", "comparison.sets.every='0:12'"]
    run = pfdist.run(small_job.with_changes(changes), tmp_path / "both", figures=False)
    assert run.names == ["regular", "mine", "every", "random"]
    assert (named_sets(run), found_sets(run)) == (["mine", "every"], ["random"])
    results = results_of(run)
    assert results["random"].search_cause
    assert results["every"].broken_constraints == ["problem.measurement_budget is 4, got 13 times"]
    assert FIGURES["compared"].files(run)
    page = str(page_of(run))
    assert "How the sets compare" in page
    assert "The set every breaks a constraint" in page
    assert results["every"].expected_mse < results["random"].expected_mse


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ({"a": [0]}, "compare needs at least two sets of times, got a: "),
        ({"regular": [0], "b": [1]}, "names of times must not be 'regular', .* got 'regular'"),
        ({"a": [13], "b": [1]}, r"must lie in 0\.\.12, got 13 \(times of a\)"),
    ],
)
def test_wrong_sets_are_refused_in_one_line(
    times: Any, message: str, job: Job, tmp_path: Path
) -> None:
    with pytest.raises(PfdistError, match=message) as caught:
        compare(job, times=times, results=tmp_path / "never")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "never").exists()


@pytest.mark.plugins("online")
@in_turn(
    ("changes", "message"),
    [
        (["search=[]"], "a job needs a search, or comparison.sets"),
        (["comparison.reference='mine'"], "or the name of a set of comparison.sets"),
        (["comparison.sets.reference=[0]"], "must not name a set 'reference'"),
        (["comparison.sets.a=[0]", "search=[]", "online.draws=3"], "online needs a search"),
        (["comparison.sets.a=[0]", "budget={least=2, most=3}"],
         r"budget needs comparison\.reference = 'evenly spaced' or 'regular', got comp"),
    ],
)  # fmt: skip
def test_a_wrong_job_is_refused(changes: list[str], message: str, small_job: Job) -> None:
    with pytest.raises(JobError, match=message):
        small_job.with_changes(changes)


def test_sets_that_are_evaluated_together_share_draws_and_noise(job: Job) -> None:
    sets = pfdist.evaluate(job, {"a": [0, 6], "same": "0:6:6", "regular": "regular"}, draws=50)
    np.testing.assert_array_equal(sets["a"].mse, sets["same"].mse)
    assert sets["regular"].measurement_times == (0, 4, 8, 12)
    assert pfdist.evaluate(job, "regular", draws=50).measurement_times == (0, 4, 8, 12)
    alone = pfdist.evaluate(job, {"a": [0, 6]}, draws=50)["a"]
    np.testing.assert_array_equal(alone.mse, sets["a"].mse)
    assert isinstance(pfdist.evaluate(job, [0, 6], draws=50), pfdist.Evaluation)


def test_evaluate_prints_a_line_for_each_set(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["evaluate", str(folder / "walk.toml"), *WORDS, "--draws", "30"]
    assert main(words) == 0
    out, err = capsys.readouterr()
    rows = [line.split()[0] for line in out.splitlines() if re.search(r"± \d", line)]
    assert rows == ["clinic", "late", "few"]
    assert "Note" not in out  # fewer measurements break no constraint
    assert not err
    assert main([*words, "--json"]) == 0
    assert [*json.loads(capsys.readouterr().out)["sets"]] == ["clinic", "late", "few"]
