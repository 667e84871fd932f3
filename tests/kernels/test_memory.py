"""Named tuples that Python and compiled code hand to compiled functions."""

import sys
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from pfdist.errors import EngineWarning
from pfdist.kernels import cached
from pfdist.kernels.cached import entry
from pfdist.kernels.memory import call, read, zeros


class Inner(NamedTuple):
    scale: float
    flag: bool


class Outer(NamedTuple):
    count: int
    inner: Inner
    key: np.uint64
    values: NDArray[np.float32]
    out: NDArray[np.float64]


@entry(Outer)
def _write(outer):  # type: ignore[no-untyped-def]
    count, inner, key, values, out = read(outer)
    for i in range(count):
        out[i] = inner.scale * values[i] if inner.flag else 0.0
    out[count] = np.float64(key >> np.uint64(60))


class Twice(NamedTuple):
    outer: Outer
    write: int


@entry(Twice)
def _write_twice(twice):  # type: ignore[no-untyped-def]
    outer, write = read(twice)
    doubled = Inner(2.0 * outer.inner.scale, True)
    call(write, Outer(outer.count, outer.inner, outer.key, outer.values, outer.out))
    if outer.inner.flag:
        call(write, Outer(1, doubled, outer.key, outer.values, outer.out))


def test_compiled_code_gets_all_fields_of_a_named_tuple() -> None:
    values, out = np.arange(3, dtype=np.float32), np.empty(4)
    _write(Outer(3, Inner(0.5, True), np.uint64(2**63), values, out))
    np.testing.assert_array_equal(out, [0.0, 0.5, 1.0, 8.0])


def test_compiled_code_calls_another_function_by_its_address() -> None:
    values, out = np.arange(1, 4, dtype=np.float32), np.empty(4)
    outer = Outer(3, Inner(0.5, True), np.uint64(2**63), values, out)
    _write_twice(Twice(outer, _write.address))
    np.testing.assert_array_equal(out, [1.0, 8.0, 1.5, 8.0])


@pytest.mark.parametrize("values", [np.zeros(3), np.zeros(6, np.float32)[::2]])
def test_an_array_of_another_type_is_not_accepted(values: NDArray[np.float32]) -> None:
    with pytest.raises(TypeError, match="contiguous, of float32"):
        _write(Outer(3, Inner(0.5, True), np.uint64(1), values, np.empty(4)))


def test_arrays_of_zeros_lie_apart_in_one_memory() -> None:
    memory, addresses = zeros(Outer, values=17, out=2)
    assert addresses["values"] % 64 == addresses["out"] % 64 == 0
    assert addresses["out"] == addresses["values"] + 128
    assert memory.ctypes.data + memory.size >= addresses["out"] + 16
    assert not memory.any()


def test_a_terminal_sees_when_the_filter_is_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(cached.FOLDER_VARIABLE, str(tmp_path / "cache"))
    folder = partial(cached._folder.__wrapped__, tmp_path)
    folder()
    assert capsys.readouterr().err == ""  # no terminal
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    (folder() / "code").touch()
    folder()
    assert capsys.readouterr().err == "Compiling the filter, once on this machine (about 10 s)...\n"


def test_code_is_not_kept_in_a_folder_that_others_can_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tmp_path.chmod(0o777)
    monkeypatch.setenv(cached.FOLDER_VARIABLE, str(tmp_path))
    with pytest.warns(EngineWarning, match="compiled code is not kept"):
        assert cached._folder.__wrapped__(tmp_path) is None
