"""The way in, and what is said about a misspelt word."""

import shlex
from pathlib import Path

import pytest

from pfdist import Job
from pfdist.cli.command import COMMANDS
from pfdist.cli.main import main

KEPT = Path(__file__).parents[2] / "results" / "example" / "job.toml"


def test_pfdist_alone_shows_three_commands_to_try(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("sys.argv", ["pfdist"])
    assert main() == main([]) == 0
    text, again = capsys.readouterr().out.split("`pfdist --help` lists all commands.\n")[:2]
    assert text == again
    assert text.startswith("pfdist finds the measurement times ")
    lines = [line[2:] for line in text.splitlines() if line.startswith("  pfdist ")]
    assert len(lines) == 3
    assert all(line in COMMANDS[line.split()[1]].examples for line in lines)
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(
    ("line", "code", "meant"),
    [
        ("paln", 2, "plan"),
        ("--verison", 2, "--version"),
        ("evaluate {job} --tmies 0,3", 2, "--times"),
        ("plan {job} -json", 2, "--json"),
        ("plan {job} --search suvivors", 2, "survivors"),
        ("run {job} --pool seral", 2, "serial"),
        ("run {job} --set sede=3", 1, "seed"),
        ("run {job} --set filter.partcles=3", 1, "particles"),
        ("run {job} --set filter.engine=kalmann", 1, "kalman"),
        ("run {job} --set search.genetics.generations=3", 1, "genetic"),
        ("run {job} --set online.search.method=coridor", 1, "corridor"),
        ("run {job} --set model.name=umgm", 1, "ungm"),
        ("run {job} --set model.parameters.proces_sd=1", 1, "process_sd"),
        ("run {folder}/smal.toml", 1, "{folder}/small.toml"),
        ("status {folder}/runn", 1, "{folder}/run"),
        ("verify {folder}/runn", 1, "{folder}/run"),
        ("status found", 1, "results/foun"),
        ("filter {kept} x.csv --planned regula", 1, "regular"),
    ],
)
def test_a_misspelt_word_is_followed_by_the_nearest_one_in_one_line(
    line: str,
    code: int,
    meant: str,
    small_job: Job,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = small_job.path.parent
    monkeypatch.chdir(folder)
    for run in ("run", "results/foun"):
        (folder / run).mkdir(parents=True)
        (folder / run / "run.json").touch()
    names = {"job": small_job.path, "folder": folder, "kept": KEPT}
    assert _exit_code(shlex.split(line.format(**names))) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert f"; did you mean {meant.format(**names)!r}?" in captured.err


def test_online_search_lists_and_suggests_only_methods_that_can_plan_online(
    small_job: Job, capsys: pytest.CaptureFixture[str]
) -> None:
    for method in ("relaxation", "relaxatoin"):
        assert main(["run", str(small_job.path), "--set", f"online.search.method={method}"]) == 1
        line = capsys.readouterr().err
        allowed = line.partition("must be one of ")[2].partition(", got ")[0]
        assert "'corridor'" in allowed
        assert "relaxation" not in allowed
        assert "did you mean" not in line


def _exit_code(words: list[str]) -> object:
    try:
        return main(words)
    except SystemExit as stop:
        return stop.code
