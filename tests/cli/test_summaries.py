"""Tables, lists and budgets are printed in 80 columns; JSON has all of them."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pandas as pd
import pytest

import pfdist
from oracles.listed import forget
from oracles.results_of import results_of
from pfdist.common.parts import Table, Text
from pfdist.common.rounding import with_error
from pfdist.pages.terminal import COLUMNS, lines_of, lines_of_blocks
from pfdist.questions.budget_page import budget
from pfdist.questions.runs import list_page, table_page
from pfdist.results import columns

Printed = Callable[..., str]


@pytest.fixture(scope="module")
def runs(finished: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    other = ("model.parameters.process_sd=3", "filter.engine=numpy", "search.random.evaluations=3")
    shutil.copytree(finished(), folder / "a")
    shutil.copytree(finished("seed=2", "problem.measurement_budget=5"), folder / "b")
    shutil.copytree(finished(*other), folder / "c")
    return folder


@pytest.fixture
def printed(call: Callable[..., Any]) -> Printed:
    """Give what a command prints that says nothing else."""

    def called(line: str, *words: object) -> str:
        code, out, error = call(line, *words)
        assert (code, error) == (0, "")
        return out

    return called


def test_a_table_shows_keys_errors_gains_and_seconds(runs: Path, printed: Printed) -> None:
    lines = printed("table", runs / "a", runs / "b").splitlines()
    assert max(map(len, lines)) <= COLUMNS
    words = lines[0].split() + lines[1].split()
    assert {"run", "seed", "measurement_budget", "set", "gain", "seconds"} <= set(words)
    summary = results_of(pfdist.open_run(runs / "b"))["random"]
    row = next(line for line in lines if line.startswith("b ") and "random" in line)
    assert with_error(summary.expected_mse, summary.standard_error) in row
    assert row.split()[:3] == ["b", "2", "5"]
    assert lines[-1] == (
        "±: one standard error; gain %: how far the MSE is below that of regular (95 %)"
    )


def test_a_table_that_does_not_fit_names_what_it_leaves_out(runs: Path, printed: Printed) -> None:
    lines = printed("table", runs).splitlines()
    assert max(map(len, lines)) <= COLUMNS
    (told,) = [number for number, line in enumerate(lines) if line.startswith("Left out: ")]
    assert "process_sd" in " ".join(lines[told:])  # which two of the jobs lack


def test_a_table_without_rows_says_nothing() -> None:
    assert lines_of_blocks([Table("Rise of the error", ("t", "if removed"), [])]) == []


def test_json_has_every_column(runs: Path, printed: Printed) -> None:
    answer = json.loads(printed("table", runs, "--json"))
    assert set(answer) == {"rows"}
    frame = pfdist.table(runs)
    assert list(answer["rows"][0]) == frame.columns.tolist()
    for row, expected in zip(answer["rows"], frame.to_dict("records"), strict=True):
        for key, value in row.items():
            if value is None:
                assert pd.isna(expected[key])
            else:
                assert (tuple(value) if isinstance(value, list) else value) == expected[key]


@pytest.mark.slow
def test_the_unit_of_the_clock_is_in_the_json_and_in_the_heads(
    finished: Callable[..., Path], tmp_path: Path, printed: Printed
) -> None:
    run = finished("problem.time_step=0.5", 'problem.time_unit="h"')
    answer = json.loads(printed("table", run, "--json"))
    assert answer["time_unit"] == "h"
    assert all(2 * time == int(2 * time) for time in answer["rows"][0]["measurement_times"])
    out = tmp_path / "t.tex"
    assert printed("table", run, "--out", out) == f"{out}\n"
    assert "measurement times [h]" in out.read_text()


def test_a_list_shows_state_age_size_and_gain(runs: Path, tmp_path: Path, printed: Printed) -> None:
    for name in ("a", "b", "c"):
        shutil.copytree(runs / name, tmp_path / name)
    (tmp_path / "a" / "run.json").write_text("{}")
    forget(tmp_path / "b", "comparison")
    folder, _, head, bad, unfinished, good = printed("list", tmp_path).splitlines()
    assert folder == str(tmp_path)
    assert head.split() == ["run", "state", "age", "size", "found"]
    assert max(map(len, (bad, unfinished, good))) <= COLUMNS
    assert "damaged" in bad
    assert "run.json is damaged" in bad
    assert unfinished.split()[:2] == ["b", "unfinished"]
    assert unfinished.endswith("0 of 250 draws")
    assert " % below regular" in good or " % above regular" in good
    answer = json.loads(printed("list", tmp_path, "--json"))
    assert [row["state"] for row in answer["runs"]] == ["damaged", "unfinished", "finished"]
    assert answer["runs"][1]["gain_of_means"] is None


def test_the_list_of_no_runs_says_so(tmp_path: Path, printed: Printed) -> None:
    assert printed("list", tmp_path) == f"{tmp_path}: no runs\n"


@pytest.mark.parametrize("name", ["a\nb", "\x1b[2J", "x" * 200])
def test_a_name_cannot_spoil_the_terminal(name: str, runs: Path, tmp_path: Path) -> None:
    shutil.copytree(runs / "a", tmp_path / name)
    pages = list_page(pfdist.list_runs(tmp_path), "results"), table_page(pfdist.table(tmp_path))
    lines = [line for page in pages for line in lines_of(page)]
    assert all(line.isprintable() for line in lines)


_NOTHING = dict.fromkeys(columns.COLUMNS)


class Budget:
    """A run of 16 measurements, as a chapter sees it."""

    is_compared = True

    def __init__(self, scale: float = 1.0, reached: Any = None, **changes: Any) -> None:
        self.rows = {
            f"{kind}_16": SimpleNamespace(
                **_NOTHING
                | {
                    "name": f"{kind}_16",
                    "kind": kind,
                    "measurement_times": [*range(16)],
                    "measurements": 16,
                    "expected_mse": scale * mse,
                    "expected_mse_low": scale * (mse - 2 * error),
                    "expected_mse_high": scale * (mse + 2 * error),
                }
            )
            for kind, mse, error in (("regular", 34.207, 0.195), ("found", 25.846, 0.187))
        }
        vars(self.rows["found_16"]).update(changes)
        self.target = None if reached is None else 25.0
        nobody = {"measurements": None, "impossible": None}
        answers = {"found": nobody if reached is None else reached}
        self.reaching = lambda target: answers
        self.run = SimpleNamespace(tables=())

    unit = ""

    def listed(self, times: list[int]) -> str:
        return str(times)

    @property
    def lines(self) -> list[str]:
        return lines_of_blocks(budget(cast("Any", self)).blocks)


def test_the_table_of_a_budget_has_the_bound_and_the_limit_holds_as_it_is_printed() -> None:
    bound = {"bound": 25.4371, "bound_error": 0.145, "bound_low": 24.9399}
    _, _, head, row, *_ = Budget(**bound).lines
    assert head.split() == ["N", "regular", "times", "found", "times", "lower", "bound"]
    assert row.endswith("16  34.21 (33.82 to 34.60)  25.85 (25.47 to 26.22)  25.44 (from 24.93)")
    exact = Budget(bound=25.4371, bound_error=0.0, bound_low=25.4371).lines
    assert any(line.endswith("  25.437") for line in exact)
    wide = Budget(1e-20, **{key: 1e-20 * value for key, value in bound.items()}).lines
    assert wide[3].endswith("2.585e-19 (2.547e-19 to 2.622e-19)")
    assert "Left out: lower bound" in wide[4]
    assert max(map(len, wide)) <= COLUMNS
    assert not any("bound" in line for line in Budget().lines)


PROVED = "proved: no 15 times can (95 % confidence)"


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, f"17 found times reach it (95 %: 16 to 18); {PROVED}"),
        ({"impossible": None}, "17 found times reach it (95 %: 16 to 18)"),
        (
            {"interval": [16, None], "larger_that_do_not": [19, 20]},
            f"17 found times reach it (95 %: 16 to more), but not 19, 20; {PROVED}",
        ),
        (
            {"measurements": None},
            f"none of these numbers of found times reaches it; {PROVED}",
        ),
    ],
)
def test_a_line_says_which_number_reaches_a_target_and_which_cannot(
    changes: dict[str, Any], told: str
) -> None:
    found = {"measurements": 17, "interval": [16, 18], "larger_that_do_not": []}
    found |= {"impossible": 15, "measurement_times": None} | changes
    blocks = budget(cast("Any", Budget(reached=found))).blocks
    texts = [block.text for block in blocks if isinstance(block, Text)]
    assert f"target 25: {told}" in texts
