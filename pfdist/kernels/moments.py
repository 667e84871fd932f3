"""Mean and variance of z over a weighted cloud, and the estimates of an instant's error."""

from collections.abc import Callable
from typing import Any

from pfdist.kernels.arithmetic import row_sum
from pfdist.kernels.components import reader, tuple_of, writer
from pfdist.kernels.formulas import formula
from pfdist.kernels.melting import melted


def moments(
    quantity_of_interest: Callable[..., Any], components: tuple[int, int, int]
) -> tuple[Callable[..., Any], ...]:
    """Compile the weighted mean of z, and its variance.

    A particle of weight 0 does not count. The terms are computed first, in vectors whose length
    depends on the processor. Then `row_sum` adds them in a fixed order.
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
    def fill_terms(cloud, here, t, p, weight, row, terms):
        for i in range(cloud.shape[2]):
            z = quantity(read_x(cloud, here, i), t, p)
            write_terms(terms, i, weighted(weight[row, i], z))

    @melted
    def fill_squares(cloud, here, t, p, weight, row, mean, terms):
        for i in range(cloud.shape[2]):
            z = quantity(read_x(cloud, here, i), t, p)
            write_terms(terms, i, weighted(weight[row, i], squares(z, mean)))

    return fill_terms, fill_squares, mean_of


def recorders(error: Callable[..., Any], quantities: int) -> tuple[Callable[..., Any], ...]:
    """Compile what records mean and variance, and the part of an instant's error they estimate.

    Each filter contributes its variance, by the estimator's weights. The first of two filters
    stores its mean, and the second adds the squared distance to it.
    """
    error_of = formula(error, "error")
    write_z = writer(quantities, "d, t, c")
    read_mean, write_mean = (make(quantities, "s, t, c") for make in (reader, writer))

    @melted
    def record(results, d, t, mean, variances):
        if results.estimate.size > 0:
            write_z(results.estimate, d, t, mean)
            write_z(results.variance, d, t, variances)

    @melted
    def error_by_variance(
        weights, first_means, filter_number, s, t, mean, variances, truth, instant
    ):
        total = 0.0
        if weights.variance != 0.0:  # else an infinite variance would make a NaN
            for variance in variances:
                total += variance
            total *= weights.variance
        if first_means.size > 0:
            if filter_number > 0:
                distance = error_of(read_mean(first_means, s, t), mean, instant, truth)
                total += weights.distance * distance
            write_mean(first_means, s, t, mean)
        return total

    return record, error_by_variance
