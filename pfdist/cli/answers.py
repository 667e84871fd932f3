"""How commands print their answers: as text, or as one JSON object."""

import dataclasses
import json
from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping
from inspect import signature
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from pfdist.errors import one_line

if TYPE_CHECKING:  # a command that checks nothing needs no module of the checks
    import pandas as pd

    from pfdist.analysis import Run
    from pfdist.checks.model import Check
    from pfdist.documents.parts import Page

_NONE: Mapping[str, Any] = MappingProxyType({})


def print_json(answer: dict[str, Any], options: Namespace) -> None:
    """Print an answer as one JSON object; a number that is not finite becomes null."""
    # Not above: pandas takes long to load, and commands without --json need no pandas.
    from pfdist.analysis import finite  # noqa: PLC0415

    print(json.dumps(finite(answer), indent=2, allow_nan=False), file=options.answers)


def print_records(
    name: str, frame: "pd.DataFrame", options: Namespace, facts: Mapping[str, Any] = _NONE
) -> None:
    """Print a table as one JSON object, with its rows under a name.

    Parameters
    ----------
    name : str
    frame : DataFrame
        Moments become texts as of ISO 8601, and missing values null.
    options : Namespace
        The parsed arguments.
    facts : mapping, optional
        Stands before the rows.
    """
    cells = frame.astype(object).where(frame.notna(), None)
    rows = [
        {str(key): _plain(value) for key, value in row.items()} for row in cells.to_dict("records")
    ]
    print_json({**facts, name: rows}, options)


def _plain(value: Any) -> Any:
    return value.isoformat(timespec="seconds") if hasattr(value, "isoformat") else value


def computed(
    function: Callable[..., Any], options: Namespace, *arguments: Any, **chosen: Any
) -> Any:
    """Call a function of `pfdist.api` for a job, and show its progress.

    The function gets the job, these arguments, and every other option of the command that has the
    name of one of its keywords.
    """
    from pfdist.api.display import Display  # noqa: PLC0415

    given = signature(function).bind_partial(options.job, *arguments).arguments
    keywords = [key for key in signature(function).parameters if key not in given]
    chosen = {key: getattr(options, key) for key in keywords if hasattr(options, key)} | chosen
    if "report" in keywords and hasattr(options, "no_report"):
        chosen["report"] = not options.no_report
    with Display() as display:
        chosen |= {"changes": options.set, "say": display.say}
        if "progress" in keywords:
            chosen["progress"] = display.show
        return function(options.job, *arguments, **chosen)


def print_answer(answer: Any, options: Namespace, files: Iterable[Path] = ()) -> None:
    """Print an answer of `pfdist.api`, and the files that were written."""
    if options.json:
        print_json(answer.as_json(), options)
        return
    print_page(answer._page(), options)
    if names := [one_line(str(file)) for file in files]:
        print("\n".join(["", *names]))


def print_page(page: "Page", options: Namespace) -> None:
    """Print an answer; its details too, if they were asked for."""
    from pfdist.documents.terminal import lines_of  # noqa: PLC0415

    lines = lines_of(page, verbose=getattr(options, "verbose", False))
    print("\n".join(lines).strip("\n"))


def print_run(run: "Run", options: Namespace, target: float | None = None) -> None:
    """Print what a run has found, and where its tables, its figures and its report are.

    Files of the user's own that have these names are not named.

    Parameters
    ----------
    run : Run
    options : Namespace
        The parsed arguments.
    target : float, optional
        An expected MSE: how many measurements reach it.
    """
    if options.json:
        from pfdist.analysis import reaching  # noqa: PLC0415

        reached = {} if target is None else reaching(run.table("budget"), target)
        asked = {} if target is None else {"target": target, "reached": reached}
        print_json(run.summary().as_json() | asked, options)
        return
    # Not above: commands that print no run need none of these libraries.
    from pfdist.answers.run import answer_of  # noqa: PLC0415
    from pfdist.store.folder import (  # noqa: PLC0415
        FIGURES_FOLDER,
        REPORT,
        figures_in,
        has_report,
    )

    print_page(answer_of(run, target, details=options.verbose), options)
    results = {
        "tables": ("tables", (run.path / "tables").is_dir()),
        "figures": (FIGURES_FOLDER, any(figures_in(run.path))),
        "report": (REPORT, has_report(run.path)),
    }
    print_places({name: run.path / file for name, (file, is_there) in results.items() if is_there})


def print_places(places: Mapping[str, Path]) -> None:
    """Print where files are, by what they hold, in one line if it fits; no path is cut."""
    from pfdist.documents.terminal import COLUMNS  # noqa: PLC0415

    texts = [one_line(f"{name}: {at}") for name, at in places.items()]
    line = "   ".join(texts)
    if texts:
        print("\n" + (line if len(line) <= COLUMNS else "\n".join(texts)))


def print_checks(checks: Iterable["Check"], options: Namespace) -> list[str]:
    """Print checks as they are made, or all as one JSON object.

    Returns
    -------
    list of str
        Names of the checks that found something wrong.
    """
    from pfdist.documents.terminal import wrapped  # noqa: PLC0415

    made = []
    for check in checks:
        made.append(check)
        if not options.json:
            lines = wrapped(f"{check.name}: {check.text}", f"{check.state:5} ")
            print("\n".join(lines), flush=True)
    if options.json:
        print_json({"checks": [dataclasses.asdict(check) for check in made]}, options)
    return [check.name for check in made if check.state == "wrong"]
