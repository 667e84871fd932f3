"""From programs to machine code: functions that compute a formula for `LANES` particles at a time.

What is the same for all particles is computed before, once for each instant, by the same functions
of our own: `split` separates these two halves of a program.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir

from pfdist.kernels.functions import FUNCTIONS
from pfdist.kernels.vectors import LANES, Vector, constant, splat
from pfdist.models.program import MASKS, Operation, Program

Layout = Mapping[str, tuple[str, int]]
"""Where a function finds the arguments of a formula: for each group, an array and the first row.

The arrays are "slots" (a float64 for each particle), "noise" (a float32 for each particle) and
"given" (a float64 for each draw).
"""

ARRAYS = ("slots", "noise", "given")
_SHARED = ("t", "parameter", "covariate", "constant")  # leaves with one value for all particles
_INDEX, _DOUBLE, _FLOAT = ir.IntType(64), ir.DoubleType(), ir.FloatType()
_MOST_COMPILED = 32


# --- the two halves of a program ------------------------------------------------------------------


class Half(NamedTuple):
    """A program to be compiled, which can be compared.

    Its leaves are ("slots", (), row), ("noise", (), row), ("given", (), row), ("shared", (), entry
    of the table's row) and ("number", (), its bits).
    """

    operations: tuple[Operation, ...]
    outputs: tuple[int, ...]
    tables: tuple[tuple[int, bytes], ...]  # lengths and contents of the arrays that `take` reads


class Split(NamedTuple):
    """A program in two halves."""

    shared: Half  # from a slot for each instant to the entries of the table
    leaves: tuple[int, ...]  # the operations of the program that are the rows of slots of `shared`
    particles: Half

    @property
    def needs_code(self) -> bool:
        """Whether the shared half computes anything."""
        return any(each.name not in ("slots", "number") for each in self.shared.operations)


class _Writer:
    """Collects different operations."""

    def __init__(self) -> None:
        self.operations: dict[Operation, int] = {}

    def add(self, name: str, arguments: tuple[int, ...] = (), which: Any = None) -> int:
        """The number of an operation, which is written if it is new."""
        operation = Operation(name, arguments, which)
        return self.operations.setdefault(operation, len(self.operations))

    def number(self, value: float) -> int:
        """The number of a leaf that is the same at all instants."""
        return self.add("number", (), struct.unpack("<q", struct.pack("<d", value))[0])


def _value(operation: Operation) -> float:
    value: float = struct.unpack("<d", struct.pack("<q", operation.which))[0]
    return value


def split(program: Program, layout: Layout, *, exact: bool = False) -> Split:
    """Separate what is the same for all particles.

    A division by such a number becomes a multiplication by its reciprocal, with an error of at most
    1.5 units in the last place. Only `exact` divides: it is for denominators so large or so small
    that the reciprocal has fewer digits.
    """
    shared, particles = _Writer(), _Writer()
    shared_at, particle_at, leaves = dict[int, int](), dict[int, int](), list[int]()
    table = dict[int, int]()  # values of the shared half that are entries of the table

    def entry(value: int, *, reciprocal: bool = False) -> int:
        """A shared value, as the particles' half reads it."""
        number, is_mask = shared_at[value], program.operations[value].name in MASKS
        operation = [*shared.operations][number]
        if operation.name == "number":
            numeral = _value(operation)
            return particles.number(1.0 / numeral if reciprocal else numeral)
        if reciprocal:
            number = shared.add("divide", (shared.number(1.0), number))
        if is_mask:
            number = shared.add("float", (number,))
        read = particles.add("shared", (), table.setdefault(number, len(table)))
        return particles.add("not_equal", (read, particles.number(0.0))) if is_mask else read

    is_shared = program.is_uniform
    for value, (name, arguments, which) in enumerate(program.operations):
        if is_shared[value]:
            if name in _SHARED:
                column = program.constants[:, which] if name == "constant" else np.arange(2)
                if (column.view(np.int64) == column.view(np.int64)[0]).all():
                    shared_at[value] = shared.number(column[0])
                    continue
                shared_at[value] = shared.add("slots", (), len(leaves))
                leaves.append(value)
            else:
                moved = tuple(shared_at[each] for each in arguments)
                shared_at[value] = shared.add(name, moved, which)
        elif name in layout:
            array, first = layout[name]
            particle_at[value] = particles.add(array, (), first + which)
        else:
            by = name == "divide" and is_shared[arguments[1]] and not exact
            moved = tuple(
                entry(each, reciprocal=by) if is_shared[each] else particle_at[each]
                for each in arguments
            )
            particle_at[value] = particles.add("multiply" if by else name, moved, which)
    outputs = tuple(
        entry(each) if is_shared[each] else particle_at[each] for each in program.outputs
    )
    tables = tuple((each.size, np.asarray(each, np.float64).tobytes()) for each in program.tables)
    return Split(
        Half((*shared.operations,), (*table,), tables),
        (*leaves,),
        Half((*particles.operations,), outputs, tables),
    )


# --- machine code ---------------------------------------------------------------------------------


class Code:
    """The machine code of some functions, which lives as long as this object."""

    def __init__(self, halves: tuple[Half, ...]) -> None:
        module = ir.Module("blocks")
        module.triple = llvm.get_process_triple()
        for number, half in enumerate(halves):
            _write_function(module, f"block{number}", half)
        parsed, machine = llvm.parse_assembly(str(module)), _machine()
        options = llvm.create_pipeline_tuning_options(speed_level=2)
        options.loop_vectorization = options.slp_vectorization = False
        passes = llvm.create_pass_builder(machine, options)
        passes.getModulePassManager().run(parsed, passes)
        self._engine = llvm.create_mcjit_compiler(parsed, machine)
        self._engine.finalize_object()
        self.addresses = {
            half: self._engine.get_function_address(f"block{number}")
            for number, half in enumerate(halves)
        }


@lru_cache(maxsize=_MOST_COMPILED)
def machine_code(halves: tuple[Half, ...]) -> Code:
    """The machine code of some halves of programs; the least recently used are forgotten."""
    return Code(halves)


@cache
def _machine() -> Any:
    """The processor for which Numba compiles, too."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    name, features = numba.config.CPU_NAME, numba.config.CPU_FEATURES
    if features is None:
        features = "" if name else llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        cpu=name or llvm.get_host_cpu_name(), features=features, opt=2, jit=True
    )


ARGUMENTS = (
    *(("out", _DOUBLE), ("out_stride", _INDEX), ("slots", _DOUBLE), ("slots_stride", _INDEX)),
    *(("noise", _FLOAT), ("noise_stride", _INDEX)),
    *(("given", _DOUBLE), ("draw_stride", _INDEX), ("component_stride", _INDEX)),
    *(("shared", _DOUBLE), ("draws", _INDEX), ("width", _INDEX)),
)
"""Arguments of a block; those that are no index are addresses of arrays.

Component c of the particle i of draw d is ``slots[c * slots_stride + d * width + i]``, and the same
holds for noise and results. ``given[d * draw_stride + c * component_stride]`` is that of a draw.
"""
_POINTERS = ("out", "slots", "noise", "given", "shared")
FUNCTION = ir.FunctionType(
    ir.VoidType(), [kind.as_pointer() if name in _POINTERS else kind for name, kind in ARGUMENTS]
)


def _write_function(module: ir.Module, name: str, half: Half) -> None:
    function = ir.Function(module, FUNCTION, name)
    given = dict(zip((name for name, _ in ARGUMENTS), function.args, strict=True))
    given["out"].add_attribute("noalias")
    builder = ir.IRBuilder(function.append_basic_block("entry"))
    values = dict[int, Vector]()
    rows = {"slots": "slots_stride", "noise": "noise_stride"}

    def load(array: str, place: Any) -> Vector:
        address = builder.gep(given[array], [place])
        return splat(Vector(builder, builder.load(address, align=8)), LANES)

    def compute(position: Any) -> None:
        for number, operation in enumerate(half.operations):
            if operation.name in rows:
                stride = given[rows[operation.name]]
                place = builder.add(builder.mul(_index(operation.which), stride), position)
                values[number] = load_vector(builder, given[operation.name], place)
            elif number not in values:
                arguments = [values[each] for each in operation.arguments]
                values[number] = _applied(builder, half, operation, arguments)
        for row, output in enumerate(half.outputs):
            place = builder.add(builder.mul(_index(row), given["out_stride"]), position)
            store_vector(builder, given["out"], place, values[output])

    for number, operation in enumerate(half.operations):
        if operation.name == "number":
            values[number] = constant(builder, "f8", LANES, _value(operation))
        elif operation.name == "shared":
            values[number] = load("shared", _index(operation.which))
    with _loop(builder, given["draws"], 1) as draw:
        for number, operation in enumerate(half.operations):
            if operation.name == "given":
                first = builder.mul(draw, given["draw_stride"])
                component = builder.mul(_index(operation.which), given["component_stride"])
                values[number] = load("given", builder.add(first, component))
        origin = builder.mul(draw, given["width"])
        with _loop(builder, given["width"], LANES) as particle:
            compute(builder.add(origin, particle))
    builder.ret_void()


def _index(number: int) -> Any:
    return ir.Constant(_INDEX, number)


@contextmanager
def _loop(builder: Any, count: Any, step: int) -> Iterator[Any]:
    """A loop over 0, step, ... below a count above 0; the body is written in the context."""
    before, body = builder.block, builder.append_basic_block("body")
    builder.branch(body)
    builder.position_at_end(body)
    number = builder.phi(_INDEX)
    number.add_incoming(_index(0), before)
    yield number
    following = builder.add(number, _index(step))
    number.add_incoming(following, builder.block)
    behind = builder.append_basic_block("behind")
    builder.cbranch(builder.icmp_signed("<", following, count), body, behind)
    builder.position_at_end(behind)
