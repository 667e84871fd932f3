"""Every example of the help runs, on small jobs of the same names; so does the committed run."""

import json
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import tomli_w

import pfdist
from oracles.extras import lack_of
from pfdist.cli.commands import COMMANDS
from pfdist.cli.main import main
from pfdist.common.parsing import parse_toml
from pfdist.filters.particle_filter import KERNEL_VERSION
from pfdist.results import read_recorded

JOBS = Path(__file__).parents[2] / "jobs"
COMMITTED = Path(__file__).parents[2] / "results" / "example"
EXAMPLES = [line for command in COMMANDS.values() for line in command.examples]
_SMALL: dict[str, dict[str, Any]] = {
    "problem": {"measurement_budget": 4},
    "filter": {"particles": 5},
    "evaluation": {"draws": 10},
    "comparison": {"draws": 100},
    "execution": {"pool": "serial"},
}
# Options that follow an example: the same work on fewer draws, and without Ray.
_SHORTER = {
    "bound": "--pool serial --draws 480 --work 0",
    "compare": "--draws 100 --pool serial",
    "budget": "--draws 50 --bound-draws 0",
    "online": "--draws 2",
    "plan": "--bound-draws 0 --set comparison.draws=100",
    "run": "--set comparison.draws=100",
    "why": "--draws 20",
}


def _small(job: Path) -> str:
    """Give a job of the same horizon, with few measurements, particles and draws."""
    data = parse_toml(job.read_text())
    for name, section in _SMALL.items():
        data[name] = {**data.get(name, {}), **section}
    for search in data.get("search", ()):
        search["evaluation"] = {"draws": 10}
        if search["method"] == "genetic":
            search |= {"population": 4, "generations": 2}
    if "online" in data:
        data["online"] |= {"draws": 2, "judging_draws": 8}
    return tomli_w.dumps(data)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with the files that examples name, the run of jobs/plan.toml, and a sweep."""
    folder = tmp_path_factory.mktemp("examples")
    (folder / "jobs").mkdir()
    for job in ("plan", "quick", "online"):
        (folder / "jobs" / f"{job}.toml").write_text(_small(JOBS / f"{job}.toml"))
    for job in ("budgets", "two_compartments"):
        shutil.copy(JOBS / f"{job}.toml", folder / "jobs")
    (folder / "mine.py").write_text("from pfdist.models.library.ungm import model\n")
    (folder / "patient.csv").write_text("t,y0\n1,0.3\n4,5.1\n9,2.2\n")
    rows = [f"{name},{t},{(7 * t) % 5}" for name in "ab" for t in range(61)]
    (folder / "patients.csv").write_text("\n".join(["patient,t,y0", *rows, ""]))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(["plan", "jobs/plan.toml", "--bound-draws", "0"]) == 0
        assert main(["rule", "jobs/plan.toml"]) == 0  # for `pfdist next --rule`
        again = ["--bound-draws", "0", "--set", "seed=2", "--results", "results/budgets/seed=2"]
        assert main(["plan", "jobs/plan.toml", *again]) == 0
        shutil.copytree("results/plan", "results/budgets/seed=1")
        yield folder


@pytest.fixture
def no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page of `explore` ends at once, and no browser opens."""

    async def serve(*_: Any, **__: Any) -> None:
        pass

    if not lack_of("explore"):
        monkeypatch.setattr("uvicorn.Server.serve", serve)
    monkeypatch.setattr("webbrowser.open", lambda _: None)


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Let the command `init` run in an empty folder: it replaces no file."""
    return lambda command: monkeypatch.chdir(tmp_path) if command == "init" else None


def _with_marks(lines: Iterable[str]) -> list[Any]:
    needs = [pytest.mark.needs("explore")]
    return [pytest.param(each, marks=needs * ("explore" in each)) for each in lines]


@pytest.mark.slow
@pytest.mark.parametrize("line", _with_marks(EXAMPLES))
@pytest.mark.usefixtures("no_figures", "no_page")
def test_an_example_runs(line: str, folder: Path, elsewhere: Callable[[str], None]) -> None:
    program, *words = shlex.split(line)
    elsewhere(words[0])
    if program != "pfdist" or ">" in words:
        _run_in_bash(line, folder)
        return
    assert main(_shortened(words)) == 0


@pytest.mark.slow
@pytest.mark.parametrize("command", _with_marks(COMMANDS))
@pytest.mark.usefixtures("folder", "no_figures", "no_page")
def test_every_command_prints_one_json_object(
    command: str, call: Callable[..., Any], elsewhere: Callable[[str], None]
) -> None:
    elsewhere(command)
    example = next(iter(COMMANDS[command].examples))
    in_bash = {"completion": ["completion", "bash"], "schema": ["schema"]}
    words = in_bash.get(command) or _shortened(shlex.split(example)[1:])
    called = call("", *words, "--json")
    assert called.code == 0, called.err
    assert isinstance(json.loads(called.out), dict)


def _shortened(words: list[str]) -> list[str]:
    """The words with options for less work; an option that is given keeps its place."""
    shorter = shlex.split(_SHORTER.get(words[0], ""))
    shortened = list(words)
    for option, value in zip(shorter[::2], shorter[1::2], strict=True):
        if option in words and option != "--set":
            shortened[words.index(option) + 1] = value
        else:
            shortened += [option, value]
    return shortened


def _run_in_bash(line: str, home: Path) -> None:
    """Run a line that only a shell understands; the folder it writes to is there."""
    (home / ".config" / "fish" / "completions").mkdir(parents=True, exist_ok=True)
    (home / ".zfunc").mkdir(exist_ok=True)
    program = f'pfdist() {{ {shlex.quote(sys.executable)} -m pfdist "$@"; }}'
    environment = {**os.environ, "HOME": str(home)}
    bash = shutil.which("bash") or "bash"
    subprocess.run([bash, "-ec", f"{program}\n{line}"], check=True, timeout=300, env=environment)


TAKE_A_RUN = ["compare", "list", "plot", "report", "status", "table", "verify"]
ASK = {"bound": [], "filter": ["patient.csv"], "next": ["patient.csv"], "rule": [], "why": []}


@pytest.mark.plugins("runs")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in (*ASK, "plot", "report")))
        for name in (*TAKE_A_RUN, *ASK)
    ],
)
@pytest.mark.usefixtures("no_figures")
def test_a_command_about_a_run_opens_the_committed_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(COMMITTED, "example")
    Path("patient.csv").write_text("t,y0\n1,0.3\n2,5.1\n3,2.2\n")
    words = {"compare": ["example/job.toml", "example"]}.get(name, ["example"])
    if name in ASK:
        words = ["example/job.toml", *ASK[name]]
    assert main([name, *words, *shlex.split(_SHORTER.get(name, ""))]) == 0


def test_the_committed_run_is_the_one_that_its_command_makes_today() -> None:
    """results/README.md names the command: `pfdist run jobs/quick.toml`."""
    about, job = read_recorded(COMMITTED)
    assert job == pfdist.load_job(JOBS / "quick.toml").identity()
    assert about["kernel"] == KERNEL_VERSION
    assert pfdist.open_run(COMMITTED).state == "finished"
