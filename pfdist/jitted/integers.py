"""Checks that the results of integer arithmetic fit their type."""

import builtins
import math
import operator

import numpy as np
from numba.core import cgutils, types
from numba.core.errors import UnsupportedError
from numba.core.lowering import Lower
from numba.core.typing import signature as signature_of

BITS = 64
_NARROW = 32  # bits; to narrower integers, processors convert too large floats differently
_NO_INTEGER = "NaN, infinity or a number that 64 bits do not hold cannot become an integer"
TO_INTEGER = (int, round, math.floor, math.ceil, math.trunc)
_TOO_LARGE = "an integer must fit 64 bits in compiled code; a float may be larger"

_DIVISIONS = {
    operator.floordiv: "integer division or modulo by zero",
    operator.mod: "integer division or modulo by zero",
    operator.truediv: "division by zero",
    divmod: "integer division or modulo by zero",
}
_WITH_OVERFLOW = {
    operator.add: "sadd_with_overflow",
    operator.sub: "ssub_with_overflow",
    operator.mul: "smul_with_overflow",
}
_SHIFTS = (operator.lshift, operator.rshift)
_OF_TWO = (*_DIVISIONS, *_WITH_OVERFLOW, *_SHIFTS, operator.pow)
OPERATIONS = (
    {function: function for function in _OF_TWO}
    | {
        getattr(operator, f"i{function.__name__}"): function
        for function in _OF_TWO
        if function is not divmod
    }
    | {np.power: operator.pow, builtins.pow: operator.pow}
)
"""The basic operation of each function of two integers."""

NEGATIONS = (operator.neg, abs, operator.abs)
NUMPY_SHIFTS = (np.left_shift, np.right_shift)
LDEXP = (math.ldexp, np.ldexp)
_LARGEST_EXPONENT = 10_000  # times 2 to a larger power, every float is 0 or infinite


class Integers(Lower):  # type: ignore[misc]
    """A lowering with methods that check integers; the subclass provides `raise_unless`."""

    def check_two(self, op, kinds, values):
        """Emit the check that an operation on two integers has a result that fits."""
        builder, (left, right) = self.builder, values
        signed = all(kind.signed for kind in kinds)
        if op in _DIVISIONS:
            zero = cgutils.is_scalar_zero(builder, right)
            self.raise_unless(builder.not_(zero), ZeroDivisionError, _DIVISIONS[op])
            if op in (operator.floordiv, divmod) and signed:
                opposite = builder.icmp_signed("==", right, right.type(-1))
                overflows = builder.and_(opposite, _is_least(builder, left))
                self.raise_unless(builder.not_(overflows), OverflowError, _TOO_LARGE)
        elif op in _SHIFTS:
            inside = builder.icmp_unsigned("<", right, right.type(BITS))
            self.raise_unless(inside, ValueError, "a shift must be by 0 to 63 bits, got {}", right)
        if op in _WITH_OVERFLOW and signed:
            overflows = builder.extract_value(getattr(builder, _WITH_OVERFLOW[op])(left, right), 1)
            self.raise_unless(builder.not_(overflows), OverflowError, _TOO_LARGE)
        elif op is operator.lshift and signed:
            back = builder.ashr(builder.shl(left, right), right)
            self.raise_unless(builder.icmp_signed("==", back, left), OverflowError, _TOO_LARGE)
        elif op is operator.pow:
            self._check_power(kinds, values)

    def _check_power(self, kinds, values):
        builder, (_, right) = self.builder, values
        if kinds[1].signed:
            message = "a negative power of an integer must be written with a float, as 2.0 ** n"
            positive = builder.icmp_signed(">=", right, right.type(0))
            self.raise_unless(positive, ValueError, message)
        self._check_fits(_power_fits, kinds, values)

    def check_negation(self, kind, value):
        """Emit the check that the negative of an integer fits."""
        if kind.signed:
            least = _is_least(self.builder, value)
            self.raise_unless(self.builder.not_(least), OverflowError, _TOO_LARGE)

    def check_sum(self, kinds, values):
        """Emit the check that Python's sum of integers fits."""
        self._check_fits(_sum_fits if len(kinds) == 1 else _sum_and_start_fit, kinds, values)

    def check_kind(self, kind, into, value):
        """Emit the check that an integer fits another integer type."""
        builder = self.builder
        if into.minval <= kind.minval and kind.maxval <= into.maxval:
            return
        compare = builder.icmp_signed if kind.signed else builder.icmp_unsigned
        fits = cgutils.true_bit
        if kind.minval < into.minval:
            fits = builder.and_(fits, compare(">=", value, value.type(into.minval)))
        if kind.maxval > into.maxval:
            fits = builder.and_(fits, compare("<=", value, value.type(into.maxval)))
        message = f"the integer {{}} is out of bounds for {into.name}"
        self.raise_unless(fits, OverflowError, message, value)

    def as_numpy_shifts(self, op, kinds, values, shifted):
        """Give NumPy's result of a shift by a negative number of bits, or by all bits."""
        builder, (left, right) = self.builder, values
        inside = builder.icmp_unsigned("<", right, right.type(kinds[0].bitwidth))
        rest = shifted.type(0)
        if op is np.right_shift and kinds[0].signed:
            rest = builder.ashr(left, left.type(kinds[0].bitwidth - 1))
        return builder.select(inside, shifted, rest)

    def limited_exponent(self, exponent):
        """Limit an exponent of 2 to 32 bits, which does not change the result."""
        builder = self.builder
        for order, limit in (("<", _LARGEST_EXPONENT), (">", -_LARGEST_EXPONENT)):
            constant = exponent.type(limit)
            exponent = builder.select(
                builder.icmp_signed(order, exponent, constant), exponent, constant
            )
        return exponent

    def check_finite(self, given, result):
        """Emit the check that the result for a finite float is finite."""
        builder = self.builder
        finite = [
            builder.fcmp_ordered("<", _size(builder, value), value.type(math.inf))
            for value in (given, result)
        ]
        right = builder.or_(builder.not_(finite[0]), finite[1])
        self.raise_unless(right, OverflowError, "math range error")

    # --- conversions ---

    def lower_to_number(self, fnty, expr, signature, values):
        """Lower a conversion to another type of numbers."""
        kinds, into = signature.args, signature.return_type
        if not isinstance(into, types.Integer) or len(kinds) != 1:
            return super()._lower_call_normal(fnty, expr, signature)
        (kind,), (value,) = kinds, values
        if isinstance(kind, types.Integer):
            self.check_kind(kind, into, value)
        elif isinstance(kind, types.Float):
            fits = self.fits(value, into)
            if isinstance(fnty, types.NumberClass) and _is_wide(into):
                converted = super()._lower_call_normal(fnty, expr, signature)
                least = converted.type(into.minval)
                return self.builder.select(fits, converted, least)  # NumPy's, on x86
            self.raise_unless(fits, ValueError, _NO_INTEGER)
        return super()._lower_call_normal(fnty, expr, signature)

    def lower_ldexp(self, fnty, expr, signature, values):
        """Lower a product with a power of 2; Numba itself would cut the exponent to 32 bits."""
        given, into = self.typeof(expr.args[1].name), signature.args[1]
        if not isinstance(into, types.Integer):
            raise UnsupportedError("Use of unsupported ldexp of an array", self.loc)
        wide = self.context.cast(self.builder, self.loadvar(expr.args[1].name), given, types.int64)
        limited = self.context.cast(self.builder, self.limited_exponent(wide), types.int64, into)
        lowered = self.context.get_function(fnty, signature)
        result = lowered(self.builder, (values[0], limited), self.loc)
        if fnty.typing_key is math.ldexp:
            self.check_finite(values[0], result)
        return result

    # --- tests ---

    def fits(self, value, kind):
        """Emit the test whether a float fits an integer type."""
        low = value.type(float(kind.minval) if kind.signed else -1.0)
        high = value.type(float(2 ** (kind.bitwidth - kind.signed)))
        order = ">=" if kind.signed else ">"
        return self.builder.and_(
            self.builder.fcmp_ordered(order, value, low),
            self.builder.fcmp_ordered("<", value, high),
        )

    def _check_fits(self, test, kinds, values):
        fits = self.context.compile_internal(
            self.builder, test, signature_of(types.boolean, *kinds), values
        )
        self.raise_unless(fits, OverflowError, _TOO_LARGE)


def _power_fits(base, exponent):
    """Whether a power fits a signed integer of 64 bits, up to rounding; compiled into a check."""
    size, power = abs(float(base)), 1.0
    while exponent > 0:
        if exponent & 1:
            power *= size
        size *= size
        exponent >>= 1
    return power < 2.0**63


def _sum_fits(values):
    """Whether a sum fits a signed integer of 64 bits, up to rounding; compiled into a check."""
    total = 0.0
    for value in values:
        total += float(value)
    return abs(total) < 2.0**63


def _sum_and_start_fit(values, start):
    total = float(start)
    for value in values:
        total += float(value)
    return abs(total) < 2.0**63


def _is_wide(kind):
    return kind.signed and kind.bitwidth >= _NARROW


def are_integers(kinds):
    """Whether all types are integers."""
    return all(isinstance(kind, types.Integer) for kind in kinds)


def _is_least(builder, value):
    return builder.icmp_signed("==", value, value.type(-(2 ** (value.type.width - 1))))


def _size(builder, value):
    function = builder.module.declare_intrinsic("llvm.fabs", [value.type])
    return builder.call(function, [value])
