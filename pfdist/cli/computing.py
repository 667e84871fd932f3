"""From parsed arguments to the arguments of the functions that compute a run."""

from argparse import Namespace
from typing import Any

from pfdist.api.display import Display


def settings(options: Namespace, display: Display) -> dict[str, Any]:
    """The arguments of `pfdist.run` that `pfdist.cli.arguments.computing` has added.

    Parameters
    ----------
    options : Namespace
        The parsed arguments.
    display : Display
        Shows the progress of the run, and prints its messages.
    """
    names = ("results", "pool", "workers", "address", "wait_for_cores", "reuse")
    chosen = {name: getattr(options, name) for name in names if hasattr(options, name)}
    return {**chosen, "report": not options.no_report, "progress": display.show, "say": display.say}
