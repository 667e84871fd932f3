"""Programs as machine code: functions that compute a formula for `LANES` particles at a time.

Values that are the same for all particles are computed first, once for each instant, by separate
functions; `split` separates these two halves of a program.
"""

import math
import re
import struct
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from pfdist.kernels.functions import FUNCTIONS
from pfdist.kernels.vectors import LANES, Vector, VectorArray, constant, entries, outlined, splat
from pfdist.models.program import GROUPS, MASKS, Operation, Program

Layout = Mapping[str, tuple[str, int]]
"""The place of a formula's arguments: for each group, an array and the first row.

The arrays are "slots" (a number for each particle), "noise" (a float32 for each particle) and
"given" (a float64 for each draw).
"""


_SHARED = ("t", "parameter", "covariate", "constant")  # leaves with one value for all particles
_INDEX, _DOUBLE, _FLOAT = ir.IntType(64), ir.DoubleType(), ir.FloatType()
_MOST_COMPILED = 32
MOST_TOGETHER = 300  # values that a function needs; a longer program is compiled in pieces
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


class Split(NamedTuple):
    """A program in two halves."""

    shared: Half  # from a slot for each instant to the entries of the table
    leaves: tuple[int, ...]  # the operations of the program that are the rows of slots of `shared`
    particles: Half


class _Writer:
    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self._numbers: dict[Any, int] = {}

    def add(self, name: str, arguments: tuple[int, ...] = (), which: Any = None) -> int:
        """The number of an operation, which is written if it is new."""
        operation = Operation(name, arguments, which)
        key = (operation, len(self.operations)) if name == "repeat" else operation  # loops differ
        number = self._numbers.setdefault(key, len(self.operations))
        if number == len(self.operations):
            self.operations.append(operation)
        return number

    def number(self, value: float) -> int:
        """The number of a leaf that is the same at all instants."""
        return self.add("number", (), struct.unpack("<q", struct.pack("<d", value))[0])


def _value(operation: Operation) -> float:
    value: float = struct.unpack("<d", struct.pack("<q", operation.which))[0]
    return value


def split(program: Program, layout: Layout, *, exact: bool = False) -> Split:
    """A program split into the values that are the same for all particles, and the rest.

    A division by such a value becomes a multiplication by its reciprocal, with an error of at most
    1.5 units in the last place. `exact` keeps divisions, for denominators so large or so small that
    the reciprocal is inaccurate.
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
        Half((*particles.operations,), outputs, tables),
    )


def _is_constant(column: Any) -> bool:
    bits = np.ascontiguousarray(column).view(np.int64)
    return bool((bits == bits[0]).all())


# --- machine code ---------------------------------------------------------------------------------


class MachineCode:
    """The machine code of some functions, which lives as long as this object.

    LLVM's passes do not run before: they take more than half of the time of a compilation, and
    filters are at most 2 % quicker for it, as traced programs repeat no operation.
    """

    def __init__(self, halves: tuple[Half, ...]) -> None:
        module, self._size = module_of(halves)
        parsed = llvm.parse_assembly(str(module))
        self._engine = llvm.create_mcjit_compiler(parsed, _machine())
        self._engine.finalize_object()
        self.addresses = {
            half: self._engine.get_function_address(f"block{number}")
            for number, half in enumerate(halves)
        }

    def new_memory(self) -> NDArray[np.float64]:
        """Memory in which one thread can run the functions; it begins at a line of the cache."""
        memory = np.empty(self._size + 8)
        return memory[-memory.ctypes.data // 8 % 8 :]


def module_of(halves: tuple[Half, ...]) -> tuple[ir.Module, int]:
    """LLVM's module of a function for each half of a program, and the numbers that one keeps."""
    module, most = ir.Module("blocks"), 0
    module.triple = llvm.get_process_triple()
    for number, half in enumerate(halves):
        arranged = _Arranged(half)
        _Function(module, f"block{number}", half, arranged).write()
        most = max(most, arranged.size * LANES)
    return module, most


@lru_cache(maxsize=_MOST_COMPILED)
def machine_code(halves: tuple[Half, ...]) -> MachineCode:
    """The machine code of some halves of programs; the least recently used are dropped."""
    return MachineCode(halves)


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
    *(("shared", _DOUBLE), ("memory", _DOUBLE), ("draws", _INDEX), ("width", _INDEX)),
)
"""Arguments of a block.

Component c of the particle i of draw d is ``slots[c * slots_stride + d * width + i]``, and the same
holds for noise and results. ``given[d * draw_stride + c * component_stride]`` is that of a draw.
"""
POINTERS = ("out", "slots", "noise", "given", "shared", "memory")
"""The arguments that are addresses of arrays."""
_PIECE = (*ARGUMENTS, ("position", _INDEX), ("step", _INDEX))
"""Arguments of a piece of a block; `given` is that of its draw."""


def _signature(arguments: Sequence[tuple[str, Any]]) -> ir.FunctionType:
    kinds = [kind.as_pointer() if name in POINTERS else kind for name, kind in arguments]
    return ir.FunctionType(ir.VoidType(), kinds)


FUNCTION = _signature(ARGUMENTS)


class _Arranged:
    """The operations of half a program in the order of machine code, and their places in memory.

    LLVM's time grows faster than a function, and values for which no register is left lie on the
    stack. So a long program is cut into pieces, which are functions. A value that another piece
    needs is kept in memory. So are the entries of which each step of a loop takes one, and the
    states of a loop that is longer than a piece.

    Further operations are ("put", (value,), place), ("out", (value,), row) and ("kept",), a value
    that was put.
    """

    def __init__(self, half: Half) -> None:
        self.operations, self.size = [*half.operations], 0  # vectors in memory
        self.rows, self.often = _rows_of_steps(half), _often(half)
        self.places = dict[int, int]()  # of values in memory
        self.entries = dict[int, int]()  # the place of the first entry of each "nth"
        self.bodies = dict[int, list[list[int]]]()  # the pieces of a step of each long loop
        outputs = [[self._add("out", (each,), row)] for row, each in enumerate(half.outputs)]
        self.pieces = self._cut([*self._groups(half), *outputs])
        pieces = [*self.pieces, *(piece for body in self.bodies.values() for piece in body)]
        piece_of = {number: k for k, piece in enumerate(pieces) for number in piece}
        for number, k in piece_of.items():
            for each in self._taken(number):
                if piece_of.get(each, k) != k and each not in self.places:
                    self.places[each] = self._place()

    @property
    def is_short(self) -> bool:
        """Whether one function computes all."""
        return len(self.pieces) == 1 and not self.bodies

    def needed(self, numbers: Sequence[int]) -> set[int]:
        """Some operations, and what they take; numbers that are part of the code do not count."""
        taken = {each for number in numbers for each in self._taken(number)}
        return {*numbers, *(each for each in taken if self.operations[each].name != "number")}

    def _taken(self, number: int) -> tuple[int, ...]:
        """The values that an operation takes, besides those of its loop."""
        name, arguments, _ = self.operations[number]
        if name in ("state", "step", "nth", "final"):
            return ()
        return arguments[:1] if number in self.bodies else arguments

    def _add(self, name: str, arguments: tuple[int, ...], which: int) -> int:
        self.operations.append(Operation(name, arguments, which))
        return len(self.operations) - 1

    def _place(self, count: int = 1) -> int:
        self.size += count
        return self.size - count

    def _put(self, values: Sequence[int], first: int) -> list[list[int]]:
        """Operations that put values at successive places."""
        return [[self._add("put", (each,), first + k)] for k, each in enumerate(values)]

    def _groups(self, half: Half) -> Iterator[list[int]]:
        """The pieces that are not cut, in order: operations and loops."""
        ends, finals = dict[int, int](), defaultdict[int, list[int]](list)
        for number, (name, arguments, _) in enumerate(half.operations):
            if name == "again":
                ends[arguments[0]] = number
            elif name == "final":
                finals[arguments[0]].append(number)
        behind = 0
        for number, (name, *_) in enumerate(half.operations):
            if name == "repeat":
                end, behind = ends[number], ends[number] + 1
                step = [k for k in range(number + 1, end) if half.operations[k].name not in _LEAVES]
                yield from self._loop(number, step, end, finals[end])
            elif number >= behind and name not in (*_LEAVES, "final"):
                yield [number]

    def _loop(self, begin: int, step: list[int], end: int, last: list[int]) -> list[list[int]]:
        """A loop, behind what must be in memory; its last values stand beside it."""
        groups = list[list[int]]()
        for each in step:
            name, arguments, _ = self.operations[each]
            if name == "nth" and each not in self.rows:
                self.entries[each] = self._place(len(arguments) - 1)
                groups += self._put(arguments[1:], self.entries[each])
        if len(self.needed([begin, *step, end, *last])) <= MOST_TOGETHER:
            return [*groups, [begin, *step, end, *last]]
        values, following = self.operations[begin].arguments[1:], self.operations[end].arguments[1:]
        first, behind = self._place(len(values)), self._place(len(values))
        for each in (*step, *last):
            if self.operations[each].name in ("state", "final"):
                self.places[each] = first + self.operations[each].which
        kept = [self._add("kept", (), behind + k) for k in range(len(values))]
        self.places.update((each, behind + k) for k, each in enumerate(kept))
        body = [[each] for each in step if each not in self.places]
        body += [*self._put(following, behind), *self._put(kept, first)]
        self.bodies[begin] = self._cut(body)
        return [*groups, *self._put(values, first), [begin]]

    def _cut(self, groups: Iterable[list[int]]) -> list[list[int]]:
        """Pieces that need few values each; a long loop is a piece."""
        pieces, needed = list[list[int]](), set[int]()
        for group in groups:
            more = self.needed(group)
            is_full = len(needed) + len(more - needed) > MOST_TOGETHER
            if not pieces or is_full or {group[0], pieces[-1][0]} & self.bodies.keys():
                pieces.append([])
                needed = set[int]()
            pieces[-1] += group
            needed |= more
        return pieces


class _Function:
    """Writes a function of half a program: its block, or a piece."""

    def __init__(
        self,
        module: ir.Module,
        name: str,
        half: Half,
        arranged: _Arranged,
        arguments: Sequence[tuple[str, Any]] = ARGUMENTS,
    ) -> None:
        self.function = ir.Function(module, _signature(arguments), name)
        names = (name for name, _ in arguments)
        self._given = dict(zip(names, self.function.args, strict=True))
        for each in ("out", "memory"):
            self._given[each].add_attribute("noalias")
        self._builder = ir.IRBuilder(self.function.append_basic_block("entry"))
        self._half, self._arranged, self._values = half, arranged, dict[int, Vector]()

    def write(self) -> None:
        """Write loops over draws and over particles.

        If the program is short, what does not change is loaded before them.
        """
        builder, given, arranged = self._builder, self._given, self._arranged
        self._load("shared")
        with _loop(builder, given["draws"], 1) as draw:
            first = builder.mul(draw, given["draw_stride"])
            given["given"] = builder.gep(given["given"], [first])
            self._load("given")
            origin = builder.mul(draw, given["width"])
            with _loop(builder, given["width"], LANES) as particle:
                given["position"] = builder.add(origin, particle)
                self._load("slots", "noise")
                if arranged.is_short:
                    self._compute(arranged.pieces[0])
                else:
                    self._call_pieces()
        builder.ret_void()

    def _load(self, *arrays: str) -> None:
        if self._arranged.is_short:
            for number in sorted(self._arranged.needed(self._arranged.pieces[0])):
                if self._arranged.operations[number].name in arrays:
                    self._value(number)

    def _call_pieces(self) -> None:
        """Write the calls of pieces, and the loops over these."""
        for piece in self._arranged.pieces:
            body = self._arranged.bodies.get(piece[0])
            if body is None:
                self._call(piece, _index(0))
                continue
            _, (count, *_), most = self._arranged.operations[piece[0]]
            with _loop(self._builder, _steps(self._value(count), most), 1) as step:
                for each in body:
                    self._call(each, step)

    def _call(self, piece: list[int], step: Any) -> None:
        """Write a piece, and its call."""
        name = f"{self.function.name}piece{piece[0]}"
        module, given = self._builder.module, self._given
        inner = _Function(module, name, self._half, self._arranged, _PIECE)
        inner.function.linkage = "internal"
        inner.function.attributes.add("noinline")
        inner._compute(piece)
        inner._builder.ret_void()
        values = [given[name] for name, _ in _PIECE[:-1]]
        self._builder.call(inner.function, [*values, step])

    # --- values -----------------------------------------------------------------------------------

    def _value(self, number: int) -> Vector:
        """The value of an operation; one that is not computed here is loaded."""
        if number not in self._values:
            name, _, which = self._arranged.operations[number]
            if name == "number":
                value = _numeral(self._builder, self._half, number)
            elif name in ("slots", "noise"):
                value = self._loaded_row(name, _index(which))
            elif name == "shared":
                value = self._spread("shared", _index(which))
            elif name == "given":
                row = self._builder.mul(_index(which), self._given["component_stride"])
                value = self._spread("given", row)
            else:
                value = self._kept(_index(self._arranged.places[number]))
                value = value.differs(0.0) if name in MASKS else value
            self._values[number] = value
        return self._values[number]

    def _spread(self, array: str, place: Any) -> Vector:
        number = self._array(array).load(Vector(self._builder, place, "i8"), 0)
        return splat(number, LANES)

    def _array(self, name: str) -> VectorArray:
        return VectorArray(self._builder, self._given[name], "f4" if name == "noise" else "f8")

    def _row(self, array: str, row: Any) -> Vector:
        place = self._builder.mul(row, self._given[f"{array}_stride"])
        return Vector(self._builder, self._builder.add(place, self._given["position"]), "i8")

    def _loaded_row(self, array: str, row: Any) -> Vector:
        """The values of some particles in a row."""
        return self._array(array).load(self._row(array, row), LANES).to("f8")

    def _place(self, place: Any) -> Vector:
        return Vector(self._builder, self._builder.mul(place, _index(LANES)), "i8")

    def _kept(self, place: Any) -> Vector:
        return self._array("memory").load(self._place(place), LANES)

    def _keep(self, place: int, value: Vector) -> None:
        """Keep a value in memory; a mask as 1 and 0."""
        self._array("memory").store(self._place(_index(place)), value.to("f8"))

    # --- operations -------------------------------------------------------------------------------

    def _compute(self, numbers: Sequence[int]) -> None:
        loop: Any = None
        for number in numbers:
            name, arguments, which = self._arranged.operations[number]
            if name == "repeat":
                count, *values = map(self._value, arguments)
                loop = _Loop(count, values, which)
                self._given["step"] = loop.step.value
            elif name == "again":
                loop.end([self._value(each) for each in arguments[1:]])
            elif name == "put":
                self._keep(which, self._value(arguments[0]))
            elif name == "out":
                place = self._row("out", _index(which))
                self._array("out").store(place, self._value(arguments[0]).to("f8"))
            else:
                is_of_loop = name in ("state", "final")
                value = loop.values[which] if is_of_loop else self._computed(number)
                self._values[number] = value
                if number in self._arranged.places:
                    self._keep(self._arranged.places[number], value)

    def _computed(self, number: int) -> Vector:
        """The value of an operation; that of a long operation which is used often, by a call."""
        name, arguments, which = self._arranged.operations[number]
        if name in ("step", "nth"):
            return self._of_step(number)
        given = [self._value(each) for each in arguments]
        if name == "take":
            return _take(self._half, given[0], which)
        if name in self._arranged.often:
            return outlined(f"vector_{name}", FUNCTIONS[name], given)
        return FUNCTIONS[name](*given)

    def _of_step(self, number: int) -> Vector:
        """The number of a step, or its entry of some values."""
        builder, step = self._builder, self._given["step"]
        if number in self._arranged.entries:
            first = _index(self._arranged.entries[number])
            return self._kept(builder.add(first, step))
        if number in self._arranged.rows:
            first, stride = self._arranged.rows[number]
            row = builder.mul(_index(stride), step)
            return self._loaded_row("noise", builder.add(row, _index(first)))
        return splat(Vector(builder, step, "i8").to("f8"), LANES)


class _Loop:
    """A loop over steps: `values` are those of the step before, and then those of the last step.

    A step has a number, from 0 on.
    """

    def __init__(self, count: Vector, values: list[Vector], most: int) -> None:
        builder = self._builder = count.builder
        self._count = _steps(count, most)
        before, self._body = builder.block, builder.append_basic_block("step")
        builder.branch(self._body)
        builder.position_at_end(self._body)
        self.step = Vector(builder, builder.phi(_INDEX), "i8")
        self.step.value.add_incoming(_index(0), before)
        self.values = [Vector(builder, builder.phi(each.value.type), each.kind) for each in values]
        for phi, value in zip(self.values, values, strict=True):
            phi.value.add_incoming(value.value, before)

    def end(self, values: list[Vector]) -> None:
        """Begin the next step with other values, or end."""
        builder = self._builder
        following = builder.add(self.step.value, _index(1))
        self.step.value.add_incoming(following, builder.block)
        for phi, value in zip(self.values, values, strict=True):
            phi.value.add_incoming(value.value, builder.block)
        behind = builder.append_basic_block("behind")
        is_next = builder.icmp_signed("<", following, self._count)
        builder.cbranch(is_next, self._body, behind)
        builder.position_at_end(behind)
        self.values = values


def _steps(count: Vector, most: int) -> Any:
    """The number of steps of a loop, from a number that is the same for all particles."""
    first = Vector(count.builder, count.builder.extract_element(count.value, _index(0)), count.kind)
    first = (first >= 1.0).select(first, first.number(1.0))
    return (first <= most).select(first, first.number(most)).to("i8").value


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


def _often(half: Half) -> frozenset[str]:
    """The long operations that half a program uses often."""
    counts = Counter(each.name for each in half.operations)
    return frozenset(name for name, count in counts.items() if count > _MOST_INLINED) & _LONG


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
    return constant(builder, "f8", LANES, _value(half.operations[number]))


def _take(half: Half, index: Vector, which: int) -> Vector:
    """Entries of a table by a whole number; NaN where it lies outside."""
    size, content = half.tables[which]
    name = f"table{hash((size, content)) & (2**63 - 1)}"
    inside = (index >= 0.0) & (index < float(size))
    safe = inside.select(index, index.number(0.0)).to("i8")
    found = entries(name, np.frombuffer(content).tolist(), safe)
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
