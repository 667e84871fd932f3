"""At a prompt and in a notebook: results as cards, progress in a line, messages to a function."""

import shutil
import sys
from collections.abc import Callable
from html import escape
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import pfdist
from pfdist import Job
from pfdist.questions.display import Display
from pfdist.questions.options import following
from pfdist.runner.progress import silent

FEW = ["search=[{method='random', evaluations=3}]", "comparison.draws=20"]


@pytest.fixture
def job(small_job: Job) -> Job:
    return small_job.with_changes(FEW)


@pytest.mark.plugins("why")
def test_each_result_is_a_line_at_a_prompt_and_a_table_in_a_notebook(
    finished: Callable[..., Path], tmp_path: Path
) -> None:
    exact = finished(*FEW, "model.name=random_walk", "filter.engine=kalman")
    job = shutil.copytree(exact, tmp_path / "<b>run") / "job.toml"
    run = pfdist.open_run(job.parent)
    results = {
        "Measure at t = ": run,
        "evaluation": pfdist.evaluate(job, [0, 4, 8], draws=20),
        # Few draws were searched, so the regular times are better, and are recommended.
        "For regular times: Proved: no other": pfdist.bound(job, figures=False),
        "Most important measurement": pfdist.why(job, figures=False),
    }
    for begins, result in results.items():
        line, table = repr(result), result._repr_html_()
        assert line.startswith(f"<{begins}")
        assert len(line.splitlines()) == 1
        assert ("<table>" in table) == (result is not run)  # its sentences say it
        assert "<b>" not in table
    page = run._repr_html_()
    assert "<svg" in page  # one picture: the system
    assert page.count("<svg") == 1
    assert "Proved: no other 4 times" in page
    assert f"{escape(str(run.path))}: finished, " in page


def test_a_run_that_cannot_be_read_has_a_card_that_says_so(small_run: pfdist.Run) -> None:
    for file in (small_run.path / "tables" / "comparison").iterdir():
        file.write_bytes(b"damaged")
    assert repr(small_run) == f"<run {small_run.path}: cannot be read>"
    assert "cannot be read" in small_run._repr_html_()


def test_a_run_whose_picture_cannot_be_drawn_still_has_an_answer(small_run: pfdist.Run) -> None:
    shutil.rmtree(small_run.path / "tables" / "trajectories")
    page = small_run._repr_html_()
    assert "Measure at t = " in page
    assert "<svg" not in page


def test_progress_is_silent_unless_it_is_wanted(
    job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pfdist.run(job, tmp_path / "run", figures=False)
    assert capsys.readouterr() == ("", "")
    pfdist.run(job, tmp_path / "other", figures=False, progress=True)
    out, err = capsys.readouterr()
    assert out == ""
    assert "100.0 %  comparison" in err


@pytest.mark.parametrize("watched", [False, True])
def test_by_default_a_terminal_shows_the_progress(
    watched: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: watched, raising=False)
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    with following(None, silent) as (show, say):
        assert isinstance(getattr(show, "__self__", None), Display) is watched
        assert say is silent  # lines about results become warnings, and no others are printed


@pytest.mark.plugins("why")
def test_a_function_receives_the_progress_and_another_the_messages(
    job: Job, tmp_path: Path
) -> None:
    seen, said = list[Any](), list[str]()
    run = pfdist.run(job, tmp_path / "run", figures=False, progress=seen.append, say=said.append)
    assert seen[-1].done == seen[-1].total > 0
    assert len(said) == 1
    pfdist.why(run, 5, figures=False, progress=seen.append)
    assert seen[-1].phase == "why random"


def test_a_notebook_has_one_line_below_its_cell_which_goes_in_the_end(
    job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """IPython is played: a shell with a kernel, and a display whose handle is updated."""
    shown = list[str]()

    def display(line: Any, display_id: bool) -> SimpleNamespace:
        assert display_id
        shown.append(line._repr_html_())
        return SimpleNamespace(update=lambda line: shown.append(line._repr_html_()))

    notebook, of_display = ModuleType("IPython"), ModuleType("IPython.display")
    notebook.get_ipython = lambda: SimpleNamespace(kernel=True)  # type: ignore[attr-defined]
    of_display.display = display  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", notebook)
    monkeypatch.setitem(sys.modules, "IPython.display", of_display)
    pfdist.run(job, tmp_path / "run", figures=False, progress=True)
    assert shown[0] == shown[-1] == ""
    assert shown[-2].startswith("<code>100.0 %  comparison")
    assert "100.0 %" not in capsys.readouterr().err
