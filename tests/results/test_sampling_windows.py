"""Windows in words: which measurements matter, and which can move."""

from typing import Any

from pfdist.problem.clock import Clock
from pfdist.results.sampling_windows import windows_of

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
    assert strict.text == "2, 4, 5 (undecided: 6)"
    assert windows_of(rows, 5, CLOCK)[0].text == "2 to 5"
    assert (tuple(single.inside), tuple(single.open)) == ((9,), (8, 10))
    assert (single.text, fixed.text) == ("only 9 (undecided: 8, 10)", "only 20")
