"""Values of single operations of programs, by machine code."""

import numpy as np
from numba import njit

from pfdist.kernels.blocks import call, run
from pfdist.kernels.lowering import Half, machine_code
from pfdist.kernels.vectors import LANES
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
    _call(address, out, x, w, y, blocks.table, place, draws, width)
    return out


@njit
def _call(address, out, x, w, y, table, place, draws, width):
    stride = draws * width
    call(
        address, out, 0, stride, x, 0, stride, w, 0, stride, y, 0, y.shape[1], 1, table, place,
        draws, width,
    )  # fmt: skip
