"""The reference of a comparison: what it is, what it is called, and that it may be any set."""

from pathlib import Path

import numpy as np
import pytest

import pfdist
from oracles.results_of import results_of
from pfdist import Job
from pfdist.cli.main import main
from pfdist.questions.evaluate import evaluate
from pfdist.results.sets import described

SHORT = ["search.genetic.generations=1", "search.random.evaluations=3", "comparison.draws=60"]
COUNTED = {"horizon": 12, "measurement_budget": 4}
PAID = {"horizon": 12, "price": [1] * 6 + [2] * 7, "total_price": 7}


@pytest.mark.parametrize(
    ("problem", "name", "times", "phrase"),
    [
        (COUNTED, "regular", (0, 4, 8, 12), "regular times (N = 4)"),
        (
            COUNTED | {"forbidden": [4]},
            "regular",
            (0, 3, 8, 12),
            "the feasible set nearest to regular times (N = 4)",
        ),
        (
            PAID,
            "regular",
            (0, 2, 3, 4, 5, 12),
            "nearest to regular times of the sets with the most measurements "
            "(N = 6, spends 7 of 7)",
        ),
        (COUNTED, "reference", (1, 2), "the set that comparison.reference names (N = 2)"),
    ],
)
def test_the_summary_says_what_it_is(
    problem: dict[str, object], name: str, times: tuple[int, ...], phrase: str
) -> None:
    assert described({"problem": problem}, name, times)["description"] == phrase


@pytest.mark.plugins("why")
@pytest.mark.slow
@pytest.mark.parametrize("times", [(0, 3, 9), ()])
def test_any_set_is_compared_under_its_name_in_tables_summary_figures_and_why(
    times: tuple[int, ...], small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = small_job.with_changes([*SHORT, f"comparison.reference={[*reversed(times)]}"])
    run = pfdist.run(job, tmp_path / "run")
    assert run.names == ["reference", "genetic", "random"]
    rows = run.table("comparison")
    errors = [name for name in rows if name.startswith("mse_")]
    assert errors == ["mse_reference", "mse_genetic", "mse_random"]
    expected = 1 - rows["mse_random"] / rows["mse_reference"]
    np.testing.assert_allclose(run.table("gains")["gain_random"], expected)
    reference = results_of(run)["reference"]
    assert tuple(reference.measurement_times) == times
    assert reference.broken_constraints == []
    alone = evaluate(job, times, draws=500)
    error = np.hypot(alone.standard_error, reference.standard_error)
    assert abs(alone.expected_mse - reference.expected_mse) < 4 * error
    assert main(["status", str(run.path)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert f"The reference has {len(times)} of 4 measurements." in text
    assert "regular" not in text
    assert main(["why", str(run.path / "job.toml"), "--draws", "20"]) == 0
    assert "Measurements of the random plan" in capsys.readouterr().out
    worth = pfdist.open_run(run.path).table("worth")
    assert {*worth["name"]} - {"genetic", "random"} == ({"reference"} if times else set())
