"""Optimal measurement times for particle filtering, computed in parallel."""

from importlib.metadata import version

from pfdist.common.stub import names_of_stub

__version__ = version("pfdist")
__getattr__, __all__ = names_of_stub(globals())


def __dir__() -> list[str]:
    return __all__
