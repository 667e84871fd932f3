"""Multiply-adds and reciprocals in formulas: which operations are fused follows from their text.

If LLVM may fuse ``a * b + c`` where it likes, the bytes depend on the processor. If it may not,
formulas are up to a tenth slower. So this pass over Numba's representation of a formula decides it,
before Numba knows any type or processor:

================================  =====================================================
``a * b + c``, ``c + a * b``      ``fma(a, b, c)``, where the product is used nowhere else
``a * b - c``, ``c - a * b``      ``fma(a, b, -c)``, ``fma(-a, b, c)``
``x ** 2`` in the place of a * b  as ``x * x``
``a * b + c * d``                 ``fma(a, b, c * d)``
``a / d``                         ``a * (1 / d)``, where d is the same for all particles:
                                  a constant, or computed from arguments called t or p
================================  =====================================================

What is not a product of float64 numbers stays as it was written.
"""

import operator
from typing import Any

from numba import types
from numba.core import ir
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.extending import overload

from pfdist.kernels.arithmetic import fma
from pfdist.kernels.guarded import Guarded
from pfdist.kernels.melting import MELTING, melting

# Where the operands are integers, the operation is checked as any other of a formula.
_CHECKED = {**MELTING, "pipeline_class": melting(Guarded), "error_model": "numpy"}

_FIXED_ARGUMENTS = ("t", "p")
_FIXED_OPERATIONS = frozenset(
    {"binop", "unary", "getattr", "call", "build_tuple", "static_getitem", "getitem", "cast"}
)


# --- what the operations become -------------------------------------------------------------------


def product_plus(a, b, c):
    """``a * b + c``."""
    return a * b + c


def product_minus(a, b, c):
    """``a * b - c``."""
    return a * b - c


def minus_product(a, b, c):
    """``c - a * b``."""
    return c - a * b


def quotient(a, d):
    """``a / d``."""
    return a / d


def _are_numbers(*kinds):
    return all(isinstance(kind, types.Float | types.Integer | types.Boolean) for kind in kinds)


def _fuses(a, b, c):
    return _are_numbers(a, b, c) and types.float64 in (a, b)


@overload(product_plus, jit_options=_CHECKED)
def _product_plus(a, b, c):
    if _fuses(a, b, c):
        return lambda a, b, c: fma(float(a), float(b), float(c))
    return lambda a, b, c: a * b + c


@overload(product_minus, jit_options=_CHECKED)
def _product_minus(a, b, c):
    if _fuses(a, b, c):
        return lambda a, b, c: fma(float(a), float(b), -float(c))
    return lambda a, b, c: a * b - c


@overload(minus_product, jit_options=_CHECKED)
def _minus_product(a, b, c):
    if _fuses(a, b, c):
        return lambda a, b, c: fma(-float(a), float(b), float(c))
    return lambda a, b, c: c - a * b


@overload(quotient, jit_options=_CHECKED)
def _quotient(a, d):
    if a == types.float64 and _are_numbers(d):
        return lambda a, d: a * (1.0 / float(d))
    return lambda a, d: a / d


# --- where they stand ----------------------------------------------------------------------------


@register_pass(mutates_CFG=False, analysis_only=False)
class MultiplyAdd(FunctionPass):  # type: ignore[misc]
    """Replace sums of products, and quotients, in a formula."""

    _name = "pfdist_multiply_add"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state):
        """Rewrite the function; say whether anything was changed."""
        formula = _Formula(state.func_ir)
        changed = [formula.rewrite(block) for block in state.func_ir.blocks.values()]
        return any(changed)


class _Formula:
    """A formula's variables: how each is defined, and how often it is used."""

    def __init__(self, func_ir):
        self._definitions: dict[str, list[Any]] = {}
        self._uses: dict[str, int] = {}
        for block in func_ir.blocks.values():
            for statement in block.body:
                if isinstance(statement, ir.Assign):
                    self._definitions.setdefault(statement.target.name, []).append(statement.value)
                    used = _variables(statement.value)
                else:
                    used = statement.list_vars()
                for variable in used:
                    self._uses[variable.name] = self._uses.get(variable.name, 0) + 1

    def rewrite(self, block):
        """Rewrite a block, and say whether anything was changed."""
        body: list[Any] = []
        here: set[str] = set()
        for statement in block.body:
            if isinstance(statement, ir.Assign):
                found = self._replacement(statement.value, here)
                if found:
                    function, arguments = found
                    name = block.scope.redefine("$multiply_add", statement.loc)
                    chosen = ir.Global(function.__name__, function, statement.loc)
                    body.append(ir.Assign(chosen, name, statement.loc))
                    call = ir.Expr.call(name, arguments, (), statement.loc)
                    statement = ir.Assign(call, statement.target, statement.loc)  # noqa: PLW2901
                here.add(statement.target.name)
            body.append(statement)
        changed = len(body) > len(block.body)
        block.body = body
        return changed

    def _replacement(self, value, here):
        """The function and its arguments in the place of an operation; None if it stays."""
        if not (isinstance(value, ir.Expr) and value.op in ("binop", "inplace_binop")):
            return None
        function = value.immutable_fn if value.op == "inplace_binop" else value.fn
        left, right = value.lhs, value.rhs
        if function is operator.truediv:
            scaled = self._is_fixed(right) and not self._is_fixed(left)
            return (quotient, (left, right)) if scaled else None
        if function not in (operator.add, operator.sub):
            return None
        added = function is operator.add
        if factors := self._factors(left, here):
            return (product_plus if added else product_minus, (*factors, right))
        if factors := self._factors(right, here):
            return (product_plus if added else minus_product, (*factors, left))
        return None

    def _factors(self, variable, here):
        """The two factors of a product of this block that is used once; None if it is none."""
        value = self._definition(variable)
        single = variable.name in here and self._uses[variable.name] == 1
        if not (single and isinstance(value, ir.Expr) and value.op == "binop"):
            return None
        if value.fn is operator.mul:
            return value.lhs, value.rhs
        exponent = self._definition(value.rhs)
        squared = value.fn is operator.pow and isinstance(exponent, ir.Const)
        if squared and type(exponent.value) is int and exponent.value == 2:
            return value.lhs, value.lhs
        return None

    def _definition(self, variable):
        """The only definition of a variable; None if there are several."""
        definitions = self._definitions.get(variable.name, ())
        return definitions[0] if len(definitions) == 1 else None

    def _is_fixed(self, variable):
        """Whether a value is the same for all particles: made of constants, t and p alone."""
        value = self._definition(variable)
        if isinstance(value, ir.Arg):
            return value.name in _FIXED_ARGUMENTS
        if isinstance(value, ir.Var):
            return self._is_fixed(value)
        if isinstance(value, ir.Expr):
            return value.op in _FIXED_OPERATIONS and all(map(self._is_fixed, _variables(value)))
        return isinstance(value, ir.Const | ir.Global | ir.FreeVar)


def _variables(value):
    """Variables in the right-hand side of an assignment."""
    if isinstance(value, ir.Var):
        return [value]
    return value.list_vars() if isinstance(value, ir.Expr) else []
