"""Many short cases in one test: each item of pytest takes longer than such a case."""

import inspect
from collections.abc import Callable, Iterable
from functools import wraps
from typing import Any

Test = Callable[..., None]


def in_turn(names: str | tuple[str, ...], values: Iterable[Any]) -> Callable[[Test], Test]:
    """A decorator as ``pytest.mark.parametrize``, whose cases are one test.

    The first case that fails ends the test, with a note which it was.
    """
    cases = [(value,) if isinstance(names, str) else tuple(value) for value in values]
    names = (names,) if isinstance(names, str) else names
    assert cases

    def decorated(test: Test) -> Test:
        @wraps(test)
        def with_each(*args: Any, **given: Any) -> None:
            for case in cases:
                try:
                    test(*args, **given, **dict(zip(names, case, strict=True)))
                except BaseException as error:
                    error.add_note(f"in the case {case!r:.500}")
                    raise

        signature = inspect.signature(test)
        rest = [each for name, each in signature.parameters.items() if name not in names]
        with_each.__signature__ = signature.replace(parameters=rest)  # type: ignore[attr-defined]
        return with_each

    return decorated
