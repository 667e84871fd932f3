"""Log densities of continuous variables, and log probabilities of counts and categories.

They contain all constants. They use the deviance and the excess over Stirling's formula, so no
large terms cancel: the error of a value L is at most 1e-12 max(1, abs(L)).
"""

import math
from typing import Any

import numpy as np

from pfdist.densities.special import (
    LOG_2PI,
    deviance,
    largest_finite,
    log_bessel,
    log_beta_part,
    log_gamma_part,
    log_normal_tail,
    stirling_excess,
)


def normal_logpdf(y: Any, mean: Any, sd: Any) -> Any:
    """Log density of a normal variable.

    Parameters
    ----------
    y, mean, sd : float or array
        Value, mean and standard deviation, sd > 0.

    Returns
    -------
    float or array
    """
    z = (y - mean) / sd
    return -0.5 * z * z - np.log(sd) - 0.5 * LOG_2PI


def lognormal_logpdf(y: Any, mean: Any, sd: Any) -> Any:
    """Log density of a positive variable whose logarithm is normal.

    Parameters
    ----------
    y, mean, sd : float or array
        Value; mean and standard deviation of its logarithm, sd > 0.

    Returns
    -------
    float or array
    """
    log_y = np.log(np.where(y > 0.0, y, 1.0))
    return np.where(y > 0.0, normal_logpdf(log_y, mean, sd) - log_y, -math.inf)


def student_t_logpdf(y: Any, df: Any, location: Any, scale: Any) -> Any:
    """Log density of location + scale t, where t has `df` degrees of freedom.

    Parameters
    ----------
    y, df, location, scale : float or array
        Value; degrees of freedom, df > 0; centre; scale > 0, in the unit of y. With a scale of 0
        the density is 0, and infinite at the centre.

    Returns
    -------
    float or array
    """
    h, distance = 0.5 * df, np.abs(y - location)
    z = distance / np.maximum(scale, 5e-324)
    constant = h * np.log1p(0.5 / h) - 0.5 - 0.5 * LOG_2PI
    constant = constant + stirling_excess(h + 0.5) - stirling_excess(h)
    near = constant - np.log(scale) - (h + 0.5) * np.log1p(z * z / df)
    # Far out, 1 + z^2 / df is z^2 / df to the last digit, and a square may be infinite.
    log_t = np.log(np.maximum(distance, 5e-324)) - 0.5 * np.log(df)
    far = constant + df * np.log(scale) - (df + 1.0) * log_t
    return np.where(distance <= 1e9 * scale * np.sqrt(df), near, far)


def laplace_logpdf(y: Any, location: Any, scale: Any) -> Any:
    """Log density of a Laplace variable with mean absolute deviation `scale`.

    Parameters
    ----------
    y, location, scale : float or array
        Value; centre; mean absolute deviation from it, scale > 0.

    Returns
    -------
    float or array
    """
    return -np.abs(y - location) / scale - np.log(2.0 * scale)


def gamma_logpdf(y: Any, shape: Any, scale: Any) -> Any:
    """Log density of a gamma variable with mean shape * scale; shape 1 is the exponential.

    Parameters
    ----------
    y, shape, scale : float or array
        Value; shape > 0; scale > 0, in the unit of y.

    Returns
    -------
    float or array
    """
    inside = y > 0.0
    x = np.where(inside, y / scale, 1.0)
    value = log_gamma_part(shape, x) - np.log(np.where(inside, y, 1.0))
    return np.where(inside, value, -math.inf)


def beta_logpdf(y: Any, a: Any, b: Any) -> Any:
    """Log density of a beta variable with mean a / (a + b).

    Parameters
    ----------
    y, a, b : float or array
        Value; a > 0 and b > 0: the exponents of y and 1 - y are a - 1 and b - 1.

    Returns
    -------
    float or array
    """
    inside = (y > 0.0) & (y < 1.0)
    x = np.where(inside, y, 0.5)
    value = log_beta_part(a, b, x, 1.0 - x) - np.log(x * (1.0 - x))
    return np.where(inside, value, -math.inf)


def von_mises_logpdf(y: Any, mean: Any, concentration: Any) -> Any:
    """Log density of a von Mises angle, proportional to exp(concentration cos(y - mean)).

    Parameters
    ----------
    y, mean, concentration : float or array
        Angle and mean direction in radians; concentration >= 0.

    Returns
    -------
    float or array
    """
    half = np.sin(0.5 * (y - mean))
    return -2.0 * concentration * half * half - LOG_2PI - log_bessel(concentration)


def poisson_logpmf(y: Any, mean: Any) -> Any:
    """Log probability of a Poisson count.

    Parameters
    ----------
    y, mean : float or array
        Count; mean >= 0.

    Returns
    -------
    float or array
    """
    k = np.where(y > 0.0, y, 1.0)
    value = -0.5 * (LOG_2PI + np.log(k)) - stirling_excess(k) - deviance(k, mean)
    return _of_whole(y, np.where(y > 0.0, value, -mean))


def _of_whole(y, value):
    """The value where y is a whole number of 0 or more, and minus infinity elsewhere."""
    return np.where((y >= 0.0) & (y == np.floor(y)), value, -math.inf)


def binomial_logpmf(y: Any, n: Any, p: Any) -> Any:
    """Log probability of the number of successes in n trials.

    Parameters
    ----------
    y, n, p : float or array
        Number of successes; number of trials; probability of success in 0..1.

    Returns
    -------
    float or array
    """
    inside = (y > 0.0) & (y < n)
    k, m = np.where(inside, y, 1.0), np.where(inside, n, 2.0)
    value = log_beta_part(k, m - k, p, 1.0 - p) - np.log(k * (m - k) / m)
    all_succeed = n * np.log(np.where(n > 0.0, p, 1.0))
    value = np.where(y == n, all_succeed, np.where(inside, value, n * np.log1p(-p)))
    return np.where(y > n, -math.inf, _of_whole(y, value))


def negative_binomial_logpmf(y: Any, mean: Any, size: Any) -> Any:
    """Log probability of a count with the variance mean + mean^2 / size.

    Parameters
    ----------
    y, mean, size : float or array
        Count; mean > 0; size > 0.

    Returns
    -------
    float or array
    """
    k, p = np.where(y > 0.0, y, 1.0), mean / (mean + size)
    value = log_beta_part(k, size, p, size / (mean + size)) - np.log(k)
    return _of_whole(y, np.where(y > 0.0, value, -size * np.log1p(mean / size)))


def categorical_logpmf(y: Any, weights: Any) -> Any:
    """Log probability of the number of a category.

    Parameters
    ----------
    y : float or array
        Number of the category.
    weights : tuple of float or array
        Weights of the categories; they need not sum to 1.

    Returns
    -------
    float or array
    """
    total: Any = 0.0
    chosen: Any = 0.0
    for number in range(len(weights)):
        total = total + weights[number]
        chosen = np.where(y == number, weights[number], chosen)
    return np.log(chosen / total)


def mixture_logpdf(log_densities: Any, weights: Any) -> Any:
    """Log density of a mixture.

    Parameters
    ----------
    log_densities : tuple of float or array
        Log densities of the components.
    weights : tuple of float or array
        Weights of the components; they need not sum to 1.

    Returns
    -------
    float or array
    """
    top = largest_finite(log_densities)
    total, likelihood = 0.0, 0.0
    for k in range(len(weights)):
        total = total + weights[k]
        likelihood = likelihood + weights[k] * np.exp(log_densities[k] - top)
    return top + np.log(likelihood / total)


# --- the probabilities of values up to y, and above it --------------------------------------------


def normal_log_tails(y: Any, mean: Any, sd: Any) -> tuple[Any, Any]:
    """Logarithms of the probabilities that a normal variable is at most y, and above y.

    Parameters
    ----------
    y, mean, sd : float or array
        Value, mean and standard deviation, sd > 0.

    Returns
    -------
    pair of float or array
        Both are accurate even where they are far below 0.
    """
    z = (y - mean) / sd
    return log_normal_tail(-z), log_normal_tail(z)


def lognormal_log_tails(y: Any, mean: Any, sd: Any) -> tuple[Any, Any]:
    """Logarithms of the probabilities of values up to y, and above it, if log(y) is normal.

    Parameters
    ----------
    y, mean, sd : float or array
        Value above 0; mean and standard deviation of its logarithm, sd > 0.

    Returns
    -------
    pair of float or array
    """
    return normal_log_tails(np.log(y), mean, sd)


def laplace_log_tails(y: Any, location: Any, scale: Any) -> tuple[Any, Any]:
    """Logarithms of the probabilities that a Laplace variable is at most y, and above y.

    Parameters
    ----------
    y, location, scale : float or array
        Value, location and scale, scale > 0.

    Returns
    -------
    pair of float or array
    """
    z = (y - location) / scale
    small = -np.abs(z) - 0.6931471805599453  # log(2)
    large = np.log1p(-0.5 * np.exp(-np.abs(z)))
    return np.where(z < 0.0, small, large), np.where(z < 0.0, large, small)
