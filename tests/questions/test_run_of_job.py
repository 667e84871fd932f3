"""Commands that compute take a job and find its run; those that read run no model."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import pfdist
from oracles.in_turn import in_turn
from oracles.listed import rewrite
from pfdist import Job
from pfdist.cli.main import main
from pfdist.errors import StoreError

pytestmark = pytest.mark.plugins("budget", "filter", "online", "runs", "why")

QUICK = [
    "model.name=random_walk",
    "filter.engine=kalman",
    "search.random.evaluations=3",
    "search.genetic.generations=1",
    "comparison.draws=20",
]
READERS = ["status", "table", "list", "report", "plot", "verify"]
ASK: dict[str, list[str]] = {
    "why": [],
    "bound": [],
    "filter": ["y.csv", "--no-report"],
    "next": ["y.csv"],
}
COMPUTERS = {
    **ASK,
    "run": [],
    "plan": ["--bound-draws", "0"],
    "compare": ["--times", "mine=0,3", "--times", "other=1,4"],
    "online": ["--set", "online.draws=3"],
    "budget": ["--measurements", "2:3", "--draws", "20", "--bound-draws", "0"],
    "evaluate": ["--times", "0,3"],
}


@pytest.fixture
def there(finished: Callable[..., Path], small_job: Job, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a job that lists searches, and its run, in which the process works."""
    there = small_job.path.parent
    monkeypatch.chdir(there)
    Path("jobs").mkdir()
    small_job.path.rename("jobs/small.toml")
    shutil.copytree(finished(*QUICK), "results/small")
    Path("y.csv").write_text("t,y0\n0,0.1\n")
    return there


@pytest.fixture
def error(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """A function that gives the one line with which a command line is refused."""

    def refused(*words: str) -> str:
        capsys.readouterr()
        assert main(words) == 1, words
        lines = capsys.readouterr().err.splitlines()
        said = [line for line in lines if line.startswith("pfdist: ")]
        assert len(said) == 1, lines
        return said[0].removeprefix("pfdist: ")

    return refused


def why(*arguments: Any, **options: Any) -> Any:
    return pfdist.why(*arguments, **{"draws": 5, "changes": QUICK, "figures": False} | options)


def test_a_question_finds_the_run_of_its_job(there: Path) -> None:
    found = why("jobs/small.toml")
    assert found.run == Path("results/small").absolute()
    shutil.move("results/small", "elsewhere")
    again = why("jobs/small.toml", results="elsewhere")
    pd.testing.assert_frame_equal(found.worth, again.worth)
    of_kept = why("elsewhere/job.toml", changes=())  # a run's own job stands for this run
    pd.testing.assert_frame_equal(found.worth, of_kept.worth)
    assert of_kept.run == Path("elsewhere").absolute()


def test_a_plan_is_found_if_the_job_was_not_run(there: Path, error: Callable[..., str]) -> None:
    shutil.rmtree("results/small")
    line = error("why", "jobs/small.toml")
    assert line == (
        "there is no run of this job in results/small or results/small-plan: `pfdist run "
        "jobs/small.toml` makes it"
    )
    assert "`pfdist run jobs/small.toml --results a` makes it" in error(
        "bound", "jobs/small.toml", "--results", "a"
    )
    changes = ["comparison.draws=20", "filter.particles=10"]
    made = pfdist.plan("jobs/small.toml", changes=changes, figures=False, bound_draws=0)
    assert made.path == Path("results/small-plan").absolute()
    assert why("jobs/small.toml", changes=changes).run == made.path


@in_turn("search", ["random", "exchange"])
def test_a_named_folder_may_hold_a_plan_of_a_job_that_lists_searches(
    search: str, there: Path, error: Callable[..., str]
) -> None:
    changes = [*QUICK[:2], "comparison.draws=20"]
    made = pfdist.plan("jobs/small.toml", search, search, changes, figures=False, bound_draws=0)
    of_plan = {"results": search, "changes": changes}
    assert why("jobs/small.toml", **of_plan).run == made.path
    found = pfdist.filter_measurements("jobs/small.toml", "y.csv", report=False, **of_plan)
    assert len(found.table) == 13
    Path(f"{search}-2").mkdir()
    line = error("plan", "jobs/small.toml", "--results", search, "--set", "seed=99")
    assert f"{search} holds a different run: give --results {search}-3. In the run" in line
    assert error(
        "why", "jobs/small.toml", "--results", search, "--set", *changes, "filter.particles=7"
    ).endswith("In the run -> now: filter.particles: 40 -> 7")


@in_turn("command", ASK)
def test_another_job_than_that_of_the_run_is_refused(
    command: str, there: Path, error: Callable[..., str]
) -> None:
    words = [command, "jobs/small.toml", *ASK[command], "--set", *QUICK, "filter.particles=7"]
    named = ["--results", "results/small"] if command in ("filter", "next") else []
    line = error(*words, *named)
    assert "results/small holds a different run: ask about results/small, or plan this job" in line
    assert " with --results results/small-2. In" in line
    assert line.endswith(". In the run -> now: filter.particles: 40 -> 7")


@in_turn("name", ["filter_measurements", "next_time"])
@pytest.mark.usefixtures("there")
def test_measurements_need_no_run(name: str, finished: Callable[..., Path]) -> None:
    """Issue 108: a job and a table are enough; a run is used if it is a finished one of the job."""
    ask = getattr(pfdist, name)
    shutil.rmtree("results")
    shutil.copytree(finished(*QUICK), "results/small")
    lines, report = list[str](), {"report": False} if name == "filter_measurements" else {}
    options = {"changes": QUICK, "say": lines.append} | report

    def answer(**more: Any) -> Any:
        lines.clear()
        return ask("jobs/small.toml", "y.csv", **options | more)

    assert answer().run == Path("results/small").absolute()
    assert lines == []
    assert answer(results="none").run is None
    assert lines == ["none holds no run: the answer uses no plan"]
    assert answer(changes=[*QUICK, "filter.particles=7"]).run is None
    why = "results/small holds a different run (filter.particles: 40 -> 7)"
    assert lines == [f"{why}: the answer uses no plan"]
    shutil.rmtree("results/small")

    def stop(progress: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pfdist.run("jobs/small.toml", changes=QUICK, progress=stop, figures=False)
    before = {each: each.read_bytes() for each in Path("results").rglob("*") if each.is_file()}
    for each in ("jobs/small.toml", "results/small"):
        lines.clear()
        assert ask(each, "y.csv", **options).run is None
        assert lines == ["results/small is not finished (searching): the answer uses no plan"]
    with pytest.raises(StoreError, match="is not finished"):
        answer(planned="genetic")
    assert before == {each: each.read_bytes() for each in before}


@pytest.mark.usefixtures("there")
def test_a_folder_with_the_name_of_a_model_is_not_taken_for_it(
    finished: Callable[..., Path],
) -> None:
    shutil.copytree(finished(*QUICK), "ungm")
    assert pfdist.Filter("ungm").model.name == "ungm"
    for folder in (Path("ungm"), "./ungm"):
        assert pfdist.Filter(folder).model.name == "random_walk"


@in_turn("name", ["filter_measurements", "next_time"])
@pytest.mark.usefixtures("there")
def test_measurements_need_no_run_that_cannot_be_read(
    name: str, finished: Callable[..., Path]
) -> None:
    ask = getattr(pfdist, name)
    shutil.rmtree("results")
    shutil.copytree(finished(*QUICK), "results/small")
    file, lines = Path("results/small/run.json").absolute(), list[str]()
    content = json.loads(file.read_text())
    options = {"changes": QUICK, "say": lines.append}
    options |= {"report": False} if name == "filter_measurements" else {}
    older = json.dumps({**content, "schema_version": 2})
    for write, why in (
        (lambda: file.write_text("{"), "results/small/run.json is damaged: "),
        (lambda: rewrite(file, older), "results/small is of schema version 2, which pfdist 0.4"),
    ):
        write()
        lines.clear()
        assert ask("jobs/small.toml", "y.csv", **options).run is None
        (line,) = lines
        assert line.startswith(why)
        assert line.endswith(": the answer uses no plan")
        assert ";" not in line
        with pytest.raises(StoreError, match=why):
            ask("jobs/small.toml", "y.csv", results="results/small", **options)


def test_a_question_leaves_the_draws_of_the_run_as_they_are(there: Path) -> None:
    before = Path("results/small/job.toml").read_bytes()
    for draws in (10, 100):
        why("jobs/small.toml", changes=[*QUICK, f"comparison.draws={draws}"])
        assert Path("results/small/job.toml").read_bytes() == before
        assert pfdist.open_run("results/small").state == "finished"


def test_a_run_computes_also_if_it_was_opened_from_its_folder(there: Path) -> None:
    made = pfdist.run("jobs/small.toml", changes=QUICK, figures=False)
    opened = pfdist.open_run(made.path)
    for each in (made, opened, made.path):
        pd.testing.assert_frame_equal(why(each, changes=()).worth, opened.table("worth"))


@pytest.mark.usefixtures("no_figures")
def test_a_command_that_computes_takes_the_folder_of_a_run(there: Path) -> None:
    for command, more in COMPUTERS.items():
        words = [command, "results/small", *more]
        if command not in (*ASK, "run", "evaluate"):
            words += ["--results", f"new/{command}"]
        assert main(words) == 0


def test_a_command_that_reads_refuses_a_job_file_and_names_its_run(
    there: Path, error: Callable[..., str]
) -> None:
    for command in READERS:
        for job in ("jobs/small.toml", "results/small/job.toml") if command != "list" else ():
            says = f"a run must be a folder, got the job file {job}: its run is results/small"
            assert error(command, job) == says


@pytest.fixture
def hostile(there: Path) -> Path:
    """The folder of a run that names a model file in it, in run.json, too, and has run nothing."""
    run, flag = there / "results" / "small", there / "executed"
    (run / "mine.py").write_text(f"open({str(flag)!r}, 'w').close()\nraise SystemExit\n")
    job = (run / "job.toml").read_text().replace('"random_walk"', '"mine.py:model"')
    assert "mine.py" in job
    rewrite(run / "job.toml", job)
    about = json.loads((run / "run.json").read_text())
    about["provenance"]["folder"] = str(run)
    rewrite(run / "run.json", json.dumps(about))
    return flag


@pytest.mark.usefixtures("no_figures", "undrawn")
def test_no_command_about_the_folder_of_a_run_runs_a_model(hostile: Path) -> None:
    """SECURITY.md: nothing in the folder of a run is run, also if its model file exists."""
    for command in READERS:
        assert main([command, "results/small"]) == 0
    for command in [*ASK, "evaluate"]:
        main([command, "results/small", *COMPUTERS[command]])
    pfdist.compare("jobs/small.toml", "results/small", draws=20, figures=False).table("pairs")
    assert not hostile.exists()


def test_a_run_keeps_its_model_and_another_one_needs_a_job(
    there: Path, error: Callable[..., str]
) -> None:
    line = error("evaluate", "results/small", "--times", "0,3", "--set", "model.name=robot")
    assert line == (
        "model.name must be 'random_walk', the model of the run in results/small, got 'robot'"
    )


@pytest.mark.parametrize("name", ["model.json", "files.json"])
def test_no_question_follows_a_link(name: str, there: Path, error: Callable[..., str]) -> None:
    """SECURITY.md: nothing in the folder of a run is opened through a link."""
    file = Path("results/small") / name
    file.rename(f"{name}-elsewhere")
    file.symlink_to(Path(f"{name}-elsewhere").absolute())
    line = error("evaluate", "results/small", "--times", "0,3")
    assert line.startswith(f"results/small/{name} must be a plain file, got a link")
