"""The answer of a driver, computed in this process."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pfdist.problem.sections import Execution
from pfdist.runner.build import Built, make_pool
from pfdist.runner.door import Driver, RunSession, complete
from pfdist.runner.progress import Progress
from pfdist.store import Store


def answered(
    built: Built,
    driver: Callable[..., Driver],
    *arguments: Any,
    show: Callable[[Progress], Any] = lambda progress: None,
) -> Any:
    """The value of a driver; it keeps nothing, so its store has no folder."""
    session = RunSession(built, Store(Path("nowhere")), show)
    return complete(driver(session, *arguments), make_pool(Execution(pool="serial")))
