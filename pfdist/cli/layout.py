"""The lines of a summary: a name, and a text beside it."""

import textwrap

COLUMNS = 80


def line(name: str, text: str) -> str:
    """Give a line of a summary."""
    return f"  {name:<21} {text}"


def wrapped_lines(name: str, text: str) -> list[str]:
    """Give the lines of a summary that a long text takes."""
    return textwrap.wrap(line(name, text), COLUMNS, subsequent_indent=line("", ""))


def paragraph(text: str) -> list[str]:
    """Give the lines of an indented sentence; a no-break space becomes a space."""
    lines = textwrap.wrap(text, COLUMNS, initial_indent="  ", subsequent_indent="  ")
    return [line.replace("\xa0", " ") for line in lines]
