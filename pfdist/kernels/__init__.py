"""Compiled code: programs as machine code, noise, weights, resampling, the generic filter.

This room uses only NumPy, llvmlite and Numba, and depends on programs, but not on models. Every
compiled function is tested against plain NumPy.
"""

import os

from pfdist.errors import PfdistError, shown

_FILE = ".numba_config.yaml"


def check_settings() -> None:
    """Raise `PfdistError` if Numba would not compile, or would read a file of settings.

    Numba reads such a file in the working folder whenever it compiles. The file may change every
    number, and may belong to another project.
    """
    without = os.environ.get("NUMBA_DISABLE_JIT", "")
    if without not in ("", "0"):
        raise PfdistError(
            "the environment variable NUMBA_DISABLE_JIT must be 0 or unset, because filters are "
            f"compiled, got {shown(without)}"
        )
    if os.path.lexists(_FILE):
        raise PfdistError(
            f"the working folder must hold no {_FILE}, because Numba reads it and may compute "
            "other numbers: move it, or start in another folder"
        )


check_settings()
