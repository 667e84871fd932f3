"""The options that computing functions share: shown by their signatures, and checked by name."""

import inspect
from collections.abc import Callable
from typing import Any

import pytest

import pfdist
from pfdist.errors import ArgumentError
from pfdist.questions.options import Options

FUNCTIONS = [
    pfdist.run, pfdist.plan, pfdist.budget, pfdist.online, pfdist.compare, pfdist.bound,
    pfdist.sweep,
]  # fmt: skip


@pytest.mark.parametrize("function", FUNCTIONS)
def test_the_signature_shows_every_option_by_name(function: Callable[..., Any]) -> None:
    parameters = inspect.signature(function).parameters
    assert set(Options.__annotations__) <= set(parameters)
    kinds = {parameters[name].kind for name in Options.__annotations__}
    assert kinds == {inspect.Parameter.KEYWORD_ONLY}


@pytest.mark.parametrize("function", FUNCTIONS)
def test_an_unknown_option_is_refused_with_the_nearest(function: Callable[..., Any]) -> None:
    with pytest.raises(ArgumentError, match="got worker; did you mean 'workers'") as refused:
        function("job.toml", worker=2)
    assert "\n" not in str(refused.value)
    can_change = "changes" in inspect.signature(function).parameters
    assert ("changes=['KEY=VALUE'] changes a key of the job" in str(refused.value)) == can_change
