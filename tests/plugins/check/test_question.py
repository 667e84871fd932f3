"""Check what `pfdist check-model` finds, on models with one mistake each."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pfdist import load_model
from pfdist.plugins.check.model_checks import Check, check_loaded

RIGHT = """
import numpy as np
from pfdist import StateSpaceModel

model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (3 * w[0],),
    transition=lambda x, t, w, p: (0.9 * x[0] + w[0],),
    measurement=lambda x, t, v, p: (x[0] + np.exp(0.1 * x[0]) * v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / np.exp(0.1 * x[0])) ** 2 - 0.1 * x[0],
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
    z_names=("level",),
)
"""
LOOKS = [
    "load",
    "compile",
    "simulate",
    "log_likelihood",
    "every instant",
    "degenerate draws",
    "expected MSE",
    "effective sample size",
    "particles",
    "an evaluation",
]


def checked(
    folder: Path, change: tuple[str, str] = ("", ""), times: tuple[float, ...] = ()
) -> Iterator[Check]:
    """Give each check of a changed model when it is asked for: those behind it are not computed."""
    assert change[0] in RIGHT
    (folder / "mine.py").write_text(RIGHT.replace(*change, 1))
    return check_loaded(lambda: load_model("mine.py:model", folder), 12, 50, times)


def checks_of(
    folder: Path, change: tuple[str, str] = ("", ""), times: tuple[float, ...] = ()
) -> dict[str, Check]:
    return {check.name: check for check in checked(folder, change, times)}


def test_a_model_without_a_name_of_z_hears_how_to_name_it(tmp_path: Path) -> None:
    names = checks_of(tmp_path, ('    z_names=("level",),\n', ""))["names"]
    assert (names.state, names.text.count('z_names=("')) == ("note", 1)


def test_a_right_model_passes_every_look(tmp_path: Path) -> None:
    checks = checks_of(tmp_path)
    assert list(checks) == LOOKS
    assert {check.state for check in checks.values()} == {"ok"}


LIKELIHOOD = "-0.5 * ((y[0] - x[0]) / np.exp(0.1 * x[0])) ** 2 - 0.1 * x[0]"
QUADRATIC, TERM = "-0.5 * ((y[0] - x[0])", " - 0.1 * x[0]"
NARROW = LIKELIHOOD.replace("np.exp(0.1 * x[0])", "(0.9 * np.exp(0.1 * x[0]))")
WINDOW = "np.log(np.abs(y[0] - x[0]) < 9 * np.exp(0.1 * x[0]))"
QUANTITY = "(x[0],),\n    initial_noise"
# A piece of RIGHT, what stands there instead, and what the check of a name says. Those for which
# particles are filtered, or that are compiled to be looked at, take seconds.
MISTAKES = [
    ("0.9 * x[0]", "np.piecewise(x[0], [x[0] > 0], [1, 2])", "load", "wrong",
     r"cannot be traced at t = 0: np\.piecewise of a value of particles.*mine\.py:\d+"),
    (TERM, "", "log_likelihood", "wrong", "a term left out that depends on x"),
]  # fmt: skip
SLOW_MISTAKES = [
    (LIKELIHOOD, NARROW, "log_likelihood", "wrong",
     r"come from the more likely state, where .* implies \d+,\d+ ± \d+ "),
    (QUADRATIC, f"np.log(9 - y[0]) {QUADRATIC}", "log_likelihood", "wrong",
     r"must be finite .* got NaN or infinity for \d+\.\d+% of y"),
    (LIKELIHOOD, WINDOW, "log_likelihood", "wrong", "come from the second state"),
    (LIKELIHOOD, "0 * y[0]", "log_likelihood", "note", "does not depend on x"),
    (QUADRATIC, f"np.log(y[0] < 1.0) {QUADRATIC}", "degenerate draws", "note", "% of draws"),
    (QUANTITY, f"(1e200 * {QUANTITY[1:]}", "expected MSE", "wrong", "must be finite"),
    (QUANTITY, f"(1e80 * {QUANTITY[1:]}", "expected MSE", "wrong",
     r"must be finite, and its error, got \d.*e\+1\d\d ± inf"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "look", "state", "says"),
    [*MISTAKES, *(pytest.param(*row, marks=pytest.mark.slow) for row in SLOW_MISTAKES)],
)
def test_a_mistake_is_found(
    old: str, new: str, look: str, state: str, says: str, tmp_path: Path
) -> None:
    check = next(check for check in checked(tmp_path, (old, new)) if check.name == look)
    assert check.state == state, check
    assert re.search(says, check.text), check.text
    assert "\n" not in check.text


READS_CLOCK = ("0.9 * x[0] + w[0]", "np.exp(-p.dt[t]) * x[0] + w[0]")


@pytest.mark.slow
def test_a_model_that_reads_a_clock_gets_one_and_the_note_says_so(tmp_path: Path) -> None:
    checks = checks_of(tmp_path, READS_CLOCK)
    assert checks["clock"].state == "note"
    assert checks["clock"].text.startswith("p.time is 0 to 12 in 13 instants, assumed because")
    assert {check.state for name, check in checks.items() if name != "clock"} == {"ok"}
    assert list(checks) == [*LOOKS[:1], "clock", *LOOKS[1:]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("times", "state"), [((0, 0.25, 0.75), "ok"), ((0, 0.25, 0.8), "wrong"), ((), "wrong")]
)
def test_a_given_clock_is_used(times: tuple[float, ...], state: str, tmp_path: Path) -> None:
    change = (READS_CLOCK[0], "np.sqrt(0.5 - p.dt[t]) * x[0] + w[0]")
    assert checks_of(tmp_path, change, times)["simulate"].state == state


def test_a_parameter_with_the_name_of_the_clocks_is_wrong(tmp_path: Path) -> None:
    change = ('name="mine",', 'name="mine", parameters={"dt": 0.5},')
    check = checks_of(tmp_path, change, (0.0, 1.0))["clock"]
    assert check.state == "wrong"
    assert "no parameter may have the name 'dt'" in check.text


def test_no_such_model(tmp_path: Path) -> None:
    (check,) = check_loaded(lambda: load_model("mine.py:model", tmp_path), 60, 500)
    assert (check.name, check.state) == ("load", "wrong")


def test_a_long_formula_that_is_compiled_in_pieces_is_named() -> None:
    walk = load_model("random_walk")

    def transition(x: Any, t: Any, w: Any, p: Any) -> Any:
        a = x[0]
        for _ in range(200):
            a = 0.5 * a + 0.1
        return (a + w[0],)

    long = replace(walk, transition=transition, linear_gaussian=False)
    for model, says in ((walk, ""), (long, "; transition has 401 operations and is compiled in p")):
        checks = check_loaded(lambda: model, 3, 10)  # noqa: B023
        text = next(check.text for check in checks if check.name == "compile")
        assert text.removesuffix("ieces") == f"every formula is traced and compiled{says}"
