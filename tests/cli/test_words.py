"""Lists of numbers with spaces, wherever the option stands, and options that nobody knows."""

from pathlib import Path

import pytest

from pfdist.cli.parser import make_parser
from pfdist.cli.words import unknown_option
from pfdist.common.number_list import whole_numbers


@pytest.mark.parametrize(
    "line",
    [
        "a.toml --times 0,3,6",
        "a.toml --times 0 3 6",
        "--times 0 3 6 a.toml",
        "--times=0 3 6 a.toml",
        "--ti 0, 3 ,6 a.toml --json",
        "--times 0:6:3 a.toml",
        "--times 0:3:3 6 --seed 3 a.toml",
    ],
)
def test_times_may_have_spaces_before_and_after_the_job(line: str) -> None:
    options = make_parser().parse_args(["evaluate", *line.split()])
    ((name, times),) = options.times
    assert (options.job, name, whole_numbers(times)) == ("a.toml", "", [0, 3, 6])


def test_times_with_names_may_have_spaces_too() -> None:
    line = "a.toml --times mine=0 3 6 --times=b=1:3 5 --times regular"
    options = make_parser().parse_args(["compare", *line.split()])
    assert options.times == [("mine", "0 3 6"), ("b", "1:3 5"), ("regular", "regular")]


def test_a_folder_is_no_part_of_a_list(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "2024").mkdir()
    monkeypatch.chdir(tmp_path)
    for folder in (".", "..", "2024"):
        words = ["compare", "--times", "m=0:60:3", "5", folder, "a", "--times=n=1", ",", "2e0"]
        options = make_parser().parse_args(words)
        assert options.times == [("m", "0:60:3 5"), ("n", "1 , 2e0")]
        assert (options.job, options.runs) == (folder, ["a"])


def test_a_long_word_belongs_to_a_list() -> None:
    long = ",".join(map(str, range(1, 200)))
    options = make_parser().parse_args(["evaluate", "a.toml", "--times", "0", long])
    assert options.times == [("", f"0 {long}")]


def test_measurements_take_the_same_lists() -> None:
    options = make_parser().parse_args(["budget", "a.toml", "--measurements", "5:7", "20:40:10"])
    assert options.measurements == [5, 6, 7, 20, 30, 40]


@pytest.mark.parametrize("line", ["--times 0 x", "--times 0 -1", "--draws 3 4 --times 0"])
def test_a_word_that_is_no_number_of_a_list_is_not_taken_for_one(line: str) -> None:
    with pytest.raises(SystemExit) as stop:
        make_parser().parse_args(["evaluate", "a.toml", *line.split()])
    assert stop.value.code == 2


@pytest.mark.parametrize(
    ("line", "unknown"),
    [
        ("--draw 3 --jsn", "--jsn"),
        ("--draws=3 --target -1 -.5 -", ""),
        ("--drows=3", "--drows"),
        ("-json", "-json"),
        ("-- --jsn", ""),
    ],
)
def test_the_first_unknown_option_is_found(line: str, unknown: str) -> None:
    assert unknown_option(line.split(), ["-h", "--draws", "--json", "--target"]) == unknown
