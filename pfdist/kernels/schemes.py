"""The resampling schemes, and when they resample; data only, without an import of Numba."""

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from pfdist.errors import shown


@dataclass(frozen=True)
class Scheme:
    """A resampling scheme."""

    name: str  # as job files name it
    description: str  # in one line, for help and manual
    holds_truth: bool = False  # whether particle 0 follows the true states of the draw


MULTINOMIAL = Scheme("multinomial", "Independent ancestors, in proportion to the weights.")
STRATIFIED = Scheme("stratified", "One point in each of as many strata as there are particles.")
SYSTEMATIC = Scheme("systematic", "Equidistant points with one common random shift.")
CONDITIONAL = Scheme(
    "conditional", "Multinomial, with the true state among the particles.", holds_truth=True
)
"""The scheme of the lower bound. No job can name it, because a real filter does not have the truth.

Particle 0 has the true state x(t) of the draw at each t, and remains its own ancestor. The other
particles choose independent ancestors among all particles. Given y and the cloud as a set, the
truth is then distributed as the weights. So the expected squared error of the weighted mean is the
expected weighted variance, and this variance is at most the error of the exact filter, for any
number of particles.

Source: Andrieu, Doucet, Holenstein, "Particle Markov chain Monte Carlo methods", Journal of the
Royal Statistical Society B 72, 2010 (conditional sequential Monte Carlo).
"""

SCHEMES = {scheme.name: scheme for scheme in (MULTINOMIAL, STRATIFIED, SYSTEMATIC)}
"""The schemes that a job can name."""
if TYPE_CHECKING:
    Resampling = str
else:
    Resampling = Literal[tuple(SCHEMES)]

ALL_SCHEMES = SCHEMES | {CONDITIONAL.name: CONDITIONAL}

ALWAYS: Final = math.inf
"""The threshold of a filter that resamples at each measurement."""
_BELOW = re.compile(r"below (\d*\.?\d+)")


def threshold_of(resample: str) -> float:
    """The threshold in a text: "always", or "below 0.5" for 0.5.

    A filter resamples if its effective sample size is below this share of its particles. Raises
    `ValueError` for any other text.
    """
    if resample == "always":
        return ALWAYS
    found = _BELOW.fullmatch(resample) if isinstance(resample, str) else None
    if found is None or not 0.0 < float(found[1]) <= 1.0:
        raise ValueError(
            "resample must be 'always', or 'below' with a share of the particles above 0 and at "
            f"most 1, as in 'below 0.5', got {shown(resample)}"
        )
    return float(found[1])


def resample_written(threshold: float) -> str:
    """The text whose threshold this is.

    >>> threshold_of(resample_written(0.01)), threshold_of(resample_written(ALWAYS))
    (0.01, inf)
    """
    return "always" if threshold == ALWAYS else f"below {threshold:.20f}"
