"""Validation errors are a sentence: in our words for the commonest mistakes, else in pydantic's.

A misspelt name is followed by the name that was meant, or by nothing.
"""

import inspect
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from oracles.in_turn import in_turn
from pfdist.common.nearest import did_you_mean, did_you_mean_path, quoted_names
from pfdist.common.section import Arguments, Whole, checked, explained
from pfdist.errors import ArgumentError, JobError

METHODS = ["corridor", "random", "relaxation", "survivors"]


class Inner(BaseModel):
    model_config = ConfigDict(extra="forbid")
    count: int = 1


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)
    whole: Annotated[int, Field(ge=1, lt=2**63)] = 1
    even: Annotated[int, Field(multiple_of=2)] = 2
    share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    finite: Annotated[float, Field(allow_inf_nan=False)] = 0.5
    flag: bool = True
    name: Annotated[str, Field(pattern="^[a-z]+$", max_length=5)] = "a"
    kind: Literal["fresh", "common"] = "fresh"
    several: Annotated[list[int], Field(min_length=1, max_length=2)] = [1]
    parameters: dict[str, float] = {}
    inner: Inner = Inner()
    either: Annotated[int, Field(ge=1)] | Literal["auto"] = 1
    entries: tuple[int | str, ...] = ()
    prices: tuple[float, ...] | dict[str, float] = ()


def sentence(data: dict[str, Any]) -> str:
    with pytest.raises(ValidationError) as caught:
        Section.model_validate(data)
    return explained(caught.value, Section)


@in_turn(
    ("key", "value", "said"),
    [
        ("whole", 0, "whole must be at least 1, got 0"),
        ("whole", 2**63, f"whole must be less than {2**63}, got {2**63}"),
        ("whole", 1.0, "whole must be an integer, got 1.0"),
        ("even", 7, "even must be a multiple of 2, got 7"),
        ("share", 1.5, "share must be at most 1, got 1.5"),
        ("share", "x", "share must be a number, got 'x'"),
        ("flag", 1, "flag must be true or false, got 1"),
        ("name", "A", "name: String should match pattern '^[a-z]+$', got 'A'"),
        ("kind", "new", "kind must be 'fresh' or 'common', got 'new'"),
        (
            "several",
            [],
            "several: List should have at least 1 item after validation, not 0, got []",
        ),
        ("inner", 3, "inner must be a section, got 3"),
        (
            "inner",
            {"cont": 3},
            "unknown key 'cont' in [inner]; did you mean 'count'? Allowed: count",
        ),
        ("kind", "comon", "kind: got 'comon'; did you mean 'common'? Allowed: 'fresh' or 'common'"),
        (
            "count",
            3,
            "unknown key 'count'; did you mean 'inner.count'? Allowed: "
            f"{', '.join(Section.model_fields)}",
        ),
        ("either", 0, "either must be at least 1 or 'auto', got 0"),
        (
            "either",
            "atuo",
            "either: got 'atuo'; did you mean 'auto'? Allowed: an integer or 'auto'",
        ),
        ("entries", (1, 2.5), "each entry of entries must be an integer or a string, got 2.5"),
        ("prices", {"a": "x"}, "prices must be a number, got 'x'"),
    ],
)
def test_each_type_of_error_has_its_own_words(key: str, value: object, said: str) -> None:
    assert sentence({key: value}) == said


@checked
def squared(
    first: object,
    draws: Annotated[Whole, Field(ge=1)] | None = None,
    *others: object,
    label: Annotated[Literal["a", "b"], Field()] = "a",
    **more: object,
) -> tuple[object, ...]:
    return first, draws, others, label, more


def test_arguments_are_checked_by_the_types_that_declare_limits() -> None:
    assert squared([1]) == ([1], None, (), "a", {})
    first, draws, *others = squared("x", np.int32(3), 4, label="b", extra=5)
    assert (first, draws, *others) == ("x", 3, (4,), "b", {"extra": 5})
    assert type(draws) is int
    for wrong in (0, np.int64(0), True, 1.0, "1"):
        with pytest.raises(ArgumentError, match=r"^draws must be ") as caught:
            squared(1, wrong)  # type: ignore[arg-type]
        assert caught.value.argument == "draws"
    with pytest.raises(ArgumentError, match=r"^label must be 'a' or 'b', got 'c'$"):
        squared(1, label="c")  # type: ignore[arg-type]
    label = inspect.signature(squared).parameters["label"]
    assert label.annotation == Literal["a", "b"]  # without the limits


def test_settings_raise_the_error_that_their_class_names() -> None:
    class Settings(Arguments):
        error: ClassVar = JobError
        draws: Annotated[Whole, Field(ge=1)] = 1

    assert Settings(draws=np.int64(2)).draws == 2  # type: ignore[arg-type]
    for wrong, said in (({"draws": 0}, "at least 1, got 0"), ({"drws": 1}, "did you mean 'draws'")):
        with pytest.raises(JobError, match=said) as caught:
            Settings(**wrong)
        assert caught.value.argument in wrong


@in_turn(
    ("word", "name"),
    [
        ("survivor", "survivors"),
        ("Relaxation", "relaxation"),
        ("relxaation", "relaxation"),
        ("genetic", ""),
        ("", ""),
        (3, ""),
        (["survivors"], ""),
        ("survivors" * 1_000_000, ""),  # nobody means this
    ],
)
def test_the_nearest_name_is_similar_or_empty(word: object, name: str) -> None:
    assert did_you_mean(word, METHODS) == (f"; did you mean {name!r}?" if name else "")


def test_a_path_of_a_similar_name_and_of_the_wanted_kind_is_suggested(tmp_path: Path) -> None:
    for name in ("quick", "quack.toml"):
        (tmp_path / name).mkdir()
    folders = (tmp_path / "none", tmp_path)
    meant = did_you_mean_path(Path("quik"), folders, lambda path: not path.suffix)
    assert meant == f"; did you mean {str(tmp_path / 'quick')!r}?"
    assert did_you_mean_path(Path("quik"), folders, lambda path: False) == ""


def test_names_between_quotes_are_found() -> None:
    assert quoted_names("'fresh' or 'common'") == ["fresh", "common"]
