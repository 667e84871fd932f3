"""Fixtures that tests share: models, small jobs, and one Ray cluster a process."""

import contextlib
import fcntl
import os
import re
import shlex
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hypothesis import settings

import pfdist
from pfdist import Job, StateSpaceModel, load_job, load_model
from pfdist.cli.main import main
from pfdist.common import stopping
from pfdist.errors import started_in
from pfdist.filters.work import FilterWork
from pfdist.plugins import PLUGINS
from pfdist.pools.base import Outcome, SerialPool
from pfdist.runner.progress import Progress

sys.path.insert(0, str(Path(__file__).parent))  # for `from oracles.kalman import ...`

from oracles.extras import SkipsWithoutExtra, extra_of, lack_of
from oracles.undrawn import undraw

# No test depends on measured time, and each finds the same when it is repeated.
settings.register_profile("steady", max_examples=40, deadline=None, derandomize=True, database=None)
settings.load_profile("steady")

QUICK = ("common", "problem", "results")  # folders of tests
collect_ignore = ["oracles"]  # they have no doctests, and would be imported a second time
SMALL_JOB = (Path(__file__).parent / "small.toml").read_text()


@pytest.fixture(scope="session", autouse=True)
def no_flush() -> Iterator[None]:
    """Flush no file to the disk, which takes half of a small run: no test can cut the power.

    Processes that tests start flush theirs.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def commit_seconds(pytestconfig: pytest.Config) -> Iterator[None]:
    """Commit rows as often as ``--commit-seconds`` says: as a slow machine does, or never."""
    seconds = pytestconfig.getoption("commit_seconds")
    with pytest.MonkeyPatch.context() as patch:
        if seconds is not None:
            patch.setattr("pfdist.runner.door.COMMIT_SECONDS", seconds)
        yield


@pytest.fixture(scope="session", autouse=True)
def one_format() -> Iterator[None]:
    """Draw figures as SVG, which takes half as long as PNG; `pfdist plot` draws all formats."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pfdist.pages.figure._OWN", "svg")
        yield


class AcrossProcesses:
    """A lock that one thread of one process holds."""

    def __init__(self, path: Path) -> None:
        self._lock, self._file = threading.Lock(), path.open("w")

    def __enter__(self) -> None:
        self._lock.acquire()
        fcntl.flock(self._file, fcntl.LOCK_EX)

    def __exit__(self, *error: object) -> None:
        fcntl.flock(self._file, fcntl.LOCK_UN)
        self._lock.release()

    def close(self) -> None:
        self._file.close()


@pytest.fixture(scope="session", autouse=True)
def one_compiles(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let one process compile a function that is not kept yet; the other loads it then."""
    with contextlib.ExitStack() as stack:
        if "PYTEST_XDIST_WORKER" in os.environ:
            lock = AcrossProcesses(tmp_path_factory.getbasetemp().parent / "compiling")
            stack.callback(lock.close)
            patch = stack.enter_context(pytest.MonkeyPatch.context())
            patch.setattr("pfdist.kernels.cached._ONE_AT_A_TIME", lock)
        yield


@pytest.fixture(scope="session")
def ungm() -> StateSpaceModel:
    return load_model("ungm")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """The machine's Chromium: Debian's package chromium, or that which PFDIST_CHROMIUM names."""
    from playwright.sync_api import sync_playwright

    program = os.environ.get("PFDIST_CHROMIUM") or shutil.which("chromium")
    assert program, (
        "there is no Chromium: install Debian's package chromium, or set PFDIST_CHROMIUM"
    )
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture
def stop(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Act as if the program had received some signals; without any, forget them."""
    heard = threading.Event()
    monkeypatch.setattr(stopping, "_heard", heard)
    monkeypatch.setattr(stopping, "_received", received := list[int]())

    def receive(*numbers: int) -> None:
        received[:] = numbers
        (heard.set if numbers else heard.clear)()

    return receive


@pytest.fixture
def small_job(tmp_path: Path) -> Job:
    path = tmp_path / "small.toml"
    path.write_text(SMALL_JOB)
    return load_job(path)


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Finished runs without figures, shared by all tests of the session; nobody changes them.

    ``finished("comparison.draws=60")`` is the folder of the small job's run with this change,
    ``finished(job="...")`` that of another job, given as TOML; ``proved`` is the number of draws of
    its bound. Ask for it before you patch the program: the run is made when it is first asked for.
    """
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base  # by all processes

    def find(*changes: str, job: str = SMALL_JOB, proved: int = 0) -> Path:
        key = repr((job, changes, proved)).encode()
        folder = shared / f"finished-{sha256(key).hexdigest()[:12]}"
        if not folder.exists():
            scratch = tmp_path_factory.mktemp("scratch")
            (scratch / "job.toml").write_text(job)
            run = pfdist.run(scratch / "job.toml", scratch / "run", changes=changes, figures=False)
            if proved:
                pfdist.bound(run, proved, pool="serial", figures=False)
            with contextlib.suppress(OSError):  # another process was quicker
                scratch.rename(folder)
        return folder / "run"

    return find


@pytest.fixture
def small_run(finished: Callable[..., Path], tmp_path: Path) -> pfdist.Run:
    """A finished run of the small job, in a copy of its own: ``tmp_path / "run"``."""
    return pfdist.open_run(shutil.copytree(finished(), tmp_path / "run"))


@pytest.fixture(autouse=True)
def no_start() -> Iterator[None]:
    """A command leaves no folder behind to which later tests would show paths relative."""
    yield
    started_in("")


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """No figures and reports by a command line: they take the longest."""
    monkeypatch.setattr("pfdist.plots.draw_missing_figures", lambda run, there: [])
    monkeypatch.setattr("pfdist.questions.run.try_report", lambda run, say: None)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Save each figure as an empty picture."""
    undraw(monkeypatch)


@pytest.fixture(scope="session")
def ray_cluster() -> Iterator[None]:
    """Two CPUs, for all tests of this process that want Ray."""
    from pfdist.pools.ray_cluster import connected

    with connected("local", 2):
        yield


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """A file whose tests need a plugin that was deleted is left out."""
    if collection_path.suffix != ".py":
        return None
    named = re.findall(r"pfdist\.plugins\.(\w+)", collection_path.read_text(encoding="utf-8"))
    return True if {*named} - {*PLUGINS} else None


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--keep-golden", action="store_true", help="write the golden numbers anew")
    parser.addoption(
        "--commit-seconds", type=float, help="commit after the work of so many seconds: 0.001, inf"
    )


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(SkipsWithoutExtra())


def _deleted(*names: str) -> str:
    deleted = [name for name in names if name not in PLUGINS]
    return f"without the plugin {deleted[0]}" if deleted else ""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the quick tests and the faults; let `pytest -m crash` run the whole table of faults."""
    quick = tuple(f"tests/{folder}/" for folder in QUICK)
    for item in items:
        if extra := extra_of(item.path):
            item.add_marker(pytest.mark.needs(extra))  # it is installed: `pytest -m needs` runs it
        lacks = [lack_of(*mark.args) for mark in item.iter_markers("needs")]
        lacks += [_deleted(*mark.args) for mark in item.iter_markers("plugins")]
        for lack in filter(None, lacks):
            item.add_marker(pytest.mark.skip(reason=lack))
        if item.nodeid.startswith(quick) and not item.get_closest_marker("notebook"):
            item.add_marker("quick")
        # Slurm must be installed first, so its tests are run by their own name alone.
        own = any(item.get_closest_marker(name) for name in ("crash", "slurm"))
        if item.path.parent.name == "crash" and not own:
            item.add_marker("fault")
    if config.option.markexpr == "crash":
        for item in items:
            if item.get_closest_marker("fault"):
                item.add_marker("crash")


class Called(NamedTuple):
    code: object
    out: str
    err: str


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Callable[..., Called]:
    """Call pfdist with a line, or with words; give the exit code and what is printed."""

    def called(line: str, *words: object) -> Called:
        try:
            code: object = main([*shlex.split(line), *map(str, words)])
        except SystemExit as stop:
            code = stop.code
        return Called(code, *capsys.readouterr())

    return called


@pytest.fixture
def said(call: Callable[..., Called]) -> Callable[..., str]:
    """Call pfdist with words; give what it prints, or with another code than 0 its error."""

    def printed(*words: object, code: int = 0) -> str:
        called = call("", *words)
        assert called.code == code, called.err
        return called.err if code else called.out

    return printed


@pytest.fixture
def handed(monkeypatch: pytest.MonkeyPatch) -> list[FilterWork]:
    """The works that the serial pool has computed, from now on."""
    works, do = list[FilterWork](), SerialPool.run

    def noting(self: SerialPool, tasks: Any) -> Iterator[Outcome]:
        for outcome in do(self, tasks):
            works.extend(outcome.task.work)
            yield outcome

    monkeypatch.setattr(SerialPool, "run", noting)
    return works


@pytest.fixture(scope="session")
def stopped() -> Callable[..., None]:
    """``stopped(job, path, phase, evaluations)``: a run is stopped when a phase has come so far."""

    def stop(job: Job, path: Path, phase: str, evaluations: int = 1, **options: Any) -> None:
        def show(progress: Progress) -> None:
            if progress.phase == phase and progress.evaluations >= evaluations:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            pfdist.run(job, path, progress=show, figures=False, **options)

    return stop
