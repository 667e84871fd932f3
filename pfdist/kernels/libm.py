"""The functions of the C library that compiled code calls and that may round differently elsewhere.

The C library chooses an implementation by the processor, and its versions differ. Functions whose
results are exact or correctly rounded, such as `sqrt` and `fmod`, give the same bits everywhere;
they are not counted. BLAS and LAPACK also choose by the processor; ``np.dot``, ``@`` and
``np.linalg`` call them.
"""

import re
from typing import Any

from pfdist.kernels.disk_cache import modules_of

_DECLARED = re.compile(
    r"^declare [^@\n]*?\b(?:double|float|double>|float>) @\"?([\w.]+)\"?\(", re.MULTILINE
)
_LINEAR_ALGEBRA = re.compile(r"^declare [^@\n]*@\"?numba_(xx|ez_)(\w+)\"?\(", re.MULTILINE)
_TYPE = re.compile(r"\.(?:nx)?v?\d*[fip]\d+.*$")  # of an intrinsic's arguments: .f64, .v4f32
_ALLOCATES = re.compile(r"(?:call|invoke) [^\n]*@NRT_(?:MemInfo_(?:alloc|new|varsize)|Allocate)")
_EXACT = frozenset(
    {
        *("fma", "fabs", "sqrt", "copysign", "is.fpclass", "fmod"),
        *("floor", "ceil", "trunc", "rint", "nearbyint", "round", "roundeven", "ldexp"),
        *("maxnum", "minnum", "maximum", "minimum", "maximumnum", "minimumnum"),
        *("vector.reduce.fmax", "vector.reduce.fmin"),
    }
)
_MOVES = ("masked.", "experimental.", "vector.insert", "vector.extract", "vector.splice")


def libm_functions(compiled: Any) -> tuple[str, ...]:
    """Names of the functions of the C library on which a compiled function's last digits depend.

    They are in alphabetical order, and empty if its bytes are the same on every processor. The
    function was called before, so that it is compiled or loaded from disk.
    """
    names = set()
    for module in modules_of(compiled):
        declared = (str(each).strip() for each in module.functions if each.is_declaration)
        names |= named_in("\n".join(declared))
    return tuple(sorted(names))


def makes_arrays(compiled: Any) -> bool:
    """Whether a compiled function allocates memory, which Numba does for arrays and lists."""
    return any(_ALLOCATES.search(str(module)) for module in modules_of(compiled))


def named_in(module: str) -> set[str]:
    """Names of such functions among the declarations of an LLVM module."""
    libraries = {"xx": "BLAS", "ez_": "LAPACK"}
    names = {f"{name} ({libraries[kind]})" for kind, name in _LINEAR_ALGEBRA.findall(module)}
    for symbol in _DECLARED.findall(module):
        if symbol.startswith(("Py", "NRT_", "numba_xx", "numba_ez_")):
            continue
        name = _TYPE.sub("", symbol).removeprefix("llvm.").removeprefix("numba_")
        if not symbol.startswith("llvm.") and name.endswith("f") and name != "erf":
            name = name.removesuffix("f")  # of float32
        if name not in _EXACT and not name.startswith(_MOVES):
            names.add(name)
    return names
