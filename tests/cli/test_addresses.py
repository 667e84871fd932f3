"""An address, as s3://bucket/run, is no path: every command says so, and makes no folder of it."""

import inspect
import os
import pkgutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import pfdist
from oracles.in_turn import in_turn
from pfdist.cli.commands import COMMANDS
from pfdist.cli.words import _PYTHON_ALONE, word_of
from pfdist.common.arguments import address_fault, path_argument
from pfdist.errors import ArgumentError, PfdistError

Call = Callable[..., Any]
ADDRESS = "s3://bucket/run"
SAID = f"must be a path of this machine, got the address '{ADDRESS}': mount its storage as a folder"
SMALL = Path(__file__).parents[1] / "small.toml"
NEEDED = {
    "budget": ["--measurements", "3"],
    "online": ["--set", "online.draws=9"],
    "compare": ["--times", "mine=0,3"],
    "evaluate": ["--times", "0,3"],
    "simulate": ["--out", "rows.csv"],
    "sweep": ["--over", "seed=1,2"],
}
"""Options that a command needs."""


def _parameters(command: str) -> dict[str, inspect.Parameter]:
    return dict(inspect.signature(pkgutil.resolve_name(COMMANDS[command].function)).parameters)


def _paths() -> Iterator[tuple[str, str]]:
    """All arguments of all commands that are paths."""
    for command in COMMANDS:
        for name, parameter in _parameters(command).items():
            if name not in _PYTHON_ALONE and "Path" in str(word_of(command, parameter).kind):
                yield command, name


@pytest.mark.plugins("filter", "init", "runs")
def test_the_table_has_the_arguments_that_it_should() -> None:
    table = {*_paths()}
    assert {("run", name) for name in ("job", "results", "reuse")} <= table
    assert {("filter", name) for name in ("job", "measurements", "out", "prior")} <= table
    assert {
        ("status", "export"),
        ("verify", "run"),
        ("table", "out"),
    } <= table
    assert {command for command, _ in table} == COMMANDS.keys() - {
        "init",
        "models",
        "completion",
        "schema",
    }


@in_turn(("command", "name"), [*_paths()])
def test_an_address_is_refused_wherever_a_command_takes_a_path(
    command: str, name: str, finished: Callable[..., Path], call: Call, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("rows.csv").write_text("t,y0\n0,1\n")
    run = str(finished())
    given = {"measurements": "rows.csv", "data": "rows.csv", "model": "ungm"}
    given |= {"job": str(SMALL)} if command in NEEDED else {}
    words = [command]
    for each, about in _parameters(command).items():
        if each in _PYTHON_ALONE or about.kind is about.VAR_KEYWORD:
            continue
        word = word_of(command, about)
        value = ADDRESS if each == name else given.get(each, run)
        is_needed = about.default is about.empty and about.kind is not about.KEYWORD_ONLY
        if word.stands_alone and (each == name or is_needed):
            words.append(value)
        elif each == name:
            words += [f"--{name}", value]
    code, out, error = call("", *words, *(NEEDED.get(command, []) if name != "out" else []))
    assert code == 1
    assert SAID in " ".join((out + error).split())
    assert os.listdir(tmp_path) == ["rows.csv"]


JOB = 'seed = 1\n[model]\nname = "{}"\n[problem]\nhorizon = 3\nmeasurement_budget = 1\n'


@pytest.mark.plugins("sweep")
def test_an_address_in_a_job_or_a_sweep_file_is_named_with_its_key(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.toml").write_text(JOB.format("s3://bucket/walk.py:model"))
    covariate = '[model.parameters]\nnoise_sd = { file = "s3://bucket/rain.csv" }\n'
    Path("b.toml").write_text(JOB.format("random_walk") + covariate)
    Path("c.toml").write_text('job = "gs://bucket/a.toml"\n[over]\nseed = [1, 2]\n')
    for line, key, address in (
        ("evaluate a.toml --times 0", "model.name: the model", "s3://bucket/walk.py:model"),
        ("run b.toml", "model.parameters.noise_sd.file", "s3://bucket/rain.csv"),
        ("sweep c.toml", "job", "gs://bucket/a.toml"),
    ):
        code, _, error = call(line)
        assert code == 1
        assert error.startswith(f"pfdist: {key} must be a path of this machine, got the address ")
        assert address in error
    with pytest.raises(PfdistError, match="the model must be a path of this machine"):
        pfdist.Problem("https://host/walk.py:model", horizon=3, measurement_budget=1)
    assert sorted(os.listdir(tmp_path)) == ["a.toml", "b.toml", "c.toml"]


@pytest.mark.parametrize("path", [ADDRESS, Path(ADDRESS), "file:///home/x", "a+b.c-d://x"])
def test_an_address_is_known_as_a_text_and_as_a_path(path: str | Path) -> None:
    with pytest.raises(ArgumentError, match="results must be a path of this machine, got the add"):
        path_argument("results", path)


@in_turn(
    "path",
    [
        "s3:",
        "s3:/x",
        "./s3://x",
        "a/b://c",
        "12:30://x",
        "C:/x",
        "x//y",
        Path("/s3://x"),
        Path("a:b"),
    ],
)
def test_a_path_of_any_other_name_is_no_address(path: str | Path) -> None:
    assert address_fault(path) == ""
    assert path_argument("results", path) == Path(path).absolute()


def test_a_cache_at_an_address_is_named_and_not_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pfdist.kernels import cached

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(cached.FOLDER_VARIABLE, ADDRESS)
    with pytest.warns(UserWarning, match=f"compiled code is not kept.*{ADDRESS}"):
        assert cached._folder.__wrapped__(tmp_path) is None
    assert os.listdir(tmp_path) == []
