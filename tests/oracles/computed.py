"""Values of single operations of programs, by machine code."""

import numpy as np

from pfdist.kernels.blocks import run
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
