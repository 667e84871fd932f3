"""Without Numba's compiler there are no filters: said in one line."""

import importlib

import pytest

import pfdist.kernels
from pfdist.errors import CompileError


@pytest.mark.parametrize("value", ["1", "yes", "x" * 10_000])
def test_a_switched_off_compiler_is_named(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", value)
    with pytest.raises(CompileError, match=r"NUMBA_DISABLE_JIT must be 0 .* got") as refused:
        importlib.reload(pfdist.kernels)
    assert len(str(refused.value)) < 400


@pytest.mark.parametrize("value", ["", "0"])
def test_a_compiler_that_is_on_is_accepted(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", value)
    assert importlib.reload(pfdist.kernels) is pfdist.kernels
