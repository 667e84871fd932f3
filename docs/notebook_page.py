"""Run notebook.ipynb and write its page with all outputs: ``python docs/notebook_page.py``.

It needs ``pip install -e '.[notebook]'``. A test compares the code of the page with the notebook's.
"""

import base64
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parent
NOTE = (
    "\n\nThis page is [notebook.ipynb](notebook.ipynb) with its outputs; "
    "download it to run it yourself."
)
PAPER = 'style="background: white"'  # of a picture on any page
SECONDS = 900  # for a cell


def main() -> None:
    """Run the notebook, and write the page and its pictures."""
    notebook = nbformat.read(FOLDER / "notebook.ipynb", as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        resources = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=SECONDS, resources=resources).execute()
    write(notebook)


def write(notebook: Any) -> None:
    """Write the page of a notebook that has run."""
    parts, pictures, heading = list[str](), 0, ""
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            heading = cell.source.partition("\n")[0].lstrip("# ")
            parts.append(cell.source + ("" if parts else NOTE))
            continue
        parts.append(f"```python\n{cell.source.rstrip(';')}\n```")
        for data in _shown(cell.outputs):
            html, png = data.get("text/html", ""), data.get("image/png", "")
            drawing = re.search(r"(?s)<div[^>]*>(<svg.*?</svg>)</div>", html)
            if html and not png:
                html = html.replace(drawing[0], "") if drawing else html
                parts.append(f"```{{raw}} html\n{_table(html)}\n```")
            if png or drawing:
                pictures += 1
                name = f"figures/notebook-{pictures}.{'png' if png else 'svg'}"
                svg = drawing[1].replace("<svg", f"<svg {PAPER}", 1) if drawing else ""
                (FOLDER / name).write_bytes(base64.b64decode(png) if png else svg.encode())
                parts.append(f"![{heading}]({name})")
    page = "\n\n".join(["---\norphan: true\n---", *parts, ""])
    (FOLDER / "notebook.md").write_text(page, encoding="utf-8")


def _shown(outputs: list[Any]) -> Iterator[dict[str, str]]:
    """Outputs with something to see; the empty ones are progress that has ended."""
    for output in outputs:
        data = output.get("data", {})
        if "image/png" in data or data.get("text/html", "").strip():
            yield data


def _table(html: str) -> str:
    """HTML in the site's look; the column of a DataFrame's index gets a head."""
    html = re.sub(r"(?s)<style.*?</style>", "", html).replace("<th></th>", "<th>row</th>", 1)
    html = re.sub(r"<table[^>]*>", '<table class="docutils">', html)
    for old, new in (
        ("<table", '<div class="table-wrapper docutils container"><table'),
        ("</table>", "</table></div>"),
        ("white-space:pre;overflow-x:auto", "white-space:pre-wrap"),
    ):
        html = html.replace(old, new)
    return "\n".join(line for line in html.splitlines() if line.strip())


if __name__ == "__main__":
    main()
