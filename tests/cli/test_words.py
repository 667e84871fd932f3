"""Lists of numbers with spaces, unknown options, and the scripts that complete words in shells."""

import re
import subprocess
from collections.abc import Iterable
from pathlib import Path

import pytest

from oracles.completed_by_zsh import completed_by_zsh
from pfdist.cli.commands.completion import script
from pfdist.cli.parser import make_parser
from pfdist.cli.words import unknown_option
from pfdist.common.parsing import whole_numbers


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


def test_a_folder_is_no_part_of_a_list(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "2024").mkdir()
    monkeypatch.chdir(tmp_path)
    for folder in (".", "..", "2024"):
        words = ["compare", "--times", "m=0:60:3", "5", folder, "a", "--times=n=1", ",", "2e0"]
        options = make_parser().parse_args(words)
        assert options.times == [("m", "0:60:3 5"), ("n", "1 , 2e0")]
        assert (options.job, options.folders) == (folder, ["a"])


def test_a_list_may_be_long_and_there_may_be_several() -> None:
    long = ",".join(map(str, range(1, 200)))
    line = f"a.toml --times mine=0 {long} --times=b=1:3 5 --times regular"
    options = make_parser().parse_args(["compare", *line.split()])
    assert options.times == [("mine", f"0 {long}"), ("b", "1:3 5"), ("regular", "regular")]
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the script for bash, a job file, a model file, a run, and other folders."""
    folder = tmp_path_factory.mktemp("completion")
    (folder / "script").write_text(script("bash"))
    for file in ("jobs/plan.toml", "results/my run/run.json", "mine.py", "patient.csv", "notes/a"):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).touch()
    return folder


LINES = {
    "pl": {"plan", "plot"},
    "check-model un": {"ungm", "ungm_gordon"},
    "plan jobs/": {"jobs/plan.toml"},
    "filter a.toml p": {"patient.csv"},
    "plan a.toml --search gr": {"greedy_backward", "greedy_forward"},
    "run a.toml --pool s": {"serial"},
    "run a.toml --results n": {"notes"},
    "budget a.toml --me": {"--measurements"},
    "budget a.toml --measurements 5:9 --ta": {"--target"},
}


@pytest.mark.parametrize(
    ("line", "found"),
    [*LINES.items(), ("status ", {"results"}), ("status results/", {"results/my run"})],
)
def test_bash_completes(line: str, found: set[str], folder: Path) -> None:
    ask = (
        ". ./script\n"
        'COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))\n'
        "_shtab_pfdist\n"
        'printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    done = subprocess.run(
        ["bash", "-c", ask, "bash", "pfdist", *line.split(" ")],
        cwd=folder, capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    assert set(done.stdout.split("\n")) - {""} == found


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_get_a_script_that_knows_commands_options_and_values(shell: str) -> None:
    text = script(shell)
    assert all(word in text for word in ("check-model", "measurements", "greedy_backward", "toml"))


def test_the_words_for_values_are_no_commands_of_zsh() -> None:
    """A specification is --option[help]:word:command, and a bare colon ends the word."""
    specifications = re.findall(r'^  "(--\S.*)"$', script("zsh"), re.MULTILINE)
    assert len(specifications) > 50
    for specification in specifications:
        _, *parts = re.split(r"(?<!\\):", specification)
        assert len(parts) in (0, 2), specification


def test_the_patterns_of_zsh_are_no_qualifiers() -> None:
    """zsh reads parentheses at the end of a pattern as qualifiers, if they hold no bar."""
    patterns = re.findall(r"_files -g '([^']*)'", script("zsh"))
    assert {"*.toml", "(*.csv|*.parquet)"} <= set(patterns)
    assert not [pattern for pattern in patterns if pattern[0] == "(" and "|" not in pattern]


def _names(words: Iterable[str]) -> set[str]:
    """Commands, options, and files without their folders."""
    return {Path(word).name for word in words}


@pytest.mark.shells
@pytest.mark.parametrize("line", [*LINES, "run a.toml --address "])
def test_zsh_completes(line: str, folder: Path) -> None:
    (folder / "functions").mkdir(exist_ok=True)
    (folder / "functions" / "_pfdist").write_text(script("zsh"))
    assert completed_by_zsh(f"pfdist {line}", folder) == _names(LINES.get(line, ()))


@pytest.mark.shells
@pytest.mark.parametrize("line", LINES)
def test_fish_completes(line: str, folder: Path) -> None:
    (folder / "pfdist.fish").write_text(script("fish"))
    done = subprocess.run(
        ["fish", "-c", "source pfdist.fish; complete -C $argv[1]", f"pfdist {line}"],
        cwd=folder, capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    assert _names(row.partition("\t")[0] for row in done.stdout.splitlines()) == _names(LINES[line])
