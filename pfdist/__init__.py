"""When to measure: optimal measurement times for particle filtering, computed in parallel."""

from importlib.metadata import version

import lazy_loader

# What a worker does not need, pandas, scipy.stats and matplotlib, it does not wait for.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__version__ = version("pfdist")
