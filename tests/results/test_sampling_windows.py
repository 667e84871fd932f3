"""Windows in words: which measurements matter, and when an optimum is called flat."""

from typing import Any

import pytest

from pfdist.results.sampling_windows import is_flat, sentences, windows_of

STATES = {"i": "inside", "o": "open", "x": "outside"}


def _rows(t: int, strict: str, wide: str = "", first: int = 0) -> list[dict[Any, Any]]:
    """A row for each letter, from an instant on."""
    return [
        {"t": t, "moved_to": first + k, "within_1": STATES[a], "within_5": STATES[b]}
        for k, (a, b) in enumerate(zip(strict, wide or strict, strict=True))
    ]


def _jitter(*rows: tuple[int, int, float, float, float]) -> list[dict[Any, Any]]:
    keys = ("percent", "draws", "loss", "low", "high")
    return [dict(zip(keys, row, strict=True)) for row in rows]


def test_windows_need_not_be_contiguous_and_hold_the_measurement_itself() -> None:
    rows = _rows(4, "ixiio", "iiiix", first=2) + _rows(9, "oxo", first=8) + _rows(20, "i", first=20)
    strict, single, fixed = windows_of(reversed(rows), 1)
    assert (tuple(strict.inside), tuple(strict.open)) == ((2, 4, 5), (6,))
    assert strict.text == "2, 4, 5 (open: 6)"
    assert windows_of(rows, 5)[0].text == "2 to 5"
    assert (tuple(single.inside), tuple(single.open), single.is_single) == ((9,), (8, 10), False)
    assert single.text == "only 9 (open: 8, 10)"
    assert (fixed.can_be_tried, fixed.is_single, fixed.text) == (False, False, "only 20")


def test_an_optimum_is_flat_if_all_can_move_together_within_the_level() -> None:
    (row,) = _jitter((1, 100, 0.004, 0.001, 0.009))
    wide, fixed = _rows(4, "ii", first=4), _rows(20, "i", first=20)
    assert is_flat(windows_of(wide + fixed, 1), row)
    assert not is_flat(windows_of(fixed, 1), row)  # nothing can move
    assert not is_flat(windows_of(wide + _rows(9, "io", first=9), 1), row)
    for high in (0.0101, float("nan"), None):  # unknown, in a table and in an answer
        assert not is_flat(windows_of(wide, 1), row | {"high": high})


def test_the_summary_names_what_must_be_kept_what_can_move_and_what_is_open() -> None:
    rows = [
        *_rows(1, "xix", "iii"), *_rows(4, "ii", first=4), *_rows(9, "oio", first=8),
        *_rows(12, "xi", first=11),
    ]  # fmt: skip
    jitter = _jitter((1, 100, 0.004, -0.001, 0.009), (5, 100, 0.07, 0.06, 0.08))
    assert sentences(rows, jitter) == [
        "Keep exactly (every other instant that was tried loses more than 1 %): t = 1, 12.",
        "Can move at a loss of at most 1 %: t = 4.",
        "The draws leave open whether these can move within 1 %: t = 9.",
        "If all measurements move at random within their windows of 1 %, the loss is 0.40 % "
        "(95 %: -0.10 to 0.90).",
        "If all measurements move at random within their windows of 5 %, the loss is 7.0 % "
        "(95 %: 6.0 to 8.0).",
    ]


@pytest.mark.parametrize("is_found", [True, False])
def test_only_a_found_set_is_called_an_optimum(is_found: bool) -> None:
    jitter = _jitter((1, 100, 0.004, 0.001, 0.007), (5, 0, 0.0, 0.0, 0.0))
    rows = _rows(4, "ii", first=4) + _rows(9, "ii", first=8) + _rows(20, "i", first=20)
    said = sentences(rows, jitter, is_found=is_found)
    flat = (
        "The optimum is flat: 2 of 3 measurements can move, each within a window of 1 %. If all of "
        "these move at random within their windows, the loss is 0.40 % (95 %: 0.10 to 0.70)."
    )
    assert (flat in said) is is_found
    assert len([sentence for sentence in said if "at random" in sentence]) == 1


def test_nothing_is_said_without_measurements() -> None:
    assert sentences([], _jitter((1, 0, 0.0, 0.0, 0.0))) == []
