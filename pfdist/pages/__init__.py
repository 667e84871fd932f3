"""Parts of a page, what shows them (a terminal, an HTML page), and the figures of a run."""

import lazy_loader

# `pfdist.plots` is the module `plots`, which loads Matplotlib when it is used.
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submodules=["plots"])
