"""Named sets compared on common draws: exact differences, the same bytes again, what is refused."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from pfdist import Job
from pfdist.analysis import Run
from pfdist.cli.main import main
from pfdist.errors import JobError, PfdistError, RunMismatchError

WALK = """
seed = 4
[model]
name = "random_walk"
[problem]
horizon = 12
measurement_budget = 4
[filter]
particles = 400
[comparison]
draws = 1500
[execution]
pool = "serial"
"""
SETS = {"clinic": [0, 3, 6, 12], "late": "6:12:2", "few": [4, 9]}
WORDS = ["--times", "clinic=0,3,6,12", "--times", "late=6:12:2", "--times", "few=4", "9"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compare")
    (folder / "walk.toml").write_text(WALK)
    return folder


@pytest.fixture(scope="module")
def job(folder: Path) -> Job:
    return pfdist.load_job(folder / "walk.toml")


@pytest.fixture(scope="module")
def compared(job: Job, folder: Path) -> Run:
    return pfdist.compare(job, times=SETS, results=folder / "compared", figures=False)


@pytest.fixture(scope="module")
def exact(job: Job, folder: Path) -> Run:
    kalman = job.with_changes(["filter.engine=kalman", "comparison.draws=40"])
    return pfdist.compare(kalman, times=SETS, results=folder / "exact", figures=False)


def test_a_comparison_of_the_sets_of_a_run_of_an_object_knows_the_object(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Questions about the comparison need no model either: this process made the run."""
    monkeypatch.chdir(folder)
    model = replace(pfdist.load_model("random_walk"), name="my_walk")
    problem = pfdist.Problem(model, horizon=12, measurement_budget=4, engine="kalman")
    run = pfdist.run(
        problem.job(search=[{"method": "random", "evaluations": 3}], comparison={"draws": 40}),
        folder / "object",
        "serial",
        figures=False,
    )
    found = pfdist.compare(problem, run, times={"late": "6:12:2"}, pool="serial", figures=False)
    assert found.path == Path("results/my_walk-compare")
    assert pfdist.why(found, draws=2, figures=False).sets["name"].tolist() == found.names


def _bytes(run: Path) -> dict[str, bytes]:
    files = [run / "job.toml", *(run / "tables").glob("*/*.parquet")]
    return {
        str(file.relative_to(run)): file.read_bytes()
        for file in files
        if "timings" not in str(file)
    }


def test_an_exact_engine_gives_the_exact_differences_and_ranks(job: Job, exact: Run) -> None:
    kalman = job.with_changes(["filter.engine=kalman"])
    known = {name: each.exact for name, each in pfdist.evaluate(kalman, SETS).items()}
    for pair in exact.pairs().to_dict("records"):
        difference = known[pair["first"]] - known[pair["second"]]
        assert pair["difference"] == pair["low"] == pair["high"] == pytest.approx(difference)
        assert pair["clear"]
    ranks = exact.ranks()
    assert ranks["name"].to_list() == sorted(known, key=lambda name: known[name])
    assert ranks["best_rank"].to_list() == ranks["worst_rank"].to_list() == [1, 2, 3]
    assert (ranks["standard_error"] == 0.0).all()


@pytest.mark.slow
def test_differences_of_a_particle_filter_agree_with_the_exact_ones(
    compared: Run, exact: Run
) -> None:
    pairs, known = compared.pairs(), exact.pairs()
    error = (pairs["high"] - pairs["low"]) / 2 / 1.9615  # Student's t of 1500 draws
    assert (np.abs(pairs["difference"] - known["difference"]) < 4 * error).all()
    assert pairs["clear"].any()
    assert compared.ranks()["name"].to_list() == exact.ranks()["name"].to_list()


def test_one_command_gives_the_numbers_of_three_lines_of_python(
    compared: Run, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["compare", str(folder / "walk.toml"), *WORDS, "--results", str(folder / "command")]
    assert main([*words, "--no-report", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["pairs"] == compared.pairs().to_dict("records")
    assert answer["ranks"] == compared.ranks().to_dict("records")
    assert _bytes(folder / "command") == _bytes(compared.path)
    few = answer["results"]["few"]
    assert few["broken_constraints"] == ["problem.measurement_budget is 4, got 2 times"]
    assert answer["results"]["clinic"]["broken_constraints"] == []


def test_the_summary_fits_80_columns_and_names_what_is_broken(
    compared: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status", str(compared.path)]) == 0
    *lines, files = capsys.readouterr().out.splitlines()
    assert files.startswith("tables: ")
    assert max(map(len, lines[1:])) <= 80
    text = "\n".join(lines)
    assert "breaks                problem.measurement_budget is 4, got 2 times" in text
    assert "clinic against late: " in text
    assert "rank 3, expected MSE" in text


def test_an_interrupted_comparison_goes_on_and_ends_with_the_same_bytes(
    job: Job, folder: Path, compared: Run
) -> None:
    def stop(progress: Any) -> None:
        if progress.evaluations:
            raise KeyboardInterrupt

    results = folder / "stopped"
    with pytest.raises(KeyboardInterrupt):
        pfdist.compare(job, times=SETS, results=results, figures=False, progress=stop)
    pfdist.compare(job, times=SETS, results=results, figures=False)
    assert _bytes(results) == _bytes(compared.path)


def test_more_draws_go_on_and_other_sets_are_another_run(
    job: Job, folder: Path, compared: Run
) -> None:
    results = folder / "more"
    pfdist.compare(job, times=SETS, results=results, draws=600, figures=False)
    more = pfdist.compare(job, times=SETS, results=results, draws=1500, figures=False)
    pd.testing.assert_frame_equal(more.pairs(), compared.pairs())
    with pytest.raises(RunMismatchError, match=r"comparison\.sets\.few: \[4, 9\] -> \[4, 8\]"):
        pfdist.compare(job, times=SETS | {"few": [4, 8]}, results=results, figures=False)


@pytest.mark.slow
def test_workers_change_no_byte(job: Job, folder: Path, compared: Run, ray_cluster: None) -> None:
    results, options = folder / "ray", {"pool": "ray", "workers": 2, "figures": False}
    run = pfdist.compare(job, times=SETS, results=results, **options)  # type: ignore[arg-type]
    assert _bytes(run.path) == _bytes(compared.path)


@pytest.mark.slow
def test_times_are_times_on_the_clock(job: Job, folder: Path, compared: Run) -> None:
    clock = job.with_changes(
        settings={"problem": {"time_unit": "h", "time_step": 0.5, "horizon": 6}}
    )
    times = {"clinic": [0, 1.5, 3, 6], "late": "3:6:1", "few": [2, 4.5]}
    run = pfdist.compare(clock, times=times, results=folder / "clock", figures=False)
    assert run.sets() == {"clinic": (0.0, 1.5, 3.0, 6.0), "late": (3, 4, 5, 6), "few": (2, 4.5)}
    np.testing.assert_array_equal(run.pairs()["difference"], compared.pairs()["difference"])
    with pytest.raises(JobError, match=r"first problem, which counts instants, got .* clock in h"):
        pfdist.compare(job, run, times=SETS)


def test_the_sets_of_runs_are_compared_on_the_problem_of_the_job(
    job: Job, folder: Path, exact: Run
) -> None:
    changes = ["filter.engine=kalman", "comparison.draws=40", "search=[{method='random'}]"]
    changes += ["search.random.evaluations=5"]
    first = pfdist.run(job.with_changes(changes), folder / "first", figures=False)
    other = job.with_changes([*changes, "seed=8", "comparison.reference=[1, 2]"])
    second = pfdist.run(other, folder / "second", figures=False)
    options = {"figures": False, "pool": "serial"}
    kalman = job.with_changes(["filter.engine=kalman", "comparison.draws=40"])
    both = pfdist.compare(kalman, first, second.path, exact, results=folder / "both", **options)
    assert [*both.sets()] == [
        "regular", "random", "second_reference", "second_random", "clinic", "late", "few",
    ]  # fmt: skip
    assert both.sets()["second_random"] == second.sets()["random"]
    assert both.job["search"] == []
    again = pfdist.compare(
        kalman, first.path, first, times={"mine": [0, 12]}, results=folder / "x", **options
    )
    assert [*again.sets()] == ["regular", "random", "mine"]


def test_a_run_on_a_longer_horizon_is_refused_by_its_name(job: Job, folder: Path) -> None:
    longer = job.with_changes(["problem.horizon=20", "comparison.draws=2"])
    run = pfdist.compare(
        longer, times={"a": [20], "b": [0]}, results=folder / "long", figures=False
    )
    with pytest.raises(JobError, match=r"and ends at 12, got a run that ends at 20 \(.*long\)"):
        pfdist.compare(job, run)


def test_a_run_on_another_clock_of_the_same_unit_is_refused(job: Job, folder: Path) -> None:
    hours = {"problem": {"time_unit": "h", "horizon": 12}}
    hourly = job.with_changes(["comparison.draws=2", "filter.engine=numpy"], settings=hours)
    halves = hourly.with_changes(["problem.time_step=0.5"])
    run = pfdist.compare(
        halves, times={"a": [0], "b": [1]}, results=folder / "halves", figures=False
    )
    with pytest.raises(JobError, match=r"instant 1 is 1 h, got .* instant 1 is 0\.5 h \(.*halves"):
        pfdist.compare(hourly, run)


def test_each_difference_of_the_problem_of_a_run_is_said(job: Job, folder: Path) -> None:
    few = job.with_changes(["comparison.draws=2"])
    other = few.with_changes(
        ["problem.horizon=6", "model.parameters.step_sd=2"],
        settings={"problem": {"instant_weights": [1, 1, 1, 1, 1, 1, 2]}},
    )
    times = {"a": [0], "b": [1]}
    same = pfdist.compare(few, times=times, results=folder / "same", figures=False)
    run = pfdist.compare(other, times=times, results=folder / "other", figures=False)
    lines: list[str] = []
    options: dict[str, Any] = {"figures": False, "say": lines.append, "results": folder / "all"}
    pfdist.compare(few, same, run, **options)
    differs = " has another problem than the first: "
    said = [line.partition(differs) for line in lines if differs in line]
    assert {path for path, _, _ in said} == {str(run.path)}
    assert [what for _, _, what in said] == [
        "its horizon is 6, not 12",
        "its errors have other weights of instants",
        "its model differs in model.parameters.step_sd",
    ]


def test_a_reference_that_the_job_lists_is_compared(job: Job, folder: Path) -> None:
    listed = job.with_changes(["comparison.draws=2", "comparison.reference=[0, 3, 6]"])
    run = pfdist.compare(listed, times={"a": [0]}, results=folder / "listed", figures=False)
    assert run.sets() == {"reference": (0, 3, 6), "a": (0,)}


def test_the_name_of_a_set_fits_a_column_however_long_its_parts_are(job: Job, folder: Path) -> None:
    few, long = job.with_changes(["comparison.draws=2"]), "s" * 64
    times = {long: [0], "b": [1]}
    runs = [
        pfdist.compare(
            few,
            times=times | {long: [t]},
            results=folder / f"{'a_long_folder_name' * 2}{t}",
            figures=False,
        )
        for t in (2, 3, 4)
    ]
    both = pfdist.compare(few, *runs, results=folder / "cut", figures=False)
    names = [*both.sets()]
    assert len({*names}) == len(names) == 4
    assert max(map(len, names)) == 64


def test_the_model_of_a_run_whose_sets_are_compared_is_not_run(job: Job, folder: Path) -> None:
    home = folder / "mine"
    home.mkdir()
    (home / "mine.py").write_text("from pfdist.models.random_walk import model\n")
    (home / "mine.toml").write_text(WALK.replace('"random_walk"', '"mine.py:model"'))
    options: dict[str, Any] = {"figures": False, "draws": 20, "pool": "serial"}
    first = pfdist.compare(home / "mine.toml", times=SETS, results=home / "a", **options)
    (home / "mine.py").write_text("raise SystemExit\n")
    found = pfdist.compare(job, first.path, times={"more": [1]}, results=home / "b", **options)
    assert [*found.sets()] == [*SETS, "more"]


def test_a_run_that_nobody_finished_is_refused(job: Job, folder: Path) -> None:
    (folder / "empty").mkdir()
    for wrong in (folder / "empty", folder / "nothing"):
        with pytest.raises(PfdistError):
            pfdist.compare(job, wrong, times=SETS)


def test_a_job_may_have_searches_and_given_sets(small_job: Job, tmp_path: Path) -> None:
    changes = ["comparison.draws=30", "search=[{method='random', evaluations=3}]"]
    changes += ["comparison.sets.mine=[0, 1, 2]", "comparison.sets.every='0:12'"]
    run = pfdist.run(small_job.with_changes(changes), tmp_path / "both", report=True)
    assert run.names == ["regular", "mine", "every", "random"]
    assert (run.named, run.found) == (["mine", "every"], ["random"])
    results = run.summary()["results"]
    assert "search_cause" in results["random"]
    assert results["mine"]["broken_constraints"] == ["problem.measurement_budget is 4, got 3 times"]
    assert (tmp_path / "both" / "figures" / "compared.svg").exists()
    page = (tmp_path / "both" / "report.html").read_text()
    assert "How the sets compare" in page
    assert "The times of mine break a constraint of the job." in page
    assert "The times of random have an expected MSE of" in page  # the best of the searches
    assert results["every"]["expected_mse"] < results["random"]["expected_mse"]


def test_the_report_of_a_comparison_names_ranks_pairs_and_broken_constraints(
    compared: Run,
) -> None:
    page = pfdist.report(compared).read_text()
    assert "How the sets compare" in page
    assert "took no part in the search" not in page
    assert "found times" not in page
    assert "problem.measurement_budget is 4, got 2 times" in page
    assert "The answer" not in page
    assert "How the times were found" not in page


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ({"a": [0]}, "compare needs at least two sets of times, got a: "),
        ({"A": [0], "b": [1]}, r"names of comparison\.sets must be lower-case .* got 'A'"),
        ({"regular": [0], "b": [1]}, "names of times must not be 'regular', .* got 'regular'"),
        ({"b": [1], "comparison": [0]}, "names of times must not be .* got 'comparison'"),
        ({"a": [13], "b": [1]}, r"must lie in 0\.\.12, got 13 \(times of a\)"),
        ({"a": [1, 1], "b": [1]}, r"must differ from each other, got 1 twice \(times of a\)"),
        ({"a": ["x"], "b": [1]}, "times of a must name times, .* got 'x'"),
        ({"a": 3, "b": [1]}, "times of a must be a list of times, .* got 3"),
        ([[0], [1]], "times must name sets, as .* got "),
    ],
)
def test_wrong_sets_are_refused_in_one_line(
    times: Any, message: str, job: Job, tmp_path: Path
) -> None:
    with pytest.raises(PfdistError, match=message) as caught:
        pfdist.compare(job, times=times, results=tmp_path / "never")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "never").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--times", "0,3"], "times of several sets must be NAME=TIMES"),
        (["--times", "a=0", "--times", "a=1"], "'a' twice"),
    ],
)
def test_wrong_options_are_refused_in_one_line(
    words: list[str], message: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", str(folder / "walk.toml"), *words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["search=[]"], "search must name at least one search, unless"),
        (["comparison.reference='mine'"], "or the name of a set of comparison.sets"),
        (["comparison.sets.genetic=[0]"], "other names than the searches, got 'genetic'"),
        (["comparison.sets.reference=[0]"], "must not name a set 'reference'"),
        (["comparison.sets.regular=[0]"], "must not name a set 'regular'"),
        (["comparison.sets.a=[13]"], r"0\.\.12, got 13 \(comparison\.sets\.a\)"),
        (["comparison.sets.a=3"], r"comparison\.sets\.a must be 'regular', or times"),
        (["comparison.sets.a=[0]", "search=[]", "online.draws=3"], "online needs a search"),
        (
            ["comparison.sets.a=[0]", "budget={least=2, most=3}"],
            r"budget needs comparison\.reference = 'regular', got comparison\.sets",
        ),
    ],
)
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
    assert [line.partition(":")[0] for line in out.splitlines()] == ["clinic", "late", "few"]
    assert "the times of few break a constraint: problem.measurement_budget" in err
    assert main([*words, "--json"]) == 0
    assert [*json.loads(capsys.readouterr().out)["sets"]] == ["clinic", "late", "few"]
