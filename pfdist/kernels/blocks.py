"""Blocks: formulas as machine code for a batch of particles, and tables of their numbers.

Values that are the same for all particles are computed once for each instant, by separate functions
with instants instead of particles. They are rows of a table, and a block receives the row of its
instant.
"""

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from pfdist.kernels.cached import compiled
from pfdist.kernels.callbacks import Callback
from pfdist.kernels.lowering import (
    ARGUMENTS,
    FUNCTION,
    POINTERS,
    Layout,
    MachineCode,
    machine_code,
    split,
)
from pfdist.kernels.memory import ahead
from pfdist.kernels.vectors import LANES
from pfdist.models.parameters import Parameter
from pfdist.models.program import Array, evaluate_program, merged
from pfdist.models.tracing import Traced, check_results

_LARGE = 2.0**1000  # the reciprocals of smaller numbers have all digits


class Blocks(NamedTuple):
    """Blocks in the form for compiled code: a row for each block, a column for each instant."""

    addresses: NDArray[np.int64]  # (blocks, instants): of the machine code
    places: NDArray[np.int64]  # (blocks, instants): where the row of the table begins
    table: NDArray[np.float64]
    memory: NDArray[np.float64]  # in which the machine code works: that of the caller alone


class Source(NamedTuple):
    """A traced formula, and the place of its block's arguments."""

    traced: Traced
    layout: Layout
    parameters: Mapping[str, Parameter]
    results: int  # rows that its block writes


@dataclass(frozen=True)
class Compiled:
    """Blocks with their machine code and callbacks, which must live as long as the blocks."""

    shared: Blocks
    code: MachineCode = field(repr=False)
    callbacks: Sequence[Callback] = ()

    @property
    def blocks(self) -> Blocks:
        """The blocks, with new memory, so that threads can run in parallel."""
        return self.shared._replace(memory=self.code.new_memory())

    @property
    def together(self) -> int | None:
        """The number of particles in a callback; None without callbacks, see `Callback`."""
        return max((each.together for each in self.callbacks), default=None)


def compile_blocks(sources: Sequence[Source | Callback | None], instants: range) -> Compiled:
    """Formulas compiled for K instants; a missing block has the address 0.

    A formula that was traced for fewer instants has its last block at the remaining ones.
    """
    programs = [
        (number, source, _Program(source, which))
        for number, source in enumerate(sources)
        if isinstance(source, Source)
        for which in range(len(source.traced.programs))
    ]
    callbacks = {
        number: source for number, source in enumerate(sources) if isinstance(source, Callback)
    }
    for number, source, program in programs:
        check_results(f"formula {number}", program.program, source.results, instants[0])
    halves = [half for *_, program in programs for half in program.split[::2]]
    code = machine_code((*dict.fromkeys(half for half in halves if half.outputs),))
    addresses, places = np.zeros((2, len(sources), len(instants)), np.int64)
    table, size = [np.zeros(1)], 1
    for number, source, program in programs:
        rows, traced = program.table(code), source.traced
        last = np.minimum(np.arange(len(instants)), traced.which.size - 1)
        is_here = traced.which == program.which
        row, here = (np.cumsum(is_here) - 1)[last], is_here[last]
        addresses[number, here] = code.addresses[program.split.particles]
        places[number, here] = size + row[here] * rows.shape[1]
        table.append(rows.ravel())
        size += rows.size
    for number, callback in callbacks.items():  # it reads the instant from the table
        addresses[number], places[number] = callback.address, size + np.arange(len(instants))
    table.append(np.array(instants, np.float64))
    blocks = Blocks(addresses, places, np.concatenate(table), np.empty(0))
    return Compiled(blocks, code, [*callbacks.values()])


class _Program:
    """One of the programs of a source, in its two halves."""

    def __init__(self, source: Source, which: int) -> None:
        self._source, self.which = source, which
        self.program = merged(source.traced.programs[which])
        self._instants = np.array(source.traced.instants)[source.traced.which == which]
        self.split = split(self.program, source.layout, exact=self._divides_by_extremes())

    def _divides_by_extremes(self) -> bool:
        """Whether the reciprocal of a number for all particles may have fewer digits."""
        divisors = self._leaves(self.program.shared_divisors)
        sizes = np.abs(np.concatenate([*divisors, [1.0]]))
        return bool(((sizes < 1.0 / _LARGE) | (sizes > _LARGE)).any())

    def _leaves(self, operations: tuple[int, ...]) -> list[Array]:
        """Values that are the same for all particles, by NumPy, for each instant."""
        some = replace(self.program, outputs=operations)
        parameters, rows = self._source.parameters, np.arange(len(some.constants))
        values = evaluate_program(merged(some), {}, self._instants, parameters, rows)
        return [np.broadcast_to(each, self._instants.shape) for each in values]

    def table(self, code: MachineCode) -> Array:
        """A row for each instant of the program, with the numbers that its block needs."""
        shared, count = self.split.shared, self._instants.size
        if not shared.outputs:
            return np.empty((count, 0))
        slots = np.zeros((max(1, len(self.split.leaves)), -(-count // LANES) * LANES))
        for row, values in zip(slots, self._leaves(self.split.leaves), strict=False):
            row[:count], row[count:] = values, values[0]
        out = np.empty((len(shared.outputs), slots.shape[1]))
        run_block(code, code.addresses[shared], out, slots)
        return np.ascontiguousarray(out[:, :count].T)


_CALL = ctypes.CFUNCTYPE(
    None,
    *(ctypes.c_void_p if name in POINTERS else ctypes.c_int64 for name, _ in ARGUMENTS),
)


def run_block(
    code: MachineCode, address: int, out: Array, slots: Array, shared: Array | None = None
) -> None:
    """Call a block that needs only rows of slots, (rows, a multiple of `LANES`).

    `shared` has the numbers of its instant, if it needs any.
    """
    width, memory = slots.shape[1], code.new_memory()
    rows, results = slots.ctypes.data, out.ctypes.data
    numbers = rows if shared is None else shared.ctypes.data
    kept = memory.ctypes.data
    _CALL(address)(results, width, rows, width, rows, 0, rows, 0, 0, numbers, kept, 1, width)


# --- calls of blocks from compiled functions ------------------------------------------------------


@compiled
def call_block(blocks, which, out, slots, noise, given, size):
    """Call a block by its number in `Blocks`; see `pfdist.kernels.lowering.ARGUMENTS`.

    `out`, `slots` and `noise` are a pointer and a stride, `given` a pointer and two strides, and
    `size` the numbers of draws and of slots of each.
    """
    shared = ahead(blocks.table, blocks.places[which])
    _call(blocks.addresses[which], out, slots, noise, given, shared, blocks.memory, size)


@intrinsic
def _call(context, address, out, slots, noise, given, shared, memory, size):
    def generate(context, builder, signature, values):
        numbers = []
        for kind, value in zip(signature.args, values, strict=True):
            count = len(kind) if isinstance(kind, types.BaseTuple) else 0
            numbers += [builder.extract_value(value, k) for k in range(count)] or [value]
        function = builder.inttoptr(numbers[0], FUNCTION.as_pointer())
        given = [
            builder.bitcast(number, kind) if isinstance(kind, ir.PointerType) else number
            for number, kind in zip(numbers[1:], FUNCTION.args, strict=True)
        ]
        builder.call(function, given)
        return context.get_dummy_value()

    return types.none(address, out, slots, noise, given, shared, memory, size), generate
