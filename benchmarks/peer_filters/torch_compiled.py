"""PyTorch on many draws at once: ``torch.compile`` for each step, float32, on the CPU.

Blocks of 250 draws. The option `fallback_random` takes PyTorch's own vectorised normals: those of
the compiled code are made one by one, and the filter takes 7 times the time. Systematic resampling
scatters where each particle's children begin; with `searchsorted` the filter takes 2.5 times the
time. Multinomial looks up ascending uniforms, made from exponentials: unsorted ones, sorted ones
and `torch.multinomial` take 1.7 to 2 times the time.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

Array = NDArray[np.float64]

_DRAWS_AT_ONCE = 250

torch.set_num_threads(1)
_compiled = torch.compile(dynamic=False, options={"fallback_random": True})


def filter_draws(
    y: Array, z: Array, measured: NDArray[np.bool_], particles: int, resampling: str, seed: int
) -> Array:
    """Filter draws block by block; see `benchmarks.peer_filters`."""
    torch.manual_seed(seed)
    with torch.inference_mode():
        return _filter_draws(y, z, measured, particles, resampling)


def _filter_draws(
    y: Array, z: Array, measured: NDArray[np.bool_], particles: int, resampling: str
) -> Array:
    begin, to_measurement = _STEPS[resampling]
    t = torch.arange(measured.size, dtype=torch.float32)
    push, sd = 8 * torch.cos(1.2 * (t - 1)), torch.sin(0.25 * t) + 2
    mse = np.empty(len(y))
    for first in range(0, len(y), _DRAWS_AT_ONCE):
        block = slice(first, first + _DRAWS_AT_ONCE)
        here, truth = (
            torch.tensor(values[block].T[:, :, None], dtype=torch.float32) for values in (y, z)
        )
        x = 5 * torch.randn(here.shape[1], particles)
        x, total = begin(x, here[0], truth[0], sd[0]) if measured[0] else (x, _error(x, truth[0]))
        for now in range(1, measured.size):
            if measured[now]:
                x, error = to_measurement(x, push[now], here[now], truth[now], sd[now])
            else:
                x, error = _to_next(x, push[now], truth[now])
            total += error
        mse[block] = total[:, 0] / measured.size
    return mse


def _propagated(x: Any, push: Any) -> Any:
    return x / 2 + 25 * x / (1 + x * x) + push + torch.randn_like(x)


def _error(x: Any, z: Any) -> Any:
    return (x.mean(1, keepdim=True) - z) ** 2


def _next(x: Any, push: Any, z: Any) -> Any:
    x = _propagated(x, push)
    return x, _error(x, z)


_to_next = _compiled(_next)


def _steps(ancestors: Callable[[Any], Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """The first measurement, and the step to any other, with a resampling scheme."""

    def observe(x: Any, y: Any, z: Any, sd: Any) -> Any:
        log_weight = -0.5 * ((y - x * x / 20) / sd) ** 2
        weight = torch.exp(log_weight - log_weight.amax(1, keepdim=True))
        weight = weight / weight.sum(1, keepdim=True)
        error = ((weight * x).sum(1, keepdim=True) - z) ** 2
        return x.gather(1, ancestors(weight).clamp(max=x.shape[1] - 1)), error

    def to_measurement(x: Any, push: Any, y: Any, z: Any, sd: Any) -> Any:
        return observe(_propagated(x, push), y, z, sd)

    return _compiled(observe), _compiled(to_measurement)


def _systematic(weight: Any) -> Any:
    draws, particles = weight.shape
    cumulative = weight.cumsum(1)
    scale = particles / cumulative[:, -1:]
    ends = torch.ceil(cumulative * scale - torch.rand(draws, 1)).long().clamp(0, particles)
    passed = torch.zeros(draws, particles + 1, dtype=torch.int64)
    return passed.scatter_add_(1, ends, torch.ones_like(ends)).cumsum(1)[:, :particles]


def _multinomial(weight: Any) -> Any:
    draws, particles = weight.shape
    cumulative = weight.cumsum(1)
    sums = (-torch.log1p(-torch.rand(draws, particles + 1))).cumsum(1)
    points = sums[:, :-1] * (cumulative[:, -1:] / sums[:, -1:])
    return torch.searchsorted(cumulative, points, right=True)


_STEPS = {"multinomial": _steps(_multinomial), "systematic": _steps(_systematic)}
