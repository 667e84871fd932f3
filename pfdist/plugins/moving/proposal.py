"""The declaration of the proposal `moving`."""

from typing import Final

from pfdist.filters.engines import COMPILED, NUMPY
from pfdist.filters.proposal import Proposal

MOVING: Final = Proposal(
    "moving",
    engines=(COMPILED.name, NUMPY.name),
    moves=True,
    why="because a plain filter loses the constants among the components of x",
    described="a particle filter with {}, whose paths take Metropolis steps",
    times_beside_truth=5,
    takes_weights=False,
    extended_by="pfdist.plugins.moving.arrays:moved_extension",
    twin_by="pfdist.plugins.moving.plain:filter_block",
)
