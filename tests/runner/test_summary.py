"""A run's summary: no cost from draws that chose a set is given as the set's own."""

import re
from pathlib import Path

import numpy as np
import pytest

import pfdist
from pfdist import Job
from pfdist.analysis import Run
from pfdist.display import print_summary
from pfdist.errors import RunMismatchError
from pfdist.search_sections import CommonEvaluation

SURVIVORS = """
[[search]]
method = "survivors"
[search.evaluation]
draws = 30
noise = "common"
particles = 20
"""


@pytest.fixture(autouse=True)
def _no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pfdist.runner.run.draw_figures", lambda run: [])
    monkeypatch.setattr("pfdist.runner.run.figure_files", lambda run: [])


@pytest.fixture
def raced(small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """A run whose search ended with several sets, between which a race on other draws decided."""
    monkeypatch.setattr("pfdist.search.trust.BELOW", 10.0)  # 20 particles are believed
    text = small_job.path.read_text()
    head, _, rest = text.partition("[[search]]")
    small_job.path.write_text(head + SURVIVORS + rest[rest.index("[comparison]") :])
    return pfdist.run(small_job.path, tmp_path / "run")


def test_what_a_search_believed_is_its_own_and_nothing_of_its_race_is_reported(
    raced: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    result, rows = raced.summary()["results"]["survivors"], raced.evaluations()
    times = rows["measurement_times"].map(tuple) == tuple(result["measurement_times"])
    own = rows[times & rows["phase"].isin(["survivors", "survivors.polish"]) & (rows["end"] == 12)]
    race = rows[rows["phase"] == "survivors.shortlist"]
    assert len(race) > 1
    polished = own[own["phase"] == "survivors.polish"]
    chosen = polished if len(polished) else own  # on the most draws that it was tried on
    believed = chosen.loc[chosen["draws"].idxmax()]
    assert result["search_cost"] == believed["expected_mse"]
    assert result["search_standard_error"] == believed["standard_error"]
    fresh = raced.comparison()["mse_survivors"].mean()
    assert result["expected_mse"] == pytest.approx(fresh)
    assert result["search_excess"] == pytest.approx(result["search_cost"] / fresh - 1)
    differs = {"particles": 20, "resampling": "systematic", "estimator": "filter_variance"}
    assert result["search_estimation"] == differs
    print_summary(raced.summary(), "")
    text = capsys.readouterr().out
    excess, side = (
        abs(100 * result["search_excess"]),
        "above" if fresh < result["search_cost"] else "below",
    )
    cause = result["search_cause"]
    assert (
        f"{result['search_cost']:.3f} ± {result['search_standard_error']:.3f}, {excess:.2f} % "
        f"{side} the fresh cost ({cause}; particles = 20, "
        "resampling = systematic, estimator = filter_variance)"
    ) in text
    for cost in race["expected_mse"]:
        assert not np.isclose(cost, [result["expected_mse"], result["search_cost"]]).any()
        assert f"{cost:.3f}" not in re.findall(r"[\d.]+", text)


def test_a_program_that_would_search_otherwise_does_not_go_on(
    raced: Run, small_job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(CommonEvaluation, "particles_of", lambda own, job_particles: 21)
    with pytest.raises(RunMismatchError, match=r"estimations.survivors.particles: 20 -> 21$"):
        pfdist.run(small_job.path, raced.path)


def test_the_reference_is_filtered_twice_and_said_to_gain_nothing(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfdist.runner.comparison_phase.REPEATED", 100)
    run = pfdist.run(small_job, tmp_path / "run")
    again, once = run.repeated(), run.comparison()[:100]
    assert again["draw"].tolist() == list(range(100))
    a, b = once["mse_regular"].to_numpy(), again["mse"].to_numpy()
    assert (a != b).all()  # other noise,
    assert np.corrcoef(a, b)[0, 1] > 4 / np.sqrt(100)  # the same draws
    result = run.summary()["results"]["regular"]
    assert result["gain_over_itself"] == pytest.approx(np.mean(-((a - b) ** 2) / (2 * a * b)))
    assert result["gain_over_itself_draws"] == 100
    low, high = result["gain_over_itself_interval"]
    assert low < result["gain_over_itself"] < high
