"""Guided steps, and weights that are carried over a measurement.

A guided filter draws the process noise w of the step to a measured instant from a proposal, which
knows the measurement. The weight of a particle is then p(y | x) p(w) / q(w | x, y). A filter that
does not always resample carries its weights to the next measurement, where they are factors.

Log-weights are collected in `pfdist.kernels.scratch.Scratch.log_weight`: first the logarithm of the
carried weights, then what the proposal contributes, and at last the log-likelihood.

Sources: Doucet, Godsill, Andrieu, "On sequential Monte Carlo sampling methods for Bayesian
filtering", Statistics and Computing 10, 2000. Chopin, Papaspiliopoulos, "An introduction to
sequential Monte Carlo", 2020, chapter 10.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.arithmetic import row_sum
from pfdist.kernels.cloud import FilterFormulas, repeat_first
from pfdist.kernels.components import reader, tuple_of, writer
from pfdist.kernels.elementary import log
from pfdist.kernels.formulas import formula
from pfdist.kernels.melting import melted
from pfdist.kernels.noise import FILTER_PROCESS, filler
from pfdist.kernels.scratch import EQUAL, WEIGHTED
from pfdist.kernels.weights import cumulate

_LOG_OF_ROOT = math.log(2.0 * math.pi) / 2.0
_CENTRES = {"normal": 0.0, "uniform": 0.5, "centred": 0.0}


def plain_log_density(kinds: tuple[str, ...], w: tuple[Any, ...]) -> NDArray[np.float64]:
    """Log-density of noise of these kinds, for arrays; plain twin of `_log_density_of`."""
    total = np.zeros(np.broadcast_shapes(*map(np.shape, w)))
    for kind, value in zip(kinds, w, strict=True):
        normal = -0.5 * np.square(value) - _LOG_OF_ROOT
        uniform = np.where(np.abs(value - _CENTRES[kind]) <= 0.5, 0.0, -np.inf)
        total = total + (normal if kind == "normal" else uniform)
    return total


def _log_density_of(kinds: tuple[str, ...]) -> Callable[..., Any]:
    """Compile the log-density of noise of these kinds."""

    @melted
    def component(value, is_normal, centre):
        uniform = 0.0 if abs(value - centre) <= 0.5 else -np.inf
        return -0.5 * value * value - _LOG_OF_ROOT if is_normal else uniform

    components = tuple_of(
        len(kinds), "w", "component(w[c], is_normal[c], centre[c])", component=component,
        is_normal=tuple(kind == "normal" for kind in kinds), centre=tuple(map(_CENTRES.get, kinds)),
    )  # fmt: skip

    @melted
    def log_density(w):
        total = 0.0
        for value in components(w):
            total += value
        return total

    return log_density


# --- the step to an instant -----------------------------------------------------------------------


def step_of(
    propagate: Callable[..., None],
    begin_log_weights: Callable[..., None],
    formulas: FilterFormulas,
    noise_kinds: tuple[tuple[str, ...], ...],
    components: tuple[int, tuple[int, ...], int],
) -> Callable[..., None]:
    """Compile ``step(scratch, here, row, request, p, at, t, is_measured)``, from t - 1 to t.

    If t is measured, `begin_log_weights` begins the log-weights. A guided filter, which has a
    proposal, then adds log p(w) - log q(w).
    All other steps are `propagate`. Other arguments are those of
    `pfdist.kernels.fused_filter.fused_filter`.
    """

    @melted
    def plain_step(scratch, here, row, request, p, at, t, is_measured):
        cloud, noise, before = scratch.cloud, scratch.noise, request.start + t - 1
        if is_measured:
            begin_log_weights(scratch, row)
        propagate(cloud, here, noise, request.particles, p, at.stream, at.draw, before)

    if not formulas.proposal:
        return plain_step
    transition = formula(formulas.transition, "transition")
    proposal = formula(formulas.proposal[0], "proposal")
    log_density_of_proposal = formula(formulas.proposal[1], "proposal_log_density")
    _, process, variates = noise_kinds
    fill_u, read_u = filler(variates), reader(len(variates), "c, i")
    log_density, as_floats = _log_density_of(process), tuple_of(len(process), "w", "float64(w[c])")
    states, (measurements,), _ = components
    read_x, write_x = reader(states, "half, c, i"), writer(states, "half, c, i")
    read_y = reader(measurements, "d, t, c")

    @melted
    def step(scratch, here, row, request, p, at, t, is_measured):
        cloud, noise, log_weight = scratch.cloud, scratch.noise, scratch.log_weight
        particles, before = request.particles, request.start + t - 1
        if not is_measured:
            propagate(cloud, here, noise, particles, p, at.stream, at.draw, before)
            return
        begin_log_weights(scratch, row)
        fill_u(noise, particles, at.stream, at.draw, before, FILTER_PROCESS)
        repeat_first(noise, particles, cloud.shape[2])
        y = read_y(request.y, at.d, t)
        for i in range(cloud.shape[2]):
            x = read_x(cloud, here, i)
            w = as_floats(proposal(x, y, before, read_u(noise, i), p))
            write_x(cloud, 1 - here, i, transition(x, before, w, p))
            log_weight[i] += log_density(w) - log_density_of_proposal(w, x, y, before, p)

    return step


# --- weights between measurements -----------------------------------------------------------------


def weighting(
    begin: Callable[..., Any], resample_cloud: Callable[..., Any], guided: bool, carries: bool
) -> tuple[Callable[..., Any], ...]:
    """Compile what happens to weights between measurements.

    - ``begin_weighted(at, request, p, scratch, source) -> error, row, total``: `begin`, and row and
      total of the weights of the cloud that it takes;
    - ``begin_log_weights(scratch, row)``, before the step to a measured instant;
    - ``resample(scratch, here, request, total, at, t) -> here, row, total``.
    """
    first_weights, resample = _equal_weights, _always(resample_cloud)
    begin_log_weights = _zero_log_weights if guided else _no_log_weights
    if carries:
        first_weights, resample = _resumed_weights, _if_uneven(resample_cloud)
        begin_log_weights = _carried_log_weights

    @melted
    def begin_weighted(at, request, p, scratch, source):
        error = begin(at, request, p, scratch, source)
        row, total = first_weights(scratch, source, request)
        begin_log_weights(scratch, row)
        return error, row, total

    return begin_weighted, begin_log_weights, resample


@melted
def _equal_weights(scratch, source, request):
    return EQUAL, float(request.particles)


@melted
def _resumed_weights(scratch, source, request):
    """Take the weights of the saved cloud or of the prior, if they have any."""
    weight, size = scratch.weight, scratch.log_weight.size
    if source >= 0:
        for i in range(size):
            weight[WEIGHTED, i] = scratch.saved.weights[source, i]
    elif request.prior.weight.size > 0:
        for i in range(request.particles):
            weight[WEIGHTED, i] = request.prior.weight[i]
    else:
        return EQUAL, float(request.particles)
    return WEIGHTED, cumulate(weight, WEIGHTED, size, scratch.resampling.cumulative)


@melted
def _no_log_weights(scratch, row):
    """Do nothing: the log-likelihood alone is the log-weight."""


@melted
def _zero_log_weights(scratch, row):
    for i in range(scratch.log_weight.size):
        scratch.log_weight[i] = 0.0


@melted
def _carried_log_weights(scratch, row):
    for i in range(scratch.log_weight.size):
        scratch.log_weight[i] = log(np.float64(scratch.weight[row, i]))


def _always(resample_cloud: Callable[..., Any]) -> Callable[..., Any]:
    @melted
    def resample(scratch, here, request, total, at, t):
        here = resample_cloud(scratch, here, request, at, t, 0)
        return here, EQUAL, float(request.particles)

    return resample


def _if_uneven(resample_cloud: Callable[..., Any]) -> Callable[..., Any]:
    """Resample only if the effective sample size lies below the threshold.

    Source: Kong, Liu, Wong, "Sequential imputations and Bayesian missing data problems", Journal of
    the American Statistical Association 89, 1994.
    """

    @melted
    def resample(scratch, here, request, total, at, t):
        weight, squares, particles = scratch.weight, scratch.terms, float(request.particles)
        for i in range(squares.shape[1]):
            squares[0, i] = np.float64(weight[WEIGHTED, i]) ** 2
        least = request.threshold * particles
        if total * total >= least * row_sum(squares, np.uintp(0)):
            return here, WEIGHTED, total
        here = resample_cloud(scratch, here, request, at, t, 0)
        return here, EQUAL, particles

    return resample
