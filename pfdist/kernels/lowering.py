"""Programs as machine code: functions that compute a formula for `LANES` particles at a time.

Values that are the same for all particles are computed first, once for each instant, by separate
functions; `split` separates these two halves of a program.
"""

import math
import re
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir

from pfdist.kernels.singles import function_of
from pfdist.kernels.vectors import KINDS, LANES, Array, Vector, constant, entries, outlined, splat
from pfdist.models.program import GROUPS, LOOPS, MASKS, Operation, Program

Layout = Mapping[str, tuple[str, int]]
"""The place of a formula's arguments: for each group, an array and the first row.

The arrays are "slots" (a number for each particle), "noise" (a float32 for each particle) and
"given" (a float64 for each draw).
"""


class Precision(NamedTuple):
    """The types of numbers in a block: "f8" is float64, and "f4" float32."""

    slots: str = "f8"
    computed: str = "f8"  # and that of results


DOUBLES = Precision()


_SHARED = ("t", "parameter", "covariate", "constant")  # leaves with one value for all particles
_INDEX, _DOUBLE, _FLOAT = ir.IntType(64), ir.DoubleType(), ir.FloatType()
_MOST_COMPILED = 32
MOST_TOGETHER = 300  # operations of a function; a longer program is compiled in pieces
_MOST_INLINED = 4  # long operations of one kind in a function
_LEAVES = ("slots", "noise", "given", "shared", "number")


# --- the two halves of a program ------------------------------------------------------------------


class Half(NamedTuple):
    """A program to be compiled, which can be compared.

    Its leaves are ("slots", (), row), ("noise", (), row), ("given", (), row), ("shared", (), entry
    of the table's row) and ("number", (), its bits).
    """

    operations: tuple[Operation, ...]
    outputs: tuple[int, ...]
    tables: tuple[tuple[int, bytes], ...]  # lengths and contents of the arrays that `take` reads
    precision: Precision = DOUBLES


class Split(NamedTuple):
    """A program in two halves."""

    shared: Half  # from a slot for each instant to the entries of the table
    leaves: tuple[int, ...]  # the operations of the program that are the rows of slots of `shared`
    particles: Half


class _Writer:
    """Collects different operations."""

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self._numbers: dict[Operation, int] = {}

    def add(self, name: str, arguments: tuple[int, ...] = (), which: Any = None) -> int:
        """The number of an operation, which is written if it is new."""
        operation = Operation(name, arguments, which)
        number = self._numbers.setdefault(operation, len(self.operations))
        if number == len(self.operations):
            self.operations.append(operation)
        return number

    def number(self, value: float) -> int:
        """The number of a leaf that is the same at all instants."""
        return self.add("number", (), struct.unpack("<q", struct.pack("<d", value))[0])


def _value(operation: Operation) -> float:
    value: float = struct.unpack("<d", struct.pack("<q", operation.which))[0]
    return value


def split(
    program: Program, layout: Layout, *, exact: bool = False, precision: Precision = DOUBLES
) -> Split:
    """A program split into the values that are the same for all particles, and the rest.

    The first half is always computed in float64. A division by such a value becomes a
    multiplication by its reciprocal, with an error of at most 1.5 units in the last place. `exact`
    keeps divisions, for denominators so large or so small that the reciprocal is inaccurate.
    """
    shared, particles = _Writer(), _Writer()
    shared_at, particle_at, leaves = dict[int, int](), dict[int, int](), list[int]()
    table = dict[int, int]()  # values of the shared half that are entries of the table

    def entry(value: int, *, reciprocal: bool = False) -> int:
        """A shared value, in the form that the particles' half reads."""
        number, is_mask = shared_at[value], program.operations[value].name in MASKS
        operation = shared.operations[number]
        if operation.name == "number":
            numeral = _value(operation)
            return particles.number(1.0 / numeral if reciprocal else numeral)
        if reciprocal:
            number = shared.add("divide", (shared.number(1.0), number))
        if is_mask:
            number = shared.add("float", (number,))
        read = particles.add("shared", (), table.setdefault(number, len(table)))
        return particles.add("not_equal", (read, particles.number(0.0))) if is_mask else read

    is_shared = program.is_shared
    for value, (name, arguments, which) in enumerate(program.operations):
        if is_shared[value]:
            if name in _SHARED:
                if name == "constant" and _is_constant(program.constants[:, which]):
                    shared_at[value] = shared.number(program.constants[0, which])
                    continue
                shared_at[value] = shared.add("slots", (), len(leaves))
                leaves.append(value)
            else:
                moved = tuple(shared_at[each] for each in arguments)
                shared_at[value] = shared.add(name, moved, which)
        elif name in GROUPS:
            array, first = layout[name]
            particle_at[value] = particles.add(array, (), first + which)
        else:
            divides = name == "divide" and is_shared[arguments[1]] and not exact
            moved = tuple(
                entry(each, reciprocal=divides) if is_shared[each] else particle_at[each]
                for each in arguments
            )
            particle_at[value] = particles.add("multiply" if divides else name, moved, which)
    outputs = tuple(
        entry(each) if is_shared[each] else particle_at[each] for each in program.outputs
    )
    tables = tuple((each.size, np.asarray(each, np.float64).tobytes()) for each in program.tables)
    return Split(
        Half((*shared.operations,), (*table,), tables),
        (*leaves,),
        Half((*particles.operations,), outputs, tables, precision),
    )


def _is_constant(column: Any) -> bool:
    bits = np.ascontiguousarray(column).view(np.int64)
    return bool((bits == bits[0]).all())


# --- machine code ---------------------------------------------------------------------------------


class Code:
    """The machine code of some functions, which lives as long as this object."""

    def __init__(self, halves: tuple[Half, ...]) -> None:
        parsed, machine = llvm.parse_assembly(str(module_of(halves))), _machine()
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


def module_of(halves: tuple[Half, ...]) -> ir.Module:
    """LLVM's module of a function for each half of a program."""
    module = ir.Module("blocks")
    module.triple = llvm.get_process_triple()
    for number, half in enumerate(halves):
        _Function(module, f"block{number}", half).write()
    return module


@lru_cache(maxsize=_MOST_COMPILED)
def machine_code(halves: tuple[Half, ...]) -> Code:
    """The machine code of some halves of programs; the least recently used are dropped."""
    return Code(halves)


def _machine() -> Any:
    """The processor for which Numba compiles, too; an engine owns the object that it gets."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    name, features = numba.config.CPU_NAME, numba.config.CPU_FEATURES
    if features is None:
        features = "" if name else llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        cpu=name or llvm.get_host_cpu_name(), features=features, opt=2, jit=True
    )


@cache
def has_fused_multiply_add() -> bool:
    """Whether the processor has this instruction; otherwise the C library computes it."""
    module, kind = ir.Module("trial"), ir.DoubleType()
    function = ir.Function(module, ir.FunctionType(kind, [kind] * 3), "trial")
    builder = ir.IRBuilder(function.append_basic_block())
    builder.ret(builder.fma(*function.args))
    assembly = _machine().emit_assembly(llvm.parse_assembly(str(module)))
    return re.search(r"\bfma\b", assembly) is None


ARGUMENTS = (
    *(("out", _DOUBLE), ("out_stride", _INDEX), ("slots", _DOUBLE), ("slots_stride", _INDEX)),
    *(("noise", _FLOAT), ("noise_stride", _INDEX)),
    *(("given", _DOUBLE), ("draw_stride", _INDEX), ("component_stride", _INDEX)),
    *(("shared", _DOUBLE), ("draws", _INDEX), ("width", _INDEX)),
)
"""Arguments of a block.

Component c of the particle i of draw d is ``slots[c * slots_stride + d * width + i]``, and the same
holds for noise and results. ``given[d * draw_stride + c * component_stride]`` is that of a draw.
"""
POINTERS = ("out", "slots", "noise", "given", "shared")
"""The arguments that are addresses of arrays."""
FUNCTION = ir.FunctionType(
    ir.VoidType(), [kind.as_pointer() if name in POINTERS else kind for name, kind in ARGUMENTS]
)


class _Function:
    """Writes the function of half a program."""

    def __init__(self, module: ir.Module, name: str, half: Half) -> None:
        function = ir.Function(module, FUNCTION, name)
        self._given = dict(zip((name for name, _ in ARGUMENTS), function.args, strict=True))
        self._given["out"].add_attribute("noalias")
        self._builder = ir.IRBuilder(function.append_basic_block("entry"))
        self._half, self._values, self._often = half, dict[int, Vector](), _often(half)
        self._precision = half.precision
        self._computed = [
            number for number, each in enumerate(half.operations) if each.name not in _LEAVES
        ]
        self._rows = _rows_of_steps(half)
        used = {
            each
            for number in self._computed
            for each in half.operations[number].arguments
            if number not in self._rows
        }
        self._loaded = [
            number
            for number, each in enumerate(half.operations)
            if each.name in ("slots", "noise") and (number in used or number in half.outputs)
        ]

    def write(self) -> None:
        """Write loops over draws and over particles; what does not change is loaded before them."""
        builder, given = self._builder, self._given
        for number, operation in enumerate(self._half.operations):
            if operation.name == "number":
                self._values[number] = _numeral(builder, self._half, number)
            elif operation.name == "shared":
                self._values[number] = self._spread("shared", _index(operation.which))
        with _loop(builder, given["draws"], 1) as draw:
            first = builder.mul(draw, given["draw_stride"])
            for number, operation in enumerate(self._half.operations):
                if operation.name == "given":
                    component = builder.mul(_index(operation.which), given["component_stride"])
                    self._values[number] = self._spread("given", builder.add(first, component))
            origin = builder.mul(draw, given["width"])
            with _loop(builder, given["width"], LANES) as particle:
                self._compute(builder.add(origin, particle))
        builder.ret_void()

    def _spread(self, array: str, place: Any) -> Vector:
        number = self._array(array).load(Vector(self._builder, place, "i8"), 0)
        return splat(number.to(self._precision.computed), LANES)

    def _array(self, name: str) -> Array:
        kinds = {"noise": "f4", "slots": self._precision.slots, "out": self._precision.computed}
        kind, address = kinds.get(name, "f8"), self._given[name]
        return Array(self._builder, self._builder.bitcast(address, KINDS[kind].as_pointer()), kind)

    def _row(self, array: str, row: Any, position: Any) -> Vector:
        """The place of a vector in a row."""
        stride = self._given[f"{array}_stride"]
        place = self._builder.add(self._builder.mul(row, stride), position)
        return Vector(self._builder, place, "i8")

    def _compute(self, position: Any) -> None:
        """Write what is done for some particles."""
        for number in self._loaded:
            name, _, which = self._half.operations[number]
            self._values[number] = self._loaded_row(name, _index(which), position)
        if len(self._computed) <= MOST_TOGETHER:
            self._compute_each(self._computed, position)
        else:
            self._compute_in_pieces(position)
        for row, output in enumerate(self._half.outputs):
            value = self._values[output]
            self._array("out").store(
                self._row("out", _index(row), position), value.to(self._precision.computed)
            )

    def _loaded_row(self, array: str, row: Any, position: Any) -> Vector:
        """The values of some particles in a row."""
        vector = self._array(array).load(self._row(array, row, position), LANES)
        return vector.to(self._precision.computed)

    def _compute_each(self, numbers: Iterable[int], position: Any) -> None:
        """Compute operations, one after another."""
        values = self._values
        loop: Any = None
        for number in numbers:
            name, arguments, which = self._half.operations[number]
            if name not in LOOPS:
                values[number] = _applied(self._half, number, values, self._often)
            elif name == "repeat":
                given = [values[each] for each in arguments]
                loop = _Loop(given[0], given[1:], which)
            elif name == "nth" and number in self._rows:
                first, stride = self._rows[number]
                row = self._builder.mul(_index(stride), loop.step.value)
                row = self._builder.add(row, _index(first))
                values[number] = self._loaded_row("noise", row, position)
            elif name == "nth":
                values[number] = loop.nth([values[each] for each in arguments[1:]])
            elif name == "again":
                loop.end([values[each] for each in arguments[1:]])
            elif name == "step":
                values[number] = splat(loop.step.to(self._precision.computed), LANES)
            else:
                values[number] = loop.values[which]

    def _compute_in_pieces(self, position: Any) -> None:
        """Compute by several functions: LLVM takes a time that grows faster than a function does.

        Values that another piece needs are kept in memory. A loop is not cut.
        """
        operations = self._half.operations
        pieces, loops = _pieces(self._half, self._computed)
        piece_of = {number: k for k, piece in enumerate(pieces) for number in piece}
        kept = {
            each
            for number in self._computed
            for each in operations[number].arguments
            if piece_of.get(each) != piece_of[number]
            and operations[each].name != "number"
            and number not in self._rows
        } | {each for each in self._half.outputs if each in piece_of}
        places = {number: place for place, number in enumerate(sorted(kept))}
        with self._builder.goto_entry_block():
            memory = self._builder.alloca(KINDS["f8"], size=len(places) * LANES)
        for number in places.keys() - piece_of.keys():
            _store(memory, places[number], self._values[number])
        for k, piece in enumerate(pieces):
            if k not in loops:
                function = self._piece(f"piece{k}", piece, places)
                self._builder.call(function, [memory])
                continue
            for number in {each for some in piece for each in operations[some].arguments}:
                if number in places and number in piece_of and piece_of[number] != k:
                    self._values[number] = _load(
                        self._builder, memory, places[number], self._half, number
                    )
            self._compute_each(piece, position)
            for number in piece:
                if number in places:
                    _store(memory, places[number], self._values[number])
        for number in self._half.outputs:
            if number in piece_of:
                self._values[number] = _load(
                    self._builder, memory, places[number], self._half, number
                )

    def _piece(self, name: str, piece: list[int], places: Mapping[int, int]) -> ir.Function:
        """A function that computes some operations, from values in memory to others."""
        kind = ir.FunctionType(ir.VoidType(), [KINDS["f8"].as_pointer()])
        function = ir.Function(self._builder.module, kind, f"{self._builder.function.name}{name}")
        function.linkage = "internal"
        function.attributes.add("noinline")
        builder = ir.IRBuilder(function.append_basic_block("entry"))
        (memory,), operations, values = function.args, self._half.operations, dict[int, Vector]()
        for number in piece:
            for each in operations[number].arguments:
                if each not in values and operations[each].name == "number":
                    values[each] = _numeral(builder, self._half, each)
                elif each not in values:
                    values[each] = _load(builder, memory, places[each], self._half, each)
            values[number] = _applied(self._half, number, values, self._often)
            if number in places:
                _store(memory, places[number], values[number])
        builder.ret_void()
        return function


class _Loop:
    """A loop over steps: `values` are those of the step before, and then those of the last step.

    A step has a number, from 0 on.
    """

    def __init__(self, count: Vector, values: list[Vector], most: int) -> None:
        builder = self._builder = count.builder
        first = Vector(builder, builder.extract_element(count.value, _index(0)), count.kind)
        first = (first >= 1.0).select(first, first.number(1.0))
        self._count = (first <= most).select(first, first.number(most)).to("i8")
        self._before, self._body = builder.block, builder.append_basic_block("step")
        builder.branch(self._body)
        builder.position_at_end(self._body)
        self.step = Vector(builder, builder.phi(_INDEX), "i8")
        self.step.value.add_incoming(_index(0), self._before)
        self.values = [Vector(builder, builder.phi(each.value.type), each.kind) for each in values]
        for phi, value in zip(self.values, values, strict=True):
            phi.value.add_incoming(value.value, self._before)

    def nth(self, values: list[Vector]) -> Vector:
        """The value with the number of the step; all values are there before the loop."""
        builder, kind, width = self._builder, values[0].kind, LANES
        with builder.goto_entry_block():
            memory = builder.alloca(KINDS[kind], size=len(values) * width)
        with builder.goto_block(self._before):
            array = Array(builder, memory, kind)
            for place, value in enumerate(values):
                array.store(Vector(builder, _index(place * width), "i8"), value)
        position = Vector(builder, builder.mul(self.step.value, _index(width)), "i8")
        return Array(builder, memory, kind).load(position, width)

    def end(self, values: list[Vector]) -> None:
        """Begin the next step with other values, or end."""
        builder = self._builder
        following = builder.add(self.step.value, _index(1))
        self.step.value.add_incoming(following, builder.block)
        for phi, value in zip(self.values, values, strict=True):
            phi.value.add_incoming(value.value, builder.block)
        behind = builder.append_basic_block("behind")
        is_next = builder.icmp_signed("<", following, self._count.value)
        builder.cbranch(is_next, self._body, behind)
        builder.position_at_end(behind)
        self.values = values


def _rows_of_steps(half: Half) -> dict[int, tuple[int, int]]:
    """First row and distance of the rows of noise of which each step takes one."""
    found = dict[int, tuple[int, int]]()
    for number, (name, arguments, _) in enumerate(half.operations):
        given = [half.operations[each] for each in arguments[1:]]
        if name == "nth" and {each.name for each in given} == {"noise"}:
            rows = [each.which for each in given]
            stride = rows[1] - rows[0] if len(rows) > 1 else 0
            if rows == [rows[0] + stride * k for k in range(len(rows))]:
                found[number] = rows[0], stride
    return found


def _pieces(half: Half, computed: Sequence[int]) -> tuple[list[list[int]], set[int]]:
    """Operations that one function computes, and which of these are loops."""
    pieces, loops, inside = [list[int]()], set[int](), False
    for number in computed:
        name, last = half.operations[number].name, len(pieces) - 1
        follows = inside or (name == "final" and last in loops)
        is_full = last in loops or len(pieces[-1]) >= MOST_TOGETHER
        if pieces[-1] and not follows and (name == "repeat" or is_full):
            pieces.append([])
        if name == "repeat":
            loops.add(len(pieces) - 1)
        inside = (inside or name == "repeat") and name != "again"
        pieces[-1].append(number)
    return pieces, loops


def _often(half: Half) -> frozenset[str]:
    """The long operations that half a program uses often."""
    counts = Counter(each.name for each in half.operations)
    return frozenset(name for name, count in counts.items() if count > _MOST_INLINED) & _LONG


def _applied(
    half: Half, number: int, values: Mapping[int, Vector], often: frozenset[str]
) -> Vector:
    """The value of an operation; the long operations `often` are called."""
    name, arguments, which = half.operations[number]
    given = [values[each] for each in arguments]
    if name == "take":
        return _take(half, given[0], which)
    function, kind = function_of(name, half.precision.computed), half.precision.computed
    return outlined(f"vector_{name}_{kind}", function, given) if name in often else function(*given)


_LONG = frozenset(
    {
        *("exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "power", "cbrt"),
        *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "hypot"),
        "logaddexp",
        *("sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh"),
        *("fmod", "remainder", "floor_divide"),
    }
)
"""Operations of many instructions, which become separate functions where they are used often."""


def _numeral(builder: ir.IRBuilder, half: Half, number: int) -> Vector:
    """A number that is the same for all particles and at all instants."""
    return constant(builder, half.precision.computed, LANES, _value(half.operations[number]))


def _store(memory: Any, place: int, value: Vector) -> None:
    """Keep a value in memory; a mask as 1 and 0."""
    index = Vector(value.builder, _index(place * LANES), "i8")
    Array(value.builder, memory, "f8").store(index, value.to("f8"))


def _load(builder: ir.IRBuilder, memory: Any, place: int, half: Half, number: int) -> Vector:
    """Load a value from memory."""
    index = Vector(builder, _index(place * LANES), "i8")
    value = Array(builder, memory, "f8").load(index, LANES)
    is_mask = half.operations[number].name in MASKS
    return value.differs(0.0) if is_mask else value.to(half.precision.computed)


def _take(half: Half, index: Vector, which: int) -> Vector:
    """Entries of a table by a whole number; NaN where it lies outside."""
    size, content = half.tables[which]
    name = f"table{hash((size, content)) & (2**63 - 1)}"
    inside = (index >= 0.0) & (index < float(size))
    safe = inside.select(index, index.number(0.0)).to("i8")
    found = entries(name, np.frombuffer(content).tolist(), safe).to(index.kind)
    return inside.select(found, index.number(math.nan))


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
