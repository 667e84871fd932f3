"""Numba's reasons why it cannot compile a formula, in a line of plain English."""

import re
from collections.abc import Callable

from numba import errors

NOT_COMPILED = (errors.NumbaError, errors.UnsupportedBytecodeError)
"""Errors that Numba raises if it cannot compile a function."""

_NOT_THEIRS = re.compile(r"(^|/)(numba/|pfdist/(kernels/|models/(base|seeing)\.py|filters/))")
_TOLD = re.compile(
    r"^.*(?:Untyped global name|No implementation of function|Unknown attribute|Cannot|cannot"
    r"|Invalid use|Use of unsupported|NameError).*$",
    re.MULTILINE,
)
_OPCODE = re.compile(r"unsupported opcode \((\w+)\)")
_OPCODES = {
    "STORE_GLOBAL": "a formula must not assign to a global variable",
    "IMPORT_NAME": "an import stands at the top of the file, not in a formula",
    "LOAD_BUILD_CLASS": "a class is defined at the top of the file, not in a formula",
}
_GLOBAL = re.compile(r"Untyped global name '(\w+)': (.*)")
_RECURSION = "a function that calls itself; write a loop, or the formula out"
_MISSING = re.compile(r"No implementation of function Function\(<(?:(?:built-in )?[a-z]+ )?'?(\w+)")
_SIGNATURE = re.compile(r">>> \w+\((.*)\)")
_OURS = {
    "exception_match": "`except` of one kind of error (`except Exception` it has)",
}
_OF_A_MODULE = re.compile(r"Unknown attribute '(\w+)' of type Module\(<module '([\w.]+)'")
_INSTEAD = {
    "piecewise": "; write pfdist.where(condition, a, b), one in another",
    "vectorize": "; write the formula with NumPy's functions",
    "default_rng": "; take randomness from the noise it is given",
}


def reason_of(error: BaseException) -> str:
    """The reason why Numba could not compile, and the user's line: ``what (file:line)``."""
    text = str(error)
    places = re.findall(r'File "(.*?)", line (\d+)', text)
    places += re.findall(r"Raised from (.*?) \((\d+)\)", text)
    own = [f"{file}:{line}" for file, line in places if not _NOT_THEIRS.search(file)]
    return f"{_reason(text)}{f' ({own[0]})' if own else ''}"


def _reason(text: str) -> str:
    for pattern, told in _REASONS:
        if found := pattern.search(text):
            return told(found, text)
    lines = _TOLD.findall(text) or [
        line for line in text.splitlines() if line.strip() and "nopython mode" not in line
    ]
    return _plain(lines[0]) if lines else "it does not say why"


def _no_opcode(found: re.Match[str], _: str) -> str:
    return _OPCODES.get(found[1], f"it knows no {found[1]} of Python's bytecode")


def _no_global(found: re.Match[str], _: str) -> str:
    reason = _RECURSION if "function" in found[2] else _plain(found[2])
    return f"it cannot use {found[1]}, {reason}"


def _no_function(found: re.Match[str], text: str) -> str:
    kinds = _SIGNATURE.search(text)
    arguments = "" if found[1] == "exception_match" or kinds is None else f" of ({kinds[1]})"
    return f"it has no {_OURS.get(found[1], found[1])}{arguments}"


def _no_attribute(found: re.Match[str], _: str) -> str:
    module = "np" if found[2] == "numpy" else found[2].replace("numpy.", "np.")
    return f"it has no {module}.{found[1]}{_INSTEAD.get(found[1], '')}"


_REASONS: tuple[tuple[re.Pattern[str], Callable[[re.Match[str], str], str]], ...] = (
    (_OPCODE, _no_opcode),
    (_GLOBAL, _no_global),
    (_MISSING, _no_function),
    (_OF_A_MODULE, _no_attribute),
)


def _plain(line: str) -> str:
    """A line without addresses of memory."""
    return re.sub(r" at 0x[0-9a-f]+", "", line.strip())
