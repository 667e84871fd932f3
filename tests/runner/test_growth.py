"""A run that grows or reuses another computes only the new, with the same bytes."""

import random
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.counted import A_DRAW, SETS, count_draws
from oracles.results_of import results_of
from pfdist import Job
from pfdist.cli.main import main
from pfdist.errors import StoreError
from pfdist.pools.base import Outcome, SerialPool
from pfdist.runner import comparison_phase
from pfdist.runner.pace import Pace
from pfdist.runner.progress import Progress

BLOCK, MOST = 50, 430


@pytest.fixture
def all_draws(finished: Callable[..., Path]) -> pfdist.Run:
    return pfdist.open_run(finished(f"comparison.draws={MOST}"))


@pytest.fixture(autouse=True)
def _small_blocks(
    finished: Callable[..., Path], all_draws: pfdist.Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    finished()  # runs that are shared are computed by the program as it is
    for module in ("results.stored_run", "runner.comparison_phase"):
        monkeypatch.setattr(f"pfdist.{module}.BLOCK", BLOCK)
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: BLOCK * SETS * A_DRAW)


def test_order_and_kills_change_no_byte(
    small_job: Job, all_draws: pfdist.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = small_job.with_changes([f"comparison.draws={MOST}"])
    chance, do = random.Random(0), SerialPool.run

    def in_disorder(self: SerialPool, tasks: Any) -> Iterator[Outcome]:
        tasks = iter(tasks)
        while some := list(islice(tasks, 8)):
            chance.shuffle(some)
            for outcome in do(self, some):
                if chance.random() < 0.1:
                    raise KeyboardInterrupt
                yield outcome

    monkeypatch.setattr(SerialPool, "run", in_disorder)
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: chance.randrange(30, 200) * A_DRAW)
    kills = 0
    while True:
        try:
            pfdist.run(job, tmp_path / "run", figures=False)
            break
        except KeyboardInterrupt:
            kills += 1
    assert kills > 0
    assert hashes(tmp_path / "run") == hashes(all_draws.path)


def test_what_is_shown_at_the_end_is_what_the_summary_says(small_job: Job, tmp_path: Path) -> None:
    seen: list[Progress] = []
    run = pfdist.run(small_job, tmp_path / "run", progress=seen.append, figures=False)
    results = results_of(run)
    assert [found.label for found in seen[-1].found] == ["genetic plan", "random plan"]
    for found in seen[-1].found:
        [result] = (each for each in results.values() if each.label == found.label)
        assert found.gain_of_means.value == result.gain_of_means
    assert seen[-1].done == seen[-1].total
    assert len({state.found for state in seen}) > 2  # it is shown as it comes


def test_a_kill_in_the_midst_shows_what_was_found_before(
    small_job: Job, tmp_path: Path, stopped: Callable[..., None]
) -> None:
    stopped(small_job, tmp_path / "run", "comparison", 200)
    seen: list[Progress] = []
    known = pfdist.open_run(tmp_path / "run")
    assert (known.state, known.draws_compared) == ("comparing", 200)
    gain = results_of(known)["genetic"].gain_of_means
    pfdist.run(small_job, tmp_path / "run", progress=seen.append, figures=False)
    first = next(state for state in seen if state.found)
    assert first.evaluations == 200
    assert first.found[0].gain_of_means.value == gain


def _tree(run: Path) -> dict[Path, bytes]:
    return {path.relative_to(run): path.read_bytes() for path in run.rglob("*") if path.is_file()}


def test_a_run_that_reuses_another_computes_only_what_is_new_and_ends_as_a_run_from_nothing(
    small_job: Job,
    small_run: pfdist.Run,
    tmp_path: Path,
    stopped: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    old, new = small_run.path, tmp_path / "new"
    known = set(small_run.table("evaluations")["evaluation"])
    counted = count_draws(monkeypatch)
    longer = small_job.with_changes(["search.genetic.generations=6"])
    nothing = pfdist.run(longer, tmp_path / "nothing", figures=False)
    from_nothing = sum(counted)
    before = _tree(old)
    counted.clear()
    stopped(longer, new, "random", 0, reuse=old)
    run = pfdist.run(longer, new, reuse=[old], figures=False)
    same = known & set(run.table("evaluations")["evaluation"])
    assert len(same) == len(known) >= 10  # earlier generations, and all random trials
    assert sum(counted) == from_nothing - len(same) * small_job.evaluation.draws
    assert hashes(new) == hashes(nothing.path)
    assert _tree(old) == before
    assert pfdist.run(longer, new, figures=False).state == "finished"  # it stands on its own


def test_a_damaged_run_lends_nothing(small_job: Job, small_run: pfdist.Run, tmp_path: Path) -> None:
    (file,) = small_run.path.glob("tables/draws/genetic-*")
    content = file.read_bytes()
    file.write_bytes(content[:100] + bytes([content[100] ^ 4]) + content[101:])
    with pytest.raises(StoreError, match=f"{file.name} is damaged"):
        pfdist.run(small_job, tmp_path / "new", reuse=small_run.path, figures=False)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("engine", ["compiled", "numpy"])
def test_a_run_of_another_processor_lends_what_has_the_same_bytes_here(
    engine: str, small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # NumPy may round a last digit in another way there; compiled formulas never do.
    few = ["evaluation.draws=5", "comparison.draws=50"]
    job = small_job.with_changes([f"filter.engine={engine}", *few])
    lender = pfdist.run(job, tmp_path / "old", figures=False).path
    elsewhere = {"compiled_for": "other", "model": "another processor"}
    monkeypatch.setattr("pfdist.runner.provenance.processor", lambda: elsewhere)
    options: dict[str, Any] = {"reuse": lender, "figures": False}
    if engine == "numpy":
        with pytest.raises(StoreError, match=r"another processor .* depend on the processor"):
            pfdist.run(job, tmp_path / "new", **options)
    else:
        assert pfdist.run(job, tmp_path / "new", **options).state == "finished"


@pytest.mark.usefixtures("no_figures")
def test_the_command_line_reuses_runs(
    small_job: Job, small_run: pfdist.Run, tmp_path: Path
) -> None:
    old, new = str(small_run.path), str(tmp_path / "new")
    command = ["run", str(small_job.path), "--results"]
    change = ["--set", "search.genetic.generations=5"]
    assert main([*command, old, *change]) == 1
    assert main([*command, new, *change, "--reuse", old]) == 0
    rows = pfdist.open_run(new).table("evaluations").query("phase == 'genetic'")
    assert rows["generation"].nunique() == 5
    assert main([*command, str(tmp_path / "b"), "--reuse", str(tmp_path / "no")]) == 1


@pytest.mark.parametrize("committed", [[], [range(1, 9)], [range(3), range(4, 9)]])
def test_a_table_that_lacks_committed_draws_is_not_published(committed: list[range]) -> None:
    """As where another driver has taken the parts away."""
    store: Any = SimpleNamespace(path="run", has_parts=lambda *_: True, draws=lambda *_: committed)
    with pytest.raises(StoreError, match="lacks draws that were committed"):
        comparison_phase._publish(store, 8, 0)
