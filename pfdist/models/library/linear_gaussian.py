"""Linear-Gaussian models of any dimension from matrices, and an oscillator with varying noise.

A sensor measures the position of the oscillator, with noise that varies with time. A measurement is
most informative when its noise is small and it predicts the position for long.

References
----------
Anderson, Moore, "Optimal filtering", 1979, chapter 2.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import ModelError
from pfdist.models.base import StateSpaceModel

Matrix = Sequence[Sequence[float]] | Callable[[int], Any]
Formula = Callable[..., Any]
Array = NDArray[np.float64]


def linear_gaussian(
    name: str,
    *,
    initial_noise: Matrix,
    transition: Matrix,
    process_noise: Matrix,
    measurement: Matrix,
    measurement_noise: Matrix,
    quantity_of_interest: Matrix,
) -> StateSpaceModel:
    """The model x(t+1) = A x(t) + B w(t), y(t) = C x(t) + D v(t), z = H x.

    w and v are standard normal. A matrix is a sequence of rows, or a function of t that gives a
    tuple of tuples. Such a function may use whatever a formula may use.

    Parameters
    ----------
    name : str
    initial_noise : matrix, (n, k0)
        x(0) is this matrix times a standard normal vector.
    transition : matrix, (n, n)
        A.
    process_noise : matrix, (n, k)
        B.
    measurement : matrix, (m, n)
        C.
    measurement_noise : matrix, (m, m)
        D. It must be diagonal, because each measurement has independent noise. A function of t is
        checked at t = 0.
    quantity_of_interest : matrix, (q, n)
        H.

    Returns
    -------
    StateSpaceModel
        With ``linear_gaussian=True``, so that the Kalman filter can compute its expected MSE.

    Raises
    ------
    ModelError
        The matrix of the measurement noise is not diagonal.

    Examples
    --------
    >>> walk = linear_gaussian("walk", initial_noise=[[5]], transition=[[1]], process_noise=[[1]],
    ...     measurement=[[1]], measurement_noise=lambda t: ((1 + t % 2,),),
    ...     quantity_of_interest=[[1]])
    >>> walk.measurement((3.0,), 1, (0.5,), walk.p)
    (4.0,)
    """
    start, want, look = map(_times, (initial_noise, quantity_of_interest, measurement))
    move, see = _sum(transition, process_noise), _sum(measurement, measurement_noise)
    noise = _function(measurement_noise)
    _check_diagonal(name, noise(0))
    return StateSpaceModel(
        name=name,
        initial=lambda w, p: start(w, 0),
        transition=lambda x, t, w, p: move(x, w, t),
        measurement=lambda x, t, v, p: see(x, v, t),
        log_likelihood=_log_likelihood(look, noise, _shape(measurement)[0]),
        quantity_of_interest=lambda x, t, p: want(x, t),
        initial_noise=_normal(initial_noise),
        process_noise=_normal(process_noise),
        measurement_noise=_normal(measurement_noise),
        linear_gaussian=True,
    )


def _log_likelihood(look: Formula, noise: Formula, measurements: int) -> Formula:
    """The log-likelihood of independent normal measurements, up to a constant."""

    def log_likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        expected, sd, total = look(x, t), noise(t), 0.0
        for i in range(measurements):
            total = total - 0.5 * ((y[i] - expected[i]) / sd[i][i]) ** 2
        return total

    return log_likelihood


def _normal(matrix: Matrix) -> tuple[str, ...]:
    """The kinds of noise that a matrix is multiplied with."""
    return ("normal",) * _shape(matrix)[1]


def _check_diagonal(name: str, matrix: Sequence[Sequence[float]]) -> None:
    for i, row in enumerate(matrix):
        for j, entry in enumerate(row):
            if i != j and entry != 0:
                raise ModelError(
                    f"model {name}: the matrix of the measurement noise must be diagonal, got "
                    f"{entry} in row {i}, column {j} (both from 0)"
                )


def _function(matrix: Matrix) -> Formula:
    if callable(matrix):
        return matrix
    rows = tuple(tuple(float(entry) for entry in row) for row in matrix)
    return lambda t: rows


def _shape(matrix: Matrix) -> tuple[int, int]:
    rows = _function(matrix)(0)
    return len(rows), len(rows[0])


def _times(matrix: Matrix) -> Formula:
    """The function ``(x, t) -> matrix(t) x``."""
    return _stacked([_row(matrix, i) for i in range(_shape(matrix)[0])])


def _sum(matrix: Matrix, noise: Matrix) -> Formula:
    """The function ``(x, w, t) -> matrix(t) x + noise(t) w``."""

    def component(i: int) -> Formula:
        of_x, of_w = _row(matrix, i), _row(noise, i)
        return lambda x, w, t: of_x(x, t) + of_w(w, t)

    return _stacked([component(i) for i in range(_shape(matrix)[0])])


def _row(matrix: Matrix, i: int) -> Formula:
    """The function ``(x, t) -> component i of matrix(t) x``."""
    rows, columns = _function(matrix), _shape(matrix)[1]
    if not callable(matrix):
        entries = [(j, entry) for j, entry in enumerate(rows(0)[i]) if entry != 0]
        return _dot(entries or [(0, 0.0)])

    def component(x: Any, t: Any) -> Any:
        row, total = rows(t)[i], 0.0
        for j in range(columns):
            total = total + row[j] * x[j]
        return total

    return component


def _dot(entries: list[tuple[int, float]]) -> Formula:
    """The function ``(x, t) -> sum of entry * x[j]``; compiled code would copy a whole matrix."""
    *others, (j, entry) = entries
    if not others:
        return lambda x, t: entry * x[j]
    head = _dot(others)
    return lambda x, t: head(x, t) + entry * x[j]


def _stacked(functions: list[Formula]) -> Formula:
    """A function whose value is the tuple of the values of several functions.

    Numba cannot make a tuple in a loop, so the tuples are joined recursively.
    """
    *others, last = functions
    if not others:
        return lambda *arguments: (last(*arguments),)
    head = _stacked(others)
    return lambda *arguments: head(*arguments) + (last(*arguments),)  # noqa: RUF005


DAMPING, STEP = 0.02, 0.35  # a period of 18 steps; a tenth of the amplitude is lost in five steps

model = linear_gaussian(
    "linear_gaussian",
    initial_noise=((2.0, 0.0), (0.0, 2.0)),
    transition=(
        (np.exp(-DAMPING) * np.cos(STEP), np.exp(-DAMPING) * np.sin(STEP)),
        (-np.exp(-DAMPING) * np.sin(STEP), np.exp(-DAMPING) * np.cos(STEP)),
    ),
    process_noise=((0.0,), (0.4,)),
    measurement=((1.0, 0.0),),
    measurement_noise=lambda t: ((1.0 + 0.8 * np.sin(0.2 * t),),),
    quantity_of_interest=((1.0, 0.0),),
)
