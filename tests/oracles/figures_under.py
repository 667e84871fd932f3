"""Print what NumPy and its linear algebra compute, in a process with the kernels of a processor."""

import json
import os
import subprocess
import sys

CORES = ("Haswell", "SkylakeX", "Zen", "Sandybridge")
"""Names that OpenBLAS knows; without it they change nothing."""


def figures_under(core: str) -> dict[str, list[float]]:
    """Compute figures of the exact filter, of the plain filter and of the analysis."""
    done = subprocess.run(
        [sys.executable, __file__],
        env={**os.environ, "OPENBLAS_CORETYPE": core},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, list[float]] = json.loads(done.stdout)
    return found


def _figures() -> dict[str, list[float]]:
    import numpy as np

    from pfdist import load_model
    from pfdist.filters import kalman, plain
    from pfdist.results import Moments
    from pfdist.results.particle_loss import less

    found = {}
    for name in ("linear_gaussian", "random_walk"):
        model = load_model(name)
        draws = plain.simulate(model, 30, range(10), 3)
        filtered = kalman.filter_draws(model, draws, (0, 5, 9, 20), 1, 0)
        found[f"{name} exact"] = kalman.expected_mse(model, 30, [(0, 5, 9, 20), (3, 4)]).tolist()
        found[f"{name} kalman"] = filtered.mse.tolist()
    model = load_model("ungm")
    draws = plain.simulate(model, 12, range(10), 3)
    mse = plain.filter_draws(model, draws, (0, 5, 9), 100, 7).mse
    found["plain"] = mse.tolist()
    moments = Moments()
    moments.add(mse)
    found["analysis"] = [moments.mean, moments.standard_error]
    first, other = np.random.default_rng(1).normal(3.0, 2.0, (2, 20_000))
    for count in range(1000, 20_001, 1000):
        many = Moments()
        many.add(first[:count])
        both = less(many, first[:count], (first + other)[:count])
        found["analysis"] += [both.value, both.standard_error]
    return found


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_figures()))
