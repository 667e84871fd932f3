"""files.json: it lists what must be there, and a kill between two steps costs nothing."""

import errno
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from oracles.stored_rows import compared_rows
from pfdist.errors import BusyError, PfdistWarning, StoreError
from pfdist.store import Store, comparison_schema, files, listing, schema, tables
from pfdist.store.about import add_to_provenance, read_run, write_about
from pfdist.store.listing import change_listing, read_listing, record_pages
from pfdist.store.lock import check_not_held, held

KEY = "0123456789abcdef"
RUN = json.loads((Path(__file__).parents[1] / "assets" / "kept" / "run.json").read_text())


def _draws(evaluation: str, first: int, last: int) -> pa.Table:
    draw = np.arange(first, last)
    columns = {"evaluation": [evaluation] * draw.size, "draw": draw, "mse": 1.0 + draw}
    return pa.table({**columns, "degenerate": draw < 0}, schema=schema("draws"))


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    """A run with a published phase and a part of another one."""
    monkeypatch.setattr(tables, "_MOST_KNOWN", 0)  # each file is read, as in another process
    write_about(tmp_path, KEY, {"job.toml": "seed = 1\n", "run.json": json.dumps(RUN)})
    store = Store(tmp_path, KEY)
    store.publish("draws", "genetic", [_draws("a", 0, 5)])
    store.commit("draws", "random", _draws("b", 0, 3))
    return store


def _files(run: Path) -> list[str]:
    return sorted(str(path.relative_to(run)) for path in run.glob("[pt]a*/*/[!.]*"))


def test_the_list_names_every_published_file_and_the_hash_of_each_file_that_says_what_a_run_is(
    store: Store,
) -> None:
    content = json.loads((store.path / "files.json").read_text())
    (published,) = store.path.glob("tables/*/*")
    assert content["files"] == [str(published.relative_to(store.path))]
    assert hashlib.sha256(published.read_bytes()).hexdigest()[:16] in published.name
    for name in ("job.toml", "run.json"):
        sha256 = hashlib.sha256((store.path / name).read_bytes()).hexdigest()
        assert content["about"][name] == [sha256]
    assert content["run"] == KEY


@pytest.mark.parametrize("holder", ["[" * 100_000, "7", "", '{"process": 1}', "\0"])
def test_a_lock_that_somebody_has_edited_names_no_process(tmp_path: Path, holder: str) -> None:
    with held(tmp_path):
        (tmp_path / ".lock").write_text(holder)
        with pytest.raises(BusyError, match="is being computed by another process"):
            check_not_held(tmp_path)


class KilledError(BaseException):
    """Stands for a kill before a file operation."""


Operation = Callable[..., object]


def _killed_at(act: Callable[[], object], at: int, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Act, but end before the operation with this number; whether that was reached."""
    count = 0

    def counted(operation: Operation) -> Operation:
        def do(*arguments: object, **options: object) -> object:
            nonlocal count
            count += 1
            if count > at:
                raise KilledError
            return operation(*arguments, **options)

        return do

    with monkeypatch.context() as patch:
        prepare = counted(files.prepare)
        for place, name, operation in (
            (files, "prepare", prepare),
            (tables, "prepare", prepare),
            (files, "give_name", counted(files.give_name)),
            (files, "remove", counted(files.remove)),
        ):
            patch.setattr(place, name, operation)
        try:
            act()
        except KilledError:
            return True
    return False


@pytest.mark.parametrize("at", range(10))
def test_a_kill_between_two_steps_of_publishing_loses_no_row_and_leaves_the_same_files(
    at: int, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also if the rows of the second attempt differ, as timings do."""
    rows = pa.concat_tables([_draws("b", 0, 3), _draws("c", 0, 2)])
    store.commit("draws", "random", _draws("c", 0, 2))
    was_killed = _killed_at(lambda: store.publish("draws", "random", [rows]), at, monkeypatch)
    assert was_killed == (at < 6)  # prepare and name a table and the list; remove two parts
    assert len(Store(store.path).read("draws")) == 10  # a reader sees every row at any instant
    again = Store(store.path, KEY)
    again.recover()
    assert len(again.read("draws")) == 10
    again.commit("draws", "random", _draws("d", 0, 1))  # the second attempt has other rows
    again.settle("draws", "random")
    assert len(again.read("draws")) == 11
    listed = read_listing(store.path)
    assert listed is not None
    assert _files(store.path) == sorted(listed.files)
    assert not [*again.damages(), *again.strangers()]


@pytest.mark.parametrize("at", range(5))
def test_a_kill_while_run_json_is_replaced_leaves_the_old_one_or_the_new(
    at: int, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    was_killed = _killed_at(
        lambda: add_to_provenance(store.path, {"unproved": "why"}), at, monkeypatch
    )
    assert was_killed == (at < 4)
    run, _ = read_run(store.path)
    assert run["provenance"] in (old := RUN["provenance"], old | {"unproved": "why"})
    change_listing(store.path)  # the next list keeps the hash of the file that is there
    assert read_run(store.path)[0] == run
    listed = read_listing(store.path)
    assert listed is not None
    assert [len(hashes) for hashes in listed.about.values()] == [1, 1]


@pytest.mark.parametrize("name", ["job.toml", "run.json"])
def test_a_file_that_says_what_a_run_is_and_was_edited_is_named_with_the_remedy(
    name: str, store: Store
) -> None:
    path = store.path / name
    path.write_text(path.read_text() + " ")
    with pytest.raises(StoreError, match=rf"{name} is damaged: .*; remove it, and run the same"):
        read_run(store.path)


def test_every_flipped_bit_of_the_list_is_found(store: Store) -> None:
    path = store.path / "files.json"
    whole = path.read_bytes()
    for bit in range(0, 8 * len(whole), 5):
        content = bytearray(whole)
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        with pytest.raises(StoreError, match=r"files\.json is damaged: .*; remove it, and run"):
            read_listing(store.path)


@pytest.mark.parametrize("name", ["../x-00000-{}.parquet", "tables/draws/../x-00000-{}.parquet"])
def test_a_list_that_names_files_outside_the_tables_is_not_accepted(
    name: str, store: Store
) -> None:
    change_listing(store.path, files=(name.format("0" * 16),))
    listing._known.clear()  # as in another process
    with pytest.raises(StoreError, match="is damaged"):
        read_listing(store.path)


def test_a_run_that_has_lost_a_file_is_unfinished_again_and_keeps_its_other_rows(
    tmp_path: Path,
) -> None:
    store = Store(tmp_path, KEY)
    write_about(tmp_path, KEY, {"job.toml": "seed = 1\n", "run.json": json.dumps(RUN)})
    for phase in ("genetic", "random", "bound.proof"):
        store.publish("draws", phase, [_draws(phase, 0, 5)])
    next(tmp_path.glob("tables/draws/genetic-*")).unlink()
    with pytest.raises(StoreError, match=r"genetic-00000-\S+ is missing: run the same command"):
        store.read("draws")
    store.recover()
    assert store.has_parts("draws", "random")
    assert not store.has_parts("draws", "bound.proof")
    assert len(store.read("draws")) == 10


def test_a_run_that_has_lost_its_list_makes_it_from_the_files_that_are_there(store: Store) -> None:
    before = _files(store.path)
    (store.path / "files.json").unlink()
    with pytest.raises(StoreError, match=r"files\.json is missing"):
        read_run(store.path)
    store.recover()
    assert len(store.read("draws")) == 8
    store.settle("draws", "genetic")
    assert _files(store.path) == before
    assert read_run(store.path)[0] == RUN


def test_what_is_not_listed_is_not_read_and_goes_with_the_next_driver(store: Store) -> None:
    (published,) = store.path.glob("tables/draws/*")
    stranger = published.with_name(published.name.replace("00000", "00001"))
    stranger.write_bytes(published.read_bytes())
    mine = published.with_name("notes.txt")
    mine.write_text("mine")
    assert len(store.read("draws")) == 8
    assert [*map(str, store.strangers())] == [
        str(stranger), str(mine),
    ]  # fmt: skip
    store.recover()
    assert not stranger.exists()
    assert mine.read_text() == "mine"


def test_a_part_with_another_hash_is_no_damage(store: Store) -> None:
    (part,) = store.path.glob("parts/draws/*")
    part.write_bytes(part.read_bytes()[:-1])
    assert len(store.read("draws")) == 5
    assert not [*store.damages(), *map(str, store.strangers())]
    store.recover()
    assert not part.exists()


def test_a_file_of_another_table_or_run_is_named(store: Store, tmp_path: Path) -> None:
    other = Store(tmp_path / "other", "f" * 16)
    other.commit("draws", "genetic", _draws("z", 0, 1))
    store.commit("comparison", "genetic", compared_rows(0, 3))
    for file, kind in (
        (next(other.path.glob("parts/draws/*")), "run"),
        (next(store.path.glob("parts/comparison/*")), "table"),
    ):
        here = store.path / "parts" / "draws" / file.name
        here.write_bytes(file.read_bytes())
        with pytest.raises(StoreError, match=f"{file.name} belongs to another {kind}: .*; remove"):
            store.read("draws")
        here.unlink()


def test_a_draw_of_any_number_costs_neither_time_nor_memory(store: Store) -> None:
    rows = compared_rows(0, 3).set_column(0, "draw", pa.array([0, 1, 3_000_000_000_000]))
    store.commit("comparison", "comparison", rows.cast(comparison_schema(["a"])))
    last = 3_000_000_000_000
    assert store.draws("comparison") == [range(2), range(last, last + 1)]
    blocks = [block["draw"].to_pylist() for block in store.blocks("comparison", 10)]
    assert blocks == [[0, 1], [3_000_000_000_000]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: rows.drop_columns(["mse"]), "lacks the column mse"),
        (
            lambda rows: rows.set_column(1, "draw", pa.array(["0"] * 5)),
            "must have int64 in the column draw, got string",
        ),
    ],
)
def test_columns_are_those_of_the_schema(
    change: Callable[[pa.Table], pa.Table], words: str, store: Store
) -> None:
    rows = change(_draws("a", 0, 5)).replace_schema_metadata(schema("draws").metadata)
    store.commit("draws", "genetic", rows)
    with pytest.raises(StoreError, match=words):
        store.read("draws")


def test_files_that_are_not_of_tables_are_never_removed(store: Store, tmp_path: Path) -> None:
    """Neither a user's own files, nor those behind a link."""
    other = Store(tmp_path / "other", "f" * 16)
    other.publish("draws", "genetic", [_draws("z", 0, 1)])
    for place in ("tables", "parts"):
        (store.path / place / "mine").symlink_to(other.path / "tables" / "draws")
        (store.path / place / "draws" / "my-copy.parquet").write_text("mine")
    (store.path / "parts" / "draws" / f"a-{'0' * 16}.parquet").mkdir()
    before = _files(store.path)
    store.recover()
    assert _files(store.path) == before
    assert len(store.read("draws")) == 8


def test_without_locks_no_page_is_listed_beside_a_driver(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The list of a command that draws could replace that of a driver."""

    def no_locks(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", no_locks)
    (store.path / "figures").mkdir()
    figure = store.path / "figures" / "searches.svg"
    figure.write_text("a figure")
    before = (store.path / "files.json").read_text()
    with pytest.warns(PfdistWarning, match="only one command at a time"):
        record_pages(store.path, [figure])
    assert (store.path / "files.json").read_text() == before
    record_pages(store.path, [figure], locked=True)
    assert "searches.svg" in (store.path / "files.json").read_text()


def test_several_tables_are_published_together(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kill leaves the answer before or the one after, in all tables."""
    tables_of_answer = ("draws", "comparison")
    for number, at in enumerate(range(12)):
        rows = {"draws": [_draws("w", 0, number + 1)], "comparison": [compared_rows(0, number + 1)]}
        _killed_at(lambda: store.publish_together("why", rows), at, monkeypatch)  # noqa: B023
        sizes = {
            sum(path.name.startswith("why-") for path in store._listed() if table in path.parts)
            for table in tables_of_answer
        }
        assert len(sizes) == 1
        if sizes == {1}:
            answer = store.read("draws").query("evaluation == 'w'")
            assert len(answer) == len(store.read("comparison"))
        store.recover()
