"""Named tuples in memory, which compiled functions read through an address.

If a compiled function receives a large named tuple directly, each field is a separate argument, and
Numba copies all fields for each variable. A `Place` takes far less time to compile: its attributes
are the fields, read from memory where they are used. All fields take eight bytes: whole numbers
(also for a bool), numbers of double precision, and the addresses of arrays. A named tuple within
another one lies where its field is; it is a place, too.
"""

import struct
from collections.abc import Sequence
from functools import cache
from types import UnionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model
from numpy.typing import NDArray

_CACHE_LINE = 64  # bytes
_NUMBERS = {int: types.int64, bool: types.int64, np.uint64: types.uint64, float: types.float64}
_FORMATS = {types.int64: "q", types.uint64: "Q", types.float64: "d"}


class Place(types.Type):  # type: ignore[misc]  # Numba has no types
    """The type of the address of a named tuple."""

    def __init__(self, kind: type) -> None:
        self.kind = kind
        super().__init__(f"{kind.__module__}.{kind.__qualname__}")


register_model(Place)(models.OpaqueModel)


@infer_getattr
class _Fields(AttributeTemplate):  # type: ignore[misc]
    key = Place

    def generic_resolve(self, place: Any, name: str) -> Any:
        return _field(place.kind, name)[1]


@lower_getattr_generic(Place)
def _read_field(context: Any, builder: Any, place: Any, address: Any, name: str) -> Any:
    number, field = _field(place.kind, name)
    there = builder.gep(address, [ir.Constant(ir.IntType(64), 8 * number)])
    return there if isinstance(field, Place) else _load(context, builder, there, field)


@cache
def _field(kind: Any, name: str) -> tuple[int, Any]:
    """How many numbers lie before a field, and its type; a named tuple is a place."""
    types_of_fields = list(tuple_type(kind))
    number = kind._fields.index(name)
    before, field = types_of_fields[:number], types_of_fields[number]
    is_tuple = isinstance(field, types.BaseTuple)
    field = Place(field.instance_class) if is_tuple else field
    return len(_flat(before, types.BaseTuple)), field


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
        return Place(get_args(hint)[1])
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
def read(context: Any, place: Any) -> Any:
    """The named tuple at a place; compiled code never changes it."""
    kind = tuple_type(place.kind)

    def generate(context: Any, builder: Any, signature: Any, values: Sequence[Any]) -> Any:
        return _load(context, builder, values[0], kind)

    return kind(place), generate


def _load(context: Any, builder: Any, address: Any, kind: Any) -> Any:
    pointer = builder.bitcast(address, context.get_value_type(kind).as_pointer())
    loaded = builder.load(pointer)
    loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
    return loaded


def placing(kind: type) -> Any:
    """A function for compiled code: the place of a named tuple of this kind, from its address."""

    @intrinsic
    def placed(context: Any, address: Any) -> Any:
        place = Place(kind)

        def generate(context: Any, builder: Any, signature: Any, values: Sequence[Any]) -> Any:
            return builder.inttoptr(values[0], context.get_value_type(place))

        return place(types.int64), generate

    return placed


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
    """A named tuple with fields of the wanted types; one that is given by its place is read."""
    if isinstance(wanted, types.BaseTuple) and isinstance(given, Place):
        return _load(context, builder, value, wanted)
    if not isinstance(wanted, types.BaseTuple):
        return context.cast(builder, value, given, wanted)
    fields = [
        _cast(context, builder, builder.extract_value(value, number), *kinds)
        for number, kinds in enumerate(zip(given, wanted, strict=True))
    ]
    return context.make_tuple(builder, wanted, fields)
