"""An answer in the terminal, or as one JSON object."""

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from pfdist.cli.words import Line
from pfdist.common.parts import Page
from pfdist.errors import one_line
from pfdist.pages.terminal import lines_of, wrapped
from pfdist.questions.run_page import answer_of
from pfdist.results import Run, finite, reaching
from pfdist.results.stored_run import steps_by_part
from pfdist.runner.parts import PARTS
from pfdist.store import listed_pages
from pfdist.store.folder import FIGURES_FOLDER, REPORT, figures_in


def show(answer: Any, line: Line, json_stream: TextIO) -> None:
    """Print the answer of a command.

    Parameters
    ----------
    answer : object
        The result of the function of the command. Lines and checks are printed one by one.
    line : Line
        The command line.
    json_stream : file
        Receives the JSON object, if one is wanted.
    """
    if isinstance(answer, Iterator):
        _show_each(answer, line, json_stream)
    elif line.json:
        _print_json(_as_json(answer, line), json_stream)
    else:
        _show_text(answer, line)


def _show_each(answers: Iterator[Any], line: Line, stream: TextIO) -> None:
    made, is_whole = [], False
    try:
        for each in answers:
            made.append(each)
            if not line.json:
                print("\n".join(_lines(each)), flush=True)
        is_whole = True
    finally:
        if line.json and (made or is_whole):
            _print_json(_as_one(made, line.name), stream)


def _as_one(made: list[Any], command: str) -> dict[str, Any]:
    """Lines, names with descriptions, or checks as one object."""
    match made:
        case [tuple(), *_]:
            return {command: {name.strip(): description for name, description in made}}
        case [str(), *_] | []:
            return {"lines": made}
    return {"checks": [dataclasses.asdict(each) for each in made]}


def _lines(each: Any) -> list[str]:
    """The lines of a text, of a name with its description, or of a check."""
    match each:
        case str():
            return [one_line(each)]
        case name, description:
            return wrapped(description, name)
    return wrapped(f"{each.name}: {each.text}", f"{each.state:5} ")


def _as_json(answer: Any, line: Line) -> dict[str, Any]:
    target = line.options.get("target")
    match answer:
        case str() | Path():
            return {"answer": str(answer)}
        case Run() if target is not None:
            asked = {"target": target, "reached": reaching(answer.table("sets"), target)}
            return answer.as_json() | asked
        case Run():
            return answer.as_json()
    values: dict[str, Any] = answer.as_json()
    return values


def _print_json(answer: dict[str, Any], stream: TextIO) -> None:
    """Print an answer as one JSON object; a number that is not finite becomes null."""
    print(json.dumps(finite(answer), indent=2, allow_nan=False), file=stream)


def _show_text(answer: Any, line: Line) -> None:
    match answer:
        case str():
            print(answer)
        case Path():
            print(one_line(str(answer)))
        case Run():
            _show_run(answer, line)
        case _:
            _print_page(answer._page(), line)
            if files := getattr(answer, "files", ()):
                print("\n".join(["", *(one_line(str(file)) for file in files)]))
            if figures := getattr(answer, "figures", ()):
                names = ", ".join(dict.fromkeys(file.stem for file in figures))
                print("\n".join(wrapped(f"({names})", f"figures: {figures[0].parent} ")))


def _show_run(run: Run, line: Line) -> None:
    """Print the answer of a run; what only `status` and --verbose say is left out if it ended."""
    page = answer_of(run, line.options.get("target"), details=line.verbose)
    is_status, places = line.name == "status", _places(run)
    if run.state == "finished" and not (is_status or line.verbose):
        places = dict([*places.items()][-1:])  # the report, if there is one
        page = dataclasses.replace(page, place="")
    _print_page(page, line)
    if is_status and (done := steps_by_part(run)):
        parts = "; ".join(f"{PARTS[part]} {steps:.3g}" for part, steps in done.items())
        text = f"{sum(done.values()):.3g} ({parts})"
        print("\n".join(wrapped(text, "particle-steps: ")))
    print("\n" * (not page.place), end="")
    for name, at in places.items():
        print(one_line(f"{name}: {at}"))


def _places(run: Run) -> dict[str, Path]:
    """Tables, figures and report of a run, as far as they are there.

    The user's own files with these names do not count, nor do pages that show fewer draws.
    """
    pages = listed_pages(run.path)
    places = {
        "tables": ("tables", (run.path / "tables").is_dir()),
        "figures": (FIGURES_FOLDER, not pages.isdisjoint(figures_in(run.path))),
        "report": (REPORT, run.path / REPORT in pages),
    }
    return {name: run.path / file for name, (file, is_there) in places.items() if is_there}


def _print_page(page: Page, line: Line) -> None:
    print("\n".join(lines_of(page, verbose=line.verbose)).strip("\n"))
