"""Figures as pictures of a page: SVG elements with the colours of the page and unique ids."""

import io
import re
from collections.abc import Iterator
from dataclasses import replace
from xml.etree import ElementTree

from pfdist.common.parts import Block, Figures, Page, Picture, Section
from pfdist.errors import printable
from pfdist.pages.figure import FIGURES, Plot, Tables, drawn
from pfdist.pages.style import PALETTE, SCREEN, styled
from pfdist.results import Run
from pfdist.results.run import SHOWN

_SVG, _LINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_COLOURS = {
    "#000000": "currentColor",
    "#ffffff": "var(--card, white)",
    **{light: f"var(--{name}, {light})" for name, (light, _) in PALETTE.items()},
}
_COLOUR = re.compile("|".join(_COLOURS), re.IGNORECASE)
_INCHES = (5.4, 3.0)
"""Text of the screen's size is then as large as the page's, and still legible on a phone."""
_NOT_DRAWN = ("metadata", "style")
"""Elements that Matplotlib writes and a page does not need."""


def with_pictures(page: Page, run: Run) -> Page:
    """A page with pictures in the places for figures; with none before the comparison has begun.

    A section in which only details are left is folded away.
    """
    tables = Tables(run)

    def filled(section: Section) -> Section:
        blocks = list[Block]()
        for block in section.blocks:
            blocks += _pictures(tables, block) if isinstance(block, Figures) else [block]
        is_folded = section.folded or all(block.detail for block in blocks)
        return replace(section, blocks=blocks, folded=is_folded)

    return replace(page, sections=[filled(section) for section in page.sections])


SHOWN.declare("pictures", with_pictures)


def _pictures(tables: Tables, figures: Figures) -> Iterator[Picture]:
    if not tables.run.draws_compared:
        return
    for name in figures.names:
        figure = FIGURES[name]
        shown = None if figures.sets is None else {f"{name}-{each}" for each in figures.sets}
        for file, plot in figure.plots(tables):
            if not figure.each_set or shown is None or file in shown:
                yield replace(picture(plot, file, figure.description), detail=figures.detail)


def picture(plot: Plot, name: str, description: str) -> Picture:
    """A plot as a picture of a page: an SVG element with its title.

    Parameters
    ----------
    plot : Plot
    name : str
        Comes before all ids of the element, so that two elements of a page share none.
    description : str
        A line for those who cannot see the figure.
    """
    file = io.StringIO()
    with styled(SCREEN, {"figure.figsize": _INCHES}):
        drawn(plot).savefig(file, format="svg", transparent=True, metadata={"Date": None})
    ElementTree.register_namespace("", _SVG)
    svg = ElementTree.fromstring(file.getvalue())  # noqa: S314  it was written just above
    for parent in list(svg.iter()):
        for child in list(parent):
            if child.tag.removeprefix(f"{{{_SVG}}}") in _NOT_DRAWN:
                parent.remove(child)
    for element in svg.iter():
        _adapt(element, f"{name}-")
    for key in ("width", "height", "version"):
        svg.attrib.pop(key, None)
    svg.attrib |= {"role": "img", "aria-label": printable(description)}
    return Picture(plot.title, description, ElementTree.tostring(svg, encoding="unicode"),
                   wide=plot.columns > 1)  # fmt: skip


def _adapt(element: ElementTree.Element, prefix: str) -> None:
    """Give an element the colours of the page, and ids that begin with a prefix."""
    link = element.attrib.pop(f"{{{_LINK}}}href", None)
    if link is not None:
        element.set("href", f"#{prefix}{link[1:]}" if link.startswith("#") else link)
    for key, value in element.attrib.items():
        if key == "id":
            element.set(key, prefix + value)
        elif key != "href":
            named = value.replace("url(#", f"url(#{prefix}")
            element.set(key, _COLOUR.sub(lambda match: _COLOURS[match[0].lower()], named))
