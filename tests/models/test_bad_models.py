"""Models that read what is not theirs or compute what is no number: refused with their line."""

import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from pfdist import evaluate, load_model
from pfdist.errors import ModelError
from pfdist.plugins.check.model_checks import check_loaded

MODEL = """
import numpy as np
from pfdist import StateSpaceModel

TABLE = np.array([1.0, 2.0, 3.0])


def look_up(k):
    return TABLE[k]  # HELPER


def picky(t):
    if t > 5:
        raise ValueError("no such instant")  # RAISED
    return 0.0


def transition(x, t, w, p):
    return (0.5 * x[0] + w[0] + TRANSITION,)  # HERE


def log_likelihood(y, x, t, p):
    return -0.5 * (y[0] - x[0]) ** 2 + LIKELIHOOD  # THERE


model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (w[0],),
    transition=transition,
    measurement=lambda x, t, v, p: (x[0] + v[0],),
    log_likelihood=log_likelihood,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
)
"""
JOB = """
seed = 1
[model]
name = "mine.py:model"
[problem]
horizon = 12
measurement_budget = 4
[[search]]
method = "random"
"""
EVERY_TIME = range(13)
BAD = {
    "a table too short": ("transition", "TABLE[t]", "IndexError", "HERE"),
    "in a helper": ("transition", "look_up(t)", "IndexError", "HELPER"),
    "by zero": ("transition", "1 // (t - 3)", "ZeroDivisionError", "HERE"),
    "an error of its own": ("transition", "picky(t)", "ValueError", "RAISED"),
    "only where it is measured": ("log_likelihood", "1 % (t - 5)", "ZeroDivisionError", "THERE"),
}


def written(folder: Path, formula: str, term: str) -> str:
    terms = {"transition": "0.0", "log_likelihood": "0.0"} | {formula: term}
    text = MODEL.replace("TRANSITION", terms["transition"])
    text = text.replace("LIKELIHOOD", terms["log_likelihood"])
    (folder / "mine.py").write_text(text)
    (folder / "mine.toml").write_text(JOB)
    return text


def evaluated(folder: Path, engine: str, times: Iterable[int]) -> float:
    job = folder / f"{engine}.toml"
    job.write_text(f'{JOB}[filter]\nengine = "{engine}"\nparticles = 20\n')
    return evaluate(job, times, draws=20).expected_mse


def wrong_checks(folder: Path) -> list[str]:
    checks = check_loaded(lambda: load_model("mine.py:model", folder), 12, 20)
    return [check.text for check in checks if check.state == "wrong"]


@pytest.mark.parametrize("case", BAD)
def test_a_bad_formula_is_refused_with_its_line_whatever_computes_it(
    case: str, tmp_path: Path
) -> None:
    formula, term, kind, mark = BAD[case]
    text = written(tmp_path, formula, term)
    (line,) = (i for i, row in enumerate(text.splitlines(), 1) if row.endswith(f"# {mark}"))
    message = rf"^model mine: {formula} failed: {kind}: [^\n]*mine\.py:{line}\)$"
    for engine in ("compiled", "numpy"):
        with pytest.raises(ModelError, match=message):
            evaluated(tmp_path, engine, EVERY_TIME)
    assert any(re.search(message, text) for text in wrong_checks(tmp_path))


def test_an_index_far_outside_ends_in_a_line_and_not_in_the_process(tmp_path: Path) -> None:
    written(tmp_path, "transition", "TABLE[(t // 3) * 10**12]")
    code = f"import pfdist; pfdist.evaluate({str(tmp_path / 'mine.toml')!r}, (0, 3), draws=20)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done  # and not -11, a signal's
    last = done.stderr.splitlines()[-1]
    assert "index 1000000000000 is out of bounds for axis 0 with size 3 at t = 3" in last
