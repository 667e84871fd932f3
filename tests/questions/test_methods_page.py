"""The methods paragraph of a run has the numbers of its tables."""

from collections.abc import Callable
from pathlib import Path

import pytest

import pfdist
from pfdist.common.rounding import rounded
from pfdist.pages.terminal import lines_of
from pfdist.questions.run_page import answer_of, page_of
from pfdist.results.stored_run import evaluations_of
from pfdist.store import run_key


def _paragraph(run: pfdist.Run) -> str:
    text = " ".join(" ".join(lines_of(answer_of(run, details=True))).split())
    _, _, paragraph = text.partition("We looked for ")
    return paragraph.replace("\xa0", " ")


def test_the_paragraph_has_the_numbers_of_the_run_and_its_proof(
    small_job: pfdist.Job, tmp_path: Path
) -> None:
    run = pfdist.plan(small_job, tmp_path / "run", figures=False)
    told, best = _paragraph(run), run.best
    assert told.startswith("the measurement times that give the lowest expected MSE of state with")
    for words in (
        f"pfdist {pfdist.__version__} (Aspeel et al., ICIP 2020, doi:10.1109/",
        f"run {run_key(run.path)[:12]}, seed {run.job['seed']})",
        f"at {run.job['problem']['horizon'] + 1} instants",
        f"a bootstrap particle filter with {run.job['filter']['particles']} particles.",
        f"The search (relaxation) estimated {evaluations_of(run):,} errors of sets.",
        f"{run.draws_compared} simulated systems that took no part in the search.",
        f"at t = {', '.join(map(str, best.measurement_times))}.",
        f"{rounded(100 * best.gain_of_means, 3)} % lower (95 % CI ",
        "Proved: no other 4 times lower the expected MSE by more than",
        "all numbers hold as far as the model is right.",
    ):
        assert words in told
    report = " ".join(str(page_of(run)).split())
    assert "A methods paragraph" in report
    assert told.split(". ")[1] in report


@pytest.mark.plugins("guided")
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["filter.proposal=guided"], "a guided particle filter with 40 particles"),
        (["model.name=linear_gaussian", "filter.engine=kalman"], "the Kalman filter, whose errors"),
        (["model.filter.parameters={process_sd=2}"], "whose model differs from that of the truth"),
    ],
)
def test_the_paragraph_names_the_filter_and_that_nothing_is_proved(
    changes: list[str], words: str, finished: Callable[..., Path]
) -> None:
    told = _paragraph(pfdist.open_run(finished(*changes)))
    assert words in told
    assert "Nothing was proved about other times." in told
