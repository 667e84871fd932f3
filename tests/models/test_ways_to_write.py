"""Ways to write a formula: the compiled engine computes what NumPy computes from a model's file."""

import numpy as np
import pytest

from oracles.model_text import MEASURED
from pfdist.filters import particle_filter, plain, simulation
from pfdist.models import carried_model

MODEL = (
    """
import math
import numba
import numpy as np
import pandas as pd
import pfdist
from pfdist import StateSpaceModel
{before}

def transition(x, t, w, p):
    {body}

model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (w[0],),
    transition=transition,
"""
    + MEASURED
    + """    parameters={{"sigma": 0.9}},
)
"""
)
WAYS = {
    "a dictionary": ("DOSES = {0: 5.0, 4: 3.0}", "return (x[0] / 2 + DOSES.get(t, 0.0) + w[0],)"),
    "a list": ("RATES = [0.1 * k for k in range(20)]", "return (RATES[t] * x[0] + w[0],)"),
    "a frame": (
        "FRAME = pd.DataFrame({'dose': np.arange(20.0)})",
        "return (0.5 * x[0] + 0.1 * FRAME.loc[t, 'dose'] + w[0],)",
    ),
    "a generator": ("", "return tuple(p.sigma * each + w[0] for each in x)"),
    "a regime by a table": (
        "GAINS = [0.9, -0.5, 0.1]",
        "return (pfdist.take(GAINS, np.clip(np.abs(x[0]), 0, 2).astype(int)) * x[0] + w[0],)",
    ),
    "a helper of Numba": (
        "@numba.njit\ndef half(a):\n    return 0.5 * a",
        "return (half(x[0]) + w[0],)",
    ),
    "math of t": ("", "return (0.5 * x[0] + math.cos(t) + w[0],)"),
    "a branch on t": ("", "return (x[0] + w[0] if t % 3 else 0.5 * x[0],)"),
    "a loop": (
        "",
        "a = x[0]\n    for _ in range(5):\n        a = a + 0.1 * np.sin(a)\n"
        "    return (a + p.sigma * w[0],)",
    ),
    "a small matrix": (
        "A = np.array([[0.5, 0.2], [0.1, 0.7]])",
        "return ((A @ np.array([x[0], w[0]]))[0] + w[0],)",
    ),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_formula_may_be_written_in_many_ways(way, tmp_path):
    before, body = WAYS[way]
    (tmp_path / "mine.py").write_text(MODEL.format(before=before, body=body))
    model = carried_model("mine.py:model", tmp_path).model
    draws = simulation.simulate(model, 12, range(20), 1)
    slow = plain.simulate(model, 12, range(20), 1)
    np.testing.assert_allclose(draws.x, slow.x, rtol=1e-9, atol=1e-12)
    fast, slow = (
        engine.filter_draws(model, draws, (0, 4, 8), 100, 2) for engine in (particle_filter, plain)
    )
    np.testing.assert_allclose(fast.mse, slow.mse, rtol=1e-7)
