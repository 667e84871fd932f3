"""How compiled code hands on an error: with the formula, the line at work and the instant."""

from collections.abc import Iterator
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.callconv import (
    RETCODE_USEREXC,
    CPUCallConv,
)

UNWRAPPED = "pfdist_integers_of_an_error_"
"""How the name of a function begins that turns an error's parts into Python's."""

_INTEGER = ir.IntType(64)


class InCallError(Exception):
    """An error inside a function that a formula calls.

    Parameters
    ----------
    raised : tuple
        The error as Numba packs it: class, arguments, and (function, file, line) or None.
    t : int, optional
        The instant, if the formula knows it.
    """

    def __init__(self, raised: Any, t: int | None = None) -> None:
        super().__init__(raised, t)
        self.raised, self.t = raised, t

    def layers(self) -> Iterator[tuple[type[BaseException], tuple[Any, ...], Any]]:
        """Give class, arguments and place of the error that each call handed on, outermost first.

        The last of them is the error itself.
        """
        raised: Any = self.raised
        while True:
            yield raised
            kind, arguments, _ = raised
            if not (isinstance(kind, type) and issubclass(kind, InCallError)):
                return
            raised = arguments[0]


class CallConv(CPUCallConv):  # type: ignore[misc]
    """Numba's calling convention, but for what an error carries."""

    def build_excinfo_struct(self, exc, exc_args, loc, func_name):
        """Give what is known of an error before it happens."""
        place = self.context.place
        return exc, exc_args, (self.context.formula, place.filename, place.line)

    # --- what is added ---

    def return_user_exc(self, builder, exc, exc_args=None, loc=None, func_name=None):
        """Return an error, with the instant where it is known."""
        t = self.context.instant(builder)
        # To tell the instant takes memory.
        if t is None or exc is MemoryError or not _is_text(exc_args):
            super().return_user_exc(builder, exc, exc_args, loc, func_name)
        else:
            self.return_formatted(builder, exc, exc_args[0], ())

    def return_formatted(self, builder, exc, text, integers):
        """Return an error whose text has integers in the places of its brackets."""
        t = self.context.instant(builder)
        if t is not None:
            text, integers = f"{text} at t = {{}}", (*integers, t)
        if not integers:
            super().return_user_exc(builder, exc, (text,))
            return
        kinds = (None, *[types.int64] * len(integers))
        self.set_dynamic_user_exc(builder, exc, (text, *integers), kinds)
        caught = getattr(builder, "_in_try_block", None)
        if caught:
            builder.branch(caught["target"])
        else:
            builder.ret(RETCODE_USEREXC)

    def return_status_propagate(self, builder, status):
        """Hand on the error of a function that was called, with the place of the call."""
        if self.context.is_of_formula(builder) and self.context.enable_nrt:
            pointer = cgutils.alloca_once_value(builder, status.excinfoptr)
            with builder.if_then(status.is_user_exc):
                self._wrap(builder, status.excinfoptr)
                own = self._get_excinfo_argument(builder.function)
                builder.store(builder.load(own), pointer)
            status = status._replace(excinfoptr=builder.load(pointer))
        super().return_status_propagate(builder, status)

    def _wrap(self, builder, inner):
        t = self.context.instant(builder)
        values = (inner,) if t is None else (inner, t)
        kinds = (types.voidptr, types.int64)[: len(values)]
        self.set_dynamic_user_exc(builder, InCallError, values, kinds)

    # --- into Python's ---

    def emit_unwrap_dynamic_exception_fn(self, module, st_type, nb_types):
        """As Numba's for integers, but without the environment, which cached code lacks."""
        kinds = [kind for kind in nb_types if kind is not None]
        if any(kind not in (types.int64, types.voidptr) for kind in kinds):
            return super().emit_unwrap_dynamic_exception_fn(module, st_type, nb_types)
        letters = ["i" if kind == types.int64 else "e" for kind in kinds]
        name = f"{UNWRAPPED}{''.join(letters)}"
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
        made = []
        for i, kind in enumerate(kinds):
            value = builder.extract_value(values, i)
            made.append(
                python.long_from_longlong(value)
                if kind == types.int64
                else self.unpack_exception(builder, python, _Status(value))
            )
        self.context.nrt.free(builder, function.args[0])
        builder.ret(python.tuple_pack(made))
        return function


class _Status:
    """As much of a call's status as it takes to unpack an error."""

    def __init__(self, pointer):
        self.excinfoptr = pointer


def as_int64(builder, integer):
    """Give an integer with 64 bits."""
    return builder.sext(integer, _INTEGER) if integer.type.width < _INTEGER.width else integer


def _is_text(arguments):
    return (
        arguments is not None
        and len(arguments) == 1
        and isinstance(arguments[0], str)
        and "{" not in arguments[0]
    )
