"""The manifest: lines that are appended, by one driver or by several, and cut short by a kill."""

from itertools import permutations
from pathlib import Path

import pytest

from pfdist.store import Manifest
from pfdist.store.files import add_lines

FILE = Path("tables/timings/genetic-00000.parquet")
A, B, KEY = "a" * 64, "b" * 64, "0123456789abcdef"
STEPS = ("next", "names", "now")
ORDERS = [
    order
    for order in permutations([(driver, step) for driver in (A, B) for step in STEPS])
    if all(
        [step for each, step in order if each == driver] == list(STEPS) for driver in (A, B)
    )
]  # fmt: skip


@pytest.fixture
def manifest(tmp_path: Path) -> Manifest:
    return Manifest(tmp_path)


def _add(manifest: Manifest, *lines: str) -> None:
    add_lines(manifest.folder / "manifest", list(lines))


@pytest.mark.parametrize("order", ORDERS)
def test_what_lies_there_is_expected_in_whatever_order_two_drivers_publish(
    order: tuple[tuple[str, str], ...], manifest: Manifest
) -> None:
    there = ""
    for driver, step in order:
        if step == "names":
            there = driver
        else:
            _add(manifest, f"{step} {FILE} {driver}")
    assert manifest.expected()[FILE].get(there)


def test_a_file_is_the_new_one_or_the_one_before_until_it_has_its_name(manifest: Manifest) -> None:
    _add(manifest, f"next {FILE} {A}")
    assert manifest.expected() == {FILE: {A: False}}
    _add(manifest, f"now {FILE} {A}", f"next {FILE} {B}")
    assert manifest.expected() == {FILE: {A: True, B: False}}
    _add(manifest, f"now {FILE} {B}")
    assert manifest.expected() == {FILE: {B: True}}
    _add(manifest, f"gone {FILE} {B}")
    assert manifest.expected() == {}


def test_a_line_that_was_cut_short_means_nothing_and_spoils_no_other(manifest: Manifest) -> None:
    line, path = f"now {FILE} {B}", manifest.folder / "manifest"
    _add(manifest, f"run {KEY}", f"now {FILE} {A}")
    whole = path.read_text()
    for size in range(len(line)):
        path.write_text(f"{whole}\n{line[:size]}")
        assert manifest.expected() == {FILE: {A: True}}
        assert manifest.recorded_key() == KEY
        _add(manifest, f"gone {FILE} {A}")
        assert manifest.expected() == {}
    for size in range(len(KEY)):
        path.write_text(f"{whole}\nrun {'f' * size}")
        assert manifest.recorded_key() == KEY


@pytest.mark.parametrize(
    "path", ["../thesis.tex", "{folder}/thesis.tex", "tables/../../thesis.tex"]
)
def test_a_manifest_that_names_files_outside_the_run_moves_none(path: str, tmp_path: Path) -> None:
    thesis = tmp_path / "thesis.tex"
    thesis.write_text("precious")
    (tmp_path / "run").mkdir()
    manifest = Manifest(tmp_path / "run")
    _add(manifest, f"now {path.format(folder=tmp_path)} {A}")
    assert not [manifest.quarantine(damage) for damage in manifest.damages()]
    assert thesis.read_text() == "precious"
