"""Most filters fail: there is no plan. Some fail, or a likelihood is wrong: it is said first."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.systems import one_state
from pfdist import Problem
from pfdist.common.parts import Page
from pfdist.common.percent import CHECK_FAILS, RANKS_FAIL
from pfdist.common.shown import as_fragment
from pfdist.errors import SearchError
from pfdist.filters.estimate import Evaluation
from pfdist.pages.html import as_html
from pfdist.pages.terminal import lines_of
from pfdist.questions import run_page, subject
from pfdist.questions.evaluate import Evaluated
from pfdist.questions.run_page import answer_of, page_of
from pfdist.results import stored_run
from pfdist.runner import comparison_phase

EXACT = one_state(
    "a sensor of deviation 0",
    initial=lambda w, p: (2.0 * w[0],),
    transition=lambda x, t, w, p: (x[0] + 0.4 * w[0],),
    measurement=lambda x, t, v, p: (x[0] + p.sd * v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / p.sd) ** 2,
    parameters={"sd": 0.0},
    linear_gaussian=True,
)
PROBLEM = Problem(EXACT, horizon=4, measurement_budget=2, particles=20, engine="numpy")


def test_there_is_no_plan_if_most_draws_are_degenerate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No particle has the likelihood of a measurement without noise: all draws are degenerate."""
    monkeypatch.setattr(comparison_phase, "BLOCK", 20)  # after so many draws it is known
    named = "check-model .* 'kalman' .* 'continue'"
    changes = ["comparison.draws=400", "search.relaxation.evaluation.draws=20"]
    path = tmp_path / "run"
    with pytest.raises(SearchError, match=f"no plan, because .* of .* degenerate .* {named}"):
        pfdist.plan(PROBLEM, path, changes=changes, pool="serial", figures=False, bound_draws=0)
    compared = pfdist.open_run(path).draws_compared
    assert 20 <= compared < 400
    with pytest.raises(SearchError, match="no plan"):  # at once: the draws are there
        pfdist.plan(PROBLEM, path, changes=changes, pool="serial", figures=False, bound_draws=0)
    assert pfdist.open_run(path).draws_compared == compared


def test_a_job_may_continue_and_its_answer_says_first_that_draws_are_degenerate(
    tmp_path: Path,
) -> None:
    searching = [{"method": "random", "evaluations": 3}]
    continuing = {"degenerate_draws": "continue"}
    job = PROBLEM.job(search=searching, comparison={"draws": 20}, evaluation=continuing)
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    assert _first(answer_of(run)).startswith("With the plan, 20 of 20 draws are degenerate: ")


def _first(page: Page) -> str:
    """The first paragraph in a terminal."""
    paragraph, *_ = "\n".join(lines_of(page)).strip().split("\n\n")
    return " ".join(paragraph.split())


def _flagged(share: float) -> Callable[[Any], Iterator[tuple[Any, ...]]]:
    """Per-draw errors of a run, of which this share of the draws is degenerate with each set."""
    errors_of = stored_run.errors_of

    def flagged(run: Any) -> Iterator[tuple[Any, ...]]:
        for errors, degenerate, *others in errors_of(run):
            degenerate[: round(share * len(errors))] = True
            yield (errors, degenerate, *others)

    return flagged


@pytest.mark.parametrize(("share", "is_first"), [(0.008, False), (0.012, True)])
def test_from_1_percent_on_degenerate_draws_are_said_first(
    share: float, is_first: bool, finished: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = pfdist.open_run(finished())
    monkeypatch.setattr(stored_run, "errors_of", _flagged(share))
    monkeypatch.setattr("pfdist.results.sets.summary_of", lambda run: None)
    said = f"{round(share * 250)} of 250 draws are degenerate: the filter leaves out measurements"
    assert (said in _first(answer_of(run))) == is_first
    main = as_html(page_of(run)).partition("<main>")[2].split()
    assert (main[:4] == ["<p", 'class="warning"', 'role="note">With', "the"]) == is_first
    assert "Degenerate: " in " ".join(lines_of(answer_of(run)))  # each set, below the table
    flags = np.arange(250) < share * 250
    alone = {"": Evaluation((0,), np.ones(250), degenerate=flags)}
    problem = pfdist.load_job(run.path).problem
    evaluated = Evaluated(alone, {}, problem, {"": []}, [], 0, None)
    assert _first(evaluated._page()).startswith(said if is_first else "Expected MSE 1")
    assert as_fragment(evaluated._page()).startswith(f"<p>{said}" if is_first else "<p>Expected")
    assert " ".join(lines_of(evaluated._page())).replace("\n", " ").count("degenerate") == 1


@pytest.mark.parametrize("reason", [CHECK_FAILS, RANKS_FAIL])
def test_a_wrong_likelihood_is_said_first(
    reason: str, finished: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = pfdist.open_run(finished())
    said = f"Not proved for the random plan: {reason}: it is."
    for module in (subject, run_page):
        monkeypatch.setattr(module, "unproved", lambda _: said)
    assert _first(answer_of(run)) == said
    assert " ".join(" ".join(lines_of(answer_of(run))).split()).count(said) == 1
    for module in (subject, run_page):
        monkeypatch.setattr(module, "unproved", lambda _: "Not proved: it takes long.")
    assert _first(answer_of(run)).startswith("Measure at")
    assert lines_of(answer_of(run))[-3] == "Note: Not proved: it takes long."
