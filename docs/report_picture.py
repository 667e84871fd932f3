"""Make the pictures of *Read your report*: ``python docs/report_picture.py`` needs Chromium.

It plans jobs/plan.toml, opens the report, and puts numbers before what the page explains.
"""

import os
import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

import pfdist

FOLDER = Path(__file__).parent
PARTS = {  # picture: its element, and the texts before which the numbers stand, in their order
    "answer": (
        "section:has(#section-1)",
        ["Measure at", "4.71", "15.33", "32 evenly", "1.9", "With the plan"],
    ),
    "bound": (
        "section:has(#section-2) .table",
        ["21.95", "1.30", "1.9 %", "0.19", "1.12", "0.00"],
    ),
}
STYLE = """
.mark { background: #653700; color: white; border-radius: 1em; padding: 0 .45em; margin: 0 .25em;
        font: bold 0.8em sans-serif; display: inline-block }
section { border: 0 !important; margin: 0 !important; padding: 8px !important; max-width: 44em }
.table { padding: 8px; max-width: none; font-size: 0.72em }
.scrolls::before { display: none !important }
figure, svg { max-width: 560px }
"""
MARK = """(element, [text, number]) => {
  const walker = document.createTreeWalker(element, NodeFilter.SHOW_TEXT);
  for (let node; (node = walker.nextNode()); ) {
    const at = node.data.replace(/\\u00a0/g, " ").indexOf(text);
    if (at < 0 || node.parentElement.closest("caption, h2, svg, .mark")) continue;
    const mark = Object.assign(document.createElement("span"), {className: "mark"});
    mark.textContent = number;
    node.splitText(at).before(mark);
    return true;
  }
  return false;
}"""


def main() -> None:
    """Plan the job, and write the pictures."""
    program = os.environ.get("PFDIST_CHROMIUM") or shutil.which("chromium")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        run = pfdist.plan(FOLDER.parent / "jobs" / "plan.toml", Path(folder) / "plan", report=True)
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 900, "height": 900}, color_scheme="light")
        page.goto((run.path / "report.html").as_uri())
        page.add_style_tag(content=STYLE)
        page.evaluate("document.querySelectorAll('section details').forEach(e => (e.open = true))")
        number = 0
        for name, (selector, texts) in PARTS.items():
            element = page.locator(selector).first
            for text in texts:
                number += 1
                if not element.evaluate(MARK, [text, str(number)]):
                    raise SystemExit(f"the report has no text {text!r} in {name}")
            element.screenshot(path=FOLDER / "figures" / f"report-{name}.png")
        browser.close()


if __name__ == "__main__":
    main()
