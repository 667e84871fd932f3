"""Which functions of the C library a formula calls: those alone on which its last digits depend."""

import math

import numpy as np
import pytest
from numba import njit

from pfdist.kernels.formulas import formula
from pfdist.kernels.libm import libm_functions

VECTOR, MATRIX = np.ones(3), np.ones((3, 3))


def called_by(function):
    melting = formula(function)

    @njit
    def compiled(x, y):
        return melting(x, y)

    compiled(1.3, 2.7)
    return libm_functions(compiled)


@pytest.mark.parametrize(
    ("function", "names"),
    [
        (lambda x, y: x**y, ("pow",)),
        (lambda x, y: x**2.5, ("pow",)),
        (lambda x, y: math.gamma(x) + math.erf(y), ("erf", "gamma")),
        (lambda x, y: 2 * np.logaddexp(x, y), ("exp", "log1p")),
        (lambda x, y: np.float32(x) ** np.float32(y), ("pow",)),
        (lambda x, y: np.dot(VECTOR, x * VECTOR), ("dot (BLAS)",)),
        (lambda x, y: (x * MATRIX @ VECTOR)[0], ("gemv (BLAS)",)),
        (lambda x, y: x % y + x // y, ()),
        (lambda x, y: np.sqrt(x) + abs(y) + np.floor(x) + math.ceil(y) + round(x), ()),
        (lambda x, y: x**2 + y**3 + x**0.5 + np.maximum(x, y), ()),
        (lambda x, y: np.exp(x) + math.log(y) + np.hypot(x, y) + np.tanh(x) + math.atan2(x, y), ()),
    ],
    ids=[
        *("power", "constant power", "gamma and erf", "logaddexp", "float32", "np.dot", "@"),
        *("remainders", "rounded correctly", "whole powers and the root", "our own"),
    ],
)
def test_functions_that_round_otherwise_elsewhere_are_named_and_no_others(function, names):
    assert called_by(function) == names


def test_linear_algebra_is_named():
    assert any("LAPACK" in name or "BLAS" in name for name in called_by(least_eigenvalue))


def least_eigenvalue(x, y):
    return np.linalg.eigvalsh(x * MATRIX)[0]
