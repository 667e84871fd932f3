"""The store of a finished run, for tables that answer a question about the run."""

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from pfdist.analysis import Run
from pfdist.errors import RunMismatchError, StoreError
from pfdist.runner.build import Built
from pfdist.runner.identity import opened, store_of
from pfdist.runner.provenance import note_processor
from pfdist.store import Store


@contextlib.contextmanager
def own_store(
    run: Run, built: Built, say: Callable[[str], Any], *, must_be: bool = True
) -> Iterator[Store]:
    """The run's own store, or a temporary store if another version computed the run.

    Parameters
    ----------
    run : Run
    built : Built
    say : callable
        Receives a line for each damaged file, and if nothing is stored in the run's folder.
    must_be : bool
        Whether the folder must be fit for writing; otherwise a temporary store takes its place.

    Raises
    ------
    StoreError
        Another process computes the run, or the folder cannot be read or written.
    """
    with contextlib.ExitStack() as stack:
        try:
            store = stack.enter_context(opened(run.path, built, say))
            note_processor(run.path, built, say)
        except RunMismatchError as error:
            difference, *_ = error.differences
            say(f"{run.path} is of another program ({difference}): the answer is not stored there")
            store = _elsewhere(stack, built)
        except StoreError as error:
            if must_be:
                raise
            say(f"the answer is not stored in the run: {error}")
            store = _elsewhere(stack, built)
        yield store


def _elsewhere(stack: contextlib.ExitStack, built: Built) -> Store:
    return store_of(built, Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="pfdist-"))))
