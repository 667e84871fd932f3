"""The sentences of a report say no more than the numbers support, and nothing about the machine."""

import re
from pathlib import Path

import pytest

import pfdist
from pfdist import Job
from pfdist.cli.main import main
from pfdist.common.gap_sentence import gap_sentence
from pfdist.common.percent import percent
from pfdist.common.rounding import rounded
from pfdist.reports.run_report import page_of
from pfdist.reports.sections.computed import _LOAD
from pfdist.reports.sections.searches import searches
from pfdist.reports.subject import Subject, effect

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
    assert gap_sentence(BOUND, 3, is_constrained=True).startswith(
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


def test_an_exact_gain_is_said_where_the_tables_hold_it(small_job: Job, tmp_path: Path) -> None:
    """The expected MSEs are those that `pfdist.evaluate` gives, and not the means of draws."""
    run = _run(small_job, tmp_path / "run")
    assert "exact_gain" not in run.summary()["results"]["genetic"]
    assert "This gain is an average over simulated draws" in _text(run)
    pfdist.bound(run, figures=False)
    results = run.summary()["results"]
    exact = [
        pfdist.evaluate(small_job.with_changes(EXACT), result["measurement_times"]).expected_mse
        for result in results.values()
    ]
    assert [result["exact_mse"] for result in results.values()] == pytest.approx(exact)
    assert results["genetic"]["exact_gain"] == pytest.approx(1 - exact[1] / exact[0])
    assert f"from {rounded(exact[0])} to {rounded(exact[1])}: the filter knows" in _text(run)


def test_why_tells_the_exact_errors_too(small_job: Job, tmp_path: Path) -> None:
    run = _run(small_job, tmp_path / "run")
    pfdist.why(run, figures=False)
    of_why = [result["exact_mse"] for result in run.summary()["results"].values()]
    pfdist.bound(run, figures=False)
    of_bound = [result["exact_mse"] for result in run.summary()["results"].values()]
    assert of_why == pytest.approx(of_bound)


def test_the_best_of_several_sets_is_chosen_by_exact_errors(small_job: Job, tmp_path: Path) -> None:
    random = ", ".join(f"{{method='random', name='s{k}', evaluations=1}}" for k in range(4))
    run = _run(small_job, tmp_path / "run", f"search=[{random}]", "comparison.draws=2")
    subject = Subject(run)
    costs = {name: found["search_cost"] for name, found in subject.found.items()}
    assert subject.by_error == sorted(costs, key=lambda name: costs[name])
    assert "the best of 4 sets by their expected errors, which are known exactly" in _text(run)


def test_an_estimate_without_standard_error_is_not_called_exact(
    small_job: Job, tmp_path: Path
) -> None:
    """A search by particles may see the same error in all of its draws."""
    run = _run(small_job, tmp_path / "run", "filter.engine=compiled")
    subject = Subject(run)
    for result in subject.found.values():
        result["search_standard_error"] = 0.0
    assert "exact" not in str(searches(subject))


def test_columns_without_any_value_are_left_out(small_job: Job, tmp_path: Path) -> None:
    """The searches of a range of budgets believe something of each number of measurements."""
    job = small_job.with_changes([*EXACT, "problem.horizon=6"])
    subject = Subject(pfdist.budget(job, (2, 3), tmp_path / "run", draws=20, figures=False))
    found = searches(subject)
    assert found is not None
    assert found.blocks[0].head == ["search", "method", "sets evaluated"]


@pytest.mark.parametrize(
    ("change", "is_constrained"),
    [
        pytest.param("seed=1", False, marks=pytest.mark.slow),
        ("problem.minimum_spacing=1", False),
        ("problem.minimum_spacing=2", True),
        pytest.param("problem.forbidden=[3]", True, marks=pytest.mark.slow),
        pytest.param("problem.required=[3]", True, marks=pytest.mark.slow),
    ],
)
def test_report_and_commands_say_alike_whether_constraints_exclude_times(
    small_job: Job,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    change: str,
    is_constrained: bool,
) -> None:
    run = _run(small_job, tmp_path / "run", change)
    assert main(["bound", str(run.path / "job.toml")]) == 0
    of_bound = capsys.readouterr().out
    assert main(["status", str(run.path)]) == 0
    for text in (of_bound, capsys.readouterr().out, _text(run)):
        assert ("that the constraints allow" in " ".join(text.split())) == is_constrained


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


@pytest.mark.slow
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
