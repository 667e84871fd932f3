"""Linear-Gaussian models of any dimension from matrices, and an oscillator with varying noise.

A sensor measures the position of the oscillator, with noise that varies with time. A measurement is
most informative when its noise is small and it predicts the position for long.

References
----------
Anderson, Moore, "Optimal filtering", 1979, chapter 2.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from pfdist.errors import ModelError
from pfdist.models.base import StateSpaceModel
from pfdist.models.symbols import Symbol

Matrix = Sequence[Sequence[float]] | Callable[[int], Any]
Formula = Callable[..., Any]
_ROUNDING = 1e-12  # of a variance that is zero


def linear_gaussian(
    name: str,
    *,
    initial_noise: Matrix,
    transition: Matrix,
    process_noise: Matrix,
    measurement: Matrix,
    measurement_noise: Matrix,
    quantity_of_interest: Matrix,
    initial_mean: Sequence[float] | None = None,
    covariances: bool = False,
) -> StateSpaceModel:
    """The model x(t+1) = A x(t) + B w(t), y(t) = C x(t) + D v(t), z = H x.

    w and v are standard normal, so B B' and D D' are the covariance matrices Q and R. A matrix is a
    sequence of rows, or a function of t that gives a tuple of tuples. Such a function may use
    whatever a formula may use.

    Parameters
    ----------
    name : str
    initial_noise : matrix, (n, k0)
        x(0) is its mean plus this matrix times a standard normal vector.
    transition : matrix, (n, n)
        A.
    process_noise : matrix, (n, k)
        B.
    measurement : matrix, (m, n)
        C.
    measurement_noise : matrix, (m, l)
        D.
    quantity_of_interest : matrix, (q, n)
        H.
    initial_mean : sequence of float, (n,), optional
        The mean of x(0), by default 0.
    covariances : bool
        Whether the three matrices of noise are covariance matrices, (n, n), Q and R, instead of
        factors. A function of t is checked at t = 0.

    Returns
    -------
    StateSpaceModel
        With ``linear_gaussian=True``, so that the Kalman filter can compute its expected MSE.

    Raises
    ------
    ModelError
        A covariance matrix is not symmetric, or has a negative eigenvalue.

    Examples
    --------
    >>> walk = linear_gaussian("walk", initial_noise=[[5]], transition=[[1]], process_noise=[[1]],
    ...     measurement=[[1]], measurement_noise=lambda t: ((1 + t % 2,),),
    ...     quantity_of_interest=[[1]])
    >>> walk.measurement((3.0,), 1, (0.5,), walk.p)
    (4.0,)
    >>> pair = linear_gaussian("pair", initial_noise=[[4]], initial_mean=[10], transition=[[1]],
    ...     process_noise=[[0.1]], measurement=[[1], [1]], measurement_noise=[[1, 0.8], [0.8, 2]],
    ...     quantity_of_interest=[[1]], covariances=True)
    >>> pair.initial((0.5,), pair.p)
    (11.0,)
    """
    if covariances:
        initial_noise, process_noise, measurement_noise = (
            _factor(name, each) for each in (initial_noise, process_noise, measurement_noise)
        )
    start, want, look = map(_times, (initial_noise, quantity_of_interest, measurement))
    move, see = _sum(transition, process_noise), _sum(measurement, measurement_noise)
    mean = initial_mean
    return StateSpaceModel(
        name=name,
        initial=lambda w, p: start(w, 0) if mean is None else _added(map(float, mean), start(w, 0)),
        transition=lambda x, t, w, p: move(x, w, t),
        measurement=lambda x, t, v, p: see(x, v, t),
        log_likelihood=_log_likelihood(look, _function(measurement_noise)),
        quantity_of_interest=lambda x, t, p: want(x, t),
        initial_noise=_normal(initial_noise),
        process_noise=_normal(process_noise),
        measurement_noise=_normal(measurement_noise),
        linear_gaussian=True,
    )


def _log_likelihood(look: Formula, noise: Formula) -> Formula:
    """The log-likelihood of normal measurements, up to a constant."""

    def log_likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        scaled, total = list[Any](), 0.0
        for value, expected, row in zip(y, look(x, t), _lower(noise(t)), strict=True):
            rest = value - expected
            for entry, known in zip(row, scaled, strict=False):
                rest = rest if _is_zero(entry) else rest - entry * known
            scaled.append(rest / row[len(scaled)])
            total = total - 0.5 * scaled[-1] ** 2
        return total

    return log_likelihood


def _lower(rows: Sequence[Sequence[Any]]) -> Sequence[Sequence[Any]]:
    """The factor itself if it is lower triangular; otherwise one that is, of the same covariance.

    Symbols may stand in a matrix that varies with t.
    """
    if len(rows) == len(rows[0]) and all(
        _is_zero(entry) for i, row in enumerate(rows) for entry in row[i + 1 :]
    ):
        return rows
    return _cholesky([[_dot(a, b) for b in rows] for a in rows])


def _cholesky(rows: Sequence[Sequence[Any]]) -> tuple[tuple[Any, ...], ...]:
    """The lower triangular factor of a covariance matrix, which may be singular."""
    factor = list[tuple[Any, ...]]()
    for i, row in enumerate(rows):
        found = list[Any]()
        for j, other in enumerate([*factor, found]):
            rest = row[j] - _dot(found, other[:j]) if j else row[j]
            if j == i:
                found.append(np.sqrt(np.where(rest > _ROUNDING * row[i], rest, 0.0)))
            else:
                is_free = other[j] > 0.0
                found.append(np.where(is_free, rest / np.where(is_free, other[j], 1.0), 0.0))
        factor.append((*found, *(0.0,) * (len(rows) - 1 - i)))
    return tuple(factor)


def _factor(name: str, covariance: Matrix) -> Matrix:
    """A factor of a covariance matrix."""
    rows = _function(covariance)
    factor, given = np.array(_cholesky(rows(0))), np.array(rows(0))
    if given.shape != factor.shape or not np.allclose(factor @ factor.T, given):
        raise ModelError(
            f"model {name}: a covariance matrix must be symmetric, without negative eigenvalues, "
            f"got {given.tolist()}"
        )
    return (lambda t: _cholesky(rows(t))) if callable(covariance) else factor.tolist()


def _is_zero(entry: Any) -> bool:
    return not isinstance(entry, Symbol) and entry == 0.0


def _normal(matrix: Matrix) -> tuple[str, ...]:
    """The kinds of noise that a matrix is multiplied with."""
    return ("normal",) * len(_function(matrix)(0)[0])


def _function(matrix: Matrix) -> Formula:
    if callable(matrix):
        return matrix
    rows = tuple(tuple(float(entry) for entry in row) for row in matrix)
    return lambda t: rows


def _times(matrix: Matrix) -> Formula:
    """The function ``(x, t) -> matrix(t) x``."""
    rows = _function(matrix)
    if callable(matrix):
        return lambda x, t: tuple(_dot(row, x) for row in rows(t))
    kept = [[j for j, entry in enumerate(row) if entry != 0.0] or [0] for row in rows(0)]
    return lambda x, t: tuple(
        _dot([row[j] for j in columns], [x[j] for j in columns])
        for row, columns in zip(rows(t), kept, strict=True)
    )


def _sum(matrix: Matrix, noise: Matrix) -> Formula:
    """The function ``(x, w, t) -> matrix(t) x + noise(t) w``."""
    of_x, of_w = _times(matrix), _times(noise)
    return lambda x, w, t: _added(of_x(x, t), of_w(w, t))


def _added(a: Iterable[Any], b: Iterable[Any]) -> tuple[Any, ...]:
    return tuple(map(add, a, b))


def _dot(row: Sequence[Any], x: Sequence[Any]) -> Any:
    return reduce(add, (entry * component for entry, component in zip(row, x, strict=True)))


DAMPING, STEP = 0.02, 0.35  # a period of 18 steps; a tenth of the amplitude is lost in five steps

oscillator = linear_gaussian(
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
model = replace(
    oscillator,
    x_names=("position", "velocity"),
    y_names=("measured position",),
    z_names=("position",),
)
