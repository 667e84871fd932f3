"""Draws: transforms of normal or uniform noise into other distributions.

Uniform noise lies at least 6e-8 from 0 and 1. Centred noise lies between -1/2 and 1/2. Each
function reads a negative u as 1 + u, so that centred noise reaches 2^-53 in both tails.

References
----------
Bailey, "Polar generation of random variates with the t-distribution", Mathematics of Computation
62, 1994.
"""

import math
from typing import Any

import numpy as np

from pfdist.densities.quantiles import (
    count_quantile,
    log_gamma_quantile,
    log_tail,
    tails,
    von_mises_quantile,
)


def normal_draw(w: Any, mean: Any, sd: Any) -> Any:
    """A normal variable.

    Parameters
    ----------
    w : float or array
        Normal noise.
    mean, sd : float or array

    Returns
    -------
    float or array
    """
    return mean + sd * w


def lognormal_draw(w: Any, mean: Any, sd: Any) -> Any:
    """A variable whose logarithm is normal.

    Parameters
    ----------
    w : float or array
        Normal noise.
    mean, sd : float or array
        Mean and standard deviation of the logarithm.

    Returns
    -------
    float or array
    """
    return np.exp(mean + sd * w)


# --- draws from uniform or centred noise ----------------------------------------------------------


def laplace_draw(u: Any, location: Any, scale: Any) -> Any:
    """A Laplace variable, by its quantile.

    Parameters
    ----------
    u : float or array
        Uniform or centred noise.
    location, scale : float or array

    Returns
    -------
    float or array
    """
    low, high = tails(u)
    return location + scale * np.where(low < high, np.log(2.0 * low), -np.log(2.0 * high))


def student_t_draw(u: Any, v: Any, df: Any, location: Any, scale: Any) -> Any:
    """A Student t variable, by Bailey's polar method from two variates; u decides the tails.

    Parameters
    ----------
    u, v : float or array
        Uniform or centred noise.
    df, location, scale : float or array

    Returns
    -------
    float or array
    """
    low, high = tails(u)
    squared = df * np.expm1(-2.0 / df * log_tail(low, high))
    return location + scale * np.sqrt(squared) * np.cos(2.0 * math.pi * v)


def gamma_draw(u: Any, shape: Any, scale: Any) -> Any:
    """A gamma variable, by its quantile.

    Parameters
    ----------
    u : float or array
        Uniform or centred noise.
    shape, scale : float or array

    Returns
    -------
    float or array
    """
    return scale * np.exp(log_gamma_quantile(u, shape))


def beta_draw(u: Any, v: Any, a: Any, b: Any) -> Any:
    """A beta variable, from two variates: a gamma variable over the sum of two.

    Parameters
    ----------
    u, v : float or array
        Uniform or centred noise.
    a, b : float or array

    Returns
    -------
    float or array
    """
    return 1.0 / (1.0 + np.exp(log_gamma_quantile(v, b) - log_gamma_quantile(u, a)))


def categorical_draw(u: Any, weights: Any) -> Any:
    """The number 0, 1, ... of a category, by its quantile.

    Parameters
    ----------
    u : float or array
        Uniform or centred noise.
    weights : tuple of float or array

    Returns
    -------
    float or array
    """
    low, _ = tails(u)
    total: Any = 0.0
    below: Any = 0.0
    number: Any = 0.0
    for weight in weights:
        total = total + weight
    for k in range(len(weights) - 1):
        below = below + weights[k]
        number = number + np.where(below < low * total, 1.0, 0.0)
    return number


def mixture_draw(u: Any, draws: Any, weights: Any) -> Any:
    """A draw from a mixture: the draw of the component that u chooses.

    Parameters
    ----------
    u : float or array
        Uniform or centred noise.
    draws : tuple of float or array
        A draw of each component.
    weights : tuple of float or array

    Returns
    -------
    float or array
    """
    number, chosen = categorical_draw(u, weights), draws[0]
    for k in range(1, len(weights)):
        chosen = np.where(number == k, draws[k], chosen)
    return chosen


def von_mises_draw(u: Any, mean: Any, concentration: Any) -> Any:
    """A von Mises angle: the mean plus the quantile of the deviation, which is in -pi..pi.

    Parameters
    ----------
    u : float or array
        Uniform or centred noise.
    mean, concentration : float or array

    Returns
    -------
    float or array
    """
    low, high = tails(u)
    tail = np.minimum(low, high)
    angle = von_mises_quantile(tail, concentration)
    return mean + np.where(low < high, -angle, angle)


def poisson_draw(u: Any, mean: Any) -> Any:
    """A Poisson count, by its quantile.

    Parameters
    ----------
    u : float or array
        Uniform or centred noise.
    mean : float or array
        0 or more.

    Returns
    -------
    float or array
    """
    return count_quantile(u, mean, mean, 1.0, None)


def binomial_draw(u: Any, n: Any, p: Any) -> Any:
    """The number of successes in n trials, by its quantile.

    Parameters
    ----------
    u : float or array
        Uniform or centred noise.
    n, p : float or array
        Number of trials; probability of success in 0..1.

    Returns
    -------
    float or array
    """
    flipped = p > 0.5
    share = np.where(flipped, 1.0 - p, p)
    mean = n * share
    k = count_quantile(np.where(flipped, -u, u), mean, mean * (1.0 - share), 1.0 - 2.0 * share, n)
    return np.where(flipped, n - k, k)


def negative_binomial_draw(u: Any, v: Any, mean: Any, size: Any) -> Any:
    """A negative binomial count, from two variates: Poisson, with a gamma variable as its mean.

    Parameters
    ----------
    u, v : float or array
        Uniform or centred noise.
    mean, size : float or array

    Returns
    -------
    float or array
    """
    return poisson_draw(u, gamma_draw(v, size, mean / size))
