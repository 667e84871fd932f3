"""The page in a real Chromium: mouse, touch, keyboard, constraints, and what may go wrong."""

import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

import pytest

import pfdist
from oracles.explored import SMALL, served
from oracles.three_sensors import SYSTEMS
from pfdist import load_job
from pfdist.plugins.explorer import server
from pfdist.plugins.explorer.session import ExplorerSession, reply

pytestmark = [pytest.mark.browser, pytest.mark.needs("browser")]

HOSTILE = "<img src=x onerror=alert(1)>"
EXACT = ("model.name=random_walk", "filter.engine=kalman", "search=[{method='survivors'}]")
JUDGE = "Judge on fresh draws"
Open = Callable[..., Any]


@pytest.fixture
def open_page(browser: Any) -> Iterator[Open]:
    """Open an address; in the end, nothing may be on the console or asked from elsewhere.

    A test that loses the connection on purpose allows what Chromium then says.
    """
    contexts, wrong, own = list[Any](), list[str](), list[str]()
    allowed = list[str]()

    def open_it(address: str, width: int = 1000, scheme: str = "light", **settings: Any) -> Any:
        context = browser.new_context(
            viewport={"width": width, "height": 900}, color_scheme=scheme, **settings
        )
        context.set_default_timeout(30_000)
        contexts.append(context)
        own.append(address)
        page = context.new_page()
        page.on("console", lambda message: wrong.append(message.text))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda asked: asked.url.startswith((address, "data:", "blob:"))
                or wrong.append(asked.url))  # fmt: skip
        page.on("websocket", lambda each: each.url.startswith(address.replace("http", "ws"))
                or wrong.append(each.url))  # fmt: skip
        page.on("dialog", lambda dialog: wrong.append(dialog.message))
        page.goto(address)
        page.locator("dl div").first.wait_for()
        return page

    open_it.allowed = allowed  # type: ignore[attr-defined]
    yield open_it
    for context in contexts:
        context.close()
    assert [text for text in wrong if not any(part in text for part in allowed)] == []


def times(page: Any) -> list[int]:
    return sorted(int(each.get_attribute("aria-valuenow")) for each in sliders(page).all())


def sliders(page: Any) -> Any:
    return page.get_by_role("slider")


def slider(page: Any, at: int) -> Any:
    return page.locator(f'[role="slider"][aria-valuenow="{at}"]').first


def center(box: dict[str, float]) -> tuple[float, float]:
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def place(page: Any, t: float) -> float:
    """The x of a time, from the places of the first and last time of the reference."""
    first, last = page.locator("circle.even").first, page.locator("circle.even").last
    left, right = (center(each.bounding_box())[0] for each in (first, last))
    return left + (right - left) * t / 12


def drag(page: Any, at: int, to: float) -> None:
    x, y = center(slider(page, at).bounding_box())
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(1, 9):
        page.mouse.move(x + (place(page, to) - x) * step / 8, y)
    page.mouse.up()


def shown(page: Any, term: str) -> str:
    head = page.locator("dt", has_text=re.compile(f"^{term}$"))
    text: str = page.locator("dl div").filter(has=head).locator("dd").inner_text()
    return text


def wait(page: Any, is_so: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < end
        page.wait_for_timeout(30)


def answered(page: Any, session: Any, term: str = "expected MSE") -> None:
    """Wait for the figures of the times on the page, on any number of draws."""
    chosen = times(page)

    def is_known() -> bool:
        draws = int(
            re.findall(r"\(([\d,]+)\)", page.locator(".mark").inner_text())[0].replace(",", "")
        )
        return shown(page, term) == dict(session.answer(chosen, draws)["facts"])[term]

    wait(page, is_known)


# --- times ----------------------------------------------------------------------------------------


def test_a_dragged_time_moves_to_allowed_instants_only_and_the_figures_follow(
    open_page: Open, address: str, session: ExplorerSession
) -> None:
    page = open_page(address)
    before = times(page)
    assert before == [*session.even] == [0, 4, 8, 12]
    drag(page, 8, 9.2)  # 9 and 10 are forbidden; 11 is too near to 12
    assert times(page) == before
    drag(page, 12, 10.6)
    assert times(page) == [0, 4, 8, 11]
    answered(page, session)
    drag(page, 8, 5.1)  # 5 is too near to 4, 6 is not
    assert times(page) == [0, 4, 6, 11]
    answered(page, session)
    drag(page, 4, 2)  # required
    assert times(page) == [0, 4, 6, 11]
    assert page.locator(".broken li").count() == 0
    assert "against regular times" in page.locator("dl.verdict").inner_text()
    drag(page, 6, 1.9)  # past the required time
    assert times(page) == [0, 2, 4, 11]


def test_the_paired_difference_stands_first_and_is_the_largest(
    open_page: Open, address: str, session: ExplorerSession
) -> None:
    page = open_page(address)
    slider(page, 12).press("ArrowLeft")
    answered(page, session)
    assert " ± " in shown(page, "expected MSE against regular times")
    own, *others = page.evaluate("""() => [...document.querySelectorAll(".verdict dd, main *")]
        .sort((a, b) => b.matches(".verdict dd") - a.matches(".verdict dd"))
        .map((each) => parseFloat(getComputedStyle(each).fontSize))""")
    assert own > max(others)
    difference, chart = (page.locator(each).bounding_box() for each in (".verdict", "figure"))
    assert difference["y"] + difference["height"] < chart["y"]


def test_touch_drags_too(open_page: Open, address: str) -> None:
    page = open_page(address, width=400, has_touch=True, is_mobile=True)
    x, y = center(slider(page, 12).bounding_box())
    client = page.context.new_cdp_session(page)

    def touch(kind: str, *points: dict[str, float]) -> None:
        client.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [*points]})

    touch("touchStart", {"x": x, "y": y})
    for step in range(1, 9):
        touch("touchMove", {"x": x + (place(page, 11) - x) * step / 8, "y": y})
    touch("touchEnd")
    assert times(page) == [0, 4, 8, 11]


def test_times_are_added_and_removed(
    open_page: Open, address: str, session: ExplorerSession
) -> None:
    page = open_page(address)
    strip = page.locator("rect.strip.yours").bounding_box()
    page.mouse.click(place(page, 6), strip["y"] + strip["height"] / 2)
    assert times(page) == [0, 4, 6, 8, 12]
    broken = "Broken constraint: measurement_budget is 4, got 5 times"
    wait(page, lambda: page.locator(".broken li").all_inner_texts() == [broken])
    slider(page, 6).dblclick()
    wait(page, lambda: times(page) == [0, 4, 8, 12])
    wait(page, lambda: page.locator(".broken li").count() == 0)
    slider(page, 8).focus()
    page.keyboard.press("Delete")
    assert times(page) == [0, 4, 12]
    page.get_by_role("button", name="Add a time").click()  # to the largest gap
    assert times(page) == [0, 4, 8, 12]
    page.get_by_role("button", name="Remove").click()
    assert times(page) == [0, 4, 12]
    slider(page, 4).focus()
    assert page.get_by_role("button", name="Remove").is_disabled()  # required
    page.keyboard.press("Delete")
    assert times(page) == [0, 4, 12]
    page.get_by_role("button", name="Start from regular times").click()
    assert times(page) == [*session.even]


def test_the_keyboard_does_all(open_page: Open, address: str) -> None:
    page = open_page(address)
    slider(page, 0).focus()
    for key, at in (  # 3 and 5 are too near to the required time, 7, 9 and 10 are forbidden
        ("ArrowRight", 1), ("ArrowUp", 2), ("PageDown", 0), ("ArrowRight", 1), ("End", 6),
        ("ArrowLeft", 2), ("Home", 0), ("PageUp", 2),
    ):  # fmt: skip
        page.keyboard.press(key)
        assert times(page) == sorted([at, 4, 8, 12]), key
    focused = page.locator(":focus")
    assert focused.get_attribute("role") == "slider"
    assert focused.get_attribute("aria-label") == "Measurement 1 of 4"
    assert focused.get_attribute("aria-valuetext") == "2"
    assert slider(page, 4).get_attribute("aria-disabled") == "true"
    reached = list[str]()
    page.locator("h1").click()
    for _ in range(15):  # four times and eleven more
        page.keyboard.press("Tab")
        reached.append(page.locator(":focus").text_content())
    assert {"Add a time", "Remove", JUDGE, "Name and keep", "Copy command"} <= {*reached}
    assert reached[-1] == "Download job"


def test_fingers_have_buttons_and_every_change_can_be_undone(open_page: Open, address: str) -> None:
    page = open_page(address, width=400, has_touch=True, is_mobile=True)
    for each in page.get_by_role("button").all():
        box = each.bounding_box()
        assert box is None or min(box["width"], box["height"]) >= 44
    slider(page, 12).focus()
    page.get_by_role("button", name="Earlier").tap()
    assert times(page) == [0, 4, 8, 11]
    page.get_by_role("button", name="Later").tap()
    page.get_by_role("button", name="Remove").tap()
    assert times(page) == [0, 4, 8]
    page.get_by_role("button", name="Add a time").tap()
    for expected in ([0, 4, 8], [0, 4, 8, 12], [0, 4, 8, 11]):
        page.get_by_role("button", name="Undo").tap()
        assert times(page) == expected
    page.keyboard.press("Control+z")
    assert times(page) == [0, 4, 8, 12]
    assert page.get_by_role("button", name="Undo").is_disabled()


def test_a_reader_hears_the_answer_once_it_is_still(open_page: Open, address: str) -> None:
    page = open_page(address)
    slider(page, 0).press("ArrowRight")
    live = page.locator(".live")
    wait(page, lambda: "against regular times" in live.inner_text())
    assert live.get_attribute("role") == "status"
    assert "on these draws" in live.inner_text()


# --- sensors --------------------------------------------------------------------------------------


def test_each_sensor_has_a_strip_and_its_own_forbidden_times(
    open_page: Open, of_sensors: ExplorerSession
) -> None:
    with served(of_sensors) as address:
        page = open_page(address)
        heads = page.locator(".lanes text").all_text_contents()
        assert heads[3:] == ["Yours: near", "Yours: far", "Yours: both"]
        count = sliders(page).count()
        page.get_by_role("button", name="Add far").click()
        assert sliders(page).count() == count + 1
        focused = page.locator(":focus")
        assert focused.get_attribute("aria-valuetext").endswith(" far")
        focused.press("Home")
        for expected in ("1 far", "2 far", "6 far"):
            page.keyboard.press("ArrowRight")
            assert page.locator(":focus").get_attribute("aria-valuetext") == expected
        assert page.locator("rect.forbidden").count() == 2 * 3


def test_spacing_of_a_late_sensor_counts_when_it_measures(
    open_page: Open,
) -> None:
    """Steps may differ by rounding, so instants that are far enough apart may be, too."""
    rounding, never = 0.9e-9, {"forbidden": ["0:12"]}
    problem = pfdist.Problem(
        SYSTEMS[0].as_model(),
        times=[0, 1, 2, 3 - rounding, 4 - 2 * rounding, 5 - rounding, *range(6, 13)],
        measurement_budget=2,
        engine="kalman",
        sensors={"near": {"delay": 2, "minimum_spacing": 2}, "far": never, "both": never},
        required=["2 near"],
    )
    session = ExplorerSession(problem)
    ((held,), sets) = session.feasible.required, session.feasible
    arrivals = [t for t in range(2, 13) if 3 * t != held]
    allowed = [t - 2 for t in arrivals if not sets.broken(sorted((held, 3 * t)))]
    with served(session) as address:
        page = open_page(address)
        sliders(page).last.focus()
        page.keyboard.press("Home")
        found = [int(page.locator(":focus").get_attribute("aria-valuenow"))]
        for _ in allowed[1:]:
            page.keyboard.press("ArrowRight")
            found.append(int(page.locator(":focus").get_attribute("aria-valuenow")))
        assert found == allowed


def test_prices_are_shown_and_counted(open_page: Open) -> None:
    prices = "problem.price={'0:6'=1, '7:12'=2.5}"
    job = load_job(SMALL, [prices, "problem.total_price=4", *EXACT], {"problem": {"horizon": 12}})
    with served(ExplorerSession(job)) as address:
        page = open_page(address)
        assert re.fullmatch(r"\d, price [\d.]+ of 4", shown(page, "measurements"))
        assert page.locator("rect.price").count() == 13
        page.get_by_role("button", name="Add a time").click()
        page.keyboard.press("End")
        assert page.locator(":focus").get_attribute("aria-valuetext").endswith(", price 2.5")
        wait(page, lambda: "total_price is 4" in page.locator(".broken").inner_text())


# --- judging and keeping --------------------------------------------------------------------------


def test_sets_are_judged_kept_copied_and_saved(
    open_page: Open, address: str, session: ExplorerSession, tmp_path: Path
) -> None:
    before = len(session.judgements())
    page = open_page(address, permissions=["clipboard-read", "clipboard-write"])
    assert page.locator(".mark").inner_text().startswith("on these draws")
    for number, name in enumerate(("first", "second")):
        slider(page, times(page)[0]).press("ArrowRight")
        page.get_by_label("Name").fill(name)
        page.get_by_role("button", name="Name and keep").click()
        page.get_by_role("button", name=f"Use {name}").wait_for()
        page.get_by_role("button", name=JUDGE).click()
        page.locator(".judged tbody tr").nth(before + number).wait_for()
        page.get_by_role("button", name=JUDGE).wait_for()
    rows = page.locator(".judged tbody th").all_inner_texts()[before:]
    assert rows[:2] == ["first", "second"]
    assert all(row.endswith(" (judged once more)") for row in rows[2:])
    assert "intervals hold together with 95 %" in page.locator("caption").inner_text()
    wait(page, lambda: "judged on fresh draws" in page.locator(".mark").inner_text())
    page.get_by_role("button", name="Use first").click()
    assert times(page) == [1, 4, 8, 12]
    page.get_by_role("button", name="Copy command").click()
    wait(page, lambda: "pfdist compare" in page.evaluate("navigator.clipboard.readText()"))
    assert "first=1,4,8,12" in page.evaluate("navigator.clipboard.readText()")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download job").click()
    file = tmp_path / "job.toml"
    download.value.save_as(file)
    assert [*pfdist.load_job(file).given_sets] == ["regular", "first", "second"]


def test_hostile_names_are_text(open_page: Open, session: ExplorerSession) -> None:
    class Hostile:
        """A session whose model, run, units and sentences are markup."""

        def state(self) -> dict[str, Any]:
            state = session.state() | {"model": HOSTILE, "run": HOSTILE, "unit": HOSTILE}
            return state | {
                "judged": [],
                "budget": HOSTILE,
                "components": [{"name": HOSTILE, "unit": HOSTILE}],
            }

        def answer(self, chosen: Sequence[int], draws: int) -> dict[str, Any]:
            answer = session.answer(chosen, draws)
            return answer | {"facts": [(HOSTILE, HOSTILE)], "broken": [HOSTILE], "mark": HOSTILE}

        def judge(self, name: str, _: Sequence[int]) -> list[dict[str, Any]]:
            return [{"name": name, "text": HOSTILE, "draws": 3, "written": HOSTILE, "again": False}]

    with served(Hostile()) as address:
        page = open_page(address)
        page.get_by_label("Name").fill(HOSTILE)
        page.get_by_role("button", name=JUDGE).click()
        page.locator(".judged tbody tr").first.wait_for()
        assert page.locator(".judged tbody th").inner_text() == HOSTILE
        assert HOSTILE in page.locator("h1").inner_text()
        assert page.locator("img").count() == 0


def test_a_name_that_is_not_allowed_is_explained(
    open_page: Open, address: str, session: ExplorerSession
) -> None:
    page = open_page(address)
    page.get_by_label("Name").fill(HOSTILE)
    page.get_by_role("button", name="Name and keep").click()
    wait(page, lambda: "lower-case letters" in page.get_by_role("alert").inner_text())
    assert page.locator(".kept li").count() == 0
    slider(page, 12).press("ArrowLeft")
    answered(page, session)
    page.wait_for_timeout(500)  # an answer about times does not remove the message about a name
    assert "lower-case letters" in page.get_by_role("alert").inner_text()


# --- what may go wrong ----------------------------------------------------------------------------


def test_a_slow_model_drops_stale_moves_and_says_that_it_computes(
    open_page: Open, session: ExplorerSession
) -> None:
    asked, go_on = list[tuple[int, ...]](), threading.Event()
    go_on.set()

    def answer(chosen: Sequence[int], draws: int) -> dict[str, Any]:
        asked.append(tuple(chosen))
        assert go_on.wait(30)
        return session.answer(chosen, draws) | {"finer": None}

    with served(SimpleNamespace(state=session.state, answer=answer)) as address:
        page = open_page(address)
        asked.clear()
        go_on.clear()
        slider(page, 12).press("ArrowLeft")
        slider(page, 8).focus()
        for _ in range(3):
            page.keyboard.press("ArrowLeft")
            page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowLeft")
        wait(page, lambda: page.locator(".banner").inner_text() == "Computing…")
        go_on.set()
        wait(page, lambda: len(asked) == 2)
        page.wait_for_timeout(300)
        assert asked == [(0, 4, 8, 11), (0, 4, 6, 11)]
        assert page.locator(".banner").inner_text() == ""


def test_finer_draws_follow_while_the_user_rests(open_page: Open, address: str) -> None:
    page = open_page(address)
    slider(page, 12).press("ArrowLeft")
    draws = list[int]()

    def more() -> bool:
        now = int(re.findall(r"([\d,]+)\)", page.locator(".mark").inner_text())[0].replace(",", ""))
        draws.append(now)
        return now >= 4 * min(draws)

    wait(page, more)
    since = draws[draws.index(min(draws)) :]  # before, the answer was that of the former times
    assert since == sorted(since)


def test_the_file_that_a_browser_gets_leads_to_the_page(
    browser: Any, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = SimpleQueue[str]()
    monkeypatch.setattr("webbrowser.open", opened.put)
    with server._browser(address), closing(browser.new_page()) as page:
        page.goto(opened.get(timeout=20))
        page.locator("dl div").first.wait_for()
        assert page.url == address
        assert page.evaluate("document.referrer") == ""


def test_a_lost_connection_is_said_and_found_again(
    open_page: Open, session: ExplorerSession
) -> None:
    open_page.allowed.append("WebSocket connection to")  # type: ignore[attr-defined]
    with served(session) as address:
        page = open_page(address)
        slider(page, 12).press("ArrowLeft")
        port = int(address.split(":")[2].split("/")[0])
    wait(page, lambda: page.locator(".banner").inner_text().startswith("Connection lost."))
    slider(page, 8).press("ArrowLeft")
    assert times(page) == [0, 4, 6, 11]
    with served(session, port):
        wait(page, lambda: page.locator(".banner").inner_text() == "")
        assert times(page) == [0, 4, 6, 11]
        answered(page, session)


def test_two_pages_have_their_own_times(
    open_page: Open, address: str, session: ExplorerSession
) -> None:
    pages = [open_page(address), open_page(address)]
    for _ in range(2):
        for page, at in zip(pages, (12, 8), strict=True):
            if at in times(page):
                slider(page, at).press("ArrowLeft")
    assert [times(page) for page in pages] == [[0, 4, 8, 11], [0, 4, 6, 12]]
    for page in pages:
        answered(page, session)


_RENDER = """async () => {
  const { default: widget } = await import(new URL("explore.js", location.href));
  const el = document.createElement("div");
  let heard = [];
  document.querySelector("main").replaceChildren(el);
  window.stop = widget.render({ el, model: {
    on: (_, callback) => { heard.push(callback); },
    off: (_, callback) => { heard = heard.filter((each) => each !== callback); },
    async send(message) {
      const answer = await window.kernel(message);
      heard.forEach((callback) => callback(answer, []));
    },
  } });
}"""


def test_the_widget_shows_the_same_in_a_notebook(
    open_page: Open, address: str, session: ExplorerSession
) -> None:
    page = open_page(address)
    page.expose_function("kernel", lambda message: reply(session, message))
    page.evaluate(_RENDER)
    page.locator("dl div").first.wait_for()
    slider(page, 12).press("ArrowLeft")
    assert times(page) == [0, 4, 8, 11]
    answered(page, session)
    page.evaluate("window.stop()")


# --- looks ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [400, 1000])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everyone_can_read_and_use_it(
    open_page: Open, address: str, of_sensors: ExplorerSession, width: int, scheme: str
) -> None:
    from axe_playwright_python.sync_playwright import Axe

    with served(of_sensors) as other:
        for each in (address, other):
            page = open_page(each, width, scheme)
            sliders(page).first.focus()
            page.keyboard.press("ArrowRight")
            page.get_by_role("button", name="Add").first.click()
            page.get_by_role("button", name="Name and keep").click()
            page.get_by_role("button", name="Use mine").wait_for()
            page.get_by_role("button", name=JUDGE).click()
            page.locator(".judged tbody tr").first.wait_for()
            page.get_by_role("button", name=JUDGE).wait_for()
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            broken = Axe().run(page).response["violations"]
            assert [(rule["id"], rule["nodes"][0]["html"]) for rule in broken] == []
            paper = page.evaluate("getComputedStyle(document.documentElement).backgroundColor")
            assert paper == {"light": "rgb(255, 255, 255)", "dark": "rgb(22, 24, 28)"}[scheme]


def test_colours_are_those_of_figures() -> None:
    from pfdist.pages.style import PALETTE

    folder = Path(pfdist.__file__).parent / "plugins" / "explorer"
    css = (folder / "explore.css").read_text()
    for name in ("red", "blue", "ochre", "green"):
        assert re.findall(rf"--{name}: (#\w+);", css) == [*PALETTE[name]]
