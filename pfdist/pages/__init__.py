"""Parts of a page, what shows them (a terminal, an HTML page), and the figures of a run."""

from importlib import import_module
from types import ModuleType


def __getattr__(name: str) -> ModuleType:
    """`pfdist.plots`, which loads Matplotlib when it is used."""
    if name != "plots":
        raise AttributeError(name)
    return import_module("pfdist.pages.plots")
