"""Progress and messages in Python: in a terminal, in a notebook, or by a function of one's own."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import pfdist
from pfdist import Job

FEW = ("search=[{method='random', evaluations=3}]", "comparison.draws=20")


def test_progress_is_silent_unless_it_is_wanted(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = small_job.with_changes(FEW)
    pfdist.run(job, tmp_path / "run", figures=False)
    assert capsys.readouterr() == ("", "")
    pfdist.run(job, tmp_path / "other", figures=False, progress=True)
    out, err = capsys.readouterr()
    assert out == ""
    assert "1 worker in " in err
    assert "100.0 %  comparison" in err


def test_a_function_receives_the_progress_and_another_the_messages(
    small_job: Job, tmp_path: Path
) -> None:
    seen, said = list[Any](), list[str]()
    job = small_job.with_changes(FEW)
    run = pfdist.run(job, tmp_path / "run", figures=False, progress=seen.append, say=said.append)
    assert seen[-1].done == seen[-1].total > 0
    assert len(said) == 1
    pfdist.why(run, 5, figures=False, progress=seen.append)
    assert seen[-1].phase == "why random"


def test_a_notebook_has_one_line_below_its_cell_which_goes_in_the_end(
    small_job: Job,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
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
    pfdist.run(small_job.with_changes(FEW), tmp_path / "run", figures=False, progress=True)
    assert shown[0] == shown[-1] == ""
    assert shown[-2].startswith("<code>100.0 %  comparison")
    assert "100.0 %" not in capsys.readouterr().err
