"""The folder of a finished run: its tables, its figures, and how many files."""

import math
from pathlib import Path

import pandas as pd
import pytest

import pfdist
from pfdist import Job, load_job
from pfdist.errors import PfdistError
from pfdist.runner.build import build
from pfdist.store import parquet
from pfdist.store.repair import verify_run

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_tables_are_read_with_pandas_alone(small_job: Job, tmp_path: Path) -> None:
    run = pfdist.run(small_job, tmp_path / "run")
    rows = pd.read_parquet(tmp_path / "run" / "tables" / "comparison")
    pd.testing.assert_frame_equal(rows, run.comparison())


def test_a_folder_with_other_things_is_left_alone(small_job: Job, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("do not touch")
    with pytest.raises(PfdistError, match=r"results must be .*thesis\.tex"):
        pfdist.run(small_job, tmp_path)


@pytest.mark.slow
def test_figures_are_drawn_again_when_the_run_has_grown(small_job: Job, tmp_path: Path) -> None:
    run = pfdist.run(small_job, tmp_path / "run")
    figure = run.path / "figures" / "gain-genetic.svg"
    before = figure.read_bytes()
    pfdist.run(small_job, tmp_path / "run")
    assert figure.read_bytes() == before
    pfdist.run(small_job.with_changes(["comparison.draws=430"]), tmp_path / "run")
    assert figure.read_bytes() != before
    figure.unlink()
    pfdist.run(small_job.with_changes(["comparison.draws=430"]), tmp_path / "run")
    assert figure.exists()


def test_a_finished_run_of_the_papers_job_holds_fewer_than_60_files(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def parts(job: Job) -> dict[str, list[int]]:
        """How many files the rows of a job's large tables are cut into."""
        rows = [
            search.optimiser.evaluations * job.evaluation.draws for search in build(job).searches
        ]
        cut = parquet.ROWS_IN_A_FILE
        return {
            "draws": [math.ceil(count / cut["draws"]) for count in rows],
            "comparison": [math.ceil(job.comparison.draws / cut["comparison"])],
        }

    paper = parts(load_job(ROOT / "jobs" / "paper.toml"))
    monkeypatch.setitem(parquet.ROWS_IN_A_FILE, "draws", 400)
    monkeypatch.setitem(parquet.ROWS_IN_A_FILE, "comparison", 100)
    job = small_job.with_changes(["search.random.evaluations=24"])
    run = pfdist.run(job, tmp_path / "run")
    assert [len(small_job.search), sum(paper["comparison"])] == [2, 2]
    for table, files in parts(job).items():
        assert len(list((run.path / "tables" / table).iterdir())) == sum(files)
        assert files >= paper[table]
    # tables, what the manifest says of each, figures: all there is
    assert len([path for path in run.path.rglob("*") if path.is_file()]) < 60


@pytest.mark.crash
def test_the_papers_run_of_fewer_particles_holds_fewer_than_60_files(tmp_path: Path) -> None:
    job = load_job(ROOT / "jobs" / "paper.toml", ["filter.particles=2"])  # as many rows
    run = pfdist.run(job, tmp_path / "run", pool="serial")
    assert len(run.draws()) == 1000 * run.evaluations()["evaluation"].nunique() > 2_000_000
    assert run.draws_compared == 100_000
    assert len([path for path in run.path.rglob("*") if path.is_file()]) < 60
    assert list(verify_run(run.path)) == []
