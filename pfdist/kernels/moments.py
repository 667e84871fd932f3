"""What is computed of a weighted cloud: mean and variance of z, and what an instant costs."""

from collections.abc import Callable
from typing import Any

from pfdist.kernels.arithmetic import row_sum
from pfdist.kernels.components import reader, tuple_of, writer
from pfdist.kernels.estimators import SQUARED_ERROR_INDEX
from pfdist.kernels.formulas import formula
from pfdist.kernels.melting import melted


def moments(
    quantity_of_interest: Callable[..., Any], components: tuple[int, int, int]
) -> tuple[Callable[..., Any], ...]:
    """Compile the weighted mean of z, and its variance.

    A particle of weight 0 does not count. The terms are computed first, a vector of whatever length
    the processor has at a time; then `row_sum` adds them in an order of its own.
    """
    states, _, quantities = components
    quantity = formula(quantity_of_interest, "quantity_of_interest")
    read_x = reader(states, "half, c, i")
    weighted = tuple_of(
        quantities, "weight, values", "weight * (values[c] if weight > 0.0 else 0.0)"
    )
    squares = tuple_of(quantities, "values, mean", "(values[c] - mean[c]) ** 2")
    write_terms = writer(quantities, "c, i")
    mean_of = tuple_of(
        quantities, "terms, total", "row_sum(terms, uintp(c)) / total", row_sum=row_sum
    )

    @melted
    def average(cloud, here, t, p, weight, row, total, terms):
        for i in range(cloud.shape[2]):
            z = quantity(read_x(cloud, here, i), t, p)
            write_terms(terms, i, weighted(weight[row, i], z))
        return mean_of(terms, total)

    @melted
    def spread(cloud, here, t, p, weight, row, total, mean, terms):
        for i in range(cloud.shape[2]):
            z = quantity(read_x(cloud, here, i), t, p)
            write_terms(terms, i, weighted(weight[row, i], squares(z, mean)))
        return mean_of(terms, total)

    return average, spread


def recorders(error: Callable[..., Any], quantities: int) -> tuple[Callable[..., Any], ...]:
    """Compile what records mean and variance, and what an instant costs by them.

    Of two filters each gives half of its variance; the first one leaves its mean to the second.
    """
    error_of = formula(error, "error")
    write_z = writer(quantities, "d, t, c")
    read_other, write_other = (make(quantities, "s, t, c") for make in (reader, writer))

    @melted
    def record(estimate, variance, d, t, mean, variances):
        if estimate.size > 0:  # somebody asks
            write_z(estimate, d, t, mean)
            write_z(variance, d, t, variances)

    @melted
    def cost_of(estimator, k, others, s, t, mean, variances, truth):
        total = 0.0
        for variance in variances:
            total += variance
        if others.size > 0:
            total *= 0.5
            total += error_of(read_other(others, s, t), mean, t, truth) if k > 0 else 0.0
            write_other(others, s, t, mean)
        return total if estimator != SQUARED_ERROR_INDEX else 0.0

    return record, cost_of
