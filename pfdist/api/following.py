"""How a caller follows a computation: by functions of their own, or by the display of pfdist."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from pfdist.common.arguments import called_argument
from pfdist.runner.progress import Show

Say = Callable[[str], Any]


def silent(line: str) -> None:
    """Print nothing."""


@contextlib.contextmanager
def following(progress: Show | bool, say: Say) -> Iterator[tuple[Show, Say]]:
    """The functions that receive the progress and the messages of a computation.

    Parameters
    ----------
    progress : callable or bool
        True shows progress and messages: a bar in a terminal, a line in a notebook, else a line
        every few seconds. False shows nothing. A callable receives each
        `pfdist.runner.progress.Progress`.
    say : callable
        Receives the messages, line by line.
    """
    called_argument("say", say)
    if not isinstance(progress, bool):
        called_argument("progress", progress)
        yield progress, say
    elif not progress:
        yield lambda state: None, say
    else:
        from pfdist.api.display import Display  # noqa: PLC0415  rich takes long to load

        with Display() as display:
            yield display.show, display.say if say is silent else say
