"""Draw the picture of `pfdist explore`: ``python docs/explore_pictures.py RUN``.

RUN is a run of jobs/pharmacokinetics.toml for which `pfdist why` was asked. A real Chromium shows
the page of ``pfdist explore``.
"""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from playwright.sync_api import Locator, sync_playwright

FIGURES = Path(__file__).parent / "figures"
WIDTH, SECONDS = 620, 30


def main(run: str) -> None:
    """Start the command, and take the picture."""
    words = [sys.executable, "-m", "pfdist", "explore", run, "--no-browser"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as command:  # noqa: S603
        try:
            _take(str(command.stdout and command.stdout.readline()).strip())
        finally:
            command.terminate()


def _take(address: str) -> None:
    chromium = shutil.which("chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": 800})
        page.goto(address)
        _settle(page)
        _times(page).nth(3).press("ArrowRight")
        _judge(page, 1)
        _times(page).nth(4).press("ArrowRight")
        _judge(page, 3)
        _settle(page)
        page.screenshot(path=FIGURES / "explore.png", full_page=True)
        browser.close()


def _times(page: Any) -> Locator:
    slider: Locator = page.get_by_role("slider")
    return slider


def _judge(page: Any, rows: int) -> None:
    page.get_by_role("button", name="Judge").click()
    page.locator(".judged tbody tr").nth(rows - 1).wait_for(timeout=SECONDS * 1000)
    page.get_by_role("button", name="Judge on").wait_for()


def _settle(page: Any) -> None:
    page.locator("dl div").first.wait_for()
    page.wait_for_timeout(6000)  # until the draws are fine


if __name__ == "__main__":
    main(sys.argv[1])
