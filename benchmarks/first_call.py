"""The time that a fresh process takes to its first evaluation, with a cold and a warm cache."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable

import pandas as pd

from pfdist.kernels.cached import FOLDER_VARIABLE

_CHILD = """
import json, sys, time
start = time.perf_counter()
import pfdist
from pfdist.filters.simulation import simulate
from pfdist.filters.particle_filter import filter_draws
imported = time.perf_counter()
model = pfdist.load_model(sys.argv[1])
draws = simulate(model, 60, range(1000), 1)
filter_draws(model, draws, tuple(range(0, 61, 3)), 500, 2)
done = time.perf_counter()
print(json.dumps({"import_seconds": imported - start, "first_call_seconds": done - imported}))
"""


def measure_first_calls(models: Iterable[str], repeats: int) -> pd.DataFrame:
    """Give the times of the import, and of the first simulation and filter, in fresh processes.

    Parameters
    ----------
    models : iterable of str
    repeats : int
        Number of pairs of a cold start, with an empty cache, and a warm start after it.

    Returns
    -------
    DataFrame
        model, cache (cold or warm), repeat, import_seconds, first_call_seconds.
    """
    rows = []
    for model in models:
        for repeat in range(repeats):
            with tempfile.TemporaryDirectory(prefix="cache-") as cache:
                for state in ("cold", "warm"):
                    command = [sys.executable, "-c", _CHILD, model]
                    environment = os.environ | {FOLDER_VARIABLE: cache}
                    done = subprocess.run(  # noqa: S603  our own text
                        command, env=environment, check=True, capture_output=True, text=True
                    )
                    about = {"model": model, "cache": state, "repeat": repeat}
                    rows.append(about | json.loads(done.stdout))
    return pd.DataFrame(rows)
