"""A misspelt name is followed by the name that was meant, or by nothing."""

from pathlib import Path

import pytest

from pfdist.common.nearest import did_you_mean, did_you_mean_path, nearest_name, quoted_names

METHODS = ["annealing", "corridor", "relaxation", "survivors"]


@pytest.mark.parametrize(
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
    assert nearest_name(word, METHODS) == name
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
