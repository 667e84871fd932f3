"""Values of single operations of programs, by machine code."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pfdist.kernels.blocks import call, run
from pfdist.kernels.lowering import Half, machine_code
from pfdist.kernels.vectors import LANES, ahead, with_pointers
from pfdist.models.program import MASKS, Operation


def computed(name, *arguments):
    """The values of an operation for arrays of numbers; masks are 1 and 0."""
    size = max(np.size(each) for each in arguments)
    slots = np.ones((len(arguments), -(-size // LANES) * LANES))
    for row, values in zip(slots, arguments, strict=True):
        row[:size] = values
    leaves = [Operation("slots", (), row) for row in range(len(arguments))]
    operations = [*leaves, Operation(name, tuple(range(len(leaves))))]
    if name in MASKS:
        operations.append(Operation("float", (len(leaves),)))
    half = Half(tuple(operations), (len(operations) - 1,), ())
    out = np.empty((1, slots.shape[1]))
    run(machine_code((half,)).addresses[half], out, slots)
    return out[0, :size]


def called(blocks, t, x, w, y, outputs):
    """Results of the first block at t, (outputs, D, W), for x and w (rows, D, W) and y (D, m)."""
    draws, width = x.shape[1:]
    out = np.empty((outputs, draws, width))
    x, w, y = (np.ascontiguousarray(each) for each in (x, w, y))
    address, place = int(blocks.addresses[0, t]), int(blocks.places[0, t])
    _call(address, _Arrays(out, x, w, y, blocks.table, y.shape[1], draws, width), place)
    return out


class _Arrays(NamedTuple):
    out: NDArray[np.float64]
    x: NDArray[np.float64]
    w: NDArray[np.float32]
    y: NDArray[np.float64]
    table: NDArray[np.float64]
    components: int
    draws: int
    width: int


@njit
def _call(address, arrays, place):
    given, stride = with_pointers(arrays), arrays.draws * arrays.width
    call(
        address, (given.out, stride), (given.x, stride), (given.w, stride),
        (given.y, given.components, 1), ahead(given.table, place), (given.draws, given.width),
    )  # fmt: skip
