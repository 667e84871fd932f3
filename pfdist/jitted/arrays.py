"""Checks that compiled code stays inside its arrays."""

import operator

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.errors import UnsupportedError
from numba.core.lowering import Lower
from numba.np.ufunc.dufunc import DUFunc

from pfdist.jitted.integers import are_integers

_IN_PLACE = "iadd isub imul itruediv ifloordiv imod ipow ilshift irshift iand ior ixor"
IN_PLACE = tuple(getattr(operator, name) for name in _IN_PLACE.split())
"""Operations that write to their first argument."""


class Arrays(Lower):  # type: ignore[misc]
    """A lowering with methods that check arrays; the subclass provides `raise_unless`."""

    def refuse_flat(self, array):
        """Refuse an index of ``array.flat``, which cannot be checked."""
        if isinstance(self.typeof(array.name), types.NumpyFlatType):
            raise UnsupportedError("Use of unsupported array.flat[...]: write array[...]", self.loc)

    def check_indices(self, array, value, kinds, index):
        """Emit the check that each index lies in its axis; negative indices count from the end."""
        builder = self.builder
        shape = self._shape(array, value)
        several = isinstance(index.type, ir.BaseStructType | ir.ArrayType)
        for axis, kind in enumerate(kinds):
            entry = builder.extract_value(index, axis) if several else index
            position = self.context.cast(builder, entry, kind, types.intp)
            size = shape[axis]
            low = builder.add(position, size) if kind.signed else position
            room = builder.add(size, size) if kind.signed else size
            self.raise_unless(
                builder.icmp_unsigned("<", low, room),
                IndexError,
                f"index {{}} is out of bounds for axis {axis} with size {{}}",
                position,
                size,
            )

    def check_shapes(self, kinds, values, inputs):
        """Emit the check that a call's input arrays fit the arrays to which it writes."""
        for into, written in zip(kinds[inputs:], values[inputs:], strict=True):
            if not isinstance(into, types.Array):
                continue
            room = self._shape(into, written)
            for kind, value in zip(kinds[:inputs], values[:inputs], strict=True):
                if isinstance(kind, types.Array):
                    self._check_shape(self._shape(kind, value), room)

    def _check_shape(self, shape, room):
        builder = self.builder
        if len(shape) > len(room):
            raise UnsupportedError(
                f"Use of unsupported array of {len(shape)} axes where an array of {len(room)} "
                "is written",
                self.loc,
            )
        for axis, (size, available) in enumerate(
            zip(shape, room[len(room) - len(shape) :], strict=True)
        ):
            fits = builder.or_(
                builder.icmp_signed("==", size, available),
                builder.icmp_signed("==", size, size.type(1)),
            )
            axis_written = len(room) - len(shape) + axis
            self.raise_unless(
                fits,
                ValueError,
                f"an array of size {{}} does not fit axis {axis_written} with size {{}}",
                size,
                available,
            )

    def _shape(self, kind, value):
        array = self.context.make_array(kind)(self.context, self.builder, value)
        return cgutils.unpack_tuple(self.builder, array.shape, kind.ndim)


def inputs_of(called):
    """The number of arguments that a NumPy function reads; the others are its outputs."""
    return called.nin if isinstance(called, np.ufunc | DUFunc) else None


def indices_of(kind):
    """The types of the integers in an index; empty if the index is something else."""
    kinds = kind.types if isinstance(kind, types.BaseTuple) else (kind,)  # type: ignore[attr-defined]
    return kinds if are_integers(kinds) else ()
