"""Tables, lists and budgets fit the terminal, of 80 columns by default; JSON has all of them."""

import json
import re
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
from pfdist.common.parts import Cell, Table, Text
from pfdist.common.rounding import with_error
from pfdist.pages.terminal import aligned, line_width, lines_of, lines_of_blocks
from pfdist.plugins.budget.page import budget_section
from pfdist.plugins.runs.pages import list_page, table_page
from pfdist.results import columns

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


_NOTHING = dict.fromkeys(columns.COLUMNS)


class Budget:
    """A run of 16 measurements, as a chapter sees it."""

    is_compared = True
    notes = ()

    def __init__(self, scale: float = 1.0, reached: Any = None, **changes: Any) -> None:
        self.rows = {
            f"{kind}_16": SimpleNamespace(
                **_NOTHING
                | {
                    "name": f"{kind}_16",
                    "kind": kind,
                    "measurement_times": [*range(16)],
                    "measurements": 16,
                    "budget": 16,
                    "price": None,
                    "expected_mse": scale * mse,
                    "standard_error": scale * error,
                    "label": "plan of 16",
                    "particle_loss": 0.15,
                    "particle_loss_limit": 0.3,
                }
            )
            for kind, mse, error in (("regular", 34.207, 0.195), ("found", 25.846, 0.187))
        }
        vars(self.rows["found_16"]).update(changes)
        self.reference_row = self.rows["regular_16"]
        self.target = None if reached is None else 25.0
        nobody = {"measurements": None, "impossible": None}
        nobody |= {"interval": [None, None], "larger_that_do_not": [], "measurement_times": None}
        nobody |= {"with_more_particles": None}
        answers = {"found": nobody if reached is None else reached, "regular": nobody}
        self.reaching = lambda *target: answers
        if reached is not None and reached["measurements"]:
            self.rows["found_16"].budget = reached["measurements"]
        self.run = SimpleNamespace(tables=(), job={"filter": {"particles": 400}})

    clock = SimpleNamespace(listed=str)
    distinct = property(lambda self: self.rows)
    sets = property(lambda self: pd.DataFrame([vars(row) for row in self.rows.values()]))

    def typical_errors(self, row: SimpleNamespace) -> str:
        return f"{row.budget} g/L"

    @property
    def lines(self) -> list[str]:
        return lines_of_blocks(budget_section(cast("Any", self)).blocks)


def test_the_table_of_a_budget_has_the_bound_and_the_limit_holds_as_it_is_printed() -> None:
    bound = {"bound": 25.4371, "bound_error": 0.145, "bound_low": 24.9399}
    _, _, *heads, row = Budget(**bound).lines[:6]
    words = "N regular plan as good, regular lower bound (95 % limit)"
    assert sorted(" ".join(heads).split()) == sorted(words.split())
    assert row == "16  34.21 ± 0.20  25.85 ± 0.19  more than 16  25.44 (24.93)"
    exact = Budget(bound=25.4371, bound_error=0.0, bound_low=25.4371).lines
    assert any(line.endswith("  25.437") for line in exact)
    wide = Budget(1e-20, **{key: 1e-20 * value for key, value in bound.items()}).lines
    assert "(2.585 ± 0.019)e-19  more than 16" in "\n".join(wide)
    assert max(map(len, wide)) <= COLUMNS + 1  # no cell of numbers is cut
    assert not any("bound" in line for line in Budget().lines)


FEW = "15 are provably too few; 16 is undecided"
REACH = "To reach an MSE of 25 you need"
AT = f": t = {[*range(16)]} (typical error {{}} g/L)"  # as `Budget` gives it


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, f"{REACH} 17 measurements (95 % CI 16 to 18){AT.format(17)}; {FEW}."),
        ({"impossible": None}, f"{REACH} 17 measurements (95 % CI 16 to 18){AT.format(17)}."),
        (
            {"measurements": 1, "interval": [1, 1], "impossible": None},
            f"{REACH} 1 measurement{AT.format(1)}.",
        ),
        (
            {"interval": [16, None], "larger_that_do_not": [19, 20]},
            f"{REACH} 17 measurements (95 % CI 16 to more){AT.format(17)}, "
            f"but 19, 20 do not reach it; {FEW}.",
        ),
        (
            {"measurements": None},
            f"None of these numbers of measurements reaches an MSE of 25; {FEW}.",
        ),
        (
            {"measurements": None, "with_more_particles": 16},
            "None of these numbers of measurements reaches an MSE of 25; with more particles 16 "
            "may be enough: these 400 lose at most 30.00 % of the expected MSE (95 % confidence; "
            f"estimate 15.00 %); {FEW}.",
        ),
    ],
)
def test_a_line_says_which_number_reaches_a_target_and_which_cannot(
    changes: dict[str, Any], told: str
) -> None:
    found = {"measurements": 17, "interval": [16, 18], "larger_that_do_not": []}
    found |= {"impossible": 15, "measurement_times": None, "with_more_particles": None} | changes
    blocks = budget_section(cast("Any", Budget(reached=found))).blocks
    texts = [block.text for block in blocks if isinstance(block, Text)]
    assert told in texts
