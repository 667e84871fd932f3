"""Everything that the README and the manual tell a reader to type can be typed."""

import re
import shlex
from pathlib import Path

import pytest

from pfdist.cli.main import main
from pfdist.cli.parser import make_parser
from pfdist.search.methods import DEFAULT_METHOD

ROOT = Path(__file__).parents[1]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), ROOT / "results" / "README.md"]
COMMAND = re.compile(r"(?:`|^ *|&& )pfdist ([a-z][^`\n#]*)(?:`| *$|  +#)", re.MULTILINE)
NAMED_ALONE = re.compile(r"[a-z-]+")  # `pfdist plan`: the page speaks of the command
README = (ROOT / "README.md").read_text(encoding="utf-8")
VALUES = {"COMMAND": "run", "SHELL": "bash", "TIMES": "0:60:3", "NUMBERS": "5:41"}  # for words
PROSE = ("pfdist finds", "pfdist needs")  # sentences of the README that begin a line


def _commands() -> list[str]:
    texts = [page.read_text(encoding="utf-8") for page in PAGES if page.name != "CHANGELOG.md"]
    found = {match.strip() for text in texts for match in COMMAND.findall(text)}
    return sorted(command for command in found if not f"pfdist {command}".startswith(PROSE))


@pytest.mark.parametrize("command", _commands())
def test_a_command_of_the_manual_is_accepted(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = shlex.split(command.partition(" > ")[0])
    if NAMED_ALONE.fullmatch(command):
        words.append("--help")
    words = [VALUES.get(word, word) for word in words]
    assert _exit_code(words) == 0, capsys.readouterr().err


def _exit_code(words: list[str]) -> object:
    try:
        make_parser().parse_args(words)
    except SystemExit as ended:
        return ended.code
    return 0


def test_commands_are_found_in_the_manual() -> None:
    assert {"run jobs/paper.toml", "why JOB", "models"} <= set(_commands())


@pytest.mark.zoo
@pytest.mark.usefixtures("no_figures")
def test_the_model_and_the_job_of_the_readme_are_planned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, job = (_block(language) for language in ("python", "toml"))
    (tmp_path / "mine.py").write_text(model)
    (tmp_path / "mine.toml").write_text(job)
    draws = f"search.{DEFAULT_METHOD}.evaluation.draws=20"
    few = ["filter.particles=50", "comparison.draws=40", draws]
    results = ["--pool", "serial", "--results", str(tmp_path / "run")]
    results += ["--bound-draws", "0"]
    assert main(["plan", str(tmp_path / "mine.toml"), *results, "--set", *few]) == 0
    printed = capsys.readouterr().out
    times = re.search(rf"{DEFAULT_METHOD}: measure at t = ([\d, ]+)", printed)
    assert times is not None, printed
    found = [int(time) for time in times[1].split(",")]
    assert len(found) == 10
    assert not set(found) & set(range(20, 31))


def _block(language: str) -> str:
    found = re.search(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
    assert found is not None
    return found[1]
