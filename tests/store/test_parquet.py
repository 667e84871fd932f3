"""The store: committed is committed, once, and parts and tables read as one."""

import errno
import io
import os
import re
import socket
import subprocess
from collections import OrderedDict
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from oracles.bytes_of import hashes
from oracles.forged import with_sizes_of_nothing
from oracles.stored_rows import compared_rows
from pfdist.common.component_names import numbered_components
from pfdist.errors import StoreError
from pfdist.filters.aspects import DISTANCE, VARIANCE
from pfdist.filters.beside import BESIDE
from pfdist.filters.criterion import CRITERIA
from pfdist.runner.comparison_phase import schema_of_aspect
from pfdist.store import (
    SCHEMA_VERSION,
    Store,
    comparison_schema,
    parquet,
    schema,
    tables,
    trajectories_schema,
)
from pfdist.store.listing import read_listing
from pfdist.store.schema import KEYS
from pfdist.store.tables import cut_rows


def _draws(evaluation: str, first: int, last: int) -> pa.Table:
    rows = [{"evaluation": evaluation, "draw": d, "mse": 1.0 + d} for d in range(first, last)]
    return pa.Table.from_pylist(rows, schema=schema("draws"))


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    monkeypatch.setattr(tables, "_MOST_KNOWN", 0)  # each file is read, as in another process
    return Store(tmp_path)


def test_what_is_committed_is_read_sorted_and_by_a_new_store_too(store: Store) -> None:
    store.commit("draws", "genetic", _draws("b", 0, 2))
    store.commit("draws", "genetic", _draws("a", 1, 3))
    for opened in (store, Store(store.path)):
        rows = opened.read("draws")
        assert rows[["evaluation", "draw"]].to_numpy().tolist() == [
            ["a", 1], ["a", 2], ["b", 0], ["b", 1],
        ]  # fmt: skip


def test_the_same_rows_again_change_nothing(store: Store) -> None:
    for _ in range(2):
        store.commit("draws", "genetic", _draws("a", 0, 2))
    assert len(list((store.path / "parts" / "draws").iterdir())) == 1
    assert store.read("draws")["mse"].tolist() == [1.0, 2.0]


def test_a_row_that_is_both_a_part_and_published_counts_once(store: Store) -> None:
    store.publish("draws", "genetic", [_draws("a", 0, 3)])
    store.commit("draws", "genetic", _draws("a", 0, 3))  # as if killed before it was removed
    assert len(store.read("draws")) == len(store.per_draw(["a"])) == 3
    assert store.has_parts()
    store.publish("draws", "genetic", [_draws("a", 0, 3)])
    assert len(store.read("draws")) == len(store.per_draw(["a"])) == 3
    assert not store.has_parts()


def test_a_reader_sees_a_row_that_is_published_meanwhile(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.commit("draws", "genetic", _draws("a", 0, 5))
    listing, writer = Store._files, Store(store.path)

    def published_in_between(self: Store, table: str, phase: str = "") -> list[Path]:
        found = listing(self, table, phase)
        if self is store and writer.has_parts():
            writer.publish("draws", "genetic", [_draws("a", 0, 5)])
        return found

    monkeypatch.setattr(Store, "_files", published_in_between)
    assert len(store.read("draws")) == 5


def test_draws_are_found_by_their_evaluation_in_parts_and_tables_in_order_and_each_once(
    store: Store,
) -> None:
    for first, last in ((3, 6), (0, 4), (2, 5)):
        some = pa.concat_tables([_draws("a", first, last), _draws("b", 0, 1)])
        store.commit("draws", "genetic", some)
    store.publish("draws", "random", [_draws("c", 0, 2)])
    for opened in (store, Store(store.path)):
        rows = opened.per_draw(["c", "a", "unknown"])
        assert rows.equals(pa.concat_tables([_draws("c", 0, 2), _draws("a", 0, 6)]))
        assert opened.per_draw(["unknown"]).num_rows == 0


def test_blocks_are_sorted_and_have_each_row_once(store: Store) -> None:
    for first, last in ((10, 20), (0, 10), (5, 15), (31, 40)):
        store.commit("comparison", "comparison", compared_rows(first, last))
    blocks = [rows["draw"].to_pylist() for rows in store.blocks("comparison", 7, 36)]
    assert blocks == [
        list(range(7)), list(range(7, 14)), list(range(14, 20)), list(range(31, 35)), [35],
    ]  # fmt: skip


@pytest.mark.parametrize("read", ["read", "numbers", "blocks", "per_draw"])
def test_parts_that_become_tables_while_they_are_read_are_read_all_the_same(
    store: Store, read: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for first in (0, 3):
        store.commit("draws", "genetic", _draws("a", first, first + 3))
    readers = {
        "read": lambda: len(store.read("draws")),
        "numbers": lambda: sum(map(len, store.draws("draws"))),
        "blocks": lambda: sum(rows.num_rows for rows in store.blocks("draws", 2, 6)),
        "per_draw": lambda: store.per_draw(["a"]).num_rows,
    }
    known = Store(store.path)
    assert known.per_draw(["a"]).num_rows == 6  # it has an index now, of parts
    opened, writer = parquet.read_file, Store(store.path)

    def published_in_between(path: Path, *arguments: Any, **options: Any) -> pa.Table:
        if writer.has_parts():
            writer.publish("draws", "genetic", [_draws("a", 0, 6)])
        return opened(path, *arguments, **options)

    monkeypatch.setattr(parquet, "read_file", published_in_between)
    assert readers[read]() == 6
    assert known.per_draw(["a"]).num_rows == 6


def test_publishing_removes_only_the_parts_of_its_phase(store: Store) -> None:
    store.commit("draws", "genetic", _draws("a", 0, 1))
    store.commit("draws", "random", _draws("b", 0, 1))
    store.publish("draws", "genetic", [_draws("a", 0, 1)])
    assert not store.has_parts("draws", "genetic")
    assert store.has_parts("draws", "random")
    assert store.read("draws")["evaluation"].tolist() == ["a", "b"]


def test_nothing_but_whole_tables_lies_in_a_tables_folder(store: Store) -> None:
    store.publish("draws", "genetic", [_draws("a", 0, 5)])
    store.commit("draws", "genetic", _draws("a", 0, 5))
    files = [path.name for path in store.path.rglob("*.parquet") if path.is_file()]
    assert sorted(re.sub(r"[0-9a-f]{16}", "HASH", name) for name in files) == [
        "genetic-00000-HASH.parquet",
        "genetic-HASH.parquet",
    ]
    # anybody reads them, with nothing of pfdist
    assert len(pd.read_parquet(store.path / "tables" / "draws")) == 5


def test_what_a_killed_process_left_half_written_is_swept_and_never_read(store: Store) -> None:
    store.publish("draws", "genetic", [_draws("a", 0, 5)])
    dead, unburied = subprocess.Popen(["true"]), subprocess.Popen(["true"])
    dead.wait()
    os.waitid(os.P_PID, unburied.pid, os.WEXITED | os.WNOWAIT)  # it has ended, and stays as it is
    folder, host = store.path / "tables" / "draws", socket.gethostname().replace(".", "_")
    names = {"alive": f"{host}-{os.getpid()}", "far": "elsewhere-1"}
    names |= {"dead": f"{host}-{dead.pid}", "unburied": f"{host}-{unburied.pid}"}
    halves = {whose: folder / f".{name}.{'0' * 32}.tmp" for whose, name in names.items()}
    for half in halves.values():
        half.write_bytes(b"PAR1 torn")
    assert len(store.read("draws")) == len(pd.read_parquet(folder)) == 5
    store.recover()
    unburied.wait()
    assert [whose for whose, half in halves.items() if half.exists()] == ["alive", "far"]


def test_identical_tables_are_identical_bytes(tmp_path: Path) -> None:
    whole = _draws("a", 0, 100)
    pieces = pa.concat_tables([whole.slice(0, 7), whole.slice(7)])  # cut otherwise in memory
    for name, rows in (("x", whole), ("y", pieces)):
        Store(tmp_path / name).publish("draws", "genetic", [rows])
    x, y = (hashes(tmp_path / name) for name in "xy")
    assert x == y


def test_a_file_that_cannot_be_written_is_an_error_that_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "parts").write_text("a file where a folder should be")
    with pytest.raises(StoreError, match=r"cannot write .*run the same command again"):
        Store(tmp_path).commit("draws", "genetic", _draws("a", 0, 1))


def test_what_the_disk_did_not_take_gets_no_name(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(StoreError, match=r"cannot write .*Input/output error"):
        store.commit("draws", "genetic", _draws("a", 0, 1))
    assert not list(store.path.rglob("*.parquet"))


def test_no_file_gets_a_second_name(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some file systems have no hard links: exFAT, and some in networks."""

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr(os, "symlink", refuse)
    store.commit("draws", "genetic", _draws("a", 0, 5))
    store.settle("draws", "genetic")
    assert len(Store(store.path).read("draws")) == 5


def test_a_commit_does_as_much_however_much_was_committed_before(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = list[str]()
    with monkeypatch.context() as patch:
        for name in ("open", "scandir", "listdir", "stat", "lstat", "replace", "mkdir", "fsync"):
            act = getattr(os, name)
            patch.setattr(os, name, lambda *a, n=name, f=act, **k: done.append(n) or f(*a, **k))
        counts = []
        for key in range(100):
            done.clear()
            store.commit("draws", "genetic", _draws("a", key, key + 1))
            counts.append(sorted(done))
    assert counts[1] == counts[99]
    assert "scandir" not in counts[99]
    assert "listdir" not in counts[99]


def test_what_cannot_be_read_is_an_error_that_says_why(store: Store) -> None:
    with pytest.raises(StoreError, match="no table 'comparison' yet"):
        store.read("comparison")
    store.publish("draws", "genetic", [_draws("a", 0, 5)])
    (path,) = store.path.glob("tables/draws/*")
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(StoreError, match=rf"{path.name} is damaged: .*; remove it, and run the"):
        Store(store.path).read("draws")
    rows = compared_rows(0, 1)
    newer = {**rows.schema.metadata, b"pfdist_schema_version": str(SCHEMA_VERSION + 1).encode()}
    store.publish("comparison", "comparison", [rows.replace_schema_metadata(newer)])
    with pytest.raises(StoreError, match="which a newer version of pfdist reads"):
        store.read("comparison")


@pytest.mark.parametrize("table", ["draws", "evaluations", "compared", "error_sums", "bound"])
def test_rows_that_this_process_wrote_are_those_that_another_reads(
    table: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = {"int": 3, "dou": 0.1, "str": "a", "boo": True, "lis": [1, 2]}
    row = {each.name: values[str(each.type)[:3]] for each in schema(table)}
    rows = pa.Table.from_pylist([row, dict.fromkeys(row) | {KEYS[table][0]: row[KEYS[table][0]]}])
    Store(tmp_path, "key").commit(table, "phase", rows.cast(schema(table)))
    (path,) = (tmp_path / "parts" / table).iterdir()
    written = tables.read_file(path, "key", [*row][:2])
    monkeypatch.setattr(tables, "_known", OrderedDict())
    read = tables.read_file(path, "key", [*row][:2])
    assert written.equals(read, check_metadata=True)


def test_a_file_that_changes_after_it_was_written_or_read_is_read_again(tmp_path: Path) -> None:
    store = Store(tmp_path, "key")
    store.publish("draws", "genetic", [_draws("a", 0, 5)])
    (path,), rows = tmp_path.glob("tables/draws/*"), pc.field("draw") > 2
    content = path.read_bytes()
    for _ in range(2):
        assert tables.read_file(path, "key", filters=rows).num_rows == 2
        with pytest.raises(StoreError, match="belongs to another run"):
            tables.read_file(path, "other")
        path.write_bytes(content[:-1])
        for reads in (store.read, lambda _: store.check_published()):
            with pytest.raises(StoreError, match="is damaged"):
                reads("draws")
        path.write_bytes(content)
    path.unlink()
    with pytest.raises(StoreError, match="is missing"):
        store.read("draws")


def test_tables_that_are_published_together_are_listed_at_the_end_or_not_at_all(
    store: Store,
) -> None:
    def fail() -> None:
        with store.together():
            store.settle("draws", "random")
            raise KeyError

    store.commit("draws", "random", _draws("a", 0, 5))
    with pytest.raises(KeyError):
        fail()
    assert store.has_parts("draws", "random")
    assert read_listing(store.path) is None
    with store.together():
        store.settle("draws", "random")
        store.publish("online", "comparison", [schema("online").empty_table()])
    assert not store.has_parts()
    assert len(store.read("draws")) == 5


def test_a_small_file_of_far_too_many_values_is_not_unpacked(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    a_row = {"evaluation": "a", "draw": 0, "mse": None, "degenerate": None}
    rows = pa.Table.from_pylist([a_row] * 10_000, schema=schema("draws"))
    store.publish("draws", "genetic", [rows])
    assert len(store.read("draws")) == 1  # equal keys
    monkeypatch.setattr(tables, "_USUAL_VALUES", 100)
    monkeypatch.setattr(tables, "_MOST_VALUES_A_BYTE", 1)
    with pytest.raises(StoreError, match=r"cannot read .* bytes must not hold 40,000 values"):
        store.read("draws")
    store.publish("draws", "genetic", [_draws("a", 0, 500)])
    assert len(store.read("draws")) == 500


def test_a_text_that_many_rows_share_is_measured_before_it_is_repeated(tmp_path: Path) -> None:
    """A file of some kilobytes becomes gigabytes in no more memory than its text takes once."""
    rows, text = pa.array([0] * 300), pa.array(["x" * 5_000_000])
    shared = pa.DictionaryArray.from_arrays(rows, text)
    nested = pa.ListArray.from_arrays(pa.array(range(301), pa.int32()), shared)
    for column, kept in product((shared, nested), (0, 1000)):
        path = tmp_path / "shared.parquet"
        tables.write_table(pa.table({"label": column}), path)
        content, about = path.read_bytes(), pq.read_metadata(path)
        assert len(content) < 5000
        before = pa.default_memory_pool().max_memory()
        with pytest.raises(ValueError, match="must not hold 1,500,000,000 bytes of texts"):
            tables.unpacked(content, about, 10_000_000, 50_000_000, kept)
        assert pa.default_memory_pool().max_memory() < max(before, 100_000_000)
        table = tables.unpacked(content, about, 10_000_000, 1_500_000_000, kept)
        assert table is None if not kept else table.num_rows == 300
    few = pa.table({"label": ["a", None, "bcd"], "sets": [["a", "b"], [], None], "mse": [1.0] * 3})
    tables.write_table(few, path)
    content, about = path.read_bytes(), pq.read_metadata(path)
    assert tables.unpacked(content, about, 100, 6, 10).cast(few.schema).equals(few)
    with pytest.raises(ValueError, match="must not hold 6 bytes of texts"):
        tables.unpacked(content, about, 100, 5, 10)


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("kind", ["texts", "a dictionary", "beginnings"])
def test_pages_are_added_up_before_a_file_with_forged_metadata_is_unpacked(
    kind: str, version: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Memory is taken by what headers of pages say, which the metadata may not repeat."""
    texts = ["x" * 1_000_000] * 60
    if kind == "beginnings":  # each text is the former and a letter, so a page has one of them
        texts = ["x" * (1_000_000 + more) for more in range(60)]
    pq.write_table(
        pa.table({"label": texts, "number": range(60)}), path := tmp_path / "forged.parquet",
        compression="zstd", data_page_version=version, use_dictionary=kind == "a dictionary",
        column_encoding={"label": "DELTA_BYTE_ARRAY"} if kind == "beginnings" else None,
    )  # fmt: skip
    content = with_sizes_of_nothing(path.read_bytes())
    about = pq.read_metadata(pa.BufferReader(content))
    assert len(content) < 10_000
    assert sum(chunk.total_uncompressed_size for chunk in tables.column_chunks(about)) < 1000
    assert pq.read_table(pa.BufferReader(content)).num_rows == 60  # nothing else holds it back
    for reads in ("read", "iter_batches"):
        monkeypatch.setattr(pq.ParquetFile, reads, None)  # nothing is unpacked
    most = 900_000 if kind == "a dictionary" else 50_000_000
    with pytest.raises(ValueError, match=r"must not hold [0-9,]+ bytes of texts"):
        tables.unpacked(content, about, 200, most, 1000)


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_the_sizes_of_pages_are_those_that_the_writer_has_added_up(
    version: str, tmp_path: Path
) -> None:
    """There are many pages, compressed in several ways, with texts in their statistics."""
    texts = [f"{row:050}" for row in range(3000)]
    table = pa.table({"t": texts, "y": [*range(2999), None], "z": [[True], []] * 1500})
    for compression in ("zstd", "snappy", "none"):
        pq.write_table(
            table, path := tmp_path / "pages.parquet", compression=compression,
            data_page_version=version, data_page_size=1000, write_page_checksum=True,
        )  # fmt: skip
        chunks = [*tables.column_chunks(pq.read_metadata(path))]
        with path.open("rb") as file:
            size, values = tables.size_of_pages(file, chunks)
        assert values == sum(chunk.num_values for chunk in chunks)
        headers = sum(chunk.total_uncompressed_size for chunk in chunks) - size
        assert 0 < headers < 0.2 * size
        assert len(chunks) == 3


@pytest.mark.parametrize("content", [b"", b"\x15", b"\x00", b"\x19\x00", b"\x1c" * 100])
def test_a_page_that_cannot_be_read_is_an_error(content: bytes) -> None:
    chunk: Any = SimpleNamespace(
        dictionary_page_offset=None, data_page_offset=4, total_compressed_size=100
    )
    with pytest.raises(ValueError, match=r"^(the header of )?a page (cannot be read|has no size)$"):
        tables.size_of_pages(io.BytesIO(b"PAR1" + content), [chunk])


@pytest.mark.parametrize("count", [1, 3, 4, 100])
def test_cut_rows_keeps_all_rows_in_order(count: int) -> None:
    pieces = [_draws("a", 0, 5), _draws("a", 5, 6), _draws("a", 6, 17)]
    cut = list(cut_rows(pieces, count))
    assert [d for piece in cut for d in piece["draw"].to_pylist()] == list(range(17))
    assert all(piece.num_rows == count for piece in cut[:-1])


def test_every_column_says_its_unit_and_every_table_its_version(store: Store) -> None:
    of_criteria = (aspect for form in CRITERIA.values() for aspect in form.aspects)
    aspects = (*BESIDE, DISTANCE, VARIANCE, *of_criteria)
    variable = {
        "comparison": comparison_schema(["regular", "genetic"]),
        **{each.table: schema_of_aspect(each, ["regular", "genetic"]) for each in aspects},
        "trajectories": trajectories_schema(
            ["regular"], numbered_components(2), numbered_components(1)
        ),
    }
    for table in KEYS:
        columns = variable.get(table) or schema(table)
        store.commit(table, "phase", columns.empty_table())
        (path,) = (store.path / "parts" / table).glob("phase-*.parquet")
        read = pq.read_schema(path)
        assert read.metadata[b"pfdist_schema_version"] == str(SCHEMA_VERSION).encode()
        assert read.metadata[b"table"] == table.encode()
        for column in read:
            assert b"unit" in column.metadata
            assert column.metadata[b"description"]
