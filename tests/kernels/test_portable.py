"""The compiled engine gives the same bytes, whichever processor its code is made for.

Each operation of a formula is rounded as it is written, and the kernel's source fixes the order of
its additions. LLVM chooses the length of vectors by the processor, and nothing else.
"""

import os
import platform
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import cycle

import pytest

from oracles.bytes_under import Case, hashes_under, names
from pfdist import load_model
from pfdist.filters.settings import RESAMPLING
from pfdist.models import installed_models
from pfdist.plugins.check import model_checks as checks_of_models
from pfdist.pools.cores import usable_cores

SHIPPED = sorted(name for name, (module, _) in installed_models().items() if "pfdist." in module)
DRAWN = ("oracles/drawn.py:model", "systematic")
FEW = [("ungm", "multinomial"), ("xray_tumour", "systematic"), DRAWN]


def every_scheme_and_model() -> list[Case]:
    """Each scheme with the paper's model, each model with a scheme in turn, and the draws."""
    of_ungm = [("ungm", scheme) for scheme in RESAMPLING]
    return [DRAWN, *of_ungm, *zip(SHIPPED, cycle(RESAMPLING), strict=False)]


@pytest.mark.parametrize(
    ("cases", "most"),
    [
        pytest.param(FEW, 2, id="the two most different", marks=pytest.mark.slow),
        pytest.param(every_scheme_and_model(), 6, id="all", marks=pytest.mark.crash),
    ],
)
def test_bytes_are_the_same_under_the_names_of_all_processors(cases, most, tmp_path):
    compared = names()[:most]
    with ThreadPoolExecutor(usable_cores()) as processes:
        found = processes.map(lambda name: hashes_under(name, cases, tmp_path / name), compared)
        under = dict(zip(compared, found, strict=True))
    assert len(under) >= 2, f"nothing was compared: only {list(under)} runs here"
    first, *others = under
    for other in others:
        assert under[other] == under[first], f"{other} differs from {first}"
    # A simulation for each model; one estimator at least, and estimates, for each case.
    assert len(under[first]) >= len({model for model, *_ in cases}) + 2 * len(set(cases))


@pytest.mark.skipif(platform.machine() != "x86_64", reason="processors of another kind have it")
@pytest.mark.parametrize(
    ("name", "has"), [("generic", False), pytest.param("haswell", True, marks=pytest.mark.slow)]
)
def test_a_processor_without_fused_multiply_add_is_noticed(name, has):
    code = "from pfdist.kernels import lowering; print(lowering.has_fused_multiply_add())"
    environment = {**os.environ, "NUMBA_CPU_NAME": name}
    printed = subprocess.check_output([sys.executable, "-c", code], env=environment, text=True)
    assert printed.strip() == str(has)


def test_check_model_says_that_a_processor_lacks_it(monkeypatch):
    monkeypatch.setattr(checks_of_models, "has_fused_multiply_add", lambda: False)
    checks = checks_of_models.check_loaded(lambda: load_model("random_walk"), 3, 10)
    text = next(each.text for each in checks if each.name == "compile")
    assert "about 10 times as long" in text
