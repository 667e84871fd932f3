"""Constraints that contradict each other, or that no set of measurement times satisfies."""

from itertools import pairwise

from pfdist.errors import MeasurementTimesError
from pfdist.problem.constraints import Constraints

_MOST_UNITS = 10_000  # of money; the memory of the searches grows with their number


def check(constraints: Constraints) -> None:
    """Raise an error about constraints that contradict each other, or that no set satisfies.

    The message of the `MeasurementTimesError` begins with the name of the wrong value.
    """
    _check_times(constraints)
    _check_limits(constraints)
    _check_budget_or_price(constraints)
    (_check_number if constraints.counted else _check_money)(constraints)


def _check_times(constraints: Constraints) -> None:
    """Refuse forbidden and required times that are outside, both, or too near to each other."""
    for name in ("forbidden", "required"):
        times, last = getattr(constraints, name), constraints.possible - 1
        outside = [time for time in times if not 0 <= time <= last]
        if outside:
            raise MeasurementTimesError(f"{name} must lie in 0..{last}, got {outside[0]}")
    both = {*constraints.forbidden} & {*constraints.required}
    if both:
        raise MeasurementTimesError(
            f"forbidden and required must have no time in common, got {min(both)} in both"
        )
    for time, later in pairwise(constraints.required):
        if not constraints.spacing.apart((time, later)):
            raise MeasurementTimesError(
                "required must have times that differ by at least minimum_spacing = "
                f"{constraints.minimum_spacing}, got {constraints.formatted(time)} and "
                f"{constraints.formatted(later)}"
            )


def _check_limits(constraints: Constraints) -> None:
    """Refuse N measurements under limits and a spacing of all, and required times beyond limits.

    How many measurements fit beside others would depend on all sensors together. Money needs no
    such number, because it may be left over.
    """
    if constraints.limits and constraints.counted and not constraints.spacing.is_free:
        raise MeasurementTimesError(
            "minimum_spacing must be left out if a sensor has most or minimum_spacing, unless "
            f"total_price is given, got {constraints.minimum_spacing}"
        )
    if not constraints.is_within_limits(constraints.required):
        raise MeasurementTimesError("required must keep the limits of each sensor")


def _check_budget_or_price(constraints: Constraints) -> None:
    """Refuse a budget with prices, and prices without a sum, not above 0 or of a wrong number."""
    given = (constraints.measurement_budget, constraints.price, constraints.total_price)
    if given == (None, None, None):
        raise MeasurementTimesError(
            "measurement_budget must be given, or price and total_price in its place"
        )
    if constraints.counted and given[1:] != (None, None):
        name = "price" if constraints.total_price is None else "total_price"
        raise MeasurementTimesError(
            "measurement_budget must be given without price and total_price, "
            f"got measurement_budget and {name}"
        )
    if None in given[1:] and not constraints.counted:
        got, lacks = (
            ("price", "total_price") if constraints.price is not None else ("total_price", "price")
        )
        raise MeasurementTimesError(f"{lacks} must be given with {got}")
    price, instants = constraints.price, constraints.possible
    if price is not None and len(price) != instants:
        raise MeasurementTimesError(
            f"price needs {instants} values, one for each instant, got {len(price)}"
        )
    if price is not None and min(price) <= 0:
        raise MeasurementTimesError(f"price must be above 0, got {min(price)}")


def _check_number(constraints: Constraints) -> None:
    """Refuse a number of measurements that no set has."""
    budget, possible = constraints.total, constraints.possible
    if budget > possible:
        what = "instants" if constraints.sensors == 1 else "possible measurements"
        raise MeasurementTimesError(
            f"measurement_budget must be at most the number of {what}, {possible}, got {budget}"
        )
    required = len(constraints.required)
    if budget < required:
        raise MeasurementTimesError(
            f"measurement_budget must be at least {required}, the number of required times, got "
            f"{budget}"
        )
    capacity = constraints.capacity(())
    if budget > capacity:
        raise MeasurementTimesError(
            f"measurement_budget must be at most {capacity}, the number of times that fit with "
            f"forbidden, required and minimum_spacing = {constraints.minimum_spacing}, got {budget}"
        )


def _check_money(constraints: Constraints) -> None:
    """Refuse money that pays for no set, or that has too many units."""
    money, required = constraints.total_price or 0, constraints.price_of(constraints.required)
    if money < required:
        raise MeasurementTimesError(
            f"total_price must pay for the required times, whose price is {required}, got {money}"
        )
    if not constraints.allowed:
        raise MeasurementTimesError("forbidden must leave a time, got all times")
    least = min(constraints.price_of((time,)) for time in constraints.allowed)
    if money < least:
        raise MeasurementTimesError(
            f"total_price must pay for a measurement, and the cheapest has the price {least}, "
            f"got {money}"
        )
    if constraints.total > _MOST_UNITS:
        raise MeasurementTimesError(
            f"total_price must be at most {_MOST_UNITS:,} times the largest unit in which every "
            f"price is whole, {float(constraints.unit):.15g}, got {money}: give rounder prices"
        )
