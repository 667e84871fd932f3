"""Values of operations and formulas by machine code, and the functions that it calls."""

import re
from typing import NamedTuple

import llvmlite.binding as llvm
import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.blocks import Blocks, Source, call_block, compile_blocks, run_block
from pfdist.kernels.cached import entry
from pfdist.kernels.lowering import Half, machine_code, module_of, split
from pfdist.kernels.memory import read
from pfdist.kernels.vectors import LANES
from pfdist.models.program import MASKS, Operation, merged
from pfdist.models.tracing import Formula, trace


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
    code = machine_code((half,))
    run_block(code, code.addresses[half], out, slots)
    return out[0, :size]


def formula(function):
    """A function of numbers as one of arrays of these, which machine code computes."""

    def by_machine_code(*arguments):
        arrays = np.broadcast_arrays(*(np.asarray(each, float) for each in arguments))
        size = arrays[0].size
        x = np.ones((len(arrays), 1, -(-size // LANES) * LANES))
        for row, values in zip(x, arrays, strict=True):
            row[0, :size] = values.ravel()
        source = _source(function, len(arrays))
        blocks = compile_blocks([source], range(1))
        (result,) = called(blocks.blocks, 0, x, np.empty((1, 1, 1), np.float32), x[0], 1)
        return result[0, :size].reshape(arrays[0].shape)

    return by_machine_code


def _source(function, arguments):
    given = Formula(lambda x, p: function(*x), "a formula", {"x": arguments, "p": 0}, {}, "a model")
    return Source(trace(given, range(1)), {"x": ("slots", 0)}, {}, 1)


def libraries_of(function, arguments):
    """Names of the functions that the machine code of a function of numbers calls elsewhere."""
    traced = _source(function, arguments).traced
    halves = [split(merged(each), {"x": ("slots", 0)})[::2] for each in traced.programs]
    return called_elsewhere([half for both in halves for half in both])


def called_elsewhere(halves, triple="x86_64-unknown-linux-gnu", processor="haswell"):
    """Names of the functions outside that the machine code of some halves of programs calls."""
    text = assembly(halves, triple, processor)
    names = re.findall(r"^\s+(?:bl|call\w*)\s+(\S+)", text, re.MULTILINE)
    return {*names} - {*re.findall(r"^(\w+):", text, re.MULTILINE)}


def assembly(halves, triple="x86_64-unknown-linux-gnu", processor="haswell"):
    """The machine code of some halves of programs as text, for a processor."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    module, _ = module_of(tuple(dict.fromkeys(each for each in halves if each.outputs)))
    module.triple = triple
    machine = llvm.Target.from_triple(triple).create_target_machine(
        cpu=processor, opt=2, codemodel="small"
    )
    text = machine.emit_assembly(llvm.parse_assembly(str(module)))
    assert "ret" in text
    return text


def called(blocks, t, x, w, y, outputs):
    """Results of the first block at t, (outputs, D, W), for x and w (rows, D, W) and y (D, m)."""
    draws, width = x.shape[1:]
    out = np.empty((outputs, draws, width))
    x, w, y = (np.ascontiguousarray(each) for each in (x, w, y))
    _call(_Arrays(blocks, t, out, x, w, y, y.shape[1], draws, width))
    return out


class _Arrays(NamedTuple):
    blocks: Blocks
    t: int
    out: NDArray[np.float64]
    x: NDArray[np.float64]
    w: NDArray[np.float32]
    y: NDArray[np.float64]
    components: int
    draws: int
    width: int


@entry(_Arrays)
def _call(arrays):
    given = read(arrays)
    stride = given.draws * given.width
    call_block(
        given.blocks, given.t, (given.out, stride), (given.x, stride), (given.w, stride),
        (given.y, given.components, 1), (given.draws, given.width),
    )  # fmt: skip
