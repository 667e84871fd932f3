"""Tables and lists fit the terminal, of 80 columns by default; JSON has all of them."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import pfdist
from oracles.listed import forget
from oracles.results_of import results_of
from pfdist.common.parts import Cell, Table
from pfdist.common.rounding import with_error
from pfdist.pages.terminal import aligned, line_width, lines_of, lines_of_blocks
from pfdist.plugins.runs.pages import list_page, table_page

Printed = Callable[..., str]
COLUMNS = 80


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
    assert {"run", "seed", "measurement_", "set", "gain,", "seconds"} <= set(words)
    summary = results_of(pfdist.open_run(runs / "b"))["random"]
    row = next(line for line in lines if line.startswith("b ") and "random" in line)
    assert with_error(summary.expected_mse, summary.standard_error) in row
    assert row.split()[:3] == ["b", "2", "5"]
    assert " ".join(" ".join(lines[-2:]).split()) == (
        "The gain is how far the expected MSE lies below that of regular times (95 % CI)."
    )


def test_a_table_that_does_not_fit_keeps_what_tells_its_rows_apart(
    runs: Path, printed: Printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = printed("table", runs).splitlines()
    assert max(map(len, lines)) <= COLUMNS
    assert lines[1].split()[:1] == ["run"]
    assert "Left out" not in " ".join(lines)
    monkeypatch.setenv("COLUMNS", "120")
    wide = printed("table", runs).splitlines()
    assert COLUMNS < max(map(len, wide)) <= 120
    assert len(wide[1].split()) > len(lines[1].split())


@pytest.mark.parametrize(("wanted", "width"), [("20", 40), ("100", 100), ("300", 120), ("", 80)])
def test_lines_are_as_wide_as_the_terminal(
    wanted: str, width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", wanted)
    assert line_width() == width
    words, name = " ".join(["word"] * 50), "_".join(["name"] * 30)
    rows = [[Cell(name), Cell(words), Cell("1.5", 1.5)]]
    lines = aligned(Table("", ["long_name", "about it", "error"], rows))
    assert width / 2 < max(map(len, lines)) <= max(width, 2 * 24 + 9)
    cells = [line[: lines[0].index("about it")].strip() for line in lines[1:]]
    assert "".join(cells) == name  # cut within words, but whole
    assert " ".join(lines).count("word") == 50
    assert lines[1].endswith("  1.5")


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


def test_a_list_shows_state_age_size_and_gain(runs: Path, tmp_path: Path, printed: Printed) -> None:
    for name in ("a", "b", "c"):
        shutil.copytree(runs / name, tmp_path / name)
    (tmp_path / "a" / "run.json").write_text("{}")
    forget(tmp_path / "b", "comparison")
    *above, _, folder = printed("list", tmp_path).splitlines()
    head, bad, unfinished, good = above
    assert folder == str(tmp_path)
    assert head.split() == ["run", "state", "age", "size", "found"]
    assert max(map(len, (bad, unfinished, good))) <= COLUMNS
    assert "unreadable" in bad
    assert "run.json is damaged" in bad
    assert unfinished.split()[:2] == ["b", "unfinished"]
    assert unfinished.endswith("0 of 250 draws")
    change = r"([\d.]+ % (below|above)|no clear difference from)"
    assert re.search(rf"(genetic|random) plan: {change} regular$", good)
    answer = json.loads(printed("list", tmp_path, "--json"))
    assert [row["state"] for row in answer["runs"]] == ["unreadable", "unfinished", "finished"]
    assert answer["runs"][1]["gain_of_means"] is None


def test_the_list_of_no_runs_says_so(tmp_path: Path, printed: Printed) -> None:
    assert printed("list", tmp_path) == f"{tmp_path}: no runs\n"


@pytest.mark.parametrize("name", ["a\nb", "\x1b[2J", "x" * 200])
def test_a_name_cannot_spoil_the_terminal(name: str, runs: Path, tmp_path: Path) -> None:
    shutil.copytree(runs / "a", tmp_path / name)
    pages = list_page(pfdist.list_runs(tmp_path), "results"), table_page(pfdist.table(tmp_path))
    lines = [line for page in pages for line in lines_of(page)]
    assert all(line.isprintable() for line in lines)
