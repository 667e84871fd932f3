"""Windows in words: which measurements matter, and which can move."""

from typing import Any

from pfdist.problem.clock import Clock
from pfdist.results.sampling_windows import sentences, windows_of

CLOCK = Clock.counting(20)
STATES = {"i": "inside", "o": "open", "x": "outside"}


def _rows(t: int, strict: str, wide: str = "", first: int = 0) -> list[dict[Any, Any]]:
    """A row for each letter, from an instant on."""
    return [
        {"t": t, "moved_to": first + k, "within_1": STATES[a], "within_5": STATES[b]}
        for k, (a, b) in enumerate(zip(strict, wide or strict, strict=True))
    ]


def test_windows_need_not_be_contiguous_and_hold_the_measurement_itself() -> None:
    rows = _rows(4, "ixiio", "iiiix", first=2) + _rows(9, "oxo", first=8) + _rows(20, "i", first=20)
    strict, single, fixed = windows_of(reversed(rows), 1, CLOCK)
    assert (tuple(strict.inside), tuple(strict.open)) == ((2, 4, 5), (6,))
    assert strict.text == "2, 4, 5 (open: 6)"
    assert windows_of(rows, 5, CLOCK)[0].text == "2 to 5"
    assert (tuple(single.inside), tuple(single.open), single.is_single) == ((9,), (8, 10), False)
    assert single.text == "only 9 (open: 8, 10)"
    assert (fixed.can_be_tried, fixed.is_single, fixed.text) == (False, False, "only 20")


def test_the_summary_names_what_must_be_kept_what_can_move_and_what_is_open() -> None:
    rows = [
        *_rows(1, "xix", "iii"), *_rows(4, "ii", first=4), *_rows(9, "oio", first=8),
        *_rows(12, "xi", first=11),
    ]  # fmt: skip
    assert sentences(rows, CLOCK) == [
        "Keep exactly (every other instant that was tried loses more than 1 %): t = 1, 12.",
        "Can move at a loss of at most 1 %: t = 4.",
        "Whether these can move within 1 % needs more draws: t = 9.",
    ]


def test_nothing_is_said_without_measurements() -> None:
    assert sentences([], CLOCK) == []
