"""The moves after each exponent of a moving filter, and the keys of their noise."""

from typing import Final, NamedTuple

import numpy as np

from pfdist.kernels.cached import compiled

WALK, INDEPENDENT, GAP, SUM = np.arange(4)
"""Kinds of moves; see `pfdist.moving.kernel`."""


class Move(NamedTuple):
    """A move of lines."""

    kind: np.signedinteger
    # in deviations of the cloud; of process noise, the sine of an autoregressive step
    scale: float
    span: float = 0.0  # of SUM: number of steps, in mean gaps between measurements


OF_CONSTANTS: Final = (
    Move(WALK, 1.0), Move(INDEPENDENT, 1.1), Move(WALK, 0.4), Move(INDEPENDENT, 1.1),
)  # fmt: skip
"""The moves of a model without process noise."""

OF_PATHS: Final = (
    Move(INDEPENDENT, 1.1), Move(SUM, 0.9, 1.0), Move(GAP, 0.5), Move(WALK, 0.4),
    Move(SUM, 0.6, 2.0), Move(INDEPENDENT, 1.1), Move(SUM, 0.9, 0.75), Move(GAP, 0.15),
)  # fmt: skip
"""The moves of a model with process noise. The first keeps the path, if noise is additive."""


@compiled
def derived(key, number):
    """A key that is made from another one and a number."""
    mixed = np.uint64(key) + (np.uint64(number) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> np.uint64(31))
