"""Simulate draws: realisations of x(0..T), y(0..T) and z(0..T) (paper, equations 1 to 4)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pfdist.errors import ModelError
from pfdist.kernels.components import formula, formulas_of, reader, writer
from pfdist.kernels.noise import TILE, TRUTH_INITIAL, TRUTH_MEASUREMENT, TRUTH_PROCESS, filler
from pfdist.models import StateSpaceModel


@dataclass(frozen=True)
class Draws:
    """Realisations of a model.

    Parameters
    ----------
    index : range
        Which draws of the stream these are, D of them.
    x : array of float64, (D, T+1, n)
        States.
    y : array of float64, (D, T+1, m)
        Measurements, also of the times at which nobody measures.
    z : array of float64, (D, T+1, q)
        Quantities of interest.
    """

    index: range
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]


def simulate(model: StateSpaceModel, horizon: int, index: range, stream: int) -> Draws:
    """Simulate some draws of a stream.

    Parameters
    ----------
    model : StateSpaceModel
    horizon : int
        T.
    index : range
        Which draws, one after another; a draw is the same whatever others are simulated with it.
    stream : int
        Key of the noise, 64 bits.

    Returns
    -------
    Draws

    Raises
    ------
    ModelError
        A formula cannot be compiled or failed, or gave a value that is not finite.
    """
    if index.step != 1:
        raise ValueError(f"index must be a range with step 1, got {index}")
    shape = (len(index), horizon + 1)
    x, y, z = (np.empty((*shape, count)) for count in model.components)
    with formulas_of(model.name):
        _compiled(model)(np.uint64(stream), index.start, model.p, x, y, z)
    check_finite(model, x, y, z)
    return Draws(index, x, y, z)


def check_finite(model: StateSpaceModel, *values: NDArray[np.float64]) -> None:
    """Raise a `ModelError` that names the first value of x, y or z that is not finite."""
    for name, value in zip("xyz", values, strict=True):
        if not np.isfinite(value).all():
            draw, t, component = np.argwhere(~np.isfinite(value))[0]
            raise ModelError(
                f"model {model.name}: a simulation must stay finite, got "
                f"{name}[{component}] = {value[draw, t, component]} at t = {t}"
            )


def _compiled(model: StateSpaceModel) -> Callable[..., None]:
    return _compile(
        (model.initial, model.transition, model.measurement, model.quantity_of_interest),
        (model.initial_noise, model.process_noise, model.measurement_noise),
        model.components,
    )


@lru_cache(maxsize=32)
def _compile(
    functions: tuple[Callable[..., Any], ...],
    noise: tuple[tuple[str, ...], ...],
    components: tuple[int, int, int],
) -> Callable[..., None]:
    initial, transition, measurement, quantity = map(formula, functions)
    fill_w0, fill_w, fill_v = map(filler, noise)
    read_w0, read_w, read_v = (reader(len(kinds)) for kinds in noise)
    read_x = reader(components[0])
    write_x, write_y, write_z = map(writer, components)
    rows = max(map(len, noise))

    @njit(nogil=True, error_model="numpy")
    def simulate_draws(stream, first, p, x, y, z):  # type: ignore[no-untyped-def]
        noise = np.empty((rows, TILE), np.float32)  # only its first column is used
        horizon = x.shape[1] - 1
        for d in range(x.shape[0]):
            path, measured, wanted = x[d].T, y[d].T, z[d].T
            fill_w0(noise, stream, first + d, 0, TRUTH_INITIAL)
            write_x(path, 0, initial(read_w0(noise, 0), p))
            for t in range(horizon + 1):
                state = read_x(path, t)
                fill_v(noise, stream, first + d, t, TRUTH_MEASUREMENT)
                write_y(measured, t, measurement(state, t, read_v(noise, 0), p))
                write_z(wanted, t, quantity(state, t, p))
                if t < horizon:
                    fill_w(noise, stream, first + d, t, TRUTH_PROCESS)
                    write_x(path, t + 1, transition(state, t, read_w(noise, 0), p))

    return simulate_draws  # type: ignore[no-any-return]
