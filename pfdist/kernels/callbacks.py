"""Formulas that machine code calls back: Python functions on arrays of particles.

They replace blocks, see `pfdist.kernels.lowering.ARGUMENTS`. So noise, weights, resampling and
estimates are those of the compiled filter, and a function is called once per instant for all
particles of a batch. A function of a batched model always receives the same number of particles,
even if a batch has fewer draws, because rounding in libraries may depend on the shapes of arrays.
"""

import ctypes
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.lowering import ARGUMENTS, POINTERS

Array = NDArray[np.float64]
Rows = dict[str, tuple[str, int, int]]
"""The place of each argument: its array, its first row and its number of rows."""

_KIND = ctypes.CFUNCTYPE(
    None, *(ctypes.c_size_t if name in POINTERS else ctypes.c_int64 for name, _ in ARGUMENTS)
)
_MOST_VIEWS = 10_000
_failed = threading.local()


class _Given(NamedTuple):
    """The arguments of a block, see `pfdist.kernels.lowering.ARGUMENTS`."""

    out: int
    out_stride: int
    slots: int
    slots_stride: int
    noise: int
    noise_stride: int
    given: int
    draw_stride: int
    component_stride: int
    shared: int
    memory: int
    draws: int
    width: int


class Callback:
    """A Python function with the address of a block.

    Parameters
    ----------
    function : callable
        ``(groups, t) -> rows``: from the arrays (components, particles) of each argument and the
        instant to the rows of results, each a number or an array of particles.
    rows : mapping of str to (str, int, int)
    results : int
        Number of rows of results.
    together : int
        Approximate and constant number of particles that it receives, or those of one draw if that
        is more.
    """

    def __init__(
        self,
        function: Callable[[dict[str, Array], int], Any],
        rows: Rows,
        results: int,
        together: int,
    ) -> None:
        self._function, self._rows, self._results = function, rows, results
        self.together = together
        self._views: dict[tuple[int, int, int, Any], NDArray[Any]] = {}
        self._kept = _KIND(self._call)  # must live as long as the address is used

    @property
    def address(self) -> int:
        """The address for calls from machine code."""
        return int(ctypes.cast(self._kept, ctypes.c_void_p).value or 0)

    def _call(self, *values: int) -> None:
        """Fill the rows of results; after an error they are NaN, and `check` raises it."""
        at = _Given(*values)
        size = at.out_stride
        results = self._view(at.out, self._results, size, np.float64)
        if getattr(_failed, "error", None) is not None:
            results[:] = np.nan
            return
        try:
            groups = dict[str, Array]()
            for name, (array, first, count) in self._rows.items():
                if count == 0:
                    groups[name] = np.empty((0, size))
                elif array == "given":
                    groups[name] = self._spread(at, count, size)
                elif array == "noise":
                    rows = self._view(at.noise, first + count, at.noise_stride, np.float32)
                    groups[name] = rows[first:, :size].astype(np.float64)
                else:
                    rows = self._view(at.slots, first + count, at.slots_stride, np.float64)
                    groups[name] = rows[first:, :size]
                    groups[name].flags.writeable = False  # a formula may not change its arguments
            t = int(self._view(at.shared, 1, 1, np.float64)[0, 0])
            with np.errstate(all="ignore"):
                for row, value in zip(results, self._function(groups, t), strict=True):
                    row[:] = value
        except BaseException as error:  # Python drops an error that leaves a callback
            _failed.error = error
            results[:] = np.nan

    def _spread(self, at: "_Given", count: int, size: int) -> Array:
        """Numbers of each draw, for each of its particles; the last draw's fill what is left."""
        last = (at.draws - 1) * at.draw_stride + (count - 1) * at.component_stride
        flat = self._view(at.given, 1, last + 1, np.float64)[0]
        of_draws = np.lib.stride_tricks.as_strided(
            flat, (count, at.draws), (8 * at.component_stride, 8 * at.draw_stride)
        )
        spread, used = np.empty((count, size)), at.draws * at.width
        spread[:, :used] = np.repeat(of_draws, at.width, axis=1)
        spread[:, used:] = of_draws[:, -1:]
        return spread

    def _view(self, address: int, rows: int, stride: int, kind: Any) -> NDArray[Any]:
        """Memory as an array (rows, stride)."""
        key = (address, rows, stride, kind)
        view = self._views.get(key)
        if view is None:
            if len(self._views) >= _MOST_VIEWS:
                self._views.clear()
            number = ctypes.c_float if kind is np.float32 else ctypes.c_double
            memory = (number * (rows * stride)).from_address(address)
            view = self._views[key] = np.frombuffer(memoryview(memory), kind).reshape(rows, stride)
        return view


def raise_callback_error() -> None:
    """Raise the error of a function that was called back in this thread, if there was one."""
    error, _failed.error = getattr(_failed, "error", None), None
    if error is not None:
        raise error
