"""Reports in a real Chromium, with axe-core: wide and narrow, light, dark and printed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import pfdist
from pfdist import load_job

pytestmark = pytest.mark.browser

WIDTHS = (400, 1200)
KINDS = ("plan", "budget", "online", "unfinished", "sweep")
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

    over = {"problem.measurement_budget": [3, 4], "filter.particles": [20, 40], "seed": [1, 2]}
    pfdist.sweep(file, over, results=folder / "sweep", changes=["comparison.draws=60"])
    (folder / "sweep" / "damaged").mkdir()
    (folder / "sweep" / "damaged" / "run.json").write_text("{")

    def stop(progress: Any) -> None:
        if progress.phase == "comparison":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pfdist.run(job, folder / "unfinished", progress=stop)
    return {kind: pfdist.report(folder / kind) for kind in KINDS}


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
    for details in page.locator("details").all():
        details.locator("summary").click()
    broken = Axe().run(page).response["violations"]
    assert [(rule["id"], rule["nodes"][0]["html"]) for rule in broken] == []


@pytest.mark.parametrize("page", [(1200, "light")], indirect=True)
def test_a_click_on_a_head_sorts_a_table_and_another_turns_it_round(
    page: Any, reports: dict[str, Path]
) -> None:
    page.goto(reports["budget"].as_uri())
    table = page.locator("table").first
    first = table.locator("tbody th")
    assert first.all_inner_texts() == ["3", "4", "5"]
    head = table.get_by_role("button").first  # N
    head.click()
    assert first.all_inner_texts() == ["3", "4", "5"]
    head.press("Enter")
    assert first.all_inner_texts() == ["5", "4", "3"]
    assert table.locator("thead th").first.get_attribute("aria-sort") == "descending"


@LOOKS
def test_a_table_says_that_it_scrolls_if_it_does(page: Any, reports: dict[str, Path]) -> None:
    page.goto(reports["sweep"].as_uri())
    page.wait_for_function(
        """() => [...document.querySelectorAll(".table")].every(box =>
          getComputedStyle(box, "::before").content.includes("Scroll sideways")
          == box.scrollWidth > box.clientWidth)"""
    )
    assert page.viewport_size["width"] > 400 or page.locator(".scrolls").count()


@LOOKS
def test_the_links_of_a_sweep_lead_to_its_points_and_its_table_sorts(
    page: Any, reports: dict[str, Path]
) -> None:
    page.goto(reports["sweep"].as_uri())
    first = page.locator("table").first.locator("tbody th")
    assert [*first.all_inner_texts()] == ["3"] * 8 + ["4"] * 8
    head = page.locator("table").first.get_by_role("button", name="measurement_budget")
    head.click()
    head.click()
    assert first.all_inner_texts()[0] == "4"
    link = first.first.locator("a")
    name = link.get_attribute("title").removeprefix("report of ")
    assert "measurement_budget=4" in name
    link.click()
    page.wait_for_load_state()
    assert page.locator(".subtitle").inner_text() == f"Run {name}"


@pytest.mark.parametrize("page", [(1200, "dark")], indirect=True)
def test_it_prints_in_black_on_white(page: Any, reports: dict[str, Path]) -> None:
    page.goto(reports["plan"].as_uri())
    page.emulate_media(media="print", color_scheme="dark")
    colours = page.evaluate(
        "[getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
    )
    assert colours == ["rgb(0, 0, 0)", "rgb(255, 255, 255)"]
    assert len(page.pdf()) > 10_000


@pytest.mark.parametrize("page", [(1200, "light")], indirect=True)
def test_what_is_folded_away_is_printed(page: Any, reports: dict[str, Path]) -> None:
    heights = """[...document.querySelectorAll('details')].map(folded =>
        folded.offsetHeight - folded.querySelector('summary').offsetHeight)"""
    for kind in {*KINDS} - {"sweep"}:  # which folds nothing away
        page.goto(reports[kind].as_uri())
        page.emulate_media(media="screen")
        folded = page.evaluate(heights)
        assert folded
        assert max(folded) == 0
        page.emulate_media(media="print")
        assert min(page.evaluate(heights)) > 20
