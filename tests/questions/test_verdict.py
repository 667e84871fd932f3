"""The commonest mistakes: each is named with its formula, its line and what to write instead.

`check-model` and a run come to one verdict.
"""

import re
from pathlib import Path

import pytest

from pfdist import evaluate, load_model
from pfdist.errors import ModelError
from pfdist.plugins.check.model_checks import check_loaded

MODEL = """
import math
import numpy as np
import types
from pfdist import StateSpaceModel, where

MATRIX = np.array([[0.9, 0.1], [0.0, 0.8]])
TABLE = np.linspace(0.0, 1.0, 5)
RATES = types.SimpleNamespace(a=0.9)
SEEN = {0}
COUNT = 0


def halved(n, a):
    return a if n == 0 else halved(n - 1, 0.5 * a)


def initial(w, p):
    return (w[0], w[1])


def transition(x, t, w, p):
    BODY


def log_likelihood(y, x, t, p):
    LIKELIHOOD


model = StateSpaceModel(
    name="mine",
    initial=initial,
    transition=transition,
    measurement=lambda x, t, v, p: (x[0] + v[0],),
    log_likelihood=log_likelihood,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal", "normal"),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={"a": 0.9},
)
"""
LIKELIHOOD = "return -0.5 * (y[0] - x[0]) ** 2"
JOB = """
seed = 1
[model]
name = "mine.py:model"
[problem]
horizon = 8
measurement_budget = 2
[filter]
particles = 5
ENGINE
[[search]]
method = "random"
"""
WHERE = r"pfdist\.where\(condition, a, b\)"


def written(folder: Path, body: str, likelihood: str = LIKELIHOOD, engine: str = "auto") -> Path:
    lines = body.replace("; ", "\n    ")
    (folder / "mine.py").write_text(MODEL.replace("BODY", lines).replace("LIKELIHOOD", likelihood))
    job = folder / "mine.toml"
    job.write_text(JOB.replace("ENGINE", f'engine = "{engine}"'))
    return job


def refused(folder: Path, job: Path) -> list[str]:
    """The mistakes that `check-model` and `evaluate` name."""
    checks = list(check_loaded(lambda: load_model("mine.py:model", folder), 8, 5))
    with pytest.raises(ModelError) as caught:
        evaluate(job, (0, 3), draws=5)
    return [*(check.text for check in checks if check.state == "wrong"), str(caught.value)]


# A body of transition, and what `check-model` and a run say about it.
MISTAKES = {
    "if on a state": ("return (x[0] if x[0] > 0 else w[0], x[1])", WHERE),
    "a < b < c": ("return (where(0 < x[0] < 1, 0.5, w[0]), x[1])", "& and"),
    "max": ("return (max(x[0], w[0]), x[1])", r"np\.maximum"),
    "math.sin": ("return (math.sin(x[0]) + w[0], x[1])", r"write np\.sin and not"),
    "w[1] of one": ("return (x[0] + w[1], x[1])", "w has 1, and the first is"),
    "x[2] of two": ("return (x[2] + w[0], x[1])", "x has 2"),
    "a number": ("return 0.9 * x[0] + w[0]", r"even of a single component: \(a,\), got an array"),
    "no return": ("x[0] + w[0], x[1]", "is there no `return`"),
    "nested": ("return ((x[0] + w[0],), x[1])", "a tuple that contains a tuple"),
    "w for w[0]": ("return (x[0] + w, x[1])", r"w instead of w\[0\]"),
    "x.a": ("return (x.a + w[0], x[1])", r"parameters are p\.name"),
    "p.b": ("return (p.b * x[0] + w[0], x[1])", "parameters: a"),
    "x[0] = ...": ("x[0] = w[0]; return x", "give a new tuple"),
    "np.random": ("return (x[0] + np.random.normal(), w[0])", "from the noise"),
    "a float as an index": ("return (TABLE[t / 2] + w[0], x[1])", "t // 2"),
    "int of a state": ("return (TABLE[int(x[0])], w[0])", r"write value\.astype\(int\)"),
    "a table": ("return (TABLE[t] + w[0], x[1])", "index 5 is out of bounds"),
    "a name misspelt": ("return (x[0] + wind, w[0])", "'wind' is not defined"),
    "log of a negative": ("return (np.log(x[0]), w[0])", "in log"),
    "division by zero": ("return (x[0] / (t - 3), w[0])", "divide"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_refused_by_both_with_formula_line_and_remedy(
    mistake: str, tmp_path: Path
) -> None:
    body, says = MISTAKES[mistake]
    for text in refused(tmp_path, written(tmp_path, body)):
        assert re.search(says, text), text
        assert "transition" in text
        assert re.search(r"mine\.py:\d+\)$", text)
        assert "\n" not in text
        assert len(text) < 1000


def test_nan_at_the_first_instant_is_named_with_its_formula_and_line(tmp_path: Path) -> None:
    job, file = written(tmp_path, "return (x[0] + w[0], x[1])"), tmp_path / "mine.py"
    file.write_text(file.read_text().replace("(w[0], w[1])", "(np.log(w[0]), 1)"))
    says = r"got x\[0\] = nan at t = 0 from initial[:,] .*in log \(.*:1[89]\)"
    for text in refused(tmp_path, job):
        assert re.search(says, text)


def test_a_matrix_times_an_array_of_components_is_right_in_both_engines(tmp_path: Path) -> None:
    body = "return tuple(MATRIX @ np.array(x))"
    out = "return (0.9 * x[0] + 0.1 * x[1], 0.8 * x[1])"
    found = [
        evaluate(written(tmp_path, text, engine="numpy"), (0, 3), draws=20).expected_mse
        for text in (body, out)
    ]
    assert found[0] == pytest.approx(found[1], rel=1e-9)
