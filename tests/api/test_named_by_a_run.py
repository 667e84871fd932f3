"""A run's folder has nothing run: what it names is compared first, and must be the user's own."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomli_w

import pfdist
from pfdist import Job
from pfdist.api.why import why
from pfdist.cli.main import main
from pfdist.job.job import load_job

SMALL = Path(__file__).parents[1] / "small.toml"
HOSTILE = "open({flag!r}, 'w').close()\nfrom pfdist.models.ungm import model\n"
QUICK = ["search.random.evaluations=3", "search.genetic.generations=1", "comparison.draws=20"]


class Folder:
    """A run's folder as a stranger may hand it on: its job and run.json say what they like."""

    def __init__(self, job: Job, path: Path) -> None:
        self.path, self.flag = path, path.parent / "executed"
        self.job = job.with_changes([*QUICK, f"model.name={self.file}:model"])
        self.file.write_text(HOSTILE.format(flag=str(self.flag)))

    @property
    def file(self) -> Path:
        return self.path.parent / "mine.py"

    @property
    def about(self) -> dict[str, Any]:
        about: dict[str, Any] = json.loads((self.path / "run.json").read_text())
        return about

    def names(self, model: str, files: Any = None, part: str = "model") -> None:
        """Have the run name a model, with the hashes that its maker says."""
        about, job = self.about, load_job(self.path / "job.toml").identity()
        section = job["model"] if part == "model" else job["model"].setdefault("filter", {})
        section["name"] = model
        if part != "model":
            job["model"]["name"] = "ungm"
        (self.path / "job.toml").write_text(tomli_w.dumps(job))
        if files is not None:
            about["provenance"]["files"] = files
        (self.path / "run.json").write_text(json.dumps(about))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("finished")
    (path / "small.toml").write_text(SMALL.read_text())
    pfdist.run(load_job(path / "small.toml").with_changes(QUICK), path / "run", figures=False)
    return path / "run"


@pytest.fixture
def folder(
    small_job: Job, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Folder:
    """A finished run whose model the user of this machine has never run."""
    monkeypatch.setattr("pfdist.api.why.draw_figures", lambda *run: [])
    own = tmp_path / "own"
    own.mkdir()
    monkeypatch.setattr("pfdist.meaning.known_models.own_folder", lambda: own)
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished, tmp_path / "run")
    made = Folder(small_job, tmp_path / "run")
    made.names(f"{made.file}:model", {"model": _digest(made.file)})
    return made


def _digest(path: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest()}


def _inside(folder: Folder) -> Path:
    return Path(folder.file.rename(folder.path / "mine.py"))


def in_the_folder(folder: Folder) -> None:
    file = _inside(folder)
    folder.names("mine.py:model", {"model": _digest(file), "filter_model": _digest(file)})


def above_it(folder: Folder) -> None:
    folder.names("../mine.py:model", {"model": _digest(folder.file)})


def of_the_filter(folder: Folder) -> None:
    files = {"model": {}, "filter_model": _digest(folder.file)}
    folder.names(f"{folder.file}:model", files, part="filter_model")


def through_a_link(folder: Folder) -> None:
    (folder.path / "linked.py").symlink_to(folder.file)
    digest = _digest(folder.path / "linked.py")
    folder.names(f"{folder.path}/linked.py:model", {"model": digest})


def edited(folder: Folder) -> None:
    folder.file.write_text(folder.file.read_text() + "# a word\n")


def gone(folder: Folder) -> None:
    folder.file.unlink()


def a_pipe(folder: Folder) -> None:
    gone(folder)
    os.mkfifo(folder.file)


def a_folder(folder: Folder) -> None:
    gone(folder)
    folder.file.mkdir()


def with_hashes(files: Any) -> Callable[[Folder], None]:
    def change(folder: Folder) -> None:
        folder.names(f"{folder.file}:model", files)

    return change


def named(name: str) -> Callable[[Folder], None]:
    return lambda folder: folder.names(name)


NEVER_RUN = "you have not run it on this machine, so nothing was run"
UNSAID = "does not say what its model's file mine.py held, so nothing was run"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        pytest.param(lambda folder: None, NEVER_RUN, id="an absolute path with its hash"),
        pytest.param(in_the_folder, NEVER_RUN, id="a file in the run's folder with its hash"),
        pytest.param(above_it, NEVER_RUN, id="a file above the run's folder"),
        pytest.param(of_the_filter, NEVER_RUN, id="a file for the filter"),
        pytest.param(through_a_link, NEVER_RUN, id="a link"),
        pytest.param(edited, "mine.py is not the file that", id="a file that was edited"),
        pytest.param(gone, "mine.py, which cannot be read", id="no file"),
        pytest.param(a_pipe, "mine.py, which cannot be read", id="a pipe"),
        pytest.param(a_folder, "mine.py, which cannot be read", id="a folder in its place"),
        pytest.param(with_hashes({}), UNSAID, id="no hashes"),
        pytest.param(with_hashes([1]), UNSAID, id="hashes that are a list"),
        pytest.param(with_hashes({"model": {"mine.py": 5}}), UNSAID, id="a hash that is a number"),
        pytest.param(
            with_hashes({"model": {"mine.py": "0" * 64, "../../x.py": "0" * 64}}),
            UNSAID,
            id="a file beside that lies elsewhere",
        ),
        pytest.param(
            named("os:system"), "model.name: a model must be one of", id="a module's function"
        ),
        pytest.param(named("os"), "model.name: a model must be one of", id="a module"),
        pytest.param(named("/dev/zero.py:m"), "held, so nothing was run", id="no such device"),
        pytest.param(named("a" * 10**6 + ".py:m"), "names must have at most", id="a long name"),
    ],
)
def test_a_strangers_folder_has_nothing_run(
    change: Callable[[Folder], None],
    says: str,
    folder: Folder,
    capsys: pytest.CaptureFixture[str],
) -> None:
    change(folder)
    capsys.readouterr()
    job = folder.path / "job.toml"
    for command in (["why", str(folder.path)], ["evaluate", str(job), "--times", "0,3,6,9"]):
        assert main(command) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("pfdist: ")
        assert says in line
        assert len(line) < 1000
        assert not folder.flag.exists()


def test_what_the_user_has_run_or_names_runs_and_is_said_before(folder: Folder) -> None:
    model, run = f"{folder.file}:model", str(folder.path)
    said: list[tuple[str, bool]] = []

    def say(line: str) -> None:
        said.append((line, folder.flag.exists()))

    why(run, draws=2, model=model, say=say, figures=False)
    assert said[0] == (f"runs the model {model}, as you name it", False)
    folder.flag.unlink()
    said.clear()
    why(run, draws=2, say=say, figures=False)  # it was run, and so it is known
    line, executed = said[0]
    assert line.startswith(f"runs the model file {folder.file}, named by {run}: unchanged")
    assert not executed
    folder.flag.unlink(missing_ok=True)
    for _ in ("starting", "going on"):
        said.clear()
        pfdist.run(folder.job, folder.path.with_name("other"), say=say, figures=False)
        assert said[0] == (f"runs the model file {folder.file}, which your job names", False)
        folder.flag.unlink(missing_ok=True)


def test_files_beside_the_model_that_the_run_does_not_name_are_not_run(
    folder: Folder, tmp_path: Path
) -> None:
    name, flag = "a_helper_that_is_nowhere", tmp_path / "helped"
    text = f"try:\n    import {name}\nexcept ImportError:\n    pass\n"
    folder.file.write_text(text + "from pfdist.models.ungm import model\n")
    run = pfdist.run(folder.job, tmp_path / "other", figures=False)
    (tmp_path / f"{name}.py").write_text(f"open({str(flag)!r}, 'w').close()\n")
    why(run.path, draws=2, figures=False)
    assert not flag.exists()
