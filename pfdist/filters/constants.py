"""Components of x that do not move: unknown constants, which resampling alone only copies."""

from typing import SupportsIndex

import numpy as np
from numpy.typing import NDArray

from pfdist.common.streams import stream_of
from pfdist.filters.draws import noise_of
from pfdist.filters.proposals import MOST_INSTANTS
from pfdist.kernels.variates import FILTER_INITIAL, FILTER_PROCESS
from pfdist.models import StateSpaceModel
from pfdist.models.twin import twin_of

Array = NDArray[np.float64]
_STATES = 16  # that are tried


def different_values(x: Array, constants: tuple[int, ...]) -> int:
    """The least number of different values of some components, of particles (n, P)."""
    return min((np.unique(x[c]).size for c in constants), default=x.shape[1])


def constants_of(model: StateSpaceModel, instants: range) -> tuple[int, ...]:
    """The components of x that have a density at first, and that no step changes.

    It is found by trying: a step leaves them bit for bit as they were, at each instant, for random
    states and noise.
    """
    lengths = (len(value) for value in model.parameters.values() if isinstance(value, tuple))
    tried = instants[: min(MOST_INSTANTS + 1, *lengths, len(instants))]
    found: tuple[int, ...] = model.kept(("constants", tried), lambda: _found(model, tried))
    return found


def _found(model: StateSpaceModel, instants: range) -> tuple[int, ...]:
    stream, draws, twin = stream_of("proposal", 0, "constants"), range(1), twin_of(model, instants)

    def noise(kinds: tuple[str, ...], t: int, role: SupportsIndex) -> tuple[Array, ...]:
        return tuple(each[0] for each in noise_of(kinds, _STATES, stream, draws, t, role))

    with np.errstate(all="ignore"):
        x = twin.initial(noise(model.initial_noise, 0, FILTER_INITIAL), model.p)
        x = tuple(np.broadcast_to(np.float64(each), _STATES) for each in x)
        left = [c for c, each in enumerate(x) if np.unique(each).size == _STATES]
        for t in instants[:-1]:
            if not left:
                break
            moved = twin.transition(x, t, noise(model.process_noise, t, FILTER_PROCESS), model.p)
            moved = tuple(np.broadcast_to(np.float64(each), _STATES) for each in moved)
            left = [c for c in left if np.array_equal(moved[c], x[c])]
            x = moved
    return tuple(left)
