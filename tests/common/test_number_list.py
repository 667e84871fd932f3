"""Lists of numbers: one spelling for times and for numbers of measurements."""

import pytest

from pfdist.common.number_list import MOST_NUMBERS, ranges, whole_numbers


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("7", [7]),
        ("0,6,12", [0, 6, 12]),
        ("0 6 12", [0, 6, 12]),
        (" 0, 6 ,12,", [0, 6, 12]),
        ("5:8", [5, 6, 7, 8]),
        ("0:12:6", [0, 6, 12]),
        ("0:13:6", [0, 6, 12]),
        ("3:3", [3]),
        ("12 0:4:2,7", [12, 0, 2, 4, 7]),
        ("-1", [-1]),
    ],
)
def test_numbers_ranges_commas_and_spaces_mix(text: str, numbers: list[int]) -> None:
    assert whole_numbers(text) == numbers


@pytest.mark.parametrize(
    "text", ["", ",", "1,,2", "x", "1:", ":2", "1:2:3:4", "3:1", "1:3:0", "1:3:-1", "1.5", "1-3"]
)
def test_anything_else_is_refused_with_what_was_given(text: str) -> None:
    with pytest.raises(ValueError, match=r"must .*got ") as refused:
        whole_numbers(text)
    assert repr(text) in str(refused.value)


def test_no_range_is_too_long_for_memory() -> None:
    assert len(whole_numbers(f"1:{MOST_NUMBERS}")) == MOST_NUMBERS
    for text in (f"0:{MOST_NUMBERS}", "0:" + "9" * 40, f"1:{MOST_NUMBERS} 1"):
        with pytest.raises(ValueError, match="at most 1,000,000 numbers"):
            whole_numbers(text)
    assert ranges("0:5000000 7", float) == [(0.0, 5_000_000.0, 0.0), (7.0, 7.0, 0.0)]
    with pytest.raises(ValueError, match="at most 1,000,000 numbers"):
        ranges("0:5000000:1", float)
