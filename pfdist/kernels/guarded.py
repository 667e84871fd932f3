"""The compiler of formulas, under the name that kernels know; see `pfdist.jitted`."""

from pfdist.jitted import UNWRAPPED, Guarded

__all__ = ["UNWRAPPED", "Guarded"]
