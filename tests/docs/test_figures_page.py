"""The examples of the page about figures run, and the page names every function."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from matplotlib import pyplot

import pfdist

ROOT = Path(__file__).parents[2]
EXACT = ["model.name=random_walk", "filter.engine=kalman", "comparison.draws=20"]
PAGE = (ROOT / "docs" / "figures.md").read_text(encoding="utf-8")


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    with pyplot.style.context("default"):
        yield
    pyplot.close("all")


@pytest.mark.slow
def test_the_examples_draw_what_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pyplot.close("all")  # other tests may have left figures open
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "tests" / "assets" / "schema-3", "results/quick")
    over = {"problem.measurement_budget": [3, 4], "filter.particles": [20, 40], "seed": [1, 2]}
    pfdist.sweep(ROOT / "tests/small.toml", over, results="results/budgets", changes=EXACT)
    names: dict[str, object] = {}
    for text in re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL):
        exec(compile(text, "figures.md", "exec"), names)
    assert len(pyplot.get_fignums()) == 8
    assert Path("mine.pdf").read_bytes().count(b"/FontFile2")  # TrueType fonts are embedded
