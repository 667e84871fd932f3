"""Results on disk: a CSV file for each table, a figure for each benchmark, and a README.

The first lines of a CSV file, after ``#``, name the date and the machine. So the README can be made
from the tables alone, and benchmarks can be run separately.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Protocol

import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say
from pfdist.pages.style import styled

Tables = dict[str, pd.DataFrame]


class Benchmark(Protocol):
    """The contract of a benchmark: a module with a title, names of tables, and three functions.

    The first of the tables has the name of the benchmark.
    """

    TITLE: str
    TABLES: tuple[str, ...]

    def measure(self, quick: bool, say: Say) -> Tables:
        """Give the measured tables; with `quick` only a test that the benchmark works."""

    def summary(self, tables: Tables) -> str:
        """Give a summary of the tables in Markdown."""

    def plot(self, tables: Tables) -> Figure:
        """Give the figure of the tables."""


def save(
    folder: Path, name: str, benchmark: Benchmark, tables: Tables, provenance: Mapping[str, str]
) -> None:
    """Write the tables and the figure of a benchmark.

    Parameters
    ----------
    folder : Path
        Output folder. It is made if it does not exist.
    name : str
        Name of the benchmark.
    benchmark : Benchmark
    tables : dict of DataFrames
    provenance : mapping of str to str
        See `machine.provenance`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for table, rows in tables.items():
        head = "".join(f"# {key}: {value}\n" for key, value in provenance.items())
        text = head + rows.to_csv(index=False, float_format="%.6g")
        (folder / f"{table}.csv").write_text(text, encoding="utf-8")
    _draw(folder, name, benchmark, tables)


def redraw(folder: Path, name: str, benchmark: Benchmark) -> bool:
    """Draw the figure of a benchmark from the tables in a folder, which were measured before.

    Parameters
    ----------
    folder : Path
    name : str
        Name of the benchmark.
    benchmark : Benchmark

    Returns
    -------
    bool
        False if a table is missing.
    """
    tables = _read(folder, benchmark)
    if tables is not None:
        _draw(folder, name, benchmark, tables)
    return tables is not None


def _draw(folder: Path, name: str, benchmark: Benchmark, tables: Tables) -> None:
    with styled():
        benchmark.plot(tables).savefig(folder / f"{name}.png", bbox_inches="tight")


def _read(folder: Path, benchmark: Benchmark) -> Tables | None:
    """Read the tables of a benchmark; None if one is missing."""
    files = [folder / f"{table}.csv" for table in benchmark.TABLES]
    if not all(file.exists() for file in files):
        return None
    return {file.stem: pd.read_csv(file, comment="#") for file in files}


def write_readme(folder: Path, benchmarks: Mapping[str, Benchmark]) -> str:
    """Write the README of the tables in a folder, and give its text.

    Parameters
    ----------
    folder : Path
    benchmarks : mapping of str to Benchmark
        All benchmarks. Those without tables are left out.

    Returns
    -------
    str
        The text.
    """
    parts: list[str] = []
    for name, benchmark in benchmarks.items():
        tables = _read(folder, benchmark)
        if tables is None:
            continue
        known = _provenance(folder / f"{benchmark.TABLES[0]}.csv")
        parts += [
            f"## {benchmark.TITLE}\n",
            f"{benchmark.summary(tables)}\n",
            f"Measured on {known['date']}: {known['machine']}. {known['versions']}.\n",
            f"![{benchmark.TITLE}]({name}.png)\n",
        ]
    title = "# Benchmarks\n\nWritten by `python -m benchmarks`; the CSV files hold every figure. "
    title += "± is one standard error.\n"
    text = "\n".join([title, *parts])
    (folder / "README.md").write_text(text, encoding="utf-8")
    return text


def markdown(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Give a table in Markdown. The first column has text, the others have numbers.

    Examples
    --------
    >>> print(markdown(["who", "ns"], [["us", "1.7"]]))
    | who | ns |
    |---|---:|
    | us | 1.7 |
    """
    names = list(header)
    lines = [names, *(list(row) for row in rows)]
    text = [f"| {' | '.join(line)} |" for line in lines]
    return "\n".join([text[0], "|---|" + "---:|" * (len(names) - 1), *text[1:]])


def with_range(values: pd.Series, form: str) -> str:
    """Give the median of some values, and in brackets the least and the largest.

    Examples
    --------
    >>> with_range(pd.Series([3.0, 1.0, 2.0]), ".1f")
    '2.0 (1.0 to 3.0)'
    """
    return f"{values.median():{form}} ({values.min():{form}} to {values.max():{form}})"


def _provenance(file: Path) -> dict[str, str]:
    with file.open(encoding="utf-8") as lines:
        heads = [line[1:].strip().partition(": ") for line in lines if line.startswith("#")]
    return {key: value for key, _, value in heads}
