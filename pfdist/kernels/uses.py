"""How a function uses the names in its code, read from its bytecode.

If a function uses a module only as ``module.name``, only the named variables of the module matter.
If the module itself is passed on, returned or stored, all its variables may matter.
"""

import dis
import types
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

from pfdist.kernels.formulas import names_in

_GLOBAL = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS")
_ATTRIBUTE = ("LOAD_ATTR", "LOAD_METHOD")
_NO_STEPS = ("CACHE", "EXTENDED_ARG", "NOP")
_AFTER_IMPORT = ("IMPORT_FROM", "POP_TOP", "SWAP", "ROT_TWO", "COPY")
# Names through which code can reach every attribute of an object.
_ALL = frozenset({"__dict__", "__getattr__", "__getattribute__"})


@dataclass(frozen=True)
class Uses:
    """Names in a function, and in the functions that it defines.

    Parameters
    ----------
    named : frozenset of str
        All names of global variables and attributes.
    loose : frozenset of str
        Names whose value is used in another way than ``name.attribute``.
    """

    named: frozenset[str]
    loose: frozenset[str]

    def through(self, name: str) -> "Uses | None":
        """The names that matter in the module behind a name; None if all matter."""
        return None if name in self.loose or _ALL & self.named else self


class Import(NamedTuple):
    """An import statement inside a function.

    Parameters
    ----------
    name : str
        The module's name, as it is written.
    level : int
        The number of dots before the name.
    names : tuple of str
        The names that are imported from the module; empty if the module itself is imported.
    variables : frozenset of str
        Local variables that hold the imported objects.
    """

    name: str
    level: int
    names: tuple[str, ...]
    variables: frozenset[str]


@cache
def uses_in(code: types.CodeType) -> Uses:
    """Give the names that a function uses."""
    return Uses(frozenset(names_in(code)), frozenset(_loose(code)))


@cache
def globals_in(code: types.CodeType) -> frozenset[str]:
    """Names of global variables that a function and those it defines read."""
    names = {step.argval for step in _steps(code) if step.opname in _GLOBAL}
    return frozenset(names).union(*map(globals_in, _inner(code)))


@cache
def imports_in(code: types.CodeType) -> tuple[Import, ...]:
    """Give what a function, or one that it defines, imports when it is called."""
    steps, found = _steps(code), []
    for place, step in enumerate(steps):
        if step.opname == "IMPORT_NAME":
            level, names = steps[place - 2].argval, steps[place - 1].argval
            variables = frozenset(_stored(steps[place + 1 :]))
            found.append(Import(step.argval, level, tuple(names or ()), variables))
    for inner in _inner(code):
        found += imports_in(inner)
    return tuple(found)


def _loose(code: types.CodeType) -> Iterator[str]:
    """Names whose value is used other than to take an attribute, local variables among them."""
    steps = _steps(code)
    for step, following in pairwise(steps):
        is_name = step.opname.startswith("LOAD_") and step.opcode not in dis.hasconst
        if is_name and following.opname not in _ATTRIBUTE:
            names = step.argval if isinstance(step.argval, tuple) else (step.argval,)
            yield from (name for name in names if isinstance(name, str))
    for inner in _inner(code):
        yield from _loose(inner)


def _stored(steps: list[dis.Instruction]) -> Iterator[str]:
    """Variables to which the instructions after an import assign."""
    for step in steps:
        if step.opname.startswith("STORE_"):
            yield from step.argval if isinstance(step.argval, tuple) else (step.argval,)
        elif step.opname not in _AFTER_IMPORT:
            return


def _steps(code: types.CodeType) -> list[dis.Instruction]:
    return [step for step in dis.get_instructions(code) if step.opname not in _NO_STEPS]


def _inner(code: types.CodeType) -> Iterator[types.CodeType]:
    return (constant for constant in code.co_consts if isinstance(constant, types.CodeType))
