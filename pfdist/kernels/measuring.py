"""The steps of a measurement: the cloud of particles is weighted, and later resampled."""

from collections.abc import Callable
from typing import Any

from pfdist.kernels.cloud import copy_ancestors
from pfdist.kernels.components import reader
from pfdist.kernels.melting import melted
from pfdist.kernels.resampling import RESAMPLE
from pfdist.kernels.schemes import ALL_SCHEMES
from pfdist.kernels.scratch import WEIGHTED
from pfdist.kernels.sorting import sort_by_state
from pfdist.kernels.weights import cumulate, weigh


def measuring(
    fill_log_weights: Callable[..., None], measurements: int, resampling: str
) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Compile the two steps of a measurement, for a model with this number of components of y.

    - ``weigh_cloud(scratch, here, request, p, d, t) -> here, total``: the half that then holds the
      cloud, and the sum of the weights;
    - ``resample_cloud(scratch, here, particles, stream, draw, instant) -> here``.

    `fill_log_weights` is described at `pfdist.kernels.cloud.cloud_steps`.
    """
    read_y, resample = reader(measurements, "d, t, c"), RESAMPLE[resampling]
    sort = sort_by_state if ALL_SCHEMES[resampling].sorts else _leave_unsorted

    @melted
    def weigh_cloud(scratch, here, request, p, d, t):
        cloud, weight, log_weight = scratch.cloud, scratch.weight, scratch.log_weight
        particles, y, instant = request.particles, read_y(request.y, d, t), request.start + t
        fill_log_weights(cloud, here, particles, p, y, instant, log_weight)
        weigh(log_weight, weight, WEIGHTED)
        here = sort(cloud, here, particles, weight, WEIGHTED, scratch.sorting)
        cumulative = scratch.resampling.cumulative
        return here, cumulate(weight, WEIGHTED, log_weight.size, cumulative)

    @melted
    def resample_cloud(scratch, here, particles, stream, draw, instant):
        resample(scratch.resampling, particles, stream, draw, instant)
        copy_ancestors(scratch.cloud, here, particles, scratch.resampling.ancestor)
        return 1 - here

    return weigh_cloud, resample_cloud


@melted
def _leave_unsorted(cloud, here, particles, weight, row, scratch):
    """Leave the cloud as it is: takes the place of `sort_by_state` in schemes that do not sort."""
    return here
