"""Figures of benchmarks are drawn anew from their tables, and nothing is measured."""

import shutil
from pathlib import Path

import matplotlib.image
import pytest


def test_a_figure_is_drawn_from_the_tables_that_lie_in_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from benchmarks import genetic  # no part of the package, so the wheel's tests have none
    from benchmarks.__main__ import FOLDER, main

    monkeypatch.setattr(genetic, "measure", lambda quick, say: pytest.fail("it measures"))
    shutil.copy(FOLDER / "genetic.csv", tmp_path)
    assert main(["genetic", "peers", "--redraw", "--results", str(tmp_path)]) == 0
    names = sorted(file.name for file in tmp_path.iterdir())
    assert names == ["genetic.csv", "genetic.png"]  # the tables of peers are not there
    assert matplotlib.image.imread(tmp_path / "genetic.png").shape[0] > 400
