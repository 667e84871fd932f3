"""The manual as a site: it builds without a warning, its links lead somewhere, it is shown."""

import http.server
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest

import pfdist

pytestmark = [pytest.mark.browser, pytest.mark.needs("browser"), pytest.mark.needs("docs")]

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(path.stem for path in DOCS.glob("*.md"))
LOOKS = ((400, "dark"), (1200, "light"))  # widths in pixels


class Anchors(HTMLParser):
    """The links of a page, and the names to which links may lead."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.links, self.ids = list[str](), set[str]()
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = {key: value or "" for key, value in attrs}
        self.ids |= {known["id"]} if "id" in known else set()
        self.links += [known[key] for key in ("href", "src") if key in known]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the site, built with warnings as errors."""
    folder = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", str(DOCS), str(folder)]
    built = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (built.returncode, built.stderr) == (0, "")
    return folder


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    """The address at which the site is served; a browser searches no page of a file."""
    handler = partial(_Silent, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


class _Silent(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002  the name is http.server's
        pass


def test_every_link_leads_to_a_page_and_to_a_name_on_it(site: Path) -> None:
    pages = {path: Anchors(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}
    wrong = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or path.name in ("search.html", "genindex.html"):
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            names = pages[target].ids if target in pages else set()
            if not target.is_file() or (parts.fragment and unquote(parts.fragment) not in names):
                wrong.append(f"{path.name}: {link}")
    assert wrong == []
    assert {f"{name}.html" for name in PAGES} <= {path.name for path in pages}


def test_every_public_name_is_in_the_reference(site: Path) -> None:
    pages = (page.read_text(encoding="utf-8") for page in site.glob("api-*.html"))
    names = {name for page in pages for name in Anchors(page).ids}
    modules = {"plots": "pfdist.plots.gain", "densities": "pfdist.densities.normal_logpdf"}
    wanted = {modules.get(name, f"pfdist.{name}") for name in pfdist.__all__}
    errors = {"pfdist.PfdistError": "pfdist.errors.PfdistError"}
    assert {errors.get(name, name) for name in wanted} - names == set()


@pytest.mark.parametrize(("width", "scheme"), LOOKS)
def test_every_page_fits_loads_nothing_from_elsewhere_and_prints_no_error(
    browser: Any, address: str, width: int, scheme: str
) -> None:
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page, wrong = context.new_page(), list[str]()
    page.on("console", lambda message: wrong.append(f"{page.url}: {message.text}"))
    page.on("pageerror", lambda error: wrong.append(f"{page.url}: {error}"))
    page.on(
        "response", lambda got: wrong.append(f"missing: {got.url}") if got.status > 399 else None
    )
    page.on(
        "request",
        lambda asked: None if asked.url.startswith((address, "data:")) else wrong.append(asked.url),
    )
    for name in PAGES:
        page.goto(f"{address}/{name}.html")
        assert page.locator("h1").first.inner_text()
        if page.evaluate("document.documentElement.scrollWidth") > width:
            wrong.append(f"{name} is wider than {width} pixels")
        shown = "[...document.images].filter(i => i.complete && !i.naturalWidth).map(i => i.src)"
        wrong += page.evaluate(shown)
        scrolls = "e => e.scrollWidth > e.clientWidth && e.tabIndex < 0"
        regions = f"[...document.querySelectorAll('pre, .table-wrapper, .math')].filter({scrolls})"
        if page.evaluate(f"{regions}.length"):
            wrong.append(f"{name} has a region that the keyboard cannot scroll")
        if page.locator("th").filter(has_not_text=re.compile(r"\S")).count():
            wrong.append(f"{name} has a column without a head")
    context.close()
    assert wrong == []


def test_every_page_has_a_description_of_its_own(site: Path) -> None:
    found = dict[str, str]()
    for name in PAGES:
        text = (site / f"{name}.html").read_text(encoding="utf-8")
        [found[name]] = re.findall(r'<meta name="description" content="(.{30,210}?)">', text)
    assert len(set(found.values())) == len(PAGES)


@pytest.mark.parametrize(
    ("asked", "page"),
    [
        ("satellite", "choose-model"),
        ("FAQ", "faq"),
        ("sampling schedule", "words"),
        ("optimal design", "words"),
        ("sensor scheduling", "words"),
        ("MCMC", "faq"),
        ("Kalman", "words"),
        ("budget", "words"),
        ("smoothing", "job-file"),
    ],
)
def test_the_search_finds_other_words_for_a_thing(
    browser: Any, address: str, asked: str, page: str
) -> None:
    tab = browser.new_page()
    tab.goto(f"{address}/search.html?q={asked.replace(' ', '+')}")
    link = f"ul.search li a[href*='{page}.html']"
    tab.wait_for_selector(link)
    assert tab.locator(link).first.is_visible()
    tab.close()


def test_the_search_finds_a_page_and_formulas_are_drawn(browser: Any, address: str) -> None:
    page = browser.new_page()
    page.goto(f"{address}/search.html?q=sampling+windows")
    page.wait_for_selector("ul.search li a")
    assert "questions.html" in " ".join(
        link.get_attribute("href") for link in page.locator("ul.search li a").all()
    )
    page.goto(f"{address}/paper.html")
    heights = "[...document.querySelectorAll('math')].map(m => m.getBoundingClientRect().height)"
    assert min(page.evaluate(heights)) > 5
    page.close()
