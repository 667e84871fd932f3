"""Log densities for likelihoods, and draws: noise of any kind from uniform and normal noise.

A model's formulas call these functions. They are formulas themselves: written once with NumPy's
elementwise functions, they work on arrays, and are traced and compiled with the formula that calls
them. So all processors give the same bytes.

`DENSITIES` declares each density once. Tables of the manual, advice and tests follow from it.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pfdist.densities.draws import (
    beta_draw,
    binomial_draw,
    categorical_draw,
    gamma_draw,
    laplace_draw,
    lognormal_draw,
    mixture_draw,
    negative_binomial_draw,
    normal_draw,
    poisson_draw,
    student_t_draw,
    von_mises_draw,
)
from pfdist.densities.log_densities import (
    beta_logpdf,
    binomial_logpmf,
    categorical_logpmf,
    gamma_logpdf,
    laplace_log_tails,
    laplace_logpdf,
    lognormal_log_tails,
    lognormal_logpdf,
    mixture_logpdf,
    negative_binomial_logpmf,
    normal_log_tails,
    normal_logpdf,
    poisson_logpmf,
    student_t_logpdf,
    von_mises_logpdf,
)
from pfdist.densities.special import (
    erf,
    erfc,
    lgamma,
    logsumexp,
)


@dataclass(frozen=True)
class Density:
    """A density, its support, and the noise from which it is drawn.

    Parameters
    ----------
    support : str
        The values of y whose density is not 0.
    log_density : callable
        ``(y, *parameters)``; for a mixture, the log densities of its components replace y.
    draw : callable
        ``(*noise, *parameters)``; for a mixture, a tuple of draws follows the noise.
    noise : tuple of {"normal", "uniform"}
        The noise that `draw` takes. Each "uniform" may also be "centred".
    """

    support: str
    log_density: Callable[..., Any]
    draw: Callable[..., Any]
    noise: tuple[str, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(inspect.signature(self.log_density).parameters)[1:]


_ONE, _TWO = ("uniform",), ("uniform", "uniform")
DENSITIES = {
    "normal": Density("all numbers", normal_logpdf, normal_draw, ("normal",)),
    "student_t": Density("all numbers", student_t_logpdf, student_t_draw, _TWO),
    "laplace": Density("all numbers", laplace_logpdf, laplace_draw, _ONE),
    "lognormal": Density("y > 0", lognormal_logpdf, lognormal_draw, ("normal",)),
    "gamma": Density("y > 0", gamma_logpdf, gamma_draw, _ONE),
    "beta": Density("0 < y < 1", beta_logpdf, beta_draw, _TWO),
    "von_mises": Density("angles in radians", von_mises_logpdf, von_mises_draw, _ONE),
    "poisson": Density("0, 1, 2, ...", poisson_logpmf, poisson_draw, _ONE),
    "binomial": Density("0, 1, ..., n", binomial_logpmf, binomial_draw, _ONE),
    "negative_binomial": Density(
        "0, 1, 2, ...", negative_binomial_logpmf, negative_binomial_draw, _TWO
    ),
    "categorical": Density("0, 1, ..., categories - 1", categorical_logpmf, categorical_draw, _ONE),
    "mixture": Density("that of the components", mixture_logpdf, mixture_draw, _ONE),
}
"""Each density by its name."""
