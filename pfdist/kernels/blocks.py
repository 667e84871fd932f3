"""Blocks: formulas as machine code for a batch of particles, and tables of their numbers.

Values that are the same for all particles are computed once for each instant, by functions of our
own, with instants in the place of particles. They are rows of a table, and a block gets that of its
instant.
"""

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from pfdist.kernels.lowering import FUNCTION, Code, Half, Layout, machine_code, split
from pfdist.kernels.vectors import LANES
from pfdist.models.parameters import Parameter
from pfdist.models.program import Program, merged
from pfdist.models.tracing import Traced

_SAFE = 2.0**1000  # the reciprocals of smaller numbers have all digits


class Blocks(NamedTuple):
    """Blocks as compiled code takes them: a row for each block, and a column for each instant."""

    addresses: NDArray[np.int64]  # (blocks, instants): of the machine code
    places: NDArray[np.int64]  # (blocks, instants): where the row of the table begins
    table: NDArray[np.float64]


class Source(NamedTuple):
    """A traced formula, and where its block finds the arguments."""

    traced: Traced
    layout: Layout
    parameters: Mapping[str, Parameter]


@dataclass(frozen=True)
class Compiled:
    """Blocks, and the machine code, which must live as long as they are used."""

    blocks: Blocks
    code: Code = field(repr=False)


def compile_blocks(sources: Sequence[Source | None], instants: range) -> Compiled:
    """Compile the formulas for K instants; a block that is missing has the address 0.

    A formula that was traced for fewer instants has its last block at the others.
    """
    given = [(number, each) for number, each in enumerate(sources) if each is not None]
    halves = [
        (number, source, _Program(source, which))
        for number, source in given
        for which in range(len(source.traced.programs))
    ]
    needed = (half for _, _, program in halves for half in program.split.compiled)
    code = machine_code((*dict.fromkeys(needed),))
    addresses, places = np.zeros((2, len(sources), len(instants)), np.int64)
    table, size = [np.zeros(1)], 1
    for number, source, program in halves:
        rows = program.table(code)
        table.append(rows.ravel())
        traced = source.traced
        last = np.minimum(np.arange(len(instants)), traced.which.size - 1)
        here = traced.which[last] == program.which
        addresses[number, here] = code.addresses[program.split.particles]
        places[number, here] = size + traced.row[last][here] * rows.shape[1]
        size += rows.size
    return Compiled(Blocks(addresses, places, np.concatenate(table)), code)


class _Program:
    """One of the programs of a source, in its two halves."""

    def __init__(self, source: Source, which: int) -> None:
        self.source, self.which = source, which
        program = merged(source.traced.programs[which])
        self._program, (here,) = program, np.nonzero(source.traced.which == which)
        # The instants of the rows of the program's constants.
        self._instants = np.array(source.traced.instants)[here]
        self.split = split(program, source.layout, exact=self._has_large_denominators())

    def _has_large_denominators(self) -> bool:
        """Whether a reciprocal that is the same for all particles may have fewer digits."""
        program = self._program
        outputs = tuple(program.shared_denominators)
        if not outputs:
            return False
        values = self._columns(outputs)
        size = np.abs(values[np.isfinite(values)])
        return bool(np.any((size > _SAFE) | ((size < 1 / _SAFE) & (size > 0.0))))

    def table(self, code: Code) -> NDArray[np.float64]:
        """The row of the table for each instant of the program, (K, entries)."""
        shared, count = self.split.shared, self._instants.size
        width = -(-count // LANES) * LANES
        slots = np.zeros((max(1, len(self.split.leaves)), width))
        slots[: len(self.split.leaves), :count] = self._columns(self.split.leaves)
        slots[:, count:] = slots[:, :1]
        rows = np.zeros((max(1, len(shared.outputs)), width))
        if shared.outputs:
            run(code.addresses[shared], rows, slots)
        return np.ascontiguousarray(rows[: len(shared.outputs), :count].T)
