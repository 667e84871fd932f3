"""Means over independent draws against what they must be, within 4.5 standard errors."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def assert_mean(values: Array, expected: float = 0.0) -> None:
    """Independent values have this expectation."""
    assert abs(values.mean() - expected) < 4.5 * values.std() / np.sqrt(values.size)


def assert_positive(values: Array) -> None:
    """Independent values have an expectation above zero."""
    assert values.mean() > 4.5 * values.std() / np.sqrt(values.size)


def assert_covariance(values: Array, covariance: Array) -> None:
    """Vectors, (D, n), have the mean zero and this covariance."""
    for i, j in np.ndindex(covariance.shape):
        assert_mean(values[:, i])
        assert_mean(values[:, i] * values[:, j], covariance[i, j])


def assert_exact_filter(
    estimate: Array, variance: Array, mean: Array, exact_variance: Array, particles: int
) -> None:
    """A particle filter estimates the exact filter's mean and variance, all (D, T+1, q)."""
    # A filter's error over the draws has mean 0, but for a bias of order variance / particles.
    for value, truth, bias in (
        (estimate, mean, 5 * np.sqrt(exact_variance) / particles),
        (variance, exact_variance, 10 * exact_variance / particles),
    ):
        error = value - truth
        standard_error = error.std(axis=0, ddof=1) / np.sqrt(len(error))
        assert (np.abs(error.mean(axis=0)) < 4.5 * standard_error + bias[0]).all()
    # And it is small draw by draw: a tenth of the posterior's standard deviation.
    rms = np.sqrt(np.mean((estimate - mean) ** 2, axis=0))
    assert (rms < 0.1 * np.sqrt(exact_variance[0])).all()
