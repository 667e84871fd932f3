"""Hashes of what the compiled engine computes, in a process whose code is made for a processor."""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from llvmlite import binding

Case = tuple[str, str]  # model, resampling

_NEEDED = {
    "haswell": {"avx2", "fma", "bmi2"},
    "skylake-avx512": {"avx512f", "avx512dq", "avx512bw", "avx512vl", "avx512cd"},
    "znver3": {"avx2", "fma", "bmi2"},
    "x86-64-v2": {"sse4.2", "ssse3", "popcnt"},
}
"""What of a processor's instructions LLVM uses for loops over numbers, by its name."""

_HORIZON, _DRAWS, _PARTICLES = 8, 20, 150  # particles fill the last vectors in part
_SETS = [(0, 3, 6), (1, 2, 8)]


def names() -> list[str]:
    """Names of processors whose code this processor runs.

    The first two differ most: this processor itself, and "generic", which each processor runs.
    """
    features = {name for name, has in binding.get_host_cpu_features().items() if has}
    others = (name for name, needed in _NEEDED.items() if needed <= features)
    return [binding.get_host_cpu_name(), "generic", *others]


def hashes_under(name: str, cases: Sequence[Case], cache: Path) -> dict[str, str]:
    """Hash what each case computes, in another process."""
    done = subprocess.run(
        [sys.executable, "-m", "oracles.bytes_under", json.dumps(cases)],
        cwd=Path(__file__).parents[1],
        env={**os.environ, "NUMBA_CPU_NAME": name, "PFDIST_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, str] = json.loads(done.stdout)
    return found


def _hashes(cases: Sequence[Case]) -> dict[str, str]:
    from oracles.clocked import with_clock
    from pfdist import load_model
    from pfdist.filters.particle_filter import filter_checked_sets, filter_draws
    from pfdist.filters.simulation import simulate
    from pfdist.filters.work import Estimation
    from pfdist.kernels.estimators import ESTIMATORS
    from pfdist.models import squared_error

    found = {}
    for name, resampling in cases:
        model = with_clock(load_model(name), _HORIZON)
        draws = simulate(model, _HORIZON, range(_DRAWS), 7)
        what = f"{name} {resampling}"
        found[f"{name} simulation"] = _hash(draws.x, draws.y, draws.z)
        for estimator in ESTIMATORS if model.error is squared_error else list(ESTIMATORS)[:1]:
            estimation = Estimation(_PARTICLES, resampling, estimator)
            mse = filter_checked_sets(model, draws, _SETS, [_HORIZON] * 2, 5, estimation)[0]
            found[f"{what} {estimator}"] = _hash(mse)
        kept = filter_draws(model, draws, _SETS[0], _PARTICLES, 5, resampling, True)
        found[f"{what} estimates"] = _hash(kept.mse, kept.estimate, kept.variance)
    return found


def _hash(*arrays: object) -> str:
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()  # type: ignore[attr-defined]


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_hashes(json.loads(sys.argv[1]))))
