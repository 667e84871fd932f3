"""Named tuples in memory, which compiled functions read through an address.

If a compiled function receives a large named tuple directly, each field is a separate argument. One
address takes far less time to compile. All fields take eight bytes: whole numbers (also for a
bool), numbers of double precision, and the addresses of arrays. A named tuple within another one
lies where its field is.
"""

import struct
from collections.abc import Callable, Sequence
from functools import cache
from types import UnionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

_CACHE_LINE = 64  # bytes
_NUMBERS = {int: types.int64, bool: types.int64, np.uint64: types.uint64, float: types.float64}
_FORMATS = {types.int64: "q", types.uint64: "Q", types.float64: "d"}


@cache
def tuple_type(kind: type) -> Any:
    """The type of a named tuple in compiled code, from its annotations; arrays are pointers."""
    hints = get_type_hints(kind, include_extras=True)
    return types.BaseTuple.from_types([_type_of(hint) for hint in hints.values()], kind)


def _type_of(hint: Any) -> Any:
    if isinstance(hint, UnionType):  # of numbers of Python and of NumPy; the first is compiled
        hint = get_args(hint)[0]
    if hasattr(get_origin(hint), "__value__"):  # NDArray is an alias from NumPy 2.5 on
        hint = get_origin(hint).__value__[get_args(hint)]
    if get_origin(hint) is np.ndarray:
        (number,) = get_args(get_args(hint)[1])
        return types.CPointer(numba.from_dtype(np.dtype(number)))
    if get_origin(hint) is Annotated:
        return types.CPointer(tuple_type(get_args(hint)[1]))
    return _NUMBERS[hint] if hint in _NUMBERS else tuple_type(hint)


def in_memory(values: Any) -> NDArray[np.int64]:
    """A named tuple in memory.

    It holds addresses of arrays, which the caller must keep. A field may also be the address
    itself, see `zeros`.
    """
    kind: Any = type(values)
    dtypes, layout = _layout(kind)
    numbers = _flat(values)
    for place, dtype in dtypes:
        array = numbers[place]
        if isinstance(array, int):
            continue
        if array.dtype != dtype or not array.flags.c_contiguous:
            raise TypeError(f"an array must be contiguous, of {dtype}, got one of {array.dtype}")
        numbers[place] = array.ctypes.data
    return np.frombuffer(struct.pack(layout, *numbers), np.int64).copy()


def zeros(kind: type, **counts: int) -> tuple[NDArray[np.uint8], dict[str, Any]]:
    """Memory with zeros for the arrays of a named tuple, and the address of each by name.

    This is faster than separate arrays. Each array begins at a line of the processor's cache. The
    caller must keep the memory.
    """
    sizes, addresses, end = _sizes(kind), {}, 0
    for name, count in counts.items():
        addresses[name] = end
        end += -(-count * sizes[name] // _CACHE_LINE) * _CACHE_LINE
    memory = np.zeros(end + _CACHE_LINE, np.uint8)
    first = -(-memory.ctypes.data // _CACHE_LINE) * _CACHE_LINE
    return memory, {name: first + place for name, place in addresses.items()}


@cache
def _sizes(kind: Any) -> dict[str, int]:
    """Bytes of an entry of each array of a named tuple."""
    fields = zip(kind._fields, tuple_type(kind), strict=True)
    return {
        name: field.dtype.bitwidth // 8
        for name, field in fields
        if isinstance(field, types.CPointer)
    }


@cache
def _layout(kind: Any) -> tuple[list[tuple[int, np.dtype[Any]]], str]:
    """The places of arrays among all numbers of a named tuple, and the format of the numbers."""
    fields = _flat(tuple_type(kind), types.BaseTuple)
    dtypes = [
        (place, np.dtype(field.dtype.name))
        for place, field in enumerate(fields)
        if isinstance(field, types.CPointer)
    ]
    return dtypes, "".join(_FORMATS.get(field, "Q") for field in fields)


def _flat(values: Any, kind: type = tuple) -> list[Any]:
    """All fields of a named tuple, or of the type of one, and of those in it."""
    fields = []
    for value in values:
        if isinstance(value, kind):
            fields += _flat(value, kind)
        else:
            fields.append(value)
    return fields


@intrinsic
def read(context: Any, pointer: Any) -> Any:
    """The named tuple at an address; compiled code never changes it."""

    def generate(context: Any, builder: Any, signature: Any, values: Sequence[Any]) -> Any:
        return _load(builder, values[0])

    return pointer.dtype(pointer), generate


def readers(kind: type) -> tuple[Callable[[Any], Any], ...]:
    """A function for each field of a named tuple, which reads it from the named tuple's address."""
    return tuple(map(_reader, range(len(tuple_type(kind)))))


def _reader(place: int) -> Any:
    @intrinsic
    def read_field(context: Any, pointer: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Sequence[Any]) -> Any:
            index = [ir.Constant(ir.IntType(32), number) for number in (0, place)]
            return _load(builder, builder.gep(values[0], index))

        return pointer.dtype[place](pointer), generate

    return read_field


def _load(builder: Any, address: Any) -> Any:
    loaded = builder.load(address)
    loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
    return loaded


@intrinsic
def ahead(context: Any, pointer: Any, entries: Any) -> Any:
    """The pointer to a later entry."""

    def generate(context: Any, builder: Any, signature: Any, values: Sequence[Any]) -> Any:
        return builder.gep(values[0], [values[1]])

    return pointer(pointer, types.int64), generate


@intrinsic
def call(context: Any, address: Any, values: Any) -> Any:
    """Call a function by its address with a named tuple; see `pfdist.kernels.cached.Entry`."""
    kind = tuple_type(values.instance_class)

    def generate(context: Any, builder: Any, signature: Any, arguments: Sequence[Any]) -> Any:
        stored = _cast(context, builder, arguments[1], values, kind)
        with builder.goto_entry_block():
            memory = builder.alloca(stored.type)
        builder.store(stored, memory)
        function = ir.FunctionType(ir.VoidType(), [memory.type])
        builder.call(builder.inttoptr(arguments[0], function.as_pointer()), [memory])
        return context.get_dummy_value()

    return types.none(address, values), generate


def _cast(context: Any, builder: Any, value: Any, given: Any, wanted: Any) -> Any:
    """A named tuple with fields of the wanted types."""
    if not isinstance(wanted, types.BaseTuple):
        return context.cast(builder, value, given, wanted)
    fields = [
        _cast(context, builder, builder.extract_value(value, number), *kinds)
        for number, kinds in enumerate(zip(given, wanted, strict=True))
    ]
    return context.make_tuple(builder, wanted, fields)
