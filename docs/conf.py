"""The manual as a site: ``sphinx-build -W docs build/site`` writes it to ``build/site``."""

from html import escape
from textwrap import shorten
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

import pfdist
from pfdist.pages.style import PALETTE

project = "pfdist"
author = "The pfdist developers"
release = version = pfdist.__version__
html_title = f"pfdist {release}"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4  # pages link to headings by the names that GitHub gives them
exclude_patterns = ["*.ipynb", "*.py", "paper/*"]
highlight_language = "none"

autodoc_typehints = "none"  # the sections of the docstrings have the types
autodoc_member_order = "bysource"
napoleon_numpy_docstring, napoleon_google_docstring = True, False
smartquotes = False  # quotes and dashes of options are what one types
default_role = "literal"  # docstrings name functions and arguments between single backticks

html_theme = "furo"
html_theme_options = {
    f"{mode}_css_variables": {"color-brand-primary": colour, "color-brand-content": colour}
    for mode, colour in zip(("light", "dark"), PALETTE["blue"], strict=True)
}
html_theme_options["footer_icons"] = [
    {"name": name, "html": name, "url": f"{page}.html", "class": ""}
    for name, page in (
        ("Index", "genindex"),
        ("Changes", "changes"),
        ("Contributing", "contributing"),
        ("Security", "security"),
    )
]
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_logo = html_favicon = "static/logo.svg"
html_copy_source = False
html_show_copyright = False
html_math_renderer = "mathml"  # what browsers read themselves, so a page loads nothing


def _inline(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(tex2mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def _block(translator: HTML5Translator, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def _name_pages(app: Sphinx, tree: nodes.document, name: str) -> None:
    """Links whose text is a file of the manual, as in ``bound.md``, get the title of the page."""
    for link in tree.findall(nodes.reference):
        page = link.astext().removesuffix(".md")
        if link.astext() != page and page in app.env.titles:
            link.children = [nodes.emphasis("", app.env.titles[page].astext())]


def _describe(
    _app: Sphinx, _name: str, _template: str, context: dict[str, Any], tree: nodes.document | None
) -> None:
    """The description of a page, which search engines show, is its first paragraph."""
    if tree is not None and 'name="description"' not in context["metatags"]:
        texts = (" ".join(part.astext().split()) for part in tree.findall(nodes.paragraph))
        text = shorten(
            next((text for text in texts if len(text) > 40), ""), 200, placeholder=" ..."
        )
        context["metatags"] += f'<meta name="description" content="{escape(text)}">'


def setup(app: Sphinx) -> None:
    """Register the renderer of formulas, the titles of links, and the descriptions."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.connect("doctree-resolved", _name_pages)
    app.connect("html-page-context", _describe)
