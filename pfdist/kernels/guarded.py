"""Compile a formula so that a mistake is an error with a line, and never a figure.

Numba checks neither indices nor integer arithmetic unless it is told to, and an error that it
raises by itself names no line. Here a formula is lowered to machine code instruction by
instruction, as Numba does it, with a check in front of each instruction that can go wrong:

- an index must lie in its array;
- the divisor of integers must not be 0, and their products, powers and shifts must fit 64 bits;
- a float that becomes an integer must fit 64 bits.

A formula without such instructions compiles to the same code as without checks.
"""

import math
import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.callconv import RETCODE_USEREXC, CPUCallConv
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.cpu import CPUContext
from numba.core.errors import UnsupportedError
from numba.core.ir import SetItem, StaticSetItem
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering
from numba.core.typing import signature as signature_of

_DIVISIONS = {
    operator.floordiv: "integer division or modulo by zero",
    operator.mod: "integer division or modulo by zero",
    operator.truediv: "division by zero",
    divmod: "integer division or modulo by zero",
}
_OPERATIONS = {
    function: getattr(operator, function.__name__, function)
    for function in (*_DIVISIONS, operator.mul, operator.pow, operator.lshift, operator.rshift)
} | {np.power: operator.pow}
_TO_INTEGER = (int, round, math.floor, math.ceil, math.trunc)
_NO_INTEGER = "NaN, infinity or a number that 64 bits do not hold cannot become an integer"
_TOO_LARGE = "an integer must fit 64 bits in compiled code; a float may be larger"
_BITS = 64
UNWRAPPED = "pfdist_integers_of_an_error_"
"""How the name of a function begins that turns an error's integers into Python's."""


class _Errors(CPUCallConv):  # type: ignore[misc]
    """How compiled code hands on an error: with the formula's name and the line at work."""

    def build_excinfo_struct(self, exc, exc_args, loc, func_name):
        place = self.context.place
        return exc, exc_args, (self.context.formula, place.filename, place.line)

    def emit_unwrap_dynamic_exception_fn(self, module, st_type, nb_types):
        """As Numba's for integers, but without the environment, which cached code lacks."""
        kinds = [kind for kind in nb_types if kind is not None]
        if any(kind != types.int64 for kind in kinds):
            return super().emit_unwrap_dynamic_exception_fn(module, st_type, nb_types)
        name = f"{UNWRAPPED}{len(kinds)}"
        if name in module.globals:
            return module.globals[name]
        function = ir.Function(
            module, ir.FunctionType(cgutils.voidptr_t, [cgutils.voidptr_t]), name
        )
        function.linkage = "linkonce_odr"
        function.attributes.add("noinline")
        builder = ir.IRBuilder(function.append_basic_block())
        python = self.context.get_python_api(builder)
        values = builder.load(builder.bitcast(function.args[0], st_type.as_pointer()))
        integers = [
            python.long_from_longlong(builder.extract_value(values, i)) for i in range(len(kinds))
        ]
        self.context.nrt.free(builder, function.args[0])
        builder.ret(python.tuple_pack(integers))
        return function


class _Context(CPUContext):  # type: ignore[misc]
    """What a formula is lowered in."""

    @property
    def call_conv(self):
        return _Errors(self)

    @property
    def place(self):
        """Where in the source the lowering is."""
        return self.lowering.loc

    @property
    def formula(self):
        """The formula's name."""
        return self.lowering.func_ir.func_id.func_name


class _Lower(Lower):  # type: ignore[misc]
    def __init__(self, context, *arguments, **keywords):
        super().__init__(context, *arguments, **keywords)
        self.context.lowering = self

    # --- what can go wrong ---

    def lower_inst(self, inst):
        if isinstance(inst, SetItem | StaticSetItem):
            self._refuse_flat(inst.target)
        super().lower_inst(inst)

    def lower_getitem(self, resty, expr, value, index, signature):
        self._refuse_flat(value)
        array = self.typeof(value.name)
        indices = _indices(self.typeof(index.name))
        if not isinstance(array, types.Array) or not indices:
            return super().lower_getitem(resty, expr, value, index, signature)
        self._check_indices(array, self.loadvar(value.name), indices, self.loadvar(index.name))
        self.context.enable_boundscheck = False  # it is done, and with a better message
        try:
            return super().lower_getitem(resty, expr, value, index, signature)
        finally:
            self.context.enable_boundscheck = True

    def lower_binop(self, resty, expr, op):
        kinds = self.fndesc.calltypes[expr].args
        if _are_integers(kinds):
            values = [self._cast_var(*pair) for pair in zip((expr.lhs, expr.rhs), kinds)]  # noqa: B905
            self._check_integers(op, kinds, values)
        return super().lower_binop(resty, expr, op)

    def _lower_call_normal(self, fnty, expr, signature):
        called, kinds = getattr(fnty, "typing_key", None), signature.args
        to_integer = isinstance(signature.return_type, types.Integer)
        if called in _OPERATIONS and _are_integers(kinds):
            values = self.fold_call_args(fnty, signature, expr.args, expr.vararg, expr.kws)
            self._check_integers(_OPERATIONS[called], kinds, values)
        elif to_integer and len(kinds) == 1 and isinstance(kinds[0], types.Float):
            (value,) = self.fold_call_args(fnty, signature, expr.args, expr.vararg, expr.kws)
            fits = self._fits(value, signature.return_type)
            if isinstance(fnty, types.NumberClass) and signature.return_type.signed:
                converted = super()._lower_call_normal(fnty, expr, signature)
                least = converted.type(signature.return_type.minval)
                return self.builder.select(fits, converted, least)  # NumPy's, on x86
            if isinstance(fnty, types.NumberClass) or called in _TO_INTEGER:
                self._raise_unless(fits, ValueError, _NO_INTEGER)
        return super()._lower_call_normal(fnty, expr, signature)

    # --- checks ---

    def _refuse_flat(self, array):
        if isinstance(self.typeof(array.name), types.NumpyFlatType):
            raise UnsupportedError("Use of unsupported array.flat[...]: write array[...]", self.loc)

    def _check_indices(self, array, value, kinds, index):
        """Raise unless each index lies in its axis; a negative one counts from the end."""
        builder = self.builder
        shape = cgutils.unpack_tuple(
            builder, self.context.make_array(array)(self.context, builder, value).shape, array.ndim
        )
        several = isinstance(index.type, ir.BaseStructType | ir.ArrayType)
        for axis, kind in enumerate(kinds):
            entry = builder.extract_value(index, axis) if several else index
            position = self.context.cast(builder, entry, kind, types.intp)
            size = shape[axis]
            low = builder.add(position, size) if kind.signed else position
            room = builder.add(size, size) if kind.signed else size
            self._raise_unless(
                builder.icmp_unsigned("<", low, room),
                IndexError,
                f"index {{}} is out of bounds for axis {axis} with size {{}}",
                position,
                size,
            )

    def _check_integers(self, op, kinds, values):
        """Raise where integers give what an integer cannot be."""
        builder, (left, right) = self.builder, values
        if op in _DIVISIONS:
            zero = cgutils.is_scalar_zero(builder, right)
            self._raise_unless(builder.not_(zero), ZeroDivisionError, _DIVISIONS[op])
        elif op in (operator.lshift, operator.rshift):
            inside = builder.icmp_unsigned("<", right, right.type(_BITS))
            self._raise_unless(inside, ValueError, "a shift must be by 0 to 63 bits, got {}", right)
        signed = all(kind.signed for kind in kinds)
        if op is operator.mul and signed:
            overflows = builder.extract_value(builder.smul_with_overflow(left, right), 1)
            self._raise_unless(builder.not_(overflows), OverflowError, _TOO_LARGE)
        elif op is operator.lshift and signed:
            back = builder.ashr(builder.shl(left, right), right)
            self._raise_unless(builder.icmp_signed("==", back, left), OverflowError, _TOO_LARGE)
        elif op is operator.pow:
            if kinds[1].signed:
                message = "a negative power of an integer must be written with a float, as 2.0 ** n"
                positive = builder.icmp_signed(">=", right, right.type(0))
                self._raise_unless(positive, ValueError, message)
            fits = self.context.compile_internal(
                builder, _power_fits, signature_of(types.boolean, *kinds), values
            )
            self._raise_unless(fits, OverflowError, _TOO_LARGE)

    def _fits(self, value, kind):
        """Whether an integer of this kind can hold a float."""
        low = value.type(float(kind.minval) if kind.signed else -1.0)
        high = value.type(float(2 ** (kind.bitwidth - kind.signed)))
        order = ">=" if kind.signed else ">"
        return self.builder.and_(
            self.builder.fcmp_ordered(order, value, low),
            self.builder.fcmp_ordered("<", value, high),
        )

    # --- errors ---

    def _raise_unless(self, right, kind, message, *integers):
        """Raise an error whose message has integers in the places of its brackets."""
        builder = self.builder
        with cgutils.if_unlikely(builder, builder.not_(right)):
            values = tuple(self._as_int64(integer) for integer in integers)
            function = self.func_ir.func_id
            if getattr(function.func, "takes_t", False):
                message += " at t = {}"
                values += (self._as_int64(self.fnargs[function.arg_names.index("t")]),)
            if not values:
                self.call_conv.return_user_exc(builder, kind, (message,))
                return
            self.call_conv.set_dynamic_user_exc(
                builder, kind, (message, *values), (None, *[types.int64] * len(values))
            )
            caught = getattr(builder, "_in_try_block", None)
            if caught:
                builder.branch(caught["target"])
            else:
                builder.ret(RETCODE_USEREXC)

    def _as_int64(self, integer):
        return self.builder.sext(integer, ir.IntType(_BITS))


def _power_fits(base, exponent):
    """Whether a power of integers fits 64 bits, but for the last of them."""
    size, power = abs(float(base)), 1.0
    while exponent > 0:
        if exponent & 1:
            power *= size
        size *= size
        exponent >>= 1
    return power < 2.0**63


def _indices(kind):
    """The kinds of the integers that an index is made of; none if it is something else."""
    kinds = kind.types if isinstance(kind, types.BaseTuple) else (kind,)  # type: ignore[attr-defined]
    return kinds if _are_integers(kinds) else ()


def _are_integers(kinds):
    return all(isinstance(kind, types.Integer) for kind in kinds)


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):  # type: ignore[misc]
    _name = "lowering with checks"

    @property
    def lowering_class(self):
        return _Lower


class Guarded(Compiler):  # type: ignore[misc]
    """Numba's compiler with checks."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        context = self.state.targetctx
        context.__class__ = _Context
        context.cached_internal_func = {}  # they raise errors of this formula
        context.enable_boundscheck = True

    def define_pipelines(self) -> Any:
        """Give Numba's pipelines, with the lowering that checks."""
        pipelines = super().define_pipelines()
        for pipeline in pipelines:
            pipeline.passes = [
                (_Lowering if step is NativeLowering else step, what)
                for step, what in pipeline.passes
            ]
            pipeline.finalize()
        return pipelines
