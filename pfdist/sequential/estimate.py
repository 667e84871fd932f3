"""The estimate of an instant: moments, quantiles and the surprise of a measurement."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import ArgumentError, shown
from pfdist.sequential.beliefs import Belief

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """A filter's belief of z at an instant.

    Parameters
    ----------
    t : int
    measured : bool
        Whether the filter has the measurement at t.
    mean, standard_deviation : array of float64, (q,)
        For an angle the mean direction in -pi..pi, and sqrt(-2 log R), where R is the length of the
        mean of the particles' unit vectors. For a narrow distribution, this is the usual standard
        deviation.
    effective_sample_size : float or None
        Number of particles of equal weight that are worth as much as the weighted particles; None
        for the engine "kalman", which has no particles.
    surprise : float or None
        The probability of a measurement at least as far out as that at t, if the model is right;
        None if t was not measured. See `pfdist.sequential.beliefs.surprise_of_particles`.
    """

    t: int
    measured: bool
    mean: Array
    standard_deviation: Array
    effective_sample_size: float | None
    surprise: float | None
    _belief: Belief = field(repr=False)

    def quantiles(self, levels: float | Sequence[float]) -> Array:
        """Quantiles of each component of z, (levels, q).

        Parameters
        ----------
        levels : float or sequence of float
            In 0..1, without the ends. Quantiles of an angle are at most half a turn from the mean.
        """
        try:
            wanted = np.atleast_1d(np.array(levels, np.float64))
        except (TypeError, ValueError):
            wanted = np.array([np.nan])
        if wanted.ndim != 1 or not ((wanted > 0) & (wanted < 1)).all():
            raise ArgumentError(f"levels must lie between 0 and 1, got {shown(levels)}")
        return self._belief.quantiles(wanted)


def estimate_of(
    t: int,
    mean: Array,
    variance: Array,
    is_angle: Sequence[bool],
    belief: Belief,
    surprise: float | None = None,
) -> Estimate:
    """The estimate at t, by its moments; t was measured if there is a surprise."""
    with np.errstate(all="ignore"):  # 1 - variance is below 0 where z is no angle
        squares = np.where(is_angle, -2 * np.log1p(-variance), variance)
    return Estimate(
        t,
        surprise is not None,
        mean,
        np.sqrt(squares),
        belief.effective_sample_size(),
        surprise,
        belief,
    )
