"""Words that become arguments, and the scripts that complete words in shells."""

import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from cyclopts import CycloptsError

from oracles.completed_by_zsh import completed_by_zsh
from oracles.in_turn import in_turn
from pfdist.cli.own import completion
from pfdist.cli.program import line_of


def options_of(line: str, *words: str) -> dict[str, Any]:
    read = line_of([*line.split(), *words])
    assert read is not None
    return {"files": read.arguments, **read.options, "json": read.json}


@pytest.mark.parametrize(
    "line", ["a.toml --times 0,3,6", "--times 0:6:3 a.toml", "--times=0:6:3 a.toml --json"]
)
def test_options_stand_before_and_after_the_job(line: str) -> None:
    options = options_of(f"evaluate {line}")
    assert options["files"] == ("a.toml",)
    assert options["times"] == {"": line.replace("=", " ").split("--times ")[1].split()[0]}
    assert options["json"] is ("--json" in line)


def test_blanks_inside_a_value_stay() -> None:
    times = "2 18 blood, 6 x-ray"
    assert options_of("evaluate a.toml --times", times)["times"] == {"": times}


@pytest.mark.plugins("budget")
def test_an_option_that_has_several_values_is_given_once_for_each() -> None:
    options = options_of("compare a.toml results/a --times b=1:3 results/b --times regular")
    assert options["times"] == {"b": "1:3", "regular": "regular"}
    assert options["files"] == ("a.toml", "results/a", "results/b")
    options = options_of("run a.toml --set seed=1 filter.particles=5 --set seed=2 --reuse r")
    assert options["changes"] == ["seed=1", "filter.particles=5", "seed=2"]
    assert options["reuse"] == ["r"]
    assert options_of("budget a.toml --measurements 5:7,20:40:10")["measurements"] == {
        5, 6, 7, 20, 30, 40
    }  # fmt: skip


def test_a_report_is_written_unless_it_is_declined() -> None:
    assert options_of("run a.toml")["report"] is None
    assert options_of("run a.toml --no-report")["report"] is False
    assert options_of("run a.toml --report")["report"] is True


@in_turn(
    "line",
    [
        "evaluate a.toml --times 0 x",
        "evaluate a.toml --times",
        "evaluate a.toml b.toml --times 0",
        "evaluate --job a.toml --times 0",
        "evaluate a.toml --times 0 --draws 3 --draws 4",
        "evaluate a.toml --times 0 --draws 2.5",
        "evaluate a.toml --times 0 --no-json",
        "run a.toml --empty-set",
        "sweep a.toml --part 3",
    ],
)
def test_words_that_no_argument_takes_are_refused(line: str) -> None:
    with pytest.raises(CycloptsError):
        line_of(line.split())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the script for bash, a job file, a model file, a run, and other folders."""
    folder = tmp_path_factory.mktemp("completion")
    (folder / "script").write_text(completion("bash"))
    for file in ("jobs/plan.toml", "results/run/run.json", "mine.py", "patient.csv", "notes/a"):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).touch()
    return folder


LINES = {
    "pl": {"plan", "plot"},
    "check-model m": {"mine.py"},
    "plan jobs/": {"jobs/plan.toml"},
    "filter a.toml p": {"patient.csv"},
    "plan a.toml --search ex": {"exchange", "exhaustive"},
    "run a.toml --pool s": {"serial"},
    "run a.toml --results n": {"notes"},
    "budget a.toml --me": {"--measurements"},
    "budget a.toml --measurements 5:9 --ta": {"--target"},
    "status results/": {"results/run"},
}


@pytest.mark.plugins("check", "sweep")
@in_turn(("line", "found"), LINES.items())
def test_bash_completes(line: str, found: set[str], folder: Path) -> None:
    ask = (
        ". ./script\n"
        'COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))\n'
        "_pfdist\n"
        'printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    done = subprocess.run(
        ["bash", "-c", ask, "bash", "pfdist", *line.split(" ")],
        cwd=folder, capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    assert set(done.stdout.split("\n")) - {""} == found


@pytest.mark.plugins("check")
@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_get_a_script_that_knows_commands_options_and_values(
    shell: str, call: Callable[..., Any]
) -> None:
    text = call(f"completion {shell}").out
    assert all(word in text for word in ("check-model", "measurements", "exhaustive"))


def _names(words: Iterable[str]) -> set[str]:
    """Commands, options, and files without their folders."""
    return {Path(word).name for word in words}


@pytest.mark.shells
@pytest.mark.parametrize("line", LINES)
def test_zsh_completes(line: str, folder: Path) -> None:
    (folder / "functions").mkdir(exist_ok=True)
    (folder / "functions" / "_cyclopts_pfdist").write_text(completion("zsh"))
    assert completed_by_zsh(f"pfdist {line}", folder) == _names(LINES[line])


@pytest.mark.shells
@pytest.mark.parametrize("line", LINES)
def test_fish_completes(line: str, folder: Path) -> None:
    (folder / "script.fish").write_text(completion("fish"))
    done = subprocess.run(
        ["fish", "-c", "source script.fish; complete -C $argv[1]", f"pfdist {line}"],
        cwd=folder, capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    assert _names(row.partition("\t")[0] for row in done.stdout.splitlines()) == _names(LINES[line])
