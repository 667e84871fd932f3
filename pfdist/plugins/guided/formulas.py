"""The proposal that is derived from a model: for all noise since the last measurement.

From a particle's state at the last measurement, the model is run to the instant of the measurement
y, first with normal noise 0. There, a linear-Gaussian measurement replaces the real one: k rows of
numbers ``B x + e``, with standard normal e, whose values lie ``rho`` above those of the particle.
With H, the derivatives of these rows by all normal noises w on the way, the distribution of w given
y is normal, with covariance ``S = inverse(I + H'H)`` and mean ``S H' rho``. The next run has this
mean w1 as its noise, and ``rho + H w1`` instead of rho.

Nothing of the size of w is factorised. For standard normal w0 and e, and ``K = I + H H'``,
``w0 + H' inverse(K) (rho - H w0 - e)`` has this distribution, and the logarithm of its density
follows from numbers of the size of k (Woodbury's identity, and the determinant lemma).

Sources: Doucet, Godsill, Andrieu, "On sequential Monte Carlo sampling methods for Bayesian
filtering", 2000, section II.D (linearised proposals). Hoffman, Ribak, "Constrained realizations of
Gaussian fields", 1991 (draws by a correction).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any, Final

import numpy as np

from pfdist.errors import ModelError
from pfdist.models import StateSpaceModel
from pfdist.models.derivatives import product, pulled
from pfdist.models.program import Array, evaluate_program
from pfdist.models.symbols import Recording, Symbol
from pfdist.models.twin import twin_of

SHARE: Final = 0.9
"""Share of the particles that the derived proposal draws; the model draws the others.

So p(w) / q(w) is at most 10.
"""
_MOST_ROWS = 8  # of the linear measurement
_FARTHEST = 6.0  # standard deviations of the prior that the mean may move, and the root of m more


@dataclass(frozen=True)
class Guide:
    """The formulas of the proposal for one sensor."""

    model: StateSpaceModel  # the system with this sensor alone
    angles: tuple[bool, ...]  # whether each component of y is an angle
    # The components of x on which the log-likelihood depends, if `seen` uses it; none: `seen` uses
    # the formula `measurement`.
    components: tuple[int, ...] = ()

    @property
    def rows(self) -> int:
        """The number k of rows of the linear measurement."""
        return len(self.components or self.angles)

    @property
    def sums(self) -> int:
        """The number of sums: the lower triangle of ``H H'``, row by row, ``H w0`` and ``H w1``."""
        return self.rows * (self.rows + 5) // 2

    def mean(self, x: Any, t: Any, w: Any, v: Any, p: Any) -> tuple[Any, ...]:
        """x(t + 1) with normal noise from v."""
        model = self.model
        return tuple(model.transition(x, t, _mixed(model.process_noise, w, v), p))

    def mean_initial(self, w: Any, v: Any, p: Any) -> tuple[Any, ...]:
        """x(0) with normal noise from v."""
        return tuple(self.model.initial(_mixed(self.model.initial_noise, w, v), p))

    def swept(self, x: Any, z: Any, estimate: Any, t: Any, w: Any, v: Any, p: Any) -> Any:
        """A step back: from derivatives z of the rows by x(t + 1) to those by x(t).

        The sums `estimate` grow by the normal noises of this step. Last come the derivatives by
        these, row by row.
        """
        moved, kinds = partial(self.model.transition, x, t), self.model.process_noise
        return self._swept(moved, kinds, x, z, estimate, w, v, p)

    def swept_initial(self, x: Any, z: Any, estimate: Any, w: Any, v: Any, p: Any) -> Any:
        """The same from x(0) to the initial noise."""
        begun, kinds = self.model.initial, self.model.initial_noise
        return self._swept(begun, kinds, x, z, estimate, w, v, p)

    def _swept(
        self, formula: Any, kinds: Any, x: Any, z: Any, sums: Any, w: Any, v: Any, p: Any
    ) -> tuple[Any, ...]:
        _unroll(x)
        values = formula(_mixed(kinds, w, v), p)
        drawn, centre = _normals(kinds, w), _normals(kinds, v)
        to, k, n = [*x, *centre], self.rows, len(x)
        pulls = [pulled([*zip(values, z[j * n : (j + 1) * n], strict=True)], to) for j in range(k)]
        slopes = [each[n:] for each in pulls]
        pairs = [_dot(slopes[i], slopes[j]) for i in range(k) for j in range(i + 1)]
        moved = [_dot(each, noise) for noise in (drawn, centre) for each in slopes]
        grown = [total + new for total, new in zip(sums, pairs + moved, strict=True)]
        return (*(d for each in pulls for d in each[:n]), *grown, *chain(*slopes))

    def seen(self, x: Any, y: Any, t: Any, p: Any) -> tuple[Any, ...]:
        """B, row by row, sums that are 0, and rho."""
        _unroll(x)
        rows, rho = (self._likely if self.components else self._measured)(x, y, t, p)
        return (*chain(*rows), *[0.0] * self.sums, *rho)

    def _measured(self, x: Any, y: Any, t: Any, p: Any) -> tuple[list[Any], list[Any]]:
        """From the derivatives of `measurement`, at noise 0."""
        predicted, by_x, by_v = _derivatives_of_measurement(self.model, x, t, p)
        rho = [
            _within_half_turn(value - mean) if is_angle else value - mean
            for value, mean, is_angle in zip(y, predicted, self.angles, strict=True)
        ]
        m = range(len(rho))
        covariance = [[_dot(by_v[i], by_v[j]) for j in m] for i in m]
        if self.model.missing_components or self.model.works:
            missing = [~np.isfinite(value) if self.model.works else np.isnan(value) for value in y]
            rho = [np.where(gone, 0.0, value) for gone, value in zip(missing, rho, strict=True)]
            by_x = [
                [np.where(gone, 0.0, each) for each in row]
                for gone, row in zip(missing, by_x, strict=True)
            ]
            covariance = [
                [np.where(missing[i] | missing[j], float(i == j), covariance[i][j]) for j in m]
                for i in m
            ]
        root = _cholesky(covariance)
        columns = [_solved(root, [row[c] for row in by_x]) for c in range(len(x))]
        return [[column[j] for column in columns] for j in m], _solved(root, rho)

    def _likely(self, x: Any, y: Any, t: Any, p: Any) -> tuple[list[Any], list[Any]]:
        """From the first two derivatives of the log-likelihood by x.

        With ``-A = U D U'``, the rows are those of ``sqrt(D) U'``. Those of a D that is not
        positive are left out, that is, 0.
        """
        gradient, second = _derivatives_of_likelihood(self.model, x, y, t, p)
        some = self.components
        unit, pivots = _pivots([[second[i][j] for j in some] for i in some])
        solved = _solved(unit, [gradient[i] for i in some])
        rows, rho = [], []
        for j, pivot in enumerate(pivots):
            size = np.sqrt(np.maximum(pivot, 0.0))
            row: list[Any] = [0.0] * len(x)
            for i, component in enumerate(some):
                row[component] = product(size, unit[i][j])
            rows.append(row)
            rho.append(np.where(pivot > 0.0, solved[j] / size, 0.0))
        return rows, rho

    def aimed(self, x: Any, p: Any) -> tuple[Any, ...]:
        """The coefficients of the mean, from rho and the sums."""
        return tuple(self._mean(x)[0])

    def drawn(self, x: Any, u: Any, p: Any) -> tuple[Any, ...]:
        """The coefficients c of ``w0 + H' c``, and log p(w) / q(w).

        x has rho and the sums; u has e, and a uniform number that chooses the proposal.
        """
        k, noise, is_own = self.rows, u[:-1], u[-1] >= SHARE
        mean, size, gram, root, usual = self._mean(x)
        moved = x[-2 * k : -k]
        half = sum(np.log(root[j][j]) for j in range(k))  # of log det K
        back = _solved_twice(root, [a + b for a, b in zip(moved, noise, strict=True)])
        steps = [np.where(is_own | ~usual, 0.0, a - b) for a, b in zip(mean, back, strict=True)]
        deviation = [  # H d, with the deviation d of w from the mean
            np.where(is_own, moved[i] - _dot(gram[i], mean), back[i] - noise[i]) for i in range(k)
        ]
        ratio = 0.5 * _dot(deviation, deviation) - _dot(mean, deviation) - 0.5 * size**2 - half
        mixed = -np.logaddexp(math.log(SHARE) - ratio, math.log(1.0 - SHARE))
        return (*steps, np.where(usual, mixed, 0.0))

    def _mean(self, x: Any) -> tuple[Any, ...]:
        """Coefficients and norm of the mean, ``H H'``, the root of K, and whether all is finite."""
        k = self.rows
        triangle, centred = x[k : -2 * k], x[-k:]
        rho = [a + b for a, b in zip(x[:k], centred, strict=True)]
        gram = [[triangle[_in_triangle(i, j)] for j in range(k)] for i in range(k)]
        root = _cholesky([[gram[i][j] + float(i == j) for j in range(k)] for i in range(k)])
        pull = _solved_twice(root, rho)
        size = np.sqrt(_dot(pull, [_dot(row, pull) for row in gram]))
        farthest = _FARTHEST + math.sqrt(len(self.angles))
        shorter = np.where(size > farthest, farthest / size, 1.0)
        usual = np.isfinite(size + sum(root[j][j] for j in range(k)))
        mean = [np.where(usual, shorter * each, 0.0) for each in pull]
        return mean, shorter * size, gram, root, usual


def guide_of(model: StateSpaceModel, instants: range) -> Guide | None:
    """The guide of a system with one sensor, from its formulas at some simulated states.

    It uses the first, the middle and the last instant; None if no measurement depends on x there.

    Raises
    ------
    ModelError
        The model has no normal noise, or its measurements depend on too many components of x.
    """
    if "normal" not in (*model.initial_noise, *model.process_noise):
        raise ModelError(f"model {model.name} has no normal noise for a proposal to move")
    angles, depends = [True] * model.components[1], np.zeros(model.components[0], np.bool_)
    sees, has_density = False, True
    for t in sorted({instants[0], instants[len(instants) // 2], instants[-1]}):
        x, y = _simulated(model, t)
        slopes, noises, gradient = _derivatives_at(model, x, y, t)
        angles = [a and b for a, b in zip(angles, _angles(model, x, y, t), strict=True)]
        depends |= (np.nan_to_num(gradient) != 0.0).any(axis=1)
        sees |= bool((slopes != 0.0).any())
        has_density &= _has_density(noises)
    guide = Guide(model, tuple(angles))
    if not (sees and has_density):
        guide = replace(guide, components=tuple(np.flatnonzero(depends).tolist()))
        if not guide.components:
            return None
    if guide.rows > _MOST_ROWS:
        kind = "x" if guide.components else "y"
        raise ModelError(
            f"a measurement of {model.name} must have at most {_MOST_ROWS} components of {kind}, "
            f"got {guide.rows}"
        )
    return guide


_SIMULATED = 64  # states


def _simulated(model: StateSpaceModel, t: int) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """States at t = 0, as if they were those at t, and their measurements."""
    rng, twin = np.random.default_rng(0), twin_of(model, range(t, t + 1))

    def noise(kinds: Sequence[str]) -> tuple[Array, ...]:
        return tuple(
            rng.normal(size=_SIMULATED)
            if kind == "normal"
            else rng.uniform(size=_SIMULATED) - 0.5 * (kind == "centred")
            for kind in kinds
        )

    with np.errstate(all="ignore"):
        x = twin.initial(noise(model.initial_noise), model.p)
        y = twin.measurement(x, t, noise(model.measurement_noise), model.p)

    def arrays(values: Sequence[Any]) -> tuple[Array, ...]:
        return tuple(np.broadcast_to(np.float64(each), _SIMULATED) for each in values)

    return arrays(x), arrays(y)


def _derivatives_at(
    model: StateSpaceModel, x: Sequence[Array], y: Sequence[Array], t: int
) -> tuple[Array, Array, Array]:
    """Derivatives for simulated states, whose number is the last axis.

    Those of y by x, (m, n, states), and by its normal noises; and of the log-likelihood by x.
    """
    recording, m, n = Recording(), len(y), len(x)
    states, values = (
        tuple(Symbol(recording, recording.add(group, (), i)) for i in range(count))
        for group, count in (("x", n), ("y", m))
    )
    _, by_x, by_v = _derivatives_of_measurement(model, states, t, model.p)
    gradient, _ = _derivatives_of_likelihood(model, states, values, t, model.p)
    program = recording.closed([*chain(*by_x, *by_v), *gradient])
    found = evaluate_program(program, {"x": x, "y": y}, t, model.parameters)
    rows = np.array([np.broadcast_to(each, _SIMULATED) for each in found])
    slopes, noises = rows[: m * n].reshape(m, n, -1), rows[m * n : -n].reshape(m, -1, _SIMULATED)
    return slopes, noises, rows[-n:]


def _angles(
    model: StateSpaceModel, x: Sequence[Array], y: Sequence[Array], t: int
) -> tuple[bool, ...]:
    """Whether each component of y is an angle: a full turn does not change the likelihood."""
    twin = twin_of(model, range(t, t + 1))

    def is_same(component: int, change: float) -> bool:
        moved = [value + change * (c == component) for c, value in enumerate(y)]
        with np.errstate(all="ignore"):
            now, then = (twin.log_likelihood(tuple(each), x, t, model.p) for each in (y, moved))
        return bool(np.isclose(now, then, rtol=1e-6).all())

    return tuple(is_same(c, 2.0 * math.pi) and not is_same(c, 1.0) for c in range(len(y)))


def _has_density(slopes: Array) -> bool:
    """Whether measurements (m, noises, states) with these derivatives have a density."""
    finite = np.isfinite(slopes).all(axis=(0, 1))
    if not finite.any() or slopes.shape[1] < slopes.shape[0]:
        return False
    matrices = slopes[:, :, finite].transpose(2, 0, 1)
    return bool((np.linalg.matrix_rank(matrices) == slopes.shape[0]).all())


def _derivatives_of_measurement(
    model: StateSpaceModel, x: Any, t: Any, p: Any
) -> tuple[Any, list[Any], list[Any]]:
    """The measurement at noise 0, and derivatives of its components by x and by normal noises."""
    kinds, recording = model.measurement_noise, x[0].recording
    middle = [
        Symbol(recording, recording.number(0.5 if kind == "uniform" else 0.0)) for kind in kinds
    ]
    values = model.measurement(x, t, tuple(middle), p)
    found = [pulled([(value, 1.0)], [*x, *_normals(kinds, middle)]) for value in values]
    return values, [each[: len(x)] for each in found], [each[len(x) :] for each in found]


def _derivatives_of_likelihood(
    model: StateSpaceModel, x: Any, y: Any, t: Any, p: Any
) -> tuple[list[Any], list[Any]]:
    """The first derivatives of the log-likelihood by x, and the second ones with their sign."""
    gradient = pulled([(model.log_likelihood(y, x, t, p), 1.0)], x)
    return gradient, [pulled([(each, -1.0)], x) for each in gradient]


def _unroll(x: Any) -> None:
    """Let loops be recorded step by step, because these have derivatives."""
    x[0].recording.unrolls = True


def _normals(kinds: Sequence[str], noise: Sequence[Any]) -> list[Any]:
    return [each for kind, each in zip(kinds, noise, strict=True) if kind == "normal"]


def _mixed(kinds: Sequence[str], w: Sequence[Any], v: Sequence[Any]) -> tuple[Any, ...]:
    """Noise with its normal components from v, and the others from w."""
    return tuple(b if kind == "normal" else a for kind, a, b in zip(kinds, w, v, strict=True))


# --- small matrices of symbols and numbers --------------------------------------------------------


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    total: Any = 0.0
    for each in map(product, a, b):
        total = each if isinstance(total, float) and total == 0.0 else total + each
    return total


def _in_triangle(i: int, j: int) -> int:
    """The place of an entry of a symmetric matrix in its lower triangle, row by row."""
    return max(i, j) * (max(i, j) + 1) // 2 + min(i, j)


def _cholesky(matrix: list[list[Any]]) -> list[list[Any]]:
    root: list[list[Any]] = []
    for i, row in enumerate(matrix):
        root.append([])
        for j in range(i):
            rest = row[j] - _dot(root[i], root[j][:j])
            root[i].append(rest / root[j][j])
        root[i].append(np.sqrt(row[i] - _dot(root[i], root[i])))
    return root


def _pivots(matrix: list[list[Any]]) -> tuple[list[list[Any]], list[Any]]:
    """The unit triangle U and the pivots D of ``U D U'``; a D that is not positive counts as 0."""
    unit, pivots = list[list[Any]](), list[Any]()
    for i, row in enumerate(matrix):
        scaled, unit_row = list[Any](), list[Any]()
        for j in range(i):
            scaled.append(row[j] - _dot(scaled, unit[j][:j]))
            pivot = pivots[j]
            unit_row.append(np.where(pivot > 0.0, scaled[j] / pivot, 0.0))
        pivots.append(row[i] - _dot(scaled, unit_row))
        unit.append([*unit_row, 1.0])
    return [row + [0.0] * (len(unit) - len(row)) for row in unit], pivots


def _solved(root: list[list[Any]], b: Sequence[Any]) -> list[Any]:
    x = list[Any]()
    for i, value in enumerate(b):
        rest, diagonal = value - _dot(root[i][:i], x), root[i][i]
        x.append(rest if isinstance(diagonal, float) and diagonal == 1.0 else rest / diagonal)
    return x


def _solved_twice(root: list[list[Any]], b: Sequence[Any]) -> list[Any]:
    """The solution of the system whose matrix has this root."""
    k, x = len(root), _solved(root, b)
    for i in range(k - 1, -1, -1):
        below = range(i + 1, k)
        x[i] = (x[i] - _dot([root[j][i] for j in below], [x[j] for j in below])) / root[i][i]
    return x


def _within_half_turn(angle: Any) -> Any:
    return angle - 2.0 * math.pi * np.rint(angle / (2.0 * math.pi))
