"""A run's summary: no cost from draws that chose a set is given as the set's own."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.results_of import results_of
from pfdist import Job, Problem
from pfdist.common.parts import Table
from pfdist.common.percent import HEAVY, heavy_tail_warning
from pfdist.common.rounding import with_error
from pfdist.errors import RunMismatchError, StoreError
from pfdist.filters.estimate import Evaluation
from pfdist.pages.terminal import lines_of
from pfdist.problem.search_section import CommonNoiseSettings
from pfdist.questions.evaluate import Evaluated
from pfdist.questions.run_page import answer_of, page_of, searches_section
from pfdist.questions.subject import Subject
from pfdist.results import Run, reaching, stored_run
from pfdist.results.stored_run import check_one_number

SURVIVORS = """
[[search]]
method = "survivors"
[search.evaluation]
draws = 30
noise = "common"
particles = 20
"""


def _all_that_is_said(run: Run) -> str:
    return " ".join(" ".join(lines_of(answer_of(run, details=True), verbose=True)).split())


@pytest.fixture
def raced(small_job: Job, tmp_path: Path) -> Run:
    """A run whose search ended with several sets, between which a race on other draws decided."""
    text = small_job.path.read_text()
    head, _, rest = text.partition("[[search]]")
    small_job.path.write_text(head + SURVIVORS + rest[rest.index("[comparison]") :])
    return pfdist.run(small_job.path, tmp_path / "run", figures=False)


def test_what_a_search_believed_is_its_own_and_nothing_of_its_race_is_reported(raced: Run) -> None:
    result, rows = results_of(raced)["survivors"], raced.table("evaluations")
    times = rows["measurement_times"].map(tuple) == tuple(result.measurement_times)
    own = rows[times & rows["phase"].isin(["survivors", "survivors.polish"]) & (rows["end"] == 12)]
    race = rows[rows["phase"] == "survivors.shortlist"]
    assert len(race) > 1
    polished = own[own["phase"] == "survivors.polish"]
    chosen = polished if len(polished) else own  # on the most draws that it was tried on
    believed = chosen.loc[chosen["draws"].idxmax()]
    assert result.search_mse == believed["expected_mse"]
    assert result.search_standard_error == believed["standard_error"]
    fresh = raced.table("comparison")["mse_survivors"].mean()
    assert result.expected_mse == pytest.approx(fresh)
    assert result.search_excess == pytest.approx(result.search_mse / fresh - 1)
    how = "particles = 20, resampling = systematic, estimator = filter_variance"
    assert result.search_settings == how
    text = _all_that_is_said(raced)
    (row,) = [
        row for row in searches_section(Subject(raced)).blocks[0].rows if row[0].text == "survivors"
    ]
    assert row[3].text == with_error(result.search_mse, result.search_standard_error)
    excess = 100 * result.search_excess
    assert row[4].text == f"{abs(excess):.1f} % {'below' if excess < 0 else 'above'}"
    assert row[4].value == result.search_excess
    assert row[5].text == f"{result.search_cause}; {how}"
    for cost in race["expected_mse"]:
        assert not np.isclose(cost, [result.expected_mse, result.search_mse]).any()
        assert f"{cost:.3f}" not in re.findall(r"[\d.]+", text)


def test_a_program_that_would_search_otherwise_does_not_go_on(
    raced: Run, small_job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        CommonNoiseSettings, "particles_of", lambda own, job_particles, proposal: 21
    )
    with pytest.raises(RunMismatchError, match=r"estimations.survivors.particles: 20 -> 21$"):
        pfdist.run(small_job.path, raced.path, figures=False)


@pytest.mark.parametrize("is_papers", [True, False])
def test_the_papers_experiment_alone_shows_the_papers_figures(
    is_papers: bool, finished: Callable[..., Path]
) -> None:
    """The paper, section 3: a mean relative gain of 27.7 %, and 87.5 % of the draws gain."""
    run = pfdist.open_run(finished())
    papers = pfdist.load_job(Path(__file__).parents[2] / "jobs" / "paper.toml").identity()
    assert {each["name"] for each in papers["search"]} == {*run.names} - {"regular"}
    run.job["filter"]["particles"] = 500
    if is_papers:
        run.job.update({key: papers[key] for key in ("model", "filter", "evaluation", "search")})
        run.job["problem"] = papers["problem"]
    text = " ".join(" ".join(lines_of(answer_of(run))).split())
    genetic = results_of(run)["genetic"]
    share = 100 * genetic.positive_fraction
    told = re.search(r"relative gain of the genetic plan is (-?[\d.]+) % \(.*?\); (.*)", text)
    assert bool(told) == is_papers
    if told:
        assert float(told[1]) == pytest.approx(100 * genetic.mean_relative_gain, abs=0.5)
        paper = "The paper prints 27.7 % and 87.5 %"
        assert told[2].startswith(f"{share:.1f} % of the draws gain. {paper}")


def test_a_summary_warns_where_few_draws_carry_the_error(
    finished: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three of 250 draws have 101 times the error of the others, and 1 % are two of them."""
    mse, errors_of = np.where(np.arange(250) < 3, 101.0, 1.0), stored_run.errors_of

    def heavy(run: Run) -> Iterator[tuple[Any, ...]]:
        for errors, *others in errors_of(run):
            yield (np.broadcast_to(mse[: len(errors), None], errors.shape), *others)

    run, share = pfdist.open_run(finished()), 202 / 550
    monkeypatch.setattr(stored_run, "errors_of", heavy)
    monkeypatch.setattr("pfdist.results.sets.summary_of", lambda run: None)
    said = heavy_tail_warning([share])
    assert f"carries {100 * share:.0f} % of the expected MSE" in said
    for page in (answer_of(run), page_of(run)):
        assert str(page).count(said) == 1
        assert not [text for text in page.warnings if "draws carry" in text]
    evaluation = Evaluation((0,), mse)
    assert said in evaluation._repr_html_()
    alone, problem = {"a": evaluation}, pfdist.load_job(run.path).problem
    evaluated = Evaluated(alone, {}, problem, {"a": []}, [], 0.0, None)
    assert str(evaluated._page()).count(said) == 1


def test_heavy_tails_are_said_and_light_ones_are_not() -> None:
    """The largest 1 % of log-normal errors with log-sd 2 carries Phi(2 - z) = 0.37 of their mean.

    z is the normal quantile of 99 %. For exponential errors it is 0.01 (1 + log 100) = 0.056.
    """
    random = np.random.default_rng(1)
    for draws in (250, 1000, 8000):
        heavy, light = np.exp(2 * random.standard_normal(draws)), random.exponential(size=draws)
        assert Evaluation((0,), heavy).heavy_tail
        assert not Evaluation((0,), light).heavy_tail


def test_a_table_with_standard_errors_says_so_in_its_heads_or_in_its_caption(
    finished: Callable[..., Path],
) -> None:
    """For the reader, "±" is one standard error everywhere."""
    run = pfdist.open_run(finished())
    pages = page_of(run), answer_of(run, details=True), run._page()
    blocks = [block for page in pages for section in page.sections for block in section.blocks]
    columns = [
        (block.caption + block.head[place], any("±" in row[place].text for row in block.rows))
        for block in blocks
        if isinstance(block, Table)
        for place in range(len(block.head))
    ]
    assert sum(has_error for _, has_error in columns) >= 5
    assert all("± standard error" in told for told, has_error in columns if has_error)


def test_the_papers_problem_has_no_heavy_tail() -> None:
    problem = Problem("ungm", horizon=60, measurement_budget=21, particles=100)
    evaluation = pfdist.evaluate(problem, "regular", draws=1000)
    assert 10 / 1000 < evaluation.largest_share < 0.5 * HEAVY
    assert not evaluation.heavy_tail


# --- One number of measurements is a budget curve of a single number ----------------------------

EXACT = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=50"]


@pytest.fixture
def budget(small_job: Job, tmp_path: Path) -> Run:
    job = small_job.with_changes(EXACT)
    return pfdist.budget(job, (2, 4), tmp_path / "budget", draws=50, figures=False)


def test_a_run_of_one_number_has_a_curve_of_one_number(finished: Callable[..., Path]) -> None:
    run = pfdist.open_run(finished(*EXACT))
    sets, table = run.sets, run.table("sets")
    assert list(sets) == run.names
    assert all(len(measurement_times) == 4 for measurement_times in sets.values())
    assert table["kind"].tolist() == ["regular", "found", "found"]
    assert table["measurements"].tolist() == [4, 4, 4]
    check_results(run)
    least = table[table["kind"] == "found"]["expected_mse"].min()
    assert reaching(run.table("sets"), least)["found"]["measurements"] == 4
    below = reaching(run.table("sets"), least * 0.999)
    assert (below["found"]["measurements"], below["regular"]["measurements"]) == (None, None)


def check_results(run: Run) -> None:
    """Check that there is a result for each row of the curve."""
    results, table = results_of(run), run.table("sets").set_index("name")
    assert list(results) == run.names == table.index.tolist()
    for name, result in results.items():
        assert result.expected_mse == table.loc[name, "expected_mse"]
        assert (result.search_cause is not None) == (result.kind == "found")


@pytest.mark.plugins("budget")
def test_each_set_gains_over_the_reference_with_as_many_measurements(budget: Run) -> None:
    check_results(budget)
    results, gains = results_of(budget), budget.table("gains")
    assert len(budget.references) == 3
    assert gains.columns.tolist() == ["draw", *(f"gain_{name}" for name in budget.references)]
    for name, reference in budget.references.items():
        cost, other = (results[each].expected_mse for each in (name, reference))
        assert results[name].measurements == results[reference].measurements
        assert results[name].gain_of_means == pytest.approx(1 - cost / other)
    with pytest.raises(StoreError, match="times of several numbers of measurements"):
        check_one_number(budget)
