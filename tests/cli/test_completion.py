"""Bash completes commands, options, values, jobs and runs with the printed script."""

import subprocess
from pathlib import Path

import pytest

from pfdist.cli.completion import script


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the script for bash, a job file, a model file, a run, and other folders."""
    folder = tmp_path_factory.mktemp("completion")
    (folder / "script").write_text(script("bash"))
    for file in ("jobs/plan.toml", "results/my run/run.json", "mine.py", "patient.csv", "notes/a"):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).touch()
    return folder


def _completed(words: list[str], folder: Path) -> set[str]:
    """Give what bash offers for the last word of a command line, as its Tab key does."""
    ask = (
        ". ./script\n"
        'COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))\n'
        "_shtab_pfdist\n"
        'printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    done = subprocess.run(
        ["bash", "-c", ask, "bash", "pfdist", *words],
        cwd=folder, capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    return set(done.stdout.split("\n")) - {""}


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["pl"], {"plan", "plot"}),
        (["check-model", "un"], {"ungm", "ungm_gordon"}),
        (["plan", "jobs/"], {"jobs/plan.toml"}),
        (["status", ""], {"results"}),
        (["status", "results/"], {"results/my run"}),
        (["filter", "results/run", "p"], {"patient.csv"}),
        (["plan", "a.toml", "--search", "gr"], {"greedy_backward", "greedy_forward"}),
        (["run", "a.toml", "--pool", "s"], {"serial"}),
        (["run", "a.toml", "--results", "n"], {"notes"}),
        (["why", "results/run", "--model", "m"], {"mine.py"}),
        (["budget", "a.toml", "--me"], {"--measurements"}),
        (["budget", "a.toml", "--measurements", "5:9", "--ta"], {"--target"}),
    ],
)
def test_bash_completes(words: list[str], found: set[str], folder: Path) -> None:
    assert _completed(words, folder) == found


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_get_a_script_that_knows_commands_options_and_values(shell: str) -> None:
    text = script(shell)
    assert all(word in text for word in ("check-model", "measurements", "greedy_backward", "toml"))
