"""Where process noise enters a transition additively: so a path can stay while a constant moves."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import TraceError
from pfdist.models import StateSpaceModel
from pfdist.models.derivatives import pulled
from pfdist.models.program import groups_of
from pfdist.models.symbols import RefusedError
from pfdist.models.tracing import Formula, trace
from pfdist.models.twin import twin_of

_TRIED = 16  # states, and instants
_LEAST = 1e-9  # of a matrix that has an inverse: its smallest singular value over the largest


@dataclass(frozen=True)
class Gains:
    """Components of x that process noise drives alone, and what noise a change of them takes."""

    driven: NDArray[np.int64]  # (c,)
    inverse: NDArray[np.float64]  # (T, c, c): the change of noise by that of these components


def additive_gains(model: StateSpaceModel, instants: range) -> Gains | None:
    """The gains of a model; None if its noise is not normal and additive, or drives too little.

    Noise w is additive if the derivatives of x(t + 1) by w depend neither on x nor on w. With c
    components of w, c components of x must determine w.
    """
    kinds, steps = model.process_noise, instants[:-1]
    if not kinds or not steps or {*kinds} != {"normal"}:
        return None
    (states, *_), count = model.components, len(kinds)
    arguments = {"x": states, "t": 0, "w": count, "p": 0}

    def slopes(x: Any, t: Any, w: Any, p: Any) -> tuple[Any, ...]:
        x[0].recording.unrolls = True
        values = model.transition(x, t, w, p)
        return tuple(slope for value in values for slope in pulled([(value, 1.0)], w))

    formula = Formula(slopes, "slopes", arguments, model.parameters, model.name, states * count)
    try:
        found = trace(formula, steps)
    except (RefusedError, TraceError):
        return None
    if any(groups_of(each, range(states * count)) for each in found.programs):
        return None
    none = {"x": [0.0] * states, "w": [0.0] * count}
    values = [np.ravel(found.values(none, t, model.parameters)) for t in steps]
    matrices = np.array(values, np.float64).reshape(len(steps), states, count)
    if not _is_additive(model, matrices, steps):
        return None
    driven = _driven(matrices[0])
    square = matrices[:, driven]
    sizes = np.linalg.svd(square, compute_uv=False)
    if len(driven) < count or not np.all(sizes[:, -1] > _LEAST * sizes[:, 0]):
        return None
    inverse = np.asarray(np.linalg.inv(square), np.float64)
    return Gains(np.array(driven, np.int64), inverse)


def _is_additive(model: StateSpaceModel, matrices: NDArray[np.float64], steps: range) -> bool:
    """Whether a change of noise changes x by its gains, for random states and noise.

    A derivative does not show where a function jumps.
    """
    rng, (states, count) = np.random.default_rng(0), matrices.shape[1:]
    x, w, change = (rng.normal(size=(n, _TRIED)) for n in (states, count, count))
    twin = twin_of(model, range(steps[0], steps[-1] + 2))
    for t, matrix in list(zip(steps, matrices, strict=True))[:: max(1, len(steps) // _TRIED)]:
        with np.errstate(all="ignore"):
            first, second = (
                np.stack([np.broadcast_to(each, _TRIED) for each in
                          twin.transition(tuple(x), t, tuple(noise), model.p)])
                for noise in (w, w + change)
            )  # fmt: skip
        known = np.isfinite(first) & np.isfinite(second)
        moved = np.where(known, second - first, 0.0)
        if not np.allclose(moved, np.where(known, matrix @ change, 0.0), rtol=1e-6, atol=1e-9):
            return False
    return True


def _driven(matrix: NDArray[np.float64]) -> list[int]:
    """Rows of a matrix that make it invertible: by turns the one farthest from those before."""
    rest, chosen = matrix.copy(), list[int]()
    for _ in range(matrix.shape[1]):
        lengths = np.linalg.norm(rest, axis=1)
        best = int(lengths.argmax())
        if not lengths[best] > 0.0:
            break
        chosen.append(best)
        unit = rest[best] / lengths[best]
        rest -= np.outer(rest @ unit, unit)
    return chosen
