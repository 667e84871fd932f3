"""Tables, lists and budgets are printed in 80 columns; JSON has all of them."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import pfdist
from pfdist.cli.budget_summary import budget_lines
from pfdist.cli.layout import COLUMNS
from pfdist.cli.list_lines import list_lines
from pfdist.cli.runs_lines import runs_lines
from pfdist.common.rounding import with_error

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
    assert {"run", "seed", "measurement_", "budget", "set", "gain", "seconds"} <= set(words)
    summary = pfdist.open_run(runs / "b").summary()["results"]["random"]
    row = next(line for line in lines if line.startswith("b ") and "random" in line)
    assert with_error(summary["expected_mse"], summary["standard_error"]) in row
    assert row.split()[:3] == ["b", "2", "5"]
    assert lines[-1] == "gain %: how far the expected MSE is below that of regular (95 %)"


def test_a_table_that_does_not_fit_names_what_it_leaves_out(runs: Path, printed: Printed) -> None:
    lines = printed("table", runs).splitlines()
    assert max(map(len, lines)) <= COLUMNS
    (told,) = [number for number, line in enumerate(lines) if line.startswith("--json and --out")]
    left_out = " ".join(lines[told:])
    assert "model.parameters.process_sd" in left_out  # which two of the jobs lack
    assert [line.split()[0] for line in lines[2:8]] == ["a", "a", "b", "b", "c", "c"] or (
        "run" in left_out
    )


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
    shutil.rmtree(tmp_path / "b" / "tables" / "comparison")
    head, bad, unfinished, good = printed("list", tmp_path).splitlines()
    assert head.split() == ["run", "state", "age", "size", "found"]
    assert max(map(len, (bad, unfinished, good))) <= COLUMNS
    assert "damaged" in bad
    assert "cannot read run.json" in bad
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
    lines = [
        *list_lines(pfdist.list_runs(tmp_path), "results"),
        *runs_lines(pfdist.table(tmp_path)),
    ]
    assert all(line.isprintable() for line in lines)


def _budget(scale: float = 1.0, **changes: Any) -> dict[str, Any]:
    """The summary of a budget of 16 measurements."""
    unknown = ("worse_than", "search_excess", "top_percent_share", "bound", "bound_error")
    results = {}
    for kind, mse, error in (("regular", 34.207, 0.195), ("found", 25.846, 0.187)):
        limits = {"low": scale * (mse - 2 * error), "high": scale * (mse + 2 * error)}
        costs = {"expected_mse": scale * mse, "measurements": 16, "kind": kind, "bound_low": None}
        results[f"{kind}_16"] = dict.fromkeys(unknown) | costs | limits
    results["found_16"] |= changes
    return {"results": results}


def test_the_table_of_a_budget_has_the_bound_and_the_limit_holds_as_it_is_printed() -> None:
    bound = {"bound": 25.4371, "bound_error": 0.145, "bound_low": 24.9399}
    head, row = budget_lines(_budget(**bound))[2:4]
    assert head.endswith("  regular times             found times         lower bound")
    assert row == "   16  34.21 (33.82 to 34.60)  25.85 (25.47 to 26.22)  25.44 (from 24.93)"
    exact = budget_lines(_budget(bound=25.4371, bound_error=0.0, bound_low=25.4371))
    assert exact[3].endswith("  25.437")
    wide = budget_lines(_budget(1e-20, **{key: 1e-20 * value for key, value in bound.items()}))
    assert wide[3].endswith("2.585e-19 (2.547e-19 to 2.622e-19)")  # the bound has no room
    assert max(map(len, wide)) <= COLUMNS
    assert not any("bound" in line for line in [*wide, *budget_lines(_budget())])
    unproved = budget_lines(_budget(lower_bound={"reason": "a draw is degenerate"}))
    assert unproved[-1] == "no lower bound for N = 16: a draw is degenerate"


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, "17 found times reach it (95 %: 16 to 18); no 15 times can (95 %)"),
        ({"impossible": None}, "17 found times reach it (95 %: 16 to 18)"),
        (
            {"interval": [16, None], "larger_that_do_not": [19, 20]},
            "17 found times reach it (95 %: 16 to more), but not 19, 20; no 15 times can (95 %)",
        ),
        (
            {"measurements": None},
            "none of these numbers of found times reaches it; no 15 times can (95 %)",
        ),
    ],
)
def test_a_line_says_which_number_reaches_a_target_and_which_cannot(
    changes: dict[str, Any], told: str
) -> None:
    found = {"measurements": 17, "interval": [16, 18], "larger_that_do_not": []}
    found |= {"impossible": 15, "measurement_times": None} | changes
    lines = budget_lines(_budget() | {"target": 25.0, "reached": {"found": found}})
    assert lines[-1] == f"target 25: {told}"


def test_a_line_names_the_sets_whose_error_few_draws_carry() -> None:
    told = (
        "1 % of the draws carry 65 % of the error of found_16: 95 % intervals are too narrow; "
        "take more draws"
    )
    assert told in " ".join(" ".join(budget_lines(_budget(top_percent_share=0.653))).split())
    assert "carry" not in " ".join(budget_lines(_budget(top_percent_share=0.25)))
