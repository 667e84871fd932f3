"""Runs whose figures tests draw, and reports as their readers see them."""

from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import pytest

import pfdist
from pfdist.results import Run

ROOT = Path(__file__).parents[1]
EXACT = ["model.name=random_walk", "filter.engine=kalman"]  # compiles no filter of a search


@pytest.fixture(scope="session")
def plain() -> Run:
    """A run of two searches, one of which estimates otherwise than the comparison."""
    return pfdist.open_run(ROOT / "assets" / "kept")


@pytest.fixture(scope="session")
def proved(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run with forbidden instants, online times, a lower bound, and the worth of measurements."""
    folder = tmp_path_factory.mktemp("proved") / "run"
    changes = [*EXACT, "search.random.evaluations=3", "search.genetic.generations=1"]
    changes += ["online.draws=20", "problem.forbidden=[7, '9-10']"]
    run = pfdist.run(ROOT / "small.toml", folder, changes=changes, figures=False)
    pfdist.bound(run, pool="serial", figures=False)
    pfdist.why(run, figures=False)
    return run


@pytest.fixture(scope="session")
def several(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run for several numbers of measurements."""
    job = pfdist.load_job(ROOT / "small.toml", [*EXACT, "problem.horizon=6"])
    folder = tmp_path_factory.mktemp("several") / "budget"
    return pfdist.budget(job, (2, 3), folder, draws=20, figures=False)


class Seen(HTMLParser):
    """The text of a page, its elements, links, what it loads, and the rows of its first table."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.html, self.text, self.tags = html, "", list[str]()
        self.links, self.loaded, self.rows = list[str](), list[str](), list[list[str]]()
        self._unseen, self._in_rows = 0, False
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        known = {key: value or "" for key, value in attrs}
        addresses = self.links if tag == "a" else self.loaded
        addresses += [known[key] for key in ("href", "src") if key in known]
        if tag == "tr":
            self.rows.append([])
            self._in_rows = True
        elif tag in ("td", "th") and self.rows:
            self.rows[-1].append("")
        self._unseen += tag in ("style", "script")

    def handle_endtag(self, tag: str) -> None:
        self._unseen -= tag in ("style", "script")
        self._in_rows = self._in_rows and tag != "table"

    def handle_data(self, data: str) -> None:
        if self._unseen:
            return
        told = " ".join(data.replace("\xa0", " ").split())
        self.text += f" {told}" if told else ""
        if self._in_rows and self.rows and self.rows[-1]:
            self.rows[-1][-1] += told


@pytest.fixture(scope="session")
def see() -> Callable[[pfdist.Run | Path], Seen]:
    """Give the page of a run, of which a report is written."""
    return lambda source: Seen(pfdist.report(source).read_text(encoding="utf-8"))
