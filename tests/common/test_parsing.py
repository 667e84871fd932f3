"""Text from outside becomes plain data within limits, or one line."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

import pfdist
from oracles.in_turn import in_turn
from pfdist.common.parsing import (
    MOST_BYTES,
    MOST_LEVELS,
    MOST_NUMBERS,
    finite_number,
    parse_json,
    parse_toml,
    ranges,
    read_text,
    whole_number,
    whole_numbers,
)
from pfdist.common.rounding import unrounded
from pfdist.errors import one_line, shown

DEEP = 100_000
NESTED = "{a = " * DEEP + "1" + "}" * DEEP
LONG_KEY = ".".join("a" * 5000)


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        pytest.param(parse_toml, "a = " + "[" * DEEP, id="lists that nest too deeply"),
        pytest.param(parse_toml, f"a = {NESTED}", id="tables that nest too deeply"),
        pytest.param(parse_toml, f"{LONG_KEY} = 1", id="a key of 5,000 parts"),
        pytest.param(parse_toml, "a = " + "9" * 5000, id="5,000 digits"),
        pytest.param(parse_toml, "a = 9223372036854775808", id="65 bits"),
        pytest.param(parse_toml, "a = 1\na = 2", id="a key twice"),
        pytest.param(parse_toml, "\0", id="NUL"),
        pytest.param(parse_json, "[" * DEEP, id="JSON lists that nest too deeply"),
        pytest.param(parse_json, '{"a":' * DEEP + "1" + "}" * DEEP, id="JSON objects in objects"),
        pytest.param(parse_json, "", id="nothing"),
        pytest.param(parse_json, '{"a": 9223372036854775808}', id="65 bits in JSON"),
        pytest.param(parse_json, '{"a": NaN}', id="NaN in JSON"),
        pytest.param(parse_json, "[1e999]", id="a number that is too large in JSON"),
        pytest.param(parse_json, b"\x00\xff", id="bytes that are no JSON"),
    ],
)
def test_text_that_no_job_and_no_run_has_is_refused_in_one_short_line(
    parse: Callable[[str], object], text: str
) -> None:
    with pytest.raises(ValueError, match=r"\S") as refused:
        parse(text)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


def test_what_is_within_the_limits_is_what_the_text_says() -> None:
    deep = "[" * (MOST_LEVELS - 1) + "]" * (MOST_LEVELS - 1)
    assert parse_toml(f"a = {2**63 - 1}\nb = -9223372036854775808")["a"] == 2**63 - 1
    assert parse_json(f'{{"a": {deep}}}')["a"] != []
    assert parse_json(b'[1.5e308, -1e-320, "NaN"]') == [1.5e308, -1e-320, "NaN"]


def test_one_function_reads_json() -> None:
    package = Path(pfdist.__file__).parent
    words = re.compile(r"json\.loads?\b|JSONDecoder|validate_json|receive_json|\bread_json")
    readers = [file for file in package.rglob("*.py") if words.search(file.read_text("utf-8"))]
    assert readers == [package / "common" / "parsing.py"]


def test_a_file_of_any_size_is_read_up_to_a_limit(tmp_path: Path) -> None:
    path = tmp_path / "huge.toml"
    path.write_bytes(b"#" * (MOST_BYTES + 1))
    with pytest.raises(ValueError, match="at most 16,000,000 bytes"):
        read_text(path)
    path.write_bytes(b"seed = 1 # \xff")
    with pytest.raises(ValueError, match="UTF-8, got byte 0xff at 11"):
        read_text(path)


@pytest.mark.parametrize("number", [0.0, -3.5, 1e-7, 0.1, 1.7e12, 1.25e40, -2.5e-20])
def test_numbers_that_pfdist_prints_are_read_again(number: float) -> None:
    assert finite_number(unrounded(number)) == finite_number(repr(number)) == number


@pytest.mark.parametrize("text", ["1e", "e3", "1e999", ".5", "nan", "inf", "1e1.5"])
def test_other_texts_are_no_numbers(text: str) -> None:
    with pytest.raises(ValueError, match="must be a number"):
        finite_number(text)


@in_turn("text", ["1_0", "\u0663", "\u00b2", "", " 1", "1.0", "+", "9" * 5000])
def test_whole_numbers_are_spelt_in_ascii_digits(text: str) -> None:
    with pytest.raises(ValueError, match="digits 0-9") as refused:
        whole_number(text)
    assert len(str(refused.value)) < 200
    assert (whole_number("-7"), whole_number("+07")) == (-7, 7)


@pytest.mark.parametrize(
    "value",
    [
        pytest.param("x" * 3_000_000, id="3 MB of text"),
        pytest.param(["x" * 1000] * 1000, id="a long list"),
        pytest.param(10**5000, id="5,000 digits"),
        pytest.param([[[[[[[]]]]]]], id="a deep list"),
    ],
)
def test_no_value_is_shown_whole_that_is_long(value: object) -> None:
    assert len(shown(value)) < 300
    assert "\n" not in shown(value)


def test_a_line_holds_no_control_characters_but_every_name() -> None:
    assert one_line("a\nb\x1b[2J\x00\udcff é  ±") == "a b?[2J?\udcff é  ±"


@in_turn(
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


@in_turn(
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
