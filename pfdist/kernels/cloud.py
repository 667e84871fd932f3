"""The steps of a cloud of particles, compiled from a model: begin, propagate, weight, and copy.

A cloud is an array (2, n, W), a member of `pfdist.kernels.scratch.Scratch`. Each step reads one
half, whose index is `here`, and writes the other half.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.components import reader, writer
from pfdist.kernels.formulas import formula
from pfdist.kernels.melting import melted
from pfdist.kernels.noise import FILTER_INITIAL, FILTER_PROCESS, filler
from pfdist.kernels.weights import IMPOSSIBLE


class FilterFormulas(NamedTuple):
    """Formulas of a filter's model, and the error of the truth."""

    initial: Callable[..., Any]
    transition: Callable[..., Any]
    quantity_of_interest: Callable[..., Any]
    error: Callable[..., Any]
    log_likelihoods: tuple[Callable[..., Any], ...]  # one of each sensor, in their order
    # proposal and proposal_log_density of a guided filter; else empty
    proposal: tuple[Callable[..., Any], ...] = ()

    @property
    def all(self) -> tuple[Callable[..., Any], ...]:
        """All formulas in the order of the fields."""
        return (*self[:4], *self.log_likelihoods, *self.proposal)


class Prior(NamedTuple):
    """Particles from which each filter starts in the place of `initial`."""

    x: NDArray[np.float64]  # (n, M): states of all particles
    # (F, D, P): the column of x that each particle of each of F filters of each draw starts as;
    # empty if the filters start from `initial`
    particle: NDArray[np.int64]
    # (P,): weights, if the particles are those of a filter that carries weights; else empty
    weight: NDArray[np.float64]


FROM_INITIAL = Prior(np.empty((0, 0)), np.empty((0, 0, 0), np.int64), np.empty(0))


@lru_cache(maxsize=32)
def cloud_steps(
    formulas: FilterFormulas,
    noise_kinds: tuple[tuple[str, ...], ...],
    states: int,
    carries: bool = False,
) -> tuple[Callable[..., Any], ...]:
    """Compile what a model does to a cloud: begin, propagate, and compute log-weights.

    `noise_kinds` are those of the initial state and of the process, and `states` is the number of
    components of x. The results are

    - ``begin(at, request, p, scratch, source)``, which fills the first half and returns the sum of
      the errors so far. It copies the saved cloud number `source`. If `source` is -1, it takes the
      request's prior for the draw ``at.d``, or without a prior x(0);
    - ``propagate(cloud, here, noise, particles, p, stream, draw, t)``: x(t+1) from x(t);
    - for each sensor, ``fill_log_weights(cloud, here, particles, p, y, t, log_weight)``, for a
      measurement y at t. If the filter is guided or carries weights, the log-likelihood is added
      to what `log_weight` holds.
    """
    initial = formula(formulas.initial, "initial")
    transition = formula(formulas.transition, "transition")
    fill_w0, fill_w = map(filler, noise_kinds)
    read_w0, read_w = (reader(len(kinds), "c, i") for kinds in noise_kinds)
    read_x, write_x = reader(states, "half, c, i"), writer(states, "half, c, i")

    @melted
    def begin(at, request, p, scratch, source):
        cloud, noise, particles = scratch.cloud, scratch.noise, request.particles
        if source >= 0:
            copy_cloud(scratch.saved.clouds, source, cloud, 0)
            return scratch.saved.errors[source]
        if request.prior.particle.size > 0:
            _copy_prior(request.prior, at, particles, cloud)
            return 0.0
        fill_w0(noise, particles, at.stream, at.draw, np.int64(0), FILTER_INITIAL)
        repeat_first(noise, particles, cloud.shape[2])
        for i in range(cloud.shape[2]):
            write_x(cloud, 0, i, initial(read_w0(noise, i), p))
        return 0.0

    @melted
    def propagate(cloud, here, noise, particles, p, stream, draw, t):
        fill_w(noise, particles, stream, draw, t, FILTER_PROCESS)
        repeat_first(noise, particles, cloud.shape[2])
        for i in range(cloud.shape[2]):
            x = transition(read_x(cloud, here, i), t, read_w(noise, i), p)
            write_x(cloud, 1 - here, i, x)

    adds = carries or bool(formulas.proposal)
    fillers = [
        _log_weights(formula(each, "log_likelihood"), read_x, adds)
        for each in formulas.log_likelihoods
    ]
    return begin, propagate, *fillers


def _log_weights(
    log_likelihood: Callable[..., Any], read_x: Callable[..., Any], adds: bool
) -> Callable[..., None]:
    @melted
    def fill_log_weights(cloud, here, particles, p, y, t, log_weight):
        for i in range(log_weight.size):
            value = log_likelihood(y, read_x(cloud, here, i), t, p)
            if adds:
                value += log_weight[i]
            log_weight[i] = value if abs(value) < np.inf else IMPOSSIBLE
        for i in range(particles, log_weight.size):
            log_weight[i] = IMPOSSIBLE

    return fill_log_weights


@melted
def _copy_prior(prior, at, particles, cloud):
    """Copy a filter's first particles to the first half; behind the last, repeat the first."""
    for i in range(cloud.shape[2]):
        chosen = prior.particle[at.filter_number, at.d, i if i < particles else 0]
        for component in range(cloud.shape[1]):
            cloud[0, component, i] = prior.x[component, chosen]


@melted
def repeat_first(noise, particles, size):
    """Copy the first particle's noise behind the last particle's.

    So a formula cannot fail behind the last particle if it fails for no particle.
    """
    for row in range(noise.shape[0]):
        for i in range(particles, size):
            noise[row, i] = noise[row, 0]


@melted
def copy_ancestors(cloud, here, particles, ancestor):
    """Copy each particle's ancestor to the other half; behind the last, repeat the first."""
    for i in range(particles, cloud.shape[2]):
        ancestor[i] = ancestor[0]
    for component in range(cloud.shape[1]):
        for i in range(cloud.shape[2]):
            cloud[1 - here, component, i] = cloud[here, component, ancestor[i]]


@melted
def copy_cloud(clouds, source, others, target):
    """Copy ``clouds[source]`` to ``others[target]``."""
    for component in range(clouds.shape[1]):
        for i in range(clouds.shape[2]):
            others[target, component, i] = clouds[source, component, i]
