"""The summary of a run says what its tables say, or nothing."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

import pfdist
from pfdist.results.runs_table import runs_table
from pfdist.results.sets import publish_sets, rows_of_sets
from pfdist.results.summary import summary_of
from pfdist.store.folder import SUMMARY
from pfdist.store.listing import change_listing, read_listing
from pfdist.store.verify import verify_run

Finished = Callable[..., Path]
CHANGES = [
    (),
    ("budget.least=2", "budget.most=3", 'search=[{method="relaxation", polish=false}]'),
    ("filter.engine=kalman", "model.name=random_walk"),
]


@pytest.fixture(params=CHANGES, ids=["plain", "budget", "exact"])
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


def test_a_summary_counts_for_nothing_once_a_table_has_changed(run: pfdist.Run) -> None:
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


def test_a_damaged_summary_is_not_read(run: pfdist.Run) -> None:
    content = (run.path / SUMMARY).read_bytes()
    (run.path / SUMMARY).write_bytes(content[:-9] + b"x" + content[-8:])
    assert summary_of(run) is None
    assert [SUMMARY in line for line in verify_run(run.path)] == [True]


def test_a_file_of_the_user_is_not_replaced(finished: Finished, tmp_path: Path) -> None:
    own = tmp_path / "run"
    shutil.copytree(finished(), own)
    (own / SUMMARY).unlink()
    pfdist.open_run(own).table("comparison").to_parquet(own / SUMMARY)
    content = (own / SUMMARY).read_bytes()
    publish_sets(pfdist.open_run(own))
    assert (own / SUMMARY).read_bytes() == content
    (own / SUMMARY).unlink()
    publish_sets(pfdist.open_run(own))
    assert summary_of(pfdist.open_run(own)) is not None
