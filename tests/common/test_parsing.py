"""Text from outside becomes plain data within limits, or one line."""

import pytest

from pfdist.common.parsing import (
    MOST_BYTES,
    MOST_LEVELS,
    finite_number,
    parse_json,
    parse_toml,
    read_text,
    whole_number,
)
from pfdist.common.told_times import told_time
from pfdist.errors import one_line, shown


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("a = " + "[" * 100_000, id="lists that nest too deeply"),
        pytest.param("a = " + "{a = " * 50_000 + "1" + "}" * 50_000, id="tables in a line"),
        pytest.param(".".join("a" * 5000) + " = 1", id="a key of 5,000 parts"),
        pytest.param("[" + ".".join("a" * 5000) + "]", id="a section of 5,000 parts"),
        pytest.param("a = " + "9" * 5000, id="5,000 digits"),
        pytest.param("a = 0x" + "f" * 5000, id="5,000 hexadecimal digits"),
        pytest.param("a = 9223372036854775808", id="65 bits"),
        pytest.param("a = [1, 2", id="a list without an end"),
        pytest.param("a = 1\na = 2", id="a key twice"),
        pytest.param("\0", id="NUL"),
    ],
)
def test_toml_that_no_job_has_is_refused_in_one_short_line(text: str) -> None:
    with pytest.raises(ValueError, match=r"\S") as refused:
        parse_toml(text)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("[" * 100_000, id="lists that nest too deeply"),
        pytest.param('{"a":' * 50_000 + "1" + "}" * 50_000, id="objects that nest too deeply"),
        pytest.param("9" * 5000, id="5,000 digits"),
        pytest.param("", id="nothing"),
        pytest.param("{} {}", id="two values"),
        pytest.param('{"a": 9223372036854775808}', id="65 bits"),
    ],
)
def test_json_that_no_run_has_is_refused_in_one_short_line(text: str) -> None:
    with pytest.raises(ValueError, match=r"\S") as refused:
        parse_json(text)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


def test_what_is_within_the_limits_is_what_the_text_says() -> None:
    deep = "[" * (MOST_LEVELS - 1) + "]" * (MOST_LEVELS - 1)
    assert parse_toml(f"a = {2**63 - 1}\nb = -9223372036854775808")["a"] == 2**63 - 1
    assert parse_json(f'{{"a": {deep}}}')["a"] != []


def test_a_file_of_any_size_is_read_up_to_a_limit(tmp_path) -> None:
    path = tmp_path / "huge.toml"
    path.write_bytes(b"#" * (MOST_BYTES + 1))
    with pytest.raises(ValueError, match="at most 16,000,000 bytes"):
        read_text(path)
    path.write_bytes(b"seed = 1 # \xff")
    with pytest.raises(ValueError, match="UTF-8, got byte 0xff at 11"):
        read_text(path)


@pytest.mark.parametrize("number", [0.0, -3.5, 1e-7, 0.1, 1.7e12, 1.25e40, -2.5e-20])
def test_numbers_that_pfdist_prints_are_read_again(number: float) -> None:
    assert finite_number(told_time(number)) == finite_number(repr(number)) == number


@pytest.mark.parametrize("text", ["1e", "e3", "1e999", ".5", "nan", "inf", "1e1.5"])
def test_other_texts_are_no_numbers(text: str) -> None:
    with pytest.raises(ValueError, match="must be a number"):
        finite_number(text)


@pytest.mark.parametrize("text", ["1_0", "\u0663", "\u00b2", "", " 1", "1.0", "+", "9" * 5000])
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
        pytest.param({"a": [10**5000]}, id="5,000 digits in a section"),
        pytest.param([[[[[[[]]]]]]], id="a deep list"),
    ],
)
def test_no_value_is_shown_whole_that_is_long(value: object) -> None:
    assert len(shown(value)) < 300
    assert "\n" not in shown(value)


def test_a_line_holds_no_control_characters_but_every_name() -> None:
    assert one_line("a\nb\x1b[2J\x00\udcff é  ±") == "a b?[2J?\udcff é  ±"
