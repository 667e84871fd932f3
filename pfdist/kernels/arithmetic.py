"""Operations that LLVM must be given: fused multiply-add, maximum, comparison of vectors, sums.

Only this file of the kernels contains our own LLVM instructions. All of them are portable.
"""

import functools

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from pfdist.kernels.melting import MELTING

_SHORT = 4
_SUMS = 64
LANES = 16  # 32-bit numbers that are processed together


def fma(a, b, c):
    """``a * b + c``, rounded once, for float32 or arrays of it; compiled code also takes float64.

    One instruction replaces two, and the result is the same on every machine. If the compiler were
    free to fuse, the noise would depend on the machine. In plain NumPy only float32 is supported,
    through float64, which holds the product exactly. This rounds twice, which changes the result in
    one of 2^29 cases. No argument that occurs in noise and weights is such a case.
    """
    return np.float32(np.float64(a) * b + c)


@intrinsic
def _llvm_fma(typing_context, a, b, c):
    def generate(context, builder, signature, arguments):
        return builder.fma(*arguments)

    return a(a, b, c), generate


@overload(fma, jit_options=MELTING)
def _fma_compiled(a, b, c):
    if a == b == c and a in (types.float32, types.float64):
        return lambda a, b, c: _llvm_fma(a, b, c)  # noqa: PLW0108
    return None


@intrinsic
def _llvm_maxnum(typing_context, a, b):
    def generate(context, builder, signature, arguments):
        kind = arguments[0].type
        signature = ir.FunctionType(kind, [kind, kind])
        function = builder.module.declare_intrinsic("llvm.maxnum", [kind], signature)
        return builder.call(function, arguments, fastmath=("nnan", "nsz"))

    return a(a, b), generate


def larger(a, b):
    """The larger of two floats that are not NaN; Python's `max` is not vectorised."""
    return np.maximum(a, b)


@overload(larger, jit_options=MELTING)
def _larger_compiled(a, b):
    return lambda a, b: _llvm_maxnum(a, b)  # noqa: PLW0108


@intrinsic
def add_ranks(typing_context, weights, first, points, begin, ranks):
    """Count, for each of `LANES` points, the weights that do not exceed it; add this to its rank.

    Compiled only: ``add_ranks(weights, first, points, begin, ranks)`` with arrays of uint32. All
    pairs of `LANES` weights and `LANES` points are compared: each weight with a vector of points.
    LLVM does not find this form in a loop.
    """
    signature = types.void(weights, types.uintp, points, types.uintp, ranks)
    word = ir.IntType(32)
    vector = ir.VectorType(word, LANES)

    def generate(context, builder, signature, arguments):
        weights, first, points, begin, ranks = arguments

        def address(kind, array, index):
            return builder.gep(context.make_array(kind)(context, builder, array).data, [index])

        kinds = signature.args
        weight = address(kinds[0], weights, first)
        points = builder.bitcast(address(kinds[2], points, begin), vector.as_pointer())
        ranks = builder.bitcast(address(kinds[4], ranks, begin), vector.as_pointer())
        point = builder.load(points, align=4)
        nothing, zeros = ir.Constant(vector, ir.Undefined), ir.Constant(vector, [0] * LANES)
        sums = [zeros] * 4
        for lane in range(LANES):
            value = builder.load(builder.gep(weight, [ir.Constant(ir.IntType(64), lane)]))
            alike = builder.insert_element(nothing, value, ir.Constant(word, 0))
            alike = builder.shuffle_vector(alike, nothing, zeros)  # in every lane
            passed = builder.icmp_unsigned("<=", alike, point)
            sums[lane % 4] = builder.add(sums[lane % 4], builder.zext(passed, vector))
        for partial_sum in (*sums[1:], builder.load(ranks, align=4)):
            sums[0] = builder.add(sums[0], partial_sum)
        builder.store(sums[0], ranks, align=4)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def row_sum(typing_context, values, row):
    """Sum of a row, with the same order of additions on every processor.

    Compiled only: ``row_sum(values, row)`` with an array of float64 whose rows are a multiple of
    `LANES` long. Partial sum number l adds up the values l, l + LANES, l + 2 LANES, ... Then the
    second half of the partial sums is added to the first half, until one sum is left.
    """
    signature = types.float64(values, types.uintp)
    index = ir.IntType(64)
    vector = ir.VectorType(ir.DoubleType(), _SHORT)

    def generate(context, builder, signature, arguments):
        values = context.make_array(signature.args[0])(context, builder, arguments[0])
        length = cgutils.unpack_tuple(builder, values.shape)[1]
        origin = builder.gep(values.data, [builder.mul(arguments[1], length)])
        zeros = ir.Constant(vector, [0.0] * _SHORT)
        sums = [cgutils.alloca_once_value(builder, zeros) for _ in range(_SUMS // _SHORT)]

        def add(first, last, sums):
            number = ir.Constant(index, len(sums) * _SHORT)
            with cgutils.for_range_slice(builder, first, last, number, index) as (start, _):
                for k, total in enumerate(sums):
                    place = builder.add(start, ir.Constant(index, k * _SHORT))
                    address = builder.bitcast(builder.gep(origin, [place]), vector.as_pointer())
                    block = builder.load(address, align=8)
                    builder.store(builder.fadd(builder.load(total), block), total)

        # Whole blocks of _SUMS values go to all partial sums, and the rest to the first LANES. So
        # the order of additions depends on the length alone, not on the processor's vectors.
        whole = builder.and_(length, ir.Constant(index, -_SUMS))
        add(ir.Constant(index, 0), whole, sums)
        add(whole, length, sums[: LANES // _SHORT])
        parts = [builder.load(total) for total in sums]
        while len(parts) > 1:
            half = len(parts) // 2
            parts = [builder.fadd(a, b) for a, b in zip(parts[:half], parts[half:], strict=True)]
        low, high = (
            builder.fadd(*(builder.extract_element(parts[0], ir.Constant(index, k)) for k in pair))
            for pair in ((0, 2), (1, 3))
        )
        return builder.fadd(low, high)

    return signature, generate


@intrinsic
def shaped(typing_context, array, shape):
    """The memory of an array, with a shape that LLVM sees being computed.

    LLVM does not know the size of an array that is an argument. If LLVM sees that a size is a
    multiple of a vector's length, a loop needs no remainder that is done one by one.
    """
    kind = array.copy(ndim=len(shape), layout="C")

    def generate(context, builder, signature, arguments):
        given = cgutils.create_struct_proxy(array)(context, builder, value=arguments[0])
        sizes = cgutils.unpack_tuple(builder, arguments[1], len(shape))
        itemsize = context.get_abi_sizeof(context.get_data_type(array.dtype))
        strides = [context.get_constant(types.intp, itemsize)]
        for size in reversed(sizes[1:]):
            strides.insert(0, builder.mul(strides[0], size))
        result = cgutils.create_struct_proxy(kind)(context, builder)
        result.data, result.meminfo, result.parent = given.data, given.meminfo, given.parent
        result.shape = cgutils.pack_array(builder, sizes)
        result.strides = cgutils.pack_array(builder, strides)
        result.itemsize = strides[-1]
        result.nitems = functools.reduce(builder.mul, sizes)
        return result._getvalue()

    return kind(array, shape), generate
