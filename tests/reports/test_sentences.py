"""The sentences of a report say no more than the numbers support, and nothing about the machine."""

import json
import re
from pathlib import Path

import pytest

import pfdist
from pfdist import Job
from pfdist.common.gap_sentence import gap_sentence
from pfdist.common.percent import percent
from pfdist.reports.run_report import page_of
from pfdist.reports.sections.computed import _LOAD
from pfdist.reports.subject import effect

EXACT = ("model.name=random_walk", "filter.engine=kalman", "comparison.draws=30")
SEARCH = "search=[{method='genetic', generations=1}]"
EXHAUSTIVE = ("problem.horizon=1", "problem.measurement_budget=2", "search=[{method='exhaustive'}]")
BOUND = {"budget": 4, "bound_error": 0.0, "gap": 0.1, "gap_at_most": 0.1, "confidence": 0.95}


def _text(run: pfdist.Run) -> str:
    return str(page_of(run))


def _run(job: Job, path: Path, *changes: str) -> pfdist.Run:
    return pfdist.run(job.with_changes([*EXACT, SEARCH, *changes]), path, figures=False)


def test_a_gain_whose_interval_contains_0_is_left_open() -> None:
    assert effect(0.05, [0.01, 0.09])[1] == effect(-0.05, [-0.09, -0.01])[1] == ""
    told, left_open = effect(-0.05, [-0.09, 0.01])
    assert told == "raises the expected error by 5.0 % (95 %: -1.0 to 9.0 %)"
    assert "do not tell which times are better" in left_open


def test_an_unknown_interval_is_no_interval() -> None:
    told, left_open = effect(0.2, [None, None])
    assert told == "lowers the expected error by 20.0 %"
    assert "too few draws" in left_open


def test_a_gap_of_rounding_errors_is_no_gap() -> None:
    none = gap_sentence(BOUND | {"gap": 1e-16}, 4)
    assert none == "No other 4 times have a lower expected error."
    assert percent(-1e-17) == "0.00 %"


def test_a_bound_for_money_is_not_said_of_a_number_of_times() -> None:
    assert gap_sentence(BOUND, 3, constrained=True).startswith(
        "No other times that cost no more and that the constraints allow can lower"
    )


def test_the_reference_itself_is_no_gain(small_job: Job, tmp_path: Path) -> None:
    run = _run(small_job, tmp_path / "run", *EXHAUSTIVE)
    assert "found no better times than the reference's own" in _text(run)


def test_two_draws_give_no_interval(small_job: Job, tmp_path: Path) -> None:
    text = _text(_run(small_job, tmp_path / "run", "comparison.draws=2"))
    assert "unknown to unknown" not in text
    assert "too few draws" in text


def test_exact_costs_are_not_called_too_good(small_job: Job, tmp_path: Path) -> None:
    text = _text(_run(small_job, tmp_path / "run"))
    assert "The filter is exact" in text
    assert "its draws chose the set" not in text


def test_the_best_of_online_and_plan_is_named(small_job: Job, tmp_path: Path) -> None:
    job = small_job.with_changes([*EXACT, SEARCH])
    text = _text(pfdist.online(job, tmp_path / "run", draws=5, figures=False))
    assert re.search(r"is known (lowers|raises) the expected error .*the times of genetic", text)


def test_a_report_names_no_folder_of_the_machine(small_job: Job, tmp_path: Path) -> None:
    file = tmp_path / "secret" / "walk.py"
    file.parent.mkdir()
    file.write_text("from pfdist import load_model\nmodel = load_model('random_walk')\n")
    run = _run(small_job, tmp_path / "run", f"model.name={file}:model")
    assert str(tmp_path) not in _text(run)
    assert "When to measure: walk.py:model" in _text(run)


@pytest.mark.parametrize("section", [None, ["a"]])
def test_a_damaged_provenance_is_unknown(small_job: Job, tmp_path: Path, section: object) -> None:
    run = _run(small_job, tmp_path / "run")
    about = json.loads((run.path / "run.json").read_text())
    about["provenance"]["libraries"] = section
    (run.path / "run.json").write_text(json.dumps(about))
    assert "How it was computed" in _text(pfdist.open_run(run.path))


def test_a_run_with_quotes_in_its_name_is_loaded_as_the_report_says(
    small_job: Job, tmp_path: Path
) -> None:
    run = _run(small_job, tmp_path / 'a "run" \U0001f600')
    (code,) = (
        block.text
        for section in page_of(run).sections
        for block in section.blocks
        if block.kind == "code" and block.text.startswith(_LOAD[:13])
    )
    compile(code, "report", "exec")
    assert '"a \\"run\\" \U0001f600"' in code


@pytest.mark.filterwarnings("error::UserWarning")
def test_long_names_of_many_searches_leave_room_for_the_curves(
    small_job: Job, tmp_path: Path
) -> None:
    """Matplotlib warns if a legend leaves no room."""
    names = [f"{'long' * 9}_{number}" for number in range(5)]
    searches = ", ".join(f"{{method='random', name='{name}', evaluations=2}}" for name in names)
    run = _run(small_job, tmp_path / "run", f"search=[{searches}]")
    text = _text(run)
    assert re.search(r"Found times share \d to \d of their instants with regular times", text)
