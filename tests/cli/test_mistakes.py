"""Whatever is typed or a job file holds: one line that says what, got, allowed, and where."""

import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from oracles.in_turn import in_turn
from pfdist import Job
from pfdist.cli.commands import COMMANDS
from pfdist.cli.main import main

JOB = (Path(__file__).parents[1] / "small.toml").read_text()
KEPT = Path(__file__).parents[2] / "results" / "example" / "job.toml"
NINES = "9" * 5000
LONG = "x" * 3_000_000
HUGE = str(10**30)
Refused = Callable[[list[str]], tuple[object, str]]


@pytest.fixture(scope="module")
def run(finished: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(finished(), tmp_path_factory.mktemp("mistakes") / "run"))


@pytest.fixture
def refused(call: Callable[..., Any]) -> Refused:
    """Give the exit code and the short line of a command that must refuse."""

    def called(words: list[str]) -> tuple[object, str]:
        code, out, error = call("", *words)
        assert out == ""
        assert error.count("\n") == 1
        assert error.startswith("pfdist")
        assert len(error) < 1300
        return code, error

    return called


@pytest.mark.plugins("budget", "filter", "rule", "runs", "simulate", "sweep", "why")
@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("run missing.toml", 1, "cannot read the job file missing.toml"),
        ("run {job} --results {job}", 1, r"--results must be a folder, got the file "),
        ("run {job} --workers 99999 --pool threads", 1, "at most 1,000 on one machine, got 99,999"),
        ("evaluate {job}", 2, "--times requires an argument"),
        ("evaluate {job} --times=" + "1," * 100_000, 1, r"--times must .*, got 1 twice"),
        (f"evaluate {{job}} --times=0:{HUGE}", 1, "at most 1,000,000"),
        ("evaluate {job} --times 1 --draws 1_0", 2, "digits 0-9"),
        (f"evaluate {{job}} --times 1 --{LONG}", 2, "Unknown option: --xxx"),
        (
            "evaluate {job} --times 1 --set comparison.control=false "
            "--set scenarios.parameters=[{a=1.0},{a=2.0}]",
            1,
            r"^pfdist: scenarios\.parameters: model .*unknown parameter 'a'",
        ),
        ("sweep {job} --over seed=1,2 --set seed=3", 1, "^pfdist: --set: a key of the sweep must"),
        ("plan {job} --draws 9", 2, r"--draws.*\(--set KEY=VALUE changes a key of the job"),
        (f"evaluate {{job}} --times 1 --set seed={NINES}", 1, "19 digits"),
        ("evaluate {job} --times 1 --set seed=a\udcffb", 1, "UTF-8"),
        ("status nowhere", 1, "nowhere holds no run: it has no run.json"),
        (f"why {{run}}/job.toml --draws {HUGE}", 1, "at most 100,000,000"),
        ("evaluate {job} --times 0 6 12", 2, "unexpected word '6' .a list is one word, as 0,6,12"),
        ("sweep {job} --over seed=1,2 --part 1/2 --dry-run", 1, "--part and --dry-run exclude"),
        ("check-model ungm --horizon 3 --times 0,1", 1, "^pfdist: --horizon and --times exclude"),
        (LONG, 2, "unknown command x"),
    ],
    ids=lambda value: str(value)[:50],
)
def test_every_mistake_is_one_line(
    line: str, code: int, words: str, run: Path, refused: Refused
) -> None:
    filled = line.replace("{job}", str(run / "job.toml")).replace("{run}", str(run))
    given, told = refused(filled.split(" "))
    assert re.search(words, told), told
    assert given == code


def _changed(old: str, new: str) -> bytes:
    assert old in JOB
    return JOB.replace(old, new, 1).encode()


def _named(name: str) -> bytes:
    return _changed("[problem]", f'[model]\nname = "{name}"\n[problem]')


FILES = {
    "65 bits": (_changed("seed = 1", f"seed = {2**63}"), "64 bits"),
    "deep lists": (_changed("seed = 1", "seed = " + "[" * 9999), "16 deep"),
    "a key of 3 MB": (_changed("seed = 1", f"{LONG} = 1"), "unknown key 'xx"),
    "NUL in a model's name": (_named("a\\u0000.py:m"), "name: String should match"),
    "NUL in a search's name": (
        _changed('method = "random"', 'method = "random"\nname = "a\\u0000b"'),
        "name must be lower-case letters",
    ),
    "population 10^18": (
        _changed("population = 6", f"population = {10**18}"),
        r"1e18|1000000000000000000 on 30 draws each takes about .* GB",
    ),
    "101 searches": (
        _changed("[comparison]", '[[search]]\nmethod="random"\nname="a"\n' * 99 + "[comparison]"),
        "search must",
    ),
    "a dot in a key": (b'"a.b" = 1\n' + JOB.encode(), "unknown key 'a.b', allowed: seed"),
    "not UTF-8": (JOB.encode() + b"# \xff", "UTF-8, got byte 0xff"),
    "16 MB of comment": (b"#" * 16_000_001, "16,000,000 bytes"),
}


@in_turn("name", FILES)
def test_a_hostile_job_file_is_refused_in_one_line(
    name: str, tmp_path: Path, refused: Refused
) -> None:
    content, words = FILES[name]
    path = tmp_path / "job.toml"
    path.write_bytes(content)
    code, line = refused(["run", str(path), "--results", str(tmp_path / "run")])
    assert code == 1
    assert re.search(words, line), line
    assert not (tmp_path / "run").exists()


@pytest.mark.plugins("sweep")
@pytest.mark.parametrize("kind", ["pipe", "device", "socket", "huge"])
@pytest.mark.parametrize(
    "line", ["run {path}", "sweep {path}", "evaluate {job} --times 0 --set model.name={path}:m"]
)
def test_no_pipe_device_socket_or_huge_file_is_read(
    kind: str, line: str, small_job: Job, tmp_path: Path, refused: Refused
) -> None:
    """A pipe would hang for ever, and a file of 10 GB would fill the memory."""
    path = tmp_path / ("a.py" if "model" in line else "a.toml")
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "huge":
        path.touch()
        os.truncate(path, 10**10)
    else:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(str(path))
    code, told = refused(line.format(path=path, job=small_job.path).split())
    assert code == 1
    words = "16,000,000 bytes, got 10,000,000,000" if kind == "huge" else "must be a plain file"
    assert words in told


@pytest.mark.plugins("budget", "check")
@pytest.mark.parametrize(
    ("line", "code", "meant"),
    [
        ("paln", 2, "plan"),
        ("evaluate {job} --tmies 0,3", 2, "--times"),
        ("plan {job} --search suvivors", 2, "survivors"),
        ("run {job} --set filter.partcles=3", 1, "particles"),
        ("run {job} --set model.parameters.proces_sd=1", 1, "process_sd"),
        ("run {folder}/smal.toml", 1, "small.toml"),
        ("status found", 1, "results/foun"),
        ("filter {kept} x.csv --planned relaxatio", 1, "relaxation"),
    ],
)
def test_a_misspelt_word_is_followed_by_the_nearest_one(
    line: str,
    code: int,
    meant: str,
    small_job: Job,
    monkeypatch: pytest.MonkeyPatch,
    refused: Refused,
) -> None:
    folder = small_job.path.parent
    monkeypatch.chdir(folder)
    for name in ("run", "results/foun"):
        (folder / name).mkdir(parents=True)
        (folder / name / "run.json").touch()
    names = {"job": small_job.path, "folder": folder, "kept": KEPT}
    given, told = refused(line.format(**names).split())
    assert given == code
    wanted = re.escape(meant.format(**names))
    assert re.search(rf"[Dd]id you mean ['\"]?{wanted}\b", told), told


@pytest.mark.plugins("online")
def test_online_search_lists_and_suggests_only_methods_that_can_plan_online(
    small_job: Job, refused: Refused
) -> None:
    for method in ("relaxation", "relaxatoin"):
        change = f"online.search.method={method}"
        _, line = refused(["run", str(small_job.path), "--set", change])
        allowed = line.partition("must be one of ")[2].partition(", got ")[0]
        assert "'corridor'" in allowed
        assert "relaxation" not in allowed
        assert "did you mean" not in line


def test_debug_shows_the_traceback_before_the_line(call: Callable[..., Any]) -> None:
    code, _, error = call("", "run", "missing\x1b.toml", "--debug")
    assert code == 1
    assert "Traceback (most recent call last)" in error
    assert "\x1b" not in error
    assert error.splitlines()[-1].startswith("pfdist: cannot read the job file missing?.toml")


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        ("pfdist.results.open_run", ["status", "run"]),
        ("pfdist.cli.main.line_of", ["status", "run"]),
    ],
)
def test_an_unexpected_exception_is_one_line(
    broken: str, words: list[str], refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise KeyError("\x1b[2J")

    monkeypatch.setattr(broken, fail)
    code, line = refused(words)
    assert code == 1
    assert line.startswith("pfdist: unexpected KeyError: ")
    assert line.endswith("(--debug shows the traceback)\n")
    assert "\x1b" not in line


def test_a_file_of_settings_for_numba_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / ".numba_config.yaml").write_text("disable_jit: 1\n")
    code, line = refused(["run", "missing.toml"])
    assert code == 1
    assert "must hold no .numba_config.yaml" in line


@pytest.mark.plugins("budget", "init", "why")
def test_pfdist_alone_shows_three_commands_to_try(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main([]) == 0
    text = capsys.readouterr().out.removesuffix("`pfdist --help` lists all commands.\n")
    # In a process of its own: the program listens to signals.
    alone = subprocess.run(
        [sys.executable, "-m", "pfdist"], capture_output=True, text=True, check=True
    )
    assert text in alone.stdout
    assert text.startswith("pfdist finds the measurement times ")
    lines = [line[2:] for line in text.splitlines() if line.startswith("  pfdist ")]
    assert len(lines) == 3
    assert all(line in COMMANDS[line.split()[1]].examples for line in lines)
    assert max(map(len, text.splitlines())) <= 80
