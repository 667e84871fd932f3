"""The contract of every figure of a run."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from matplotlib.figure import Figure as Canvas

import pfdist
from pfdist.common.plugins import plugins
from pfdist.pages import figure as figures
from pfdist.pages.figure import FIGURES, Tables
from pfdist.results import Run

ROOT = Path(__file__).parents[1]
EXACT = ["model.name=random_walk", "filter.engine=kalman"]  # compiles no filter of a search

every = pytest.mark.parametrize("name", FIGURES)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory, finished: Callable[..., Path]) -> list[Run]:
    """A kept run; runs with a bound and online times, several numbers, why, and named sets."""
    folder = tmp_path_factory.mktemp("figures")
    shutil.copytree(ROOT / "assets" / "kept", folder / "run")
    job = pfdist.load_job(ROOT / "small.toml", [*EXACT, "problem.horizon=6"])
    several = []
    if "budget" in plugins():
        several.append(pfdist.budget(job, (2, 3), folder / "budget", draws=20, figures=False))
    online = ["online.draws=20"] * ("online" in plugins())
    proved = shutil.copytree(finished(*EXACT, *online), folder / "proved")
    pfdist.bound(proved / "job.toml", pool="serial", figures=False)
    explained = shutil.copytree(finished(), folder / "why")
    if "why" in plugins():
        pfdist.why(explained / "job.toml", draws=20, figures=False)
    pfdist.bound(explained / "job.toml", 960, pool="serial", figures=False)  # in two steps
    sets = {"few": [0, 12], "many": "0:12:2"}
    short = pfdist.load_job(ROOT / "small.toml", EXACT)
    named = pfdist.compare(short, times=sets, results=folder / "sets", draws=20, figures=False)
    opened = [pfdist.open_run(path) for path in (folder / "run", proved, explained)]
    return [*opened, *several, named]


@every
def test_a_chapter_of_the_answers_shows_it(name: str) -> None:
    rooms = (ROOT.parent / "pfdist" / each for each in ("questions", "plugins"))
    chapters = (each for room in rooms for each in room.rglob("*.py") if "figure" not in each.stem)
    assert any(f'"{name}"' in chapter.read_text() for chapter in chapters)


@every
def test_one_sentence_describes_it(name: str) -> None:
    assert FIGURES[name].description.endswith(".")


@every
def test_it_is_drawn_into_the_files_that_it_names_and_shows_something(
    name: str, runs: list[Run]
) -> None:
    """Its title is a sentence about the run."""
    assert any(FIGURES[name].files(run) for run in runs)
    for run in runs:
        files = []
        for file, plot in FIGURES[name].plots(Tables(run)):
            files.append(file)
            assert plot.title[:1].isupper()
            assert plot.title.endswith(".")
            assert "nan" not in plot.title.split()
            canvas = Canvas(figsize=(3.5, plot.height), layout="constrained")
            panels = canvas.subplots(plot.panels, squeeze=False)[:, 0].tolist()
            plot.draw(panels)
            assert all(axes.has_data() or axes.texts for axes in panels), file
        assert files == FIGURES[name].files(run)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name != "bound")) for name in FIGURES]
)
def test_the_same_figure_is_the_same_bytes(name: str, runs: list[Run]) -> None:
    run = next(run for run in runs if FIGURES[name].files(run))
    files = (figures.save_plots(run.path, FIGURES[name].plots(Tables(run))) for _ in range(2))
    first, again = ([file.read_bytes() for file in some] for some in files)
    assert first == again
