"""The summary of a run says what its tables say, or nothing."""

import contextlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import pfdist
from oracles.file_layer import Ended, FileLayer
from pfdist.cli.own import verify
from pfdist.errors import StoreError
from pfdist.plugins.runs.runs_table import runs_table
from pfdist.results.sets import fault_of_summary, publish_sets, rows_of_sets
from pfdist.results.summary import summary_of
from pfdist.store.folder import SUMMARY
from pfdist.store.listing import change_listing, read_listing, record_pages
from pfdist.store.verify import verify_run

Finished = Callable[..., Path]
Summary = dict[str, Any]
Change = Callable[[Summary], None]
CHANGES = [
    (),
    ("budget.least=2", "budget.most=3", 'search=[{method="relaxation", polish=false}]'),
    ("filter.engine=kalman", "model.name=random_walk"),
    ('problem.clock={start="2026-03-28", step="6 h"}', "problem.horizon=72"),
]


@pytest.fixture(params=CHANGES, ids=["plain", "budget", "exact", "dates"])
def run(request: pytest.FixtureRequest, finished: Finished, tmp_path: Path) -> pfdist.Run:
    own = shutil.copytree(finished(*request.param), tmp_path / "run")
    return pfdist.open_run(own)


def test_a_list_and_tables_are_the_same_with_and_without_a_summary(run: pfdist.Run) -> None:
    assert summary_of(run) is not None
    kept = pfdist.list_runs(run.path), runs_table([run]), run.table("sets")
    rows = [*map(vars, rows_of_sets(run))]
    (run.path / SUMMARY).unlink()
    assert summary_of(run) is None
    now = pfdist.list_runs(run.path), runs_table([run]), run.table("sets")
    for frame, again in zip(kept, now, strict=True):
        without = [name for name in ("bytes", "changed") if name in frame]
        pd.testing.assert_frame_equal(frame.drop(columns=without), again.drop(columns=without))
    assert rows == [*map(vars, rows_of_sets(run))]


def test_a_summary_counts_for_nothing_once_a_table_has_changed(small_run: pfdist.Run) -> None:
    run = small_run
    listing = read_listing(run.path)
    assert listing is not None
    change_listing(run.path, files=listing.files[1:])
    assert summary_of(run) is None
    change_listing(run.path, files=listing.files)
    assert summary_of(run) is not None
    part = run.path / "parts/comparison/comparison-0123456789abcdef.parquet"
    part.parent.mkdir(parents=True, exist_ok=True)
    part.write_bytes(b"")
    assert summary_of(run) is None


def test_a_damaged_summary_is_not_read(small_run: pfdist.Run) -> None:
    run = small_run
    content = (run.path / SUMMARY).read_bytes()
    (run.path / SUMMARY).write_bytes(content[:-9] + b"x" + content[-8:])
    assert summary_of(run) is None
    assert [SUMMARY in line for line in verify_run(run.path)] == [True]


@pytest.mark.parametrize(
    "fault",
    ["ended", "ENOSPC", *(pytest.param(f, marks=pytest.mark.slow) for f in ("EIO", "EROFS"))],
)
def test_a_kill_or_a_full_disk_leaves_a_summary_and_an_export_whole_or_none(
    fault: str, small_run: pfdist.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At each operation on a file; then both can be written, and nothing is left beside them."""
    run, export = small_run, tmp_path / "plan.csv"
    layer, former = FileLayer(monkeypatch, tmp_path), b"measurement,t\n1,12\n"
    run.export(export)
    whole, summary = export.read_bytes(), (run.path / SUMMARY).read_bytes()

    def write() -> None:
        publish_sets(run)  # a run is as good without its summary, so this raises no error
        run.export(export)

    (run.path / SUMMARY).unlink()
    count = layer.run(write)
    assert count > 10
    for at in range(count):
        export.write_bytes(former)
        (run.path / SUMMARY).unlink(missing_ok=True)
        with contextlib.suppress(Ended, StoreError):
            layer.run(write, fault, at)
        assert export.read_bytes() in (former, whole)
        assert [*map(str, verify_run(run.path))] == []
        write()
        assert (export.read_bytes(), (run.path / SUMMARY).read_bytes()) == (whole, summary)
        assert summary_of(run) is not None


def test_a_file_of_the_user_is_not_replaced(finished: Finished, tmp_path: Path) -> None:
    own = tmp_path / "run"
    shutil.copytree(finished(), own)
    (own / SUMMARY).unlink()
    (own / SUMMARY).write_text('{"table": "mine"}')
    content = (own / SUMMARY).read_bytes()
    publish_sets(pfdist.open_run(own))
    assert (own / SUMMARY).read_bytes() == content
    (own / SUMMARY).unlink()
    publish_sets(pfdist.open_run(own))
    assert summary_of(pfdist.open_run(own)) is not None


def _many(summary: Summary) -> None:
    summary["sets"] *= 9_000


def _of_wrong_type(summary: Summary) -> None:
    summary["sets"][0]["expected_mse"] = "1.0"


def _of_dictionaries(summary: Summary) -> None:
    summary["sets"][0]["description"] = {"x": "y"}


def _of_deep_lists(summary: Summary) -> None:
    for _ in range(100):
        summary["sets"] = [summary["sets"]]


def _without_rows(summary: Summary) -> None:
    summary["sets"].clear()


def _without(key: str) -> Change:
    def change(summary: Summary) -> None:
        del summary[key]

    return change


def _with_errors_times(factor: float) -> Change:
    def change(summary: Summary) -> None:
        for row in summary["sets"]:
            row["expected_mse"] *= factor

    return change


@pytest.mark.parametrize(
    "change",
    [_many, _of_wrong_type, _of_dictionaries, _of_deep_lists, _without_rows, _without("made_of"),
     _without("worker_seconds")],
)  # fmt: skip
def test_a_forged_summary_costs_nothing_and_is_not_read(
    change: Change, finished: Finished, tmp_path: Path
) -> None:
    """The hash in files.json is repaired, as whoever sends a folder may do."""
    forged = _forged(change, finished, tmp_path)
    assert summary_of(forged) is None
    assert forged.table("sets")["expected_mse"].notna().all()
    with pytest.raises(StoreError, match=r"sets\.json cannot be used: .*: remove it"):
        list(verify(str(forged.path)))


def test_verify_compares_a_summary_with_the_tables(finished: Finished, tmp_path: Path) -> None:
    assert fault_of_summary(pfdist.open_run(finished())) == ""
    rounded = _forged(_with_errors_times(1 + 1e-14), finished, tmp_path / "rounded")
    assert fault_of_summary(rounded) == ""  # by other versions of the libraries
    forged = _forged(_with_errors_times(1 + 1e-6), finished, tmp_path)
    assert summary_of(forged) is not None
    with pytest.raises(StoreError, match="something else than the tables: remove it"):
        list(verify(str(forged.path)))


def _forged(change: Change, finished: Finished, folder: Path) -> pfdist.Run:
    path = shutil.copytree(finished(), folder / "run") / SUMMARY
    summary = json.loads(path.read_text())
    change(summary)
    path.write_text(json.dumps(summary))
    record_pages(path.parent, [path])
    return pfdist.open_run(path.parent)
