"""Vectors of numbers in LLVM: Python functions write instructions for whole vectors.

A `Vector` is a value of LLVM's builder, with operators. A function of vectors runs once, while code
is compiled, and writes an instruction for each operation. Nothing depends on how LLVM optimises:
no operation may be reordered or fused, so all processors give the same bits.
"""

import ctypes
import inspect
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, register_model

LANES = 16
"""Number of particles in a vector."""

KINDS: dict[str, Any] = {
    "f4": ir.FloatType(), "f8": ir.DoubleType(), "i1": ir.IntType(1),
    "i4": ir.IntType(32), "u4": ir.IntType(32), "i8": ir.IntType(64), "u8": ir.IntType(64),
}  # fmt: skip
"""The types of numbers: floats, signed and unsigned integers, and masks, by their bytes."""

Number = float | int | bool


class Vector:
    """A vector of a kind, or a single number (``lanes`` is 0)."""

    __slots__ = ("builder", "kind", "value")

    def __init__(self, builder: ir.IRBuilder, value: Any, kind: str) -> None:
        self.builder, self.value, self.kind = builder, value, kind

    @property
    def lanes(self) -> int:
        """Number of lanes; 0 of a single number."""
        kind = self.value.type
        return int(kind.count) if isinstance(kind, ir.VectorType) else 0

    @property
    def is_float(self) -> bool:
        """Whether the numbers are floating-point numbers."""
        return self.kind[0] == "f"

    def number(self, value: Number, kind: str = "") -> "Vector":
        """The same number in all lanes, of the same kind or another."""
        return constant(self.builder, kind or self.kind, self.lanes, value)

    def like(self, other: "Vector | Number") -> "Vector":
        """Another operand, with as many lanes as this vector."""
        if not isinstance(other, Vector):
            return self.number(other)
        return splat(other, self.lanes) if self.lanes and not other.lanes else other

    def _of(self, value: Any, kind: str = "") -> "Vector":
        return Vector(self.builder, value, kind or self.kind)

    def _both(self, operation: str, other: "Vector | Number") -> "Vector":
        second = self.like(other)
        first = second.like(self)
        name = f"f{operation}" if self.is_float else operation
        return self._of(getattr(self.builder, name)(first.value, second.value))

    def __add__(self, other: "Vector | Number") -> "Vector":
        return self._both("add", other)

    def __sub__(self, other: "Vector | Number") -> "Vector":
        return self._both("sub", other)

    def __mul__(self, other: "Vector | Number") -> "Vector":
        return self._both("mul", other)

    def __truediv__(self, other: "Vector | Number") -> "Vector":
        return self._both("div", other)

    def __radd__(self, other: Number) -> "Vector":
        return self.like(other) + self

    def __rsub__(self, other: Number) -> "Vector":
        return self.like(other) - self

    def __rmul__(self, other: Number) -> "Vector":
        return self.like(other) * self

    def __rtruediv__(self, other: Number) -> "Vector":
        return self.like(other) / self

    def __neg__(self) -> "Vector":
        return self._of(self.builder.fneg(self.value) if self.is_float else (0 - self).value)

    def __and__(self, other: "Vector | Number") -> "Vector":
        return self._of(self.builder.and_(self.value, self.like(other).value))

    def __or__(self, other: "Vector | Number") -> "Vector":
        return self._of(self.builder.or_(self.value, self.like(other).value))

    def __xor__(self, other: "Vector | Number") -> "Vector":
        return self._of(self.builder.xor(self.value, self.like(other).value))

    def __invert__(self) -> "Vector":
        return self._of(self.builder.not_(self.value))

    def __lshift__(self, other: "Vector | Number") -> "Vector":
        return self._of(self.builder.shl(self.value, self.like(other).value))

    def __rshift__(self, other: "Vector | Number") -> "Vector":
        shift = self.builder.ashr if self.kind[0] == "i" else self.builder.lshr
        return self._of(shift(self.value, self.like(other).value))

    # --- comparisons: false where an operand is not a number, but for "differs" -----------------

    def _compared(self, operator: str, other: "Vector | Number") -> "Vector":
        second = self.like(other)
        first = second.like(self).value
        builder = self.builder
        if not self.is_float:
            compare = builder.icmp_signed if self.kind[0] == "i" else builder.icmp_unsigned
        elif operator == "!=":
            compare = builder.fcmp_unordered
        else:
            compare = builder.fcmp_ordered
        return self._of(compare(operator, first, second.value), "i1")

    def __lt__(self, other: "Vector | Number") -> "Vector":
        return self._compared("<", other)

    def __le__(self, other: "Vector | Number") -> "Vector":
        return self._compared("<=", other)

    def __gt__(self, other: "Vector | Number") -> "Vector":
        return self._compared(">", other)

    def __ge__(self, other: "Vector | Number") -> "Vector":
        return self._compared(">=", other)

    def equals(self, other: "Vector | Number") -> "Vector":
        """A mask of equal numbers."""
        return self._compared("==", other)

    def differs(self, other: "Vector | Number") -> "Vector":
        """A mask of different numbers; NaN differs from itself."""
        return self._compared("!=", other)

    def select(self, if_true: "Vector | Number", if_false: "Vector") -> "Vector":
        """The first value where this mask holds, and the second elsewhere."""
        second = if_false if if_false.lanes or not self.lanes else splat(if_false, self.lanes)
        first = second.like(if_true)
        return second._of(self.builder.select(self.value, first.value, second.value))

    # --- functions ------------------------------------------------------------------------------

    def call(self, name: str, *others: "Vector | Number") -> "Vector":
        """The value of an LLVM intrinsic, such as "fma", for operands of one type."""
        arguments = [self.value, *(self.like(other).value for other in others)]
        kind = self.value.type
        suffix = f"{self.kind.replace('u', 'i')[0]}{8 * int(self.kind[1])}"
        suffix = f"v{self.lanes}{suffix}" if self.lanes else suffix
        module, full = self.builder.module, f"llvm.{name}.{suffix}"
        function = module.globals.get(full)
        if function is None:
            signature = ir.FunctionType(kind, [kind] * len(arguments))
            function = ir.Function(module, signature, full)
        return self._of(self.builder.call(function, arguments))

    def fma(self, factor: "Vector | Number", summand: "Vector | Number") -> "Vector":
        """The product with a factor, plus a summand, rounded once."""
        return self.call("fma", factor, summand)

    def rotated(self, bits: int) -> "Vector":
        """Each integer, rotated to the left."""
        return self.call("fshl", self, bits)

    def bits(self, kind: str) -> "Vector":
        """The same bits as numbers of another kind of the same size."""
        element = KINDS[kind]
        whole = ir.VectorType(element, self.lanes) if self.lanes else element
        return self._of(self.builder.bitcast(self.value, whole), kind)

    def to(self, kind: str) -> "Vector":
        """The same numbers in another kind.

        A float that becomes an integer must be in the range of integers; else the result is
        undefined.
        """
        if kind == self.kind:
            return self
        element, builder = KINDS[kind], self.builder
        whole = ir.VectorType(element, self.lanes) if self.lanes else element
        smaller = int(kind[1]) < int(self.kind[1])
        is_signed = self.kind[0] == "i" and self.kind != "i1"
        if self.is_float and kind[0] == "f":
            convert = builder.fptrunc if smaller else builder.fpext
        elif self.is_float:
            convert = builder.fptosi if kind[0] == "i" else builder.fptoui
        elif kind[0] == "f":
            convert = builder.sitofp if is_signed else builder.uitofp
        elif KINDS[self.kind].width == element.width:
            return self._of(self.value, kind)
        elif KINDS[self.kind].width > element.width:
            convert = builder.trunc
        else:
            convert = builder.sext if is_signed else builder.zext
        return self._of(convert(self.value, whole), kind)

    # --- lanes ----------------------------------------------------------------------------------

    def lane(self, number: int) -> "Vector":
        """The number in a lane."""
        return self._of(self.builder.extract_element(self.value, ir.Constant(KINDS["i4"], number)))

    def shuffled(self, lanes: Sequence[int], other: "Vector | None" = None) -> "Vector":
        """A vector of some lanes; lanes of `other` are numbered after this vector's."""
        mask = ir.Constant(ir.VectorType(KINDS["i4"], len(lanes)), list(lanes))
        second = self if other is None else other
        return self._of(self.builder.shuffle_vector(self.value, second.value, mask))

    def halves(self) -> tuple["Vector", "Vector"]:
        """The first half of the lanes, and the second."""
        half = self.lanes // 2
        return self.shuffled(range(half)), self.shuffled(range(half, 2 * half))

    def reduced(self, combine: Callable[["Vector", "Vector"], "Vector"]) -> "Vector":
        """All lanes combined into one number in a fixed order, half with half."""
        rest = self
        while rest.lanes > 1:
            rest = combine(*rest.halves())
        return rest.lane(0)

    def sum(self) -> "Vector":
        """The sum of all lanes, in a fixed order."""
        return self.reduced(lambda first, second: first + second)

    def count(self) -> "Vector":
        """The number of lanes in which this mask holds."""
        bits = self.builder.bitcast(self.value, ir.IntType(self.lanes))
        count = self.builder.zext(self.builder.ctpop(bits), KINDS["i8"])
        return self._of(count, "i8")


def constant(builder: ir.IRBuilder, kind: str, lanes: int, value: Number) -> Vector:
    """The same number in all lanes; a single number if there are 0 lanes."""
    element = KINDS[kind]
    if kind == "f4":
        number: Any = ctypes.c_float(value).value  # infinite if it is too large
    else:
        number = float(value) if kind == "f8" else int(value) & ((1 << element.width) - 1)
    if lanes:
        return Vector(builder, ir.Constant(ir.VectorType(element, lanes), [number] * lanes), kind)
    return Vector(builder, ir.Constant(element, number), kind)


def splat(number: Vector, lanes: int) -> Vector:
    """A vector with the same number in all lanes."""
    builder, whole = number.builder, ir.VectorType(number.value.type, lanes)
    nothing, first = ir.Constant(whole, ir.Undefined), ir.Constant(KINDS["i4"], 0)
    vector = builder.insert_element(nothing, number.value, first)
    zeros = ir.Constant(ir.VectorType(KINDS["i4"], lanes), [0] * lanes)
    return Vector(builder, builder.shuffle_vector(vector, nothing, zeros), number.kind)


def outlined(name: str, function: Callable[..., Vector], given: Sequence[Vector]) -> Vector:
    """The value of a function whose code is in a module only once; values have one type."""
    builder, kind = given[0].builder, given[0].value.type
    written = builder.module.globals.get(name)
    if written is None:
        signature = ir.FunctionType(kind, [kind] * len(given))
        written = ir.Function(builder.module, signature, name)
        written.linkage = "internal"
        written.attributes.add("noinline")
        inner = ir.IRBuilder(written.append_basic_block("entry"))
        inner.ret(function(*(Vector(inner, each, given[0].kind) for each in written.args)).value)
    return given[0]._of(builder.call(written, [each.value for each in given]))


def where_some(mask: Vector, compute: Callable[[], Vector], usual: Vector) -> Vector:
    """Values computed where a mask holds; if it holds nowhere, nothing is computed."""
    builder, before = mask.builder, mask.builder.block
    some = mask.count().differs(0) if mask.lanes else mask
    with builder.if_then(some.value, likely=False):
        computed = mask.select(compute(), usual)
        inside = builder.block
    value = usual._of(builder.phi(usual.value.type))
    value.value.add_incoming(computed.value, inside)
    value.value.add_incoming(usual.value, before)
    return value


def each_lane(function: Callable[..., Vector], *given: Vector) -> Vector:
    """The values of a function of single numbers, where the first number is not NaN.

    They are computed by a loop, so that the code is short.
    """
    x = given[0]
    builder, before = x.builder, x.builder.block
    body, behind = builder.append_basic_block("lane"), builder.append_basic_block("behind")
    builder.branch(body)
    builder.position_at_end(body)
    lane, values = builder.phi(KINDS["i4"]), builder.phi(x.value.type)
    lane.add_incoming(ir.Constant(KINDS["i4"], 0), before)
    values.add_incoming(ir.Constant(x.value.type, ir.Undefined), before)
    numbers = [x._of(builder.extract_element(each.value, lane)) for each in given]
    is_given = numbers[0].equals(numbers[0])
    number = where_some(is_given, lambda: function(*numbers), numbers[0])
    following = builder.insert_element(values, number.value, lane)
    next_lane = builder.add(lane, ir.Constant(KINDS["i4"], 1))
    lane.add_incoming(next_lane, builder.block)
    values.add_incoming(following, builder.block)
    more = builder.icmp_signed("<", next_lane, ir.Constant(KINDS["i4"], x.lanes))
    builder.cbranch(more, body, behind)
    builder.position_at_end(behind)
    return x._of(following)


def entries(name: str, numbers: Sequence[float], index: Vector) -> Vector:
    """Entries of a table that is in a module only once, by integers within its range."""
    builder = index.builder
    table = builder.module.globals.get(name)
    if table is None:
        kind = ir.ArrayType(KINDS["f8"], len(numbers))
        table = ir.GlobalVariable(builder.module, kind, name)
        table.linkage, table.global_constant = "internal", True
        table.initializer = ir.Constant(kind, list(numbers))

    def entry(number: Vector) -> Any:
        address = builder.gep(table, [ir.Constant(KINDS["i8"], 0), number.value])
        return builder.load(address, align=8)

    if not index.lanes:
        return Vector(builder, entry(index), "f8")
    vector = ir.Constant(ir.VectorType(KINDS["f8"], index.lanes), ir.Undefined)
    for lane in range(index.lanes):
        place = ir.Constant(KINDS["i4"], lane)
        vector = builder.insert_element(vector, entry(index.lane(lane)), place)
    return Vector(builder, vector, "f8")


def polynomial(x: Vector, *coefficients: float) -> Vector:
    """A polynomial, the highest power first."""
    value = x.number(coefficients[0])
    for coefficient in coefficients[1:]:
        value = value.fma(x, coefficient)
    return value


def iota(builder: ir.IRBuilder, kind: str, lanes: int) -> Vector:
    """The vector 0, 1, 2, ..."""
    whole = ir.VectorType(KINDS[kind], lanes)
    return Vector(builder, ir.Constant(whole, list(range(lanes))), kind)


class VectorArray:
    """The memory of an array: vectors are loaded from it and stored into it."""

    def __init__(self, builder: ir.IRBuilder, address: Any, kind: str) -> None:
        self.builder, self.address, self.kind = builder, address, kind

    def _at(self, index: Vector, more: int, lanes: int) -> Any:
        place = index.value
        if more:
            place = self.builder.add(place, ir.Constant(KINDS["i8"], more))
        address = self.builder.gep(self.address, [place])
        if not lanes:
            return address
        return self.builder.bitcast(address, ir.VectorType(KINDS[self.kind], lanes).as_pointer())

    def load(self, index: Vector, lanes: int, more: int = 0) -> Vector:
        """The numbers from an index on, plus `more`; a single number if there are 0 lanes."""
        address = self._at(index, more, lanes)
        value = self.builder.load(address, align=int(self.kind[1]))
        return Vector(self.builder, value, self.kind)

    def store(self, index: Vector, numbers: Vector, more: int = 0) -> None:
        """Store a vector, or a number, from an index on."""
        address = self._at(index, more, numbers.lanes)
        self.builder.store(numbers.value, address, align=int(self.kind[1]))


# --- functions of vectors in compiled functions ---------------------------------------------------


class VectorType(types.Type):  # type: ignore[misc]
    """The type of a vector in functions that Numba compiles."""

    def __init__(self, kind: str, lanes: int) -> None:
        self.kind, self.lanes = kind, lanes
        super().__init__(name=f"vector of {lanes} {kind}")


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: VectorType) -> None:
        super().__init__(manager, kind, ir.VectorType(KINDS[kind.kind], kind.lanes))


_KIND_OF = {
    types.float32: "f4", types.float64: "f8", types.int32: "i4", types.uint32: "u4",
    types.int64: "i8", types.uint64: "u8", types.boolean: "i1", types.uint8: "u1",
}  # fmt: skip
_NUMBER_OF = {kind: number for number, kind in _KIND_OF.items()}


def _result_type(result: str | None) -> Any:
    """The type of a result such as "f8" (a number), "16 f4" (a vector) or None."""
    if result is None:
        return types.none
    lanes, _, kind = result.rpartition(" ")
    return VectorType(kind, int(lanes)) if lanes else _NUMBER_OF[kind]


_CACHE_LINE = 64  # bytes


def vectorised(result: str | None = None) -> Callable[[Callable[..., Any]], Any]:
    """A decorator that makes a function of vectors callable from Numba functions.

    The function receives a `Vector` for each number or vector, and an `Array` for each array. Its
    result is described by, for instance, "f8" for a number, "16 f4" for a vector, or None.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        def typed(context: Any, *arguments: Any) -> tuple[Any, Callable[..., Any]]:
            return _result_type(result)(*arguments), generate

        def generate(context: Any, builder: Any, signature: Any, values: Sequence[Any]) -> Any:
            operands = [
                _operand(context, builder, kind, value)
                for kind, value in zip(signature.args, values, strict=True)
            ]
            _align_stack(builder.function)
            computed = function(*operands)
            return context.get_dummy_value() if result is None else computed.value

        typed.__name__, typed.__doc__ = function.__name__, function.__doc__
        typed.__module__ = function.__module__
        names = "context", *inspect.signature(function).parameters
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        signature = inspect.Signature([inspect.Parameter(name, kind) for name in names])
        vars(typed)["__signature__"] = signature  # Numba reads it
        return intrinsic(typed)

    return decorate


def _align_stack(function: Any) -> None:
    """Let no vector that LLVM keeps on the stack cross a line of the processor's cache, or a page.

    The stack is aligned to 16 bytes only, and begins elsewhere in each process. In some processes
    vectors crossed a page, and a filter took up to a third longer.
    """
    function.attributes.alignstack = _CACHE_LINE
    function.attributes.add("nounwind")  # llvmlite writes no alignment if it is alone


def _operand(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        data = context.make_array(kind)(context, builder, value).data
        return VectorArray(builder, data, _KIND_OF[kind.dtype])
    if isinstance(kind, types.CPointer):
        return VectorArray(builder, value, _KIND_OF[kind.dtype])
    if isinstance(kind, VectorType):
        return Vector(builder, value, kind.kind)
    return Vector(builder, value, _KIND_OF[types.unliteral(kind)])
