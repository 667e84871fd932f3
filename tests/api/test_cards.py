"""Each result at a prompt and in a notebook: short, and without markup of its own."""

from pathlib import Path

import pfdist
from pfdist import Job
from pfdist.api.bound import bound


def test_each_result_is_a_line_at_a_prompt_and_a_table_in_a_notebook(
    small_job: Job, tmp_path: Path
) -> None:
    kalman = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=30"]
    job = small_job.with_changes([*kalman, "search.genetic.generations=1"])
    run = pfdist.run(job, tmp_path / "<b>run", figures=False)
    results = {
        "run": run,
        "evaluation": pfdist.evaluate(small_job, [0, 4, 8], draws=20),
        "lower bound": bound(run, figures=False),
        "what each measurement": pfdist.why(run, figures=False),
    }
    for begins, result in results.items():
        line, table = repr(result), result._repr_html_()
        assert line.startswith(f"<{begins}")
        assert len(line.splitlines()) == 1
        assert "<table>" in table
        assert "<b>" not in table
    assert repr(run) == f"<run {run.path}: finished, 30 draws compared>"
    assert "regular" in run._repr_html_()


def test_a_run_that_cannot_be_read_has_a_card_that_says_so(small_job: Job, tmp_path: Path) -> None:
    changes = ["comparison.draws=5", "search.genetic.generations=1"]
    run = pfdist.run(small_job.with_changes(changes), tmp_path / "run", figures=False)
    for file in (run.path / "tables" / "comparison").iterdir():
        file.write_bytes(b"damaged")
    assert repr(run) == f"<run {run.path}: cannot be read>"
    assert "cannot be read" in run._repr_html_()
