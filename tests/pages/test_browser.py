"""Reports in a real Chromium, with axe-core: wide and narrow, light, dark and printed."""

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import pfdist
from pfdist import load_job
from pfdist.common.parts import Cell, Page, Section, Table
from pfdist.questions.report import write_page

pytestmark = [
    pytest.mark.browser,
    pytest.mark.needs("browser"),
    pytest.mark.plugins("budget", "online", "why"),
]

WIDTHS = (400, 1200)
KINDS = ("plan", "budget", "online", "unfinished")
SMALL = ("model.name=random_walk", "filter.engine=kalman", "comparison.draws=60")


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A report of each kind of run, with everything that can be asked about the run."""
    folder = tmp_path_factory.mktemp("runs")
    file = folder / "small.toml"
    file.write_text((Path(__file__).parents[1] / "small.toml").read_text())
    job = load_job(file, [*SMALL, "search=[{method='genetic', generations=1}]"])
    plan = pfdist.run(job, folder / "plan", bound_draws=480)
    pfdist.why(plan)
    pfdist.budget(job, (3, 5), folder / "budget", draws=60)
    pfdist.online(job, folder / "online", draws=20)

    def stop(progress: Any) -> None:
        if progress.phase == "comparison":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pfdist.run(job, folder / "unfinished", progress=stop)
    cells = [Cell(f"{10 * each} of the words of a wide column") for each in range(6)]
    rows = [[Cell(str(number), number), *cells] for number in (*range(8, 17), *range(8))]
    table = Table("Table", ["number", *(f"column {each}" for each in range(6))], rows)
    write_page(Page("Table", "", [Section("Table", [table])]), folder / "table.html")
    made = {kind: pfdist.report(folder / kind) for kind in KINDS}
    return made | {"table": folder / "table.html"}


@pytest.fixture
def page(browser: Any, request: pytest.FixtureRequest) -> Iterator[Any]:
    """A page that fails the test if anything is printed on the console or requested."""
    width, scheme = request.param
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    opened, wrong = context.new_page(), list[str]()
    opened.on("console", lambda message: wrong.append(message.text))
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    opened.on(
        "request",
        lambda asked: None if asked.url.startswith(("file:", "data:")) else wrong.append(asked.url),
    )
    yield opened
    context.close()
    assert wrong == []


LOOKS = pytest.mark.parametrize(
    "page", [(width, scheme) for width in WIDTHS for scheme in ("light", "dark")], indirect=True
)


@LOOKS
@pytest.mark.parametrize("kind", KINDS)
def test_every_figure_is_seen_and_everyone_can_read_it(
    page: Any, reports: dict[str, Path], kind: str
) -> None:
    from axe_playwright_python.sync_playwright import Axe

    page.goto(reports[kind].as_uri())
    for details in page.locator("details").all():
        details.locator("> summary").click()
    figures = page.locator("figure")
    assert figures.count() >= (kind != "unfinished")
    for figure in figures.all():
        box = figure.locator("svg").bounding_box()
        assert box["width"] > 250
        assert box["height"] > 100
        assert figure.locator("figcaption").inner_text().endswith(".")
        assert figure.locator("svg").get_attribute("aria-label")
    page_width = page.evaluate("document.documentElement.scrollWidth")
    assert page_width <= page.viewport_size["width"]
    broken = Axe().run(page).response["violations"]
    assert [(rule["id"], rule["nodes"][0]["html"]) for rule in broken] == []


@pytest.mark.parametrize("page", [(1200, "light")], indirect=True)
def test_a_click_on_a_head_sorts_a_table_and_another_turns_it_round(
    page: Any, reports: dict[str, Path]
) -> None:
    page.goto(reports["budget"].as_uri())
    assert page.locator("table").first.locator("tbody tr").count() == 3
    assert not page.locator("table").first.get_by_role("button").count()
    page.goto(reports["table"].as_uri())
    table = page.locator("table").first
    first, numbers = table.locator("tbody th"), [*map(str, range(17))]
    assert first.all_inner_texts() == numbers[8:] + numbers[:8]
    head = table.get_by_role("button").first
    head.click()
    assert first.all_inner_texts() == numbers
    head.press("Enter")
    assert first.all_inner_texts() == numbers[::-1]
    assert table.locator("thead th").first.get_attribute("aria-sort") == "descending"


@pytest.mark.parametrize("page", [(600, "light"), (400, "light")], indirect=True)
def test_a_table_says_that_it_scrolls_if_it_does(page: Any, reports: dict[str, Path]) -> None:
    page.goto(reports["table"].as_uri())
    page.wait_for_function(
        """() => [...document.querySelectorAll(".table")].every(box =>
          getComputedStyle(box, "::before").content.includes("Scroll sideways")
          == box.scrollWidth > box.clientWidth)"""
    )
    assert bool(page.locator(".scrolls").count()) is (page.viewport_size["width"] > 400)


@pytest.mark.parametrize("page", [(400, "light")], indirect=True)
@pytest.mark.parametrize("kind", KINDS)
def test_a_narrow_page_cuts_no_cell_and_each_cell_has_the_head_of_its_column(
    page: Any, reports: dict[str, Path], kind: str
) -> None:
    page.goto(reports[kind].as_uri())
    for details in page.locator("details").all():
        details.locator("> summary").click()
    cells = page.evaluate(
        """[...document.querySelectorAll("tbody th, td:not(:empty)")].map(cell => [
          cell.scrollWidth - cell.clientWidth, cell.getBoundingClientRect().right,
          cell.dataset.label, cell.closest("table").tHead.rows[0].cells[cell.cellIndex].textContent,
          getComputedStyle(cell, "::before").content])"""
    )
    assert len(cells) >= 3
    for beyond, right, label, head, shown in cells:
        assert beyond <= 0
        assert right <= 400
        assert label == head
        assert shown == "attr(data-label)" or shown.strip('"') == label


@pytest.mark.parametrize("page", [(1200, "dark")], indirect=True)
def test_it_prints_in_black_on_white(page: Any, reports: dict[str, Path]) -> None:
    page.goto(reports["plan"].as_uri())
    page.emulate_media(media="print", color_scheme="dark")
    colours = page.evaluate(
        "[getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
    )
    assert colours == ["rgb(0, 0, 0)", "rgb(255, 255, 255)"]


@pytest.mark.parametrize("page", [(1200, "light")], indirect=True)
@pytest.mark.parametrize("kind", KINDS)
def test_no_heading_is_printed_at_the_end_of_a_page(
    page: Any, reports: dict[str, Path], kind: str, tmp_path: Path
) -> None:
    page.goto(reports[kind].as_uri())
    heads = page.locator("h2, caption, summary").all_text_contents()
    for height in range(240, 300, 12):  # headings meet the ends of some of these pages
        page.pdf(path=tmp_path / "report.pdf", width="210mm", height=f"{height}mm")
        words = ["pdftotext", "-layout", str(tmp_path / "report.pdf"), "-"]
        text = subprocess.run(words, capture_output=True, text=True, check=True).stdout
        lasts = {" ".join(sheet.strip().rpartition("\n")[2].split()) for sheet in text.split("\f")}
        assert not lasts & {" ".join(head.split()) for head in heads}


@pytest.mark.parametrize("page", [(1200, "light")], indirect=True)
def test_only_what_is_unfolded_is_printed(page: Any, reports: dict[str, Path]) -> None:
    for kind in KINDS:
        page.goto(reports[kind].as_uri())
        page.locator("summary").first.click()
        page.emulate_media(media="print")
        shown = [each.is_visible() for each in page.locator("details").all()]
        assert shown == [True] + [False] * (len(shown) - 1)
        page.emulate_media(media="screen")
