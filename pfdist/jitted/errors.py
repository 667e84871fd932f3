"""Errors of compiled code, with the formula, the line and the instant.

A compiled function returns a status code. If the code says "error", the function also returns a
pointer to the error's parts: its class, its arguments and its place. Each caller tests the code and
returns it to its own caller. At last the code that Python called turns the parts into a Python
exception. `CallConv` extends this convention of Numba: an error inside a called function is wrapped
in an `InCallError` with the place of the call, so that the whole way to the error is known.
"""

from collections.abc import Iterator
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.callconv import (
    RETCODE_USEREXC,
    CPUCallConv,
)

UNWRAPPED = "pfdist_integers_of_an_error_"
"""Prefix of the names of functions that turn an error's parts into Python objects."""

_INTEGER = ir.IntType(64)


class InCallError(Exception):
    """An error inside a function that a formula calls.

    Parameters
    ----------
    raised : tuple
        The error as Numba packs it: class, arguments, and (function, file, line) or None.
    t : int, optional
        The instant, if the formula has an argument t.
    """

    def __init__(self, raised: Any, t: int | None = None) -> None:
        super().__init__(raised, t)
        self.raised, self.t = raised, t

    def layers(self) -> Iterator[tuple[type[BaseException], tuple[Any, ...], Any]]:
        """Give class, arguments and place of the errors inside this one, the outermost first.

        The last layer is the error itself.
        """
        raised: Any = self.raised
        while True:
            yield raised
            kind, arguments, _ = raised
            if not (isinstance(kind, type) and issubclass(kind, InCallError)):
                return
            raised = arguments[0]


class CallConv(CPUCallConv):  # type: ignore[misc]
    """Numba's calling convention, with more information in each error."""

    def build_excinfo_struct(self, exc, exc_args, loc, func_name):
        """Give the parts of an error that are known when the function is compiled."""
        place = self.context.place
        return exc, exc_args, (self.context.formula, place.filename, place.line)

    # --- the code that returns an error ---

    def return_user_exc(self, builder, exc, exc_args=None, loc=None, func_name=None):
        """Emit the return of an error, with the instant if it is known and fits the message."""
        t = self.context.instant(builder)
        # An error with an instant allocates memory.
        if t is None or exc is MemoryError or not _is_text(exc_args):
            super().return_user_exc(builder, exc, exc_args, loc, func_name)
        else:
            self.return_formatted(builder, exc, exc_args[0], ())

    def return_formatted(self, builder, exc, text, integers):
        """Emit the return of an error; an integer replaces each pair of braces in its text."""
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
        """Emit the return of a called function's error.

        A formula, or a function that it calls, adds the place of the call.
        """
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

    # --- the code that turns an error into Python objects ---

    def emit_unwrap_dynamic_exception_fn(self, module, st_type, nb_types):
        """Emit the function that makes a Python tuple of an error's arguments.

        An argument is an integer, or a pointer to the error inside a call; Numba handles errors
        with other arguments. Numba's own function needs the environment of the compiled function.
        Code from the cache has no such environment.
        """
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
    """The part of a call's status from which an error is unpacked."""

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
