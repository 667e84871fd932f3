"""A model that moves the process to another folder moves no file of a question, and no message."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pfdist
from oracles.model_text import MEASURED

MODEL = (
    """
import os

import pfdist

{at_import}

def transition(x, t, w, p):
    {in_formula}
    return (0.9 * x[0] + w[0],)

model = pfdist.StateSpaceModel(
    name="wanderer",
    initial=lambda w, p: (w[0],),
    transition=transition,
"""
    + MEASURED
    + ")\n"
)
JOB = """
seed = 1
[problem]
horizon = 12
measurement_budget = 4
[filter]
{engine}
particles = 40
[evaluation]
draws = 10
[[search]]
method = "random"
evaluations = 1
[execution]
pool = "serial"
[model]
name = "mine.py:model"
[model.filter]
name = "believed.py:model"
"""
SMALL = "comparison.draws=60"


@pytest.fixture(params=["at import", pytest.param("in a formula", marks=pytest.mark.slow)])
def start(request: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder where a command starts; its model moves to another one."""
    away, folder = tmp_path / "away", tmp_path / "start"
    away.mkdir()
    (folder / "jobs").mkdir(parents=True)
    moves = f"os.chdir({str(away)!r})"
    at_import, in_formula = (moves, "") if request.param == "at import" else ("", moves)
    text = MODEL.format(at_import=at_import, in_formula=in_formula)
    (folder / "jobs" / "mine.py").write_text(text)
    believed = text.replace("wanderer", "believed")
    (folder / "jobs" / "believed.py").write_text(believed)
    engine = "" if request.param == "at import" else 'engine = "numpy"'
    (folder / "jobs" / "a.toml").write_text(JOB.format(engine=engine))
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.plugins("filter", "sweep", "why")
@pytest.mark.usefixtures("undrawn")
@pytest.mark.filterwarnings("ignore::pfdist.errors.EngineWarning")
def test_nothing_moves_with_a_model(start: Path, call: Callable[..., Any]) -> None:
    def said(line: str, code: int = 0) -> str:
        os.chdir(start)
        called = call(line)
        assert Path.cwd() != start, "the model has moved"
        assert called.code == code, called.err
        assert str(start) not in called.out + called.err
        assert not any((start.parent / "away").iterdir())
        return str(called.out + called.err)

    assert "report: results/a/report.html" in said(f"run jobs/a.toml --set {SMALL}")
    assert (start / "results/a/report.html").exists()
    assert str(start) not in (start / "results/a/report.html").read_text()
    (start / "rows.csv").write_text("t,y0\n0,1\n3,0.5\n")
    (start / "prior.csv").write_text("x0\n0.1\n0.2\n0.3\n")
    line = f"filter jobs/a.toml rows.csv --prior prior.csv --out out --no-report --set {SMALL}"
    assert "out/rows.filtered.csv" in said(line)
    assert "results/a/figures (why-" in said(f"why jobs/a.toml --draws 40 --set {SMALL}")
    sweep = f"sweep jobs/a.toml --over seed=1 --set {SMALL} --pool serial --no-report"
    assert "\nresults/a-sweep/points.csv\n" in said(sweep)
    os.chdir(start)
    run = pfdist.run("jobs/a.toml", changes=[SMALL], figures=False)  # in Python
    assert Path.cwd() != start
    assert run.path == start / "results/a"


def test_a_working_folder_that_was_removed_is_a_line(
    tmp_path: Path, call: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path.joinpath("gone").mkdir() or tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    called = call("list")
    assert called.code == 1
    assert called.err == (
        "pfdist: the working folder cannot be read (No such file or directory): change into "
        "another\n"
    )
