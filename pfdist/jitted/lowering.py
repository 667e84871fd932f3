"""The lowering of statements to LLVM instructions, with a check where a statement can go wrong.

Numba calls a method of `Lowered` for each statement of a function. Each method below emits the
check, and then has Numba's own method emit the statement. A check is a comparison and a branch
that is rarely taken; the branch returns the error (`Lowered.raise_unless`).
"""

from functools import cache
from typing import Any

from numba import njit
from numba.core import cgutils, types
from numba.core.cpu import CPUContext
from numba.core.errors import UnsupportedError
from numba.core.ir import Expr, SetItem, StaticSetItem
from numba.np.ufunc.dufunc import DUFunc

from pfdist.jitted.admitted import unchecked
from pfdist.jitted.arrays import IN_PLACE, Arrays, indices_of, inputs_of
from pfdist.jitted.errors import CallConv, as_int64
from pfdist.jitted.integers import (
    LDEXP,
    NEGATIONS,
    NUMPY_SHIFTS,
    OPERATIONS,
    TO_INTEGER,
    Integers,
    are_integers,
)

_NUMBERS = (types.Float, types.Integer, types.Boolean)


class Context(CPUContext):  # type: ignore[misc]
    """Numba's context of a compilation, which also knows the formula that is compiled.

    `Guarded` turns Numba's context into this class.
    """

    compiler: Any = None
    lowering: Any = None  # the `Lowered` at work; None before it begins

    @property
    def call_conv(self):
        """The calling convention, by which functions return errors."""
        return CallConv(self)

    @property
    def place(self):
        """The line of the source that is lowered at present."""
        return self.lowering.loc

    @property
    def formula(self):
        """The name of the formula, or of the function that is compiled on its own."""
        return self.lowering.func_ir.func_id.func_name

    def is_of_formula(self, builder):
        """Whether a formula or a helper is lowered, and not a function of Numba inside it."""
        return self._is_lowered(builder) and hasattr(self._function, "takes_t")

    def instant(self, builder):
        """Give t, if the formula that is lowered has an argument t; otherwise None."""
        if not self._is_lowered(builder) or not getattr(self._function, "takes_t", False):
            return None
        names = self.lowering.func_ir.func_id.arg_names
        position = names.index("t")
        if not isinstance(self.lowering.fndesc.argtypes[position], types.Integer):
            return None
        return as_int64(builder, self.lowering.fnargs[position])

    @property
    def is_a_formula_of_t(self):
        """Whether a formula is lowered that has an argument t, and not a function that it calls."""
        return getattr(self._function, "takes_t", False)

    def get_function(self, fn, sig, _firstcall=True):
        """Give the function that a call calls; refuse a function without checks."""
        name = unchecked(fn, sig)
        if name is not None:
            raise UnsupportedError(
                f"Use of unsupported function {name}: its indices cannot be checked here; "
                "compile it with numba.njit, and call it by its name",
                self.place,
            )
        return super().get_function(fn, sig, _firstcall)

    @property
    def _function(self):
        return self.lowering.func_ir.func_id.func

    def _is_lowered(self, builder):
        own = getattr(self.lowering, "builder", None)
        return own is not None and builder.function is own.function


class Lowered(Integers, Arrays):
    """Numba's lowering, with checks."""

    def __init__(self, context, *arguments, **keywords):
        super().__init__(context, *arguments, **keywords)
        self.context.lowering = self

    # --- statements that can go wrong ---

    def lower_inst(self, inst):
        """Lower a statement."""
        if isinstance(inst, SetItem | StaticSetItem):
            self.refuse_flat(inst.target)
            self._check_entry(inst)
        super().lower_inst(inst)

    def lower_getitem(self, resty, expr, value, index, signature):
        """Lower an index."""
        self.refuse_flat(value)
        array = self.typeof(value.name)
        indices = indices_of(self.typeof(index.name))
        if not isinstance(array, types.Array) or not indices:
            return super().lower_getitem(resty, expr, value, index, signature)
        if not self._is_parameter_at_t(value, index):
            self.check_indices(array, self.loadvar(value.name), indices, self.loadvar(index.name))
        self.context.enable_boundscheck = False  # the check above has a better message
        try:
            return super().lower_getitem(resty, expr, value, index, signature)
        finally:
            self.context.enable_boundscheck = True

    def lower_binop(self, resty, expr, op):
        """Lower an operation on two values."""
        kinds = self.fndesc.calltypes[expr].args
        values = [self._cast_var(*pair) for pair in zip((expr.lhs, expr.rhs), kinds)]  # noqa: B905
        if op in OPERATIONS and are_integers(kinds):
            self.check_two(OPERATIONS[op], kinds, values)
        elif op in IN_PLACE:
            self.check_shapes((kinds[1], kinds[0]), (values[1], values[0]), 1)
        return super().lower_binop(resty, expr, op)

    def lower_expr(self, resty, expr):
        """Lower an expression."""
        if expr.op == "unary" and expr.fn in NEGATIONS:
            self._check_negation(self.fndesc.calltypes[expr].args, [expr.value])
        elif expr.op == "arrayexpr":
            for called in _vectorized_in(expr.expr):
                raise self._refused_on_arrays(called)
        return super().lower_expr(resty, expr)

    def _lower_call_normal(self, fnty, expr, signature):
        called, kinds = getattr(fnty, "typing_key", None), signature.args
        if not isinstance(fnty, types.NumberClass) and not _may_go_wrong(called, signature):
            return super()._lower_call_normal(fnty, expr, signature)
        values = self.fold_call_args(fnty, signature, expr.args, expr.vararg, expr.kws)
        if isinstance(fnty, types.NumberClass) or called in TO_INTEGER:
            return self.lower_to_number(fnty, expr, signature, values)
        if isinstance(called, DUFunc):
            return self._elementwise(called, signature, values)
        if called in LDEXP:
            return self.lower_ldexp(fnty, expr, signature, values)
        if called in NUMPY_SHIFTS and are_integers((*kinds, signature.return_type)):
            shifted = super()._lower_call_normal(fnty, expr, signature)
            return self.as_numpy_shifts(called, kinds, values, shifted)
        self._check_call(called, signature, values)
        return super()._lower_call_normal(fnty, expr, signature)

    def _check_call(self, called, signature, values):
        """Emit the check of a call whose integer may overflow, or which writes to an array."""
        kinds, inputs = signature.args, inputs_of(called)
        if called in OPERATIONS and len(kinds) == 2 and are_integers(kinds):
            self.check_two(OPERATIONS[called], kinds, values)
        elif called in NEGATIONS and are_integers(kinds):
            self.check_negation(kinds[0], values[0])
        elif called is sum and isinstance(signature.return_type, types.Integer):
            self.check_sum(kinds, values)
        elif inputs is not None and len(kinds) > inputs:
            self.check_shapes(kinds, values, inputs)
        elif called in IN_PLACE:
            self.check_shapes((kinds[1], kinds[0]), (values[1], values[0]), 1)

    def _lower_call_FunctionType(self, fnty, expr, signature):  # noqa: N802  Numba's name
        raise self._refused(expr)

    def _lower_call_ExternalFunctionPointer(self, fnty, expr, signature):  # noqa: N802
        raise self._refused(expr)

    # --- checks and refusals ---

    def _is_parameter_at_t(self, array, index):
        """Whether an entry is ``p.name[t]`` of a formula's own p and t, which always exists.

        A parameter that is an array has an entry for each instant; the filter checks this once. A
        check for each particle stops vectorisation, and such formulas take up to 8 times the time.
        """
        arguments = self.func_ir.func_id.arg_names
        if not self.context.is_a_formula_of_t or index.name != "t" or "p" not in arguments:
            return False
        read = self.func_ir.get_definition(array)
        return isinstance(read, Expr) and read.op == "getattr" and read.value.name == "p"

    def _refused(self, expr):
        return UnsupportedError(
            "Use of unsupported function that is chosen while the formula runs, or was compiled "
            "elsewhere: what it reads cannot be checked; call a function by its name",
            expr.loc,
        )

    def _check_entry(self, inst):
        """Emit the check that an integer fits the array to which it is written."""
        array, given = self.typeof(inst.target.name), self.typeof(inst.value.name)
        plain = types.unliteral(given)  # type: ignore[attr-defined]
        if isinstance(array, types.Array) and are_integers((array.dtype, given)):
            value = self.context.cast(self.builder, self.loadvar(inst.value.name), given, plain)
            self.check_kind(plain, array.dtype, value)

    def _check_negation(self, kinds, variables):
        if are_integers(kinds):
            self.check_negation(kinds[0], self._cast_var(variables[0], kinds[0]))

    def _elementwise(self, called, signature, values):
        """Lower a call of a vectorized function, whose errors Numba's own lowering drops."""
        inner, _ = called.find_ewise_function(signature.args)
        if inner is None or not all(isinstance(kind, _NUMBERS) for kind in signature.args):
            raise self._refused_on_arrays(called)
        context, builder = self.context, self.builder
        given = [
            context.cast(builder, value, kind, wanted)
            for value, kind, wanted in zip(values, signature.args, inner.args, strict=True)
        ]
        function = context.typing_context.resolve_value_type(_of_numbers(called, context.compiler))
        call = function.get_call_type(context.typing_context, inner.args, {})
        result = context.get_function(function, call)(builder, given, self.loc)
        result = context.cast(builder, result, call.return_type, inner.return_type)
        return context.cast(builder, result, inner.return_type, signature.return_type)

    def _refused_on_arrays(self, called):
        return UnsupportedError(
            f"Use of unsupported call of the vectorized function {called.__name__} with an array: "
            "call it with numbers",
            self.loc,
        )

    def raise_unless(self, right, kind, message, *integers):
        """Emit a branch that returns an error unless a condition holds.

        The brackets in the message are filled with the integers.
        """
        builder = self.builder
        with cgutils.if_unlikely(builder, builder.not_(right)):
            values = tuple(as_int64(builder, integer) for integer in integers)
            self.call_conv.return_formatted(builder, kind, message, values)


def _may_go_wrong(called, signature):
    """Whether a call of this function needs a check."""
    try:
        known = called in _LOOKED_AT
    except TypeError:  # the function has no hash
        return False
    inputs = inputs_of(called)
    writes = inputs is not None and len(signature.args) > inputs
    return known or writes or isinstance(called, DUFunc)


def _vectorized_in(expression):
    """Functions made by `numba.vectorize` in an expression of arrays, as Numba holds it."""
    if isinstance(expression, DUFunc):
        yield expression
    elif isinstance(expression, tuple | list):
        for part in expression:
            yield from _vectorized_in(part)


@cache
def _of_numbers(called, compiler):
    """Compile the function of numbers from which a vectorized function was made."""
    return njit(called._dispatcher.py_func, pipeline_class=compiler, error_model="numpy")


_LOOKED_AT = {*OPERATIONS, *IN_PLACE, *NEGATIONS, *TO_INTEGER, *NUMPY_SHIFTS, *LDEXP, sum}
