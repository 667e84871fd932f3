"""Ended, or failed, at every single file operation of a run, and run again: the same bytes."""

import contextlib
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import pfdist
from oracles.bytes_of import hashes
from oracles.counted import A_DRAW, committed_draws, count_draws
from oracles.file_layer import Ended, FileLayer
from pfdist import Job, load_job
from pfdist.errors import StoreError
from pfdist.plugins.rule.ruling import tuned
from pfdist.runner import comparison_phase, door, gap_terms
from pfdist.runner.bound_settings import LEAST_DRAWS
from pfdist.runner.pace import Pace
from pfdist.store import parquet
from pfdist.store.verify import verify_run

CHANGES = [
    "search.genetic.generations=2",
    "search.genetic.population=4",
    "search.random.evaluations=2",
    "evaluation.draws=30",
    "comparison.draws=80",
]
ONLINE = """
[online]
judging_draws = 20
search.method = "corridor"
search.rounds = 1
search.evaluation.draws = 10
search.evaluation.particles = 10
"""
FAULTS = {"ended": Ended, "ENOSPC": StoreError, "EIO": StoreError}
faults = pytest.mark.parametrize(
    "fault", ["ended", *(pytest.param(each, marks=pytest.mark.crash) for each in ("ENOSPC", "EIO"))]
)
LAST = 12  # operations, by which a run keeps its summary; it is as good without one
SAYS = r"cannot (write|remove|move|lock) [^\n]*: (No space left on device|Input/output error);"
SAYS += r" finished work is saved, run the same command again once this is fixed$"


@pytest.fixture
def layer(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> FileLayer:
    monkeypatch.setattr(door, "COMMIT_SECONDS", 0.0)
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: 150 * A_DRAW)
    monkeypatch.setattr(comparison_phase, "TRAJECTORIES", 30)
    monkeypatch.setattr(comparison_phase, "LOSS_DRAWS", 10)
    monkeypatch.setitem(parquet.ROWS_IN_A_FILE, "comparison", 50)
    monkeypatch.setitem(parquet.ROWS_IN_A_FILE, "draws", 120)
    return FileLayer(monkeypatch, tmp_path)


def _fresh(job: Job, path: Path) -> Job:
    return job


def _grown(job: Job, path: Path) -> Job:
    pfdist.run(job, path, figures=False)
    return job.with_changes(["comparison.draws=110"])


def _lost(job: Job, path: Path) -> Job:
    """A finished run from which damaged files were removed."""
    pfdist.run(job, path, figures=False)
    for file in sorted((path / "tables" / "draws").glob("genetic-*"))[:2]:
        file.unlink()
    next((path / "tables" / "comparison").glob("comparison-00001-*")).unlink()
    (path / "job.toml").unlink()
    return job


def _unlisted(job: Job, path: Path) -> Job:
    """A finished run that has lost the list of its files."""
    pfdist.run(job, path, figures=False)
    (path / "files.json").unlink()
    return job


@pytest.mark.parametrize("step", [19, pytest.param(1, marks=pytest.mark.crash)])
@pytest.mark.parametrize(
    ("begin", "fault"),
    [
        *((_fresh, "ended"), (_grown, "ENOSPC"), (_lost, "ended")),
        *(
            pytest.param(begin, fault, marks=pytest.mark.crash)
            for begin, fault in ((_fresh, "EIO"), (_lost, "ENOSPC"), (_unlisted, "ended"))
        ),
    ],
)
def test_a_run_that_goes_wrong_at_any_file_operation_ends_with_the_same_bytes(
    begin: Callable[[Job, Path], Job],
    fault: str,
    step: int,
    small_job: Job,
    tmp_path: Path,
    layer: FileLayer,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counted = count_draws(monkeypatch)
    job = begin(small_job.with_changes(CHANGES), tmp_path / "begun")
    (tmp_path / "begun").mkdir(exist_ok=True)
    untouched = shutil.copytree(tmp_path / "begun", tmp_path / "whole")
    count = layer.run(partial(pfdist.run, job, untouched, figures=False))
    whole, needed = hashes(untouched), committed_draws(untouched)
    assert count > 40
    for at in range(0, count, step):
        path, said = shutil.copytree(tmp_path / "begun", tmp_path / f"{at}"), []
        with _fails(fault, None if fault == "ended" else SAYS, may_succeed=at >= count - LAST):
            layer.run(partial(pfdist.run, job, path, say=said.append, figures=False), fault, at)
        where = f"{fault} at operation {at} of {count}"
        was_whole = begin in (_fresh, _grown)
        committed = committed_draws(path) if was_whole else None
        if (path / "run.json").exists() and was_whole:
            pfdist.open_run(path).as_json()  # whoever asks how far it is gets an answer
        counted.clear()
        pfdist.run(job, path, say=said.append, figures=False)
        assert hashes(path) == whole, where
        assert committed is None or sum(counted) == needed - committed, where
        assert not list(path.glob("parts/**/*.parquet")), where
        assert not list(verify_run(path)), where
        expected = ("is ready: ", "ended without a message: ")
        assert not [line for line in said if not any(map(line.count, expected))], where
        shutil.rmtree(path)


def _fails(
    fault: str, says: str | None, *, may_succeed: bool
) -> contextlib.AbstractContextManager[object]:
    """Expect the error of a fault; after a kill nothing succeeds."""
    if may_succeed and fault != "ended":
        return contextlib.suppress(StoreError)
    return pytest.raises(FAULTS[fault], match=says)


def go_wrong(
    compute: Callable[[Path], object],
    begun: Path,
    layer: FileLayer,
    step: int,
    fault: str,
    look: Callable[[Path], None],
    says: str | None = None,
    *,
    may_succeed: bool = False,
) -> None:
    """Let a fault end a computation at each so many file operations, and go on: the same bytes.

    The caller looks at each run before it goes on.
    """
    untouched = shutil.copytree(begun, begun.with_name("whole"))
    count = layer.run(partial(compute, untouched))
    whole = hashes(untouched)
    assert count > 15
    for at in range(step // 2, count, step):
        path, where = begun.with_name(f"{at}"), f"{fault} at operation {at} of {count}"
        shutil.copytree(begun, path)
        with _fails(fault, says, may_succeed=may_succeed or at >= count - LAST):
            layer.run(partial(compute, path), fault, at)
        look(path)
        compute(path)
        assert hashes(path) == whole, where
        assert not list(path.glob("parts/**/*.parquet")), where
        assert not list(verify_run(path)), where
        shutil.rmtree(path)


@pytest.mark.parametrize("step", [97, pytest.param(1, marks=pytest.mark.crash)])
@faults
def test_a_bound_that_goes_wrong_at_any_file_operation_ends_with_the_same_bytes(
    fault: str,
    step: int,
    small_job: Job,
    tmp_path: Path,
    layer: FileLayer,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A bound of 480 draws that grows to 960, in files of 8 blocks."""
    monkeypatch.setattr(gap_terms, "SET_DRAWS", 60)
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: 10**9)  # a task for each work
    monkeypatch.setitem(parquet.ROWS_IN_A_FILE, "error_sums", 8)
    job = small_job.with_changes([*CHANGES, "model.name=random_walk", "problem.horizon=6"])
    begun = pfdist.run(job, tmp_path / "begun", figures=False).path
    few, many = LEAST_DRAWS, 2 * LEAST_DRAWS
    pfdist.bound(job, few, results=begun, figures=False)

    def prove(path: Path) -> None:
        pfdist.bound(job, many, results=path, figures=False)

    def look(path: Path) -> None:
        assert pfdist.open_run(path).state == "finished"

    go_wrong(prove, begun, layer, step, fault, look)


@pytest.mark.parametrize("step", [97, pytest.param(1, marks=pytest.mark.crash)])
@faults
def test_online_draws_that_go_wrong_at_any_file_operation_end_with_the_same_bytes(
    fault: str,
    step: int,
    small_job: Job,
    tmp_path: Path,
    layer: FileLayer,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Four draws whose times are chosen one after another, which grow to eight."""
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: 1)  # a task for each draw
    text = small_job.path.read_text()
    small_job.path.write_text(f"{text}\n{ONLINE}")
    few, many = (load_job(small_job.path, [*CHANGES, f"online.draws={draws}"]) for draws in (4, 8))
    begun = pfdist.run(few, tmp_path / "begun", figures=False).path
    again, says = partial(pfdist.run, many, figures=False), None if fault == "ended" else SAYS

    def look(path: Path) -> None:
        pfdist.open_run(path).as_json()  # whoever asks how far it is gets an answer

    go_wrong(again, begun, layer, step, fault, look, says)


ASKS: dict[str, tuple[list[str], Callable[[Job, Path], object]]] = {
    "opponent": (
        ["comparison.reference=evenly spaced"],
        lambda job, path: pfdist.run(job, path, figures=False),
    ),
    "smoothed proof": (
        ["problem.estimate=smoothed"],
        lambda job, path: pfdist.bound(job, LEAST_DRAWS, results=path, figures=False),
    ),
    "rule": ([], lambda job, path: pfdist.rule(job, results=path, figures=False)),
}


@pytest.mark.parametrize("step", [601, pytest.param(61, marks=pytest.mark.crash)])
@pytest.mark.parametrize("asked", ASKS)
@faults
def test_an_opponent_a_proof_or_a_rule_that_goes_wrong_at_any_operation_ends_with_the_same_bytes(
    fault: str,
    asked: str,
    step: int,
    small_job: Job,
    tmp_path: Path,
    layer: FileLayer,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The ranking, the evaluation from coarse to fine and the race; smoothed sums; the sweeps."""
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: 10**7)
    monkeypatch.setattr("pfdist.plugins.rule.question.tuned", partial(tuned, draws=60))
    changes, ask = ASKS[asked]
    small = [*CHANGES, "model.name=random_walk", "problem.horizon=6", *changes]
    job, begun = small_job.with_changes(small), tmp_path / "begun"
    if asked == "opponent":
        begun.mkdir()
    else:
        step *= 2  # they have more operations
        pfdist.run(job, begun, figures=False)

    def look(path: Path) -> None:
        if (path / "run.json").exists():
            pfdist.open_run(path).as_json()  # whoever asks how far it is gets an answer

    def compute(path: Path) -> None:
        ask(job, path)

    go_wrong(compute, begun, layer, step, fault, look)
    phases = {path.name.split("-")[0] for path in tmp_path.glob("whole/tables/draws/*")}
    if asked == "opponent":
        assert {"evenly_spaced.coarse", "evenly_spaced.shortlist"} <= phases
    elif asked == "rule":
        assert {"rule.draws.sweep4", "rule.draws.choice"} <= phases


@pytest.mark.plugins("why")
@pytest.mark.parametrize("step", [5, pytest.param(1, marks=pytest.mark.crash)])
@faults
def test_the_worth_of_measurements_that_goes_wrong_at_any_file_operation_has_the_same_bytes(
    fault: str, step: int, small_job: Job, tmp_path: Path, layer: FileLayer
) -> None:
    """The answer on 10 draws takes the place of that on 5."""
    job = small_job.with_changes(CHANGES)
    begun = pfdist.run(job, tmp_path / "begun", figures=False).path
    pfdist.why(job, 5, results=begun, figures=False)

    def ask(path: Path) -> None:
        pfdist.why(job, 10, results=path, figures=False)

    def look(path: Path) -> None:
        assert pfdist.open_run(path).state == "finished"
        assert set(pfdist.open_run(path).table("worth")["draws"]) <= {5, 10}
        assert set(pfdist.open_run(path).table("sampling_windows")["draws"]) <= {5, 10}

    go_wrong(ask, begun, layer, step, fault, look, may_succeed=True)


@pytest.mark.parametrize(
    ("fault", "step"),
    [("ended", 7), *(pytest.param(fault, 1, marks=pytest.mark.crash) for fault in FAULTS)],
)
def test_a_report_is_there_whole_or_not_at_all_and_its_failure_fails_no_run(
    fault: str, step: int, small_job: Job, tmp_path: Path, layer: FileLayer
) -> None:
    job = small_job.with_changes(CHANGES)
    file, said = tmp_path / "run" / "report.html", list[str]()
    pfdist.run(job, file.parent, figures=False, report=True)
    whole = file.read_bytes()
    file.unlink()
    again = partial(pfdist.run, job, file.parent, figures=False, report=True, say=said.append)
    count = layer.run(again)
    assert file.read_bytes() == whole
    for at in range(0, count, step):
        file.unlink()
        if fault == "ended":
            with pytest.raises(Ended):
                layer.run(again, fault, at)
        else:
            with contextlib.suppress(StoreError):  # of the lock; a report's is only told
                layer.run(again, fault, at)
        assert not file.exists() or file.read_bytes() == whole
        again()
        assert file.read_bytes() == whole, f"{fault} at operation {at} of {count}"
    if fault != "ended":
        assert [line for line in said if line.startswith("there is no report: cannot write")]


@pytest.mark.parametrize("step", [23, pytest.param(1, marks=pytest.mark.crash)])
@faults
def test_a_figure_is_there_whole_or_not_at_all(
    fault: str,
    step: int,
    small_job: Job,
    tmp_path: Path,
    layer: FileLayer,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **options: path.write_text("it"))
    run = pfdist.run(small_job.with_changes(CHANGES), tmp_path / "run", figures=False)
    before = shutil.copytree(run.path, tmp_path / "before")
    again = partial(pfdist.run, small_job.with_changes(CHANGES), run.path, report=False)
    count = layer.run(again)
    whole = hashes(run.path)
    assert count > 20
    for at in range(0, count, step):
        shutil.rmtree(run.path)
        shutil.copytree(before, run.path)
        # That the list of pages cannot be written is a warning: figures can be drawn again.
        raises = pytest.raises(Ended) if fault == "ended" else contextlib.suppress(FAULTS[fault])
        with raises:
            layer.run(again, fault, at)
        again()
        assert hashes(run.path) == whole, f"{fault} at operation {at} of {count}"
