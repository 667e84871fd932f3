"""Optimal measurement times for particle filtering, computed in parallel."""

from importlib.metadata import version

import lazy_loader

# Names are loaded when they are used, so a worker does not wait for pandas or matplotlib.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__version__ = version("pfdist")
